"""RAPID as a language: names that the controller accepts, instructions that are safe between moves, frames and angles.

The joints A1…A6 of every model folder have KUKA's signs, and at zero the arm is stretched out along +X. ABB's axes
turn about +Z, +Y, +Y, +X, +Y, +X, and at zero the upper arm is vertical and the forearm along +X. For a serial arm:

    J1 = −A1    J2 = A2 + 90°    J3 = A3 − 90°    J4 = −A4    J5 = A5    J6 = −A6

With a parallelogram (IRB 6660, 7600 with rod, palletisers) ABB measures axis 3 from the floor, not from the upper arm.
Such arms are not serial, and model folders cannot describe them. Robot root and
flange are those of ABB: base frame, and `tool0` with Z out of the flange and X downwards at zero.

A `num` of RAPID has single precision; so have positions, orientations and joint angles.
"""

from __future__ import annotations

import re
import unicodedata

import numpy as np

from postproc.frames import DEG_PER_RAD, M_PER_MM, RAD_PER_DEG, Array
from postproc.program import Ints

PREFIX = "mod_"
"""Prefix of the module's name, which must differ from the procedure's."""
MAX_LENGTH = 32 - len(PREFIX)
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss"})

WORDS = frozenset(
    {
        "ALIAS", "AND", "BACKWARD", "CASE", "CONNECT", "CONST", "DEFAULT", "DIV", "DO", "ELSE", "ELSEIF", "ENDFOR",
        "ENDFUNC", "ENDIF", "ENDMODULE", "ENDPROC", "ENDRECORD", "ENDTEST", "ENDTRAP", "ENDWHILE", "ERROR", "EXIT",
        "FALSE", "FOR", "FROM", "FUNC", "GOTO", "IF", "INOUT", "LOCAL", "MOD", "MODULE", "NOSTEPIN", "NOT", "NOVIEW",
        "OR", "PERS", "PROC", "RAISE", "READONLY", "RECORD", "RETRY", "RETURN", "STEP", "SYSMODULE", "TEST", "THEN",
        "TO", "TRAP", "TRUE", "TRYNEXT", "UNDO", "VAR", "VIEWONLY", "WHILE", "WITH", "XOR",
    }
)  # fmt: skip
"""Reserved words."""
HARMLESS = frozenset(
    {
        "CLKRESET", "CLKSTART", "CLKSTOP", "DECR", "INCR", "INVERTDO", "PULSEDO", "RESET", "SET", "SETAO", "SETDO",
        "SETGO", "STOP", "TPERASE", "TPWRITE", "WAITAI", "WAITDI", "WAITDO", "WAITGI", "WAITROB", "WAITTIME",
        "WAITUNTIL",
    }
)  # fmt: skip
"""Instructions that neither move the robot nor change the meaning of moves."""
MOVING = re.compile(
    "MOVE|TRIGG|SEARCH|STARTMOVE|STOPMOVE|CLEARPATH|RESTOPATH|STOREPATH|IND[ACDR]|CONF[JL]|CIRPATH|SINGAREA|PDISP|EOFFS|"
    "SOFT|CORR|ACCSET|VELSET|PATHACC|GRIPLOAD|MECHUNITLOAD|WORLDACC"
)
"""First letters of instructions that move the robot or change how it moves."""
_ABB_SIGN = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
_ABB_ZERO = np.array([0.0, 90.0, -90.0, 0.0, 0.0, 0.0])
"""J = sign · A + zero [deg]: ABB's joint angles J of joint angles A with KUKA's signs, which are used elsewhere."""
_QUADRANT_TOLERANCE = 1e-6
"""An angle that is less than this below a quadrant [deg] belongs to it: the difference is rounding."""


def fault_of(name: str) -> str | None:
    """Return the reason why the controller refuses a program name; None if it is valid.

    Names of instructions are refused too, and all that begin with the first letters of a moving one (`MOVING`).

    >>> fault_of("PART_1"), fault_of("_1")
    (None, 'it does not begin with a letter')
    """
    if len(name) > MAX_LENGTH:
        return f"it has {len(name)} characters, {MAX_LENGTH} are allowed"
    if not re.match(r"[A-Za-z]", name):
        return "it does not begin with a letter"
    if not _NAME.fullmatch(name):
        return "it has other characters than letters, digits and underscores"
    if name.upper() in WORDS | HARMLESS:
        return "it is a word of RAPID"
    if MOVING.match(name.upper()):
        return "it begins as an instruction of RAPID does"
    return None


def valid_name(name: str) -> str:
    """Return the name itself if the controller accepts it, otherwise a similar valid name.

    >>> valid_name("part_1"), valid_name("1001"), valid_name("Gehäuse oben.2"), valid_name("stop")
    ('part_1', 'P1001', 'Gehaeuse_oben_2', 'P_stop')
    """
    if fault_of(name) is None:
        return name
    plain = unicodedata.normalize("NFKD", name.translate(_UMLAUTS)).encode("ascii", "ignore").decode()
    word = re.sub(r"\W+", "_", plain).strip("_") or "PROGRAM"
    word = f"P{word}" if word[0].isdigit() else word
    word = word[:MAX_LENGTH].rstrip("_")
    return word if fault_of(word) is None else f"P_{word}"[:MAX_LENGTH]


NO_EXTERNAL_AXES = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
BEGIN = ("ConfJ\\On;", "ConfL\\Off;", "CirPathMode\\ObjectFrame;")
END = ("ConfL\\On;", "CirPathMode\\PathFrame;")
"""Settings for the moves, and the defaults of RAPID that are restored after them."""
_INSTRUCTION = re.compile(r"([A-Za-z]\w*)(?:[ \t\\][^;]*)?;", re.ASCII)
_ASSIGNMENT = re.compile(r"([A-Za-z]\w*)[\w.{},]*[ \t]*:=[^;]+;", re.ASCII)
_MOVE_DATA = re.compile(r"(?:tool|wobj|speed|zone)_[0-9]+", re.IGNORECASE)
"""Names of the data of a new module that its moves use."""


def line_fault(line: str) -> str | None:
    """Return the reason why a line of the cell is not allowed between moves; None if it is allowed.

    >>> line_fault("SetDO doSpindle,1;"), line_fault("$OUT[1]=TRUE")
    (None, 'it is not a RAPID instruction that ends with a semicolon')
    """
    if line.startswith("!") or not line:
        return None
    match = _ASSIGNMENT.fullmatch(line) or _INSTRUCTION.fullmatch(line)
    if match is None:
        return "it is not a RAPID instruction that ends with a semicolon"
    word = match[1]
    if word.upper() in WORDS:
        return f"{word} changes the execution order"
    if MOVING.match(word.upper()):
        return f"{word} moves the robot or changes how it moves"
    if _MOVE_DATA.fullmatch(word):
        return f"{word} is used by the moves"
    return None


def abb_from_joints(q: Array) -> Array:
    """Return ABB's J1…J6 (…, 6) [deg] of joint angles A1…A6 (…, 6) [rad]."""
    return np.asarray(_ABB_SIGN * q * DEG_PER_RAD + _ABB_ZERO)


def joints_from_abb(angles: Array) -> Array:
    """Return joint angles A1…A6 (…, 6) [rad] of ABB's J1…J6 (…, 6) [deg]."""
    return np.asarray(_ABB_SIGN * (angles - _ABB_ZERO) * RAD_PER_DEG)


def configuration(q: Array, status: Ints) -> Ints:
    """Return cf1, cf4, cf6, cfx (n, 4) of robtargets.

    cf1, cf4 and cf6 are the quadrants of J1, J4, J6: 0 from 0° to 90°, −1 from −90° to 0°, and so on. cfx, 0…7, is the
    sum of 4 if the wrist centre is behind axis 1, 2 if it is behind the lower arm, 1 if J5 is negative (ABB, data type
    confdata). The status S of KUKA states the same in the opposite order of bits, but its bit 1 is set if the wrist
    centre is *in front of* the line through axes 2 and 3.

    :param q: (n, 6) joint angles, KUKA signs [rad].
    :param status: (n,) status S of KUKA.
    """
    quadrant = np.floor((abb_from_joints(q)[:, [0, 3, 5]] + _QUADRANT_TOLERANCE) / 90.0).astype(np.int64)
    cfx = 4 * (status & 1) + 2 * (1 - (status >> 1 & 1)) + (status >> 2 & 1)
    return np.column_stack([quadrant, cfx])


def status_from_cfx(cfx: Ints) -> Ints:
    """Return the status S of KUKA (n,) for cfx (n,); the inverse of the last column of `configuration`."""
    return np.asarray((cfx >> 2 & 1) + 2 * (1 - (cfx >> 1 & 1)) + 4 * (cfx & 1))


def quaternions(rotation: Array) -> Array:
    """Return q1…q4 (n, 4), q1 ≥ 0 the real part, of rotations (n, 3, 3).

    The largest of the four is computed first and the others from it, which is accurate near half turns (Shepperd 1978).
    """
    r = np.asarray(rotation).reshape(-1, 3, 3)
    trace = np.einsum("nii->n", r)
    diagonal = np.einsum("nii->ni", r)
    square = np.column_stack([1.0 + trace, 1.0 - trace[:, None] + 2.0 * diagonal])  # 4·qᵢ²
    multiples = np.empty((len(r), 4, 4))  # row i: 4·qᵢ·q
    x, y, z = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    multiples[:, 0] = np.column_stack([square[:, 0], x, y, z])
    multiples[:, 1] = np.column_stack([x, square[:, 1], xy, xz])
    multiples[:, 2] = np.column_stack([y, xy, square[:, 2], yz])
    multiples[:, 3] = np.column_stack([z, xz, yz, square[:, 3]])
    q = multiples[np.arange(len(r)), np.argmax(square, axis=1)]
    q /= np.sqrt(np.einsum("ni,ni->n", q, q))[:, None]
    return np.asarray(np.where(q[:, :1] < 0.0, -q, q))


def rotations(q: Array) -> Array:
    """Return rotations (n, 3, 3) of quaternions (n, 4), real part first; quaternions are normalised here."""
    w, x, y, z = (q / np.sqrt(np.einsum("ni,ni->n", q, q))[:, None]).T
    return np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        ),
        2,
        0,
    )


def poses(numbers: Array) -> Array:
    """Return poses (n, 4, 4) [m] of x, y, z [mm], q1…q4 (n, 7), rounded to single precision as in the controller."""
    stored_numbers = numbers.astype(np.float32).astype(np.float64)
    matrices = np.broadcast_to(np.eye(4), (len(numbers), 4, 4)).copy()
    matrices[:, :3, :3] = rotations(stored_numbers[:, 3:])
    matrices[:, :3, 3] = stored_numbers[:, :3] * M_PER_MM
    return matrices
