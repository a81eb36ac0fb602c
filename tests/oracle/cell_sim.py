"""A robot controller and milling cell that shares no code with the package.

Reads the plain KRL that a post-processor writes (literal LIN, CIRC, PTP, $BASE, $TOOL; named points from the .dat),
interpolates as KUKA does, and lets the elastic arm of `tests.oracle.arm` follow it under a given force.
"""

from __future__ import annotations

import re

import numpy as np
from scipy.optimize import root
from scipy.spatial.transform import Rotation, Slerp

from tests.oracle.arm import Arm, abc

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_AGGREGATE = re.compile(r"\{[^}]*\}")


def _parts(text):
    return {k.upper(): float(v) for k, v in re.findall(rf"\b([A-Za-z]\d?)\s+({_NUMBER})", text)}


def _frame(parts, previous=None):
    base = dict(zip("XYZABC", previous or (0.0,) * 6, strict=True))
    base.update({k: v for k, v in parts.items() if k in base})
    return tuple(base[k] for k in "XYZABC")


def read(src, dat="", home=None):
    """List of moves: dicts with kind, line (1-based), and frame (mm, deg), via, or joints (deg); $BASE and $TOOL."""
    points = {"XHOME": "{" + ",".join(f"A{n} {a}" for n, a in enumerate(home, 1)) + "}"} if home else {}
    for name, body in re.findall(
        r"(?im)^\s*(?:DECL\s+)?(?:GLOBAL\s+)?(?:E6POS|POS|FRAME)\s+(\w+)\s*=\s*(\{[^}]*\})", dat + "\n" + src
    ):
        points[name.upper()] = body
    moves, base, tool, last = [], None, None, None
    modes = {"ORI": "VAR", "CIRC": "BASE"}
    for number, raw in enumerate(re.split(r"\r\n|\n|\r", src), 1):
        line = raw.split(";")[0].strip()
        setting = re.match(r"(?i)\$(BASE|TOOL)\s*=\s*(\{.*\})", line)
        if setting:
            frame = _frame(_parts(setting[2]))
            base, tool = (frame, tool) if setting[1].upper() == "BASE" else (base, frame)
            continue
        own = {name.upper(): word.upper() for name, word in re.findall(r"(?i)\$(ORI|CIRC)_TYPE\s*=\s*#(\w+)", line)}
        motion = re.match(r"(?i)S?(PTP|LIN|CIRC)\s+(.*)", line)
        if not motion:
            modes |= own
        if not motion:
            continue
        kind, rest = motion[1].upper(), motion[2]
        bodies = _AGGREGATE.findall(rest) or [
            points[n.upper()] for n in re.split(r"[,\s]+", rest) if n.upper() in points
        ]
        parts = [_parts(body) for body in bodies]
        move = {"kind": kind, "line": number, "base": base, "tool": tool, "modes": modes | own}
        if "A1" in parts[-1]:
            move["joints"] = [parts[-1][f"A{n}"] for n in range(1, 7)]
        else:
            if kind == "CIRC":
                move["via"] = _frame(parts[0], last)
            last = _frame(parts[-1], last)
            move["frame"] = last
        moves.append(move)
    return moves


class Cell:
    def __init__(self, arm: Arm, start_deg, base=None, tool=None):
        self.arm, self.start = arm, np.radians(start_deg)
        self.base, self.tool = base, tool

    def run(self, moves, shares=(1.0,)):
        """Yield (move index, share of the move, commanded TCP in $BASE, joint angles)."""
        q = self.start
        for index, move in enumerate(moves):
            base, tool = abc(*(move["base"] or self.base)), abc(*(move["tool"] or self.tool))
            if "joints" in move:
                q = np.radians(move["joints"])
                continue
            begin = np.linalg.inv(base) @ self.arm.nominal_tcp(q, tool)
            by_wrist = move["kind"] == "LIN" and move["modes"]["ORI"] == "JOINT"
            before = q
            for share in shares if move["kind"] != "PTP" else (1.0,):
                pose = self.between(move, begin, share)
                if by_wrist:
                    q_here = self.led_by_wrist(before, base, abc(*move["frame"]), pose, tool, share)
                    pose = np.linalg.inv(base) @ self.arm.nominal_tcp(q_here, tool)
                else:
                    q_here = self.arm.inverse(base @ pose, tool, q)
                yield index, share, pose, q_here
            q = q_here

    def led_by_wrist(self, begin, base, end, pose, tool, share):
        """Joint angles with the wrist between those at start and end, and the tip where it is on its line."""
        last = self.arm.inverse(base @ end, tool, begin)
        q = begin + share * (last - begin)

        def missed(first):
            return 1e3 * (self.arm.nominal_tcp(np.append(first, q[3:]), tool)[:3, 3] - (base @ pose)[:3, 3])

        found = root(missed, q[:3], tol=1e-13)
        assert np.abs(missed(found.x)).max() < 1e-7
        return np.append(found.x, q[3:])

    @staticmethod
    def between(move, begin, share):
        end = abc(*move["frame"])
        pose = np.eye(4)
        held = move["modes"]["ORI"] == "CONSTANT"
        if held:
            end[:3, :3] = begin[:3, :3]
        turn = Slerp([0, 1], Rotation.from_matrix([begin[:3, :3], end[:3, :3]]))
        pose[:3, :3] = turn(share).as_matrix()
        pose[:3, 3] = begin[:3, 3] + share * (end[:3, 3] - begin[:3, 3])
        if move["kind"] == "CIRC":
            a, b, c = begin[:3, 3], np.array(move["via"][:3]) / 1000, end[:3, 3]
            # the centre is where the three perpendicular bisector planes meet
            n = np.cross(b - a, c - a)
            rows = np.array([b - a, c - a, n / np.linalg.norm(n) * np.linalg.norm(c - a)])
            rhs = [np.dot(b - a, (a + b) / 2), np.dot(c - a, (a + c) / 2), np.dot(rows[2], a)]
            centre = np.linalg.solve(rows, rhs)
            axis = n / np.linalg.norm(n)
            angle = np.arctan2(np.dot(np.cross(a - centre, c - centre), axis), np.dot(a - centre, c - centre)) % (
                2 * np.pi
            )
            here, there = (Rotation.from_rotvec(axis * angle * way) for way in (share, 1.0))
            pose[:3, 3] = centre + here.apply(a - centre)
            if move["modes"]["CIRC"] == "PATH":  # what changes is the orientation that a rider on the path sees
                first, last = Rotation.from_matrix(begin[:3, :3]), there.inv() * Rotation.from_matrix(end[:3, :3])
                change = (first.inv() * last).as_rotvec() * (0.0 if held else share)
                pose[:3, :3] = (here * first * Rotation.from_rotvec(change)).as_matrix()
        return pose

    def tip(self, move, q, wrench_base):
        """Loaded TCP in $BASE [m] under a wrench in $BASE axes."""
        base, tool = abc(*(move["base"] or self.base)), abc(*(move["tool"] or self.tool))
        r = base[:3, :3]
        wrench = np.concatenate([r @ wrench_base[:3], r @ wrench_base[3:]])
        return (np.linalg.inv(base) @ self.arm.loaded_tcp(q, tool, wrench))[:3, 3]
