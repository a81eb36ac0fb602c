"""Three answers on a program: may it be driven, is it better than uncorrected, does it hold the tolerance.

They have one form everywhere: in report.json, on pages, on the terminal, in the hosts. State, colour and exit code
follow from one table:

| answer | ok | warning | failed |
|---|---|---|---|
| drive | nothing is wrong | a warning on motions, or a joint near its limit | it may not be driven |
| better | ≥ `UNCERTAIN_CHANCE`, or nothing to judge | below, unknown, or a worse worst place | < `HARMFUL_CHANCE` |
| tolerance | held | cannot be judged | not held |

`UNCERTAIN_CHANCE` and `HARMFUL_CHANCE` are chances of a gain, see `postproc.elastostatics`.
The state of the whole is the worst of the three. A wide bound alone never fails: with both expected errors the user
can decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from msgspec import Struct

from postproc.correction import Mode
from postproc.report.formatting import State, two_digit_text

COLOURS: dict[State, str] = {"ok": "green", "warning": "amber", "failed": "red"}
EXIT_CODES: dict[State, int] = {"ok": 0, "warning": 0, "failed": 3}
_STATES_BY_SEVERITY: tuple[State, ...] = ("ok", "warning", "failed")
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
"""Checks that a comparison does not make: a prediction of the second program makes them."""
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
"""Checks that may be missing → the reason, or how to have them made."""


class Remedy(Struct, frozen=True):
    """A measure that would lower the expected error on the part, and the error with it (95 %)."""

    action: str
    expected_mm: float


class Drive(Struct, frozen=True):
    """May the program be driven? `unchecked` names the checks that were not made."""

    state: State
    reasons: list[str]
    unchecked: list[str]


class Improvement(Struct, frozen=True):
    """Is the corrected program better than the uncorrected one?

    Expected errors on the part (95 %) along the cutting path.

    `uncorrected_mm` and `corrected_mm` are the errors at the worst target, of the program as read and as corrected;
    None if the model states no uncertainty. `chance`: chance that the correction makes the part better (RMS); None if
    nothing is corrected.
    """

    state: State
    uncorrected_mm: float | None
    corrected_mm: float | None
    uncorrected_rms_mm: float | None
    corrected_rms_mm: float | None
    chance: float | None
    reasons: list[str]


class Tolerance(Struct, frozen=True):
    """Does the program hold the tolerance that the user gave?

    :param of: "part", or "path" for the tolerance of the path between the written targets.
    :param mm: the tolerance.
    :param held: None: unknown.
    :param beyond_percent: share of the length of the cutting path on which the tolerance is exceeded; None: unknown.
    """

    state: State
    of: str
    mm: float
    held: bool | None
    beyond_percent: float | None
    would_help: list[Remedy]
    reasons: list[str]


class Verdict(Struct, frozen=True):
    """The three answers on a program, with the state, the headline and the reasons that follow from them.

    :param headline: the verdict in one or two sentences.
    :param answers: each of the three questions with its answer, as text.
    :param reasons: reasons of the state, those of the worst answer first; for "ok" what to expect.
    :param holds: what to expect, and checks that passed.
    :param assumes: assumptions of the verdict.
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
        """Exit code of a command that has this verdict."""
        return EXIT_CODES[self.state]


def worst_state(states: Iterable[State]) -> State:
    """Return the worst of states; "ok" without states."""
    return max(states, key=_STATES_BY_SEVERITY.index, default="ok")


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
    """Return the verdict that follows from three answers; its state is the worst of theirs.

    :param better: answer whether the correction makes the part better; None: not judged.
    :param tolerance: answer on the tolerance; None: no tolerance is given.
    :param holds: what to expect, and checks that passed; they are the reasons if no answer has one.
    :param assumes: assumptions of the verdict.
    :param words: state → sentence with which the headline begins; None: `WORDS`.
    :param remark: sentence with which the headline ends, such as an assumption that nobody has confirmed.
    """
    answers = [answer for answer in (drive, better, tolerance) if answer is not None]
    state = worst_state(answer.state for answer in answers)
    by_severity = sorted(answers, key=lambda answer: -_STATES_BY_SEVERITY.index(answer.state))
    reasons = [reason for answer in by_severity for reason in answer.reasons]
    first_sentence = WORDS[mode, state] if words is None else words[state]
    sentences = (first_sentence, _improvement_sentence(mode, better), _tolerance_sentence(tolerance), remark)
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


_SENTENCE_FORMS: dict[Mode, str] = {
    "convert": "Uncorrected up to {} mm, corrected up to {} mm (95 %){}.",
    "nominal": "Uncorrected, as written, up to {} mm; corrected it would be up to {} mm (95 %){}.",
    "predict": "Uncorrected up to {} mm; corrected it would be up to {} mm (95 %){}.",
}


def _improvement_sentence(mode: Mode, improvement: Improvement | None) -> str:
    """Return a sentence with both expected errors; empty if one of them, or the chance, is unknown."""
    if (
        improvement is None
        or improvement.uncorrected_mm is None
        or improvement.corrected_mm is None
        or improvement.chance is None
    ):
        return ""
    chance = "" if improvement.state == "ok" else f", better with a chance of {chance_in_words(improvement.chance)}"
    return _SENTENCE_FORMS[mode].format(
        two_digit_text(improvement.uncorrected_mm), two_digit_text(improvement.corrected_mm), chance
    )


def _tolerance_sentence(tolerance: Tolerance | None) -> str:
    """Return a sentence on the tolerance of the part; empty without a tolerance of the part."""
    if tolerance is None or tolerance.of != "part":
        return ""
    if tolerance.held is None:
        return f"It is not known whether your tolerance of {tolerance.mm:g} mm is held."
    if tolerance.held:
        return f"Your tolerance of {tolerance.mm:g} mm is held."
    sentence = f"Your tolerance of {tolerance.mm:g} mm is not held"
    return (
        f"{sentence}. What would help: {remedies_text(tolerance.would_help)}."
        if tolerance.would_help
        else f"{sentence}."
    )


def remedies_text(actions: Sequence[Remedy]) -> str:
    """Return remedies in words with the expected error [mm] of each, the smallest error first."""
    by_error = sorted(actions, key=lambda remedy: remedy.expected_mm)
    return ", ".join(f"{remedy.action} ({two_digit_text(remedy.expected_mm)} mm at best)" for remedy in by_error)


QUESTIONS = ("May it be driven?", "Is it better than uncorrected?", "Does it hold your tolerance?")


def answer_rows(drive: Drive, better: Improvement | None, tolerance: Tolerance | None) -> list[tuple[str, str, State]]:
    """Return question, answer in words and state of each of the three answers; an unknown answer has the state "ok"."""
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


def _comparison_text(improvement: Improvement | None) -> str:
    """Return the errors of the uncorrected and the corrected program in words, with the chance that correction helps.

    "not known" if the model states no uncertainty; one error if nothing is corrected.
    """
    if improvement is None or improvement.uncorrected_mm is None or improvement.corrected_mm is None:
        return "not known"
    if improvement.chance is None:  # the correction changes nothing
        return f"nothing is corrected; up to {two_digit_text(improvement.corrected_mm)} mm (95 %)"
    # largest and RMS of each program; the RMS is known where the largest is, so that `or` only serves its type
    errors = (
        (improvement.uncorrected_mm, improvement.uncorrected_rms_mm),
        (improvement.corrected_mm, improvement.corrected_rms_mm),
    )
    uncorrected_text, corrected_text = (
        f"up to {two_digit_text(largest)} mm, RMS {two_digit_text(rms or 0.0)}" for largest, rms in errors
    )
    chance = chance_in_words(improvement.chance)
    return f"chance {chance}: uncorrected {uncorrected_text}; corrected {corrected_text} (95 %)"


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
"""Placeholder for the verdict of a summary whose numbers are not judged yet."""
