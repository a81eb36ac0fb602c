"""Torques that readings cover: on each joint the range in each direction, and the share of a job inside it.

Gears with lost motion, friction or breakpoints deflect differently if a torque changes its sign or leaves the measured
range. So a validation is valid for a job only as far as the torques of its cutting forces are inside the covered
ranges. Torques are those of the load alone, without weights and compensator.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from postproc.frames import Array
from postproc.identification import record
from postproc.identification.measurement_model import joint_torques
from postproc.identification.readings import Measurements
from postproc.program import Bools, Ints
from postproc.robot import JOINTS, RobotModel

SIGNS = ("negative", "positive")
LEAST_TORQUE = 1.0
"""Smallest torque [N·m] that counts as having a sign."""
ENOUGH = 5
"""Configurations needed to cover one sign of torque. If all of them are inside the bound, the share inside is above one
half, with 95 % confidence."""


class Coverage(Struct, frozen=True, eq=False):
    """Torques that the readings covered, by joint and sign (column 0 negative, 1 positive).

    :param largest: (6, 2) largest torque of that sign, as a positive number; 0 where there is none [N·m].
    :param configurations: (6, 2) number of configurations with a torque of that sign.
    :param refuted: (6, 2) whether the readings with that sign contradict the model.
    :param least: smallest load that was measured: torque on its most loaded joint, divided by `largest`.
    """

    largest: Array
    configurations: Array
    refuted: Bools
    least: float

    @property
    def covered(self) -> Bools:
        """Whether (6, 2) a sign of torque has enough configurations, and none that contradict the model."""
        return np.asarray((self.configurations >= ENOUGH) & ~self.refuted)


class Outside(Struct, frozen=True):
    """A reason why a share of a job is not covered. Shares of several reasons may overlap."""

    reason: str
    share: float


class JobShare(Struct, frozen=True):
    """Share of a program's cutting path whose torques are covered, and the reasons for the rest."""

    program: str
    share: float
    outside: tuple[Outside, ...]


def coverage(torque: Array, config: Ints, refuted: Bools | None = None) -> Coverage:
    """Return the torques that loaded states cover.

    :param torque: (L, 6) joint torques of each loaded state [N·m].
    :param config: (L,) configuration of each state.
    """
    sides = signed(torque)
    there = sides > LEAST_TORQUE
    largest = np.where(there.any(axis=0), sides.max(axis=0, initial=0.0), 0.0)
    names, place = np.unique(config, return_inverse=True)
    counted = np.zeros((len(names), 6, 2), dtype=bool)
    np.logical_or.at(counted, place, there)
    level = np.full(len(names), np.inf)
    np.minimum.at(level, place, _level(sides, largest))
    least = float(np.sort(level)[min(ENOUGH, len(level)) - 1]) if len(level) else np.inf
    return Coverage(largest, counted.sum(axis=0), np.zeros((6, 2), dtype=bool) if refuted is None else refuted, least)


def of_readings(robot: RobotModel, data: Measurements) -> Coverage:
    """Return the torques that readings cover."""
    return coverage(joint_torques(robot, data), data.state_config[data.loaded])


def signed(torque: Array) -> Array:
    """Return torques (N, 6) as (N, 6, 2): size of the negative and of the positive part [N·m]."""
    return np.stack([np.maximum(-torque, 0.0), np.maximum(torque, 0.0)], axis=-1)


def inside(torque: Array, covered: Coverage) -> Bools:
    """Return (T,) whether torques (T, 6) [N·m] are covered on all joints, and not below the smallest loads."""
    missing, beyond, low = _faults(torque, covered)
    return np.asarray(~((missing | beyond).any(axis=(1, 2)) | low))


def share(program: str, torque: Array, weight: Array, covered: Coverage) -> JobShare:
    """Return the covered share of a program, with reasons for the rest.

    :param torque: (T, 6) joint torques of the cutting forces at places along its cutting moves [N·m].
    :param weight: (T,) share of the cutting path of each place, sum 1.
    """
    missing, beyond, low = _faults(torque, covered)
    outside = [Outside("all torques below those of the smallest loads", float(weight @ low))]
    for joint, side in np.ndindex(6, 2):
        where = f"{SIGNS[side]} torque on {JOINTS[joint]}"
        count = int(covered.configurations[joint, side])
        why = f"{where}: {count} of {ENOUGH} configurations needed have it" if count else f"{where}: no reading has it"
        if covered.refuted[joint, side]:
            why = f"{where}: there the readings contradict the model"
        far = f"{where} beyond {covered.largest[joint, side]:.0f} N·m"
        outside += [
            Outside(why, float(weight @ missing[:, joint, side])),
            Outside(far, float(weight @ beyond[:, joint, side])),
        ]
    reasons = sorted((reason for reason in outside if reason.share > 0.0), key=lambda each: -each.share)
    return JobShare(program, float(weight @ inside(torque, covered)), tuple(reasons))


def _faults(torque: Array, covered: Coverage) -> tuple[Bools, Bools, Bools]:
    """Return why torques (T, 6) are not covered: by sign (T, 6, 2), too large (T, 6, 2), all too small (T,)."""
    sides, good = signed(torque), covered.covered
    acts = sides > LEAST_TORQUE
    return acts & ~good, acts & good & (sides > covered.largest), _level(sides, covered.largest) < covered.least


def _level(sides: Array, largest: Array) -> Array:
    """Return the torque (N,) on the most loaded joint, divided by the largest one covered with that sign."""
    scaled = np.divide(sides, largest, out=np.zeros_like(sides), where=largest > 0.0)
    return np.asarray(scaled.max(axis=(1, 2)))


def as_record(covered: Coverage) -> list[record.TorqueRange]:
    """Return the torques as `identification.json` contains them."""
    return [
        record.TorqueRange(name, float(-sides[0]) + 0.0, float(sides[1]), int(count[0]), int(count[1]))
        for name, sides, count in zip(JOINTS, covered.largest, covered.configurations, strict=True)
    ]


def table(covered: Coverage, identified: Sequence[record.TorqueRange]) -> list[str]:
    """Return a table for the terminal: covered torques by joint and sign, next to those of the identification.

    :param identified: torques that the model was identified with; empty if the model does not record them.
    """
    lines = [f"torques that the loads put on the joints, N·m; in brackets: configurations, {ENOUGH} cover a direction"]
    head = f"{'':>4}{'negative':>16}{'positive':>16}"
    lines.append(head + (f"{'identified with':>24}" if identified else ""))
    for joint, name in enumerate(JOINTS):
        cells = [_cell(covered, joint, side) for side in (0, 1)]
        row = f"{name:>4}{cells[0]:>16}{cells[1]:>16}"
        if identified:
            own = identified[joint]
            row += f"{f'{own.negative_Nm:.0f} … {own.positive_Nm:.0f}':>24}"
        lines.append(row)
    if not identified:
        lines.append("the model does not record which torques it was identified with")
    one_sided = [
        f"{name} {' and '.join(sign for sign, there in zip(SIGNS, sides, strict=True) if not there)}"
        for name, sides in zip(JOINTS, covered.covered, strict=True)
        if not sides.all()
    ]
    if one_sided:
        lines.append(f"not covered: torques on {', '.join(one_sided)}")
    return lines


def _cell(covered: Coverage, joint: int, side: int) -> str:
    count = int(covered.configurations[joint, side])
    if count == 0:
        return "none"
    value = f"{(-1.0, 1.0)[side] * covered.largest[joint, side]:.0f} ({count})"
    return f"{value} off" if covered.refuted[joint, side] else value


def job_lines(jobs: Sequence[JobShare]) -> list[str]:
    """Return lines for the terminal: covered share of each program, and the reasons for the rest."""
    lines = []
    for job in jobs:
        lines.append(f"{job.program}: {job.share:.0%} of the cutting path is inside these torques")
        lines += [f"  outside {each.share:.0%}: {each.reason}" for each in job.outside]
    return lines
