"""Memory that a conversion takes grows with the program by a bounded number of bytes for each target."""

import gc
import tracemalloc

from postproc import correction
from postproc.dialects.text import decode
from tests.kr270 import CELL, ROBOT

MOST = 830
"""Bytes for each target at the peak (783 today): poses, forces, joint angles, texts, and what computing them takes."""
READING = 200
"""Bytes for each line at the peak of reading KRL (183 today), the text not included: its columns, and its motions."""


def peak_of_reading(count: int) -> int:
    """Return the largest memory that reading a KRL program of `count` lines takes [bytes]."""
    gc.collect()
    lines = "".join(f"LIN {{X {0.1 * n:.4f},Y 50,Z 5,A 0,B 0,C 180}} C_DIS\r\n" for n in range(count))
    head = "DEF part( )\r\n$APO.CDIS=0.02\r\n$VEL.CP=0.01\r\n"
    document = decode("part.src", f"{head}{lines}END\r\n".encode())
    tracemalloc.start()
    try:
        program = correction.read([document], ROBOT, CELL, "part", "krl")
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(program.motions) == count
    return most


def peak(count: int) -> int:
    """Return the largest memory of a conversion of `count` lines [bytes]."""
    gc.collect()
    lines = "".join(f"X{0.1 * (n % 900):.1f} Y{0.1 * (n // 900):.1f}\n" for n in range(count))
    text = f"G21 G90\nM3 S1000\n(FORCE FX=100 FZ=50)\nG0 X0 Y0 Z0\nG1 F1000\n{lines}M2\n"
    tracemalloc.start()
    try:
        program = correction.read([decode("part.nc", text.encode())], ROBOT, CELL, "part", "gcode")
        result = correction.process(program, ROBOT, CELL)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(result) >= count
    assert not result.failed
    return most


def test_memory_for_each_target_is_bounded():
    peak(100)  # imports what is needed, fills caches
    small, large = peak(8_000), peak(40_000)
    assert (large - small) / 32_000 < MOST


def test_memory_for_each_line_of_krl_that_is_read_is_bounded():
    peak_of_reading(100)
    small, large = peak_of_reading(8_000), peak_of_reading(40_000)
    assert (large - small) / 32_000 < READING
