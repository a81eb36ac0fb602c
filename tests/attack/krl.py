"""Random KRL against a controller that executes it: what is accepted, and what is written, must be what it does.

    python -m tests.attack.krl --minutes 60 [--seed 0]

A program is read by the package; if it is accepted, the controller runs it several times, with other chance each time.
All runs must make the motions that the package read: targets, `$BASE`, `$TOOL`, speeds, approximation. Then its targets
are moved and divided, and the program that the package writes runs too: its targets must be those that were wanted.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc.cell import Frame, Krl, Tool
from postproc.dialects import krl
from postproc.dialects.krl.course import Fork
from postproc.dialects.krl.read import flow
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from postproc.frames import pose_from_xyzabc, xyzabc_from_pose
from postproc.program import CIRC, LIN, PTP
from tests.attack.krl_generator import Generator
from tests.attack.krl_interpreter import Controller, Invalid
from tests.dialects.krl_programs import CELL, forward, targets
from tests.oracle.arm import abc
from tests.oracle.krl_grammar import check, takes

flow._MOST_TRACED = flow._MOST_STATEMENTS = 10_000
KINDS = {"LIN": LIN, "PTP": PTP, "CIRC": CIRC}
FRAMES = {1: (900, 50, 600, 0, 0, 10), 2: (1000, 0, 500, 5, 0, 0), 3: (1200, 100, 650, 30, 0, 0)}
TOOLS = {1: (0, 0, 200, 0, 0, 0), 2: (20, 0, 280, 0, 90, 0)}
RUNS, MOST_RUNS = 3, 30
MORE, MIXED, KEPT = 1_000_000, 100_000_000, 200_000_000
"""From these seeds on programs have more kinds of values; nested loops, splines, SYNCCMD; and motions that stay."""
_CHECKED = 4, 16
"""Of so many programs below `MORE`, and of others, one is checked by the grammar, which takes as long as all else."""
_WRITTEN = 2e-4
"""Half of the last digits that are printed, in mm and in degrees, several times over."""


class Wrong(AssertionError):
    """The package and the controller do not agree."""


def cell(folder, *, keep=False):
    """The cell of `krl_programs` with some more frames."""
    return replace(
        CELL,
        krl=Krl(search=["lib"], initmov="cell", keep_unresolved=keep),
        base_data={str(n): Frame(*values) for n, values in FRAMES.items()},
        tool_data={str(n): Tool(*values) for n, values in TOOLS.items()},
        folder=str(folder),
    )


def executed(files, seed, program):
    """The motions that the controller makes in the program and in what it calls, but for those left as they are."""
    named = {Path(name).name: text for name, text in files.items()}
    data = {
        "BASE_DATA": {n: dict(zip("XYZABC", map(float, v), strict=True)) for n, v in {**FRAMES, 0: (0,) * 6}.items()},
        "TOOL_DATA": {n: dict(zip("XYZABC", map(float, v), strict=True)) for n, v in {**TOOLS, 0: (0,) * 6}.items()},
    }
    base, tool = CELL.base, CELL.tool
    controller = Controller(
        named, np.random.default_rng(seed), abc(base.X, base.Y, base.Z), abc(tool.X, tool.Y, tool.Z), data
    )
    controller.numbers = None
    followed = [(r.source.document.name, r.first, r.last) for r in program.layout.course.inlined]
    motions = controller.run("PART")
    left = {("part.src", issue.source_line) for issue in program.issues if issue.kind == "motions-elsewhere"}
    stay = {(one.file, one.line) for one in program.unresolved}

    def is_followed(file, line):
        return file == "part.src" or any(f == file and a < line < b for f, a, b in followed)

    made = []
    for motion in motions:
        places = (*motion.callers, (motion.file, motion.line))
        if left.isdisjoint(motion.callers) and stay.isdisjoint(places) and all(is_followed(*each) for each in places):
            if 0 < motion.synchronised < controller.synchronised:
                raise Wrong(f"the motion in line {motion.line} is between two SYNCCMD")
            made.append(motion)
    return made


def compare(program, motions, numbers, joints, kinds, tolerance, lines=None):
    """Raise `Wrong` unless motions of the controller are those of the package."""
    if len(motions) != len(kinds):
        raise Wrong(f"{len(kinds)} motions are read, {len(motions)} are executed")
    m = program.motions
    for row, motion in enumerate(motions):
        where = f"motion {row} in line {motion.line}"
        if KINDS[motion.kind] != kinds[row] or (
            lines is not None and motion.file == "part.src" and lines[row] != motion.line
        ):
            raise Wrong(f"{where}: another motion is read")
        if motion.joints is not None:
            if not np.allclose(np.degrees(joints[row]), motion.joints):
                raise Wrong(f"{where}: other joints are read")
            continue
        here, there = pose_from_xyzabc(numbers[row]), abc(*motion.numbers)
        if not np.allclose(here[:3, 3], there[:3, 3], atol=tolerance / 1000) or not np.allclose(
            here[:3, :3], there[:3, :3], atol=tolerance
        ):
            raise Wrong(f"{where}: {numbers[row].round(4).tolist()} is read, {np.round(motion.numbers, 4)} executed")
        if lines is not None:
            same = np.allclose(program.bases[m.base[row]], motion.base, atol=1e-9)
            if not same or not np.allclose(program.tools[m.tool[row]], motion.tool, atol=1e-9):
                raise Wrong(f"{where}: another $BASE or $TOOL is read")
            if motion.kind != "PTP" and not np.isclose(m.feed[row], motion.speed, rtol=1e-9):
                raise Wrong(f"{where}: the speed {m.feed[row]} is read, {motion.speed} executed")
            if motion.cdis is not None and not np.isclose(m.blend[row] * 1000, motion.cdis):
                raise Wrong(f"{where}: the approximation {m.blend[row] * 1000} is read, {motion.cdis} executed")


def moved(program, rng):
    """Targets somewhat elsewhere, some motions divided, some left as they are."""
    m = program.motions
    count = len(m)
    shift = rng.uniform(-2e-3, 2e-3, (count, 3)) * (rng.random(count) < 0.8)[:, None]
    pieces = {row: rng.uniform(0.1, 0.9, 1).round(3) for row in np.flatnonzero(rng.random(count) < 0.25)}
    pieces = {row: t for row, t in pieces.items() if m.kind[row] != PTP}
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


def attempt(seed, folder):
    """One program: ``"refused"``, ``"invalid"`` (the controller stops), or ``"accepted"``.

    :raises Wrong: the package is wrong.
    """
    rng = np.random.default_rng(seed)
    keep = seed >= KEPT
    files = Generator(rng, more=seed >= MORE, mixed=seed >= MIXED, keep=keep).programs()
    try:
        program = read(files, folder, keep=keep)
    except PostprocError:
        return "refused"
    return confirmed(program, files, folder, rng, keep=keep, checked=seed % _CHECKED[seed >= MORE] == 0)


def read(files, folder, *, keep=False):
    """The program of a folder with some files, as the package reads it."""
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(text.encode())
    documents = [replace(decode(n, files[n].encode()), folder=str(folder)) for n in ("part.src", "part.dat")]
    return krl.read_program(documents, cell(folder, keep=keep), forward, "part")


def confirmed(program, files, folder, rng, *, keep=False, checked=True):
    """``"accepted"`` if a program is what the controller does, before and after its targets were moved; ``"invalid"``.

    :param keep: some motions stay as they are.
    :param checked: the grammar reads what is written.
    :raises Wrong: it is not.
    """
    m = program.motions
    if any(isinstance(step, Fork) for step in program.layout.course.steps):
        return "branches"  # not one list of motions: what they are is tested with programs made for it
    if {(one.file, one.line) for one in program.unresolved} & set(places_of(program)):
        return "in some rounds"  # likewise
    runs = 0
    for chance in range(RUNS):
        try:
            done = executed(files, chance, program)
        except Invalid:
            continue
        runs += 1
        compare(program, done, program.numbers_as_written(), m.joints, m.kind, 1e-6, m.line)
    if not runs:
        return "invalid"
    if not np.isnan(m.joints[:, 0]).any():
        return "accepted"  # by joint angles alone
    same = krl.rewrite(program, targets(program, keep=True))
    if same.documents != program.documents:
        raise Wrong("what needs no correction is changed")
    wanted = moved(program, rng)
    try:
        written = krl.rewrite(program, wanted)
    except PostprocError:
        return "accepted"
    if any(issue.level == "error" for issue in written.issues):
        return "accepted"
    if checked and all(takes(document.name, document.text) for document in program.documents):
        for document in written.documents:
            check(document.name, document.text)
    new = {Path(name).name: text for name, text in files.items()}
    new |= {document.name: document.text for document in written.documents}
    again = krl.read_program(written.documents, cell(folder, keep=keep), forward, "part")
    if {one.text for one in again.unresolved} != {one.text for one in program.unresolved}:  # in copies too
        raise Wrong("other motions stay as they are in what is written")
    pose, joints, kinds = in_order(program, wanted)
    finished = 0
    for chance in range(RUNS if runs < RUNS else MOST_RUNS):  # what chance gives an index may stop a program too
        try:
            done = executed(new, chance, again)
        except Invalid:
            continue
        finished += 1
        compare(program, done, xyzabc_from_pose(pose), joints, kinds, _WRITTEN)
        if finished == RUNS:
            break
    if runs == RUNS and not finished:
        raise Wrong("what is written stops")
    return "kept" if program.unresolved else "accepted"


def places_of(program):
    """File and line of each motion."""
    found = program.places(np.arange(len(program.motions)))
    return [found.of(row) for row in range(len(program.motions))]


def attack(seed):
    """Try the program of a seed; what goes wrong is told with its files."""
    with tempfile.TemporaryDirectory() as name:
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


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep-going", action="store_true")
    arguments = parser.parse_args()
    end, seed, outcomes = time.monotonic() + 60.0 * arguments.minutes, arguments.seed, Counter()
    while time.monotonic() < end and (arguments.keep_going or not outcomes["wrong"]):
        try:
            outcomes[attack(seed)] += 1
        except Wrong as cause:
            outcomes["wrong"] += 1
            print(cause)
        except KeyboardInterrupt:
            break
        seed += 1
    print(f"{sum(outcomes.values())} programs: {dict(outcomes)}; next seed {seed}")
    return outcomes["wrong"] > 0


if __name__ == "__main__":
    raise SystemExit(main())
