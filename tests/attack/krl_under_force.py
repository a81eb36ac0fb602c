"""Random KRL jobs corrected: whatever inputs say, the loaded tool of the written program goes where the job said.

    python -m tests.attack.krl_under_force --minutes 60 [--seed 0]

A controller executes a job and what the package writes of it, once for every sequence of inputs. Each commanded pose
is turned into joint angles and loaded with the force that the comments of the written program give, by an arm that is
not the package's; the tool must then stand on the path of the job, and at each of its targets. Besides:

- a job that depends on no input is written out as plain motions, and corrected: the same motions must be made;
- without forces it comes back byte for byte.
"""

from __future__ import annotations

import dataclasses
import re
import tempfile
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from postproc import correction
from postproc import robot as robots
from postproc.cell import Frame, Tool
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from tests.attack.driver import Wrong, parser, try_seeds
from tests.attack.krl_interpreter import Choices, Controller, Invalid, components
from tests.attack.krl_jobs import Job
from tests.kr270 import CELL
from tests.oracle.arm import Arm, abc
from tests.oracle.elastic import inverse, loaded_tip
from tests.oracle.krl_grammar import check

MOST_RUNS = 12
"""Sequences of inputs that are tried of each job."""
DIGITS = 3e-7
"""What four digits of mm and five of degrees leave of a place [m]: 0.05 µm in each coordinate, and the correction."""
TURN = 4e-7
"""What five digits of degrees leave of an orientation [rad]."""
BESIDE = 2e-6
"""How far inserted targets may stand beside the path [m]: their force is written in a comment of so many digits."""


@cache
def setup():
    """Cell, robot, and the arm of the oracle."""
    folder = robots.find(CELL.robot)
    base = {"3": Frame(X=1500.0, Y=-200.0, Z=700.0), "4": Frame(X=1510.0, Y=-190.0, Z=705.0, A=5.0)}
    cell = replace(CELL, base_data=base, tool_data={"2": Tool(Z=350.0)}, krl=replace(CELL.krl, initmov="cell"))
    return cell, robots.load(folder), Arm.load(folder)


def executed(files, choices, main="PART"):
    """The motions of a run; of a LOOP without EXIT those of two rounds."""
    cell, _, arm = setup()
    named = {Path(name).name: text for name, text in files.items()}
    data = {
        f"{kind}_DATA": {
            int(number): {name: float(getattr(frame, name)) for name in "XYZABC"} for number, frame in frames.items()
        }
        for kind, frames in (("BASE", cell.base_data), ("TOOL", cell.tool_data))
    }
    frames = [abc(*(getattr(frame, name) for name in "XYZABC")) for frame in (cell.base, cell.tool)]
    controller = Controller(named, None, *frames, data, choices)
    start = np.linalg.inv(frames[0]) @ arm.frames(np.array(cell.start_joints))[-1] @ frames[1]
    controller.numbers = list(components(start).values())
    motions, (first, second) = controller.run(main), controller.rounds
    if second:  # the third round begins as the second does
        second[-1] = dataclasses.replace(second[-1], waits=first[-1].waits)
    return motions + second


def loaded(motion, guess):
    """Where the tool stands in the root (4, 4) as a motion ends, and the joint angles."""
    pose = motion.base @ abc(*motion.numbers)
    given = pose, motion.tool, wrench_of(motion), np.asarray(guess), setup()[2].stiffness
    return loaded_by(*(values.tobytes() for values in given))


@lru_cache(4096)
def loaded_by(*given):
    """The same of pose, tool, wrench, joint angles and stiffness as bytes: runs of a job make many motions again."""
    _, _, arm = setup()
    pose, tool, wrench, guess = map(np.frombuffer, given[:4])
    pose, tool = pose.reshape(4, 4), tool.reshape(4, 4)
    q = inverse(arm, pose, tool, guess)
    return (loaded_tip(arm, q, tool, wrench) if wrench.any() else pose), q


def wrench_of(motion):
    """The force of a comment in the root (6,)."""
    given = {name.upper(): float(value) for name, value in re.findall(r"([FM][XYZ])\s*=\s*([-+.\dEe]+)", motion.force)}
    wrench = np.array([given.get(name, 0.0) for name in ("FX", "FY", "FZ", "MX", "MY", "MZ")])
    axes = motion.base[:3, :3]
    if "FRAME=TOOL" in motion.force:
        axes = axes @ abc(*motion.numbers)[:3, :3]
    assert "FRAME=FEED" not in motion.force
    return np.concatenate([axes @ wrench[:3], axes @ wrench[3:]])


class Path_:
    """The path of one nominal motion in the root."""

    def __init__(self, motion, start):
        """:param start: (4, 4) flange in the root as it begins."""
        self.motion = motion
        self.end = motion.base @ abc(*motion.numbers)
        self.flange = self.end @ np.linalg.inv(motion.tool)
        self.start = (start @ motion.tool)[:3, 3]

    def beside(self, place):
        """How far a place stands from the path [m]."""
        here, end = self.start, self.end[:3, 3]
        if self.motion.kind == "LIN":
            along = end - here
            share = np.clip((place - here) @ along / max(along @ along, 1e-18), 0.0, 1.0)
            return np.linalg.norm(place - here - share * along)
        if self.motion.kind != "CIRC":
            return np.inf
        via = (self.motion.base @ [*(np.array(self.motion.via) / 1000), 1.0])[:3]
        one, two = via - here, end - here
        normal = np.cross(one, two)
        normal /= np.linalg.norm(normal)
        centre = here + np.linalg.solve(np.array([one, two, normal]), [0.5 * one @ one, 0.5 * two @ two, 0.0])
        off = place - centre
        high = off @ normal
        return np.hypot(np.linalg.norm(off - high * normal) - np.linalg.norm(here - centre), high)


def compare(nominal, corrected, kept, text, waiting, warned):
    """Raise `Wrong` unless the corrected motions, loaded, lead along the nominal ones.

    While the program waits, nothing is fed: lines and arcs before a wait end without force.

    :param waiting: (file, line) of motions behind which some run waits.
    :param warned: True if a warning says that the program waits under force somewhere.
    :param kept: (file, line) of motions and calls that stay as they are, in some round at least.
    :param text: (file, line) → statement, of the job and of the written program.
    """
    cell, _, arm = setup()
    guess = np.array(cell.start_joints)
    flange = None
    todo = iter(corrected)
    lost = False
    for number, motion in enumerate(nominal):
        where = f"motion {number} of line {motion.line} in {motion.file}"
        stays = not kept.isdisjoint({*((file, line) for file, line, _ in motion.callers), (motion.file, motion.line)})
        if motion.joints is not None:
            made = next(todo, None)
            if made is None or made.joints != motion.joints:
                raise Wrong(f"{where}: other joint angles are commanded")
            guess, lost = np.radians(motion.joints), False
            flange = arm.frames(guess)[-1]
            continue
        path = Path_(motion, flange if flange is not None else np.eye(4))
        while True:
            made = next(todo, None)
            if made is None:
                raise Wrong(f"{where} is not made")
            if made.joints is not None:
                raise Wrong(f"{where}: joint angles are commanded")
            stays = stays and text[0][motion.file, motion.line] == text[1][made.file, made.line]
            if stays:
                guess = inverse(arm, made.base @ abc(*made.numbers), made.tool, guess)
                break
            if made.kind == "PTP" != motion.kind:
                raise Wrong(f"{where}: a PTP is made")
            place, guess = loaded(made, guess)
            away = np.linalg.norm(place[:3, 3] - path.end[:3, 3])
            turn = np.abs(place[:3, :3] - path.end[:3, :3]).max()
            if away < DIGITS and turn < TURN:
                ended = (motion.file, motion.line) in waiting and not np.abs(wrench_of(made)).any()
                must_end = motion.waits and motion.kind in ("LIN", "CIRC") and not warned
                if not ended and (must_end or np.abs(wrench_of(made) - wrench_of(motion)).max() > 0.02):
                    raise Wrong(f"{where}: loaded with {made.force}, not {motion.force}")
                same = np.allclose(made.base, motion.base, atol=1e-9) and np.allclose(made.tool, motion.tool, atol=1e-9)
                kinds = {motion.kind, "LIN"} if ended else {motion.kind, made.kind if motion.kind == "SPL" else ""}
                if not same or made.kind not in kinds or not np.isclose(made.speed, motion.speed):
                    raise Wrong(f"{where}: other frames, speed or kind in line {made.line}")
                break
            # the force falls over the last millimetre before a wait: on an arc this piece is written as chords
            is_chord = (
                motion.waits
                and motion.kind == "CIRC"
                and made.kind == "LIN"
                and away < cell.output.force_ramp_mm / 1000
            )
            is_part = motion.kind != "PTP" and (motion.kind == made.kind or is_chord)
            if not is_part or lost or path.beside(place[:3, 3]) > BESIDE:
                raise Wrong(
                    f"{where}: line {made.line} of {made.file} leads {1e3 * path.beside(place[:3, 3]):.6f} mm beside, "
                    f"{1e3 * away:.6f} mm and {turn:.1e} from its end; force {made.force}"
                )
        flange, lost = path.flange, stays and bool(motion.force)
    if next(todo, None) is not None:
        raise Wrong("more motions are made")


def statements(files):
    """(file, line) → its statement; names that files share, once the program is divided, as they were before."""
    return {
        (Path(name).name, number): line.strip().replace("part_", "")
        for name, text in files.items()
        for number, line in enumerate(text.splitlines(), 1)
    }


def correct_job(files, folder, **changes):
    """What correcting a job gives."""
    cell, robot, _ = setup()
    cell = replace(cell, folder=str(folder), **changes)
    for name, text in files.items():
        (folder / name).write_bytes(text.encode())
    documents = [replace(decode(n, files[n].encode()), folder=str(folder)) for n in ("part.src", "part.dat")]
    return correction.process(correction.read(documents, robot, cell, "part", "krl"), robot, cell)


def every_run(files, main="PART"):
    """Yield the motions for each sequence of inputs, and these."""
    choices = Choices()
    for _ in range(MOST_RUNS):
        if choices is None:
            return
        yield executed(files, choices, main), choices.decided
        choices = choices.following()


def is_wait_in_place(motion, following):
    """Whether a program waits behind a line to the place where the motion before ends."""
    if motion.numbers is None or following.numbers is None or following.kind != "LIN" or not following.waits:
        return False
    poses = [frame.base @ abc(*frame.numbers) for frame in (motion, following)]
    return bool(np.allclose(*poses, atol=1e-9))


def job_of(seed, rng, *, keep):
    """The job of a seed; those from a million on have jumps too, from ten million on jobs that are chosen.

    From a hundred million on they end in a LOOP without EXIT.
    """
    unknown, forces = bool(rng.random() < 0.6), bool(rng.random() < 0.85)
    kinds = {"jumps": 1_000_000, "selects": 10_000_000, "endless": 100_000_000}
    return Job(rng, keep=keep, unknown=unknown, forces=forces, **{kind: seed >= first for kind, first in kinds.items()})


def prove(seed, folder):
    """Try the job of a seed; return what came of it.

    :raises Wrong: the package is wrong.
    """
    rng = np.random.default_rng(seed)
    keep = bool(rng.random() < 0.3)
    job = job_of(seed, rng, keep=keep)
    try:
        runs = list(every_run(job.files))
    except Invalid as cause:
        return f"invalid: {cause}"
    cell, _, _ = setup()
    options = {"krl": replace(cell.krl, keep_unresolved=keep)}
    if rng.random() < 0.3:
        options["output"] = replace(cell.output, lines_per_file=int(rng.integers(12, 40)))
    try:
        result = correct_job(job.files, folder, **options)
    except PostprocError as error:
        return "refused: " + re.sub(r"[\d.]+|\S*\.src\S*|'.*'", "", str(error))[:90]
    if result.failed:
        error = next(issue for issue in result.issues if issue.level == "error")
        if error.kind == "read-back":
            raise Wrong(f"what is written cannot be released: {error.message}")
        return f"refused: {error.kind}"
    new = {Path(name).name: text for name, text in job.files.items()}
    if any(document.name == "partMain.src" for document in result.documents):
        new = {name: text for name, text in new.items() if not name.startswith("part")}
    for document in result.documents:
        check(document.name, document.text)
    new |= {document.name: document.text for document in result.documents}
    if not job.forces and "output" not in options and any(d.text != job.files[d.name] for d in result.documents):
        raise Wrong("without forces another text is written")
    kept = set()
    for issue in result.issues:
        if issue.kind == "unresolved":
            file, _, line = issue.subject.rpartition("line ")
            kept.add((file.rstrip(", ") or "part.src", int(line)))
        elif issue.kind == "motions-elsewhere":
            kept.add(("part.src", issue.source_line))
    main = "PARTMAIN" if "partMain.src" in new else "PART"
    texts = statements(job.files), statements(new)
    # a motion that goes nowhere cannot take the force away: the one before it ends without
    waiting = {
        (motion.file, motion.line)
        for nominal, _ in runs
        for index, motion in enumerate(nominal)
        if motion.waits or (index + 1 < len(nominal) and is_wait_in_place(motion, nominal[index + 1]))
    }
    warned = any(issue.kind == "dwell-in-material" for issue in result.issues)
    for nominal, decided in runs:
        inputs = Choices(decided, most=99)
        try:
            made = executed(new, inputs, main)
        except Invalid as cause:
            raise Wrong(f"what is written stops: {cause}") from None
        if inputs.decided != decided:
            raise Wrong(f"inputs are asked otherwise: {decided}, {inputs.decided}")
        compare(nominal, made, kept, texts, waiting, warned)
    outcome = "kept" if kept else "branches" if len(runs) > 1 else "straight"
    if (
        len(runs) == 1 and not kept and not warned
    ):  # a round that keeps its force at a wait is not that of plain motions
        flattened(runs[0][0], job, folder, made)
    return outcome + (", in files" if main == "PARTMAIN" else "") + ("" if job.forces else ", no forces")


def flattened(nominal, job, folder, made):
    """Raise `Wrong` unless the job written out as plain motions, corrected, makes the same motions."""
    lines, force, frames, speed = ["DEF part()", "$APO.CDIS=0.5"], "", None, None
    for motion in nominal:
        now = motion.base, motion.tool
        if frames is None or any(not np.array_equal(a, b) for a, b in zip(now, frames, strict=True)):
            frames = now
            lines += [f"{name}={{{plain(frame)}}}" for name, frame in zip(("$BASE", "$TOOL"), now, strict=True)]
        if motion.speed != speed:
            speed = motion.speed
            lines.append(f"$VEL.CP={speed!r}")
        if motion.kind != "PTP" and motion.force != force:
            force = motion.force
            lines.append(f"; FORCE {force or 'OFF'}")
        tail = " C_DIS" if motion.cdis is not None else ""
        via = "" if motion.via is None else ",".join(f"{n} {v:.9f}" for n, v in zip("XYZ", motion.via, strict=True))
        joints = motion.joints is not None
        names, values = ([f"A{n}" for n in range(1, 7)], motion.joints) if joints else ("XYZABC", motion.numbers)
        end = ",".join(f"{n} {v:.9f}" for n, v in zip(names, values, strict=True))
        lines.append(f"{motion.kind} {f'{{{via}}},' if via else ''}{{{end}}}{tail}")
        if motion.waits:
            lines.append("WAIT SEC 1")
    files = {"part.src": "\n".join([*lines, "END", ""]), "part.dat": "DEFDAT part\nENDDAT\n"}
    result = correct_job(files, folder)
    if result.failed:
        raise Wrong(f"as plain motions it is refused: {[i.message for i in result.issues if i.level == 'error']}")
    files |= {document.name: document.text for document in result.documents}
    again = executed(files, Choices())
    if len(again) != len(made):
        raise Wrong(f"as plain motions {len(again)} targets are written, {len(made)} as it was")
    for one, other in zip(made, again, strict=True):
        if one.joints is not None:
            continue  # `compare` has seen to them
        poses = [abc(*motion.numbers) for motion in (one, other)]
        off = np.abs(poses[0][:3, 3] - poses[1][:3, 3]).max()
        if one.kind != other.kind or off > 1e-6 or np.abs(poses[0] - poses[1]).max() > 1e-6:
            raise Wrong(f"line {one.line} of {one.file} leads elsewhere than plain motions: {off * 1e3:.6f} mm")


def plain(frame):
    return ",".join(f"{name} {value:.12f}" for name, value in components(frame).items())


def attack(seed):
    """Try the job of a seed; what goes wrong is told with its files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            return prove(seed, folder)
        except Exception as cause:
            rng = np.random.default_rng(seed)
            keep = bool(rng.random() < 0.3)
            job = job_of(seed, rng, keep=keep)
            files = "\n".join(f"--- {name}\n{text}" for name, text in job.files.items() if not name.endswith(".dat"))
            raise Wrong(f"seed {seed}: {type(cause).__name__}: {cause}\n{files}") from cause


def main():
    """Try jobs, and count what came of them."""
    return try_seeds(parser(__doc__).parse_args(), attack)


if __name__ == "__main__":
    raise SystemExit(main())
