"""Whole random G-code programs, as a CAM system might write them and as nobody would, with and without mistakes."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from decimal import Decimal

import numpy as np

from postproc.cell import Frame
from postproc.frames import Array

PLANES = {"G17": (0, 1, 2), "G18": (2, 0, 1), "G19": (1, 2, 0)}
OFFSETS = {
    "G54": Frame(),
    "G55": Frame(X=101.6, Y=-25.4, Z=12.7),
    "G56": Frame(X=-50.8, Z=25.4),
    "G59.1": Frame(Y=254.0),
    "G59.3": Frame(X=25.4, Y=50.8, Z=-76.2, A=30.0),
}
"""Work offsets of the cell and of rs274, mm (tenths of inches, which rs274 keeps them in)."""
TICK = 1e-4
MISTAKES = (
    "G1 G2", "G2 X1 Y1", "G3 R1", "G2 I1 R1 X1", "X", "G0 X1 X2", "M3 M4", "G4", "G4 P-1", "F-10", "G99.9", "G12",
    "M77", "M123", "G1 X1 F0", "I1", "R5", "P2", "(a (b))", "(open", "G80 X1", "S-5", "Q1", "D1", "L2", "H1",
    "G90 G91", "G17 G18", "G20 G21", "N5 N6", "G1 X1.2.3", "G0 X1 Y", "G1 X1E2", ")", "G2 I0 J0 K0",
    "G2 X9 Y9 I1 J1 K1", "T-1", "T1.5 M6", "G61 G64", "M7 M8", "M0 M1", "G54 G55", "G43 G49", "O5 X1", "N1.5.2",
    "G", "M", "G1 X1 Z1 P3", "G-1", "M-3",
)  # fmt: skip
REFUSED = (
    "G41 D1", "G42", "G28", "G30 Z1", "G53 G0 X1", "G68",
    "G95", "G96 S100", "G38.2 Z-1", "G33 Z1 K1", "G5 X1 Y1 I1 J1 P1 Q1", "G43.1 Z1", "G7",
    "G8", "G57", "G59", "M60", "M62 P1", "M66 P1", "G1 X#1",
    "A1", "G1 B2 F9", "C-3", "U1", "G0 W2",
)  # fmt: skip
"""Blocks that change the motion in a way that is not read: each must be refused, whatever rs274 says."""


@dataclass
class Block:
    """A line: its words, and how it is spelt."""

    words: list[str | tuple[str, int]]
    joint: str = " "
    lower: bool = False
    head: str = ""
    tail: str = ""

    def text(self, scale: int) -> str:
        """Return the line with its lengths times `scale`."""
        line = self.joint.join(_word(word, scale) for word in self.words)
        return self.head + (line.lower() if self.lower else line) + self.tail


def _word(word: str | tuple[str, int], scale: int) -> str:
    if isinstance(word, str):
        return word
    letter, ticks = word
    number = f"{Decimal(ticks * scale).scaleb(-4):f}"
    if "." in number and ticks % 3 == 0:
        number = number.rstrip("0")
    if number.startswith("0.") and len(number) > 2 and ticks % 2:
        number = number[1:]
    return letter + ("+" + number if ticks % 7 == 0 and ticks >= 0 else number)


@dataclass
class Generator:
    """Writes a program, knowing where the tool is.

    :ivar blocks: its lines.
    :ivar sound: nothing in it was spoilt: all its lengths can be scaled.
    :ivar refused: rows of lines that must be refused.
    """

    rng: random.Random
    blocks: list[Block] = field(default_factory=list)
    refused: set[int] = field(default_factory=set)
    sound: bool = True
    unit: float = 1.0
    plane: str = "G17"
    motion: str = ""
    relative: bool = False
    absolute_centre: bool = False
    offset: str = "G54"
    position: Array = field(default_factory=lambda: np.zeros(3))
    end: str = "\n"
    tape: bool = False

    def text(self, scale: int) -> str:
        """Return the program with all lengths times `scale`."""
        lines = [block.text(scale) for block in self.blocks]
        if self.tape:
            lines = ["%", *lines, "%"]
        return self.end.join(lines) + self.end

    def program(self) -> None:
        """Write a whole program."""
        rng = self.rng
        self.end, self.tape = rng.choice(["\n", "\n", "\r\n"]), rng.random() < 0.3
        if rng.random() < 0.5:
            self._line("G21", "G90", "G17", *rng.sample(["G40", "G49", "G80", "G94", "G54", "G64", "G98"], 3))
        self._line("G0", *[self._towards(axis, rng.uniform(-90, 90)) for axis in range(3)], "F600")
        self.motion = "G0"
        steps = [self._straight] * 4 + [self._arc] * 4 + [self._mode] * 3 + [self._machine] * 2 + [self._change_offset]
        for _ in range(rng.randint(1, 25)):
            rng.choice(steps)()
            if rng.random() < 0.03:
                self._line(rng.choice(["", "(note)", "; note", "()", "(FORCE FX=10 FY=-5.5 FZ=100)", "(FORCE OFF)"]))
            if rng.random() < 0.02:
                self._mistake()
        if not self.tape or rng.random() < 0.5:
            self._line(rng.choice(["M2", "M30", "M02"]))
            if rng.random() < 0.2:
                self._line(rng.choice(["", "G0 Y1.5 (x)", "nonsense (((", "O1001", "(end)"]))

    def _mistake(self) -> None:
        self.sound = False
        wrong = self.rng.random() < 0.5
        if wrong:
            self.refused.add(len(self.blocks))
        self.blocks.append(Block(self.rng.choice(REFUSED if wrong else MISTAKES).split(" ")))

    def _line(self, *words: str | tuple[str, int]) -> None:
        rng = self.rng
        block = Block([word for word in words if word], rng.choice([" ", " ", "", "  "]), rng.random() < 0.1)
        if any(isinstance(word, str) and word[:1] in ("(", ";", "M", "%", "n", "O") for word in block.words):
            block.joint, block.lower = " ", False
        if rng.random() < 0.3:
            block.head = f"N{len(self.blocks) * 10} "
        if rng.random() < 0.05 and block.words:
            block.head = "/" + block.head
        if rng.random() < 0.08:
            block.tail = rng.choice([" (c)", " ; c", "(FORCE FX=5)", " ", "\t"])
        self.blocks.append(block)

    def _named(self, code: str) -> list[str]:
        modal = code == self.motion and self.rng.random() < 0.6
        self.motion = code
        return [] if modal else [self.rng.choice([code, code, code.replace("G", "G0")])]

    def _towards(self, axis: int, target: float) -> tuple[str, int]:
        """Word for an axis, and the position is there: the nearest that can be written."""
        origin = self.position[axis] if self.relative else 0.0
        ticks = round((target - origin) / self.unit / TICK)
        self.position[axis] = origin + ticks * TICK * self.unit
        return "XYZ"[axis], ticks

    def _straight(self) -> None:
        code = self._named(self.rng.choice(["G0", "G1", "G1"]))
        axes = self.rng.sample(range(3), self.rng.choice([1, 1, 2, 3]))
        words = [self._towards(axis, self.position[axis] + self.rng.uniform(-60, 60)) for axis in axes]
        self._line(*code, *words, *self._feed(), *self.rng.choice([[]] * 8 + [["A0."], ["B0"], ["M8"], ["M9"]]))

    def _feed(self) -> list[str]:
        return [f"F{self.rng.choice([60, 100.5, '.5', 3000])}"] if self.rng.random() < 0.2 else []

    def _arc(self) -> None:
        rng = self.rng
        first, second, across = PLANES[self.plane]
        radius = rng.uniform(0.5, 40.0) * self.unit
        heading, clockwise = rng.uniform(-3.1, 3.1), rng.random() < 0.5
        by_radius, full = rng.random() < 0.4, rng.random() < 0.2
        sweep = rng.choice([rng.uniform(0.2, 3.0), rng.uniform(3.3, 6.0)])
        start = self.position.copy()
        centre = radius * np.array([math.cos(heading), math.sin(heading)])
        origin = np.where(self.absolute_centre, start[[first, second]], 0.0)
        ticks = np.rint((centre + origin) / self.unit / TICK)
        centre = ticks * TICK * self.unit - origin
        angle = -sweep if clockwise else sweep
        cos, sin = math.cos(angle), math.sin(angle)
        to = centre - np.array([[cos, -sin], [sin, cos]]) @ centre
        words: list[str | tuple[str, int]] = [*self._named("G2" if clockwise else "G3")]
        if not full:
            words += [self._towards(axis, start[axis] + d) for axis, d in zip((first, second), to, strict=True)]
        if rng.random() < 0.3:
            words.append(self._towards(across, self.position[across] + rng.uniform(-20, 20)))
        if by_radius and not full:
            length = round(float(np.hypot(*centre)) / self.unit / TICK)
            words.append(("R", -length if sweep > math.pi else length))
        else:
            words += [("IJK"[axis], int(n)) for axis, n in zip((first, second), ticks, strict=True)]
        if rng.random() < 0.15:
            words.append(f"P{rng.randint(1, 4)}")
        rng.shuffle(words) if rng.random() < 0.1 else None
        self._line(*words, *self._feed())

    def _mode(self) -> None:
        codes = self.rng.sample(["units", "distance", "centre", "plane", "path", "none", "feed", "cancel"], 1)
        words: list[str] = []
        for code in codes:
            if code == "units":
                words.append(self.rng.choice(["G20", "G21"]))
                self.unit = 25.4 if words[-1] == "G20" else 1.0
            elif code == "distance":
                words.append(self.rng.choice(["G90", "G91"]))
                self.relative = words[-1] == "G91"
            elif code == "centre":
                words.append(self.rng.choice(["G90.1", "G91.1"]))
                self.absolute_centre = words[-1] == "G90.1"
            elif code == "plane":
                words.append(self.rng.choice(["G17", "G18", "G19"]))
                self.plane = words[-1]
            elif code == "path":
                words += self.rng.choice([["G61"], ["G61.1"], ["G64"], ["G64", "P.05"], ["G64", "P1", "Q0.1"]])
            elif code == "none":
                words.append(self.rng.choice(["G40", "G49", "G98", "G99", "G97", "G92.1", "G43 H1", "G94 F500"]))
            elif code == "feed":
                words.append(f"F{self.rng.randint(1, 3000)}")
            else:
                words.append("G80")
                self.motion = ""
        self._line(*" ".join(words).split(" "))

    def _machine(self) -> None:
        block = self.rng.choice(
            ["S1200 M3", "M4 S800", "M5", "M8", "M7", "M9", "G4 P.5", "G4 P2", "M0", "M1", "T2 M6", "T3", "S900",
             "M48 M49", "M3", "M5 M9"]
        )  # fmt: skip
        if "M6" in block and OFFSETS[self.offset].A:
            return  # the stand-alone rs274 then forgets the turn of the work offset
        self._line(*block.split(" "))

    def _change_offset(self) -> None:
        new = self.rng.choice(list(OFFSETS))
        here = np.append(self.position, 1000.0) / 1000.0
        base = OFFSETS[self.offset].pose() @ here
        self.position = (np.linalg.inv(OFFSETS[new].pose()) @ base)[:3] * 1000.0
        self.offset = new
        self._line(new)


def mutated(made: Generator, rng: random.Random) -> None:
    """Spoil a program a little: words of lines after the first motion are left out, doubled, swapped or changed."""
    for _ in range(rng.choice([1, 1, 2, 3])):
        row = rng.randrange(2, len(made.blocks)) if len(made.blocks) > 2 else 0
        words = made.blocks[row].words
        if row == 0 or not words or row in made.refused:
            continue
        place = rng.randrange(len(words))
        kind = rng.choice(["drop", "double", "swap", "letter", "number", "insert"])
        if kind == "drop":
            del words[place]
        elif kind == "double":
            words.insert(place, words[place])
        elif kind == "swap":
            at = rng.randrange(2, len(made.blocks))
            other = made.blocks[at].words
            if other and at not in made.refused:
                at = rng.randrange(len(other))
                words[place], other[at] = other[at], words[place]
        elif kind == "letter" and isinstance(words[place], tuple):
            words[place] = (rng.choice("XYZIJKRFPQ"), words[place][1])
        elif kind == "number" and isinstance(words[place], tuple):
            words[place] = (words[place][0], rng.choice([0, -words[place][1], words[place][1] * 10, 1, 10_000]))
        elif kind == "insert":
            words.insert(
                place,
                rng.choice(["G0", "G1", "G2", "G3", "G80", "G17", "G91", "F0", "P1", "I0", "K0", "M5", "R1", "S5"]),
            )
