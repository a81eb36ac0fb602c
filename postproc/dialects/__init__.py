"""Readers and writers of program formats: each format's rules stand in one place, behind one protocol."""

from postproc.dialects.dialect import Dialect, Writer

__all__ = ["Dialect", "Writer"]
