"""KRL out: a program as it was with other numbers, or a new one."""

from postproc.dialects.krl.write.emit import axis_motion, document, emit, head
from postproc.dialects.krl.write.modules import in_modules
from postproc.dialects.krl.write.renaming import own_copies, renamed
from postproc.dialects.krl.write.rewrite import rewrite
from postproc.dialects.krl.write.splitting import in_files

__all__ = ["axis_motion", "document", "emit", "head", "in_files", "in_modules", "own_copies", "renamed", "rewrite"]
