"""Arrays in a page: numbers as bytes, in base64; `scripts/columns.js` makes typed arrays of them."""

from __future__ import annotations

import base64
from collections.abc import Mapping

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.frames import Array

_TYPES = {"f": "<f4", "i": "<i4", "b": "|u1"}


class Described(Struct, frozen=True):
    """A column in the bytes: its name, type and number of values (1 = the same everywhere)."""

    name: str
    type: str
    count: int


class Columns(Struct, frozen=True):
    """Columns of one length.

    :param length: of each.
    :param described: the columns in the order of their bytes.
    :param text: their bytes, base64.
    """

    length: int
    described: tuple[Described, ...]
    text: str

    @classmethod
    def of(cls, columns: Mapping[str, Array | NDArray[np.int64] | NDArray[np.bool_]]) -> Columns:
        """Pack columns (n,): numbers in single precision, whole ones in 32 bits, truths in a byte.

        A column that is the same everywhere is held as one number.
        """
        packed, described = [], []
        for name, values in sorted(columns.items(), key=lambda entry: entry[1].dtype.kind == "b"):
            exact = np.asarray(values).astype(_TYPES[values.dtype.kind])
            if len(exact) and (exact == exact[0]).all():
                exact = exact[:1]
            packed.append(exact.tobytes())
            described.append(Described(name, exact.dtype.str[1:], len(exact)))
        length = max((len(values) for values in columns.values()), default=0)
        return cls(length, tuple(described), base64.b64encode(b"".join(packed)).decode())
