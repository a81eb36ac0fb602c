"""Strict reading of TOML and CSV, and writing that leaves whole files or none."""

from postproc.files.reading import convert, parse_csv, read_csv, read_text, read_toml
from postproc.files.records import (
    FileEntry,
    foreign,
    foreign_single,
    listed,
    noted,
    recorded,
    refuse,
    sealed,
    with_record,
)
from postproc.files.writing import alone_in, remove_leftovers, toml, write_whole

__all__ = [
    "FileEntry",
    "alone_in",
    "convert",
    "foreign",
    "foreign_single",
    "listed",
    "noted",
    "parse_csv",
    "read_csv",
    "read_text",
    "read_toml",
    "recorded",
    "refuse",
    "remove_leftovers",
    "sealed",
    "toml",
    "with_record",
    "write_whole",
]
