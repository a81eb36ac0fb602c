"""APT cutter-location data (ISO 4343): `statements` splits the text, `walk` executes it, `reader` makes the program."""

from postproc.dialects.apt.reader import read

__all__ = ["read"]
