"""GLOBAL variables of other files: points, frames and numbers that the `.dat` files of a folder declare for all."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection
from contextlib import suppress

from postproc.dialects.krl.language.tokens import NAME
from postproc.dialects.krl.read.data_lists import read_data
from postproc.dialects.krl.read.folder_files import FolderFiles
from postproc.dialects.krl.read.variables import Variables
from postproc.errors import ProgramError

GLOBAL_VARIABLE = re.compile(
    rb"^[ \t]*(?:(?:DECL|CONST)[ \t]+)*GLOBAL[ \t]+(?:(?:DECL|CONST)[ \t]+)*\w+[ \t]+(\w+)", re.I | re.M
)


def read_shared(variables: Variables, code: str, own: Collection[str], files: FolderFiles) -> None:
    """Take GLOBAL variables that a program uses from other `.dat` files; not those that several of them declare.

    :param code: of the program, as far as names may stand in it; what it calls counts too.
    :param own: names of its files.
    :param files: where to look.
    """
    mine = {name.upper() for name in own}
    others = [path for name, path in files.paths.items() if name.endswith(".DAT") and name not in mine]
    declared = {path: files.declared(path, GLOBAL_VARIABLE) for path in others}
    if not any(declared.values()):
        return
    times = Counter(name for names in declared.values() for name in names)
    used = set().union(*(NAME.findall(reached) for reached in files.reached(code)))
    known = ({name.upper() for name in used} | set(variables.types.values())) - variables.types.keys()
    wanted = {name for name in known if times[name] == 1}
    for path, names in declared.items():
        if not wanted.isdisjoint(names):
            with suppress(ProgramError):  # they have no values then, and a motion that needs one says so
                read_data(variables, files.source(path), fill=True, only=wanted)
