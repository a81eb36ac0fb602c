"""The verdict: in ten seconds, whether to trust the program."""

from postproc.report.deviation.content import Deviation
from postproc.report.kit import Kind, Note, Notes, Part, Section, Verdict
from postproc.report.verdict import WORDS


def section(told: Deviation) -> Section:
    """Return the verdict with its reasons, what holds, and what it rests on."""
    judged = told.verdict
    word = WORDS[told.compared, judged.state]
    first, *others = judged.reasons
    parts: list[Part] = [Verdict(judged.state, word, _sentence(first))]
    if others:
        kind: Kind = "error" if judged.state == "failed" else ""
        title = "Holds" if judged.state == "ok" else "And"
        parts.append(Notes(tuple(Note(_sentence(text), kind) for text in others), title, marked=True))
    if judged.holds and judged.state != "ok":
        parts.append(Notes(tuple(Note(_sentence(text)) for text in judged.holds), "What holds", marked=True))
    parts.append(Notes(tuple(Note(_sentence(text)) for text in judged.assumes), "Under these assumptions", marked=True))
    return Section("verdict", "Verdict", tuple(parts))


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "?", "!")) else ".")
