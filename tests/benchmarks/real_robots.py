"""Real robots: readings that others have published, identified by folds, and what is left on readings left out.

Run: python -m tests.benchmarks.real_robots FOLDER [--folds 6] [--only fanuc|abb|motoman|ma2010|kr300]

FOLDER holds copies of the repositories, or of the parts that are used; those that are absent are named:

- `fanuc`: longton2001-pixel/breakthrough-surge-suppression-in-high-speed-robotic-drilling, `data/stiffness_data`. FANUC
  R-2000iC under 43 pulls by a cable, 120 to 1130 N, one point. Licence: MIT.
- `abb`: icelinker/Robot-Calibration-LaserTracker, `4-DataProcess/Output`. ABB IRB 120, three reflectors in 982
  configurations without load. No licence: nothing of it may be redistributed.
- `motoman`: ctu-vras/multirobot-calibration, `UserData/Robots/Motoman/Dataset/leica_dataset`. Right arm of a two-arm
  Motoman under a Leica tracker, one reflector in 587 configurations all over the workspace, without load. No licence.
- `ma2010`: hehonglu123/Welding_Motoman, or its copy JInhan05013/Welding_motoman, `mocap`. Motoman MA2010 under motion
  capture, pose of the tool in 1500 configurations all over the workspace on each of several days, and in 1736 in which
  A1 and the wrist hardly turn; without load. No licence.
- `kr300`: JonasWeigand/Robot_Identification, `data/recorded_trajectories`. KUKA KR 300 R2500 with encoders on the links
  of A1 to A3, driven along three trajectories of 10 s. Licence: MIT. Nothing is measured at the tool, so `identify`
  reads none of it: printed are gear twist, compliance and lost motion, in their order of size.

Geometries are nominal ones: of the first and the last repository, and of the robot's data sheet. Each set is written as
files of `identify`; each fold is identified from the others as a user would.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from postproc import elastostatics, kinematics, robot
from postproc.identification import Choices, geometry_folder, identify_folder
from postproc.identification.measurement_model import kabsch
from tests.kr270 import ROBOT

HEADER = "config,load,repeat,point,A1,A2,A3,A4,A5,A6,Fx,Fy,Fz,Mx,My,Mz,X,Y,Z"
FANUC_MDH = np.array(  # α, a, θ, d of each joint: its repository, core/config.py
    [
        [0.0, 0.0, 0.0, 0.670],
        [-np.pi / 2, 0.312, -np.pi / 2, 0.0],
        [0.0, 1.075, 0.0, 0.0],
        [-np.pi / 2, 0.225, 0.0, 1.280],
        [np.pi / 2, 0.0, 0.0, 0.0],
        [-np.pi / 2, 0.0, 0.0, 0.215],
    ]
)
FANUC_POINT = (6.9, 245.3, 319.3)
"""Where the cable pulls and the displacement is measured, flange frame [mm]."""
ABB_JOINTS = (  # IRB 120, product specification: origin on the link before [m], axis
    ((0.0, 0.0, 0.0), (0, 0, 1)),
    ((0.0, 0.0, 0.290), (0, 1, 0)),
    ((0.0, 0.0, 0.270), (0, 1, 0)),
    ((0.0, 0.0, 0.070), (1, 0, 0)),
    ((0.302, 0.0, 0.0), (0, 1, 0)),
    ((0.072, 0.0, 0.0), (1, 0, 0)),
)
MOTOMAN_DH = np.array(  # a, d, α, offset of the angle, of the axis that carries both arms and of the right arm's joints
    [
        [0.000, -0.2630, np.radians(15.0), -np.pi / 2],
        [0.150, 1.4159, -np.pi / 2, 0.0],
        [0.614, 0.0, np.pi, -np.pi / 2],
        [0.200, 0.0, -np.pi / 2, 0.0],
        [0.0, -0.640, np.pi / 2, 0.0],
        [0.030, 0.0, np.pi / 2, -np.pi / 2],
    ]
)
"""Its repository, `UserData/Robots/Motoman/loadMotoman.m`."""


def urdf(joints: Sequence[tuple[Sequence[float], Sequence[float], Sequence[float]]]) -> str:
    """Return the URDF of six joints, each with origin [m], rotation (rpy) and axis; the flange is in the last frame."""
    text = ['<robot name="real"><link name="base_link"/>']
    for number, (xyz, rpy, axis) in enumerate(joints, start=1):
        parent = "base_link" if number == 1 else f"link_{number - 1}"
        triple = [" ".join(f"{value:.12g}" for value in values) for values in (xyz, rpy, axis)]
        text.append(
            f'<link name="link_{number}"/><joint name="A{number}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{number}"/><origin xyz="{triple[0]}" rpy="{triple[1]}"/><axis xyz="{triple[2]}"/>'
            '<limit lower="-6.3" upper="6.3" velocity="2" effort="1"/></joint>'
        )
    text.append(
        '<link name="flange"/><joint name="flange" type="fixed"><parent link="link_6"/><child link="flange"/></joint>'
    )
    return "".join([*text, "</robot>\n"])


def write_robot(folder: Path, name: str, text: str) -> None:
    """Write a model folder with the compliances of a KR 270 as the start of the search."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.urdf").write_text(text)
    published = ROBOT.compliance * 1e6
    lines = [f'name = "{name}"']
    for joint, value in zip(robot.JOINTS, published, strict=True):
        lines.append(f'[joints.{joint}]\ncompliance_urad_per_Nm = {value:.4g}\nsource = "of a KR 270"\nassumed = true')
    (folder / "model.toml").write_text("\n".join(lines) + "\n")


def folds(count: int, parts: int) -> list[np.ndarray]:
    """Return the rows of each fold, at random but always the same."""
    return np.array_split(np.random.default_rng(0).permutation(count), parts)


def rms(error: np.ndarray) -> float:
    """Return the RMS length of errors (n, 3), in mm."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) * 1e3


def fanuc(source: Path, work: Path, parts: int) -> None:
    """Print what is left of the deflections of the FANUC on pulls left out."""
    q, force, moved = (
        np.loadtxt(source / f"{name}.csv", delimiter=",", skiprows=1) for name in ("joint_angles", "forces", "deltaX")
    )
    # T = Rx(α) Tx(a) Rz(θ) Tz(d); θ is an offset of the joint's own angle
    origins = [
        ((a, -np.sin(alpha) * d, np.cos(alpha) * d), (alpha, 0.0, 0.0), (0, 0, 1)) for alpha, a, _, d in FANUC_MDH
    ]
    sign, offset = np.array([1, 1, -1, -1, -1, -1]), FANUC_MDH[:, 2]
    write_robot(work / "robot", "FANUC R-2000iC", urdf(origins))
    point = "".join(f"{axis} = {value}\n" for axis, value in zip("XYZ", FANUC_POINT, strict=True))
    (work / "experiment.toml").write_text(
        'robot = "robot"\nsigma_mm = 0.02\nreadings = "displacements"\n[angles]\n'
        f"sign = {sign.tolist()}\noffset_deg = {np.degrees(offset).round(9).tolist()}\nA3_per_J2 = -1\n"
        f"[load_point]\n{point}[points.P1]\n{point}"
    )
    rows = [
        ",".join(
            [
                *(str(n + 1), "1", "1", "P1"),
                *(f"{value:.6f}" for value in np.degrees(q[n])),
                *(f"{value:.4f}" for value in (*force[n], 0.0, 0.0, 0.0)),
                *(f"{1e3 * value:.4f}" for value in moved[n]),
            ]
        )
        for n in range(len(q))
    ]
    angles = q * sign + offset
    angles[:, 2] -= q[:, 1]
    tool = np.eye(4)
    tool[:3, 3] = np.array(FANUC_POINT) * 1e-3
    wrench = np.c_[force, 0 * force]
    left = {"auto": [], "joints": []}
    inside, bounds = [], []
    for out in folds(len(q), parts):
        kept = [row for n, row in enumerate(rows) if n not in set(out.tolist())]
        (work / "measurements.csv").write_text("\n".join([HEADER, *kept]) + "\n")
        for structure, errors in left.items():
            choices = Choices(structure=structure)
            identify_folder(work / "measurements.csv", work / "experiment.toml", work / f"model_{structure}", choices)
            model = robot.load(work / f"model_{structure}")
            predicted = elastostatics.deflect(model, angles[out], tool, wrench[out]).twist[:, :3]
            errors.append(moved[out] - predicted)
            if structure == "auto":
                bound = elastostatics.position_bound(model, angles[out], tool, wrench[out])
                inside.append(np.linalg.norm(errors[-1], axis=1) <= bound)
                bounds.append(bound)
    print(f"FANUC R-2000iC: {len(q)} pulls of {np.linalg.norm(force, axis=1).min():.0f} to ", end="")
    print(f"{np.linalg.norm(force, axis=1).max():.0f} N, {parts} folds; RMS on pulls left out [mm]")
    print(f"  deflection {rms(moved):.3f}; left by joint springs {rms(np.concatenate(left['joints'])):.3f}, ", end="")
    print(f"by the chosen structures {rms(np.concatenate(left['auto'])):.3f}")
    middle = np.median(np.concatenate(bounds)) * 1e3
    print(f"  inside u95: {np.concatenate(inside).mean():.2f}; u95 {middle:.3f} mm (median)")


def abb(source: Path, work: Path, parts: int) -> None:
    """Print what a calibrated geometry of the ABB leaves at configurations left out."""
    q = np.loadtxt(source / "processed_joints.txt")
    points = np.stack([np.loadtxt(source / f"processed_SMR_{n}.txt") for n in (1, 2, 3)], axis=1)
    joints = [(xyz, (0.0, 0.0, 0.0), axis) for xyz, axis in ABB_JOINTS]
    _print_geometry("ABB IRB 120", urdf(joints), q, points, work, parts)


def motoman(source: Path, work: Path, parts: int) -> None:
    """Print what a calibrated geometry of the Motoman's right arm leaves at configurations left out."""
    rows = loadmat(source / "updated_leica_dataset.mat")["dataset"]
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]  # a pose has a row for each marker that the cameras saw
    rows = rows[~np.isnan(rows[:, -1])]
    joints = []
    for a, d, alpha, offset in MOTOMAN_DH:  # T = Rz(θ) Tz(d) Tx(a) Rx(α): the next joint turns about z behind it
        turn = Rotation.from_euler("z", offset) * Rotation.from_euler("x", alpha)
        place = Rotation.from_euler("z", offset).apply([a, 0.0, d])
        joints.append((place, turn.as_euler("xyz"), (0, 0, 1)))
    _print_geometry(
        "Motoman, right arm", urdf(joints), np.degrees(rows[:, 7:13]), 1e3 * rows[:, None, 19:22], work, parts
    )


MA2010_JOINTS = (  # its repository, `config/urdf/MA_2010_A0.urdf`: origin on the link before [m], axis
    ((0.0, 0.0, 0.505), (0, 0, 1)),
    ((0.150, 0.0, 0.0), (0, 1, 0)),
    ((0.0, 0.0, 0.760), (0, -1, 0)),
    ((0.0, 0.0, 0.200), (-1, 0, 0)),
    ((1.082, 0.0, 0.0), (0, -1, 0)),
    ((0.0, 0.0, 0.0), (-1, 0, 0)),
)
MA2010_DAYS = ("0516", "0725", "0801")


def ma2010(source: Path, work: Path, parts: int) -> None:
    """Print what a calibrated geometry of the MA2010 leaves, and its bound where A1 and the wrist were not turned."""
    robot_text = urdf([(xyz, (0.0, 0.0, 0.0), axis) for xyz, axis in MA2010_JOINTS])
    for day in MA2010_DAYS:
        spread = _ma2010_readings(source / f"kinematic_raw_data/test{day}_R1", "")
        _print_geometry(f"Motoman MA2010, {day}", robot_text, *spread, work, parts)
        narrow = _ma2010_readings(source / f"PH_grad_data/test{day}_R1", "train_data_")
        _print_bound(f"Motoman MA2010, {day}", narrow, spread, work)


def _ma2010_readings(folder: Path, prefix: str) -> tuple[np.ndarray, np.ndarray]:
    """Return angles (n, 6) [deg] and positions (n, 1, 3) [mm] of the tool's markers."""
    q, tool = (np.loadtxt(folder / f"{prefix}{name}_align.csv", delimiter=",") for name in ("robot_q", "mocap_T"))
    return np.degrees(q), tool[:, None, :3]


def _print_bound(
    name: str, used: tuple[np.ndarray, np.ndarray], out: tuple[np.ndarray, np.ndarray], work: Path
) -> None:
    """Print how often the bound of a geometry from 200 configurations holds at others, inside and beyond its angles."""
    rows = np.random.default_rng(0).permutation(len(used[0]))[:200]
    record = _calibrate(used[0][rows], used[1][rows], work)
    model = robot.load(work / "model")
    error = _unloaded_errors(model, record, used[0][rows], used[1][rows], *out)
    bound = model.geometry_error.at(np.radians(out[0]))
    size = np.linalg.norm(error, axis=1)
    print(f"{name}: geometry from 200 configurations with A1 and the wrist within 2°; on {len(size)} all over [mm]")
    print(
        f"  error {rms(error):.3f} RMS, bound {model.geometry_error.u95 * 1e3:.3f} inside the measured angles, ", end=""
    )
    print(f"{np.median(bound) * 1e3:.3f} there (median); inside it: {np.mean(size <= bound):.3f}")


KR300_WINDOW = 25
"""Samples (0.1 s) over which speed and torque are smoothed by a parabola (Savitzky and Golay, 1964)."""
KR300_AT_REST = np.radians(0.5)
"""Speed [rad/s] below which the direction of motion, and so the side of the gear's flank, is not known."""


def kr300(source: Path, work: Path, parts: int) -> None:
    """Print twist, compliance and lost motion of the gears of A1 to A3, and what is left on a trajectory left out."""
    runs = [loadmat(path, squeeze_me=True, struct_as_record=False) for path in sorted(source.parent.glob("*/data.mat"))]
    print(f"KUKA KR 300 R2500: {len(runs)} trajectories, driven; [mrad RMS] about the mean of each")
    for joint in range(3):
        equations = [_twist_equations(run, joint) for run in runs]
        alone = np.array([np.linalg.lstsq(design, twist)[0] for design, twist in equations])
        left = []
        for out, (design, twist) in enumerate(equations):
            pairs = [pair for number, pair in enumerate(equations) if number != out]
            known_design, known_twist = (np.concatenate(arrays) for arrays in zip(*pairs, strict=True))
            left.append(twist - design @ np.linalg.lstsq(known_design, known_twist)[0])
        twist = np.concatenate([twist for _, twist in equations])
        compliance, step, delay = (alone * [1e6, 2e3, 1e3]).T
        print(f"  A{joint + 1}: twist {np.std(twist) * 1e3:.3f}, ", end="")
        print(f"left on the trajectory left out {np.std(np.concatenate(left)) * 1e3:.3f}; by each trajectory alone:")
        print(f"      compliance {compliance.min():.2f} to {compliance.max():.2f} µrad/(N·m), ", end="")
        print(f"step at a reversal {step.min():.2f} to {step.max():.2f} mrad, ", end="")
        print(f"delay {delay.min():.1f} to {delay.max():.1f} ms")


def _twist_equations(run: dict, joint: int) -> tuple[np.ndarray, np.ndarray]:
    """Return design (n, 3) and twist (n,) [rad], motor angle minus link angle, of the samples in motion, without means.

    Columns: torque of the motor at the link, less that of its inertia [N·m]; direction of motion; speed [rad/s], whose
    factor is the delay of the encoder of the link. Friction in the gear is part of the torque, so that the step at a
    reversal is lost motion less twice the twist by friction. The zero of the encoders is another in each trajectory.
    """
    record, ratio = run["rec"], run["para"].u[joint]
    period = float(np.median(np.diff(record.time_cont)))
    raw_speed = np.radians(record.act_vel_mot_deg_per_s[joint])
    acceleration = savgol_filter(raw_speed, KR300_WINDOW, 2, deriv=1, delta=period)
    speed = savgol_filter(raw_speed, KR300_WINDOW, 2)
    torque = ratio * record.act_torque_abs_nm[joint] - run["para"].J_mr[joint] * ratio**2 * acceleration
    design = np.stack([savgol_filter(torque, KR300_WINDOW, 2), np.sign(speed), speed], axis=1)
    twist = np.radians(record.act_pos_mot_deg[joint] - record.act_pos_se_deg[joint])
    is_moving = np.abs(speed) > KR300_AT_REST
    design, twist = design[is_moving], twist[is_moving]
    return design - design.mean(axis=0), twist - twist.mean()


def _print_geometry(name: str, robot_text: str, q: np.ndarray, points: np.ndarray, work: Path, parts: int) -> None:
    """Print what is left of readings (n, p, 3) [mm] at angles (n, 6) [deg], with the geometry from 60 and 200 poses."""
    write_robot(work / "robot", name, robot_text)
    order = np.random.default_rng(0).permutation(len(q))
    for count in (60, 200):
        errors = {"calibrated": [], "nominal": []}
        for part in range(parts):
            used, out = np.split(np.roll(order, -part * count), [count])
            record = _calibrate(q[used], points[used], work)
            for kind, model in (("calibrated", robot.load(work / "model")), ("nominal", robot.load(work / "robot"))):
                errors[kind].append(_unloaded_errors(model, record, q[used], points[used], q[out], points[out]))
        print(f"{name}: geometry from {count} of {len(q)} configurations, {parts} times; on all others [mm]")
        for kind, parts_left in errors.items():
            error = np.concatenate(parts_left)
            print(f"  {kind}: {rms(error):.3f} RMS, median {np.median(np.linalg.norm(error, axis=1)) * 1e3:.3f}")


def _calibrate(q: np.ndarray, points: np.ndarray, work: Path) -> dict:
    """Write a model with the geometry from readings (n, p, 3) [mm] at angles (n, 6) [deg]; return its record."""
    guess = "".join(
        f"[points.P{n}]\nX = {x}\nY = {y}\nZ = {z}\n"
        for n, (x, y, z) in enumerate(_on_flange(q, points, work), start=1)
    )
    (work / "experiment.toml").write_text(
        f'robot = "robot"\nsigma_mm = 0.05\n[load_point]\nX = 0\nY = 0\nZ = 0\n{guess}'
    )
    _write_unloaded(work / "measurements.csv", q, points)
    geometry_folder(work / "measurements.csv", work / "experiment.toml", work / "model")
    return json.loads((work / "model" / "identification.json").read_text())


def _on_flange(q: np.ndarray, points: np.ndarray, work: Path) -> np.ndarray:
    """Return rough places (p, 3) of the reflectors on the flange [mm], by linear least squares with the base frame."""
    model = robot.load(work / "robot")
    rows, right = [], []
    pose = _flange(model, q[:100])
    seen = points[:100]
    size = 3 * points.shape[1]
    for n in range(len(pose)):  # R·p + t = M·x + b for any linear M: reflectors follow without knowing the frame
        for k in range(points.shape[1]):
            block = np.zeros((3, size + 12))
            block[:, 3 * k : 3 * k + 3] = pose[n, :3, :3]
            block[:, size : size + 9] = -np.kron(np.eye(3), seen[n, k] * 1e-3)
            block[:, size + 9 :] = -np.eye(3)
            rows.append(block)
            right.append(-pose[n, :3, 3])
    found = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    return found[:size].reshape(-1, 3).round(5) * 1e3


def _flange(model: robot.RobotModel, q: np.ndarray) -> np.ndarray:
    """Return flange poses (n, 4, 4) at angles (n, 6) [deg]."""
    x = elastostatics.coordinates(model, np.radians(q))
    return kinematics.tcp(model.actual, x, np.eye(4))[0]


def _write_unloaded(path: Path, q: np.ndarray, points: np.ndarray) -> None:
    rows = [HEADER]
    for n in range(len(q)):
        angles = ",".join(f"{v:.6f}" for v in q[n])
        rows += [
            f"{n + 1},0,1,P{k + 1},{angles},0,0,0,0,0,0,{','.join(f'{v:.4f}' for v in points[n, k])}"
            for k in range(points.shape[1])
        ]
    path.write_text("\n".join(rows) + "\n")


def _unloaded_errors(
    model: robot.RobotModel, found: dict, q: np.ndarray, seen: np.ndarray, new_q: np.ndarray, new: np.ndarray
) -> np.ndarray:
    """Return the errors (n, 3) [m] of points at new poses, with the frame fitted to the readings used."""
    points = np.array([[found["points"][f"P{k}"][axis] for axis in "XYZ"] for k in range(1, new.shape[1] + 1)]) * 1e-3

    def at(angles: np.ndarray) -> np.ndarray:
        pose = _flange(model, angles)
        return np.einsum("nij,kj->nki", pose[:, :3, :3], points) + pose[:, None, :3, 3]

    frame = kabsch(at(q).reshape(-1, 3), seen.reshape(-1, 3) * 1e-3)
    return (new * 1e-3 - (at(new_q) @ frame[:3, :3].T + frame[:3, 3])).reshape(-1, 3)


SETS = {
    "fanuc": ("data/stiffness_data", "deltaX.csv", fanuc),
    "abb": ("4-DataProcess/Output", "processed_joints.txt", abb),
    "motoman": ("Dataset/leica_dataset", "updated_leica_dataset.mat", motoman),
    "ma2010": ("mocap", "relative_pose.py", ma2010),
    "kr300": ("FF A 08ms", "data.mat", kr300),
}


def main() -> None:
    """Print the numbers of each set that is there."""
    parser = argparse.ArgumentParser(description="Real robots: what is left on readings left out.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--folds", type=int, default=6)
    parser.add_argument("--only", choices=SETS)
    options = parser.parse_args()
    for name, (inner, file, run) in SETS.items():
        if options.only not in (None, name):
            continue
        places = [path.parent for path in options.folder.rglob(file) if path.parent.as_posix().endswith(inner)]
        if not places:
            print(f"{name}: no {inner}/{file} in {options.folder}")
            continue
        with tempfile.TemporaryDirectory() as work:
            run(places[0], Path(work), options.folds)


if __name__ == "__main__":
    main()
