"""What is known of a value before the program runs, and which variable a name means."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct, field

from postproc.dialects.krl.language.positions import Position
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.values import Aggregate, Number, Word


class Unknown(Struct, frozen=True):
    """A variable whose value is not known before the program runs.

    :param where: what changes it, as text for a message; empty where it has no value at all.
    """

    where: str = ""


NOTHING = Unknown()


Known = Number | Word | Aggregate | Position | Unknown


class Unread(Struct, frozen=True):
    """A value that stands in a declaration and is read when it is needed."""

    source: Source
    start: int
    stop: int


class Scope(Struct, frozen=True):
    """Which variable a name means.

    :param local: names of the routine's own → how they are stored.
    :param own: names of the routine's module, or those of the main program that it does not see.
    :param prefix: what is put before these.
    """

    local: Mapping[str, str] = field(default_factory=dict)
    own: frozenset[str] = frozenset()
    prefix: str = ""

    def stored(self, name: str) -> str:
        """Return under which name a variable (upper case) is stored."""
        local = self.local.get(name)
        return local if local is not None else self.prefix + name if name in self.own else name
