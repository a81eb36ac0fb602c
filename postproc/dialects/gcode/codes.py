"""G and M codes: those that are read, those without effect on a robot, and advice for the others.

A code that is in none of these tables is refused, because an unknown code may move the machine.
"""

from __future__ import annotations

from typing import NamedTuple

MOTION = (0.0, 1.0, 2.0, 3.0)
CYCLES = (73.0, 81.0, 82.0, 83.0, 84.0, 85.0, 86.0, 89.0)
MOVING = (*MOTION, *CYCLES)
"""Codes that move the tool: G0 to G3 and cycles."""
CANCEL_CYCLE = 80.0
DWELL = 4.0
DWELL_WORDS = "PXUFS"
"""Words with the time of G4 [s]: the first one that the block has."""
TOOL_LENGTH = 43.0
BLENDING = 64.0
EXACT = (61.0, 61.1)
EXACT_BLOCK = 9.0
"""Exact stop at the end of its own block (Fanuc)."""
STORE, LOCAL, SHIFT, SHIFT_CLEARED, SHIFT_OFF, SHIFT_ON = 10.0, 52.0, 92.0, 92.1, 92.2, 92.3
ORIGINS = (STORE, LOCAL, SHIFT, SHIFT_CLEARED, SHIFT_OFF, SHIFT_ON)
HOME, HOME_2, MACHINE = 28.0, 30.0, 53.0
RETURNS = (HOME, HOME_2, MACHINE)
WORK_OFFSETS = (54.0, 55.0, 56.0, 57.0, 58.0, 59.0, 59.1, 59.2, 59.3)

GROUPS: dict[str, tuple[float, ...]] = {
    "plane": (17.0, 18.0, 19.0),
    "units": (21.0, 20.0),
    "distance": (90.0, 91.0),
    "centre": (91.1, 90.1),
    "offset": WORK_OFFSETS,
    "retract": (98.0, 99.0),
    "feed": (94.0, 93.0),
}
"""Modal groups that affect the path; the first code of each is in force when a program starts."""

GROUP_OF = {code: group for group, codes in GROUPS.items() for code in codes}

STOP, END, SPINDLE, CHANGE, COOLANT = (0.0, 1.0), (2.0, 30.0), (3.0, 4.0, 5.0), 6.0, (7.0, 8.0, 9.0)

SCALE_OFF = 50.0
_IGNORED_G = (13.1, 15.0, 40.0, 40.1, 49.0, SCALE_OFF, 50.1, 69.0, 97.0)
"""Codes without effect here. They cancel modes that are refused anyway (polar coordinates and interpolation, radius
compensation, knives, length offset, scale, mirror, rotation), or select the only supported mode (spindle in rpm)."""

SMOOTHING_MODES = {5.0: "P", 5.1: "QR", 8.0: "P", 103.0: "P", 187.0: "PE"}
"""Modes of look-ahead and smoothing, with their words (splines with the same code have other words); G103 of Haas
limits the blocks that are read ahead."""

_IGNORED_M = (48.0, 49.0)
"""Override switches of the operator's panel."""

OVERRIDES = (50.0, 51.0, 52.0, 53.0)
"""Override switches of LinuxCNC, with P0 or P1. Other controls use these codes without P for other things."""

OTHER_AXES = "ABCUVW"
"""Axes of a milling machine in addition to X, Y, Z, which a robot does not have."""

ACCEPTED_G = frozenset(
    (
        *GROUP_OF,
        *MOTION,
        *CYCLES,
        *ORIGINS,
        *RETURNS,
        CANCEL_CYCLE,
        DWELL,
        TOOL_LENGTH,
        BLENDING,
        *EXACT,
        EXACT_BLOCK,
        *_IGNORED_G,
    )
)
ACCEPTED_M = frozenset((*STOP, *END, *SPINDLE, CHANGE, *COOLANT, *_IGNORED_M))

RADIUS_BY_OFFSET = (41.0, 42.0, 41.2, 42.2)
"""Radius compensation by D of the control; G41.2 and G42.2 in three dimensions (Fanuc)."""
RADIUS = (*RADIUS_BY_OFFSET, 41.1, 42.1)
_COMPENSATION = (
    "Radius compensation is not supported: set the CAM system to output the tool centre line. If the offset holds wear "
    'only, the path is the centre line already: write D0, or radius_offsets = "wear" in [gcode] of the cell.'
)
_DIAMETER = (
    "Radius compensation by a diameter in the program is not supported: set the CAM system to output the tool centre "
    "line, or write D0 if the path is the centre line already."
)
_CYCLE = "This cycle needs an oriented or reversed spindle: set the CAM system to expand it to G0 and G1."
_FIVE_AXIS = (
    'Give [rotary] in the cell: axes, and kind = "tcp" if X, Y, Z are the tool tip in the part (tool-centre-point '
    'control), or kind = "indexed" if the part turns and X, Y, Z are machine axes.'
)
_LATHE = "Lathe modes are not supported."
_OUTPUT = (
    "Outputs are not supported: switch them in the KRL program, and remove the block or set [m_codes] M64 = [] in the "
    "cell."
)
_PLACES = "Stored positions and offsets are not supported: give work offsets in the cell, [work_offsets]."
_PROBE = "Probing and threading moves depend on the machine: remove them."
_SPLINE = "Splines, NURBS and smoothing modes are not supported: set the CAM system to output G1, G2 and G3."
_MACRO = (
    "Fanuc custom macros (G65 … G67) are not supported: call subprograms by M98, or set the CAM system to expand them."
)
_TOOL = "Give the tool in the cell, [tool]. Only G43 with H is accepted, without effect."
_ROTATION_ADVICE = (
    "Scaled, mirrored, rotated and polar coordinates are not supported: set the CAM system to output plain ones."
)
_TILTED_PLANE = (
    "Tilted work planes are not supported: switch them off in the post, so that it writes G43.4 with positions of the "
    'rotary axes ([rotary] kind = "tcp" in the cell) or turns the part (kind = "indexed"), or convert the '
    "cutter-location file (APT) of the operation."
)

_ADVICE_G = {
    **dict.fromkeys((5.0, 5.1, 5.2, 5.3, 6.1, 6.2, 6.3), _SPLINE),
    **dict.fromkeys((7.0, 8.0), _LATHE),
    **dict.fromkeys((28.1, 30.1), _PLACES),
    SCALE_OFF: "G50 is accepted without other words, as the end of a scale. The G50 of lathes is not supported.",
    **dict.fromkeys((16.0, 51.0, 51.1, 68.0), _ROTATION_ADVICE),
    **dict.fromkeys((53.1, 53.6, 68.2, 68.3, 68.4), _TILTED_PLANE),
    **dict.fromkeys((17.1, 18.1, 19.1), "Planes of U, V, W are not supported."),
    **dict.fromkeys((31.0, 33.0, 33.1, 38.2, 38.3, 38.4, 38.5), _PROBE),
    **dict.fromkeys(RADIUS_BY_OFFSET, _COMPENSATION),
    **dict.fromkeys((41.1, 42.1), _DIAMETER),
    **dict.fromkeys((43.1, 43.2, 44.0), _TOOL),
    43.4: _FIVE_AXIS,
    43.5: 'I, J, K are the direction of the tool then: write kind = "vector" in [rotary] of the cell, without axes.',
    54.1: "Only nine work offsets are supported: use G54…G59.3.",
    **dict.fromkeys((65.0, 66.0, 67.0), _MACRO),
    **dict.fromkeys((74.0, 76.0, 87.0, 88.0), _CYCLE),
    95.0: "Feed per revolution is not supported: set the CAM system to output F in mm/min or inch/min.",
    96.0: "Constant surface speed needs a lathe: write G97 with S in rpm.",
}
_ADVICE_M = {
    **dict.fromkeys(
        (13.0, 14.0), "It switches spindle and coolant on (DIN 66025), but not on all machines: write M3 or M4, and M8."
    ),
    29.0: (
        "It begins rigid tapping, which needs a spindle in step with the feed. Take a tap holder with length "
        "compensation, write M3 before G84, and remove M29; or let the CAM system mill the thread."
    ),
    19.0: "The spindle cannot be oriented: remove the block.",
    60.0: "There is no pallet: use M0 to stop.",
    61.0: "Write T and M6.",
    **dict.fromkeys((float(code) for code in range(62, 69)), _OUTPUT),
    **dict.fromkeys((70.0, 71.0, 72.0, 73.0), "Stored modes are not supported: program the modes themselves (G90 …)."),
    97.0: "Call subprograms by M98.",
}

WORD_ADVICE = {
    **dict.fromkeys("ABC", f"Rotary axes: {_FIVE_AXIS}"),
    **dict.fromkeys("UVW", "Secondary axes are not supported: write X, Y, Z, with G91 for increments."),
    "E": "Extruder words and numbers with exponents are not supported. Is this a milling program?",
}
"""Advice for words that no code of the block uses."""


class Refusal(NamedTuple):
    """Problem of a code that is not accepted, and advice."""

    problem: str
    advice: str


def refusal(letter: str, code: float) -> Refusal:
    """Return the refusal of a G or M code that is not accepted.

    :param letter: G or M; `code`: its number, such as 43.4.
    """
    advice = (_ADVICE_G if letter == "G" else _ADVICE_M).get(code)
    if advice is None:
        unknown_advice = "An unknown code may move the machine. Remove it if it has no effect here"
        suffix = f", or give its KRL lines in the cell: [m_codes] M{code:g} = [] for none." if letter == "M" else "."
        return Refusal(f"{letter}{code:g} is not known", unknown_advice + suffix)
    return Refusal(f"{letter}{code:g} is not supported", advice)
