"""KUKA KRL: reading a program, writing it with other targets, and writing a new one.

program = krl.read([src, dat], cell, forward, "part")
written = krl.rewrite(program, targets)       # the same text with new numbers
written = krl.emit(program, targets, cell)    # a new program, from G-code
"""

from postproc.dialects.krl.emit import emit
from postproc.dialects.krl.layout import numbers
from postproc.dialects.krl.reader import read
from postproc.dialects.krl.renaming import renamed
from postproc.dialects.krl.rewrite import rewrite

__all__ = ["emit", "numbers", "read", "renamed", "rewrite"]
