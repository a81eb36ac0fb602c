"""Random G-code against rs274: the same motions and the same switching, refused exactly where it should be.

    python -m tests.attack.gcode --minutes 60 [--seed 0]

Each program is written twice, with its lengths as they are and 2000 times as long, so that the four decimals that rs274
prints show what is read to 5e-8. Half of the programs are spoilt. What is accepted by one side only must be one of the
differences that `postproc.dialects.gcode` states. Then the text itself is spoilt (`inputs`): no reader may fail in any
other way than with its own errors.
"""

from __future__ import annotations

import random
import re
import traceback

from msgspec.structs import replace

from postproc.dialects import gcode
from postproc.dialects.text import decode
from postproc.errors import MAX_ERRORS, InputError
from postproc.program import Program
from tests.attack import inputs
from tests.attack.driver import Wrong, parser, try_seeds
from tests.attack.gcode_generator import OFFSETS, Generator, mutated
from tests.dialects.gcode_reading import CELL, forward, outcome
from tests.oracle.rs274 import RejectedError, assert_same_moves, canonical

SCALE = 2000
NUMBERS = {"G54": 1, "G55": 2, "G56": 3, "G57": 4, "G58": 5, "G59": 6, "G59.1": 7, "G59.2": 8, "G59.3": 9}
PLACES = {NUMBERS[name]: frame.pose() for name, frame in OFFSETS.items()}
CELL_HERE = replace(CELL, work_offsets={name: frame for name, frame in OFFSETS.items() if name != "G54"})

REFUSED_HERE = re.compile(
    r"is not supported|is not known|not in the cell|has no value|O word|neither in this file|without its end|without O"
    r"|outside of O|has not set|levels deep|M98|M99|word without a code that uses it|G4 in one block with an arc"
    r"|before the position is known|out of range|too many digits|moves nothing|G80 G80|force comment"
    r"|after G28, G30 or G53|of the cycle: given in G9"
)
"""What rs274 may accept and the reader refuses, see `postproc.dialects.gcode`."""
ACCEPTED_HERE = re.compile(
    r"(?i)too many m codes|[IJK] word given for arc|mixed radius|no percent sign or program end|tool"
    r"|axis values without a g code|nested comment|dwell time missing|two g codes that both use axis values"
)
"""What rs274 may refuse and the reader accepts."""
ONLY_OTHER_AXIS = re.compile(r"(?im)^/?(n\d+)? *[ab] *0\.? *([(;].*)?$")
"""A block that rs274 quotes as wrong and the reader ignores: after G2 or G80 it takes A0 alone for a motion."""


def variables(scale: int) -> str:
    """The work offsets as the variable file of rs274, which counts in inches."""
    lines = ["5161 0", "5220 1"]
    for name, frame in OFFSETS.items():
        first = 5201 + 20 * NUMBERS[name]
        lines += [f"{first + n} {value * scale / 25.4:.6f}" for n, value in enumerate((frame.X, frame.Y, frame.Z))]
        lines.append(f"{first + 9} {frame.A:.6f}")
    return "\n".join(lines) + "\n"


def try_program(seed: int) -> str:
    """Make one program and compare. Returns what came of it in a word.

    :raises Wrong: with the program.
    """
    rng = random.Random(seed)
    made = Generator(rng)
    made.program()
    if rng.random() < 0.5:
        mutated(made, rng)
        made.sound = False
    text = made.text(1)
    try:
        return _compared(made, text)
    except Exception as cause:
        raise Wrong(f"seed {seed}:\n{text}\n{traceback.format_exc()}") from cause


def _compared(made: Generator, text: str) -> str:
    ends = [row for row, block in enumerate(made.blocks) if set(block.words) & {"M2", "M30", "M02"}]
    refused = {row + 1 + made.tape for row in made.refused if row <= min(ends, default=row)}
    here: Program | InputError
    try:
        here = gcode.read(decode("part.nc", text.encode()), CELL_HERE, forward, "part")
    except InputError as error:
        here = error
    assert outcome(text, CELL_HERE, bulk=True) == outcome(text, CELL_HERE, bulk=False), "bulk reading differs"
    if isinstance(here, InputError):
        errors = [here, *here.further_errors]
        missed = refused - {error.line for error in errors}
        assert not missed or len(errors) > MAX_ERRORS, f"not refused: lines {missed}"
    else:
        assert not refused, f"accepted: lines {refused}"
    if not made.sound and "G59.3" in text.upper() and re.search(r"(?i)M0?6", text):
        return "not comparable"  # the stand-alone rs274 forgets the turn of a work offset when the tool is changed
    try:
        there = canonical(text, variables(1))
    except RejectedError as cause:
        if isinstance(here, InputError):
            return "refused by both"
        reason = re.sub(r"(?m)^ *\d+ N\S* .*\n", "", str(cause))
        kept_feed = "zero feed rate" in reason and "G94" in text.upper()
        fine = kept_feed or ONLY_OTHER_AXIS.search(reason) or ACCEPTED_HERE.search(reason)
        assert fine, f"accepted, but rs274 says {reason}"
        return "accepted here only"
    if isinstance(here, InputError):
        if any(error.problem.startswith("M99") for error in errors):
            return "refused here only"  # which rs274 takes for the end
        assert all(REFUSED_HERE.search(error.problem) for error in errors), f"refused, but rs274 accepts: {here}"
        return "refused here only"
    assert_same_moves(here, there, 1.0, digits=2e-4 * 25.4, offsets=PLACES)
    if not made.sound:
        return "same, to four decimals"
    try:
        large = canonical(made.text(SCALE), variables(SCALE))
    except RejectedError:
        return "same, to four decimals"
    assert_same_moves(here, large, SCALE, offsets=PLACES)
    return "same"


def main() -> int:
    """Try programs and other input files, and count what came of them."""
    options = parser(__doc__).parse_args()
    return try_seeds(options, try_program, *inputs.ATTACKS)


if __name__ == "__main__":
    raise SystemExit(main())
