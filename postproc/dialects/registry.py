"""Program formats: our own dialects and those of other packages, imported when they are needed.

Another package adds a dialect by an entry point, whose object fulfils `dialect.Dialect`:

    [project.entry-points."postproc.dialects"]
    fanuc = "my_package.fanuc:FANUC"

A dialect that cannot be imported raises no error until it is needed; `broken_dialects` gives the reasons.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from postproc.dialects.dialect import Dialect, Writer
from postproc.errors import InputError, ProgramError, choices

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "postproc.dialects"
_REQUIRED_MEMBERS = ("name", "extensions", "command_decimals", "writer", "companions", "read")
_BUILTIN = {
    "apt": "postproc.dialects.apt.reader:APT",
    "gcode": "postproc.dialects.gcode.reader:GCODE",
    "krl": "postproc.dialects.krl.dialect:KRL",
    "rapid": "postproc.dialects.rapid.dialect:RAPID",
}
_EXTENSIONS = {
    **dict.fromkeys((".nc", ".ngc", ".tap", ".cnc", ".gcode", ".mpf", ".ptp"), "gcode"),
    **dict.fromkeys((".apt", ".aptsource", ".cls", ".clsf", ".cl", ".clf", ".ncl", ".cldata"), "apt"),
    ".src": "krl",
    ".mod": "rapid",
    ".modx": "rapid",
}
"""Extensions of our own dialects; stated here so that a dialect need not be imported to get its extensions."""
_VERSIONED = re.compile(r"(.+\.ncl)\.(\d{1,9})", re.IGNORECASE)
"""Name of a cutter-location file of Creo, which keeps each version as a file, and the number of the version."""
_DEFAULT_OUTPUT = "krl"
"""Dialect of the output if the dialect of the program cannot be written."""
_NO_PROGRAMS = {
    ".dat": "the data of a KRL program. Give the .src file; the .dat of the same name is read with it.",
    ".sub": "a KRL submit program, which moves no robot. Give the .src file of the part.",
    ".h": "conversational code of a Heidenhain control. Have the CAM system post-process the part as plain G-code.",
    ".spf": "a subprogram of a Siemens Sinumerik control. Have the CAM system post-process the part as plain G-code, "
    "for Fanuc or LinuxCNC, or add --dialect gcode if it is plain G-code.",
    ".prg": "a program of a control that its extension does not name: several use .prg. Add --dialect gcode if "
    "it is G-code, --dialect rapid if it is a module of ABB.",
    ".ls": "a FANUC program. Have the CAM system post-process the part as plain G-code.",
}
"""Extensions of files that are no programs to read: what they are, and what to do."""


def dialect_of_name(name: str) -> Dialect:
    """Return the dialect with a name.

    :raises InputError: no dialect has this name, or its package cannot be used.
    """
    if name in _BUILTIN:
        return _builtin_dialect(name)
    dialect = _plugins().get(name)
    if dialect is None:
        raise InputError(
            f"unknown dialect {name!r}",
            advice=choices(name, names(), "There are"),
        )
    if isinstance(dialect, str):
        raise InputError(f"the dialect {name!r} cannot be used: {dialect}", advice="Mend or remove its package.")
    return dialect


def names() -> tuple[str, ...]:
    """Return the names of all dialects that can be used: our own first."""
    return (*_BUILTIN, *(name for name, dialect in _plugins().items() if not isinstance(dialect, str)))


def broken_dialects() -> dict[str, str]:
    """Return the dialects of other packages that cannot be used: name → reason."""
    return {name: reason for name, reason in _plugins().items() if isinstance(reason, str)}


def extensions() -> dict[str, str]:
    """Return the known extensions (lower case): extension → name of its dialect.

    If several dialects have an extension, it is that of our dialect, or of the first one of another package.
    """
    dialect_names = dict(_EXTENSIONS)
    for dialect in _plugins().values():
        if not isinstance(dialect, str):  # a text is the reason why the dialect cannot be used
            for extension in dialect.extensions:
                dialect_names.setdefault(extension, dialect.name)
    return dialect_names


def without_version(path: Path) -> Path:
    """Return the path of a file without the number of its version, which Creo puts behind `.ncl`: ``part.ncl.3``."""
    match = _VERSIONED.fullmatch(path.name)
    return path if match is None else path.with_name(match[1])


def program_name(path: Path) -> str:
    """Return the name of the program in a file: that of the file, without extension and version."""
    return without_version(path).stem


def has_known_extension(path: Path) -> bool:
    """Return whether the extension of a file is that of a dialect."""
    return without_version(path).suffix.lower() in extensions()


def newest_versions(paths: Iterable[Path]) -> list[Path]:
    """Return paths without older versions of other paths, in order."""
    newest: dict[Path, Path] = {}
    for path in paths:
        unversioned_path = without_version(path)
        newest[unversioned_path] = max(newest.get(unversioned_path, path), path, key=_version)
    return list(newest.values())


def _version(path: Path) -> int:
    """Return the number of the version of a file; 0 if its name has none."""
    match = _VERSIONED.fullmatch(path.name)
    return 0 if match is None else int(match[2])


def dialect_of_file(path: Path, name: str | None = None) -> Dialect:
    """Return the dialect of a file.

    :param name: name of the dialect; None: the extension decides.
    :raises ProgramError: the extension is not known, or is that of a file that cannot be read (`_NO_PROGRAMS`).
    :raises InputError: no dialect has this name, or its package cannot be used.
    """
    if name is not None:
        return dialect_of_name(name)
    extension = without_version(path).suffix.lower()
    if extension in _EXTENSIONS:
        return dialect_of_name(_EXTENSIONS[extension])
    dialect_names = extensions()
    if extension in dialect_names:
        return dialect_of_name(dialect_names[extension])
    if extension in _NO_PROGRAMS:
        description, _, advice = _NO_PROGRAMS[extension].partition(". ")
        raise ProgramError(f"this is {description}", file=str(path), advice=advice)
    advice = (
        f"Known extensions: {' '.join(dialect_names)}. "
        f"Otherwise say how to read it with --dialect {' or '.join(names())}."
    )
    advice += "".join(f" The dialect {name} cannot be used: {reason}." for name, reason in broken_dialects().items())
    raise ProgramError(f"unknown kind of program {path.suffix!r}", file=str(path), advice=advice)


def written_in(dialect: str, to: str | None = None) -> tuple[str, Writer]:
    """Return the name of the dialect in which a program is written, and the writer of this dialect.

    A program in a dialect with a writer is always written in its own dialect.

    :param dialect: dialect of the program as it was read.
    :param to: requested dialect of the output; None = the program's own if it has a writer, else KRL.
    :raises InputError: the program cannot be written in the requested dialect.
    """
    own_writer = dialect_of_name(dialect).writer
    if own_writer is not None:
        if to not in (None, dialect):
            raise InputError(
                f"a program in {dialect} is written in {dialect} again, not in {to}",
                advice="Post-process the part as G-code for another controller.",
            )
        return dialect, own_writer
    name = _DEFAULT_OUTPUT if to is None else to
    writer = dialect_of_name(name).writer
    if writer is None:
        dialects = [
            name_of_dialect for name_of_dialect in names() if dialect_of_name(name_of_dialect).writer is not None
        ]
        raise InputError(f"{name} is only read, not written", advice=f"Written are {', '.join(dialects)}.")
    return name, writer


def written_extensions() -> frozenset[str]:
    """Return the extensions of written programs, with their point."""
    writers = (dialect_of_name(name).writer for name in names())
    return frozenset(writer.extension for writer in writers if writer is not None)


@cache
def _builtin_dialect(name: str) -> Dialect:
    """Return a dialect of this package, imported at the first call."""
    module, _, attribute = _BUILTIN[name].partition(":")
    dialect: Dialect = getattr(import_module(module), attribute)
    return dialect


@cache
def _plugins() -> dict[str, Dialect | str]:
    """Return the dialects of other packages: name → dialect, or the reason why it cannot be used, as text."""
    from importlib.metadata import entry_points  # late: slow to import, and not needed for our own dialects

    return {entry.name: _plugin(entry) for entry in entry_points(group=GROUP) if entry.name not in _BUILTIN}


def _plugin(entry: EntryPoint) -> Dialect | str:
    """Return the dialect of an entry point, or the reason why it cannot be used, as text."""
    origin = f"of {entry.dist.name} {entry.dist.version}" if entry.dist else f"({entry.value})"
    try:
        plugin = entry.load()
    except (Exception, SystemExit) as cause:  # another package may do anything at import
        return f"the import {origin} fails ({type(cause).__name__}: {cause})"
    missing_names = [name for name in _REQUIRED_MEMBERS if not hasattr(plugin, name)]
    if missing_names:
        return f"the entry point {origin} is no dialect, it has no {', '.join(missing_names)}"
    if plugin.name != entry.name:
        return f"the entry point {origin} calls itself {plugin.name!r}"
    dialect: Dialect = plugin
    return dialect
