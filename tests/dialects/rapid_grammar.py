"""RAPID as ABB's manual describes it, read without anything of the package: nested lists, instructions as tokens.

Rotations are scipy's, the arm is that of the data sheet in ABB's own axes.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

TOKEN = re.compile(r'\s*(?:([A-Za-z]\w*)|([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)|("[^"]*")|(:=|[\[\](),;\\]))')


def tokens(text: str) -> list[str]:
    """The tokens of a piece of code; anything else is no RAPID that we know."""
    out, at = [], 0
    while text[at:].strip():
        match = TOKEN.match(text, at)
        assert match, text[at : at + 40]
        out.append(match[0].strip())
        at = match.end()
    return out


def value(words: list[str]) -> Any:
    """A value at the beginning of the tokens, which it takes away: number, name, text or list."""
    word = words.pop(0)
    if word != "[":
        return float(word) if re.match(r"[-+\d]", word) else word
    items = []
    while words[0] != "]":
        items.append(value(words))
        if words[0] == ",":
            words.pop(0)
    words.pop(0)
    return items


def parse(text: str) -> tuple[dict[str, tuple[str, Any]], list[tuple[int, str, list[Any], str]]]:
    """Data by name as (type, value); instructions of the procedure as (line, name, arguments, work object)."""
    data: dict[str, tuple[str, Any]] = {}
    code: list[tuple[int, str, list[Any], str]] = []
    inside = False
    for number, line in enumerate(text.split("\r\n"), 1):
        line = line.strip()
        if not line or line.startswith("!") or line.split()[0] in ("MODULE", "ENDMODULE", "ENDPROC"):
            continue
        words = tokens(line)
        if words[0] == "PROC":
            inside = True
        elif not inside:
            assert words[0] == "LOCAL"
            assert words[1] in ("PERS", "CONST")
            assert words[4] == ":="
            data[words[3]] = (words[2], value(words[5:]))
        else:
            name, words = words[0], words[1:]
            arguments: list[Any] = []
            work_object = ""
            while words[0] != ";":
                if words[0] == "\\" and words[1].lower() == "wobj":
                    work_object, words = words[3], words[4:]
                elif words[0] in ("\\", ","):
                    words.pop(0)
                else:
                    arguments.append(value(words))
            code.append((number, name, arguments, work_object))
    return data, code


def frame(place_and_turn: list[list[float]]) -> np.ndarray:
    """A `pose` of RAPID as a matrix, in mm: quaternions have their real part first."""
    (place, turn) = place_and_turn
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(np.roll(turn, -1)).as_matrix()
    out[:3, 3] = place
    return out


def turn(axis: str, degrees: float) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return out


def shift(x: float, y: float, z: float) -> np.ndarray:
    out = np.eye(4)
    out[:3, 3] = x, y, z
    return out


def elbow_and_wrist(j: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames of the lower arm and of the wrist centre of an IRB 6700-200/2.60, and tool0, for ABB's axes [deg]; mm."""
    lower = turn("z", j[0]) @ shift(320, 0, 780) @ turn("y", j[1])
    wrist = lower @ shift(0, 0, 1125) @ turn("y", j[2]) @ shift(0, 0, 200) @ turn("x", j[3]) @ shift(1142.5, 0, 0)
    return lower, wrist, wrist @ turn("y", j[4]) @ shift(200, 0, 0) @ turn("x", j[5]) @ turn("y", 90)


def confdata(j: np.ndarray) -> list[int]:
    """cf1, cf4, cf6, cfx of ABB's axes [deg], by where the wrist centre is seen from axis 1 and from the lower arm."""
    lower, wrist, _ = elbow_and_wrist(j)
    ahead = turn("z", j[0])[:3, 0] @ wrist[:3, 3]
    before_arm = (np.linalg.inv(lower) @ wrist)[0, 3]  # X of the lower arm points forward
    cfx = 4 * (ahead < 0) + 2 * (before_arm < 0) + (j[4] < 0)
    return [*(int(np.floor(j[axis] / 90.0)) for axis in (0, 3, 5)), int(cfx)]
