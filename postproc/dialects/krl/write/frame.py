"""What every new KRL program has: header, DEF … END, the way to joint angles, CR LF."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from postproc.dialects.new_program import LINE_END
from postproc.program import Document

_HEADER = ("&ACCESS RVP", "&REL 1")
_DECLARATIONS_KRC2 = ("EXT BAS (BAS_COMMAND :IN,REAL :IN )",)  # a KRC2 does not know BAS without it


def head(name: str, controller: str, parameters: Sequence[str] = ()) -> list[str]:
    """Return the lines of a program down to its DEF.

    :param controller: ``"KRC4"`` or ``"KRC2"``.
    :param parameters: further lines of the header.
    """
    declarations = _DECLARATIONS_KRC2 if controller == "KRC2" else ()
    return [*_HEADER, *parameters, f"DEF {name}( )", *declarations]


def axis_motion(angles: Iterable[float], decimals: int) -> str:
    """Return the PTP to joint angles A1…A6 [deg]."""
    joints = ",".join(f"A{axis} {angle + 0.0:.{decimals}f}" for axis, angle in enumerate(angles, 1))
    return f"PTP {{{joints}}}"


def document(name: str, lines: Iterable[str]) -> Document:
    """Return a program of some lines, END behind them."""
    return Document(f"{name}.src", "".join(line + LINE_END for line in (*lines, "END")), "cp1252")
