"""Place of the part and turn of the tool about its axis: what the robot can drive, and how exactly it cuts there.

`drive` evaluates joint angles: reach, limits, singular poses, joint speeds, expected error. The turn of the tool
is chosen on a map of path × angle (`turn_map`), the place of the part in a region of `$BASE` (`region`).
"""

from postproc.placement.drive import FREE, REASONS, LeastMargins
from postproc.placement.samples import PathSamples
from postproc.placement.turn_map import TurnMap
from postproc.placement.turning import NO_CLEARANCE, Turn, bin_turns, choose_turn, in_chosen_turn, turn_program

__all__ = [
    "FREE",
    "NO_CLEARANCE",
    "REASONS",
    "LeastMargins",
    "PathSamples",
    "Turn",
    "TurnMap",
    "bin_turns",
    "choose_turn",
    "in_chosen_turn",
    "turn_program",
]
