"""Candidate parameters of a robot whose compliance depends on the pose, and of coupled wrists.

**Over the pose.** The compliance of joint j at a pose is k_j·(1 + f_j(q)). f_j is a Gaussian process of mean zero that
is smooth over the joint angles, by its Fourier series: waves cos(n·q), sin(n·q) with independent normal amplitudes
(Rasmussen and Williams, "Gaussian Processes for Machine Learning", 2006, 4.2.1 and 2.2). Two things change a compliance
with the pose: the shape of the arm, by A2 and A3, and gear wheels that run out of true, once and twice a turn of the
joint itself. So n has up to one turn of A2 and of A3, and up to two of the joint. The variance of a wave falls with its
turns of A2 and A3 (`_SPECTRUM_SIGMA`): the spectrum of a squared exponential of length 1 rad. The variance of all waves
of a joint together is one, times a size that the readings determine (`fit.learn`). Far from all readings the posterior
of f_j is its prior: the model has the mean compliance there, and the bound counts the whole size of f_j.

**Coupling.** Deflections of A4, A5 and A6 by each other's torques, see `robot.GearCoupling`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np

from postproc.robot import JOINTS, GearCoupling, JointCompliance, PoseWave

_TURNS_OF_ARM = (-1, 0, 1)
"""Turns of A2 and of A3 in the waves of the other joints."""
_TURNS_OF_ARM_JOINTS = (-2, -1, 0, 1, 2)
"""Turns of A2 and of A3 in the waves of A2 and A3 themselves."""
_MOST_TURNS_TOGETHER = 3
"""Largest sum of the sizes of these two turns (assumed): waves with more are small by the spectrum."""
_TURNS_OF_JOINT = (0, 1, 2)
"""Periods of a wave in one turn of the joint itself (assumed): none, one, and two as of out-of-round gears."""
_SPECTRUM_SIGMA = 1.0
"""Standard deviation of the spectrum [turns]: one over the length over which a compliance changes [rad]."""
_WRIST = JOINTS[3:]


def couplings(joints: Sequence[JointCompliance]) -> tuple[GearCoupling, ...]:
    """Return the couplings of all pairs of wrist joints (A4 to A6) among some joints."""
    wrist = [joint.joint for joint in joints if joint.joint in _WRIST]
    return tuple(GearCoupling(first, second) for first, second in combinations(wrist, 2))


def waves(joints: Sequence[JointCompliance]) -> tuple[PoseWave, ...]:
    """Return the waves cos(n·q), sin(n·q) of the joint angles q by which compliances of some joints may vary."""
    parameters: list[PoseWave] = []
    for joint in joints:
        for turns in _wave_turns(joint.index):
            parameters += [PoseWave(joint.joint, turns, "cos"), PoseWave(joint.joint, turns, "sin")]
    return tuple(parameters)


def amplitude_share(wave: PoseWave) -> float:
    """Return the prior standard deviation of a wave's amplitude, over that of the sum of all waves of its joint."""
    total_variance = sum(_spectrum(turns) for turns in _wave_turns(JOINTS.index(wave.joint)))
    return float(np.sqrt(_spectrum(wave.turns) / total_variance))


def _spectrum(turns: tuple[int, ...]) -> float:
    """Return the relative variance of a wave with some turns (6,): it falls with the turns of A2 and A3."""
    return float(np.exp(-0.5 * (turns[1] ** 2 + turns[2] ** 2) / _SPECTRUM_SIGMA**2))


def _wave_turns(index: int) -> list[tuple[int, ...]]:
    """Return n (6,), periods in one turn of each joint angle, of all waves cos(n·q) of the compliance of a joint.

    n and −n are the same wave: n is returned whose first turn that is not zero is positive, in the order of the joint
    itself, A2, A3. n = 0 is no wave.

    :param index: of the joint, from 0.
    """
    if index in (1, 2):
        pairs = [
            pair
            for pair in product(_TURNS_OF_ARM_JOINTS, repeat=2)
            if abs(pair[0]) + abs(pair[1]) <= _MOST_TURNS_TOGETHER
        ]
        candidates = [(0, *pair, 0, 0, 0) for pair in pairs]
    else:
        candidates = []
        for joint_turns, a2_turns, a3_turns in product(_TURNS_OF_JOINT, _TURNS_OF_ARM, _TURNS_OF_ARM):
            turns = [0, a2_turns, a3_turns, 0, 0, 0]
            turns[index] = joint_turns
            candidates.append(tuple(turns))
    order = (index, 1, 2)  # other turns are zero
    return [turns for turns in candidates if next((turns[joint] for joint in order if turns[joint]), 0) > 0]
