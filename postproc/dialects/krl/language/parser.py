"""From a line to a statement: the only place that knows how KRL's statements are written.

Each line is read once. A statement that is not understood becomes a plain `tree.Statement` and is kept unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

from postproc.dialects.krl.language.declarations import declared_in, structure
from postproc.dialects.krl.language.expressions import (
    list_in,
    list_spans,
    opaque_text,
    operand,
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
    """Return the statement in a piece of code; a `FaultyStatement` if it cannot be read."""
    word = word_at(source.text, start, stop)
    word_start = start
    if word == "GLOBAL":
        word_start = after_blanks(source.text, start + len(word), stop)
        word = word_at(source.text, word_start, stop)
    try:
        node = _READERS[word](source, word, start, word_start, stop) if word in _READERS else None
        return node or _ordinary_statement(source, word, start, word_start, stop)
    except ProgramError as error:
        return FaultyStatement(word, start, stop, error, code=_unparsed_code(source, start, stop))


def _unparsed_code(source: Source, start: int, stop: int) -> Value | None:
    """Return a piece of code that is not parsed further, as a value; None if there are no calls in it."""
    if "(" not in source.text[start:stop]:
        return None
    try:
        return opaque_text(source, start, stop)
    except ProgramError as error:
        return unreadable_text(source, start, stop, error)


def _ordinary_statement(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement:
    """Return a statement that no key word begins: an assignment, a call, a label, or a declaration without DECL.

    Anything else is a plain `Statement`.
    """
    text = source.text
    if word_start == stop or text[word_start] == "&" or (word in RESERVED and word not in TYPES):
        return Statement(word, start, stop, code=_unparsed_code(source, word_start, stop))
    if word in TYPES:
        return _declaration(source, word, start, word_start, stop)
    target, end = operand(source, word_start, stop)
    equals = after_sign(text, end, stop, "=")
    if isinstance(target, Reference) and equals >= 0 and text[equals : equals + 1] != "=":
        return Assignment(word, start, stop, target, value_in(source, equals, stop))
    if isinstance(target, Call) and end == stop:
        return CallStatement(word, start, stop, target)
    colon = after_sign(text, end, stop, ":")
    if isinstance(target, Reference) and colon >= 0 and after_blanks(text, colon, stop) == stop:
        return Label(word, start, stop, target.name)
    if _is_declaration(text, word_start, stop):
        return _declaration(source, word, start, word_start, stop)
    return Statement(word, start, stop, code=_unparsed_code(source, word_start, stop))


# --- what declares ---------------------------------------------------------------------------------------------------


def _definition(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return DEF or DEFFCT with name, type of the result and parameters; None without a name."""
    text, position = source.text, after_blanks(source.text, word_start + len(word), stop)
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
    if end == position or position == word_start + len(word):
        return None
    bracket = after_sign(text, end, stop, "(")
    close = text.find(")", bracket, stop) if bracket >= 0 else -1
    content = text[bracket : close if close >= 0 else stop] if bracket >= 0 else ""
    parameters = tuple(parameter for part in content.split(",") if (parameter := _parameter(part)) is not None)
    return Definition(word, start, stop, word_start > start, text[position:end], position, result, parameters)


def _parameter(text: str) -> Parameter | None:
    """Return the parameter ``name``, ``name:IN`` or ``name[]:IN`` of a routine; None for an empty text."""
    begin, stop = after_blanks(text, 0, len(text)), len(text)
    name = word_at(text, begin, stop)
    if not name:
        return None
    bracket = after_sign(text, begin + len(name), stop, "[")
    end = text.find("]", bracket) + 1 if bracket >= 0 else begin + len(name)
    colon = after_sign(text, end, stop, ":")
    return Parameter(name, colon >= 0 and after_word(text, colon, stop, "IN") >= 0, bracket >= 0)


def _is_declaration(text: str, start: int, stop: int) -> bool:
    """Return whether a piece of code declares without DECL: a type and a name, such as ``PT P1``."""
    kind = NAME.match(text, start, stop)
    if kind is None or "$" in kind[0]:
        return False
    begin = after_blanks(text, kind.end(), stop)
    end = begin + len(word_at(text, begin, stop))
    if begin == kind.end() or end == begin:
        return False
    bracket = after_sign(text, end, stop, "[")
    end = end if bracket < 0 else text.find("]", bracket, stop) + 1
    next_offset = after_blanks(text, end, stop)
    return end > 0 and (next_offset == stop or text[next_offset] in ",=")


def _declaration(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement:
    """Return DECL, CONST, STRUC or a type, with the names that it declares."""
    names = tuple(declared_in(source, word_start, stop))
    constant = bool(names) and key_word(source.text, word_start, names[0].at, "CONST") is not None
    return Declaration(word, start, stop, word_start > start, constant, names, structure(source, word_start, stop))


def _cyclic_input(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return ANIN ON, DIGIN ON or SIGNAL with its name; without a name, what `_idle_declaration` returns."""
    position = word_start + len(word)
    if word != "SIGNAL":
        position = after_word(source.text, position, stop, "ON")
    name_start = after_blanks(source.text, position, stop)
    name = word_at(source.text, name_start, stop) if 0 <= position < name_start else ""
    return CyclicInput(word, start, stop, name) if name else _idle_declaration(source, word, start, word_start, stop)


def _idle_declaration(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return a declaration that does nothing, such as EXT; a plain statement if the word is none of those."""
    return IdleDeclaration(word, start, stop) if word in DECLARATIONS else Statement(word, start, stop)


def _import(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return ``IMPORT type name IS /R1/file..original``; an `IdleDeclaration` if it reads otherwise."""
    text = source.text
    kind = NAME.match(text, after_blanks(text, word_start + len(word), stop), stop)
    name = NAME.match(text, after_blanks(text, kind.end(), stop), stop) if kind else None
    dots = text.rfind("..", word_start, stop)
    original = NAME.match(text, after_blanks(text, dots + 2, stop), stop) if dots >= 0 else None
    file = text[text.rfind("/", word_start, dots) + 1 : dots].strip().upper()
    if name is None or original is None or key_word(text, name.end(), dots, "IS") is None:
        return IdleDeclaration(word, start, stop)
    return Import(word, start, stop, name[0].upper(), original[0].upper(), file)


# --- what moves and what follows it ----------------------------------------------------------------------------------


def _motion(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return a motion: its points, CA, the axes of a relative target, WITH and approximation."""
    text, position = source.text, word_start + len(word)
    via = end = angle = None
    is_circle = word.removesuffix("_REL") in CIRCLES
    if is_circle:
        via, position = _point(source, position, stop)
        position = after_sign(text, position, stop, ",") if position >= 0 else -1
    if position >= 0:
        end, position = _point(source, position, stop)
    if is_circle and position >= 0:
        comma = after_sign(text, position, stop, ",")
        angle_start = after_word(text, comma, stop, "CA") if comma >= 0 else -1
        if angle_start >= 0:
            equals = after_sign(text, angle_start, stop, "=")
            angle, position = _point(source, max(angle_start, equals), stop)
    if position < 0:  # a point cannot be read
        return Motion(word, start, stop, via, end, angle, "", None, Tail(stop, stop, stop))
    frame, frame_span, tail_end = "", None, stop
    if word.endswith("_REL"):
        begin = text.rfind("#", position, stop)
        frame = text[begin:stop].upper() if begin >= 0 else ""
        if (next_offset := after_blanks(text, position, stop)) < stop and text[next_offset] == "#":
            frame = f"#{word_at(text, next_offset + 1, stop)}"
            position = next_offset + len(frame) if frame in FRAMES else position
        elif frame in FRAMES and _is_approximation(text, position, begin):
            frame_span, tail_end = Span(begin, stop), begin
        frame = frame if frame in FRAMES else ""
    return Motion(word, start, stop, via, end, angle, frame, frame_span, tail_in(source, position, tail_end))


def _point(source: Source, start: int, stop: int) -> tuple[Value, int]:
    """Return the value at an offset, and the offset behind it; `UnreadableText` and −1 if it cannot be read."""
    try:
        return value_at(source, start, stop)
    except ProgramError as error:
        return unreadable_text(source, start, stop, error), -1


def is_approximated(text: str) -> bool:
    """Return whether a motion, or the end of one, has a word of approximation: C_DIS, C_VEL …"""
    return any(word in APPROXIMATIONS for word, _ in words_in(text, 0, len(text)))


def _is_approximation(text: str, start: int, stop: int) -> bool:
    """Return whether the last word of a piece of code is that of an approximation."""
    words = list(words_in(text, start, stop))
    if not words:
        return False
    word, span = words[-1]
    return word.startswith("C_") and not text[span.stop : stop].strip()


def tail_in(source: Source, start: int, stop: int) -> Tail:
    """Return what follows the points of a motion, or the word SPLINE: WITH and approximation."""
    text, words, end = source.text, list[str](), stop
    plain_words = text[start:stop].upper().split()
    if APPROXIMATIONS.issuperset(plain_words):  # nearly all of them
        return Tail(start, stop, start, (), tuple(plain_words))
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
        unknown_text = _stripped_span(text, start, end)
        return Tail(
            start, stop, end, (), tuple(words), unknown_text if unknown_text.start < unknown_text.stop else None
        )
    try:
        assignments = tuple(_with_assignment(source, *span) for span in list_spans(source, with_end, end))
        return Tail(start, stop, end, assignments, tuple(words))
    except ProgramError as error:
        return Tail(start, stop, end, (), tuple(words), error=error)


def _with_assignment(source: Source, start: int, stop: int) -> Statement:
    """Return an assignment of WITH; a plain statement if it is something else."""
    target, end = operand(source, start, stop)
    equals = after_sign(source.text, end, stop, "=")
    word, span = (
        word_at(source.text, after_blanks(source.text, start, stop), stop),
        _stripped_span(source.text, start, stop),
    )
    if not isinstance(target, Reference) or equals < 0:
        return Statement(word, span.start, span.stop, code=_unparsed_code(source, start, stop))
    return Assignment(word, span.start, span.stop, target, value_in(source, equals, stop))


def _spline(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return SPLINE or PTP_SPLINE with its approximation and WITH."""
    return Spline(word, start, stop, tail_in(source, word_start + len(word), stop))


def _end_spline(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return ENDSPLINE and the text behind it."""
    rest_start = word_start + len(word)
    return EndSpline(
        word, start, stop, source.text[rest_start:stop].strip(), code=_unparsed_code(source, rest_start, stop)
    )


def _spline_timing(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return CONST_VEL, TIME_BLOCK or STOP WHEN PATH, and whether it has all that its form requires."""
    text, position = source.text, word_start + len(word)
    if word == "STOP":
        when_end = after_word(text, position, stop, "WHEN")
        position = after_word(text, when_end, stop, "PATH") if when_end >= 0 else -1
    else:
        words = ("START", "END") if word == "CONST_VEL" else ("START", "END", "PART")
        position = after_word(text, position, stop, *words)
    is_complete = position >= 0
    if is_complete:
        value_start = after_sign(text, position, stop, "=")
        has_value = value_start >= 0 and after_blanks(text, value_start, stop) < stop and text[value_start] != "="
        is_bare = word == "TIME_BLOCK" and text[:position].upper().endswith(("START", "PART")) and position == stop
        is_complete = (
            has_value and not (word == "TIME_BLOCK" and text[:position].upper().endswith("START"))
        ) or is_bare
    if is_complete and word == "STOP":
        condition = key_word(text, position, stop, "IF")
        is_complete = condition is not None and condition.stop < stop
    on_start = key_word(text, word_start, stop, "ONSTART") is not None
    return SplineTiming(
        word, start, stop, is_complete, on_start, code=_unparsed_code(source, word_start + len(word), stop)
    )


def _event(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return INTERRUPT or TRIGGER with the statement behind DO.

    :param start: offset of the statement, `word_start` that of the word, behind GLOBAL, and `stop` that of its end.
    """
    do = key_word(source.text, word_start, stop, "DO")
    head = Span(word_start, stop if do is None else do.start)
    action = None if do is None else statement_in(source, after_blanks(source.text, do.stop, stop), stop)
    if word == "TRIGGER":
        return _trigger(source, start, word_start, stop, head, action)
    is_declaration = after_word(source.text, word_start + len(word), stop, "DECL") >= 0
    return Event(
        word,
        start,
        stop,
        word_start > start,
        is_declaration,
        action,
        code=_unparsed_code(source, head.start, head.stop),
    )


def _trigger(source: Source, start: int, word_start: int, stop: int, head: Span, action: Statement | None) -> Trigger:
    """Return ``TRIGGER WHEN DISTANCE|PATH = value [ONSTART] DELAY = time DO …``; without values if it reads otherwise.

    :param head: span of what precedes DO; `action` the statement behind it.
    """
    text, from_start = source.text, False
    value: Value | None = None
    delay: Value | None = None
    when_end = after_word(text, word_start + len("TRIGGER"), head.stop, "WHEN")
    kind_end = after_word(text, when_end, head.stop, "DISTANCE", "PATH") if when_end >= 0 else -1
    is_distance = kind_end >= 0 and text[:kind_end].upper().endswith("DISTANCE")
    value_start = after_sign(text, kind_end, head.stop, "=") if kind_end >= 0 else -1
    delay_word = key_word(text, value_start, head.stop, "DELAY") if value_start >= 0 else None
    delay_start = after_sign(text, delay_word.stop, head.stop, "=") if delay_word is not None else -1
    if delay_word is not None and delay_start >= 0 and action is not None:
        on_start = key_word(text, value_start, delay_word.start, "ONSTART")
        from_start = on_start is not None
        value = value_in(source, value_start, on_start.start if on_start is not None else delay_word.start)
        delay = value_in(source, delay_start, head.stop)
    code = _unparsed_code(source, head.start, head.stop)
    return Trigger(
        "TRIGGER", start, stop, word_start > start, False, action, is_distance, value, from_start, delay, code=code
    )


def _stripped_span(text: str, start: int, stop: int) -> Span:
    """Return the span of a piece of code without the blanks around it."""
    while stop > start and text[stop - 1] in " \t":
        stop -= 1
    return Span(after_blanks(text, start, stop), stop)


# --- control structures ----------------------------------------------------------------------------------------------


def _if(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return IF with its condition, and the text behind THEN."""
    begin = word_start + len(word)
    then_word = key_word(source.text, begin, stop, "THEN")
    head = _stripped_span(source.text, begin, stop if then_word is None else then_word.start)
    text_after_then = "" if then_word is None else source.text[then_word.stop : stop].strip()
    condition = value_in(source, head.start, head.stop) if head.start < head.stop else None
    return If(word, start, stop, condition, then_word is not None, text_after_then)


def _while(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return WHILE or UNTIL with its condition."""
    return While(word, start, stop, value_in(source, word_start + len(word), stop))


def _switch(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return SWITCH with its value."""
    return Switch(word, start, stop, value_in(source, word_start + len(word), stop))


def _case(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return CASE with its values."""
    return Case(word, start, stop, list_in(source, word_start + len(word), stop))


def _bare_word(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return a word that is alone on its line, and the text behind it, which should be empty."""
    rest_start = word_start + len(word)
    return BareWord(
        word, start, stop, source.text[rest_start:stop].strip(), code=_unparsed_code(source, rest_start, stop)
    )


_FOR_ADVICE = "Write FOR counter=first TO last STEP step; STEP may be left out."


def _for(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return ``FOR counter = first TO last STEP step``; `error` says why it cannot be read."""
    text = source.text
    begin = after_blanks(text, word_start + len(word), stop)
    name = word_at(text, begin, stop) if begin > word_start + len(word) else ""
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
    code = _unparsed_code(source, begin, stop) if bounds is None else None
    return For(word, start, stop, name, counter, bounds, error, code=code)


def _bounds(source: Source, start: int, stop: int) -> tuple[Value, Value, Value | None] | None:
    """Return the bounds and the step of ``first TO last STEP step``, the step None if left out; None for other code."""
    first, end = value_at(source, start, stop)
    end = after_word(source.text, end, stop, "TO")
    if end < 0:
        return None
    last, end = value_at(source, end, stop)
    step_start, step = after_word(source.text, end, stop, "STEP"), None
    if step_start >= 0:
        step, end = value_at(source, step_start, stop)
    return (first, last, step) if after_blanks(source.text, end, stop) == stop else None


def _goto(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return GOTO with its label."""
    begin = after_blanks(source.text, word_start + len(word), stop)
    return Goto(word, start, stop, word_at(source.text, begin, stop))


def _return(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return RETURN with its value, if it has one."""
    begin = after_blanks(source.text, word_start + len(word), stop)
    return Return(word, start, stop, value_in(source, begin, stop) if begin < stop else None)


def _bas(source: Source, word: str, start: int, word_start: int, stop: int) -> Statement | None:
    """Return a call of BAS; a plain statement if it is something else."""
    call, _ = operand(source, word_start, stop)
    if isinstance(call, Call):
        return CallStatement(word, start, stop, call)
    return Statement(word, start, stop, code=_unparsed_code(source, word_start, stop))


# arguments: the file, the first word (upper case, behind GLOBAL), offsets of the statement, of that word, of the end
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
