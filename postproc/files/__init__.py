"""Strict reading of TOML and CSV, and writing that leaves whole files or none."""

from postproc.files.reading import convert, parse_csv, read_csv, read_text, read_toml
from postproc.files.writing import remove_leftovers, toml, write_whole

__all__ = ["convert", "parse_csv", "read_csv", "read_text", "read_toml", "remove_leftovers", "toml", "write_whole"]
