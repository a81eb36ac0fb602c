"""Random KRL against a controller that executes it: what is accepted, and what is written, must be what it does.

    python -m tests.attack.krl --minutes 60 [--seed 100000000] [--programs 110000] [--in-turn] [--keep-going]

Seeds below 2·10⁸ are ordinary programs; after ten of them comes one with `--keep-unresolved`, of the seed 2·10⁸ higher.
From 2·10⁸ on all are programs with `--keep-unresolved`. Counts are printed for each of the two. With `--in-turn` all
kinds of programs follow each other, seven of 31 of them with `--keep-unresolved`.

A program is read by the package; if it is accepted, the controller runs it several times, with other chance each time.
All runs must make the motions that the package read: targets, `$BASE`, `$TOOL`, speeds, approximation. Then its targets
are moved and divided, and the program that the package writes runs too: its targets must be those that were wanted.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections import defaultdict
from pathlib import Path
from unittest.mock import patch

import numpy as np
from msgspec.structs import replace

from postproc.cell import Frame, Krl, Tool
from postproc.dialects import krl
from postproc.dialects.krl.dialect import KRL
from postproc.dialects.krl.execution import Fork, RoutineEntry
from postproc.dialects.krl.read import flow
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from postproc.frames import pose_from_xyzabc, xyzabc_from_pose
from postproc.program import CIRC, LIN, PTP, SPL
from tests.attack.driver import Wrong, parser, try_seeds
from tests.attack.krl_deck import Deck
from tests.attack.krl_generator import Generator
from tests.attack.krl_interpreter import MOST_STEPS, Controller, Invalid, PositionUnknown, Unsaid, shown
from tests.attack.krl_snippets import GIVEN, Snippets
from tests.attack.krl_states import States
from tests.dialects.krl_programs import CELL, forward, targets
from tests.oracle.arm import abc
from tests.oracle.krl_grammar import check, takes

flow.MOST_TRACED = flow.MOST_STATEMENTS = 10_000
KINDS = {"LIN": LIN, "PTP": PTP, "CIRC": CIRC, "SPL": SPL}
FRAMES = {1: (900, 50, 600, 0, 0, 10), 2: (1000, 0, 500, 5, 0, 0), 3: (1200, 100, 650, 30, 0, 0)}
TOOLS = {1: (0, 0, 200, 0, 0, 0), 2: (20, 0, 280, 0, 90, 0)}
RUNS, MOST_RUNS, OFTEN = 3, 30, 200
MORE, MIXED, KEPT = 1_000_000, 100_000_000, 200_000_000
"""From these seeds on programs have more kinds of values; nested loops, splines, SYNCCMD; and motions that stay."""
HARDER = 50_000_000
"""From so much behind `MIXED`, and behind its multiples, programs have functions in targets and bounds, GOTO … too."""
STATES = 25_000_000
"""Of each two pieces of so many seeds behind `MIXED`, in the second programs read what they set, and some of what is
written is divided into files."""
SNIPPETS = STATES // 2
"""In the second half of such a piece programs hold few statements, and at most one value that is not known."""
DECK = STATES * 3 // 4
"""In its last quarter they hold pieces that are dealt in turn."""
FIRST_SEEDS = (
    *(0, 143_750_000, 137_500_000, 1_000_000, 143_750_000, 187_500_000, 100_000_000, 343_750_000, 337_500_000),
    *(143_750_000, 125_000_000, 143_750_000, 137_600_000, 150_000_000, 193_750_000, 387_500_000, 143_750_000),
    *(175_000_000, 187_600_000, 143_750_000, 325_000_000, 143_750_000, 137_700_000, 375_000_000),
    *(143_750_000, 343_750_000, 143_750_000, 143_750_000, 343_750_000, 143_750_000, 143_750_000),
)
"""First seeds of the kinds of programs: four of five are of few statements, and of these two of three are dealt."""
_CHECKED = 4, 16
"""Of so many programs below `MORE`, and of others, one is checked by the grammar, which takes as long as all else."""
SHIFTED = "the correction of the motion before it moves it too"
"""What is said of motions that stay as they are and begin at a corrected pose."""
FROM_HERE = "They begin from the robot position"
"""The same of calls that are not followed."""
ELSEWHERE = "calls that are not followed"
"""Key of the motions in such calls among the `whereabouts`."""
_NAME = r"[A-Z]\w*(?:\[[^]]*\])?"
_NAMED = re.compile(rf"S?(?:(?:LIN|PTP) {_NAME}|CIRC {_NAME}\s*,\s*{_NAME})(?: C_\w+)?$", re.IGNORECASE)
"""Motions to named points."""
_WRITTEN = 2e-4
"""Half of the last digits that are printed, in mm and in degrees, several times over."""


_ASKED, _SAME_TOOL = "asked", "same tool"
"""The cell does not say what BAS(#INITMOV,0) gives; and its [tool] is that of TOOL_DATA[1] besides."""
_INITMOV = ("cell", "cell", "bas", "cell", "cell", _SAME_TOOL, _ASKED, "cell", "cell")
_FEWEST_ROUNDS = 3
_MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""A folder in memory: to make and remove one on a disk takes a tenth of the time of a program."""


def cell(folder, *, keep=False, initmov="cell"):
    """The cell of `krl_programs` with some more frames."""
    return replace(
        CELL,
        krl=Krl(search=["lib"], initmov=stated(initmov), keep_unresolved=keep, values=GIVEN),
        base_data={str(n): Frame(*values) for n, values in FRAMES.items()},
        tool_data={str(n): Tool(*values) for n, values in tools(initmov).items()},
        folder=str(folder),
    )


def stated(initmov):
    """What the cell states as `[krl] initmov`."""
    return None if initmov in (_ASKED, _SAME_TOOL) else initmov


def tools(initmov):
    """The numbered tools of the cell and of the controller."""
    return {**TOOLS, 1: (0, 0, CELL.tool.Z, 0, 0, 0)} if initmov == _SAME_TOOL else TOOLS


def executed(files, seed, program, main="PART", initmov="cell"):
    """The motions that the controller makes in the program and in what it calls, but for those left as they are.

    :param main: the program to run: of one that was divided into files, none of whose motions is left, another one.
    :returns: motions, the `whereabouts` of those left as they are, and whether chance had a part in them.
    """
    named = {Path(name).name: text for name, text in files.items()}
    data = {
        "BASE_DATA": {n: dict(zip("XYZABC", map(float, v), strict=True)) for n, v in {**FRAMES, 0: (0,) * 6}.items()},
        "TOOL_DATA": {
            n: dict(zip("XYZABC", map(float, v), strict=True)) for n, v in {**tools(initmov), 0: (0,) * 6}.items()
        },
        **dict.fromkeys(("FDAT_ACT", "LDAT_ACT", "PDAT_ACT")),
        "$H_POS": {f"A{number}": angle for number, angle in enumerate(CELL.start.joints, 1)},
    }
    base, tool = CELL.base, CELL.tool
    rng = np.random.default_rng(seed)
    before = rng.bit_generator.state
    frames = abc(base.X, base.Y, base.Z), abc(tool.X, tool.Y, tool.Z)
    controller = Controller(named, rng, *frames, data, given=GIVEN, side=seed % 2, initmov=stated(initmov))
    motions = controller.run(main)
    execution = program.layout.execution
    origins = [
        (execution.trace.place(each.row), each.routine) for each in execution.steps if isinstance(each, RoutineEntry)
    ]
    followed = {(at.source.document.name, at.line, routine.name.upper()) for at, routine in origins}
    reported = {("part.src", issue.source_line) for issue in program.issues if issue.kind == "motions-elsewhere"}
    stay = {(one.file, one.line) for one in program.unresolved}
    first, second = ([shown(one) for one in motions if not stays(one, stay)] for motions in controller.rounds)
    if first != second and program.layout.execution.endless_loop:
        raise Wrong("the rounds of a LOOP without EXIT differ")
    made, elsewhere, begins_uncorrected = [], set(), False
    for motion in motions:
        motion.begins_uncorrected, begins_uncorrected = begins_uncorrected, True
        if main != "PART":
            made.append(motion)
            continue
        if stays(motion, stay):
            continue
        calls = {(file, line) for file, line, _ in motion.callers}
        if not followed.issuperset(motion.callers):
            if reported.isdisjoint(calls):
                raise Wrong(f"the motion in line {motion.line} of {motion.file} is neither followed nor reported")
            elsewhere.add(repr(shown(motion)))
            continue
        if 0 < motion.synchronised < controller.synchronised:
            raise Wrong(f"the motion in line {motion.line} is between two SYNCCMD")
        if motion.mode == "#TCP" and motion.joints is None:
            raise Wrong(f"the robot holds the part in line {motion.line}")
        begins_uncorrected = False
        made.append(motion)
    if controller.rounds[0] and not first:
        raise Invalid("a LOOP that stays as it is never ends")
    shifted = {one.subject for one in program.issues if one.kind == "unresolved" and SHIFTED in one.message}
    own_file = program.documents[0].name
    unresolved = [one for one in program.unresolved if f"line {one.line}" not in shifted or one.file != own_file]
    kept = whereabouts([one for one in motions if stays(one, stay)], unresolved)
    if not any(one.kind == "motions-elsewhere" and FROM_HERE in one.message for one in program.issues):
        kept[ELSEWHERE] = elsewhere
    return made, kept, Unsaid.asked or rng.bit_generator.state != before


def stays(motion, places):
    """Whether a motion, or a call that leads to it, is at one of some places."""
    return not places.isdisjoint({(motion.file, motion.line), *((file, line) for file, line, _ in motion.callers)})


def whereabouts(motions, unresolved):
    """What motions to named points do that are left as they are, by their text."""
    texts = {(one.file, one.line): one.text for one in unresolved if _NAMED.match(one.text)}
    found = defaultdict(set)
    for motion in motions:
        if (motion.file, motion.line) in texts:
            found[texts[motion.file, motion.line]].add(repr(shown(motion)))
    return found


def compare(program, motions, numbers, joints, kinds, tolerance, lines=None):
    """Raise `Wrong` unless motions of the controller are those of the package.

    Of branches that are chosen at run time the package has all: there, the controller makes some of the motions, in
    their order.
    """
    divided = branching(program)
    if len(motions) != len(kinds) and not divided:
        raise Wrong(f"{len(kinds)} motions are read, {len(motions)} are executed")
    row = 0
    for motion in motions:
        wrong = ""
        while row < len(kinds):
            problem = difference(program, row, motion, numbers, joints, kinds, tolerance, lines)
            row += 1
            wrong = wrong or problem
            if not problem or not divided:
                break
        else:
            problem = wrong or "no motion"
        if problem:
            raise Wrong(f"motion {row - 1} in line {motion.line}: {wrong or problem} is read")
        if lines is None or divided or not motion.begins_uncorrected:
            continue
        if program.after is None or program.after[row - 1] != row - 1:
            raise Wrong(f"motion {row - 1} in line {motion.line} begins behind one that stays as it is")


def branching(program):
    """Whether a program has branches that are chosen at run time."""
    return any(isinstance(step, Fork) for step in program.layout.execution.steps)


def difference(program, row, motion, numbers, joints, kinds, tolerance, lines):
    """What of a motion of the controller is otherwise in the package; empty if nothing."""
    m = program.motions
    if KINDS[motion.kind] != kinds[row] or (
        lines is not None and motion.file == "part.src" and lines[row] != motion.line
    ):
        return "another motion"
    if motion.joints is not None:
        return "" if np.allclose(np.degrees(joints[row]), motion.joints) else "another target in joints"
    here, there = numbers[row].tolist(), motion.numbers
    if not all(abs(value - other) <= 0.5 * tolerance for value, other in zip(here, there, strict=True)):
        here, there = pose_from_xyzabc(numbers[row]), abc(*motion.numbers)
        deviation = np.abs(here - there)
        if not (deviation[:3, 3].max() <= tolerance / 1000 and deviation[:3, :3].max() <= tolerance):
            return f"{numbers[row].round(4).tolist()}, not {np.round(motion.numbers, 4)},"
    if lines is None:
        return ""
    same_base = np.abs(program.bases[m.base[row]] - motion.base).max() < 1e-8
    if not same_base or not np.abs(program.tools[m.tool[row]] - motion.tool).max() < 1e-8:
        return "another $BASE or $TOOL"
    if motion.kind != "PTP" and not math.isclose(m.feed[row], motion.speed, rel_tol=1e-8):
        return f"the speed {m.feed[row]}, not {motion.speed},"
    if motion.cdis is not None and not math.isclose(m.blend[row] * 1000, motion.cdis, rel_tol=1e-5, abs_tol=1e-8):
        return f"the approximation {m.blend[row] * 1000}, not {motion.cdis},"
    return ""


def moved(program, rng):
    """Targets somewhat elsewhere, some motions divided, some left as they are."""
    m = program.motions
    count = len(m)
    shift = rng.uniform(-2e-3, 2e-3, (count, 3)) * (rng.random(count) < 0.8)[:, None]
    pieces = {row: rng.uniform(0.1, 0.9, 1).round(3) for row in np.flatnonzero(rng.random(count) < 0.25)}
    pieces = {row: t for row, t in pieces.items() if m.kind[row] not in (PTP, SPL)}
    if branching(program):
        shift[:] = shift[0]  # branches meet
    wanted = targets(program, shift, pieces=pieces)
    keep = (np.abs(shift).sum(axis=1) == 0)[wanted.motion] & (wanted.t == 1.0) & (m.kind[wanted.motion] != CIRC)
    return replace(wanted, keep=keep)


def in_order(program, wanted):
    """Numbers, joints and kinds of all that the written program does: targets, and axis targets between them."""
    m = program.motions
    axis = np.flatnonzero(~np.isnan(m.joints[:, 0]))
    motion = np.concatenate([wanted.motion, axis])
    order = np.lexsort((np.concatenate([wanted.t, np.ones(len(axis))]), motion))
    pose = np.concatenate([wanted.pose, m.target[axis]])[order]
    kinds = np.concatenate([wanted.kind, m.kind[axis]])[order]
    return pose, m.joints[motion[order]], kinds


def files_of(seed, rng):
    """The random program of a seed: name → text."""
    keep, harder = seed >= KEPT, seed >= MIXED and seed % MIXED >= HARDER
    states = reads_states(seed)
    if states and seed % STATES >= DECK:
        return Deck(rng, seed % STATES - DECK, keep=keep).programs()
    if states and seed % STATES >= SNIPPETS:
        return Snippets(rng, keep=keep).programs()
    kind = States if states else Generator
    return kind(rng, more=seed >= MORE, mixed=seed >= MIXED, keep=keep, harder=harder).programs()


def reads_states(seed):
    """Whether the program of a seed reads what it sets, see `STATES`."""
    return seed >= MIXED and seed // STATES % 2 == 1


def initmov_of(seed):
    """Return what `[krl] initmov` of the cell is for a seed: programs of dealt pieces use all three."""
    number = seed % STATES - DECK
    return _INITMOV[number // 4 % len(_INITMOV)] if reads_states(seed) and number >= 0 else "cell"


def attempt(seed, folder):
    """One program: ``"refused"``, ``"invalid"`` (the controller stops), or ``"accepted"``.

    :raises Wrong: the package is wrong.
    """
    rng, keep = np.random.default_rng(seed), seed >= KEPT
    files = files_of(seed, rng)
    try:
        program = read_job(files, folder, keep=keep, initmov=initmov_of(seed))
    except PostprocError:
        return "refused"
    lines = int(rng.integers(8, 60)) if reads_states(seed) and rng.random() < 0.4 else 0
    checked = seed % _CHECKED[seed >= MORE] == 0
    return confirmed(program, files, folder, rng, keep=keep, checked=checked, lines=lines, initmov=initmov_of(seed))


def read_job(files, folder, *, keep=False, initmov="cell"):
    """The program of a folder with some files, as the package reads it."""
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(text.encode())
    documents = [replace(decode(n, files[n].encode()), folder=str(folder)) for n in ("part.src", "part.dat")]
    return krl.read_program(documents, cell(folder, keep=keep, initmov=initmov), forward, "part")


def confirmed(program, files, folder, rng, *, keep=False, checked=True, lines=0, initmov="cell"):
    """``"accepted"`` if a program is what the controller does, before and after its targets were moved; ``"invalid"``.

    :param keep: some motions stay as they are.
    :param checked: the grammar reads what is written.
    :param lines: what is written is divided into files of so many lines; 0: it is not.
    :raises Wrong: it is not.
    """
    m = program.motions
    if {(one.file, one.line) for one in program.unresolved} & set(places_of(program)):
        return "in some rounds"  # likewise
    runs, numbers, kept = 0, program.numbers_as_written(), defaultdict(set)
    for seed in range(RUNS):
        try:
            done, left, by_chance = executed(files, seed, program, initmov=initmov)
        except Invalid:
            continue
        for text in left:
            kept[text] |= left[text]
        compare(program, done, numbers, m.joints, m.kind, 1e-6, m.line)
        if stated(initmov) is None:
            check_assumed_frames(program, files, seed, done, initmov)
        runs += 1
        if not by_chance:
            runs = RUNS
            break
    if not runs:
        return "invalid"
    if not np.isnan(m.joints[:, 0]).any():
        return "accepted"  # by joint angles alone
    lines, used_cell = 0 if branching(program) else lines, cell(folder, keep=keep, initmov=initmov)
    same = krl.rewrite(program, targets(program, keep=True))
    if same.documents != program.documents:
        raise Wrong("what needs no correction is changed")
    wanted = moved(program, rng)
    try:
        lines = 0 if program.unresolved or any(one.kind == "motions-elsewhere" for one in program.issues) else lines
        written = krl.rewrite(program, wanted) if not lines else divided(program, wanted, lines, used_cell)
    except PostprocError:
        return "accepted"
    if any(issue.level == "error" for issue in written.issues):
        return "accepted"
    if (
        checked
        and not all(takes(document.name, document.text) for document in written.documents)
        and all(takes(document.name, document.text) for document in program.documents)
    ):
        for document in written.documents:
            check(document.name, document.text)
    new = {Path(name).name: text for name, text in files.items()}
    if lines:
        del new["part.src"]  # the files take its place: it would define GLOBAL routines once more
    new |= {document.name: document.text for document in written.documents}
    again = KRL.read(written.documents, used_cell, forward, Path(written.documents[0].name).stem)
    main = Path(written.documents[0].name).stem.upper()
    if {one.text for one in again.unresolved} != {one.text for one in program.unresolved}:  # in copies too
        raise Wrong("other motions stay as they are in what is written")
    pose, joints, kinds = in_order(program, wanted)
    finished = 0
    numbers = xyzabc_from_pose(pose)
    for seed in range(RUNS if runs < RUNS else MOST_RUNS):  # what chance gives an index may stop a program too
        try:
            done, left, by_chance = executed(new, seed, again, main, initmov)
        except Invalid:
            continue
        if not left[ELSEWHERE] <= kept[ELSEWHERE] and not left[ELSEWHERE] <= often(program, files, initmov)[ELSEWHERE]:
            raise Wrong("motions of calls that are not followed are elsewhere in what is written")
        for text, only in kept.items():
            if text == ELSEWHERE or len(only) > 1 or left[text] <= only:
                continue
            if len(often(program, files, initmov).get(text, ())) == 1:  # not by chance
                raise Wrong(f"{text} stays as it is, and moves elsewhere in what is written: {left[text]}, not {only}")
        finished += 1
        compare(program, done, numbers, joints, kinds, _WRITTEN)
        if finished == RUNS or not by_chance:
            break
    if runs == RUNS and not finished:
        raise Wrong("what is written stops")
    return "kept" if program.unresolved else "branches" if branching(program) else "accepted"


def check_assumed_frames(program, files, seed, motions, initmov):
    """Raise `Wrong` unless a frame that BAS(#INITMOV,0) gives is asked for where the cell's is another one.

    :param motions: that the controller has made with one of the two.
    """
    asked = {issue.subject for issue in program.issues if issue.kind == "initial-frames" and issue.count}
    if initmov == _SAME_TOOL and "$TOOL" in asked:
        raise Wrong("$TOOL is asked for, though the cell has that of the controller")
    for name in ("cell", "bas"):
        try:
            others = executed(files, seed, program, initmov=name)[0] if initmov == _ASKED else motions
        except Invalid:
            continue
        for one, other in zip(motions, others, strict=False):
            if one.joints is None and not np.allclose(one.base, other.base) and "$BASE" not in asked:
                raise Wrong(f"$BASE of line {one.line} is what BAS(#INITMOV,0) gives, and not asked for")
            if one.joints is None and not np.allclose(one.tool, other.tool) and "$TOOL" not in asked:
                raise Wrong(f"$TOOL of line {one.line} is what BAS(#INITMOV,0) gives, and not asked for")


def often(program, files, initmov):
    """`whereabouts` of the motions that are left as they are, in many runs: some of what chance does is rare.

    Only those of calls that are not followed, if a run ends behind joint angles: what it does there is not known.
    """
    kept, all_known = defaultdict(set), True
    for seed in range(OFTEN):
        try:
            kept_in_run = executed(files, seed, program, initmov=initmov)[1]
        except PositionUnknown:
            all_known = False
        except Invalid:
            continue
        else:
            for text, places in kept_in_run.items():
                kept[text] |= places
    return kept if all_known else defaultdict(set, {ELSEWHERE: kept[ELSEWHERE]})


def divided(program, wanted, lines, whole):
    """What is written, in files of some lines.

    :param whole: the cell, without a limit.
    """
    limited = replace(whole, output=replace(whole.output, lines_per_file=lines))
    return KRL.writer.write(program, wanted, None, limited, None)


def places_of(program):
    """File and line of each motion."""
    found = program.places(np.arange(len(program.motions)))
    return [found.of(row) for row in range(len(program.motions))]


def limited():
    """Context in which programs are short, and rounds are computed at once if there are but some."""
    return patch.multiple(flow, MOST_TRACED=MOST_STEPS, MOST_STATEMENTS=MOST_STEPS, FEWEST_ROUNDS=_FEWEST_ROUNDS)


def attack(seed):
    """Try the program of a seed; what goes wrong is told with its files."""
    with limited(), tempfile.TemporaryDirectory(dir=_MEMORY) as name:
        try:
            return attempt(seed, Path(name))
        except Exception as cause:
            files = "\n".join(f"--- {p.name}\n{p.read_text()}" for p in sorted(Path(name).rglob("*.*")))
            raise Wrong(f"seed {seed}: {type(cause).__name__}: {cause}\n{files}") from cause


PIECES = [
    *"(){}[],;\"':=#$.-+*/ \t\r\n\x0c",
    "1E999",
    "1e308",
    "'H",
    "\u00b2",
    "\u0661",
    "DEF ",
    "END",
    "IF ",
    "P[",
    "XP1",
]
PIECES += ["LIN ", "NaN", "9" * 400, "(" * 600, "GLOBAL ", "INTERRUPT ", "DO ", "TRIGGER ", "WITH ", "C_DIS", "A1"]
PIECES += ["E1 5", "RETURN", "FOR ", "ENDFOR", "BAS(", "#INITMOV", "DECL ", "CIRC ", ",CA 1E5", "-" * 400]


def damaged(seed):
    """Read and write a program that was damaged: it is refused with a message, or read; never another exception."""
    rng = np.random.default_rng(seed)
    files = Generator(rng).programs()
    for name in ("part.src", "part.dat"):
        text = files[name]
        for _ in range(int(rng.integers(0, 5))):
            at, way = int(rng.integers(len(text) + 1)), int(rng.integers(4))
            other = int(rng.integers(len(text) + 1))
            piece = [PIECES[int(rng.integers(len(PIECES)))], "", text[other : other + 40], ""][way]
            text = text[:at] + piece + (text[at + [0, 5, 0, len(text)][way] :])
        files[name] = text or " "
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            documents = [replace(decode(n, files[n].encode()), folder=name) for n in ("part.src", "part.dat")]
            program = krl.read_program(documents, cell(folder), forward, "part")
            krl.rewrite(program, moved(program, rng))
        except PostprocError as error:
            return f"refused: {len(str(error)) < 10_000}"
    return "read"


def seed_in_turn(number):
    """Return the seed of a program where all kinds follow in turn, each from the first of its seeds on."""
    cycle, place = divmod(number, len(FIRST_SEEDS))
    kind = FIRST_SEEDS[place]
    return kind + cycle * FIRST_SEEDS.count(kind) + FIRST_SEEDS[:place].count(kind)


def attack_in_turn(number):
    """Try the program of a number where all kinds follow in turn."""
    return attack(seed_in_turn(number))


def main():
    """Try programs, and count what came of them."""
    arguments = parser(__doc__)
    arguments.add_argument("--in-turn", action="store_true", help="all kinds of programs; --seed: number of the first")
    options = arguments.parse_args()
    return try_seeds(options, attack_in_turn if options.in_turn else attack)


if __name__ == "__main__":
    raise SystemExit(main())
