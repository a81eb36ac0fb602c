"""Readers and writers of program formats: the rules of a format are in one place, behind one protocol."""

from postproc.dialects.dialect import Dialect, Writer

__all__ = ["Dialect", "Writer"]
