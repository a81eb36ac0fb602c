"""A verdict on a page: its headline, and the three answers as facts."""

from __future__ import annotations

from postproc.report.answers import Verdict, answer_rows
from postproc.report.formatting import State
from postproc.report.kit import Cell, Facts, Kind

_STATE_KINDS: dict[State, Kind] = {"ok": "good", "warning": "warning", "failed": "error"}


def split_headline(verdict: Verdict) -> tuple[str, str]:
    """Return the headline of a verdict in two parts: its first sentence, and the later ones.

    The second part is empty if the headline is one sentence.
    """
    first, _, later_sentences = verdict.headline.partition(". ")
    return (f"{first}.", later_sentences) if later_sentences else (first, "")


def answer_facts(verdict: Verdict) -> Facts:
    """Return the three answers as facts: each question, with its answer in the style of the state."""
    rows = answer_rows(verdict.drive, verdict.better, verdict.tolerance)
    return Facts(tuple((question, Cell(as_sentence(answer), _STATE_KINDS[state])) for question, answer, state in rows))


def as_sentence(text: str) -> str:
    """Return a text with a capital letter at its start, and with a full stop unless it ends in ".", "?" or "!"."""
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "?", "!")) else ".")
