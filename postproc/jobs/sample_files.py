"""`postproc samples`: the samples that come with the package, as files of one's own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from postproc.errors import InputError
from postproc.files import listed, write_whole


def copy_samples(folder: Path, *, overwrite: bool = False) -> list[Path]:
    """Write the samples into a folder.

    :param overwrite: replace files that are there and differ.
    :returns: what was written.
    :raises InputError: files are there that differ.
    """
    root = shipped_samples()
    contents = {path.relative_to(root): path.read_bytes() for path in _files(root)}
    there = [folder / name for name, content in contents.items() if _differs(folder / name, content)]
    if there and not overwrite:
        raise InputError(
            f"these files are there, and differ: {listed(there)}", advice="Choose another folder, or give --overwrite."
        )
    written = []
    for place in sorted({name.parent for name in contents}):
        own = {name.name: content for name, content in contents.items() if name.parent == place}
        written += write_whole(folder / place, own)
    return written


def shipped_samples() -> Path:
    """Return the folder of the samples: in the installed package, or next to it in a checkout."""
    package = Path(__file__).parent.parent
    inside = package / "samples"
    return inside if inside.is_dir() else package.parent / "samples"


def _files(root: Path) -> Iterator[Path]:
    for path in sorted(root.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            yield path


def _differs(path: Path, content: bytes) -> bool:
    return path.exists() and not (path.is_file() and path.read_bytes() == content)
