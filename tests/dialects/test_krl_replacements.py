"""Replacing pieces of a text against Python's own slicing."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from postproc.dialects.krl.write.edits import Replacements


@given(
    st.text(alphabet="ab 1.;\r\näΩ𝄞", max_size=60),
    st.lists(st.tuples(st.integers(0, 60), st.integers(0, 5), st.text(alphabet="xYä", max_size=4)), max_size=8),
    st.integers(1, 9),
)
def test_pieces_are_replaced_as_slicing_would(text, wishes, chunk):
    pieces, end = [], 0
    for start, length, new in sorted(wishes):
        if end <= start <= len(text):
            end = min(start + length, len(text))
            pieces.append((start, end, new))
            end = max(end, start + 1)
    expected, done = "", 0
    edits = Replacements()
    for start, stop, new in pieces:
        expected += text[done:start] + new
        done = stop
    for start, stop, new in reversed(pieces):
        edits.add(start, stop, new)
    assert edits.apply(text, chunk) == expected + text[done:]


def test_insertions_at_one_place_stay_in_order():
    edits = Replacements()
    for new in ("one ", "two ", "three "):
        edits.add(2, 2, new)
    edits.add(2, 3, "X")
    assert edits.apply("ab_cd") == "abone two three Xcd"


def test_numbers_are_printed_with_the_decimals_asked_for():
    edits = Replacements()
    starts = np.array([2, 8, 14])
    edits.add_numbers(starts, starts + 3, np.array([1.25, -0.00001, 1e5]), np.array([4, 3, 0]), np.zeros(3, dtype=int))
    edits.add(0, 1, "Ω")
    assert edits.apply("X 000,Y 000,Z 000}") == "Ω 1.2500,Y 0.000,Z 100000}"
    assert not Replacements()
    assert Replacements().apply("same") == "same"
