"""Random RAPID modules, read, corrected and executed by a controller that is not the package's.

    python -m tests.attack.rapid --minutes 10 [--seed 0]

Of each module, the package's motions must be those that the controller makes. The corrected module is executed too:
each pose that it commands is loaded with the force that its comments give, by the arm of the oracle; the tool must then
be on the path of the module as it was, and at each of its targets. A module without forces comes back byte for byte.
"""

from __future__ import annotations

import random
import re
from functools import cache, partial
from itertools import pairwise

import numpy as np
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from postproc import cell as cells
from postproc import correction
from postproc import robot as robots
from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.text import decode
from postproc.program import CIRC, LIN
from postproc.under_load import RobotInCell
from tests.attack.driver import Wrong, parser, try_seeds
from tests.oracle.arm import Arm
from tests.oracle.elastic import inverse, loaded_tip
from tests.oracle.rapid import Controller, wrench
from tests.places import SAMPLES

DIGITS = 1e-6
"""What four digits of mm, in single precision, and eight of quaternions leave of a place [m]."""
BESIDE = 1.1e-5
"""The tolerance of the cell [m]: how far the loaded tool may be from the path at inserted targets."""


@cache
def setup():
    """Cell, robot, the robot in the cell, the arm of the oracle."""
    cell = cells.load(SAMPLES / "cell_irb6700.toml")
    model = robots.load(robots.find(cell.robot))
    return cell, model, RobotInCell.of(model, cell), Arm.load(robots.find(cell.robot))


class Generator:
    """Writes a module: targets as numbers, names, elements, Offs and RelTool; routines, FOR and IF."""

    def __init__(self, seed: int, *, forces: bool = True) -> None:
        self.random = random.Random(seed)
        self.forces = forces
        self.data: list[str] = []
        self.count = 0
        self.routines: list[str] = []

    def pick(self, *choices):
        return self.random.choice(choices)

    def number(self, low: float, high: float, digits: int = 3) -> str:
        return f"{self.random.uniform(low, high):.{self.pick(digits, digits, 1, 5)}f}"

    def target(self) -> str:
        r = self.random
        turn = Rotation.from_euler("zyx", [r.uniform(-8, 8), r.uniform(-8, 8), 180 + r.uniform(-8, 8)], degrees=True)
        q = np.roll(turn.as_quat(), 1) * self.pick(1, -1)
        blank = self.pick("", " ")
        place = f",{blank}".join(self.number(-150, 150) for _ in range(2)) + f",{blank}{self.number(0, 120)}"
        angles = f",{blank}".join(f"{v:.{self.pick(6, 8, 9)}f}" for v in q)
        axes = self.pick("9E9,9E9,9E9,9E9,9E9,9E9", "9E+09,9E+09,9E+09,9E+09,9E+09,9E+09", "0,9E9,9E9,9E9,9E9,9E9")
        return f"[[{place}],{blank}[{angles}],[0,0,0,0],[{axes}]]"

    def named(self) -> str:
        """The name of a target, perhaps one that is used already."""
        names = [re.search(r"robtarget (\w+):=", one)[1] for one in self.data if re.search(r"robtarget \w+:=", one)]
        if names and self.random.random() < 0.3:
            return self.random.choice(names)
        self.count += 1
        kind = self.pick("CONST", "CONST", "LOCAL CONST", "VAR", "PERS")
        self.data.append(f"{kind} robtarget p{self.count}:={self.target()};")
        return f"p{self.count}"

    def point(self) -> str:
        kind = self.random.random()
        if kind < 0.4:
            return self.target()
        if kind < 0.7:
            return self.named()
        step = ",".join(self.number(-30, 30) for _ in range(3))
        if kind < 0.85:
            return f"Offs({self.named()},{step})"
        turn = self.pick("", rf"\Rz:={self.number(-10, 10)}", rf"\Rx:={self.number(-5, 5)}\Ry:={self.number(-5, 5)}")
        return f"RelTool({self.named()},{step}{turn})"

    def tail(self) -> str:
        speed = self.pick("v100", "v50", "vCut", r"v100\V:=33.5", "[40,500,5000,1000]")
        zone = self.pick("fine", "z1", "z0", "zOwn", r"z5\Z:=0.8")
        wobj = self.pick("\\WObj:=wPart", " \\WObj:=wPart", ",\\WObj:=wPart")
        return f",{self.pick('', ' ')}{speed},{zone},tMill{wobj};"

    def moves(self, count: int, indent: str) -> list[str]:
        out: list[str] = []
        for _ in range(count):
            kind = self.random.random()
            if kind < 0.12 and self.forces:
                force = " ".join(f"F{a}={self.random.uniform(-400, 400):.1f}" for a in "XYZ")
                out.append(f"{indent}! FORCE {self.pick(force, force + ' FRAME=TOOL', 'OFF')}")
            elif kind < 0.2:
                out.append(
                    indent + self.pick("SetDO doSpindle,1;", "WaitTime 0.5;", "! a comment; MoveL p1", "n1:=n1+1;")
                )
            elif kind < 0.3:
                out.append(f"{indent}MoveJ {self.point()}{self.tail()}")
            elif kind < 0.36:
                out += self.circle(indent)
            elif kind < 0.42:
                out.append(f"{indent}MoveL {self.target()}{self.tail()} {self.pick('', '! deep')}")
            else:
                out.append(f"{indent}MoveL {self.point()}{self.tail()}")
        return out

    def circle(self, indent: str) -> list[str]:
        """A straight move and a circle from its end, in one orientation."""
        r = self.random
        x, y, z = (r.uniform(-100, 100), r.uniform(-100, 100), r.uniform(0, 80))
        radius, turn = r.uniform(5, 60), r.uniform(0, 360)
        q = ",".join(f"{v:.8f}" for v in np.roll(Rotation.from_euler("x", 180, degrees=True).as_quat(), 1) + 0.0)
        out = []
        angles = np.radians([turn, turn + r.uniform(20, 100), turn + r.uniform(120, 230)])
        targets = [
            f"[[{x + radius * np.cos(a):.4f},{y + radius * np.sin(a):.4f},{z:.4f}],[{q}],[0,0,0,0],"
            "[9E9,9E9,9E9,9E9,9E9,9E9]]"
            for a in angles
        ]
        out.append(f"{indent}MoveL {targets[0]}{self.tail()}")
        out.append(f"{indent}MoveC {targets[1]},{targets[2]}{self.tail()}")
        return out

    def body(self, indent: str) -> list[str]:
        out = self.moves(self.random.randint(1, 4), indent)
        kind = self.random.random()
        if kind < 0.25:
            out.append(f"{indent}FOR i FROM {self.pick('1 TO 3', '3 TO 1', '0 TO 4 STEP 2')} DO")
            out.append(f"{indent}  MoveL Offs({self.named()},10*i,-5*i,{self.pick('0', '2*i')}){self.tail()}")
            out += self.moves(self.random.randint(0, 1), indent + "  ")
            out.append(f"{indent}ENDFOR")
        elif kind < 0.4:
            self.count += 1
            elements = ",\n    ".join(self.target() for _ in range(3))
            self.data.append(f"CONST robtarget a{self.count}{{3}}:=[{elements}];")
            out += [
                f"{indent}FOR i FROM 1 TO 3 DO",
                f"{indent}  MoveL a{self.count}{{i}}{self.tail()}",
                f"{indent}ENDFOR",
            ]
        elif kind < 0.5:
            out += [f"{indent}IF bOn THEN", *self.moves(2, indent + "  "), f"{indent}ELSE"]
            out += [*self.moves(1, indent + "  "), f"{indent}ENDIF"]
        return out + self.moves(self.random.randint(0, 2), indent)

    def module(self) -> str:
        """The text of a module."""
        end = self.pick("\n", "\r\n")
        names = [f"part_{k}" for k in range(self.random.randint(0, 3))]
        routines: list[str] = []
        for name in names:
            routines += ["", f"  PROC {name}()", *self.body("    "), "  ENDPROC"]
        main = [
            f"  PROC {self.pick('main', 'Main')}()",
            self.pick("    ConfL\\Off;", "    ConfL \\Off;"),
            "    ConfJ\\Off;",
        ]
        main.append("    CirPathMode\\ObjectFrame;")
        main.append(
            "    MoveAbsJ [[0,10,20,0,60,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v500,fine,tMill\\WObj:=wPart;",
        )
        if self.forces:
            main.append(f"    ! FORCE FX={self.number(-300, 300, 1)} FZ=200")
        for name in names:
            for _ in range(self.pick(1, 1, 2)):
                main += [*self.moves(1, "    "), f"    {name};"]
        main += [*self.body("    "), "    ! FORCE OFF" if self.forces else "    !", "  ENDPROC"]
        head = self.pick([], ["%%%", "  VERSION:1", "  LANGUAGE:ENGLISH", "%%%"])
        frame = "[[1500,-200,700],[1,0,0,0]]"
        data = [
            "PERS tooldata tMill:=[TRUE,[[0,0,350],[1,0,0,0]],[5,[0,0,100],[1,0,0,0],0,0,0]];",
            f'TASK PERS wobjdata wPart:=[FALSE,TRUE,"",{frame},[[5,-3,2],[0.99904822,0,0,0.04361939]]];',
            "LOCAL CONST speeddata vCut:=[25.5,500,5000,1000];",
            "CONST zonedata zOwn:=[FALSE,0.4,0.4,0.4,0.1,0.4,0.1];",
            "VAR num n1:=0;",
            f"CONST bool bOn:={self.pick('TRUE', 'FALSE')};",
            *self.data,
        ]
        lines = [*head, "MODULE random", *(f"  {one}" for one in data), *routines, *main, "ENDMODULE", ""]
        return end.join("\n".join(lines).split("\n"))


def executed(text: str):
    """The motions that the controller makes."""
    return Controller(text.replace("\r\n", "\n")).run()


def check_reading(text: str):
    """Compare the motions of the package with those of the controller; return the program."""
    cell, _, place, _ = setup()
    program = RAPID.read([decode("random.mod", text.encode())], cell, place.forward, "random")
    check_motions(program, executed(text))
    return program


def check_motions(program, wanted, *, ends_early=False) -> None:
    """Compare the motions of a program with those of the controller.

    :param ends_early: the controller may have made the first of them only.
    """
    m = program.motions
    if len(m) != len(wanted) and not (ends_early and len(m) > len(wanted)):
        raise Wrong(f"{len(m)} motions instead of {len(wanted)}")
    forces = [""] * len(m)
    for note in program.notes:
        for k in range(note.before, len(m)):
            forces[k] = note.wrench, note.frame
    for k, motion in enumerate(wanted):
        if int(m.line[k]) != motion.line:
            raise Wrong(f"motion {k}: line {m.line[k]} instead of {motion.line}")
        base, tool = program.bases[m.base[k]].copy(), program.tools[m.tool[k]].copy()
        base[:3, 3] *= 1e3
        tool[:3, 3] *= 1e3
        _near(tool, motion.tool, k)
        _near(base, motion.base, k)
        own = np.zeros(6) if not forces[k] else np.array(forces[k][0])
        if motion.pose is not None:
            pose = m.target[k : k + 1][0].copy()
            pose[:3, 3] *= 1e3
            _near(base @ pose, motion.pose, k)
            axes = (base @ pose if forces[k] and forces[k][1] == "TOOL" else base)[:3, :3]
            found = np.concatenate([axes @ own[:3], axes @ own[3:]])
            if np.abs(found - wrench(motion)).max() > 1e-3:
                raise Wrong(f"motion {k}: force {found} instead of {wrench(motion)}")
        if m.kind[k] in (LIN, CIRC) and abs(m.feed[k] * 1e3 - motion.speed) > 1e-5:
            raise Wrong(f"motion {k}: speed {m.feed[k]}")
        if abs(m.blend[k] * 1e3 - motion.zone) > 1e-6:
            raise Wrong(f"motion {k}: zone {m.blend[k]}")
        if motion.via is not None:
            via = base[:3, :3] @ (m.centre[k] * 1e3) + base[:3, 3]
            if abs(np.linalg.norm(motion.via - via) - np.linalg.norm(motion.pose[:3, 3] - via)) > 1e-2:
                raise Wrong(f"motion {k}: circle")


def _near(found, wanted, k) -> None:
    if np.abs(found[:3, 3] - wanted[:3, 3]).max() > 3e-4 or np.abs(found[:3, :3] - wanted[:3, :3]).max() > 1e-6:
        raise Wrong(f"motion {k}: {found} instead of {wanted}")


def check_correction(text: str, program) -> str:
    """Correct a module and compare the loaded arm with the path as it was; return what became of it."""
    cell, model, *_ = setup()
    result = correction.process(program, model, replace(cell, output=replace(cell.output, max_correction_mm=20.0)))
    errors = [issue for issue in result.issues if issue.level == "error"]
    if errors or result.documents is None or not result.documents:
        kind = errors[0].kind if errors else "nothing written"
        if kind == "read-back":
            raise Wrong(errors[0].message)
        return f"refused: {kind}"
    (document,) = result.documents
    new = document.text
    new = re.sub(r"!POSTPROC[^\r\n]*\r?\n?", "", new)
    if not program.notes and new != text:
        raise Wrong("a module without forces was changed")
    if new == text:
        return "unchanged"
    compare(executed(text), executed(new))
    return "corrected"


def compare(nominal, corrected) -> None:
    """Raise `Wrong` unless the corrected motions, loaded, lead along the nominal ones."""
    cell, _, _, arm = setup()
    guess = np.array(cell.start_joints)
    todo = iter(corrected)
    flange, before = None, np.zeros(6)
    for motion, following in reversed(list(pairwise(nominal))):
        # a move that goes nowhere cannot take the force away: the one before it ends without
        is_short = following.pose is not None and motion.pose is not None and np.allclose(following.pose, motion.pose)
        motion.waits |= following.waits and following.name != "movej" and is_short
    for k, motion in enumerate(nominal):
        if motion.pose is None:
            here = next(todo, None)
            if here is None or here.joints != motion.joints:
                raise Wrong(f"motion {k}: joints changed")
            flange, before = None, np.zeros(6)
            continue
        end = motion.pose
        start = None if flange is None else (flange @ motion.tool)[:3, 3]
        while True:
            here = next(todo, None)
            if here is None or here.pose is None or here.speed != motion.speed:
                raise Wrong(f"motion {k}: another move or speed: {here}")
            if not np.allclose(here.tool, motion.tool) or not np.allclose(here.base, motion.base):
                raise Wrong(f"motion {k}: frames")
            ends_free = motion.waits and not wrench(here).any()  # nothing is fed while the program waits
            is_end = here.name == "movej" or ends_free or np.abs(wrench(here) - wrench(motion)).max() <= 2e-3
            changes = [(before, wrench(motion)), (wrench(motion), 0.0 * before if motion.waits else wrench(motion))]
            on_the_way = any(_is_between(wrench(here), *change) for change in changes)
            if not is_end and "TOOL" not in here.force and not on_the_way:
                raise Wrong(f"motion {k}: force {here.force!r} instead of {motion.force!r}")
            pose = here.pose.copy()
            pose[:3, 3] /= 1e3
            tool = here.tool.copy()
            tool[:3, 3] /= 1e3
            q = guess = inverse(arm, pose, tool, guess)
            load = wrench(here) if here.name != "movej" else np.zeros(6)
            tip = loaded_tip(arm, q, tool, load) if load.any() else pose
            gap = np.linalg.norm(tip[:3, 3] - end[:3, 3] / 1e3)
            if gap < DIGITS:
                must_be_free = motion.waits and motion.name != "movej" and wrench(motion).any()
                if (not is_end and "TOOL" not in here.force) or (must_be_free and not ends_free):
                    raise Wrong(f"motion {k}: force {here.force!r} at its end instead of {motion.force!r}")
                break
            if here.name == "movej" or motion.name == "movej":
                break  # led to where the next one begins
            if start is not None and _beside(motion, start, tip[:3, 3] * 1e3) * 1e-3 > BESIDE:
                raise Wrong(f"motion {k} (line {motion.line}): an inserted target is beside the path")
        flange = end @ np.linalg.inv(motion.tool)
        before = np.zeros(6) if motion.name == "movej" or motion.waits else wrench(motion)
    if next(todo, None) is not None:
        raise Wrong("motions are left")


def _is_between(force, before, after) -> bool:
    """Whether a force is on the way from one to another: it builds up over the ramp of the cell."""
    change = after - before
    share = np.clip((force - before) @ change / max(change @ change, 1e-18), 0.0, 1.0)
    return np.abs(before + share * change - force).max() < 2e-3


def _beside(motion, start, place) -> float:
    """How far a place is from the path of a motion [mm]."""
    end = motion.pose[:3, 3]
    if motion.via is None:
        along = end - start
        share = np.clip((place - start) @ along / max(along @ along, 1e-18), 0.0, 1.0)
        return float(np.linalg.norm(place - start - share * along))
    one, two = motion.via - start, end - start
    normal = np.cross(one, two)
    normal /= np.linalg.norm(normal)
    centre = start + np.linalg.solve(np.array([one, two, normal]), [0.5 * one @ one, 0.5 * two @ two, 0.0])
    off = place - centre
    high = off @ normal
    return float(np.hypot(np.linalg.norm(off - high * normal) - np.linalg.norm(start - centre), high))


def attack(seed: int, *, correct: bool = True) -> str:
    """Try one random module."""
    text = Generator(seed, forces=seed % 5 != 0).module()
    program = check_reading(text)
    return check_correction(text, program) if correct else "read"


def main() -> int:
    """Try modules, and count what came of them."""
    arguments = parser(__doc__)
    arguments.add_argument("--only-read", action="store_true", help="correct no module")
    options = arguments.parse_args()
    return try_seeds(options, partial(attack, correct=not options.only_read))


if __name__ == "__main__":
    raise SystemExit(main())
