"""KRL out: a program as it was with other numbers, or a new one."""

from postproc.dialects.krl.write.emit import axis_motion, document, emit, head
from postproc.dialects.krl.write.modules import divide_into_modules
from postproc.dialects.krl.write.renaming import rename, subprogram_copies
from postproc.dialects.krl.write.rewrite import rewrite
from postproc.dialects.krl.write.splitting import split_files

__all__ = [
    "axis_motion",
    "divide_into_modules",
    "document",
    "emit",
    "head",
    "rename",
    "rewrite",
    "split_files",
    "subprogram_copies",
]
