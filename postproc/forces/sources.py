"""Readers of force files by extension: built-in ones, and those that other packages add."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from postproc.errors import ForceError, PostprocError
from postproc.forces.knots import ForceSource

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

READERS = {".csv": "postproc.forces.table:read_force_csv"}
"""Readers of `--forces` files by extension, as module:function; imported when such a file is given."""
GROUP = "postproc.forces"
"""Entry-point group in which other packages add readers; entries are named by extension, e.g. ``".xlsx"``."""


def extensions() -> list[str]:
    """Return the readable file extensions, lower case: built-in ones first, then those that packages add."""
    from importlib.metadata import entry_points

    return [*READERS, *sorted({entry.name.lower() for entry in entry_points(group=GROUP)} - set(READERS))]


def read(path: Path) -> ForceSource:
    """Read a file of forces with the reader for its extension.

    Any other file is read as CSV.

    :raises ForceError: the file is unusable, or the reader of another package fails.
    """
    extension = path.suffix.lower()
    if extension not in READERS:
        from importlib.metadata import entry_points  # slow to import, needed only for other extensions

        added = {entry.name.lower(): entry for entry in entry_points(group=GROUP)}
        if extension in added:
            return _read_by(added[extension], path)
    module, _, name = READERS.get(extension, READERS[".csv"]).partition(":")
    reader: Callable[[Path], ForceSource] = getattr(import_module(module), name)
    return reader(path)


def _read_by(entry: EntryPoint, path: Path) -> ForceSource:
    """Read a file with the reader of another package; errors name that package."""
    package = entry.dist.name if entry.dist is not None else entry.value
    try:
        source: ForceSource = entry.load()(path)
    except PostprocError:
        raise
    except (Exception, SystemExit) as cause:
        fault = f"{type(cause).__name__}: {cause}"
        raise ForceError(
            f"the reader of {entry.name} files from {package} does not work: {fault}",
            file=str(path),
            advice=f"Update or remove {package}, or give the forces as a CSV file.",
        ) from cause
    return source
