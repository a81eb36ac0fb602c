"""Strict reading of TOML and CSV, reading of meshes; sets of files that are replaced together (atomically)."""

from postproc.files.locking import locked
from postproc.files.reading import convert, parse_csv, read_csv, read_mesh, read_text, read_toml
from postproc.files.writing import (
    FileEntry,
    Staged,
    discard,
    foreign,
    foreign_single,
    listed,
    noted,
    recorded,
    refuse,
    remove_leftovers,
    replace,
    sealed,
    stage,
    toml,
    with_record,
    write_whole,
)

__all__ = [
    "FileEntry",
    "Staged",
    "convert",
    "discard",
    "foreign",
    "foreign_single",
    "listed",
    "locked",
    "noted",
    "parse_csv",
    "read_csv",
    "read_mesh",
    "read_text",
    "read_toml",
    "recorded",
    "refuse",
    "remove_leftovers",
    "replace",
    "sealed",
    "stage",
    "toml",
    "with_record",
    "write_whole",
]
