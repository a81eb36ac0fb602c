"""The three answers on a page."""

from __future__ import annotations

from postproc.report.answers import Verdict, answer_rows
from postproc.report.formatting import State
from postproc.report.kit import Cell, Facts, Kind

_OF_STATES: dict[State, Kind] = {"ok": "good", "warning": "warning", "failed": "error"}


def split_headline(verdict: Verdict) -> tuple[str, str]:
    """Return the headline of a verdict as its first sentence, and the others."""
    first, _, later_sentences = verdict.headline.partition(". ")
    return (f"{first}.", later_sentences) if later_sentences else (first, "")


def answer_facts(verdict: Verdict) -> Facts:
    """Return the three answers as facts."""
    words = answer_rows(verdict.drive, verdict.better, verdict.tolerance)
    rows = ((question, Cell(as_sentence(answer), _OF_STATES[state])) for question, answer, state in words)
    return Facts(tuple(rows))


def as_sentence(text: str) -> str:
    """Return a text as a sentence."""
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "?", "!")) else ".")
