"""Codes that shift the program frame (G10, G52, G92 …), and those that go to a place of the machine (G28, G30, G53).

What the latter mean on a robot the cell says, `[machine]`. Words of G28 count only where they make an intermediate
point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct

from postproc.cell import Cell
from postproc.dialects.gcode import codes
from postproc.dialects.gcode.blocks import BlockError


class Origin(Struct, frozen=True):
    """A change of the program frame: by G10, G52 or G92…; lengths in mm.

    :ivar axes: axis 0…2 → its word.
    :ivar system: of G10, 1 for G54 to 9 for G59.3, 0 for the one in force; `turn` its R [deg], None without.
    :ivar here: True for G10 L20, which gives coordinates of where the tool is.
    """

    row: int
    code: float
    axes: Mapping[int, float]
    system: int = 0
    turn: float | None = None
    here: bool = False


class Return(Struct, frozen=True):
    """A line with G28, G30 or G53: the axes that it names, with their words [mm]."""

    row: int
    code: float
    axes: Mapping[int, float]


class Places:
    """What the lines say of places, so far.

    :ivar offsets: names of the work offsets that are known.
    """

    def __init__(self, cell: Cell) -> None:
        self.machine = cell.machine
        self.rotary = "" if cell.rotary is None else "".join(cell.rotary.axes)
        self.offsets = {"G54", *cell.work_offsets}
        self.origins: list[Origin] = []
        self.returns: dict[int, Return] = {}
        self._shifted = False

    def read(self, row: int, g: Sequence[float], motion: float, values: dict[str, float], mm: float) -> None:
        """Take the words of such a code, if the block has one.

        :param g: its G codes, `motion` the one of G0 to G3 among them, or NaN.
        :param values: its words by letter; what is used is taken away.
        :param mm: of a unit of length.
        :raises BlockError: what it says cannot be done.
        """
        using = [code for code in g if code in codes.ORIGINS or code in codes.RETURNS]
        if not using:
            return
        takes = {letter: values.pop(letter) for letter in "XYZ" if letter in values}
        turned = [letter for letter in self.rotary if letter in values]
        if turned and (using[0] in codes.ORIGINS or self.machine.home is None):
            raise BlockError(f"{turned[0]} in a block with G{using[0]:g}", "Write X, Y and Z alone there.")
        for letter in turned:
            values[letter] = 0.0  # where the axes of the machine are at home
        axes = {"XYZ".index(letter): value * mm for letter, value in takes.items()}
        if len(using) > 1 or set(g) & {2.0, 3.0, *codes.CYCLES}:
            raise BlockError("two codes that take the same words in one block", "Write one block for each.")
        code = using[0]
        if code in codes.RETURNS:
            self._return(row, code, motion, axes)
        elif code == codes.STORE:
            self._store(row, axes, values)
        else:
            self._shift(row, code, axes)

    def _shift(self, row: int, code: float, axes: Mapping[int, float]) -> None:
        if code in (codes.LOCAL, codes.SHIFT) and not axes:
            raise BlockError(f"G{code:g} without X, Y or Z", None)
        if code == codes.SHIFT_ON and not self._shifted:
            raise BlockError("G92.3 restores an offset that the program has not set", "Set it by G92, or remove it.")
        self._shifted |= code in (codes.LOCAL, codes.SHIFT)
        self.origins.append(Origin(row, code, axes))

    def _return(self, row: int, code: float, motion: float, axes: Mapping[int, float]) -> None:
        machine, name = self.machine, f"G{code:g}"
        if machine.home is None and machine.clearance_Z is None:
            advice = (
                "Say what it means here, in the cell: [machine] home = [A1 … A6] or clearance_Z; or remove the block."
            )
            raise BlockError(f"{name} is not supported without [machine] in the cell", advice)
        if code == codes.MACHINE and motion in (1.0, 2.0, 3.0):
            advice = "G53 goes to where [machine] says, with G0: write the move in coordinates of the part."
            raise BlockError(f"{name} with G{motion:g}", advice)
        if not axes and code == codes.MACHINE:
            advice = (
                "It does nothing on most controls: remove it. Where it holds for the lines behind it, write it there."
            )
            raise BlockError("G53 without X, Y or Z", advice)
        if machine.home is None and set(axes) != {2}:
            advice = "[machine] clearance_Z says where Z goes only: give home, or let the CAM system retract in Z."
            raise BlockError(f"{name} with axes other than Z", advice)
        self.returns[row] = Return(row, code, axes)

    def _store(self, row: int, axes: Mapping[int, float], values: dict[str, float]) -> None:
        kind, system, turn = values.pop("L", 0.0), values.pop("P", -1.0), values.pop("R", None)
        if kind not in (2.0, 20.0) or (kind == 20.0 and turn is not None):
            raise BlockError(f"G10 L{kind:g} is not supported", "Tools are in the cell: [tools.1] …")
        if system not in range(10):
            raise BlockError("G10 without a work offset", "P1 is G54, P9 is G59.3, P0 the one in force.")
        number = int(system)
        if number:
            self.offsets.add(f"G{codes.WORK_OFFSETS[number - 1]:g}")
        self.origins.append(Origin(row, codes.STORE, axes, number, turn, kind == 20.0))
