"""Which G and M codes are read, which mean nothing to a robot, and what to do about the others.

A code stands in one of the tables below, or it is refused: what is not known may move the machine.
"""

from __future__ import annotations

MOTION = (0.0, 1.0, 2.0, 3.0)
CYCLES = (73.0, 81.0, 82.0, 83.0, 84.0, 85.0, 86.0, 89.0)
MOVING = (*MOTION, *CYCLES)
CANCEL_CYCLE = 80.0
DWELL = 4.0
TOOL_LENGTH = 43.0
BLENDING = 64.0
EXACT = (61.0, 61.1)
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
"""Modal groups whose state matters to the path; the first code of each is in force when a program starts."""

GROUP_OF = {code: group for group, codes in GROUPS.items() for code in codes}

STOP, END, SPINDLE, CHANGE, COOLANT = (0.0, 1.0), (2.0, 30.0), (3.0, 4.0, 5.0), 6.0, (7.0, 8.0, 9.0)

SCALE_OFF = 50.0
_IGNORED_G = (13.1, 15.0, 40.0, 40.1, 49.0, SCALE_OFF, 50.1, 69.0, 97.0)
"""Codes that only cancel what is refused here anyway (polar coordinates and interpolation, radius compensation, knives,
length offset, scale, mirror, rotation), or select what always holds (spindle in rpm)."""

SMOOTHING = {5.0: "P", 5.1: "QR", 8.0: "P", 187.0: "PE"}
"""Modes of look-ahead and smoothing, with the words that they have (splines of the same name have others)."""

_IGNORED_M = (48.0, 49.0)
"""Override switches of the operator's panel."""

OVERRIDES = (50.0, 51.0, 52.0, 53.0)
"""Such of LinuxCNC, with P0 or P1; without P they are of another control."""

READING = (61.0, 70.0, 71.0, 72.0, 73.0, 97.0, 98.0, 99.0)
"""M codes that change how the lines behind them are read: `[m_codes]` cannot say that they do nothing."""

OTHER_AXES = "ABCUVW"
"""Axes that a three-axis mill may have beside X, Y, Z, and a robot has not."""

ACCEPTED_G = frozenset(
    (*GROUP_OF, *MOTION, *CYCLES, *ORIGINS, *RETURNS, CANCEL_CYCLE, DWELL, TOOL_LENGTH, BLENDING, *EXACT, *_IGNORED_G)
)
ACCEPTED_M = frozenset((*STOP, *END, *SPINDLE, CHANGE, *COOLANT, *_IGNORED_M))

_COMPENSATION = (
    "Radius compensation is not read: let the CAM system write the centre line of the tool (compensation: in computer)."
)
_CYCLE = "This cycle needs an oriented or a reversed spindle: let the CAM system write it out as G0 and G1."
_FIVE_AXIS = "Give the rotary axes in the cell, [rotary], for a program with tool-centre-point control."
_LATHE = "Lathe modes are not read."
_OUTPUT = (
    "Outputs are not read: switch from the KRL program, and remove the block or say in the cell that it does nothing: "
    "[m_codes] M64 = []."
)
_PLACES = "Stored positions and offsets are not read: put work offsets into the cell, [work_offsets]."
_PROBE = "Probing and threading moves depend on the machine: remove them."
_SPLINE = "Splines and smoothing modes are not read: let the CAM system write G1, G2 and G3."
_MACRO = (
    "Fanuc's custom macros (G65 … G67) are not read: call subprograms by M98, or let the CAM system write them out."
)
_TOOL = "Put the tool into the cell, [tool]; only G43 with H is accepted, and has no effect."
_TURNED = "Scaled, mirrored, turned and polar coordinates are not read: let the CAM system write plain ones."

_ADVICE_G = {
    **dict.fromkeys((5.0, 5.1, 5.2, 5.3), _SPLINE),
    **dict.fromkeys((7.0, 8.0), _LATHE),
    **dict.fromkeys((28.1, 30.1), _PLACES),
    SCALE_OFF: "It is read where it ends a scale, without other words; those of lathes are not.",
    **dict.fromkeys((16.0, 51.0, 51.1, 68.0, 68.2), _TURNED),
    **dict.fromkeys((17.1, 18.1, 19.1), "Planes of U, V, W are not read."),
    **dict.fromkeys((31.0, 33.0, 33.1, 38.2, 38.3, 38.4, 38.5), _PROBE),
    **dict.fromkeys((41.0, 42.0, 41.1, 42.1), _COMPENSATION),
    **dict.fromkeys((43.1, 43.2, 44.0), _TOOL),
    **dict.fromkeys((43.4, 43.5), _FIVE_AXIS),
    54.1: "More than nine work offsets are not read: use G54…G59.3.",
    **dict.fromkeys((65.0, 66.0, 67.0), _MACRO),
    **dict.fromkeys((74.0, 76.0, 87.0, 88.0), _CYCLE),
    95.0: "Feed per turn needs the spindle's speed at every place: let the CAM system write F in mm/min or inch/min.",
    96.0: "Constant surface speed needs a lathe: write G97 with S in rpm.",
}
_ADVICE_M = {
    19.0: "The spindle cannot be oriented: remove the block.",
    60.0: "There is no pallet: use M0 to stop.",
    61.0: "Write T and M6.",
    **dict.fromkeys((float(code) for code in range(62, 69)), _OUTPUT),
    **dict.fromkeys(
        (70.0, 71.0, 72.0, 73.0), "Modes that are stored and restored are not read: write them out (G90 …)."
    ),
    97.0: "Call subprograms by M98.",
}

WORD_ADVICE = {
    **dict.fromkeys("ABC", f"Rotary axes: {_FIVE_AXIS}"),
    **dict.fromkeys("UVW", "Secondary axes are not read: write X, Y, Z, with G91 for increments."),
    "E": "Extruder words and numbers with exponents are not read: this reader is for milling programs.",
}
"""Advice for words that no code makes use of here."""


def refusal(letter: str, code: float) -> tuple[str, str]:
    """Return problem and advice for a G or M code that is not accepted."""
    advice = (_ADVICE_G if letter == "G" else _ADVICE_M).get(code)
    if advice is None:
        what = "It might move the machine. Remove it if it does not matter here"
        own = f", or say in the cell what it does: [m_codes] M{code:g} = [] for nothing." if letter == "M" else "."
        return f"{letter}{code:g} is not known", what + own
    return f"{letter}{code:g} is not supported", advice
