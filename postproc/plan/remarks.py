"""What the user should know before measuring: what the rig cannot show, what stays uncertain, what was not checked."""

from __future__ import annotations

import numpy as np

from postproc.errors import PlanError
from postproc.frames import MM_PER_M, Array
from postproc.plan.accuracy import Accuracy
from postproc.plan.criterion import Joint2
from postproc.plan.milling import TestPoses
from postproc.plan.site import Site
from postproc.program import Ints
from postproc.robot import JOINT_COMPLIANCES, JointCompliance

NO_TORQUES = (
    "static joint torques are not checked: robot.urdf states no limits (effort) and [rig] no max_torque_Nm; see that "
    "the robot may carry the load"
)
NO_TRACKER = "line of sight is not checked: the experiment has no [tracker]"
VERTICAL = 0.02
"""Largest angle [rad] of a load that counts as vertical."""
_LEAST_SHARE, _LARGEST_SHARE = 0.1, 0.4
"""Second load over the weight: less is lost in the noise, more adds no other information than the weight."""


def hidden_by_rig(site: Site, tests: TestPoses, scale: Array, missing: tuple[int, ...]) -> tuple[str, ...]:
    """Say which compliances the rig cannot show, why, what to do, and how much of the milling rests on them.

    :param scale: (6,) compliances of the robot [rad/(N·m)].
    :param missing: joints, counted from 0.
    :raises PlanError: the load shows nothing at all.
    """
    if 1 in missing:
        raise PlanError(
            "the load is too small: not even the compliance of A2 can be seen in the readings",
            advice="Use a heavier weight ([rig] mass_kg) or a better measuring device (sigma_mm).",
        )
    out = []
    for joint in missing:
        moved = np.sum(tests.regressor[:, :, joint] ** 2, axis=1)
        share = float(np.sqrt(tests.weight @ moved)) * scale[joint] * MM_PER_M
        reason, advice = "the load puts too little torque on it", "Use a heavier weight."
        if joint == 0 and site.rig.largest_tilt < VERTICAL:
            reason = "every load it can apply hangs vertically, parallel to the axis of A1"
            advice = "Pull sideways too, by a cable over a pulley ([rig] max_angle_deg)."
        elif joint == 5:
            reason = "the load acts on the axis of A6"
            advice = "Hang the load at a distance from that axis, on a bracket ([load_point])."
        name = JOINT_COMPLIANCES[joint].name
        out.append(
            f"{name} is not observable with this rig: {reason}. {advice} As it is, the identification keeps the "
            f"robot's own value; {share:.3g} mm (RMS) of the deflection at the test poses rest on it, and the expected "
            "accuracy does not count how wrong it may be"
        )
    return tuple(out)


def second_load(site: Site, tests: TestPoses) -> float:
    """Return the second load of each pose over its first: as near to the force of the work as makes sense.

    Gears that stiffen, knees and backlash show in how displacements under two loads differ, and near the force of the
    work as the work feels them.
    """
    work = float(np.sqrt(tests.weight @ np.sum(tests.wrench[:, :3] ** 2, axis=1)))
    return float(np.clip(work / site.rig.force, _LEAST_SHARE, _LARGEST_SHARE))


def left_uncertain(found: Accuracy, joint2: Joint2, blocked: Ints) -> list[str]:
    """Say what stays uncertain with the plan.

    :param blocked: rows that the robot cannot reach on a free way.
    """
    out = []
    uncertain = [p.name for p in found.uncertain if isinstance(p, JointCompliance)]
    if uncertain:
        out.append(
            f"{', '.join(uncertain)}: the 95 % interval will be wider than half the value, so that the identification "
            "keeps the robot's own. If the programs need it, plan more poses, more weight or more repeats"
        )
    if joint2.compensator is not None and not joint2.free:
        out.append(
            "the spring of the gravity compensator (K_c, s_0) cannot be determined from such measurements: the "
            "identification keeps the robot's values"
        )
    if len(blocked):
        rows = ", ".join(str(row + 1) for row in blocked)
        out.append(f"the robot would hit something on its way to configuration {rows}: jog it there by hand")
    return out
