"""Fixed-point text equals what `%` prints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from postproc.decimals import fixed_point_text, lines, parsed_numbers


def texts(values, decimals):
    return [bytes(row[row > 0]).decode() for row in fixed_point_text(np.array(values, dtype=float), decimals)]


@given(st.lists(st.floats(-9e15, 9e15) | st.floats(-2e4, 2e4), min_size=1, max_size=30), st.integers(0, 9))
def test_digits_are_those_of_the_scaled_and_rounded_value(values, decimals):
    scaled = [round(value * 10.0**decimals) for value in values]  # half to even, as an integer of any size
    assume(max(map(abs, scaled)) < 2**53)
    for number, text in zip(scaled, texts(values, decimals), strict=True):
        digits = str(abs(number)).rjust(decimals + 1, "0")
        point = len(digits) - decimals
        assert text == ("-" if number < 0 else "") + digits[:point] + ("." + digits[point:] if decimals else "")


@given(st.lists(st.floats(-1e7, 1e7), min_size=1, max_size=30), st.integers(0, 6))
def test_text_is_the_value_rounded_to_its_decimals(values, decimals):
    for value, text in zip(values, texts(values, decimals), strict=True):
        assert abs(float(text) - value) <= 0.5000001 * 10.0**-decimals + 1e-9
        assert len(text.partition(".")[2]) == decimals
        assert not text.startswith("-0") or float(text) != 0.0


def test_small_negative_numbers_are_never_minus_zero_and_absent_ones_are_empty():
    assert texts([-0.0004, -0.0006, np.nan, 0.0, 12345.6789, -1.0], 3) == [
        "0.000", "-0.001", "", "0.000", "12345.679", "-1.000",
    ]  # fmt: skip


def test_long_integers_keep_their_inner_zeros():
    assert texts([100000000, 10001, 9999, 10000], 0) == ["100000000", "10001", "9999", "10000"]


def test_lines_join_texts_and_numbers():
    assert lines([b"X ", fixed_point_text(np.array([1.0, 22.5]), 1), b"\r\n"]) == b"X 1.0\r\nX 22.5\r\n"


def test_a_number_that_cannot_be_written_digit_by_digit_is_an_error():
    with pytest.raises(ValueError, match="too large"):
        fixed_point_text(np.array([1e300]), 3)


def test_numbers_are_read_as_float_reads_them():
    rng = np.random.default_rng(4)
    texts = [
        "0",
        "-0.0",
        "+7.",
        ".5",
        "-.25",
        "12345678.1234567",
        "00000001.00",
        "99999999",
        "-1.0000000",
        "0.1",
        "8.3",
    ]
    texts += [f"{value:.{places}f}" for places in range(8) for value in rng.uniform(-9999, 9999, 300)]
    text, starts = " ".join(texts), np.cumsum([0, *(len(word) + 1 for word in texts)])
    raw = np.frombuffer(text.encode(), dtype=np.uint8)
    found = parsed_numbers(raw, starts[:-1], starts[1:] - 1)
    np.testing.assert_array_equal(found, [float(word) for word in texts])
    np.testing.assert_array_equal(np.signbit(found), [word.startswith("-") for word in texts])


@pytest.mark.parametrize(
    "text", ["1.2.3", "1-2", "--5", ".", "+", "1E5", "123456789", "0.123456789", "1234567.12345678 9"]
)
def test_what_is_no_plain_number_is_not_read(text):
    raw = np.frombuffer(f"1.5 {text}".encode(), dtype=np.uint8)
    assert parsed_numbers(raw, np.array([0, 4]), np.array([3, len(raw)])) is None
