"""Simulated robots that mill a test part: what identification from its probed surfaces is worth on other jobs."""

from __future__ import annotations

from types import SimpleNamespace

import msgspec
import numpy as np

import postproc
from postproc import files, machining
from postproc import robot as robots
from postproc.cell import Box, Frame
from postproc.elastostatics import deflect, position_bound
from postproc.errors import ModelError
from postproc.machining import ProcessSource
from postproc.robot.model_file import JointSpring, LinkSprings, ModelFile, Stiffening
from postproc.testpart import design, features, probing
from postproc.testpart.cut import ClampedProgram, CutForces, Surfaces, surfaces
from postproc.testpart.fit import fit
from postproc.testpart.model import agreement, material, model_file
from postproc.testpart.prior import Prior
from postproc.testpart.readings import Readings
from postproc.under_load import RobotInCell
from tests.kr270 import CELL, ROBOT
from tests.oracle.arm import Arm
from tests.oracle.whole_arm import WholeArm, twist
from tests.testpart.machine import Machine

FOLDER = robots.find(CELL.robot)
AL7075 = (767.01, 27.7, 168.8, 26.6, 222.0, 0.7)
SIGMA = 5e-6
JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")


def process_text(box, resolution):
    spans = ", ".join(f"{axis} = {list(map(float, span))}" for axis, span in zip("XYZ", box, strict=True))
    return f"""[material]
name = "al_7075_t6_carbide"
sigma_percent = 10.0
[tools.1]
diameter_mm = 10.0
flutes = 3
rpm = 6000
[stock]
box = {{ {spans} }}
resolution_mm = {resolution}
"""


def part(folder, box=((0, 300), (0, 200), (-40, 0)), count=12, resolution=0.8, depth=3e-3, mass=0.0, further=()):
    """Design a part; return all that is needed to cut and to identify.

    `further`: X, Y, Z [mm] and A [deg] of `$BASE` for further placements of the block.
    """
    (folder / "process.toml").write_text(process_text(box, resolution))
    process = machining.load(folder / "process.toml")
    cells = {features.Placement(): CELL}
    for number, place in enumerate(further, start=1):
        base = Frame(**dict(zip("XYZA", map(float, place), strict=True)))
        cells[features.Placement(str(number))] = msgspec.structs.replace(CELL, base=base)
    settings = tuple(RobotInCell.of(ROBOT, cell) for cell in cells.values())
    robot_in_cell = settings[0]
    prior = Prior.of(robot_in_cell.robot, process.law().sigma)
    cutting = features.Cutting(0.01, 6000.0, 0.06 * 3 * 6000 / 60e3, 1, 0.0)
    found, cutting = design.candidates(prior, settings, process, cutting, depth=depth, box=Box(*box), sigma=SIGMA)
    low, high = (1e-3 * np.array([span[k] for span in box]) for k in (0, 1))
    hung = features.hanging_places(low, high, cutting.top) if mass else np.zeros((0, 3))
    weighed = design.gauge_information(prior, settings, cutting, mass, hung, SIGMA)
    chosen = design.choose(found, prior, robot_in_cell, design.tests_in_block(found), count, weighed)
    touches = features.touch_off_places(chosen.features, cutting, low, high)
    made, programs = {}, {}
    for number, (placement, cell) in enumerate(cells.items()):
        own = [chosen.features[k] for k in np.flatnonzero(chosen.placement == number)]
        first = features.FirstNumbers(
            1 + int((chosen.placement < number).sum()), 1 + len(hung) * number, 1 + len(touches) * number
        )
        touched = touches if own else None
        made[placement] = features.program(own, cutting, mass, hung, touches=touched, first=first)
        if not made[placement].feature:
            continue
        (folder / placement.name).write_text(made[placement].text)
        programs[placement] = postproc.read_program(folder / placement.name, ROBOT, cell)
    (folder / "probing.csv").write_bytes(probing.table(made))
    return SimpleNamespace(
        folder=folder, process=process, robot_in_cell=robot_in_cell, prior=prior, cutting=cutting, found=found,
        chosen=chosen, made=made, programs=programs, cells=cells,
    )  # fmt: skip


def content():
    return files.read_toml(FOLDER / "model.toml", ModelFile, ModelError)


def truth(rng, kind="joints", drift=None):
    """An arm whose compliances differ by 30 % (log-normal); "rich": gears bend, links are flexible.

    `drift`: factors of the compliances of some joints, by name.
    """
    model = content()
    joints = {}
    for name in JOINTS:
        own = model.joints[name]
        value = own.compliance_urad_per_Nm * float(np.exp(0.3 * rng.normal())) * (drift or {}).get(name, 1.0)
        bend = []
        if kind == "rich":  # a third of the compliance ends at a torque that milling reaches
            bend = [Stiffening(float(np.exp(rng.uniform(np.log(100.0), np.log(600.0)))), 0.33 * value)]
        joints[name] = JointSpring(source="truth", compliance_urad_per_Nm=value, knees=bend)
    links = {}
    if kind == "rich":  # links that add about a sixth of what joints give
        for name in ("base", "A1", "A2", "A3"):
            size = 0.06e0 * rng.lognormal(0.0, 0.5, 3)
            links[name] = LinkSprings(
                source="truth", RX_urad_per_Nm=size[0], RY_urad_per_Nm=size[1], RZ_urad_per_Nm=size[2]
            )
    model = msgspec.structs.replace(model, joints=joints, links=links)
    return WholeArm((FOLDER / "robot.urdf").read_text(), model)


def machine(arm, scale=1.0, radius=5.0, base=(1500, -200, 700), top=(0.0, 0.0, 0.0)):
    return Machine(
        arm, Arm.load(FOLDER), [0, -70, 110, 0, 50, 0], base, (0, 0, 350), 180.0,
        tuple(scale * k for k in AL7075), radius, 3, top,
    )  # fmt: skip


def probed(part, arm, rng, scale=1.0, sigma=1e3 * SIGMA, top=(0.0, 0.0, 0.0)):
    """Cut and probe; return the name of the file. `top`: of the uncut block, see `Machine`."""
    radius = 5.0 + 0.01 * rng.normal()
    head, *rows = (part.folder / "probing.csv").read_text().splitlines()
    out = [head]
    for placement in part.programs:
        cell = part.cells[placement]
        own = [row for row in rows if len(part.cells) == 1 or row.split(",")[1] == placement.name]
        base = cell.base
        cutter = machine(arm, scale, radius, (base.X, base.Y, base.Z, base.A), top)
        text = (part.folder / placement.name).read_text()
        out += cutter.probed(text, "\n".join([head, *own, ""]), rng, sigma).splitlines()[1:]
    path = part.folder / "probed.csv"
    path.write_text("\n".join([*out, ""]))
    return path


def identified(part, path):
    return fitted(part, path, part.prior, part.robot_in_cell, part.process)


def fitted(part, path, prior, robot_in_cell, process):
    read, parts = probing.read(path), clamped(part, path, robot_in_cell.robot, process)
    where = Surfaces.join([each.surfaces for each in parts])
    return fit(prior, Readings.of(read, where, SIGMA), robot_in_cell, CutForces(parts))


def clamped(part, path, robot, process):
    """Return the programs of all placements of the block, for points that are in their order."""
    read, parts = probing.read(path), []
    for placement, program in part.programs.items():
        robot_in_cell = RobotInCell.of(robot, part.cells[placement])
        rows = np.flatnonzero(read.base == int(placement.number or -1))
        where = surfaces(program, robot_in_cell, read.take(rows), 0.5 * part.cutting.diameter)
        parts.append(ClampedProgram(program, robot_in_cell, ProcessSource(process, CELL.tool.axis), where))
    return parts


def compared(part, path, robot):
    """How a model that `model` wrote agrees with a part, under the forces that were found with it."""
    process = msgspec.structs.replace(
        part.process, material=machining.material.MaterialTable(file=str(part.folder / "found" / "material.toml"))
    )
    robot_in_cell, law = RobotInCell.of(robot, CELL), process.law()
    prior = Prior.of(robot_in_cell.robot, law.sigma, law.numbers)
    return agreement(fitted(part, path, prior.widen(), robot_in_cell, process)[0], prior)


DRIFTS = ({}, {}, {"A1": 1.3}, {"A2": 1.3}, {"A3": 1.3}, dict.fromkeys(JOINTS, 1.3), dict.fromkeys(JOINTS, 0.77))
"""What may have changed from one part to the next: nothing, one joint, all of them."""


def drifts(part, seed, cases=DRIFTS):
    """Identify a robot, let it change, mill and probe the part again: how the model agrees, one for each case."""
    rng = np.random.default_rng(seed)
    scale = float(np.exp(0.1 * np.random.default_rng(seed + 10_000).normal()))
    found, _ = identified(part, probed(part, truth(rng), rng, scale))
    robot, _ = model(found, part.process, part.folder)
    return [
        compared(part, probed(part, truth(np.random.default_rng(seed), drift=case), rng, scale), robot)
        for case in cases
    ]


def jobs(rng, count=40):
    """Joint angles and forces [N] of other jobs of the cell: up to half a metre away, the tool pointing down."""
    cutter = machine(WholeArm((FOLDER / "robot.urdf").read_text(), content()))
    near, out = cutter.joints((150.0, 100.0, 0.0), cutter.start), []
    for _ in range(count):
        place = np.array([150.0, 100.0, 0.0]) + rng.uniform(-1, 1, 3) * [400.0, 500.0, 150.0]
        force = rng.normal(size=3) * [1.0, 1.0, 0.4]
        out.append((cutter.joints(place, near), force / np.linalg.norm(force) * rng.uniform(100.0, 400.0)))
    return np.array([q for q, _ in out]), np.array([force for _, force in out])


def deflections(arm, q, force):
    """True displacements (n, 3) of the tip [m] under forces in root axes."""
    tool = np.eye(4)
    tool[2, 3] = 0.35
    rest = np.array([arm.equilibrium(row, tool, np.zeros(6))[1] for row in q])
    loaded = [arm.equilibrium(row, tool, np.append(f, np.zeros(3)))[1] for row, f in zip(q, force, strict=True)]
    return np.array([twist(a, b)[:3] for a, b in zip(rest, loaded, strict=True)])


def predicted(robot, q, force):
    tool = np.eye(4)
    tool[2, 3] = 0.35
    wrench = np.hstack([force, np.zeros((len(q), 3))])
    return deflect(robot, q, tool, wrench).twist[:, :3]


def model(found, process, folder, before=FOLDER):
    """Write the model and the material of a fit; return the model and the numbers of the law as they are read."""
    name = folder / "found"
    name.mkdir(exist_ok=True)
    prior = files.read_toml(before / "model.toml", ModelFile, ModelError)
    (name / "model.toml").write_bytes(files.toml(model_file(found, prior, process, "part"), ""))
    (name / "robot.urdf").write_bytes((FOLDER / "robot.urdf").read_bytes())
    (name / "material.toml").write_bytes(material(found, process, "part"))
    law = machining.material.law(machining.material.MaterialTable(file=str(name / "material.toml")), "")
    return postproc.load_robot(str(name)), law


def bound(robot, law, q, force, *, together=True):
    """Bound u95 on a job under forces of a law, with what is known of model and forces together, or of each."""
    tool = np.eye(4)
    tool[2, 3] = 0.35
    wrench = np.hstack([force, np.zeros((len(q), 3))])
    spread = law.sigma * np.abs(wrench)[:, :, None] * np.eye(6)
    scaled = np.full(len(q), together and robot.force_factor.is_of(law.numbers))
    return position_bound(robot, q, tool, wrench, force_spread=spread, is_proportional=scaled)


def worth(part, seed, kind="joints"):
    """Return RMS errors on other jobs before and after, the share inside the bound, its size, and the fit."""
    rng = np.random.default_rng(seed)
    arm, scale = truth(rng, kind), float(np.exp(0.1 * rng.normal()))
    found, left_out = identified(part, probed(part, arm, rng, scale))
    q, force = jobs(rng)
    true = deflections(arm, q, scale * force)
    before = np.linalg.norm(predicted(part.robot_in_cell.robot, q, force) - true, axis=1)
    after = np.linalg.norm(predicted(found.robot, q, found.scale * force) - true, axis=1)
    own, law = model(found, part.process, part.folder)
    limit = bound(own, law, q, found.scale * force)
    apart = bound(own, law, q, found.scale * force, together=False)
    return SimpleNamespace(
        before=float(np.sqrt(np.mean(before**2))), after=float(np.sqrt(np.mean(after**2))),
        inside=float(np.mean(after <= limit)), bound=float(np.sqrt(np.mean(limit**2))),
        apart=float(np.sqrt(np.mean(apart**2))),
        size=float(np.sqrt(np.mean(true**2) * 3)), fit=found, left_out=left_out, scale=scale,
    )  # fmt: skip


def at_random(found, seconds, rng):
    """A part of features taken at random, one after another, until they take as long as another part [s]."""
    chosen = []
    for row in rng.permutation(len(found.feature)).tolist():
        if found.is_apart[row, chosen].all():
            chosen.append(row)
            if found.seconds[chosen].sum() >= seconds:
                break
    return np.array(chosen, dtype=np.int64)
