"""Programs of a folder against rs274: the same motions and the same switching.

    python -m tests.attack.collected FOLDER... [--list]

Cutter-location files and RAPID modules are read and compared as `collected_cam` says. Reads each G-code program below
the folders in a bare cell and in the cell of a shop: with `[machine] clearance_Z`, all tools, work offsets. Runs rs274
on those that are read. It has no machine zero and no tool lengths, so what is compared is: places, arcs and feeds of
all cutting moves; between them the rapids; what is switched before. Rapids from and to machine positions (G28, G30,
G53), those before the first cut, and those of cycles without G98 or G99 (here to the height before the cycle, there to
R) count by the place where they end. An axis that is still at `[start]` here is at zero there. F in a block that
changes the units is in the new ones here. Where the position is not known at the first move the program is read again
with `[machine] home` at zero, where rs274 begins.

Prints what came of each program with `--list`, and the reasons of refusals with the number of programs. Ends with 1 if
motions differ.
"""

from __future__ import annotations

import argparse
import re
import signal
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell, Frame, Machine, Rotary
from postproc.dialects import gcode
from postproc.dialects.gcode.reader import GCODE
from postproc.dialects.text import decode
from postproc.errors import InputError
from postproc.frames import Array
from postproc.program import CIRC, Program
from tests.attack.collected_cam import APT_NAMES, MODULE, RAPID_NAMES, tried_apt, tried_rapid
from tests.dialects.gcode_reading import CELL, forward
from tests.oracle.rs274 import Move, RejectedError, _states, canonical

SECONDS = 60
"""Time for one program."""
NAMES = {*GCODE.extensions, ".ncc", ".eia", ".min", ".spf", ".prg", ".din", ".fnc", ".cnc", ".nct"}
OFFSETS = ("G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
CLEARANCE_MM = 200.0
BARE = replace(CELL, base=Frame(), machine=Machine(), work_offsets={}, tools={})
SHOP = replace(
    BARE,
    gcode=replace(CELL.gcode, spindle_on=["; on"], spindle_ccw=["; backwards"]),
    machine=Machine(clearance_Z=CLEARANCE_MM),
    work_offsets=dict.fromkeys(OFFSETS, Frame()),
)
START_MM = (forward(SHOP.start_joints) @ SHOP.tool.pose())[:3, 3] * 1e3
"""Where moves at feed begin if X, Y, Z are not known."""
_TOOL_WORD = re.compile(r"(?i)T0*(\d{1,5})(?!\d)")
_ASIDE_TEXT = re.compile(r"\([^()]*\)|;.*")
_TAPS_ASIDE, _ASIDE = re.compile(r"(?i)G\s*84(?![\d.])"), re.compile(r"(?i)G\s*1[89](?![\d.])")
_RETRACT = re.compile(r"(?i)G\s*9[89](?![\d.])")
_HOMES = re.compile(r"(?i)G\s*(?:28|30)(?![\d.])")
_MOTION_CODE = re.compile(r"(?i)G\s*0*[01](?![\d.])")
_ANY_MOTION = re.compile(r"(?i)G\s*(?:0*[0-3]|73|8[1-9])(?![\d.])")
_G80 = re.compile(r"(?i)G\s*80(?![\d.])")
_NUMBERED = re.compile(r"(?i)\s*(?:N\s*\d+)?\s*")
_ONLY_PLACES = re.compile(r"(?i)\s*(?:N\s*\d+)?(?:\s*[XYZ]\s*-?[\d.]+)+\s*")
_NOTHING = re.compile(r"(?i)G\s*50(?![\d.])|K\s*-?(?:0+\.?0*|\.0+)(?![\d.])(?=[^()]*$)")
_CYCLE = re.compile(r"(?i)G\s*(?:73|8[1-9])(?![\d.])")
_UNITS_WITH_F = re.compile(r"(?im)^[^(;\n]*(?:G\s*2[01](?![\d.])[^(;\n]*F|F[^(;\n]*G\s*2[01](?![\d.]))")
_MACHINE = re.compile(r"(?i)G\s*0*(?:28|30|53)(?![\d.])")
_MACHINE_OR_CYCLE = re.compile(r"(?i)G\s*0*(?:28|30|53|73|8[1-9])(?![\d.])")


class Outcome(NamedTuple):
    """What came of a program: a word, and the reason."""

    word: str
    reason: str = ""


class Cut(NamedTuple):
    """A cutting move, and the rapids before it: [mm], [mm/min].

    :param line: of the program, 0 where it is not known.
    :param state: what is switched, as in `Move.state`.
    """

    end: Array
    centre: Array | None
    normal: Array | None
    feed: float
    rapids: list[Array]
    state: tuple[object, ...]
    line: int = 0


def shop(text: str, axes: Sequence[str] = ()) -> Cell:
    """Return the cell of a shop that has all tools of a program."""
    tools = {number: Frame(Z=350.0) for number in dict.fromkeys(_TOOL_WORD.findall(text))}
    return replace(SHOP, tools=tools, rotary=Rotary(axes=list(axes), kind="tcp") if axes else None)


def read_or_error(path: Path, cell: Cell) -> Program | InputError:
    """Read a program, or return why not."""
    try:
        document = replace(decode(path.name, path.read_bytes()), folder=str(path.parent))
        return gcode.read(document, cell, forward, "part")
    except InputError as error:
        return error


def tried(path: Path) -> tuple[str, Outcome]:
    """Return what came of a program: in a bare cell (a word), and in that of a shop."""
    text = path.read_bytes().decode("latin-1")
    bare = read_or_error(path, BARE)
    axes = [axis for axis in "CBA" if re.search(rf"(?im)(?<![A-Z#]){axis}-?[\d.]", _ASIDE_TEXT.sub("", text))]
    program = read_or_error(path, shop(text))
    if isinstance(program, InputError) and axes and "word without a code" in program.problem:
        turned = read_or_error(path, shop(text, axes))
        program = program if isinstance(turned, InputError) and "word without a code" in turned.problem else turned
    is_from_zero = isinstance(program, InputError) and "before the position is known" in program.problem
    if is_from_zero:
        program = read_or_error(path, replace(shop(text, axes), machine=replace(SHOP.machine, home=[0.0, 0.0, 0.0])))
    word = "refused" if isinstance(bare, InputError) else "read"
    moves: list[Move] | str
    try:
        moves = moves_there(path)
    except RejectedError as cause:
        moves = _said(str(cause))
    if isinstance(program, InputError):
        return word, Outcome("refused by both" if isinstance(moves, str) else "refused here only", reason(program))
    if isinstance(moves, str):
        return word, Outcome("not read by rs274", moves)
    if _TAPS_ASIDE.search(text) and _ASIDE.search(text):
        return word, Outcome("not comparable", "rs274 confuses the axes of G84 in G18 and G19")
    found = difference(program, moves, text, turning=program.swivel is not None, is_from_zero=is_from_zero)
    return word, Outcome("differs", found) if found else Outcome("same")


def reason(error: InputError) -> str:
    """Return the problem of an error, without the names of subprograms and parameters."""
    return re.sub(r"O?<[^<>]*>", "O<…>", error.problem)


def _said(output: str) -> str:
    lines = [line for line in output.splitlines() if line.strip() and not re.match(r" *\d+ N\S* ", line)]
    return " / ".join(lines[-3:])


def moves_there(path: Path, *, alone: bool = False) -> list[Move]:
    """Run rs274; the end of the program is added if it has none.

    :param alone: without the other programs of the folder, which it may call.
    """
    text = path.read_bytes().decode("latin-1")
    others = [one for one in path.parent.iterdir() if one.suffix.lower() in NAMES and one != path and not alone]
    files = {one.name: one.read_bytes().decode("latin-1") for one in others[:200]}
    tools = {int(number) for number in _TOOL_WORD.findall(text)}
    cause: RejectedError | None = None
    for version in (text, (plain := _as_rs274_takes_it(text)), plain.rstrip() + "\nM2\n"):
        try:
            return canonical(version, files=files, tools=tools)
        except RejectedError as rejected:
            cause = rejected if cause is None or "no percent sign or program end" in str(cause) else cause
    assert cause is not None
    raise cause


def _as_rs274_takes_it(text: str) -> str:
    """Return a program, line by line, without what has no effect but is refused by rs274.

    That is a byte order mark, a % without an opening one, the motion code of a block with G28 or G30, G50, and an
    offset of zero across the plane of an arc. Coordinates after G80 become rapids.
    """
    lines = text.removeprefix("\xef\xbb\xbf").splitlines()
    if "%" not in next((line for line in lines if line.strip()), ""):
        lines = ["" if line.strip().startswith("%") else line for line in lines]
    out: list[str] = []
    ended = False
    for line in lines:
        words = _ASIDE_TEXT.sub("", line)
        if _HOMES.search(words):
            line = _MOTION_CODE.sub("", words)
        if ended and _ONLY_PLACES.fullmatch(words):
            line = f"{_NUMBERED.match(words)[0]}G0 {_NUMBERED.sub('', words)}"
        if _ANY_MOTION.search(words):
            ended = False
        ended |= _G80.search(words) is not None
        out.append(_NOTHING.sub("", line))
    return "\n".join([*out, ""])


def difference(
    program: Program, moves: list[Move], text: str, *, turning: bool = False, is_from_zero: bool = False
) -> str:
    """Return the first difference between the motions of a program and those of rs274; empty if there is none.

    :param turning: whether rotary axes turn: feeds are then not those of the tip.
    :param is_from_zero: whether the program begins with a rapid to zero here, where rs274 begins.
    """
    unit = 25.4 if re.search(r"(?i)G\s*[27]0(?![\d.])", text) else 1.0
    digits = 6e-5 * unit
    lines = text.splitlines()
    free = _MACHINE if _RETRACT.search(text) else _MACHINE_OR_CYCLE
    machine, somewhere = bool(_MACHINE.search(text)), bool(free.search(text))
    levels_differ = free is _MACHINE_OR_CYCLE and _CYCLE.search(text) is not None
    ours, theirs = [*_ours(program, unit)], [*_theirs(moves, digits)]
    if _begins_at_start(program) and theirs:
        theirs[0] = theirs[0]._replace(rapids=[place for place in theirs[0].rapids if place.any()])
    while len(theirs) > len(ours) and (theirs[0].end[:2] == 0.0).all() and not theirs[0].rapids:
        del theirs[0]  # hobby posts go up by G1 first: from zero there, on the way to the first place here
    if is_from_zero and ours and theirs:
        for side in (ours, theirs):
            side[0] = side[0]._replace(rapids=[place for place in side[0].rapids if place.any()])
    times = (1.0, 25.4, 1.0 / 25.4) if _UNITS_WITH_F.search(text) else (1.0,)
    _drop_unseen(ours, theirs, 8.0 * digits)
    for n, (mine, other) in enumerate(zip(ours, theirs, strict=False)):
        where = f"cut {n + 1} (line {mine.line})"
        apart = np.abs(mine.end - other.end)
        retracted = machine and mine.end[2] == CLEARANCE_MM  # there at the height of the machine position
        count = 2 if retracted else 3
        if apart[:count].max() > digits:
            return f"{where}: end {mine.end} instead of {other.end}"
        if not turning and all(abs(mine.feed * factor - other.feed) > 1e-4 * other.feed + 1e-3 for factor in times):
            return f"{where}: feed {mine.feed:.3f} instead of {other.feed:.3f}"
        if (mine.centre is None) != (other.centre is None):
            return f"{where}: an arc on one side only"
        if mine.centre is not None and other.centre is not None:
            assert mine.normal is not None
            assert other.normal is not None
            across = np.abs(other.normal) < 0.5
            if np.abs(mine.centre - other.centre)[across].max() > 10.0 * digits:
                return f"{where}: centre {mine.centre} instead of {other.centre}"
            if mine.normal @ other.normal < 0.999:
                return f"{where}: the arc turns the other way"
        if mine.state != other.state:
            return f"{where}: switched {mine.state} instead of {other.state}"
        before = ours[n - 1].line if n else 0
        between = lines[before : mine.line] if before < mine.line else lines
        last = n == 0 or levels_differ or (somewhere and any(free.search(line) for line in between))
        a, b = (one[-1:] if last else one for one in (mine.rapids, other.rapids))
        if len(a) != len(b) or any(np.abs(p - q)[:count].max() > digits for p, q in zip(a, b, strict=True)):
            return f"{where}: rapids {[p.tolist() for p in a]} instead of {[p.tolist() for p in b]}"
    if len(ours) != len(theirs):
        return f"{len(ours)} cuts instead of {len(theirs)}"
    return ""


def _drop_unseen(ours: list[Cut], theirs: list[Cut], shortest: float) -> None:
    """Remove (in place) lines so short that only one side has them: rs274 prints four decimals.

    Where the ends differ, the fewest lines are removed after which they are the same again.
    """
    n = 1
    while n < min(len(ours), len(theirs)):
        if np.abs(ours[n].end - theirs[n].end).max() > shortest / 8.0:
            most = [_short_lines(side, n, shortest) for side in (ours, theirs)]
            found = [
                (i, j)
                for i in range(most[0] + 1)
                for j in range(most[1] + 1)
                if max(n + i - len(ours), n + j - len(theirs)) < 0
                and np.abs(ours[n + i].end - theirs[n + j].end).max() <= shortest / 8.0
            ]
            if not found:
                return
            i, j = min(found, key=sum)
            del ours[n : n + i], theirs[n : n + j]
        n += 1


_MOST_SHORT = 8


def _short_lines(side: Sequence[Cut], n: int, shortest: float) -> int:
    """Return how many lines from `n` on are short and follow each other without rapids."""
    count = 0
    for before, cut in zip(side[n - 1 :], side[n : n + _MOST_SHORT], strict=False):
        if cut.centre is not None or cut.rapids or np.abs(cut.end - before.end).max() >= shortest:
            break
        count += 1
    return count


def _begins_at_start(program: Program) -> bool:
    return any(issue.kind == "from-start" for issue in program.issues)


def _ours(program: Program, unit: float) -> Iterator[Cut]:
    m = program.motions
    end, kind, rapid, lines = m.target[:, :3, 3] * 1e3, m.kind, m.rapid, m.line
    if _begins_at_start(program):  # rs274 begins at zero
        end = np.where(np.logical_and.accumulate(np.abs(end - START_MM) < 1e-6), 0.0, end)
    rapids: list[Array] = []
    printed = np.round(end / unit, 4)  # shorter moves are not seen in what rs274 prints
    for n, state in enumerate(_states(program)):
        arc = kind[n] == CIRC
        before = printed[n - 1] if n else np.where(rapid[:1], np.inf, np.zeros(3))  # rs274 begins at zero
        if not arc and (printed[n] == before).all():
            continue
        if rapid[n]:
            rapids.append(end[n])
            continue
        centre, normal = (m.centre[n] * 1e3, m.normal[n]) if arc else (None, None)
        yield Cut(end[n], centre, normal, float(m.feed[n]) * 60e3, rapids, state, int(lines[n]))
        rapids = []


def _theirs(moves: list[Move], digits: float) -> Iterator[Cut]:
    rapids: list[Array] = []
    last, moved = np.zeros(3), False
    for move in moves:
        end = _placed(move, move.end)
        if move.command == "STRAIGHT_TRAVERSE":
            if not moved or np.abs(end - last).max() > digits / 2.0:
                rapids.append(end)
        elif move.centre is not None:
            axis = {"XY": 2, "XZ": 1, "YZ": 0}[move.plane]
            normal = move.frame[:3, axis] * np.sign(move.rotation)
            yield Cut(end, _placed(move, move.centre), normal, move.feed, rapids, move.state)
            rapids = []
        elif np.abs(end - last).max() > digits / 2.0:
            yield Cut(end, None, None, move.feed, rapids, move.state)
            rapids = []
        last, moved = end, True


def _placed(move: Move, point: Array) -> Array:
    return np.asarray(move.frame[:3, :3] @ point + move.frame[:3, 3])


def programs(folders: Sequence[str]) -> list[Path]:
    """Return the programs below folders."""
    found = [path for folder in folders for path in [Path(folder), *Path(folder).rglob("*")]]
    names = {*NAMES, *APT_NAMES, *RAPID_NAMES}
    return sorted(path for path in found if path.is_file() and path.suffix.lower() in names)


def outcome_of(path: Path) -> tuple[str, Outcome]:
    """Return what came of a program of any format: in a bare cell (a word), and in that of a shop."""
    suffix = path.suffix.lower()
    if suffix in RAPID_NAMES and MODULE.search(path.read_bytes().decode("latin-1")):
        return "RAPID", Outcome(*tried_rapid(path))
    if suffix in APT_NAMES:
        return "APT", Outcome(*tried_apt(path, SHOP))
    return tried(path)


def main() -> None:
    """Try all programs and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", metavar="FOLDER")
    parser.add_argument("--list", action="store_true", help="print what came of each program")
    options = parser.parse_args()
    count: Counter[str] = Counter()
    reasons: Counter[str] = Counter()
    wrong = 0

    def too_long(*_: object) -> None:
        raise TimeoutError

    signal.signal(signal.SIGALRM, too_long)
    for path in programs(options.folders):
        signal.alarm(SECONDS)
        try:
            bare, outcome = outcome_of(path)
        except TimeoutError:
            bare, outcome = "", Outcome(f"not done in {SECONDS} s")
        except Exception as error:
            bare, outcome = "", Outcome("FAULT", repr(error))
        signal.alarm(0)
        is_gcode = bare not in ("APT", "RAPID")
        if is_gcode:
            count[f"bare cell: {bare}"] += 1
        count[f"{'shop cell' if is_gcode else bare}: {outcome.word}"] += 1
        wrong += outcome.word in ("differs", "FAULT")
        if outcome.word.startswith("refused"):
            reasons[f"{outcome.reason} ({outcome.word[8:]})"] += 1
        if options.list or outcome.word in ("differs", "FAULT"):
            print(f"{path}: {outcome.word}{': ' * bool(outcome.reason)}{outcome.reason}", flush=True)
    for table in (count, reasons):
        print()
        for what, number in table.most_common():
            print(f"{number:6d} {what}")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
