"""Which kind of file is read as which source of forces: here, and by packages that add their own."""

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
"""What reads the files of `--forces`, by their extension: module and function, imported when such a file is named."""
GROUP = "postproc.forces"
"""Entry points by which other packages add readers: each is named by its extension, as in ``".xlsx"``."""


def extensions() -> list[str]:
    """Return the extensions of the files that are read, lower case: our own first, then those that packages add."""
    from importlib.metadata import entry_points

    return [*READERS, *sorted({entry.name.lower() for entry in entry_points(group=GROUP)} - set(READERS))]


def read(path: Path) -> ForceSource:
    """Read a file of forces with the reader for its extension.

    A file of any other extension is taken for CSV.

    :raises ForceError: it is unusable, or the reader of another package is.
    """
    extension = path.suffix.lower()
    if extension not in READERS:
        from importlib.metadata import entry_points  # needed where a file is not of our own kinds

        added = {entry.name.lower(): entry for entry in entry_points(group=GROUP)}
        if extension in added:
            return _read_by(added[extension], path)
    module, _, name = READERS.get(extension, READERS[".csv"]).partition(":")
    reader: Callable[[Path], ForceSource] = getattr(import_module(module), name)
    return reader(path)


def _read_by(entry: EntryPoint, path: Path) -> ForceSource:
    """Read a file with the reader of another package, whose faults are told as such."""
    package = entry.dist.name if entry.dist is not None else entry.value
    try:
        source: ForceSource = entry.load()(path)
    except PostprocError:
        raise
    except Exception as cause:
        fault = f"{type(cause).__name__}: {cause}"
        raise ForceError(
            f"the reader of {entry.name} files that comes with {package} does not work: {fault}",
            file=str(path),
            advice=f"Update or remove {package}, or give the forces as a CSV file.",
        ) from cause
    return source
