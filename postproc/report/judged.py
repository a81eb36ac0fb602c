"""A verdict on a page: its headline, and the three answers as facts."""

from __future__ import annotations

from postproc.report.answers import Verdict, answer_rows
from postproc.report.formatting import State
from postproc.report.kit import Cell, Facts, Kind

_KINDS: dict[State, Kind] = {"ok": "good", "warning": "warning", "failed": "error"}


def split_headline(verdict: Verdict) -> tuple[str, str]:
    """Return the headline of a verdict as its first sentence, and the others."""
    first, _, later_sentences = verdict.headline.partition(". ")
    return (f"{first}.", later_sentences) if later_sentences else (first, "")


def answer_facts(verdict: Verdict) -> Facts:
    """Return the three answers as facts: question, and the answer in the style of its state."""
    rows = answer_rows(verdict.drive, verdict.better, verdict.tolerance)
    return Facts(tuple((question, Cell(as_sentence(answer), _KINDS[state])) for question, answer, state in rows))


def as_sentence(text: str) -> str:
    """Return a text with a capital letter at its start and a full stop at its end, unless it ends a sentence."""
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "?", "!")) else ".")
