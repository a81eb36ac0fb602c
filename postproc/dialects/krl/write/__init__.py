"""KRL out: a program as it was with other numbers, or a new one."""

from postproc.dialects.krl.write.emit import emit
from postproc.dialects.krl.write.frame import axis_motion, document, head
from postproc.dialects.krl.write.own_copies import own_copies
from postproc.dialects.krl.write.renaming import renamed
from postproc.dialects.krl.write.rewrite import rewrite
from postproc.dialects.krl.write.splitting import in_files

__all__ = ["axis_motion", "document", "emit", "head", "in_files", "own_copies", "renamed", "rewrite"]
