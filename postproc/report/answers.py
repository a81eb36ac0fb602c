"""Three answers on a program: may it be driven, is it better than uncorrected, does it hold the tolerance.

They have one form everywhere: in report.json, on pages, on the terminal, in the hosts. State, colour and exit code
follow from one table:

| answer | ok | warning | failed |
|---|---|---|---|
| drive | nothing is wrong | a warning on motions, or a joint near its limit | it may not be driven |
| better | the chance is at least `WIDE`, or nothing to judge | below, unknown, or a worse worst place | below `HARM` |
| tolerance | held | cannot be judged | not held |

`WIDE` and `HARM` are those of `postproc.elastostatics`.
The state of the whole is the worst of the three. A wide bound alone never fails: with both expected errors the user
can decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec import Struct

from postproc.correction import Mode
from postproc.report.formatting import State, two_digits

COLOURS: dict[State, str] = {"ok": "green", "warning": "amber", "failed": "red"}
EXIT_CODES: dict[State, int] = {"ok": 0, "warning": 0, "failed": 3}
_ORDER: tuple[State, ...] = ("ok", "warning", "failed")
WORDS: dict[tuple[Mode, State], str] = {
    ("convert", "ok"): "May be run.",
    ("convert", "warning"): "Look before you run it.",
    ("convert", "failed"): "Do not run it.",
    ("nominal", "ok"): "May be run, without correction.",
    ("nominal", "warning"): "Without correction. Look before you run it.",
    ("nominal", "failed"): "Without correction. Do not run it.",
    ("predict", "ok"): "As programmed.",
    ("predict", "warning"): "As programmed, with reservations.",
    ("predict", "failed"): "Do not run it as it is.",
}
"""The verdict in a word."""
LIMITS_AND_COLLISIONS = "joint limits, speeds and collisions"
"""What a comparison leaves to a prediction of the second program."""
SPLINES = "splines between their points"
RUN_TIME = "motions that are known at run time only"
TOOL_CHANGES = "paths behind tool changes"
UNCHECKED = {
    "collisions": "the cell has no [collision]",
    "moves through material": "no stock is known: give --process",
    LIMITS_AND_COLLISIONS: "predict checks them",
    SPLINES: "they are followed along their chords",
    RUN_TIME: "they are kept as they are",
    TOOL_CHANGES: "they begin where the called program leaves the robot",
}
"""What may be left unchecked, and why."""


class Remedy(Struct, frozen=True):
    """What would lower the expected error on the part, and to what (95 %)."""

    action: str
    expected_mm: float


class Drive(Struct, frozen=True):
    """May it be driven? `unchecked` names what was not looked at."""

    state: State
    reasons: list[str]
    unchecked: list[str]


class Improvement(Struct, frozen=True):
    """Is it better than the uncorrected program? Expected errors on the part (95 %) along the cutting path.

    `uncorrected_mm` and `corrected_mm` are those of the worst target, the program as read and as corrected; None where
    the model states no uncertainty. `chance`: that correction makes the part better (RMS); None where nothing changes.
    """

    state: State
    uncorrected_mm: float | None
    corrected_mm: float | None
    uncorrected_rms_mm: float | None
    corrected_rms_mm: float | None
    chance: float | None
    reasons: list[str]


class Tolerance(Struct, frozen=True):
    """Does it hold the tolerance that the user gave?

    :param mm: the tolerance, and `of` what: the "part", or the "path" between the written targets.
    :param beyond_percent: share of the length of the cutting path on which it is exceeded; None where unknown.
    """

    state: State
    of: str
    mm: float
    held: bool | None
    beyond_percent: float | None
    would_help: list[Remedy]
    reasons: list[str]


class Verdict(Struct, frozen=True):
    """The three answers, and what joins them.

    :param headline: in one or two sentences.
    :param answers: each of the three questions with its answer.
    :param reasons: what decides the state, the worst first; for "ok" what to expect.
    :param holds: what to expect and what was checked and holds.
    :param assumes: assumptions of all of it.
    """

    state: State
    headline: str
    answers: list[str]
    drive: Drive
    better: Improvement | None
    tolerance: Tolerance | None
    reasons: list[str]
    holds: list[str]
    assumes: list[str]

    @property
    def exit_code(self) -> int:
        """Exit code of the command that judged it."""
        return EXIT_CODES[self.state]


def worst_state(states: Iterable[State]) -> State:
    """Return the worst of states, "ok" of none."""
    return max(states, key=_ORDER.index, default="ok")


def verdict_of(
    mode: Mode,
    drive: Drive,
    better: Improvement | None,
    tolerance: Tolerance | None,
    holds: Sequence[str] = (),
    assumes: Sequence[str] = (),
    *,
    words: Mapping[State, str] | None = None,
    remark: str = "",
) -> Verdict:
    """Return the verdict that joins three answers.

    :param words: with which the headline begins, by state; None: `WORDS`.
    :param remark: a sentence with which the headline ends, such as an assumption that nobody has confirmed.
    """
    answers = [answer for answer in (drive, better, tolerance) if answer is not None]
    state = worst_state(answer.state for answer in answers)
    by_severity = sorted(answers, key=lambda answer: -_ORDER.index(answer.state))
    reasons = [reason for answer in by_severity for reason in answer.reasons]
    word = WORDS[mode, state] if words is None else words[state]
    sentences = (word, _improvement_sentence(mode, better), _tolerance_sentence(tolerance), remark)
    headline = " ".join(sentence for sentence in sentences if sentence)
    return Verdict(
        state=state,
        headline=headline,
        answers=[f"{question} {answer}" for question, answer, _ in answer_rows(drive, better, tolerance)],
        drive=drive,
        better=better,
        tolerance=tolerance,
        reasons=reasons or list(holds),
        holds=list(holds),
        assumes=list(assumes),
    )


_FORMS: dict[Mode, str] = {
    "convert": "Uncorrected up to {} mm, corrected up to {} mm (95 %){}.",
    "nominal": "Uncorrected, as written, up to {} mm; corrected it would be up to {} mm (95 %){}.",
    "predict": "Uncorrected up to {} mm; corrected it would be up to {} mm (95 %){}.",
}


def _improvement_sentence(mode: Mode, better: Improvement | None) -> str:
    """Return a sentence with both expected errors; empty where there is nothing to compare."""
    if better is None or better.uncorrected_mm is None or better.corrected_mm is None or better.chance is None:
        return ""
    chance = "" if better.state == "ok" else f", better with a chance of {chance_in_words(better.chance)}"
    return _FORMS[mode].format(two_digits(better.uncorrected_mm), two_digits(better.corrected_mm), chance)


def _tolerance_sentence(tolerance: Tolerance | None) -> str:
    """Return a sentence on the tolerance of the part, empty without one."""
    if tolerance is None or tolerance.of != "part":
        return ""
    if tolerance.held is None:
        return f"It is not known whether your tolerance of {tolerance.mm:g} mm is held."
    if tolerance.held:
        return f"Your tolerance of {tolerance.mm:g} mm is held."
    sentence = f"Your tolerance of {tolerance.mm:g} mm is not held"
    return f"{sentence}. What would help: {remedies(tolerance.would_help)}." if tolerance.would_help else f"{sentence}."


def remedies(actions: Sequence[Remedy]) -> str:
    """Return remedies in words with the expected error [mm] of each, the smallest first."""
    by_error = sorted(actions, key=lambda remedy: remedy.expected_mm)
    return ", ".join(f"{remedy.action} ({two_digits(remedy.expected_mm)} mm at best)" for remedy in by_error)


QUESTIONS = ("May it be driven?", "Is it better than uncorrected?", "Does it hold your tolerance?")


def answer_rows(drive: Drive, better: Improvement | None, tolerance: Tolerance | None) -> list[tuple[str, str, State]]:
    """Return question, answer and state of each of the three answers."""
    answers: tuple[tuple[str, State], ...] = (
        (_drive_text(drive), drive.state),
        (_comparison_text(better), "ok" if better is None else better.state),
        (_tolerance_text(tolerance), "ok" if tolerance is None else tolerance.state),
    )
    return [(question, *answer) for question, answer in zip(QUESTIONS, answers, strict=True)]


def _drive_text(drive: Drive) -> str:
    """Return in words whether the program can be driven, and what was not checked."""
    answer = {"ok": "yes", "warning": "see the reasons", "failed": "no"}[drive.state]
    unchecked_names = ", ".join(
        f"{name} ({UNCHECKED[name]})" if name in UNCHECKED else name for name in drive.unchecked
    )
    return f"{answer}; not checked: {unchecked_names}" if unchecked_names else answer


def _comparison_text(better: Improvement | None) -> str:
    """Return uncorrected and corrected error in words, with the chance that the correction helps."""
    if better is None or better.uncorrected_mm is None or better.corrected_mm is None:
        return "not known"
    if better.chance is None:
        return f"nothing is corrected; up to {two_digits(better.corrected_mm)} mm (95 %)"
    pair = ((better.uncorrected_mm, better.uncorrected_rms_mm), (better.corrected_mm, better.corrected_rms_mm))
    uncorrected_text, corrected_text = (
        f"up to {two_digits(largest)} mm, RMS {two_digits(rms or 0.0)}" for largest, rms in pair
    )
    return f"chance {chance_in_words(better.chance)}: uncorrected {uncorrected_text}; corrected {corrected_text} (95 %)"


def _tolerance_text(tolerance: Tolerance | None) -> str:
    """Return in words which tolerance was given and whether it is held."""
    if tolerance is None:
        return "none is given"
    answer = {None: "not known", True: "held", False: "not held"}[tolerance.held]
    return f"{tolerance.mm:g} mm{' of the path' if tolerance.of == 'path' else ''}: {answer}"


def chance_in_words(chance: float) -> str:
    """Return a chance in percent, never 0 or 100.

    >>> chance_in_words(0.834), chance_in_words(0.9999), chance_in_words(0.0)
    ('83 %', 'over 99 %', 'under 1 %')
    """
    return "over 99 %" if chance > 0.99 else "under 1 %" if chance < 0.01 else f"{100.0 * chance:.0f} %"


UNJUDGED = verdict_of("convert", Drive("ok", [], []), None, None)
"""A placeholder until numbers are judged."""
