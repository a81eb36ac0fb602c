"""KUKA KRL: reading a program, writing it with other targets, and writing a new one.

program = krl.read_program([src, dat], cell, forward, "part")
written = krl.rewrite(program, targets)       # the same text with new numbers
written = krl.emit(program, targets, cell)    # a new program, from G-code
"""

from postproc.dialects.krl.read import read_program
from postproc.dialects.krl.write import emit, rename, rewrite

__all__ = ["emit", "read_program", "rename", "rewrite"]
