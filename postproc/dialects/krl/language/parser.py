"""From a line to a statement: the only place that knows how KRL's statements are written.

Each line is read once. What is not understood is a plain `tree.Statement`, and kept as it is.
"""

from __future__ import annotations

from collections.abc import Callable

from postproc.dialects.krl.language.brackets import matching, split
from postproc.dialects.krl.language.declarations import declared, structure
from postproc.dialects.krl.language.expressions import arithmetic, operand, parse
from postproc.dialects.krl.language.names import (
    DECLARING,
    MOTION_WORDS,
    OPENING,
    PURE,
    RESERVED,
    SPLINES,
    TYPES,
)
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import (
    NAME,
    Span,
    after_blanks,
    after_nots,
    after_sign,
    after_word,
    key_word,
    operator_at,
    word_at,
    words_in,
)
from postproc.dialects.krl.language.tree import (
    Assignment,
    Bare,
    CallStatement,
    Case,
    Condition,
    Cyclic,
    Declaration,
    Definition,
    EndSpline,
    Event,
    Faulty,
    For,
    Goto,
    If,
    Imported,
    Label,
    Motion,
    Outside,
    Parameter,
    Return,
    Spline,
    Statement,
    Switch,
    Timed,
    Trigger,
    While,
)
from postproc.dialects.krl.language.values import Call, Opaque, Reference, Value
from postproc.errors import ProgramError


def statement(source: Source, line: int) -> Statement:
    """Return the statement on a 1-based line; it is read when it is first needed."""
    found = source.statements.get(line)
    if not isinstance(found, Statement):
        found = source.statements[line] = statement_in(source, *source.code_span(line))
    return found


def statement_in(source: Source, start: int, stop: int) -> Statement:
    """Return the statement that a piece of code is; `Faulty` where it cannot be read."""
    word = word_at(source.text, start, stop)
    first = start
    if word == "GLOBAL":
        first = after_blanks(source.text, start + len(word), stop)
        word = word_at(source.text, first, stop)
    try:
        found = _READERS[word](source, word, start, first, stop) if word in _READERS else None
        return found or _other(source, word, start, first, stop)
    except ProgramError as error:
        return Faulty(word, start, stop, error)


def _other(source: Source, word: str, start: int, first: int, stop: int) -> Statement:
    """Return an assignment, a call, a label, a declaration without DECL, or what is not understood."""
    text = source.text
    if first == stop or text[first] == "&" or (word in RESERVED and word not in TYPES):
        return Statement(word, start, stop)
    if word in TYPES:
        return _declaration(source, word, start, first, stop)
    target, end = operand(source, first, stop)
    equals = after_sign(text, end, stop, "=")
    if isinstance(target, Reference) and equals >= 0 and text[equals : equals + 1] != "=":
        return Assignment(word, start, stop, target, Span(equals, stop))
    if isinstance(target, Call) and end == stop:
        return CallStatement(word, start, stop, target)
    colon = after_sign(text, end, stop, ":")
    if isinstance(target, Reference) and colon >= 0 and after_blanks(text, colon, stop) == stop:
        return Label(word, start, stop, target.name)
    if _is_declaration(text, first, stop):
        return _declaration(source, word, start, first, stop)
    return Statement(word, start, stop)


def calls(source: Source, start: int, stop: int) -> list[Call]:
    """Return the calls of routines and functions in a piece of code, from left to right, also those inside others.

    :raises ProgramError: brackets are not balanced.
    """
    text, found = source.text, []
    if "(" not in text[start:stop]:
        return []
    for word, at in words_in(text, start, stop):
        if "$" in word or word in RESERVED or word in PURE or after_sign(text, at.stop, stop, "(") < 0:
            continue
        value, _ = operand(source, at.start, stop)
        if isinstance(value, Call):
            found.append(value)
    return found


def sole_call(source: Source, start: int, stop: int) -> Call | None:
    """Return the call that a piece of code consists of; None if it is something else."""
    value = _sole_operand(source, start, stop)
    return value if isinstance(value, Call) else None


def reference_of(source: Source, span: tuple[int, int]) -> Reference | None:
    """Return the variable that an argument consists of; None if it is something else.

    :raises ProgramError: brackets are not balanced.
    """
    value = _sole_operand(source, *span)
    return value if isinstance(value, Reference) else None


def _sole_operand(source: Source, start: int, stop: int) -> Value | None:
    """Return the named operand that a piece of code consists of; None if it is something else."""
    start = after_blanks(source.text, start, stop)
    if not word_at(source.text, start, stop):
        return None
    value, end = operand(source, start, stop)
    return value if not source.text[end:stop].strip() else None


# --- what declares ---------------------------------------------------------------------------------------------------


def _definition(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    text, position = source.text, after_blanks(source.text, first + len(word), stop)
    result = ""
    if word == "DEFFCT":
        result = word_at(text, position, stop)
        position = after_blanks(text, position + len(result), stop)
        if not result:
            return None
        if position < stop and text[position] == "[":
            position = after_blanks(text, text.find("]", position, stop) + 1, stop)
    end = position
    while end < stop and text[end] not in " \t(":
        end += 1
    if end == position or position == first + len(word):
        return None
    opened = after_sign(text, end, stop, "(")
    close = text.find(")", opened, stop) if opened >= 0 else -1
    inside = text[opened : close if close >= 0 else stop] if opened >= 0 else ""
    parameters = tuple(one for part in inside.split(",") if (one := _parameter(part)) is not None)
    return Definition(word, start, stop, first > start, text[position:end], position, result, parameters)


def _parameter(text: str) -> Parameter | None:
    """Return ``name[,]:IN`` as a parameter."""
    begin, stop = after_blanks(text, 0, len(text)), len(text)
    name = word_at(text, begin, stop)
    if not name:
        return None
    end = after_sign(text, begin + len(name), stop, "[")
    end = text.find("]", end) + 1 if end >= 0 else begin + len(name)
    colon = after_sign(text, end, stop, ":")
    return Parameter(name, colon >= 0 and after_word(text, colon, stop, "IN") >= 0)


def _is_declaration(text: str, start: int, stop: int) -> bool:
    """Return whether a statement is a type and a name, without DECL."""
    kind = NAME.match(text, start, stop)
    if kind is None or "$" in kind[0]:
        return False
    begin = after_blanks(text, kind.end(), stop)
    end = begin + len(word_at(text, begin, stop))
    if begin == kind.end() or end == begin:
        return False
    opened = after_sign(text, end, stop, "[")
    end = end if opened < 0 else text.find("]", opened, stop) + 1
    after = after_blanks(text, end, stop)
    return end > 0 and (after == stop or text[after] in ",=")


def _declaration(source: Source, word: str, start: int, first: int, stop: int) -> Statement:
    names = tuple(declared(source, first, stop))
    constant = bool(names) and key_word(source.text, first, names[0].at, "CONST") is not None
    return Declaration(word, start, stop, first > start, constant, names, structure(source, first, stop))


def _cyclic(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    position = first + len(word)
    if word != "SIGNAL":
        position = after_word(source.text, position, stop, "ON")
    behind = after_blanks(source.text, position, stop)
    name = word_at(source.text, behind, stop) if 0 <= position < behind else ""
    return Cyclic(word, start, stop, name) if name else _outside(source, word, start, first, stop)


def _outside(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    return Outside(word, start, stop) if word in DECLARING else Statement(word, start, stop)


def _imported(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    text = source.text
    kind = NAME.match(text, after_blanks(text, first + len(word), stop), stop)
    name = NAME.match(text, after_blanks(text, kind.end(), stop), stop) if kind else None
    dots = text.rfind("..", first, stop)
    original = NAME.match(text, after_blanks(text, dots + 2, stop), stop) if dots >= 0 else None
    if name is None or original is None or key_word(text, name.end(), dots, "IS") is None:
        return Outside(word, start, stop)
    return Imported(word, start, stop, name[0].upper(), original[0].upper())


# --- what moves and what follows it ----------------------------------------------------------------------------------


def _motion(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    return Motion(word, start, stop)


def _spline(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    return Spline(word, start, stop)


def _end_spline(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    return EndSpline(word, start, stop, source.text[first + len(word) : stop].strip())


def _timed(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    text, position = source.text, first + len(word)
    if word == "STOP":
        when = after_word(text, position, stop, "WHEN")
        position = after_word(text, when, stop, "PATH") if when >= 0 else -1
    else:
        words = ("START", "END") if word == "CONST_VEL" else ("START", "END", "PART")
        position = after_word(text, position, stop, *words)
    complete = position >= 0
    if complete:
        value = after_sign(text, position, stop, "=")
        given = value >= 0 and after_blanks(text, value, stop) < stop and text[value] != "="
        alone = word == "TIME_BLOCK" and text[:position].upper().endswith(("START", "PART")) and position == stop
        complete = (given and not (word == "TIME_BLOCK" and text[:position].upper().endswith("START"))) or alone
    if complete and word == "STOP":
        condition = key_word(text, position, stop, "IF")
        complete = condition is not None and condition.stop < stop
    return Timed(word, start, stop, complete, key_word(text, first, stop, "ONSTART") is not None)


def _event(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    do = key_word(source.text, first, stop, "DO")
    head = Span(first, stop if do is None else do.start)
    action = None if do is None else statement_in(source, after_blanks(source.text, do.stop, stop), stop)
    if word == "TRIGGER":
        return _trigger(source, start, first, stop, head, action)
    declares_ = after_word(source.text, first + len(word), stop, "DECL") >= 0
    return Event(word, start, stop, first > start, declares_, head, action)


def _trigger(source: Source, start: int, first: int, stop: int, head: Span, action: Statement | None) -> Trigger:
    """Return ``TRIGGER WHEN DISTANCE|PATH = value [ONSTART] DELAY = time DO …``."""
    text, value, delay, from_start = source.text, None, None, False
    when = after_word(text, first + len("TRIGGER"), head.stop, "WHEN")
    place = after_word(text, when, head.stop, "DISTANCE", "PATH") if when >= 0 else -1
    distance = place >= 0 and text[:place].upper().endswith("DISTANCE")
    begin = after_sign(text, place, head.stop, "=") if place >= 0 else -1
    delayed = key_word(text, begin, head.stop, "DELAY") if begin >= 0 else None
    time = after_sign(text, delayed.stop, head.stop, "=") if delayed is not None else -1
    if delayed is not None and time >= 0 and action is not None:
        on_start = key_word(text, begin, delayed.start, "ONSTART")
        from_start = on_start is not None
        value = _stripped(text, begin, on_start.start if on_start is not None else delayed.start)
        delay = _stripped(text, time, head.stop)
    return Trigger("TRIGGER", start, stop, first > start, False, head, action, distance, value, from_start, delay)


def _stripped(text: str, start: int, stop: int) -> Span:
    """Return a piece without blanks around it."""
    while stop > start and text[stop - 1] in " \t":
        stop -= 1
    return Span(after_blanks(text, start, stop), stop)


# --- control structures ----------------------------------------------------------------------------------------------


def _if(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    begin = first + len(word)
    then = key_word(source.text, begin, stop, "THEN")
    head = Span(begin, stop if then is None else then.start)
    behind = "" if then is None else source.text[then.stop : stop].strip()
    return If(word, start, stop, head, _whole_condition(source, head), then is not None, behind)


def _while(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    head = Span(first + len(word), stop)
    return While(word, start, stop, head, _whole_condition(source, head))


def _whole_condition(source: Source, span: Span) -> Condition | None:
    """Return the condition that a piece of code is; None where it cannot be read."""
    try:
        found, end = condition(source, span.start, span.stop)
    except ProgramError:
        return None
    return found if after_blanks(source.text, end, span.stop) == span.stop else None


def _switch(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    head = Span(first + len(word), stop)
    try:
        return Switch(word, start, stop, head, parse(source, head.start, stop)[0])
    except ProgramError as error:
        return Switch(word, start, stop, head, None, error)


def _case(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    values: list[Value | Condition | None] = []
    for begin, end in split(source, first + len(word), stop):
        value, behind = _term(source, begin, end)
        values.append(value if after_blanks(source.text, behind, end) == end else None)
    return Case(word, start, stop, tuple(values))


def _bare(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    return Bare(word, start, stop, source.text[first + len(word) : stop].strip())


def _for(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    text = source.text
    begin = after_blanks(text, first + len(word), stop)
    name = word_at(text, begin, stop) if begin > first + len(word) else ""
    counter = bounds = error = None
    values = Span(stop, stop)
    try:
        target, end = operand(source, begin, stop)
        equals = after_sign(text, end, stop, "=")
        if isinstance(target, Reference) and target.field is None and equals >= 0:
            counter, values = target, Span(equals, stop)
            bounds = _bounds(source, equals, stop)
    except ProgramError as cause:
        error = cause
    return For(word, start, stop, name, counter, bounds, values, error)


def _bounds(source: Source, start: int, stop: int) -> tuple[Value, Value, Value | None] | None:
    """Return ``first TO last STEP step``; None if it is something else."""
    first, end = parse(source, start, stop)
    end = after_word(source.text, end, stop, "TO")
    if end < 0:
        return None
    last, end = parse(source, end, stop)
    behind, step = after_word(source.text, end, stop, "STEP"), None
    if behind >= 0:
        step, end = parse(source, behind, stop)
    return (first, last, step) if after_blanks(source.text, end, stop) == stop else None


def _goto(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    begin = after_blanks(source.text, first + len(word), stop)
    return Goto(word, start, stop, word_at(source.text, begin, stop))


def _return(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    return Return(word, start, stop, Span(first + len(word), stop))


def _bas(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    call, _ = operand(source, first, stop)
    return CallStatement(word, start, stop, call) if isinstance(call, Call) else Statement(word, start, stop)


# --- conditions ------------------------------------------------------------------------------------------------------


def condition(source: Source, start: int, stop: int) -> tuple[Condition, int]:
    """Return terms joined by comparisons and logic, and the offset behind them.

    :raises ProgramError: as for `expressions.parse`.
    """
    terms: list[Value | Condition] = []
    negated: list[bool] = []
    operators: list[str] = []
    while True:
        inverse, start = after_nots(source.text, start, stop)
        term, start = _term(source, start, stop)
        terms.append(term)
        negated.append(inverse)
        operator, behind = operator_at(source.text, start, stop)
        if not operator:
            return Condition(tuple(terms), tuple(negated), tuple(operators)), start
        operators.append(operator)
        start = behind


def _term(source: Source, start: int, stop: int) -> tuple[Value | Condition, int]:
    """Return a value without operators of logic or comparison, or a condition in brackets."""
    value, end = arithmetic(source, start, stop)
    if isinstance(value, Opaque) and source.text[value.start : value.start + 1] == "(":
        close = matching(source, value.start, stop)
        inner, behind = condition(source, value.start + 1, close)
        whole = after_blanks(source.text, behind, close) == close
        return (inner if whole else value), close + 1
    return value, end


_Reader = Callable[[Source, str, int, int, int], Statement | None]
_READERS: dict[str, _Reader] = {
    **dict.fromkeys(MOTION_WORDS, _motion),
    **dict.fromkeys(SPLINES, _spline),
    **dict.fromkeys((*OPENING.values(), "ELSE", "DEFAULT", "LOOP", "REPEAT", "END", "ENDFCT"), _bare),
    **dict.fromkeys(("WHILE", "UNTIL"), _while),
    **dict.fromkeys(("CONST_VEL", "STOP", "TIME_BLOCK"), _timed),
    **dict.fromkeys(DECLARING - {"STRUC"}, _outside),
    **dict.fromkeys(("DECL", "CONST", "STRUC"), _declaration),
    **dict.fromkeys(("ANIN", "DIGIN", "SIGNAL"), _cyclic),
    **dict.fromkeys(("INTERRUPT", "TRIGGER"), _event),
    **dict.fromkeys(("DEF", "DEFFCT"), _definition),
    "SWITCH": _switch,
    "CASE": _case,
    "IMPORT": _imported,
    "ENDSPLINE": _end_spline,
    "IF": _if,
    "FOR": _for,
    "GOTO": _goto,
    "RETURN": _return,
    "BAS": _bas,
}
