"""Places of the numbers of a module in its text: what the reader passes to the writer."""

from __future__ import annotations

from msgspec import Struct

from postproc.dialects.rapid.moves import Move
from postproc.dialects.rapid.syntax import Comment
from postproc.frames import Array
from postproc.program import Ints


class Layout(Struct, frozen=True, eq=False):
    """The text of M motions.

    :param numbers: (M, 6) X, Y, Z [mm], A, B, C [deg] in the work objects, as written.
    :param text: text with loops and routines expanded, see `expansion`; the text of the file if `is_plain`.
    :param is_plain: True if nothing was expanded.
    :param moves: (M,) the motions.
    :param notes: force comments of the program, in order.
    :param declared_names: names of all data, upper case.
    """

    numbers: Array
    text: str
    is_plain: bool
    moves: tuple[Move, ...]
    notes: tuple[Comment, ...]
    declared_names: frozenset[str]

    def places(self, rows: Ints) -> None:
        """Return None: a module is one file."""

    def orientation_types(self, rows: Ints) -> None:
        """Return None: RAPID has no setting like `$ORI_TYPE`."""
