"""From a line to a statement: the only place that knows how KRL's statements are written.

Each line is read once. A statement that is not understood becomes a plain `tree.Statement` and is kept unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, cast

from postproc.dialects.krl.language.declarations import declared_in, structure
from postproc.dialects.krl.language.expressions import (
    list_spans,
    list_values,
    opaque_text,
    operand_at,
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
    key_word,
    skip_blanks,
    skip_sign,
    skip_word,
    word_at,
    words_in,
)
from postproc.dialects.krl.language.tree import (
    Assignment,
    BareWord,
    Bounds,
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
    """Return the statement on a 1-based line whose code has the span `start`, `stop`; the result is stored."""
    node = source.statements.get(line)
    if node is None:
        node = source.statements[line] = statement_in(source, start, stop)
    return cast("Statement", node)


class _Code(NamedTuple):
    """The code of one statement.

    :ivar word: its first word, upper case; if this is GLOBAL, its second word.
    :ivar start: offset at which the statement begins, GLOBAL included.
    :ivar word_start: offset of `word`.
    :ivar stop: offset behind the statement.
    """

    source: Source
    word: str
    start: int
    word_start: int
    stop: int

    @property
    def word_stop(self) -> int:
        """Offset behind `word`."""
        return self.word_start + len(self.word)

    @property
    def is_global(self) -> bool:
        """Whether GLOBAL is the first word."""
        return self.word_start > self.start


def statement_in(source: Source, start: int, stop: int) -> Statement:
    """Return the statement in a piece of code; a `FaultyStatement` if it cannot be read."""
    word = word_at(source.text, start, stop)
    word_start = start
    if word == "GLOBAL":
        word_start = skip_blanks(source.text, start + len(word), stop)
        word = word_at(source.text, word_start, stop)
    code = _Code(source, word, start, word_start, stop)
    try:
        return _READERS.get(word, _ordinary_statement)(code)
    except ProgramError as error:
        return FaultyStatement(word, start, stop, error, code=_unparsed_code(source, start, stop))


def _unparsed_code(source: Source, start: int, stop: int) -> Value | None:
    """Return a piece of code that is not parsed further, as a value with its calls; None if there are none."""
    if "(" not in source.text[start:stop]:
        return None
    try:
        return opaque_text(source, start, stop)
    except ProgramError as error:
        return unreadable_text(source, start, stop, error)


def _ordinary_statement(code: _Code) -> Statement:
    """Return a statement that does not begin with a key word: assignment, call, label or declaration without DECL.

    Anything else is a plain `Statement`.

    :raises ProgramError: brackets are not balanced.
    """
    source, word, start, word_start, stop = code
    text = source.text
    # no code, a line of the header such as &ACCESS, or a key word without a reader of its own
    if word_start == stop or text[word_start] == "&" or (word in RESERVED and word not in TYPES):
        return Statement(word, start, stop, code=_unparsed_code(source, word_start, stop))
    if word in TYPES:
        return _declaration(code)
    target, end = operand_at(source, word_start, stop)
    equals = skip_sign(text, end, stop, "=")
    # the second character: `==` compares
    if isinstance(target, Reference) and equals >= 0 and text[equals : equals + 1] != "=":
        return Assignment(word, start, stop, target, value_in(source, equals, stop))
    if isinstance(target, Call) and end == stop:
        return CallStatement(word, start, stop, target)
    colon = skip_sign(text, end, stop, ":")
    if isinstance(target, Reference) and colon >= 0 and skip_blanks(text, colon, stop) == stop:
        return Label(word, start, stop, target.name)
    if _is_declaration(text, word_start, stop):
        return _declaration(code)
    return Statement(word, start, stop, code=_unparsed_code(source, word_start, stop))


# --- declarations ----------------------------------------------------------------------------------------------------


def _definition(code: _Code) -> Statement:
    """Return DEF or DEFFCT with name, type of the result and parameters.

    Without a name, or without a type behind DEFFCT, the result is that of `_ordinary_statement`.

    :raises ProgramError: brackets are not balanced.
    """
    source, word, start, _, stop = code
    text, name_start, result_type = source.text, skip_blanks(source.text, code.word_stop, stop), ""
    if word == "DEFFCT":
        result_type = word_at(text, name_start, stop)
        name_start = skip_blanks(text, name_start + len(result_type), stop)
        if not result_type:
            return _ordinary_statement(code)
        if name_start < stop and text[name_start] == "[":  # the type is an array
            bracket = text.find("]", name_start, stop)
            if bracket < 0:
                raise source.error("the bracket [ is not closed", name_start, "Write ] behind the type of the result.")
            name_start = skip_blanks(text, bracket + 1, stop)
    name_stop = name_start
    while name_stop < stop and text[name_stop] not in " \t(":
        name_stop += 1
    if name_stop == name_start or name_start == code.word_stop:
        return _ordinary_statement(code)
    return Definition(
        word,
        start,
        stop,
        is_global=code.is_global,
        name=text[name_start:name_stop],
        name_start=name_start,
        result_type=result_type,
        parameters=_parameters(text, name_stop, stop),
    )


def _parameters(text: str, start: int, stop: int) -> tuple[Parameter, ...]:
    """Return the parameters in the brackets of a DEF; no parameters without brackets.

    A bracket that is not closed ends with the statement.

    :param start: offset behind the name of the routine; `stop` the offset behind the statement.
    """
    bracket = skip_sign(text, start, stop, "(")
    if bracket < 0:
        return ()
    close = text.find(")", bracket, stop)
    content = text[bracket : close if close >= 0 else stop]
    return tuple(parameter for part in content.split(",") if (parameter := _parameter(part)) is not None)


def _parameter(text: str) -> Parameter | None:
    """Return the parameter ``name``, ``name:IN`` or ``name[]:IN`` of a routine; None for an empty text."""
    begin, stop = skip_blanks(text, 0, len(text)), len(text)
    name = word_at(text, begin, stop)
    if not name:
        return None
    bracket = skip_sign(text, begin + len(name), stop, "[")
    end = text.find("]", bracket) + 1 if bracket >= 0 else begin + len(name)
    colon = skip_sign(text, end, stop, ":")
    is_input = colon >= 0 and skip_word(text, colon, stop, "IN") >= 0
    return Parameter(name, by_value=is_input, is_array=bracket >= 0)


def _is_declaration(text: str, start: int, stop: int) -> bool:
    """Return whether a piece of code declares without DECL: a type and a name, such as ``PT P1``."""
    kind = NAME.match(text, start, stop)
    if kind is None or "$" in kind[0]:
        return False
    begin = skip_blanks(text, kind.end(), stop)
    end = begin + len(word_at(text, begin, stop))
    if begin == kind.end() or end == begin:
        return False
    bracket = skip_sign(text, end, stop, "[")
    end = end if bracket < 0 else text.find("]", bracket, stop) + 1
    next_offset = skip_blanks(text, end, stop)
    return end > 0 and (next_offset == stop or text[next_offset] in ",=")


def _declaration(code: _Code) -> Statement:
    """Return a declaration, which begins with DECL, CONST, STRUC or a type, with the names that it declares.

    :raises ProgramError: brackets are not balanced.
    """
    source, word, start, word_start, stop = code
    names = tuple(declared_in(source, word_start, stop))
    is_constant = bool(names) and key_word(source.text, word_start, names[0].name_start, "CONST") is not None
    return Declaration(
        word,
        start,
        stop,
        is_global=code.is_global,
        is_constant=is_constant,
        names=names,
        structure=structure(source, word_start, stop),
    )


def _cyclic_input(code: _Code) -> Statement:
    """Return ANIN ON, DIGIN ON or SIGNAL with its name; without ON or a name, the result of `_idle_declaration`."""
    text, position = code.source.text, code.word_stop
    if code.word != "SIGNAL":
        position = skip_word(text, position, code.stop, "ON")
    name_start = skip_blanks(text, position, code.stop)
    name = word_at(text, name_start, code.stop) if 0 <= position < name_start else ""  # a blank must precede the name
    return CyclicInput(code.word, code.start, code.stop, name) if name else _idle_declaration(code)


def _idle_declaration(code: _Code) -> Statement:
    """Return a declaration that does nothing, such as EXT; a plain statement if its word is not in `DECLARATIONS`."""
    node_type = IdleDeclaration if code.word in DECLARATIONS else Statement
    return node_type(code.word, code.start, code.stop)


def _import(code: _Code) -> Statement:
    """Return ``IMPORT type name IS /R1/file..original``; an `IdleDeclaration` for an IMPORT of any other form."""
    text, stop = code.source.text, code.stop
    kind = NAME.match(text, skip_blanks(text, code.word_stop, stop), stop)
    name = NAME.match(text, skip_blanks(text, kind.end(), stop), stop) if kind else None
    dots = text.rfind("..", code.word_start, stop)
    original = NAME.match(text, skip_blanks(text, dots + 2, stop), stop) if dots >= 0 else None
    file = text[text.rfind("/", code.word_start, dots) + 1 : dots].strip().upper()
    if name is None or original is None or key_word(text, name.end(), dots, "IS") is None:
        return IdleDeclaration(code.word, code.start, stop)
    return Import(code.word, code.start, stop, name=name[0].upper(), original=original[0].upper(), file=file)


# --- motions and events ----------------------------------------------------------------------------------------------


def _motion(code: _Code) -> Statement:
    """Return a motion: its points, CA, the axes of a relative target, WITH and approximation.

    If a point cannot be read, it is an `UnreadableText`, and the text behind it is not read.
    """
    source, word, start, _, stop = code
    text, position = source.text, code.word_stop  # `position` is −1 once a point cannot be read
    via = end = angle = None
    is_circle = word.removesuffix("_REL") in CIRCLES
    if is_circle:
        via, position = _point(source, position, stop)
        position = skip_sign(text, position, stop, ",") if position >= 0 else -1
    if position >= 0:
        end, position = _point(source, position, stop)
    if is_circle and position >= 0:
        comma = skip_sign(text, position, stop, ",")
        angle_start = skip_word(text, comma, stop, "CA") if comma >= 0 else -1
        if angle_start >= 0:
            equals = skip_sign(text, angle_start, stop, "=")  # −1 without the sign, which may be left out
            angle, position = _point(source, max(angle_start, equals), stop)
    if position < 0:
        axes, tail = _without_axes(stop, stop), Tail(start=stop, stop=stop, with_stop=stop)
    else:
        is_relative = word.endswith("_REL")
        axes = _relative_axes(text, position, stop) if is_relative else _without_axes(position, stop)
        tail = tail_in(source, axes.tail_start, axes.tail_stop)
    return Motion(word, start, stop, via=via, end=end, angle=angle, frame=axes.frame, frame_span=axes.span, tail=tail)


class _RelativeAxes(NamedTuple):
    """The axes of a relative motion, and the bounds of its tail.

    :ivar frame: ``#BASE`` or ``#TOOL``; empty if it is not given.
    :ivar span: span of ``#BASE`` or ``#TOOL`` if it follows the approximation, else None.
    :ivar tail_start: offset at which WITH and approximation begin; `tail_stop` is behind them.
    """

    frame: str
    span: Span | None
    tail_start: int
    tail_stop: int


def _without_axes(tail_start: int, tail_stop: int) -> _RelativeAxes:
    """Return the bounds of the tail of a motion that names neither ``#BASE`` nor ``#TOOL``."""
    return _RelativeAxes(frame="", span=None, tail_start=tail_start, tail_stop=tail_stop)


def _relative_axes(text: str, start: int, stop: int) -> _RelativeAxes:
    """Return the axes of a ``_REL`` motion, which are before or behind its approximation; no axes for unknown ones.

    :param start: offset behind the points of the motion; `stop` the offset behind the statement.
    """
    frame_start = skip_blanks(text, start, stop)
    if frame_start < stop and text[frame_start] == "#":
        frame = f"#{word_at(text, frame_start + 1, stop)}"
        if frame not in FRAMES:
            return _without_axes(start, stop)
        return _RelativeAxes(frame, span=None, tail_start=frame_start + len(frame), tail_stop=stop)
    frame_start = text.rfind("#", start, stop)
    frame = text[frame_start:stop].upper() if frame_start >= 0 else ""
    if frame not in FRAMES or not _is_approximation(text, start, frame_start):  # else e.g. the value of WITH
        return _without_axes(start, stop)
    return _RelativeAxes(frame, span=Span(frame_start, stop), tail_start=start, tail_stop=frame_start)


def _point(source: Source, start: int, stop: int) -> tuple[Value, int]:
    """Return the value at an offset, and the offset behind it; `UnreadableText` and −1 if the value cannot be read."""
    try:
        return value_at(source, start, stop)
    except ProgramError as error:
        return unreadable_text(source, start, stop, error), -1


def is_approximated(text: str) -> bool:
    """Return whether the text of a motion, or the end of such a text, contains an approximation such as C_DIS."""
    return any(word in APPROXIMATIONS for word, _ in words_in(text, 0, len(text)))


def _is_approximation(text: str, start: int, stop: int) -> bool:
    """Return whether a piece of code ends with a word such as C_DIS."""
    words = list(words_in(text, start, stop))
    if not words:
        return False
    word, span = words[-1]
    return word.startswith("C_") and not text[span.stop : stop].strip()


def tail_in(source: Source, start: int, stop: int) -> Tail:
    """Return WITH and approximation (``WITH $VEL.CP=1 C_DIS``), which follow the points of a motion or the word SPLINE.

    If WITH cannot be read, `Tail.error` says why; other text before the approximation is `Tail.unknown_text`.
    """
    text = source.text
    plain_words = text[start:stop].upper().split()
    if APPROXIMATIONS.issuperset(plain_words):  # nearly all tails, also the empty one
        return Tail(start, stop, start, approximation=tuple(plain_words))
    words: list[str] = []  # of the approximation
    end = stop  # of the text before the approximation
    all_words = list(words_in(text, start, stop))
    for word, span in reversed(all_words):
        if word not in APPROXIMATIONS or text[span.stop : end].strip():
            break
        words.insert(0, word)
        end = span.start
    text_before = _stripped_span(text, start, end)  # WITH and its assignments, or unknown text
    with_stop = text_before.stop
    has_other_words = len(all_words) > len(words)
    with_word_end = skip_word(text, start, with_stop, "WITH") if has_other_words else -1
    if with_word_end < 0:
        unknown_text = text_before if text_before.start < with_stop else None
        return Tail(start, stop, with_stop, approximation=tuple(words), unknown_text=unknown_text)
    try:
        assignments = tuple(_with_assignment(source, *span) for span in list_spans(source, with_word_end, with_stop))
        return Tail(start, stop, with_stop, assignments=assignments, approximation=tuple(words))
    except ProgramError as error:
        return Tail(start, stop, with_stop, approximation=tuple(words), error=error)


def _with_assignment(source: Source, start: int, stop: int) -> Statement:
    """Return an assignment of WITH; a plain statement if it is something else."""
    target, end = operand_at(source, start, stop)
    equals = skip_sign(source.text, end, stop, "=")
    span = _stripped_span(source.text, start, stop)
    word = word_at(source.text, span.start, stop)
    if not isinstance(target, Reference) or equals < 0:
        return Statement(word, span.start, span.stop, code=_unparsed_code(source, start, stop))
    return Assignment(word, span.start, span.stop, target, value_in(source, equals, stop))


def _spline(code: _Code) -> Statement:
    """Return SPLINE or PTP_SPLINE with its approximation and WITH."""
    return Spline(code.word, code.start, code.stop, tail_in(code.source, code.word_stop, code.stop))


def _end_spline(code: _Code) -> Statement:
    """Return ENDSPLINE and the text behind it."""
    extra_text = code.source.text[code.word_stop : code.stop].strip()
    unparsed_code = _unparsed_code(code.source, code.word_stop, code.stop)
    return EndSpline(code.word, code.start, code.stop, extra_text, code=unparsed_code)


def _spline_timing(code: _Code) -> Statement:
    """Return CONST_VEL, TIME_BLOCK or STOP WHEN PATH, complete or not."""
    text, stop = code.source.text, code.stop
    is_from_start = key_word(text, code.word_start, stop, "ONSTART") is not None
    unparsed_code = _unparsed_code(code.source, code.word_stop, stop)
    return SplineTiming(code.word, code.start, stop, _is_complete_timing(code), is_from_start, code=unparsed_code)


def _is_complete_timing(code: _Code) -> bool:
    """Return whether CONST_VEL, TIME_BLOCK or STOP WHEN PATH has all that its form requires.

    The forms are ``CONST_VEL START|END = …``, ``TIME_BLOCK START``, ``TIME_BLOCK PART [= …]``, ``TIME_BLOCK END = …``,
    and ``STOP WHEN PATH = … IF condition``.
    """
    text, stop = code.source.text, code.stop
    if code.word == "STOP":
        when_end = skip_word(text, code.word_stop, stop, "WHEN")
        position = skip_word(text, when_end, stop, "PATH") if when_end >= 0 else -1
    else:
        words = ("START", "END") if code.word == "CONST_VEL" else ("START", "END", "PART")
        position = skip_word(text, code.word_stop, stop, *words)
    if position < 0:
        return False
    value_start = skip_sign(text, position, stop, "=")
    has_value = value_start >= 0 and skip_blanks(text, value_start, stop) < stop and text[value_start] != "="
    if code.word == "TIME_BLOCK":
        text_before = text[:position].upper()  # ends with START, END or PART
        is_bare = text_before.endswith(("START", "PART")) and position == stop
        return is_bare or (has_value and not text_before.endswith("START"))
    condition = key_word(text, position, stop, "IF") if code.word == "STOP" else None
    return has_value and (code.word != "STOP" or (condition is not None and condition.stop < stop))


def _event(code: _Code) -> Statement:
    """Return INTERRUPT or TRIGGER with the statement behind DO, if there is one."""
    source, word, start, word_start, stop = code
    do = key_word(source.text, word_start, stop, "DO")
    head = Span(word_start, stop if do is None else do.start)
    action = None if do is None else statement_in(source, skip_blanks(source.text, do.stop, stop), stop)
    if word == "TRIGGER":
        return _trigger(code, head, action)
    return Event(
        word,
        start,
        stop,
        is_global=code.is_global,
        is_declaration=skip_word(source.text, code.word_stop, stop, "DECL") >= 0,
        action=action,
        code=_unparsed_code(source, head.start, head.stop),
    )


def _trigger(code: _Code, head: Span, action: Statement | None) -> Trigger:
    """Return ``TRIGGER WHEN DISTANCE|PATH = value [ONSTART] DELAY = time DO …``.

    A TRIGGER of any other form has no value and no delay.

    :param head: span of the code before DO.
    :param action: the statement behind DO; None without one.
    """
    source, word, start, _, stop = code
    text, is_from_start = source.text, False
    value: Value | None = None
    delay: Value | None = None
    when_end = skip_word(text, code.word_stop, head.stop, "WHEN")
    kind_end = skip_word(text, when_end, head.stop, "DISTANCE", "PATH") if when_end >= 0 else -1
    is_distance = kind_end >= 0 and text[:kind_end].upper().endswith("DISTANCE")
    value_start = skip_sign(text, kind_end, head.stop, "=") if kind_end >= 0 else -1
    delay_word = key_word(text, value_start, head.stop, "DELAY") if value_start >= 0 else None
    delay_start = skip_sign(text, delay_word.stop, head.stop, "=") if delay_word is not None else -1
    if delay_word is not None and delay_start >= 0 and action is not None:
        on_start = key_word(text, value_start, delay_word.start, "ONSTART")
        is_from_start = on_start is not None
        value = value_in(source, value_start, on_start.start if on_start is not None else delay_word.start)
        delay = value_in(source, delay_start, head.stop)
    return Trigger(
        word,
        start,
        stop,
        is_global=code.is_global,
        is_declaration=False,
        action=action,
        is_distance=is_distance,
        value=value,
        is_from_start=is_from_start,
        delay=delay,
        code=_unparsed_code(source, head.start, head.stop),
    )


def _stripped_span(text: str, start: int, stop: int) -> Span:
    """Return the span of a piece of code without the blanks around it."""
    while stop > start and text[stop - 1] in " \t":
        stop -= 1
    return Span(skip_blanks(text, start, stop), stop)


# --- control structures ----------------------------------------------------------------------------------------------


def _if(code: _Code) -> Statement:
    """Return IF with its condition and the text behind THEN; without a condition or THEN if they are missing."""
    text, begin, stop = code.source.text, code.word_stop, code.stop
    then_word = key_word(text, begin, stop, "THEN")
    head = _stripped_span(text, begin, stop if then_word is None else then_word.start)
    extra_text = "" if then_word is None else text[then_word.stop : stop].strip()
    condition = value_in(code.source, head.start, head.stop) if head.start < head.stop else None
    has_then = then_word is not None
    return If(code.word, code.start, stop, condition=condition, has_then=has_then, extra_text=extra_text)


def _while(code: _Code) -> Statement:
    """Return WHILE or UNTIL with its condition."""
    return While(code.word, code.start, code.stop, value_in(code.source, code.word_stop, code.stop))


def _switch(code: _Code) -> Statement:
    """Return SWITCH with its value."""
    return Switch(code.word, code.start, code.stop, value_in(code.source, code.word_stop, code.stop))


def _case(code: _Code) -> Statement:
    """Return CASE with its values.

    :raises ProgramError: brackets are not balanced.
    """
    return Case(code.word, code.start, code.stop, list_values(code.source, code.word_stop, code.stop))


def _bare_word(code: _Code) -> Statement:
    """Return a word that is alone on its line, and the text behind it, which should be empty."""
    extra_text = code.source.text[code.word_stop : code.stop].strip()
    unparsed_code = _unparsed_code(code.source, code.word_stop, code.stop)
    return BareWord(code.word, code.start, code.stop, extra_text, code=unparsed_code)


_FOR_ADVICE = "Write FOR counter=first TO last STEP step; STEP may be left out."


def _for(code: _Code) -> Statement:
    """Return ``FOR counter = first TO last STEP step``.

    If it cannot be read, counter and bounds are None, and `For.error` gives the reason, if there is one.
    """
    source, text, stop = code.source, code.source.text, code.stop
    begin = skip_blanks(text, code.word_stop, stop)
    name = word_at(text, begin, stop) if begin > code.word_stop else ""
    counter = bounds = error = None
    try:
        target, end = operand_at(source, begin, stop)
        equals = skip_sign(text, end, stop, "=")
        if isinstance(target, Reference) and target.field is None and equals >= 0:
            bounds = _bounds(source, equals, stop)
            counter = None if bounds is None else target
            error = source.error("FOR is not understood", code.start, _FOR_ADVICE) if bounds is None else None
    except ProgramError as cause:
        error = cause
    return For(
        code.word,
        code.start,
        stop,
        name=name,
        counter=counter,
        bounds=bounds,
        error=error,
        code=_unparsed_code(source, begin, stop) if bounds is None else None,
    )


def _bounds(source: Source, start: int, stop: int) -> Bounds | None:
    """Return the bounds of a FOR from ``first TO last STEP step``, where STEP is optional; None for other code.

    :raises ProgramError: one of the values cannot be read.
    """
    first, end = value_at(source, start, stop)
    end = skip_word(source.text, end, stop, "TO")
    if end < 0:
        return None
    last, end = value_at(source, end, stop)
    step_start, step = skip_word(source.text, end, stop, "STEP"), None
    if step_start >= 0:
        step, end = value_at(source, step_start, stop)
    return Bounds(first, last, step) if skip_blanks(source.text, end, stop) == stop else None


def _goto(code: _Code) -> Statement:
    """Return GOTO with its label, upper case."""
    begin = skip_blanks(code.source.text, code.word_stop, code.stop)
    return Goto(code.word, code.start, code.stop, word_at(code.source.text, begin, code.stop))


def _return(code: _Code) -> Statement:
    """Return RETURN with its value, if it has one."""
    begin = skip_blanks(code.source.text, code.word_stop, code.stop)
    value = value_in(code.source, begin, code.stop) if begin < code.stop else None
    return Return(code.word, code.start, code.stop, value)


def _bas(code: _Code) -> Statement:
    """Return a call of BAS, KUKA's program that sets speeds and frames; a plain statement if it is something else.

    :raises ProgramError: brackets are not balanced.
    """
    call, _ = operand_at(code.source, code.word_start, code.stop)
    if isinstance(call, Call):
        return CallStatement(code.word, code.start, code.stop, call)
    unparsed_code = _unparsed_code(code.source, code.word_start, code.stop)
    return Statement(code.word, code.start, code.stop, code=unparsed_code)


_Reader = Callable[[_Code], Statement]
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
