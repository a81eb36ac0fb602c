"""The page Help names messages that exist, and the pictures of concepts are those of their script."""

from __future__ import annotations

import re

import pytest

from tests.documentation import concepts
from tests.documentation.pages import DOCS
from tests.places import ROOT

_CODE = re.sub(
    r'" f?"',
    "",
    " ".join(" ".join(path.read_text(encoding="utf-8").split()) for path in (ROOT / "postproc").rglob("*.py")),
)
_LEAST = 8
"""Shorter pieces of a message are in any code."""


def messages():
    rows = re.findall(r"^\| ([^|]+) \| ", (DOCS / "guide" / "help.md").read_text(encoding="utf-8"), re.M)
    return [row for row in rows if row not in ("message", "---")]


def absent(message):
    pieces = [piece.strip(" '.|:") for piece in re.sub(r"\d+", "…", message).split("…")]
    return [piece for piece in pieces if len(piece) >= _LEAST and piece not in _CODE]


def test_there_are_twenty_messages():
    assert len(messages()) >= 20


@pytest.mark.parametrize("message", messages())
def test_a_message_of_the_page_is_one_of_the_program(message):
    assert absent(message) == []


def test_a_message_that_does_not_exist_would_be_noticed():
    assert absent("the robot is tired … today") == ["the robot is tired"]


@pytest.mark.parametrize("draw", [concepts.correction, concepts.frames, concepts.answers])
def test_a_picture_of_a_concept_is_that_of_its_script(draw):
    assert (DOCS / "pictures" / f"{draw.__name__}.svg").read_text(encoding="utf-8") == draw()
