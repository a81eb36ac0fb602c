"""The parameters of a program while it runs: ``#1``, ``#<name>``.

Numbers 1 to 30 and plain names belong to a subprogram, numbers from 31 on and names that begin with ``_`` to all. What
no block has set is known to the machine alone (the last probed point, the place of G28, what another program left
behind): reading it is an error.
"""

from __future__ import annotations

from collections.abc import Sequence

from postproc.dialects.gcode.blocks import BlockError

ARGUMENTS = 30
"""So many numbered parameters belong to a subprogram."""
_LOCAL = range(1, ARGUMENTS + 1)
_LARGEST = 5601
_OF_THE_MACHINE = 5000
"""Numbers beyond this are the control's own: probed points, offsets, positions."""
_SET_FIRST = "Set it in the program, before it is used."
_MACHINE = "Only the machine knows it: write the number instead."


def key_of(name: str) -> str:
    """Return the name of a parameter as it is kept; case and blanks mean nothing in it."""
    return "".join(name.split()).lower()


Key = int | str
"""A parameter: its number, or its name."""


class Parameters:
    """What is known while a program runs."""

    def __init__(self) -> None:
        self._common: dict[Key, float] = {}
        self._own: dict[Key, float] = {}
        self._callers: list[tuple[dict[Key, float] | None, dict[Key, float]]] = []

    def get(self, key: Key) -> float:
        """Return the value of a parameter.

        :raises BlockError: it has none.
        """
        value = self._place(key).get(key)
        if value is not None:
            return value
        if isinstance(key, int):
            own = _checked(key) > _OF_THE_MACHINE
            raise BlockError(f"parameter #{key} has no value", _MACHINE if own else _SET_FIRST)
        raise BlockError(f"parameter #<{key}> has no value", _MACHINE if key.startswith("_") else _SET_FIRST)

    def exists(self, key: Key) -> bool:
        """Return whether a parameter has a value."""
        return key in self._place(key)

    def put(self, key: Key, value: float) -> None:
        """Give a parameter a value.

        :raises BlockError: it is the control's own.
        """
        if isinstance(key, int) and _checked(key) > _OF_THE_MACHINE:
            raise BlockError(f"parameter #{key} is the control's own", "Write G10, G52 or G54 … instead.")
        self._place(key)[key] = value

    def enter(self, arguments: Sequence[float] | None) -> None:
        """Begin a subprogram with its arguments as #1 …, all else up to #30 zero; None: it shares its caller's."""
        saved: dict[Key, float] | None = None
        if arguments is not None:
            saved = {n: self._common[n] for n in _LOCAL if n in self._common}
            self._common.update(dict.fromkeys(_LOCAL, 0.0))
            self._common.update(enumerate(arguments, 1))
        self._callers.append((saved, self._own))
        self._own = {}

    def leave(self) -> None:
        """End a subprogram: what belongs to its caller is there again."""
        saved, self._own = self._callers.pop()
        if saved is not None:
            for n in _LOCAL:
                self._common.pop(n, None)
            self._common.update(saved)

    def _place(self, key: Key) -> dict[Key, float]:
        return self._own if isinstance(key, str) and not key.startswith("_") else self._common


def _checked(number: int) -> int:
    if not 0 < number <= _LARGEST:
        raise BlockError(f"there is no parameter #{number}", f"Numbers are 1 to {_LARGEST}.")
    return number
