"""The measure of names: what it calls vague is what makes a reader guess."""

from __future__ import annotations

import pytest

from tests import names

pytestmark = pytest.mark.skipif(not names.WORDNET.exists(), reason="needs the Debian package wordnet-base")


@pytest.mark.parametrize(
    "name", ["found", "one", "other", "own", "each", "given", "held", "known", "_kept", "apart", "behind", "most_moved"]
)
def test_pronouns_participles_and_prepositions_are_vague(name):
    assert names.kind_of_name(name) in names.VAGUE


@pytest.mark.parametrize(
    "name",
    [
        "deviation",
        "largest_gap",
        "contact_points",
        "line_numbers",
        "is_rapid",
        "bound",
        "after_mm",
        "torques",
        "spacing",
    ],
)
def test_nouns_of_the_field_and_flags_are_not_vague(name):
    assert names.kind_of_name(name) not in names.VAGUE


def test_a_name_is_counted_once_in_each_function_that_binds_it(tmp_path):
    (tmp_path / "part.py").write_text(
        "def gap(one):\n    found = one\n    found = 2 * found\n    return [each for each in found]\n"
        "def reach():\n    found = 1\n    return found\n"
    )
    bound = [(name.function, name.text) for name in names.bound_names(tmp_path)]
    assert bound == [("gap", "one"), ("gap", "found"), ("gap", "each"), ("reach", "found")]
