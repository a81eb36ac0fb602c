"""A plan of measurements as CSV, KRL program, JSON, text and page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from postproc.cell import Cell as CellFile
from postproc.decimals import decimal_text, without_negative_zero
from postproc.dialects.krl.write import axis_motion, document, head
from postproc.files import FileEntry, json_bytes
from postproc.frames import DEG_PER_RAD, MM_PER_M, Array
from postproc.identification.validation import SIGNS
from postproc.plan import PlanResult
from postproc.plan.site import BoxShape
from postproc.program import WRENCH, Document, Ints
from postproc.report.kit import (
    Axis,
    Cell,
    Curve,
    Histogram,
    Lines,
    Mark,
    Note,
    Notes,
    Page,
    Plot,
    Points,
    Row,
    Section,
    Table,
    Tile,
    Tiles,
)
from postproc.report.kit.parts import Colour
from postproc.robot import JOINTS, WITH_LINKS

_HEADER = "config,A1,A2,A3,A4,A5,A6,Fx,Fy,Fz"
_SPEED_PERCENT = 10
"""Speed of the program in percent of the joint speeds: slow enough to stop by hand (assumed)."""
_ANGLE_DECIMALS = 3
"""Decimals of joint angles [deg], as the controller shows them."""


def plan_csv(result: PlanResult) -> bytes:
    """Return the plan as CSV, ``config,A1…A6,Fx,Fy,Fz``, in the order of least travel.

    Angles in degrees; forces of the whole load in N, root axes, at the load point.
    """
    rows = [_HEADER]
    for number, (q, force) in enumerate(zip(result.plan.q * DEG_PER_RAD, result.force, strict=True), 1):
        angles = ",".join(decimal_text(value, _ANGLE_DECIMALS) for value in q)
        rows.append(f"{number},{angles},{','.join(decimal_text(value, 1) for value in force)}")
    return ("\n".join(rows) + "\n").encode()


def krl_program(result: PlanResult, cell: CellFile, name: str) -> Document:
    """Return the KRL program: for each pose a PTP, a halt without load, and a halt for each of the two loads.

    :param name: name of the program; KRL must allow it.
    """
    lines = [
        *head(name, cell.output.controller),
        f";{len(result.plan)} poses to measure, in the order of least travel (postproc plan)",
        ";Run it in T1: ways between the poses were checked by coarse shapes only.",
        "BAS (#INITMOV,0 )",
        f"BAS (#VEL_PTP,{_SPEED_PERCENT} )",
        axis_motion(cell.start_angles, _ANGLE_DECIMALS),
    ]
    for row, (angles, force) in enumerate(zip(result.plan.q * DEG_PER_RAD, result.force, strict=True)):
        lines += [
            axis_motion(via_angles, _ANGLE_DECIMALS) + " ;on the way, the straight one is blocked"
            for via_angles in result.via[row] * DEG_PER_RAD  # (k, 6) joint angles; k = 0 if the straight way is free
        ]
        if row in result.blocked:  # no way without collision was found to this pose
            lines += [";THE WAY TO THE NEXT POSE IS BLOCKED: stop here, jog the robot there", "HALT"]
        lines += [
            f";configuration {row + 1}: load {_force_text(force)} N, root axes, at the load point",
            f";second load {_force_text(result.second_load * force)} N",
            axis_motion(angles, _ANGLE_DECIMALS),
            "HALT ;measure all points WITHOUT load, then put the second, small load on",
            "HALT ;measure all points WITH the second load, then put the whole load on",
            "HALT ;measure all points WITH the whole load, then take it off",
        ]
    lines.append(axis_motion(cell.start_angles, _ANGLE_DECIMALS))
    return document(name, lines)


def _force_text(force: Array) -> str:
    """Return a force (3,) [N] as text, such as "Fx 0.0 Fy 100.0 Fz 0.0"."""
    return " ".join(f"{axis} {without_negative_zero(value):.1f}" for axis, value in zip(WRENCH[:3], force, strict=True))


def plan_summary(result: PlanResult) -> dict[str, object]:
    """Return a plan as the content of its JSON file: poses, torques, expected accuracy, comparisons with other plans.

    Lengths are in mm. Criteria are given as square roots: the RMS distance that remains after compensation.
    """
    content: dict[str, object] = {
        "robot": result.robot,
        "configurations": len(result.plan),
        "q2_levels_deg": sorted(round(float(value), 3) for value in result.plan.q2 * DEG_PER_RAD),
        "seed": result.options.seed,
        "second_load": {
            "share": result.second_load,
            "N": result.second_load * result.site.rig.force,
        },
        "torques": _torque_entries(result),
        **_accuracy_content(result),
        "test_poses": {"count": len(result.tests), "source": result.tests.source},
        "travel_s": result.seconds,
        "interrupted": result.interrupted,
        "warnings": list(result.warnings),
    }
    if result.initial_accuracy is not None:
        # infinite if a parameter is unidentifiable from the readings so far; JSON has no infinity
        is_determined = math.isfinite(result.initial_accuracy.rms)
        content["measured_so_far"] = {"rms_mm": result.initial_accuracy.rms * MM_PER_M if is_determined else None}
    return content | _comparison_content(result)


def _criterion_root_mm(criterion: float) -> float:
    """Return the root of the criterion [m²] of a plan in mm: the RMS distance that remains after compensation."""
    return float(np.sqrt(criterion)) * MM_PER_M


def _uncompensated_rms_mm(result: PlanResult) -> float:
    """Return the RMS of the deflections at the test poses, weighted by their shares of the work [mm]."""
    return float(np.sqrt(result.tests.weight @ result.tests.deflection**2)) * MM_PER_M


def _accuracy_content(result: PlanResult) -> dict[str, object]:
    """Return the criterion, the expected errors with and without compensation [mm], and intervals of the parameters."""
    accuracy = result.accuracy  # expected once the plan is measured: errors [m], intervals as shares of the values
    return {
        "criterion": {
            "kind": "grouped" if result.options.grouped else "pooled",
            "rms_mm": _criterion_root_mm(result.plan.value),
        },
        "expected": {
            "rms_mm": accuracy.rms * MM_PER_M,
            "interval95_mm": [value * MM_PER_M for value in accuracy.interval],
            "worst_test_pose_mm": float(accuracy.poses.max()) * MM_PER_M,
        },
        "uncompensated": {
            "rms_mm": _uncompensated_rms_mm(result),
            "max_mm": float(result.tests.deflection.max()) * MM_PER_M,
        },
        "parameters": [
            {"name": parameter.symbol, "ci95_percent": float(half_width) * 100.0}
            for parameter, half_width in zip(accuracy.parameters, accuracy.relative_half_widths, strict=True)
        ],
    }


def _torque_entries(result: PlanResult) -> list[dict[str, object]]:
    """Return an entry for each joint: torques of the loads [N·m], poses by their sign, and torques of the work."""
    low, high = torque_extremes(result)
    # work: sizes (6, 2) of the torques of the work to the negative and to the positive side
    counts, work = pose_counts_by_side(result), result.directions.work_torque

    def values_by_sign(name: str, values: Iterable[float]) -> dict[str, float]:
        """Return the values of the negative and the positive side by key: `name` with the sign in place of `{}`."""
        return {name.format(sign): value for sign, value in zip(SIGNS, values, strict=True)}

    return [
        {
            "joint": joint,
            **values_by_sign("{}_Nm", (float(low[k]), float(high[k]))),
            **values_by_sign("{}_poses", counts[k].tolist()),
            **values_by_sign("work_{}_Nm", (float(without_negative_zero(-work[k, 0])), float(work[k, 1]))),
        }
        for k, joint in enumerate(JOINTS)
    ]


def _comparison_content(result: PlanResult) -> dict[str, object]:
    """Return the parts of the content on random plans, the serial approach, and other numbers of poses.

    A part is left out if it was not computed.
    """
    plan_mm = _criterion_root_mm(result.plan.value)
    random_mm = np.sqrt(result.random) * MM_PER_M  # (R,) of random plans
    content: dict[str, object] = {}
    if len(random_mm):
        content["random"] = {
            "plans": len(random_mm),
            "best_rms_mm": float(random_mm.min()),
            "median_rms_mm": float(np.median(random_mm)),
            "gain_over_best": float(random_mm.min()) / plan_mm,
            "gain_over_median": float(np.median(random_mm)) / plan_mm,
        }
    if result.serial is not None:
        serial_mm = _criterion_root_mm(result.serial.value)
        content["serial_approach"] = {"rms_mm": serial_mm, "gain": serial_mm / plan_mm}
    if result.sizes:
        content["sizes"] = [
            {
                "configurations": size.configurations,
                "rms_mm": _criterion_root_mm(size.value),
                "random_median_rms_mm": _criterion_root_mm(size.random),
            }
            for size in result.sizes
        ]
    return content


def pose_counts_by_side(result: PlanResult) -> Ints:
    """Return the numbers of poses (6, 2) that load each joint to the negative (0) and to the positive side (1)."""
    return np.asarray(result.directions.loaded_sides(result.torque).sum(axis=0))


def torque_extremes(result: PlanResult) -> tuple[Array, Array]:
    """Return the largest negative and the largest positive torque (6,) of the loads on each joint [N·m].

    0 for a joint that no load turns to that side.
    """
    return without_negative_zero(np.minimum(result.torque.min(axis=0), 0.0)), np.maximum(result.torque.max(axis=0), 0.0)


def plan_json(result: PlanResult, files: Sequence[FileEntry]) -> bytes:
    """Return `plan_summary` as JSON.

    :param files: entries of the files written with it.
    """
    content = {**plan_summary(result), "files": files}
    return json_bytes(content)


def plan_lines(result: PlanResult) -> list[str]:
    """Return the summary of a plan as lines to print."""
    low, high = (limit * MM_PER_M for limit in result.accuracy.interval)
    force = result.site.rig.force
    levels = ", ".join(f"{angle:.1f}" for angle in np.sort(np.unique(result.plan.q[:, 1])) * DEG_PER_RAD)
    torques = ", ".join(
        f"{joint} {smallest:.0f} … {largest:.0f}"
        for joint, smallest, largest in zip(JOINTS, *torque_extremes(result), strict=True)
    )
    names = " and ".join(result.unobservable)
    exception = f", but for that by {names}, which this rig does not show" if names else ""
    return [
        f"{len(result.plan)} poses, A2 at {levels}°; {len(result.tests)} test poses from {result.tests.source}",
        f"each under two loads: {force:.0f} N as planned, and {result.second_load:.0%} of it, "
        f"{result.second_load * force:.0f} N, in the same direction: as near to the work "
        "as the readings allow",
        f"torques of the loads: {torques} N·m",
        f"expected error after compensation{exception}: {result.accuracy.rms * MM_PER_M:.3g} mm RMS "
        f"(95 %: {low:.3g} … {high:.3g}); without compensation: {_uncompensated_rms_mm(result):.3g} mm",
        *_comparison_lines(result),
        *(["interrupted: this is the best plan so far"] if result.interrupted else []),
    ]


def _comparison_lines(result: PlanResult) -> Iterator[str]:
    """Yield lines on the error with the readings so far, on random plans, and on the plan of the serial approach.

    A line is left out if its comparison was not computed.
    """
    plan_mm = _criterion_root_mm(result.plan.value)
    if result.initial_accuracy is not None:
        error = f"{result.initial_accuracy.rms * MM_PER_M:.3g} mm RMS"
        if not math.isfinite(result.initial_accuracy.rms):
            error = "unknown, it does not determine every parameter"
        yield f"with what was measured so far alone: {error}"
    if len(result.random):
        random_mm = np.sqrt(result.random) * MM_PER_M  # (R,) of random plans
        median_mm = np.median(random_mm)
        yield (
            f"criterion {plan_mm:.3g} mm; {len(random_mm)} random plans: best {random_mm.min():.3g}, median "
            f"{median_mm:.3g} mm ({median_mm / plan_mm:.2f} × the plan's)"
        )
    if result.serial is not None:
        serial_mm = _criterion_root_mm(result.serial.value)
        yield f"semi-intuitive plan of the serial approach: {serial_mm:.3g} mm ({serial_mm / plan_mm:.2f} × the plan's)"


_ARROW_LENGTH = 0.45
"""Length of the arrow of a load in the picture [m] (assumed)."""
_BOX_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]
"""Edges of a box: pairs of its corners, numbered by three bits (high or low X, Y, Z), that differ in one bit."""


def poses_section(result: PlanResult) -> Section:
    """Return the section with all poses in one view in space, and a slider that shows them one by one."""
    site, count = result.site, len(result.plan)
    points = site.arm.pose(result.plan.q).point(site.points)
    arms, loads = _drawn_arms(result)
    surroundings = _drawn_surroundings(result)
    single_poses = [
        trace
        for pose in range(count)
        for trace in (
            _line_with_gaps([arms[pose]], f"pose {pose + 1}", "after", 8.0),
            _line_with_gaps([loads[pose]], "pull of the load", "before", 6.0),
            _line_with_gaps([points[pose]], "reference points", "ink", 3.0, dots=True),
        )
    ]
    all_poses = [
        _line_with_gaps(list(arms), "arms", "after", 5.0),
        _line_with_gaps(list(loads), "pull of the loads", "before", 3.0),
    ]
    traces = [*surroundings, *all_poses, *single_poses]
    # a step shows traces by their rows in `traces`: surroundings, then two of all poses, then three of each pose
    surrounding_rows = list(range(len(surroundings)))
    begin = len(surroundings) + len(all_poses)
    rows_of_all_poses = list(range(len(surroundings), begin))
    rows_of_pose = [list(range(begin + 3 * pose, begin + 3 * pose + 3)) for pose in range(count)]
    steps = [[*surrounding_rows, *rows] for rows in (rows_of_all_poses, *rows_of_pose)]
    plot = Plot(
        label="The arm in all poses of the plan, and in each; angles and loads are in the table below",
        traces=list(traces),
        height=560,
        steps=steps,
        step_names=["all", *(f"{pose + 1}" for pose in range(count))],
        note="Drag to turn, wheel to zoom; the slider shows one pose after the other. Orange: pull of the load; dots: "
        "reference points. Metres, robot root.",
    )
    return Section("poses", "The poses", (plot,))


def _drawn_arms(result: PlanResult) -> tuple[Array, Array]:
    """Return the arms and the loads of n poses as points [m], robot root.

    :returns: arms (n, k, 3), points from the root to the load point; loads (n, 2, 3), start and end of an arrow.
    """
    arm_poses = result.site.arm.pose(result.plan.q)
    origin = arm_poses.origin
    base = np.zeros_like(origin[:, :1])
    column = np.concatenate([base[..., :2], origin[:, 1:2, 2:]], axis=2)  # upright above the root, to joint 2
    hook = arm_poses.point(result.site.load_point[None])
    arms = np.concatenate([base, column, origin[:, 1:5], arm_poses.flange[:, None, :3, 3], hook], axis=1)
    pull = result.force / np.linalg.norm(result.force, axis=1, keepdims=True)
    return arms, np.stack([hook[:, 0], hook[:, 0] + _ARROW_LENGTH * pull], axis=1)


def _drawn_surroundings(result: PlanResult) -> list[Lines]:
    """Return the obstacles as edges of boxes, and the tracker as a dot; empty if the site has neither."""
    site, surroundings = result.site, list[Lines]()
    if site.obstacles:
        edges = [_box_corners(obstacle)[[start, end]] for obstacle in site.obstacles for start, end in _BOX_EDGES]
        surroundings.append(_line_with_gaps(edges, "obstacles", "warning", 2.0))
    if site.tracker is not None:
        surroundings.append(_line_with_gaps([site.tracker[None]], "tracker", "force", 6.0, dots=True))
    return surroundings


def _line_with_gaps(pieces: list[Array], name: str, colour: Colour, width: float, *, dots: bool = False) -> Lines:
    """Return pieces of any number of points (n, 3) [m] as one line in space, with gaps between the pieces.

    :param width: width of the line, or diameter of the dots [px].
    :param dots: draw the points as dots instead of a line.
    """
    gap = np.full((1, 3), np.nan)
    points = np.concatenate([part for piece in pieces for part in (piece, gap)] or [gap])
    x, y, z = (points[:, axis].tolist() for axis in range(3))
    return Lines(x, y, z, name, colour, width, dots)


def _box_corners(obstacle: object) -> Array:
    """Return the eight corners (8, 3) of a box, or of the box around a mesh [m], robot root.

    Bit k of the number of a corner says whether it is at the high end along axis k, as `_BOX_EDGES` expects.
    """
    signs = np.array([[1 if corner >> axis & 1 else -1 for axis in range(3)] for corner in range(8)])
    if isinstance(obstacle, BoxShape):
        # x_box = R x + t, so that x = Rᵀ (x_box − t); rows are multiplied from the left
        rotation, translation = obstacle.to_box[:3, :3], obstacle.to_box[:3, 3]
        return np.asarray((signs * obstacle.half - translation) @ rotation)
    vertices = obstacle.vertices  # type: ignore[attr-defined]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.asarray(0.5 * (low + high) + 0.5 * signs * (high - low))


_WELL_KNOWN_SHARE = 0.1
"""Half width of an interval, as a share of the value, that is marked as good (assumed)."""
_BINS = 60
"""Bars of the histogram."""


def expected_section(result: PlanResult) -> Section:
    """Return the section on the expected accuracy of the planned measurements."""
    low, high = (limit * MM_PER_M for limit in result.accuracy.interval)
    tiles = [
        Tile(
            "After compensation, RMS",
            f"{result.accuracy.rms * MM_PER_M:.3g}",
            "mm",
            f"95 %: {low:.3g} … {high:.3g} mm",
        ),
        Tile("Without compensation, RMS", f"{_uncompensated_rms_mm(result):.3g}", "mm"),
    ]
    if len(result.random):
        gain = np.sqrt(np.median(result.random) / result.plan.value)
        tiles.append(Tile("Better than the median of random plans", f"{gain:.2f}", "×"))
    tiles.append(Tile("Least travel, joints at full speed", f"{result.seconds:.0f}", "s"))
    return Section("expected", "What to expect", (Tiles(tuple(tiles)),))


def warnings_section(result: PlanResult) -> Section | None:
    """Return the section with the warnings; None if there are no warnings."""
    if not result.warnings:
        return None
    notes = tuple(Note(f"{text}.", "warning") for text in result.warnings)
    return Section("warnings", "Before you measure", (Notes(notes, bulleted=True),))


def comparison_section(result: PlanResult) -> Section | None:
    """Return the section with the histogram of the criterion of random plans, and where this plan is [mm].

    None without random plans.
    """
    if not len(result.random):
        return None
    random = np.sqrt(result.random) * MM_PER_M
    criterion = _criterion_root_mm(result.plan.value)
    serial = None if result.serial is None else _criterion_root_mm(result.serial.value)
    # some random plans are hopeless: the picture shows 97 % of them; the others are counted in the last bar
    largest_shown = max(float(np.quantile(random, 0.97)), serial or 0.0, criterion) * 1.05  # with a margin of 5 %
    counts, edges = np.histogram(np.clip(random, 0.0, largest_shown), bins=_BINS, range=(0.0, largest_shown))
    median = float(np.median(random))
    marks = [
        Mark(criterion, f"this plan {criterion:.3g}", "after"),
        Mark(median, f"median of random plans {median:.3g}", "before"),
    ]
    marks += [] if serial is None else [Mark(serial, f"semi-intuitive plan {serial:.3g}", "before")]
    best = f"The best of {len(random)} random plans has {random.min():.3g} mm, this one {criterion:.3g} mm"
    intuitive = "" if serial is None else f", the semi-intuitive plan of the serial approach {serial:.3g} mm"
    plot = Plot(
        label="Histogram of the criterion of random plans; this plan is marked",
        traces=[Histogram(edges.tolist(), counts.tolist(), "random plans")],
        x=Axis(title="criterion (root: RMS distance that remains), mm", range=(0.0, largest_shown)),
        y=Axis(title="number of plans"),
        marks=marks,
        note=f"{best}{intuitive}. Random plans: levels, poses and loads at random among those that can be measured. "
        "Semi-intuitive: well-conditioned poses, far apart, on evenly spaced levels.",
    )
    return Section("comparison", "Among other plans of the same size", (plot,))


def sizes_section(result: PlanResult) -> Section | None:
    """Return the section with the criterion [mm] over the number of poses; None if only one number was planned."""
    if len(result.sizes) < 2:
        return None
    number = [float(size.configurations) for size in result.sizes]
    criterion = (np.sqrt([size.value for size in result.sizes]) * MM_PER_M).tolist()
    random = (np.sqrt([size.random for size in result.sizes]) * MM_PER_M).tolist()
    plan_point = [(n, root) for n, root in zip(number, criterion, strict=True) if n == len(result.plan)]
    # random plans of few poses may be hopeless: the axis ends at four times the best plans, with a margin of 5 %
    high = min(max(random), 4.0 * max(criterion)) * 1.05
    plot = Plot(
        label="Criterion against the number of poses, for the best plans found and for random ones",
        traces=[
            Curve(number, random, "random plans, median", "before", dots=True, dashed=True),
            Curve(number, criterion, "best plan found", "after", dots=True),
            Points([n for n, _ in plan_point], [root for _, root in plan_point], "this plan", "ink", hollow=True),
        ],
        x=Axis(title="number of poses"),
        y=Axis(title="criterion (root), mm", range=(0.0, high)),
        note="Other sizes by a shorter search, good to some per cent. Once the curve falls with the root of the number "
        "only, further poses merely average out noise.",
    )
    return Section("sizes", "How many poses pay", (plot,))


def angles_section(result: PlanResult) -> Section:
    """Return the section with the table of joint angles [deg] and loads [N] of the poses, in the order of the plan."""
    head = ("Pose", *(f"{joint}, °" for joint in JOINTS), "Fx, N", "Fy, N", "Fz, N")
    rows = tuple(
        Row(
            (
                str(row),
                *(f"{without_negative_zero(angle):.3f}" for angle in q),
                *(f"{without_negative_zero(component):.1f}" for component in force),
            )
        )
        for row, (q, force) in enumerate(zip(result.plan.q * DEG_PER_RAD, result.force, strict=True), 1)
    )
    note = "In the order of least travel. Loads act on the load point, root axes."
    return Section("angles", "Angles and loads", (Table(head, rows, "Angles and loads of each pose", note=note),))


def tests_section(result: PlanResult) -> Section:
    """Return the section with the table of the test poses, the largest share of the work first."""
    order = np.argsort(-result.tests.weight, kind="stable")
    rows = tuple(
        Row(
            (
                str(rank),
                f"{100 * result.tests.weight[row]:.1f}",
                f"{np.linalg.norm(result.tests.wrench[row, :3]):.0f}",
                f"{result.tests.deflection[row] * MM_PER_M:.3f}",
                f"{result.accuracy.poses[row] * MM_PER_M:.3g}",
            )
        )
        for rank, row in enumerate(order, 1)
    )
    head = ("Test pose", "Share, %", "Force, N", "Deflection, mm", "Expected to remain, mm")
    note = f"They represent all cutting moves (Σ w A₀ᵀA₀ agrees to {100 * result.moment_error:.2g} %)."
    table = Table(head, rows, "Test poses", sortable=True, note=note)
    return Section("tests", "Test poses: where it will be milled", (table,), "half")


def parameters_section(result: PlanResult) -> Section:
    """Return the section with the expected 95 % interval of each parameter, as a share of its value."""
    rows = tuple(
        Row(
            (
                parameter.symbol,
                Cell(f"± {_percent_text(float(half))}", "good" if half <= _WELL_KNOWN_SHARE else "warning"),
            )
        )
        for parameter, half in zip(result.accuracy.parameters, result.accuracy.relative_half_widths, strict=True)
    )
    note = (
        "Of the robot's present value. A plan made for the work at hand may leave wide what the work does not need. "
        f"{WITH_LINKS}: the intervals are of that sum."
    )
    table = Table(("Parameter", "95 % interval"), rows, "Expected intervals of the parameters", note=note)
    return Section("parameters", "Parameters", (table,), "half")


def torques_section(result: PlanResult) -> Section:
    """Return the section with the torques [N·m] of the loads on the joints, by sign, and those of the work."""
    low, high = torque_extremes(result)
    work, count = result.directions.work_torque, pose_counts_by_side(result)
    rows = tuple(
        Row(
            (
                joint,
                Cell(f"{low[row]:.0f} ({count[row, 0]})", "good" if count[row, 0] else "warning"),
                Cell(f"{high[row]:.0f} ({count[row, 1]})", "good" if count[row, 1] else "warning"),
                f"{without_negative_zero(-work[row, 0]):.0f} … {work[row, 1]:.0f}",
            )
        )
        for row, joint in enumerate(JOINTS)
    )
    note = (
        "Of the load alone, N·m; in brackets the poses that load the joint to that side by about the torque of the "
        "work or more. Lost motion and preload of a gear show only where it is loaded to both sides."
    )
    head = ("Joint", "negative (poses)", "positive (poses)", "work")
    return Section(
        "torques", "Torques on the joints", (Table(head, rows, "Torques by joint and sign", note=note),), "half"
    )


def _percent_text(half_width: float) -> str:
    """Return the half width of an interval, a share of the value, in percent; "unbounded" from 10 on (assumed)."""
    return f"{100 * half_width:.2g} %" if half_width < 10.0 else "unbounded"


SECTIONS: tuple[Callable[[PlanResult], Section | None], ...] = (
    expected_section,
    warnings_section,
    poses_section,
    angles_section,
    comparison_section,
    sizes_section,
    tests_section,
    parameters_section,
    torques_section,
)
"""Functions of the sections of the page, in order; a section without content is None."""


def plan_page(result: PlanResult, name: str) -> bytes:
    """Return the page of a plan as HTML in UTF-8: one file that loads nothing.

    :param name: name of the plan, for the head of the page.
    """
    criterion_text = (
        "Criterion as printed in the paper: each level of q2 identified alone."
        if result.options.grouped
        else "Criterion: covariance of Eq. (8), shared by the levels; k2 at a test pose from them by Eq. (9), (10)."
    )
    footer = (
        Note(
            f"{criterion_text} The expected accuracy is that of an identification which weights all readings by their "
            "noise. It counts the noise of the readings only: what the model does not describe comes on top. "
            f"Seed {result.options.seed}; the same seed and files give the same plan."
        ),
    )
    sections = tuple(section for section_of in SECTIONS if (section := section_of(result)) is not None)
    return b"".join(Page("Plan of measurements", name, _subtitle(result), sections, footer).render())


def _subtitle(result: PlanResult) -> str:
    """Return robot, number of poses, load and source of the test poses of a plan in one line."""
    levels = len(np.unique(result.plan.level))
    interruption = " · search interrupted: the best plan so far" if result.interrupted else ""
    addition = " in addition to those measured" if result.initial_accuracy is not None else ""
    return (
        f"{result.robot} · {len(result.plan)} poses{addition} on {levels} levels of q2 · "
        f"load {result.site.rig.force:.0f} N · test poses from {result.tests.source}{interruption}"
    )
