"""Program files as text: decoding to the byte, and where the lines are. What every dialect shares.

Line numbers are those an editor shows. A line ends with LF, CR, CR LF, or CR CR LF (one end: what a text-mode
transfer makes of CR LF); nothing else ends a line, neither form feed nor the Unicode separators.
"""

from __future__ import annotations

import codecs

import numpy as np

from postproc.errors import ProgramError
from postproc.program import Document, Ints

_ENCODINGS = ("utf-8", "cp1252", "latin-1")


def decode(name: str, data: bytes) -> Document:
    """Return the content of a program file as text that encodes back to the same bytes.

    UTF-8 with or without byte order mark; what is not UTF-8 is taken as cp1252, and as latin-1 where cp1252 has no
    character for a byte (comments in other code pages survive that way).

    :param name: file name with extension, for messages and for `Document.name`.
    :param data: content of the file.
    :raises ProgramError: the file is empty or blank, or it is binary (holds NUL bytes).
    """
    bom = codecs.BOM_UTF8 if data.startswith(codecs.BOM_UTF8) else b""
    body = data[len(bom) :]
    if not body.strip():
        raise ProgramError("the program is empty", file=name, advice="Check that the file was transferred completely.")
    nul = data.find(b"\0")
    if nul >= 0:
        raise ProgramError(
            f"binary file (byte {nul} is NUL)", file=name, advice="Give the program as text, saved as UTF-8 or ASCII."
        )
    for encoding in _ENCODINGS:
        try:
            return Document(name, body.decode(encoding), encoding, bom)
        except UnicodeDecodeError:
            continue
    raise AssertionError("latin-1 decodes any byte")  # pragma: no cover


def line_spans(text: str) -> tuple[Ints, Ints]:
    """Return where each line begins and where it stops, (L,) and (L,): ``text[start:stop]`` is line i + 1.

    The line end is not part of the line. What follows the last line end is a line only if it is not empty.
    """
    try:
        units = np.frombuffer(text.encode("latin-1"), dtype=np.uint8)
    except UnicodeEncodeError:
        units = np.frombuffer(text.encode("utf-32-le", "surrogatepass"), dtype=np.uint32)
    lf, cr = units == 10, units == 13
    if not cr.any():
        stops = np.flatnonzero(lf)
        starts = np.concatenate([[0], stops + 1])
    else:
        cr1 = np.concatenate([[False], cr[:-1]])  # the character before is CR
        cr2 = np.concatenate([[False, False], cr[:-2]])[: len(units)]
        lf_next = np.concatenate([lf[1:], [False]])
        cr_lf_next = np.concatenate([(cr[1:] & lf_next[1:]), [False]])
        ends = np.flatnonzero(lf | (cr & ~lf_next & ~cr_lf_next))
        width = np.where(lf[ends], 1 + cr1[ends] * (1 + cr2[ends].astype(np.int64)), 1)
        stops = ends + 1 - width
        starts = np.concatenate([[0], ends + 1])
    if starts[-1] == len(units):
        starts = starts[:-1]
    else:
        stops = np.concatenate([stops, [len(units)]])
    return starts.astype(np.int64), stops.astype(np.int64)


def line_starts(text: str) -> Ints:
    """Return the offset of the first character of each line, (L,); see `line_spans`."""
    return line_spans(text)[0]
