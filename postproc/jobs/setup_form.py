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
"""Keys of texts that the form posts: a tick that the offered stock is right, and the stock that the form offered."""


class Field(Struct, frozen=True):
    """A question and the text that answers it.

    :param fault: why the text is no answer; empty: it is one.
    :param is_guess: whether the form offers a stock that is guessed from the program.
    :param is_checked: False for a guessed stock that the user has neither changed nor ticked as right.
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
        """Whether each question has a usable answer."""
        return not any(field.fault for field in self.fields)


def setup_form(needs: ProgramNeeds, texts: Mapping[str, str], *, cell: bool, process: bool) -> SetupForm:
    """Return the questions that a program raises, with the answers so far.

    Only optional questions are filled with their default. A user must not accept a guessed `$BASE` unseen.

    :param texts: key of a question → text of its answer; also `CHECKED_KEY` and `OFFERED_KEY`.
    :param cell: whether to ask for the cell; `process`: whether to ask for the process.
    """
    answers, skipped_keys, fields = Answers(), set[str](), []
    while question := next_question(needs, answers, skipped_keys, cell=cell, process=process):
        offered_text = (question.default or "") if question.optional else ""
        text = texts.get(question.key, offered_text).strip()
        fault = ""
        is_guess = question.key == "stock" and question.default is not None
        if is_guess and text == texts.get(OFFERED_KEY) and not texts.get(CHECKED_KEY):
            text = question.default or ""  # the guess may have changed with the diameters of the cutters
        is_checked = not is_guess or text != question.default or bool(texts.get(CHECKED_KEY))
        try:
            answers.put(question, text)
        except InputError as cause:
            skipped_keys.add(question.key)
            fault = str(cause) if text else "an answer is missing"
        fields.append(Field(question=question, text=text, fault=fault, is_guess=is_guess, is_checked=is_checked))
    return SetupForm(tuple(fields))


def start_arguments(program: Path, form: SetupForm) -> list[str]:
    """Return the arguments of `postproc start` that give the answers of a form, without a guess that is not checked."""
    arguments = ["start", program.name, "--no-open"]
    for field in form.fields:
        if not field.is_checked:
            continue
        flag = field.question.option.split()[0]
        number_or_code = field.question.key.partition(".")[2]  # "3" of "cutter.3"; empty without one
        is_numbered = number_or_code not in ("", DEFAULT)
        if field.text:
            arguments.append(f"{flag}={number_or_code}={field.text}" if is_numbered else f"{flag}={field.text}")
    return arguments
