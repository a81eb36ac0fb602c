"""From a line to a statement: the only place that knows how KRL's statements are written.

Each line is read once. A statement that is not understood becomes a plain `tree.Statement` and is kept unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from postproc.dialects.krl.language.declarations import declared_in, structure
from postproc.dialects.krl.language.expressions import (
    list_in,
    opaque_text,
    operand,
    split,
    unreadable_text,
    value_at,
    value_in,
)
from postproc.dialects.krl.language.names import (
    APPROXIMATIONS,
    CIRCLES,
    DECLARATIONS,
    FRAMES,
    MOTION_WORDS,
    OPENING,
    RESERVED,
    SPLINES,
    TYPES,
)
from postproc.dialects.krl.language.source import Source
from postproc.dialects.krl.language.tokens import (
    NAME,
    Span,
    after_blanks,
    after_sign,
    after_word,
    key_word,
    word_at,
    words_in,
)
from postproc.dialects.krl.language.tree import (
    Assignment,
    BareWord,
    CallStatement,
    Case,
    CyclicInput,
    Declaration,
    Definition,
    EndSpline,
    Event,
    FaultyStatement,
    For,
    Goto,
    IdleDeclaration,
    If,
    Import,
    Label,
    Motion,
    Parameter,
    Return,
    Spline,
    SplineTiming,
    Statement,
    Switch,
    Tail,
    Trigger,
    While,
)
from postproc.dialects.krl.language.values import Call, Reference, Value
from postproc.errors import ProgramError


def statement(source: Source, line: int) -> Statement:
    """Return the statement on a 1-based line; it is parsed at the first call and stored."""
    node = source.statements.get(line)
    if node is None:
        node = source.statements[line] = statement_in(source, *source.code_span(line))
    return cast("Statement", node)


def statement_at(source: Source, line: int, start: int, stop: int) -> Statement:
    """Return what `statement` does, if the span of the code of the line is known."""
    node = source.statements.get(line)
    if node is None:
        node = source.statements[line] = statement_in(source, start, stop)
    return cast("Statement", node)


def statement_in(source: Source, start: int, stop: int) -> Statement:
    """Return the statement that a piece of code is; `FaultyStatement` where it cannot be read."""
    word = word_at(source.text, start, stop)
    first = start
    if word == "GLOBAL":
        first = after_blanks(source.text, start + len(word), stop)
        word = word_at(source.text, first, stop)
    try:
        node = _READERS[word](source, word, start, first, stop) if word in _READERS else None
        return node or _ordinary_statement(source, word, start, first, stop)
    except ProgramError as error:
        return FaultyStatement(word, start, stop, error, code=_code(source, start, stop))


def _code(source: Source, start: int, stop: int) -> Value | None:
    """Return a piece of code that is read no further, if there are calls in it."""
    if "(" not in source.text[start:stop]:
        return None
    try:
        return opaque_text(source, start, stop)
    except ProgramError as error:
        return unreadable_text(source, start, stop, error)


def _ordinary_statement(source: Source, word: str, start: int, first: int, stop: int) -> Statement:
    """Return an assignment, a call, a label, a declaration without DECL, or a plain statement."""
    text = source.text
    if first == stop or text[first] == "&" or (word in RESERVED and word not in TYPES):
        return Statement(word, start, stop, code=_code(source, first, stop))
    if word in TYPES:
        return _declaration(source, word, start, first, stop)
    target, end = operand(source, first, stop)
    equals = after_sign(text, end, stop, "=")
    if isinstance(target, Reference) and equals >= 0 and text[equals : equals + 1] != "=":
        return Assignment(word, start, stop, target, value_in(source, equals, stop))
    if isinstance(target, Call) and end == stop:
        return CallStatement(word, start, stop, target)
    colon = after_sign(text, end, stop, ":")
    if isinstance(target, Reference) and colon >= 0 and after_blanks(text, colon, stop) == stop:
        return Label(word, start, stop, target.name)
    if _is_declaration(text, first, stop):
        return _declaration(source, word, start, first, stop)
    return Statement(word, start, stop, code=_code(source, first, stop))


# --- what declares ---------------------------------------------------------------------------------------------------


def _definition(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return DEF or DEFFCT with name, type of the result and parameters; None without a name."""
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
    bracket = after_sign(text, end, stop, "(")
    close = text.find(")", bracket, stop) if bracket >= 0 else -1
    content = text[bracket : close if close >= 0 else stop] if bracket >= 0 else ""
    parameters = tuple(parameter for part in content.split(",") if (parameter := _parameter(part)) is not None)
    return Definition(word, start, stop, first > start, text[position:end], position, result, parameters)


def _parameter(text: str) -> Parameter | None:
    """Return ``name[,]:IN`` as a parameter."""
    begin, stop = after_blanks(text, 0, len(text)), len(text)
    name = word_at(text, begin, stop)
    if not name:
        return None
    bracket = after_sign(text, begin + len(name), stop, "[")
    end = text.find("]", bracket) + 1 if bracket >= 0 else begin + len(name)
    colon = after_sign(text, end, stop, ":")
    return Parameter(name, colon >= 0 and after_word(text, colon, stop, "IN") >= 0, bracket >= 0)


def _is_declaration(text: str, start: int, stop: int) -> bool:
    """Return whether a statement is a type and a name, without DECL."""
    kind = NAME.match(text, start, stop)
    if kind is None or "$" in kind[0]:
        return False
    begin = after_blanks(text, kind.end(), stop)
    end = begin + len(word_at(text, begin, stop))
    if begin == kind.end() or end == begin:
        return False
    bracket = after_sign(text, end, stop, "[")
    end = end if bracket < 0 else text.find("]", bracket, stop) + 1
    next_sign = after_blanks(text, end, stop)
    return end > 0 and (next_sign == stop or text[next_sign] in ",=")


def _declaration(source: Source, word: str, start: int, first: int, stop: int) -> Statement:
    """Return DECL, CONST, STRUC, or a type with names, and what is declared."""
    names = tuple(declared_in(source, first, stop))
    constant = bool(names) and key_word(source.text, first, names[0].at, "CONST") is not None
    return Declaration(word, start, stop, first > start, constant, names, structure(source, first, stop))


def _cyclic_input(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return ANIN ON, DIGIN ON or SIGNAL with its name; without one, a plain statement."""
    position = first + len(word)
    if word != "SIGNAL":
        position = after_word(source.text, position, stop, "ON")
    name_start = after_blanks(source.text, position, stop)
    name = word_at(source.text, name_start, stop) if 0 <= position < name_start else ""
    return CyclicInput(word, start, stop, name) if name else _idle_declaration(source, word, start, first, stop)


def _idle_declaration(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return a declaration of which nothing is needed, or another statement of that word."""
    return IdleDeclaration(word, start, stop) if word in DECLARATIONS else Statement(word, start, stop)


def _import(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return ``IMPORT type name IS /R1/file..original``; an `IdleDeclaration` if it is something else."""
    text = source.text
    kind = NAME.match(text, after_blanks(text, first + len(word), stop), stop)
    name = NAME.match(text, after_blanks(text, kind.end(), stop), stop) if kind else None
    dots = text.rfind("..", first, stop)
    original = NAME.match(text, after_blanks(text, dots + 2, stop), stop) if dots >= 0 else None
    file = text[text.rfind("/", first, dots) + 1 : dots].strip().upper()
    if name is None or original is None or key_word(text, name.end(), dots, "IS") is None:
        return IdleDeclaration(word, start, stop)
    return Import(word, start, stop, name[0].upper(), original[0].upper(), file)


# --- what moves and what follows it ----------------------------------------------------------------------------------


def _motion(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return a motion: points, CA, the axes of a relative one, WITH and approximation."""
    text, position = source.text, first + len(word)
    via = end = angle = None
    circle = word.removesuffix("_REL") in CIRCLES
    if circle:
        via, position = _point(source, position, stop)
        position = after_sign(text, position, stop, ",") if position >= 0 else -1
    if position >= 0:
        end, position = _point(source, position, stop)
    if circle and position >= 0:
        comma = after_sign(text, position, stop, ",")
        angle_start = after_word(text, comma, stop, "CA") if comma >= 0 else -1
        if angle_start >= 0:
            equals = after_sign(text, angle_start, stop, "=")
            angle, position = _point(source, max(angle_start, equals), stop)
    if position < 0:
        return Motion(word, start, stop, via, end, angle, "", None, Tail(stop, stop, stop))
    frame, frame_span, last = "", None, stop
    if word.endswith("_REL"):
        begin = text.rfind("#", position, stop)
        frame = text[begin:stop].upper() if begin >= 0 else ""
        if (at := after_blanks(text, position, stop)) < stop and text[at] == "#":
            frame = f"#{word_at(text, at + 1, stop)}"
            position = at + len(frame) if frame in FRAMES else position
        elif frame in FRAMES and _is_approximation(text, position, begin):
            frame_span, last = Span(begin, stop), begin
        frame = frame if frame in FRAMES else ""
    return Motion(word, start, stop, via, end, angle, frame, frame_span, tail_in(source, position, last))


def _point(source: Source, start: int, stop: int) -> tuple[Value, int]:
    """Return a value and the offset behind it; −1 where it cannot be read."""
    try:
        return value_at(source, start, stop)
    except ProgramError as error:
        return unreadable_text(source, start, stop, error), -1


def is_approximated(text: str) -> bool:
    """Return whether a motion, or the end of one, has a word of approximation: C_DIS, C_VEL …"""
    return any(word in APPROXIMATIONS for word, _ in words_in(text, 0, len(text)))


def _is_approximation(text: str, start: int, stop: int) -> bool:
    """Return whether the last word of a piece of code is that of an approximation."""
    spans = list(words_in(text, start, stop))
    return bool(spans) and spans[-1][0].startswith("C_") and not text[spans[-1][1].stop : stop].strip()


def tail_in(source: Source, start: int, stop: int) -> Tail:
    """Return what follows the points of a motion, or SPLINE."""
    text, words, end = source.text, list[str](), stop
    plain = text[start:stop].upper().split()
    if APPROXIMATIONS.issuperset(plain):  # nearly all of them
        return Tail(start, stop, start, (), tuple(plain))
    spans = list(words_in(text, start, stop))
    for word, span in reversed(spans):
        if word not in APPROXIMATIONS or text[span.stop : end].strip():
            break
        words.insert(0, word)
        end = span.start
    while end > start and text[end - 1] in " \t":
        end -= 1
    with_end = after_word(text, start, end, "WITH") if len(spans) > len(words) else -1
    if with_end < 0:
        rest = _stripped(text, start, end)
        return Tail(start, stop, end, (), tuple(words), rest if rest.start < rest.stop else None)
    try:
        assignments = tuple(_with_assignment(source, *span) for span in split(source, with_end, end))
        return Tail(start, stop, end, assignments, tuple(words))
    except ProgramError as error:
        return Tail(start, stop, end, (), tuple(words), error=error)


def _with_assignment(source: Source, start: int, stop: int) -> Statement:
    """Return an assignment of WITH, or a plain statement if it is something else."""
    target, end = operand(source, start, stop)
    equals = after_sign(source.text, end, stop, "=")
    word, span = word_at(source.text, after_blanks(source.text, start, stop), stop), _stripped(source.text, start, stop)
    if not isinstance(target, Reference) or equals < 0:
        return Statement(word, span.start, span.stop, code=_code(source, start, stop))
    return Assignment(word, span.start, span.stop, target, value_in(source, equals, stop))


def _spline(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return SPLINE or PTP_SPLINE with its approximation and WITH."""
    return Spline(word, start, stop, tail_in(source, first + len(word), stop))


def _end_spline(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return ENDSPLINE and the text behind it."""
    rest_start = first + len(word)
    return EndSpline(word, start, stop, source.text[rest_start:stop].strip(), code=_code(source, rest_start, stop))


def _spline_timing(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return CONST_VEL, TIME_BLOCK or STOP WHEN PATH, and whether it has all that it needs."""
    text, position = source.text, first + len(word)
    if word == "STOP":
        when_end = after_word(text, position, stop, "WHEN")
        position = after_word(text, when_end, stop, "PATH") if when_end >= 0 else -1
    else:
        words = ("START", "END") if word == "CONST_VEL" else ("START", "END", "PART")
        position = after_word(text, position, stop, *words)
    complete = position >= 0
    if complete:
        value = after_sign(text, position, stop, "=")
        has_value = value >= 0 and after_blanks(text, value, stop) < stop and text[value] != "="
        is_bare = word == "TIME_BLOCK" and text[:position].upper().endswith(("START", "PART")) and position == stop
        complete = (has_value and not (word == "TIME_BLOCK" and text[:position].upper().endswith("START"))) or is_bare
    if complete and word == "STOP":
        condition = key_word(text, position, stop, "IF")
        complete = condition is not None and condition.stop < stop
    on_start = key_word(text, first, stop, "ONSTART") is not None
    return SplineTiming(word, start, stop, complete, on_start, code=_code(source, first + len(word), stop))


def _event(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return INTERRUPT or TRIGGER with the statement behind DO.

    :param start: offset of the statement, `first` that of the word, behind GLOBAL, and `stop` that of its end.
    """
    do = key_word(source.text, first, stop, "DO")
    head = Span(first, stop if do is None else do.start)
    action = None if do is None else statement_in(source, after_blanks(source.text, do.stop, stop), stop)
    if word == "TRIGGER":
        return _trigger(source, start, first, stop, head, action)
    is_declaration = after_word(source.text, first + len(word), stop, "DECL") >= 0
    return Event(word, start, stop, first > start, is_declaration, action, code=_code(source, head.start, head.stop))


def _trigger(source: Source, start: int, first: int, stop: int, head: Span, action: Statement | None) -> Trigger:
    """Return ``TRIGGER WHEN DISTANCE|PATH = value [ONSTART] DELAY = time DO …``."""
    text, from_start = source.text, False
    value: Value | None = None
    delay: Value | None = None
    when_end = after_word(text, first + len("TRIGGER"), head.stop, "WHEN")
    place = after_word(text, when_end, head.stop, "DISTANCE", "PATH") if when_end >= 0 else -1
    distance = place >= 0 and text[:place].upper().endswith("DISTANCE")
    begin = after_sign(text, place, head.stop, "=") if place >= 0 else -1
    delay_word = key_word(text, begin, head.stop, "DELAY") if begin >= 0 else None
    time = after_sign(text, delay_word.stop, head.stop, "=") if delay_word is not None else -1
    if delay_word is not None and time >= 0 and action is not None:
        on_start = key_word(text, begin, delay_word.start, "ONSTART")
        from_start = on_start is not None
        value = value_in(source, begin, on_start.start if on_start is not None else delay_word.start)
        delay = value_in(source, time, head.stop)
    code = _code(source, head.start, head.stop)
    return Trigger("TRIGGER", start, stop, first > start, False, action, distance, value, from_start, delay, code=code)


def _stripped(text: str, start: int, stop: int) -> Span:
    """Return a piece without blanks around it."""
    while stop > start and text[stop - 1] in " \t":
        stop -= 1
    return Span(after_blanks(text, start, stop), stop)


# --- control structures ----------------------------------------------------------------------------------------------


def _if(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return IF with its condition and the text behind THEN."""
    begin = first + len(word)
    then_word = key_word(source.text, begin, stop, "THEN")
    head = _stripped(source.text, begin, stop if then_word is None else then_word.start)
    rest = "" if then_word is None else source.text[then_word.stop : stop].strip()
    condition = value_in(source, head.start, head.stop) if head.start < head.stop else None
    return If(word, start, stop, condition, then_word is not None, rest)


def _while(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return WHILE or UNTIL with its condition."""
    return While(word, start, stop, value_in(source, first + len(word), stop))


def _switch(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return SWITCH with its value."""
    return Switch(word, start, stop, value_in(source, first + len(word), stop))


def _case(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return CASE with its values."""
    return Case(word, start, stop, list_in(source, first + len(word), stop))


def _bare_word(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return a word that is alone on its line, and the text behind it, which should be empty."""
    rest_start = first + len(word)
    return BareWord(word, start, stop, source.text[rest_start:stop].strip(), code=_code(source, rest_start, stop))


_FOR_ADVICE = "Write FOR counter=first TO last STEP step; STEP may be left out."


def _for(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return ``FOR counter = first TO last STEP step``; `error` says why it cannot be read."""
    text = source.text
    begin = after_blanks(text, first + len(word), stop)
    name = word_at(text, begin, stop) if begin > first + len(word) else ""
    counter = bounds = error = None
    try:
        target, end = operand(source, begin, stop)
        equals = after_sign(text, end, stop, "=")
        if isinstance(target, Reference) and target.field is None and equals >= 0:
            bounds = _bounds(source, equals, stop)
            counter = None if bounds is None else target
            error = source.error("FOR is not understood", start, _FOR_ADVICE) if bounds is None else None
    except ProgramError as cause:
        error = cause
    code = _code(source, begin, stop) if bounds is None else None
    return For(word, start, stop, name, counter, bounds, error, code=code)


def _bounds(source: Source, start: int, stop: int) -> tuple[Value, Value, Value | None] | None:
    """Return ``first TO last STEP step``; None if it is something else."""
    first, end = value_at(source, start, stop)
    end = after_word(source.text, end, stop, "TO")
    if end < 0:
        return None
    last, end = value_at(source, end, stop)
    step_start, step = after_word(source.text, end, stop, "STEP"), None
    if step_start >= 0:
        step, end = value_at(source, step_start, stop)
    return (first, last, step) if after_blanks(source.text, end, stop) == stop else None


def _goto(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return GOTO with its label."""
    begin = after_blanks(source.text, first + len(word), stop)
    return Goto(word, start, stop, word_at(source.text, begin, stop))


def _return(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return RETURN with its value, if it has one."""
    begin = after_blanks(source.text, first + len(word), stop)
    return Return(word, start, stop, value_in(source, begin, stop) if begin < stop else None)


def _bas(source: Source, word: str, start: int, first: int, stop: int) -> Statement | None:
    """Return BAS as a call; a plain statement if it is something else."""
    call, _ = operand(source, first, stop)
    if isinstance(call, Call):
        return CallStatement(word, start, stop, call)
    return Statement(word, start, stop, code=_code(source, first, stop))


_Reader = Callable[[Source, str, int, int, int], Statement | None]
_READERS: dict[str, _Reader] = {
    **dict.fromkeys(MOTION_WORDS, _motion),
    **dict.fromkeys(SPLINES, _spline),
    **dict.fromkeys((*OPENING.values(), "ELSE", "DEFAULT", "LOOP", "REPEAT", "END", "ENDFCT"), _bare_word),
    **dict.fromkeys(("WHILE", "UNTIL"), _while),
    **dict.fromkeys(("CONST_VEL", "STOP", "TIME_BLOCK"), _spline_timing),
    **dict.fromkeys(DECLARATIONS - {"STRUC"}, _idle_declaration),
    **dict.fromkeys(("DECL", "CONST", "STRUC"), _declaration),
    **dict.fromkeys(("ANIN", "DIGIN", "SIGNAL"), _cyclic_input),
    **dict.fromkeys(("INTERRUPT", "TRIGGER"), _event),
    **dict.fromkeys(("DEF", "DEFFCT"), _definition),
    "SWITCH": _switch,
    "CASE": _case,
    "IMPORT": _import,
    "ENDSPLINE": _end_spline,
    "IF": _if,
    "FOR": _for,
    "GOTO": _goto,
    "RETURN": _return,
    "BAS": _bas,
}
