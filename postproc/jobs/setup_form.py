"""The questions of `start` all at once, as a form asks them, and the command that the answers make."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from msgspec import Struct

from postproc.errors import InputError
from postproc.jobs.guided_start import Answers, Question, next_question
from postproc.jobs.program_needs import ProgramNeeds
from postproc.machining.process import DEFAULT

CHECKED_KEY, OFFERED_KEY = "stock.checked", "stock.offered"
"""Keys of a tick, the stock that is offered is the real one, and of the stock that the form offered."""


class Field(Struct, frozen=True):
    """A question and the text that answers it.

    :param fault: why it does not; empty: it does.
    :param is_guess: a stock is offered that nobody has stated.
    :param is_checked: the user has changed it, or says that it is right.
    """

    question: Question
    text: str
    fault: str = ""
    is_guess: bool = False
    is_checked: bool = True


class SetupForm(Struct, frozen=True):
    """Fields in the order of the questions."""

    fields: tuple[Field, ...]

    @property
    def is_complete(self) -> bool:
        """Return whether each question has a usable answer."""
        return not any(field.fault for field in self.fields)


def setup_form(needs: ProgramNeeds, texts: Mapping[str, str], *, cell: bool, process: bool) -> SetupForm:
    """Return the questions that a program raises, with the answers that there are.

    Only optional questions have their default: nobody shall run a robot by a guessed base that was clicked away.

    :param texts: answers by key of the question, and those of `CHECKED_KEY` and `OFFERED_KEY`.
    :param cell: ask for the cell; `process`: ask for the process.
    """
    answers, skipped_keys, fields = Answers(), set[str](), []
    while question := next_question(needs, answers, skipped_keys, cell=cell, process=process):
        text = texts.get(question.key, question.default or "" if question.optional else "").strip()
        fault = ""
        is_guess = question.key == "stock" and question.default is not None
        if is_guess and text == texts.get(OFFERED_KEY) and not texts.get(CHECKED_KEY):
            text = question.default or ""  # it depends on the diameters, which may be other ones now
        is_checked = not is_guess or text != question.default or bool(texts.get(CHECKED_KEY))
        try:
            answers.put(question, text)
        except InputError as cause:
            skipped_keys.add(question.key)
            fault = str(cause) if text else "an answer is missing"
        fields.append(Field(question, text, fault, is_guess, is_checked))
    return SetupForm(tuple(fields))


def start_arguments(program: Path, form: SetupForm) -> list[str]:
    """Return the arguments of the `postproc start` that does the same."""
    arguments = ["start", program.name, "--no-open"]
    for field in form.fields:
        if not field.is_checked:
            continue
        flag, (_, _, suffix) = field.question.option.split()[0], field.question.key.partition(".")
        if field.text:
            arguments += [f"{flag}={suffix}={field.text}" if suffix not in ("", DEFAULT) else f"{flag}={field.text}"]
    return arguments
