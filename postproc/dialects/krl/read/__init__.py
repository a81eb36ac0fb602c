"""From the files of a KRL program to a `Program`."""

from postproc.dialects.krl.read.reader import read_program

__all__ = ["read_program"]
