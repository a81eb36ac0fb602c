"""A plan of measurements as CSV and JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import numpy as np

from postproc.files import FileEntry
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array
from postproc.identification.coverage import SIGNS
from postproc.plan import PlanResult
from postproc.program import Ints
from postproc.robot import JOINTS

_HEADER = "config,A1,A2,A3,A4,A5,A6,Fx,Fy,Fz"


def plan_csv(result: PlanResult) -> bytes:
    """Return ``config,A1…A6,Fx,Fy,Fz``: deg; N, root axes, at the load point; in the order of least travel."""
    rows = [_HEADER]
    for number, (q, force) in enumerate(zip(result.plan.q * DEG_PER_RAD, result.force, strict=True), 1):
        angles = ",".join(_fixed(value, 3) for value in q)
        rows.append(f"{number},{angles},{','.join(_fixed(value, 1) for value in force)}")
    return ("\n".join(rows) + "\n").encode()


def plan_summary(result: PlanResult) -> dict[str, object]:
    """Return what the plan is worth as plain data; lengths in mm.

    Criteria are given as square roots: the RMS distance that remains after compensation.
    """
    own = float(np.sqrt(result.plan.value)) * MM_PER_M
    random = np.sqrt(result.random) * MM_PER_M
    out: dict[str, object] = {
        "robot": result.robot,
        "configurations": len(result.plan),
        "q2_levels_deg": sorted(round(float(value), 3) for value in result.plan.q2 * DEG_PER_RAD),
        "seed": result.options.seed,
        "second_load": {
            "share": result.second_load,
            "N": result.second_load * result.site.rig.force,
        },
        "torques": [
            {
                "joint": joint,
                **{f"{sign}_Nm": float(value) for sign, value in zip(SIGNS, (low, high), strict=True)},
                **{f"{sign}_poses": int(number) for sign, number in zip(SIGNS, count, strict=True)},
                **{
                    f"work_{sign}_Nm": float(value)
                    for sign, value in zip(SIGNS, (-work[0] + 0.0, work[1]), strict=True)
                },
            }
            for joint, low, high, count, work in zip(
                JOINTS, *extremes(result), poses_by_side(result), result.directions.work, strict=True
            )
        ],
        "criterion": {"kind": "grouped" if result.options.grouped else "pooled", "rms_mm": own},
        "expected": {
            "rms_mm": result.accuracy.rms * MM_PER_M,
            "interval95_mm": [value * MM_PER_M for value in result.accuracy.interval],
            "worst_test_pose_mm": float(result.accuracy.poses.max()) * MM_PER_M,
        },
        "uncompensated": {
            "rms_mm": float(np.sqrt(result.tests.weight @ result.tests.deflection**2)) * MM_PER_M,
            "max_mm": float(result.tests.deflection.max()) * MM_PER_M,
        },
        "parameters": [
            {"name": name, "ci95_percent": float(half) * 100.0}
            for name, half in zip((p.symbol for p in result.accuracy.parameters), result.accuracy.relative, strict=True)
        ],
        "test_poses": {"count": len(result.tests), "source": result.tests.source},
        "travel_s": result.seconds,
        "interrupted": result.interrupted,
        "warnings": list(result.warnings),
    }
    if result.before is not None:
        known = math.isfinite(result.before.rms)  # not while a parameter cannot be told from the readings so far
        out["measured_so_far"] = {"rms_mm": result.before.rms * MM_PER_M if known else None}
    if len(random):
        out["random"] = {
            "plans": len(random),
            "best_rms_mm": float(random.min()),
            "median_rms_mm": float(np.median(random)),
            "gain_over_best": float(random.min()) / own,
            "gain_over_median": float(np.median(random)) / own,
        }
    if result.serial is not None:
        serial = float(np.sqrt(result.serial.value)) * MM_PER_M
        out["serial_approach"] = {"rms_mm": serial, "gain": serial / own}
    if result.sizes:
        out["sizes"] = [
            {
                "configurations": size.configurations,
                "rms_mm": float(np.sqrt(size.value)) * MM_PER_M,
                "random_median_rms_mm": float(np.sqrt(size.random)) * MM_PER_M,
            }
            for size in result.sizes
        ]
    return out


def poses_by_side(result: PlanResult) -> Ints:
    """Return how many poses (6, 2) load each joint to its negative and to its positive side."""
    return np.asarray(result.directions.counted(result.torque).sum(axis=0))


def extremes(result: PlanResult) -> tuple[Array, Array]:
    """Return the largest negative and positive torques (6,) of the loads, 0 where there is none [N·m]."""
    return np.minimum(result.torque.min(axis=0), 0.0) + 0.0, np.maximum(result.torque.max(axis=0), 0.0)


def plan_json(result: PlanResult, files: Sequence[FileEntry]) -> bytes:
    """Return `plan_summary` as JSON.

    :param files: written with it.
    """
    content = {**plan_summary(result), "files": files}
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def plan_lines(result: PlanResult) -> list[str]:
    """Return what a user wants to know at once, as lines of text."""
    low, high = (value * MM_PER_M for value in result.accuracy.interval)
    own = float(np.sqrt(result.plan.value)) * MM_PER_M
    uncompensated = float(np.sqrt(result.tests.weight @ result.tests.deflection**2)) * MM_PER_M
    levels = ", ".join(f"{value:.1f}" for value in np.sort(np.unique(result.plan.q[:, 1])) * DEG_PER_RAD)
    lines = [
        f"{len(result.plan)} poses, A2 at {levels}°; {len(result.tests)} test poses from {result.tests.source}",
        f"each under two loads: {result.site.rig.force:.0f} N as planned, and {result.second_load:.0%} of it, "
        f"{result.second_load * result.site.rig.force:.0f} N, in the same direction: as near to the work "
        "as readings tell",
        "torques of the loads: "
        + ", ".join(f"{n} {a:.0f} … {b:.0f}" for n, a, b in zip(JOINTS, *extremes(result), strict=True))
        + " N·m",
        f"expected error after compensation: {result.accuracy.rms * MM_PER_M:.3g} mm RMS "
        f"(95 %: {low:.3g} … {high:.3g}); without compensation: {uncompensated:.3g} mm",
    ]
    if result.before is not None:
        alone = f"{result.before.rms * MM_PER_M:.3g} mm RMS"
        if not math.isfinite(result.before.rms):
            alone = "unknown, it does not determine every parameter"
        lines.append(f"with what was measured so far alone: {alone}")
    if len(result.random):
        random = np.sqrt(result.random) * MM_PER_M
        lines.append(
            f"criterion {own:.3g} mm; {len(random)} random plans: best {random.min():.3g}, median "
            f"{np.median(random):.3g} mm ({np.median(random) / own:.2f} × the plan's)"
        )
    if result.serial is not None:
        serial = float(np.sqrt(result.serial.value)) * MM_PER_M
        lines.append(f"semi-intuitive plan of the serial approach: {serial:.3g} mm ({serial / own:.2f} × the plan's)")
    if result.interrupted:
        lines.append("interrupted: this is the best plan so far")
    return lines


def _fixed(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text if float(text) != 0.0 else f"{0.0:.{decimals}f}"
