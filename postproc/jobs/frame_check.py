"""`postproc check frames`: which frame of the cell is off, by points that the tip touched.

A touched point is known in `$BASE` (from the drawing of the part), and the joint angles at which the tip touches it are
read from the controller. A wrong `$TOOL` shifts the tip by one vector in the axes of the flange, a wrong `$BASE` shifts
and turns all points together. Both are linear in small errors:

    r_i = R_i d + t + ω × (p_i − c)

r_i: touched minus expected point in the root, R_i: orientation of the flange, d: what `$TOOL` of the cell is too long
by, t and ω: displacement and rotation of the points from where `$BASE` of the cell has them, p_i: points, c: their
centre. With `frames = "model"` in the cell, the tip is where the robot model has it at rest: the frames are then those
of the arm with its errors, as corrections need them. Least squares, and a χ² test with the standard deviation of a
touch, decide which of "none", "tool", "base", "both" is the simplest that explains the points (W. H. Press et al.,
*Numerical Recipes*, 3rd ed., section 15.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from scipy.special import gammaincinv

from postproc import cell as cells
from postproc import kinematics
from postproc.errors import InputError
from postproc.files import read_csv
from postproc.frames import (
    DEG_PER_RAD,
    M_PER_MM,
    MM_PER_M,
    RAD_PER_DEG,
    Array,
    angle_between,
    norm,
    rotation_from_vector,
    xyzabc_from_pose,
)
from postproc.jobs.programs import load_robot
from postproc.robot import JOINTS
from postproc.under_load import RobotInCell

Suspect = Literal["none", "tool", "base", "both", "contradiction", "undecided", "unturned", "one-axis"]
_MIN_POINTS = 3
"""A frame has six unknowns, a point gives three numbers: two leave the turn about their line open."""
_CONFIDENCE = 0.95
"""Chance with which a right frame passes the test of χ²: the usual one."""
_INTERVAL_FACTOR = 1.96
"""Half width of a 95 % interval of a normal number, in standard deviations."""
_LEAST_SPREAD = 0.02
"""Least distance [m] of points from their best line, RMS, at which a rotation of `$BASE` about it shows."""
_LEAST_TURN = 20.0 * RAD_PER_DEG
"""Least rotation of the tool between two touches at which `$TOOL` and `$BASE` are told apart."""
_LEAST_VISIBLE = 0.15
"""Least length of the residuals that 1 mm of `$TOOL` leaves in any direction whatever `$BASE` is [mm]. One of four
touches that is tilted by 20° leaves more, one that is turned about the tool leaves nothing of its length."""
_PRINTED_ZERO = 0.005
"""Errors below this are printed as 0.00 mm."""
_RANK_TOLERANCE = 1e-6
"""Smallest ratio of singular values at which unknowns count as independent."""


class TouchedPoints(Struct, frozen=True, eq=False):
    """Touched points.

    :param name: (n) names of the points; `point`: (n, 3) points in `$BASE` [m].
    :param joints: (n, 6) joint angles at which the tip touches them [rad].
    """

    name: list[str]
    point: Array
    joints: Array


class FrameCheck(Struct, frozen=True, eq=False):
    """Result of a check.

    :param suspect: the frame that is off. ``"undecided"``: `$TOOL` and `$BASE` explain the points equally well.
        ``"unturned"``: no error shows, but the tool was not turned. ``"one-axis"``: no error shows, but the tool was
        turned about one axis only. ``"contradiction"``: errors of the frames do not explain the points.
    :param distances: (n,) distance of each touched point from its expected place [m].
    :param distances_left: (n,) this distance after the errors of the frames are subtracted [m].
    :param tool: (3,) error of `$TOOL` in the axes of the flange [m], with half widths of 95 % intervals (3,); or None.
    :param base: (3,) displacement of the points by `$BASE` in the root [m], and its half widths; or None.
    :param turn: (3,) rotation of `$BASE` [rad], root axes, and its half widths; or None.
    :param new_frames: frames that agree with the points, by table of the cell: X, Y, Z, A, B, C [mm, deg].
    :param hidden_error: largest error of `$TOOL` (95 %) [m] that an error of `$BASE` may cancel; None: a frame is off.
    :param arm: geometry that gives the tip: that of the controller, or the robot model without load.
    """

    suspect: Suspect
    points: TouchedPoints
    distances: Array
    distances_left: Array
    tool: tuple[Array, Array] | None = None
    base: tuple[Array, Array] | None = None
    turn: tuple[Array, Array] | None = None
    new_frames: dict[str, Array] = {}
    hidden_error: float | None = None
    arm: Literal["controller", "model"] = "controller"


def read_touches(path: Path) -> TouchedPoints:
    """Read touched points: point, X, Y, Z in `$BASE` [mm], A1 … A6 [deg].

    :raises InputError: the file cannot be read, has fewer than three points, or all points are on a line.
    """
    numbers, texts, _ = read_csv(
        path, required_columns=["point", "X", "Y", "Z", *JOINTS], optional=[], error=InputError, text_columns=("point",)
    )
    if len(texts["point"]) < _MIN_POINTS:
        advice = (
            f"Touch at least {_MIN_POINTS} points that are not on one line, one with the tool turned and one with it "
            "tilted."
        )
        raise InputError(f"{len(texts['point'])} points", file=str(path), advice=advice)
    point = np.stack([numbers[axis] for axis in "XYZ"], axis=1) * M_PER_MM
    # second singular value / √n: RMS distance of the points from their best line, in the plane of the points
    spread = np.linalg.svd(point - point.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(point))
    if spread < _LEAST_SPREAD:
        advice = f"Touch points that are {2 * _LEAST_SPREAD * MM_PER_M:g} mm and more off the line through the others."
        problem = "all points are on one line: a rotation of $BASE about it does not show"
        raise InputError(problem, file=str(path), advice=advice)
    joints = np.stack([numbers[joint] for joint in JOINTS], axis=1) * RAD_PER_DEG
    return TouchedPoints(texts["point"], point, joints)


def check_frames(path: Path, cell_file: Path, sigma_mm: float) -> FrameCheck:
    """Return which frame of a cell is off, by touched points.

    :param path: touched points, see `read_touches`.
    :param sigma_mm: standard deviation of a coordinate of a touch, with the accuracy of the robot.
    :raises PostprocError: an input is unusable.
    """
    cell = cells.load(cell_file)
    robot = load_robot(cell.robot, cell.folder)
    touches = read_touches(path)
    flange, _ = kinematics.tcp(robot.nominal, touches.joints, np.eye(4))  # poses (n, 4, 4)
    tool, base = cell.tool.pose(), cell.base.pose()
    if cell.frames == "model":
        no_load = np.zeros((len(touches.joints), 6))
        tip = RobotInCell.of(robot, cell).tip(touches.joints, tool, no_load)
    else:
        tip = (flange @ tool)[:, :3, 3]
    nominal_point = touches.point @ base[:3, :3].T + base[:3, 3]
    check = judge(touches, flange[:, :3, :3], nominal_point, tip, sigma_mm * M_PER_MM)
    new_frames = dict(_frames_by_points(check, tool, base, nominal_point.mean(axis=0)))
    return replace(check, new_frames=new_frames, arm=cell.frames or "controller")


def _frames_by_points(check: FrameCheck, tool: Array, base: Array, centre: Array) -> Iterator[tuple[str, Array]]:
    """Yield the frames that agree with the points: table of the cell, and X, Y, Z, A, B, C (6,) [mm, deg].

    Only frames with an error are yielded. `$BASE` turns about the centre of the points.

    :param tool: (4, 4) `$TOOL` of the cell; `base`: (4, 4) its `$BASE` [m].
    :param centre: (3,) centre of the points in the root [m].
    """
    if check.tool is not None:
        pose = tool.copy()
        pose[:3, 3] -= check.tool[0]
        yield "tool", xyzabc_from_pose(pose[None])[0]
    if check.base is not None and check.turn is not None:
        turn, pose = rotation_from_vector(check.turn[0]), base.copy()
        pose[:3, :3] = turn @ base[:3, :3]
        pose[:3, 3] = centre + turn @ (base[:3, 3] - centre) + check.base[0]
        yield "base", xyzabc_from_pose(pose[None])[0]


def judge(touches: TouchedPoints, flange: Array, nominal_point: Array, tip: Array, sigma: float) -> FrameCheck:
    """Return the simplest explanation of touched points: no error, `$TOOL`, `$BASE` or both, by a χ² test.

    Each explanation is a hypothesis: a matrix whose columns are the residuals by a unit of each error of a frame.

    :param flange: (n, 3, 3) orientation of the flange in the root.
    :param nominal_point: (n, 3) points in the root by `$BASE` of the cell [m].
    :param tip: (n, 3) tip in the root by joint angles and `$TOOL` [m].
    :param sigma: standard deviation of a coordinate [m].
    """
    residual = (tip - nominal_point).ravel()
    lever_arm = nominal_point - nominal_point.mean(axis=0)
    tool_columns = flange.reshape(-1, 3)
    shift_columns = np.tile(np.eye(3), (len(lever_arm), 1))
    turn_columns = np.concatenate([-_cross_matrix(vector) for vector in lever_arm])
    matrices = {
        "none": np.zeros((len(residual), 0)),
        "tool": tool_columns,
        "base": np.hstack([shift_columns, turn_columns]),
        "both": np.hstack([tool_columns, shift_columns, turn_columns]),
    }
    residual_left = {name: _residual_left(matrix, residual) for name, matrix in matrices.items()}
    suspect = _simplest_suspect(matrices, residual_left, sigma)
    visible_length = _smallest_residual(tool_columns, matrices["base"])
    if suspect == "none" and visible_length < _LEAST_VISIBLE:
        suspect = "unturned" if angle_between(flange[:1], flange).max() < _LEAST_TURN else "one-axis"
    # whose errors are stated: two if they explain the points equally well
    hypotheses = {"tool": ("tool",), "base": ("base",), "both": ("both",), "undecided": ("tool", "base")}.get(
        suspect, ()
    )
    errors: dict[str, Any] = {}
    for name in hypotheses:
        errors |= _frame_errors(name, matrices[name], residual, sigma)
    if suspect == "none":
        errors["hidden_error"] = _INTERVAL_FACTOR * sigma / visible_length
    best_hypothesis = hypotheses[0] if hypotheses else "both" if suspect == "contradiction" else "none"
    distances, distances_left = (norm(values.reshape(-1, 3)) for values in (residual, residual_left[best_hypothesis]))
    return FrameCheck(suspect=suspect, points=touches, distances=distances, distances_left=distances_left, **errors)


def _residual_left(matrix: Array, residual: Array) -> Array:
    """Return the residuals (3 n,) [m] that remain after the best-fitting errors of a hypothesis are subtracted.

    :param matrix: (3 n, k) residuals by unit errors; no columns: the hypothesis has no error.
    :param residual: (3 n,) touched minus expected points [m].
    """
    if not matrix.shape[1]:
        return residual
    return np.asarray(residual - matrix @ np.linalg.lstsq(matrix, residual, rcond=_RANK_TOLERANCE)[0])


def _simplest_suspect(matrices: Mapping[str, Array], residual_left: Mapping[str, Array], sigma: float) -> Suspect:
    """Return the simplest hypothesis that the residuals do not contradict by a χ² test.

    "undecided": `$TOOL` and `$BASE` each explain the points. "contradiction": no hypothesis does.

    :param matrices: name of each hypothesis, the simplest first → (3 n, k) residuals by unit errors.
    :param residual_left: hypothesis → residuals (3 n,) that it leaves [m].
    :param sigma: standard deviation of a coordinate [m].
    """
    plausible_suspects: list[Suspect] = []
    for name, matrix in matrices.items():
        rank = np.linalg.matrix_rank(matrix, tol=_RANK_TOLERANCE) if matrix.shape[1] else 0
        degrees_of_freedom = len(matrix) - rank
        chi_square = residual_left[name] @ residual_left[name] / sigma**2
        # the quantile of chi-square: scipy.stats takes long to import
        limit = 2.0 * gammaincinv(0.5 * degrees_of_freedom, _CONFIDENCE)
        if degrees_of_freedom > 0 and chi_square <= limit:
            plausible_suspects.append(name)  # type: ignore[arg-type]
    if not plausible_suspects:
        return "contradiction"
    is_undecided = plausible_suspects[0] == "tool" and "base" in plausible_suspects
    return "undecided" if is_undecided else plausible_suspects[0]


def _smallest_residual(tool_columns: Array, base_columns: Array) -> float:
    """Return the smallest norm of the residuals that a unit error of `$TOOL` leaves after the best fit of `$BASE`.

    Errors of `$TOOL` in the direction of this smallest norm are the hardest to see. It is the smallest singular value
    of the residuals of `$TOOL` without their components along the residuals of `$BASE`.

    :param tool_columns: (3 n, 3) residuals by unit errors of `$TOOL`.
    :param base_columns: (3 n, 6) residuals by unit errors of `$BASE`.
    """
    base_directions, singular_values, _ = np.linalg.svd(base_columns, full_matrices=False)
    base_directions = base_directions[:, singular_values > _RANK_TOLERANCE * singular_values[0]]
    remaining_columns = tool_columns - base_directions @ (base_directions.T @ tool_columns)
    return float(np.linalg.svd(remaining_columns, compute_uv=False)[-1])


def _frame_errors(name: str, matrix: Array, residual: Array, sigma: float) -> dict[str, Any]:
    """Return the least-squares errors of the suspected frames: field of `FrameCheck` → errors (3,), half widths (3,).

    The half widths are those of 95 % intervals. Lengths are in m, the rotation in rad.

    :param name: hypothesis, ``"tool"``, ``"base"`` or ``"both"``.
    :param matrix: (3 n, 3 k) residuals by unit errors; `residual`: (3 n,) touched minus expected points [m].
    :param sigma: standard deviation of a coordinate [m].
    """
    values = np.linalg.lstsq(matrix, residual, rcond=_RANK_TOLERANCE)[0]
    half_widths = (
        _INTERVAL_FACTOR * sigma * np.sqrt(np.diag(np.linalg.pinv(matrix.T @ matrix, rcond=_RANK_TOLERANCE**2)))
    )
    # three columns of the matrix belong to each field, in this order
    fields = {"tool": ["tool"], "base": ["base", "turn"], "both": ["tool", "base", "turn"]}[name]
    return {field: (values[3 * k : 3 * k + 3], half_widths[3 * k : 3 * k + 3]) for k, field in enumerate(fields)}


def _cross_matrix(vector: Array) -> Array:
    """Return the matrix (3, 3) that maps x to vector × x."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


_TOUCH_ADVICE = (
    "Touch two points again: one with the tool turned about its axis by 90°, and one with the tool tilted as far as "
    "you can, 30° at least. Only tilting tells the length of the tool from the height of $BASE."
)
_HEADLINES: dict[Suspect, str] = {
    "none": "Both frames agree with the points.",
    "tool": "$TOOL is off: correct [tool] of the cell and TOOL_DATA of the controller.",
    "base": "$BASE is off: correct [base] of the cell and BASE_DATA of the controller.",
    "both": "$TOOL and $BASE are off.",
    "unturned": "The points agree with both frames together. Errors of $TOOL and $BASE that cancel each other do not "
    f"show. {_TOUCH_ADVICE}",
    "one-axis": "The points agree with both frames together, but the tool was turned about one axis only: errors of "
    "$TOOL along it and of $BASE that cancel each other do not show. Touch a point again with the tool turned about "
    "another axis by 30° at least: tilted, if it was turned about its own. Only tilting tells the length of the tool "
    "from the height of $BASE.",
    "undecided": f"One frame is off, and the points do not show which. {_TOUCH_ADVICE}",
    "contradiction": "Neither frame explains the points: check the points and joint angles, and --sigma.",
}


def _tool_error_text(error: Array, half_widths: Array) -> str:
    """Return the text that says by how much `$TOOL` is too long or too short along X, Y, Z of the flange.

    :param error: (3,) [m]; `half_widths`: (3,) of its 95 % intervals [m].
    """
    return ", ".join(
        f"{axis} {_error_meaning(value)} {abs(value):z.2f} ± {width:.2f} mm"
        for axis, value, width in zip("XYZ", error * MM_PER_M, half_widths * MM_PER_M, strict=True)
    )


def _error_meaning(value: float) -> str:
    """Return what the sign of an error [mm] means; "off by" for an error that is printed as zero."""
    return "off by" if abs(value) < _PRINTED_ZERO else "too long by" if value > 0.0 else "too short by"


def as_text(check: FrameCheck, sigma_mm: float) -> str:
    """Return the result as lines of text for a terminal.

    :param sigma_mm: standard deviation of a coordinate of a touch, as given to `check_frames`.
    """
    lines = [_HEADLINES[check.suspect]]
    if check.hidden_error is not None:
        length = f"{check.hidden_error * MM_PER_M:.2g} mm"
        lines.append(f"  errors of $TOOL up to {length} (95 %) that $BASE makes up for would not show")
    if check.tool is not None:
        lines.append(f"  $TOOL, along the axes of the flange: {_tool_error_text(*check.tool)} (95 %)")
    for description, error, factor, unit in (
        ("the points are displaced by X, Y, Z of the root", check.base, MM_PER_M, "mm"),
        ("and turned about X, Y, Z of the root by", check.turn, DEG_PER_RAD, "°"),
    ):
        if error is not None:
            values = ", ".join(
                f"{value:z.2f} ± {half:.2f}" for value, half in zip(error[0] * factor, error[1] * factor, strict=True)
            )
            lines.append(f"  {description}: {values} {unit} (95 %)")
    for table, frame in check.new_frames.items():
        keys = ", ".join(f"{key} = {value:z.3f}" for key, value in zip("XYZABC", frame, strict=True))
        lines.append(f"  [{table}] that agrees: {keys}")
    rows = zip(check.points.name, check.distances * MM_PER_M, check.distances_left * MM_PER_M, strict=True)
    lines += [f"  {name}: {distance:.2f} mm off, {left:.2f} mm after that" for name, distance, left in rows]
    if check.arm == "model":
        lines.append('  the tip is where the robot model has it without forces (frames = "model" in the cell)')
    lines.append(f"  standard deviation of a touch: {sigma_mm:g} mm in each coordinate (--sigma)")
    return "\n".join(lines)
