"""RAPID as text: tokens, expressions, statements and routines, with their offsets.

Grammar: ABB, Technical reference manual, RAPID Kernel (3HAC16585). Names are compared in upper case, as the controller
does. A statement that is not understood is an error; nothing is guessed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from msgspec import Struct

from postproc.dialects.rapid.language import WORDS
from postproc.errors import PostprocError


class RapidSyntaxError(PostprocError):
    """A text is not RAPID.

    :ivar start: offset of the error.
    :ivar is_at_end: the text ends before it is complete.
    """

    def __init__(self, problem: str, start: int, *, is_at_end: bool = False) -> None:
        super().__init__(problem)
        self.problem, self.start, self.is_at_end = problem, start, is_at_end


class Expression(Struct, frozen=True, eq=False):
    """A value in the text, from `start` to `stop`.

    :ivar kind: ``number``, ``string``, ``bool``, ``name``, ``index``, ``field``, ``call``, ``list``, ``operation`` or
        ``numbers`` (a target of numbers only).
    :ivar value: ``number``, ``string``, ``bool``: the value. ``name``, ``field``, ``call``: name in upper case.
        ``operation``: operator. ``numbers``: the texts of its numbers. Others: None.
    :ivar items: ``index``: array and indices. ``field``: record. ``list``: values. ``operation``: operands. ``call``:
        `Argument`s. Others: empty.
    """

    kind: str
    start: int
    stop: int
    value: Any = None
    items: tuple[Any, ...] = ()


class Argument(Struct, frozen=True, eq=False):
    """An argument of an instruction or function.

    :ivar name: name of an optional argument, upper case; empty for a positional argument.
    :ivar value: None for an optional argument without a value, a switch.
    """

    name: str
    value: Expression | None
    start: int
    stop: int


class Statement(Struct, frozen=True, eq=False):
    """A statement.

    :ivar start: offset of its first character.
    :ivar stop: offset behind its last character.
    """

    start: int
    stop: int


class Comment(Statement, frozen=True, eq=False):
    """A comment.

    :ivar text: text behind ``!``.
    :ivar is_trailing: True if other text precedes it in its line.
    """

    text: str
    is_trailing: bool


class Instruction(Statement, frozen=True, eq=False):
    """An instruction or a call of a procedure.

    :ivar name: upper case; a call by a text begins with ``%``.
    """

    name: str
    arguments: tuple[Argument, ...]


class Assignment(Statement, frozen=True, eq=False):
    """``target := value;``"""

    target: Expression
    value: Expression


class Declaration(Statement, frozen=True, eq=False):
    """A declaration of data.

    :ivar kind: CONST, PERS or VAR.
    :ivar is_local: True for LOCAL.
    :ivar type: upper case.
    :ivar name: upper case.
    :ivar spelling: the name as it is spelled.
    :ivar dimensions: sizes of an array; empty for other data.
    :ivar value: initial value; None without one.
    """

    kind: str
    is_local: bool
    type: str
    name: str
    spelling: str
    dimensions: tuple[Expression, ...]
    value: Expression | None


class Conditional(Statement, frozen=True, eq=False):
    """IF or TEST.

    :ivar branches: condition and statements of each branch. The condition of ELSE and DEFAULT is None; that of CASE
        is a ``list`` of values.
    :ivar subject: value of TEST with which the values of CASE are compared; None for IF.
    """

    branches: tuple[tuple[Expression | None, tuple[Statement, ...]], ...]
    subject: Expression | None = None


class Loop(Statement, frozen=True, eq=False):
    """FOR or WHILE.

    :ivar name: variable of FOR, upper case; empty for WHILE.
    :ivar bounds: FOR: first value, last value and, if stated, step. WHILE: condition.
    :ivar body_span: span of the text between DO and ENDFOR or ENDWHILE.
    """

    name: str
    bounds: tuple[Expression, ...]
    body: tuple[Statement, ...]
    body_span: tuple[int, int]


class Jump(Statement, frozen=True, eq=False):
    """RETURN, RAISE, RETRY, TRYNEXT, EXIT, GOTO, or a label (`word` is ``:``)."""

    word: str


class Parameter(Struct, frozen=True):
    """A parameter of a routine; name and type are in upper case.

    :ivar is_changeable: True for VAR, PERS and INOUT: the routine may change the argument.
    :ivar is_optional: True if a backslash precedes it.
    """

    name: str
    type: str
    is_changeable: bool
    is_optional: bool


class Routine(Struct, frozen=True, eq=False):
    """A routine of a module.

    :ivar kind: PROC, FUNC or TRAP.
    :ivar name: upper case.
    :ivar name_span: span of the name.
    :ivar body: statements of the routine.
    :ivar handler: statements of ERROR, UNDO and BACKWARD.
    """

    kind: str
    name: str
    name_span: tuple[int, int]
    parameters: tuple[Parameter, ...]
    body: tuple[Statement, ...]
    handler: tuple[Statement, ...]
    start: int
    stop: int
    is_local: bool


class Module(Struct, frozen=True, eq=False):
    """A module with its data and routines."""

    name: str
    data: tuple[Declaration, ...]
    routines: tuple[Routine, ...]


_TOKEN = re.compile(
    r"""(?P<space>[ \t\r\n\f]+)|(?P<comment>![^\r\n]*)
    |(?P<number>(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)
    |(?P<string>"(?:[^"\r\n]|"")*")
    |(?P<name>[^\W\d]\w*)
    |(?P<symbol>:=|<=|>=|<>|[-+*/=<>()\[\]{},;:\\.?%@&|])""",
    re.VERBOSE,
)
_N = r"[ \t]*([-+]?[0-9]+(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?)[ \t]*"
_PLAIN_TARGET = re.compile(
    rf"\[[ \t]*\[{_N},{_N},{_N}\][ \t]*,[ \t]*\[{_N},{_N},{_N},{_N}\][ \t]*,[ \t]*"
    rf"\[{_N},{_N},{_N},{_N}\][ \t]*,[ \t]*\[{_N},{_N},{_N},{_N},{_N},{_N}\][ \t]*\]"
)
"""A target of 17 numbers, as in most programs: matched at once."""
_POSITIVE = r"[ \t]*[0-9]+(?:\.[0-9]*)?[ \t]*"
_SPEED = rf"\[{_POSITIVE},{_POSITIVE},{_POSITIVE},{_POSITIVE}\]"
_MOVE = re.compile(
    rf"(Move[LJ])[ \t]+({_PLAIN_TARGET.pattern})[ \t]*,[ \t]*([a-z]\w*|{_SPEED})[ \t]*,"
    r"[ \t]*([a-z]\w*)[ \t]*,[ \t]*([a-z]\w*)[ \t]*,?[ \t]*(\\WObj[ \t]*:=[ \t]*([a-z]\w*)[ \t]*)?;",
    re.IGNORECASE | re.ASCII,
)
"""MoveL or MoveJ to a target of numbers; other arguments are names, or a speed of numbers: most lines of programs."""
_NUMBER_IN_LIST = re.compile(r"[0-9.]+")
_TARGET_GROUP, _TARGET_NUMBERS = 2, 17
"""Group of the target in `_MOVE`, and number of groups of its numbers: x, y, z, q1…q4, cf1…cfx, eax_a…eax_f."""
_OPERATORS = (("OR", "XOR"), ("AND",), ("=", "<>", "<", ">", "<=", ">="), ("+", "-"), ("*", "/", "DIV", "MOD"))
_COMPARISON, _SUM, _PRODUCT = 2, 3, 4
"""Indices in `_OPERATORS`; later operators bind more tightly."""
_END_WORDS = {"ENDIF", "ELSE", "ELSEIF", "ENDFOR", "ENDWHILE", "ENDTEST", "CASE", "DEFAULT", "ENDPROC", "ENDFUNC"}
_END_WORDS |= {"ENDTRAP", "ERROR", "UNDO", "BACKWARD", "ENDMODULE"}
_DATA_KINDS = ("CONST", "PERS", "VAR")
_KEYWORD_BEHIND_SCOPE = re.compile(r"\w+[ \t\r\n]+(?:TASK[ \t\r\n]+)?(\w+)", re.IGNORECASE)
"""LOCAL, TASK or both, and the word behind them, such as PROC."""
_MAX_DEPTH = 200
"""Largest number of nested expressions and blocks: no program has more; more would exceed the limit of recursion."""


class Parser:
    """Parser of a text from an offset on. Methods parse from the next token, and step over what they parse.

    :ivar kind: kind of the next token: ``name``, ``number``, ``string``, ``symbol``, ``end`` of the text, or ``?``.
    :ivar word: text of the next token; names in upper case.
    :ivar start: offset of the next token.
    :ivar stop: offset behind the next token.
    :ivar previous_stop: offset behind the token before it.
    :ivar comments: comments that have been read and belong to no block yet.
    :ivar depth: number of open expressions and blocks.
    """

    def __init__(self, text: str, start: int = 0, renamed: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Begin at an offset.

        :param renamed: module → name → name that replaces it in this module, all in upper case.
        """
        self.text, self.previous_stop, self.stop = text, start, start
        self._renamed_in_modules = renamed or {}
        self._renamed: Mapping[str, str] = {}  # in the present module
        self.kind, self.word, self.start = "", "", start
        self.comments: list[Comment] = []
        self.depth = 0
        self.step()

    def step(self) -> None:
        """Step over the next token, to the one behind it; comments between them are added to `comments`."""
        self.previous_stop = at = self.stop
        while True:
            match = _TOKEN.match(self.text, at)
            if match is None:
                self.kind, self.start, self.stop = ("end" if at >= len(self.text) else "?"), at, at + 1
                self.word = self.text[at : at + 1]
                return
            at = match.end()
            if match.lastgroup == "comment":
                line_start = self.text[self.previous_stop : match.start()]
                # text precedes the comment on its line: no line end is between the token before and the comment
                is_trailing = "\n" not in line_start and "\r" not in line_start and self.previous_stop > 0
                self.comments.append(Comment(match.start(), at, text=match[0][1:], is_trailing=is_trailing))
            elif match.lastgroup != "space":
                is_own_name = self.word not in (".", "\\")  # no component of data, and no option of a routine
                self.kind, self.start, self.stop = str(match.lastgroup), match.start(), at
                self.word = match[0].upper() if self.kind == "name" else match[0]
                if self._renamed and is_own_name and self.kind == "name":
                    self.word = self._renamed.get(self.word, self.word)
                return

    def _continue_at(self, offset: int) -> None:
        """Make the first token at or behind an offset the next token."""
        self.stop = offset
        self.step()

    def fault(self, expectation: str) -> RapidSyntaxError:
        """Return the error that `expectation` is expected in place of the next token."""
        token = self.text[self.start : self.stop] if self.kind != "end" else "the end of the file"
        problem = f"{expectation} is expected instead of {token!r}"
        return RapidSyntaxError(problem, self.start, is_at_end=self.kind == "end")

    def expect(self, word: str) -> None:
        """Step over the next token, which must be a certain word or symbol.

        :param word: the word in upper case, or the symbol.
        :raises RapidSyntaxError: the next token is another one.
        """
        if self.word != word or self.kind not in ("name", "symbol"):
            raise self.fault(word)
        self.step()

    def accept(self, word: str) -> bool:
        """Step over the next token if it is the word (upper case) or symbol `word`; return whether it is."""
        if self.word == word and self.kind in ("name", "symbol"):
            self.step()
            return True
        return False

    def identifier(self) -> str:
        """Parse a name that is no reserved word, and step over it; return it in upper case.

        :raises RapidSyntaxError: the next token is no such name.
        """
        if self.kind != "name" or self.word in WORDS:
            raise self.fault("a name")
        name = self.word
        self.step()
        return name

    # --- expressions

    def expression(self, level: int = 0) -> Expression:
        """Parse an expression.

        :param level: index in `_OPERATORS` of the loosest operators outside of brackets that it may have.
        :raises RapidSyntaxError: it is not valid, or nested too deeply.
        """
        if level == len(_OPERATORS):
            return self._factor()
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise RapidSyntaxError("brackets or statements are nested too deeply", self.start)
        start, left = self.start, self._first_operand(level)
        while self.kind in ("symbol", "name") and self.word in _OPERATORS[level]:
            word = self.word
            self.step()
            right = self.expression(level + 1)
            left = Expression("operation", start, self.previous_stop, word, (left, right))
        self.depth -= 1
        return left

    def _first_operand(self, level: int) -> Expression:
        """Parse the first operand of an expression, with NOT or the sign before it.

        :param level: index in `_OPERATORS` of the loosest operators that the expression may have.
        :raises RapidSyntaxError: it is not valid, or nested too deeply.
        """
        start = self.start
        if level in (0, _COMPARISON) and self.word == "NOT" and self.kind == "name":
            self.step()  # at level 0, NOT applies to the AND that follows: NOT a AND b is NOT (a AND b)
            operand = self.expression(level + 1)
            return Expression("operation", start, self.previous_stop, "NOT", (operand,))
        if level == _SUM and self.kind == "symbol" and self.word in ("-", "+"):
            sign = self.word
            self.step()
            operand = self.expression(_PRODUCT)
            if operand.kind == "number":
                return Expression("number", start, self.previous_stop, -operand.value if sign == "-" else operand.value)
            return Expression("operation", start, self.previous_stop, sign, (operand,))
        return self.expression(level + 1)

    def _factor(self) -> Expression:
        """Parse a number, string, TRUE or FALSE, aggregate, expression in brackets, or reference.

        :raises RapidSyntaxError: it is none of these, or not valid.
        """
        start, kind = self.start, self.kind
        if kind == "number":
            value = float(self.word)
            self.step()
            return Expression("number", start, self.previous_stop, value)
        if kind == "string":
            text = self.word[1:-1].replace('""', '"')
            self.step()
            return Expression("string", start, self.previous_stop, text)
        if self.word == "[" and kind == "symbol":
            return self._list()
        if self.accept("("):
            inner = self.expression()
            self.expect(")")
            return Expression(inner.kind, start, self.previous_stop, inner.value, inner.items)
        if kind == "name" and self.word in ("TRUE", "FALSE"):
            is_true = self.word == "TRUE"
            self.step()
            return Expression("bool", start, self.previous_stop, is_true)
        return self._reference()

    def _list(self) -> Expression:
        """Parse an aggregate in [ ]; a target of 17 numbers is matched at once, for speed.

        :returns: an expression of the kind ``numbers`` for such a target, else one of the kind ``list``.
        :raises RapidSyntaxError: it is not valid.
        """
        start = self.start
        if (match := _PLAIN_TARGET.match(self.text, start)) is not None:
            self._continue_at(match.end())
            return Expression("numbers", start, match.end(), match.groups())
        self.expect("[")
        items = [self.expression()]
        while self.accept(","):
            items.append(self.expression())
        self.expect("]")
        return Expression("list", start, self.previous_stop, None, tuple(items))

    def _reference(self) -> Expression:
        """Parse a name with indices and components, or a call of a function.

        :raises RapidSyntaxError: it is not valid.
        """
        start = self.start
        expression = Expression("name", start, self.stop, self.identifier())
        if self.word == "(" and self.kind == "symbol":
            self.step()
            arguments = () if self.word == ")" else self.arguments(")")
            self.expect(")")
            return Expression("call", start, self.previous_stop, expression.value, arguments)
        return self._components(expression)

    def arguments(self, end: str) -> tuple[Argument, ...]:
        """Parse arguments up to the symbol `end`, which remains the next token.

        :raises RapidSyntaxError: they are not valid.
        """
        items: list[Argument] = []
        while self.word != end or self.kind != "symbol":
            if items and not self.accept(",") and not (self.word == "\\" and self.kind == "symbol"):
                raise self.fault(f"a comma or {end}")
            start = self.start
            if self.accept("\\"):
                name, value = self.identifier(), None
                if self.accept(":=") or self.accept("?"):
                    value = self.expression()
                items.append(Argument(name, value, start, self.previous_stop))
            else:
                value = self.expression()
                items.append(Argument("", value, start, self.previous_stop))
        return tuple(items)

    # --- statements

    def block(self) -> tuple[Statement, ...]:
        """Parse statements up to a word that ends a block, which remains the next token.

        :raises RapidSyntaxError: a statement is not valid, or the text ends.
        """
        self.depth += 1  # not checked here: an expression precedes each nested block, and checks the depth
        statements: list[Statement] = []
        while True:
            statements += self._take_comments()
            if self.kind == "name" and self.word in _END_WORDS:
                self.depth -= 1
                return tuple(statements)
            if self.kind == "end":
                raise self.fault("the end of a routine")
            statements.append(self.statement())

    def _take_comments(self) -> list[Comment]:
        """Return the comments before the next token, and empty `comments`."""
        comments, self.comments = self.comments, []
        return comments

    def statement(self) -> Statement:
        """Parse a statement, with all statements inside it.

        :raises RapidSyntaxError: it is not valid.
        """
        start, word = self.start, self.word
        if self.kind == "symbol" and word == "%":
            return self._late_call()
        if self.kind != "name":
            raise self.fault("a statement")
        if word in ("MOVEL", "MOVEJ") and not self._renamed and (match := _MOVE.match(self.text, start)) is not None:
            return self._plain_move(match)
        if word in ("LOCAL", "TASK", *_DATA_KINDS):
            return self.declaration()
        structures = {"IF": self._if, "TEST": self._test, "FOR": self._for_statement, "WHILE": self._while_statement}
        if word in structures:
            self.step()
            return structures[word](start)
        if word in ("RETURN", "RAISE", "RETRY", "TRYNEXT", "EXIT", "GOTO", "CONNECT"):
            return self._jump(start, word)
        if word in WORDS:
            raise self.fault("a statement")
        return self._simple_statement(start)

    def _plain_move(self, match: re.Match[str]) -> Statement:
        """Return the move that `_MOVE` matched, and step over it: target, speed, zone, tool, perhaps work object."""
        groups = match.groups()
        # `groups` is without the whole match: the numbers follow the group of the target
        numbers = groups[_TARGET_GROUP : _TARGET_GROUP + _TARGET_NUMBERS]
        target = Expression("numbers", match.start(_TARGET_GROUP), match.end(_TARGET_GROUP), numbers)
        arguments = [Argument("", target, target.start, target.stop)]
        first_group = _TARGET_GROUP + _TARGET_NUMBERS + 1  # behind the groups of the target and of its numbers
        for group in range(first_group, first_group + 3):  # speed, zone and tool
            start, stop = match.span(group)
            arguments.append(Argument("", self._plain_argument(start, stop), start, stop))
        if groups[-1] is not None:  # the name of the work object; the group before it is the whole option
            start, stop = match.span(len(groups))
            name = Expression("name", start, stop, groups[-1].upper())
            arguments.append(Argument("WOBJ", name, match.start(len(groups) - 1), stop))
        self._continue_at(match.end())
        return Instruction(match.start(), match.end(), groups[0].upper(), tuple(arguments))

    def _plain_argument(self, start: int, stop: int) -> Expression:
        """Return ``text[start:stop]`` as an expression: a name, or a list of numbers without signs."""
        if self.text[start] != "[":
            return Expression("name", start, stop, self.text[start:stop].upper())
        numbers = _NUMBER_IN_LIST.finditer(self.text, start, stop)
        items = tuple(Expression("number", *number.span(), float(number[0])) for number in numbers)
        return Expression("list", start, stop, None, items)

    def _jump(self, start: int, word: str) -> Statement:
        """Parse RETURN, RAISE, RETRY, TRYNEXT, EXIT or GOTO; or CONNECT, which becomes an instruction.

        :param start: offset of its first word.
        :param word: its first word, which is the next token.
        :raises RapidSyntaxError: it is not valid.
        """
        self.step()  # to the token behind the word
        if word == "CONNECT":
            self.expression()
            self.expect("WITH")
            name = Expression("name", self.start, self.stop, self.identifier())
            self.expect(";")
            return Instruction(start, self.previous_stop, "CONNECT", (Argument("", name, name.start, name.stop),))
        if self.word != ";":
            self.expression()
        self.expect(";")
        return Jump(start, self.previous_stop, word)

    def _late_call(self) -> Statement:
        """Parse a call by a text, ``%"name"% arguments;``: an instruction named ``%NAME``.

        It is named ``%`` if the text is computed, so that the routine is not known.

        :raises RapidSyntaxError: it is not valid.
        """
        start = self.start
        self.expect("%")
        name = self.expression()
        self.expect("%")
        arguments = self.arguments(";")
        self.expect(";")
        # without the name of the module before a colon
        routine_name = str(name.value).rpartition(":")[2].upper() if name.kind == "string" else ""
        routine_name = self._renamed.get(routine_name, routine_name)
        return Instruction(start, self.previous_stop, f"%{routine_name}", arguments)

    def _simple_statement(self, start: int) -> Statement:
        """Parse an assignment, an instruction or a label, which all begin with a name.

        :param start: offset of its first word.
        :raises RapidSyntaxError: it is not valid.
        """
        name = Expression("name", start, self.stop, self.word)
        self.step()
        if self.kind == "symbol" and self.word == ":":
            self.step()
            return Jump(start, self.previous_stop, ":")
        if self.kind == "symbol" and self.word in (":=", "{", "."):
            target = self._components(name)
            self.expect(":=")
            value = self.expression()
            self.expect(";")
            return Assignment(start, self.previous_stop, target, value)
        arguments = self.arguments(";")
        self.expect(";")
        return Instruction(start, self.previous_stop, name.value, arguments)

    def _components(self, expression: Expression) -> Expression:
        """Parse the indices { } and components . behind an expression; return the whole reference.

        :param expression: the expression, which is returned if neither follows.
        :raises RapidSyntaxError: they are not valid.
        """
        start = expression.start
        while self.kind == "symbol" and self.word in ("{", "."):
            if self.accept("{"):
                items = [expression, self.expression()]
                while self.accept(","):
                    items.append(self.expression())
                self.expect("}")
                expression = Expression("index", start, self.previous_stop, None, tuple(items))
            else:
                self.step()
                component = self.identifier()
                expression = Expression("field", start, self.previous_stop, component, (expression,))
        return expression

    def _if(self, start: int) -> Statement:
        """Parse IF with its branches, from its condition on.

        :param start: offset of the word IF.
        :raises RapidSyntaxError: it is not valid.
        """
        condition = self.expression()
        if not self.accept("THEN"):  # compact IF: one statement
            statement = self.statement()
            return Conditional(start, self.previous_stop, ((condition, (statement,)),))
        branches: list[tuple[Expression | None, tuple[Statement, ...]]] = [(condition, self.block())]
        while self.accept("ELSEIF"):
            condition = self.expression()
            self.expect("THEN")
            branches.append((condition, self.block()))
        if self.accept("ELSE"):
            branches.append((None, self.block()))
        self.expect("ENDIF")
        return Conditional(start, self.previous_stop, tuple(branches))

    def _test(self, start: int) -> Statement:
        """Parse TEST with its cases, from its value on.

        :param start: offset of the word TEST.
        :raises RapidSyntaxError: it is not valid.
        """
        subject = self.expression()
        branches: list[tuple[Expression | None, tuple[Statement, ...]]] = []
        while self.word in ("CASE", "DEFAULT"):
            condition = None
            if not self.accept("DEFAULT"):
                self.step()
                values = [self.expression()]
                while self.accept(","):
                    values.append(self.expression())
                condition = Expression("list", values[0].start, self.previous_stop, None, tuple(values))
            self.expect(":")
            branches.append((condition, self.block()))
        self.expect("ENDTEST")
        return Conditional(start, self.previous_stop, tuple(branches), subject)

    def _for_statement(self, start: int) -> Statement:
        """Parse FOR, from its variable on.

        :param start: offset of the word FOR.
        :raises RapidSyntaxError: it is not valid.
        """
        name = self.identifier()
        self.expect("FROM")
        bounds = [self.expression()]
        self.expect("TO")
        bounds.append(self.expression())
        if self.accept("STEP"):
            bounds.append(self.expression())
        return self._loop(start, name, tuple(bounds), "ENDFOR")

    def _while_statement(self, start: int) -> Statement:
        """Parse WHILE, from its condition on.

        :param start: offset of the word WHILE.
        :raises RapidSyntaxError: it is not valid.
        """
        return self._loop(start, "", (self.expression(),), "ENDWHILE")

    def _loop(self, start: int, name: str, bounds: tuple[Expression, ...], end: str) -> Statement:
        """Parse the body of a loop from DO to `end`.

        :param start: offset of FOR or WHILE.
        :param name: variable of FOR, upper case; empty for WHILE.
        :param bounds: FOR: first value, last value and, if stated, step. WHILE: condition.
        :param end: ENDFOR or ENDWHILE.
        :raises RapidSyntaxError: it is not valid.
        """
        begin = self.stop  # the end of the word DO
        self.expect("DO")
        body = self.block()
        body_span = begin, self.start
        self.expect(end)
        return Loop(start, self.previous_stop, name=name, bounds=bounds, body=body, body_span=body_span)

    def declaration(self) -> Statement:
        """Parse a declaration of data.

        :raises RapidSyntaxError: it is not valid.
        """
        start, is_local = self.start, False
        while self.word in ("LOCAL", "TASK"):  # TASK data belong to one task: only one is read
            is_local |= self.word == "LOCAL"
            self.step()
        kind = self.word
        if kind not in _DATA_KINDS:
            raise self.fault("CONST, PERS or VAR")
        self.step()
        type_ = self.identifier()
        spelling = self.text[self.start : self.stop]  # of the name, which is the next token now
        name, dimensions = self.identifier(), list[Expression]()
        if self.accept("{"):  # an array
            dimensions.append(self.expression())
            while self.accept(","):
                dimensions.append(self.expression())
            self.expect("}")
        value = self.expression() if self.accept(":=") else None
        self.expect(";")
        return Declaration(
            start,
            self.previous_stop,
            kind=kind,
            is_local=is_local,
            type=type_,
            name=name,
            spelling=spelling,
            dimensions=tuple(dimensions),
            value=value,
        )

    # --- modules

    def modules(self) -> Iterator[Module]:
        """Parse all modules of a file; a header between ``%%%`` is skipped.

        :raises RapidSyntaxError: the file is not RAPID.
        """
        while self.word == "%" and self.kind == "symbol":  # %%% VERSION:1 LANGUAGE:ENGLISH %%%
            end = self.text.find("%%%", self.stop + 2)
            if end < 0:
                raise self.fault("%%%")
            self._continue_at(end + len("%%%"))
        while self.kind != "end":
            if self.word != "MODULE":
                raise self.fault("MODULE")
            self.step()
            yield self._module()

    def _module(self) -> Module:
        """Parse a module from its name to ENDMODULE: data and routines; RECORD and ALIAS are skipped.

        :raises RapidSyntaxError: it is not valid.
        """
        name = self.identifier()
        self._renamed = self._renamed_in_modules.get(name, {})
        if self.accept("("):  # attributes such as SYSMODULE, which have no effect on motion
            self._skip_beyond(")")
        data: list[Declaration] = []
        routines: list[Routine] = []
        while self.word != "ENDMODULE":
            self._take_comments()
            keyword = self.word
            if keyword in ("LOCAL", "TASK"):
                match = _KEYWORD_BEHIND_SCOPE.match(self.text, self.start)
                keyword = "" if match is None else match[1].upper()
            if keyword in _DATA_KINDS:
                declaration = self.declaration()
                if isinstance(declaration, Declaration):
                    data.append(declaration)
            elif keyword in ("PROC", "FUNC", "TRAP"):
                routines.append(self._routine())
            elif keyword in ("RECORD", "ALIAS"):
                self._skip_beyond(";" if keyword == "ALIAS" else "ENDRECORD")
            else:
                raise self.fault("data or a routine")
        self._renamed = {}
        self.step()
        self._take_comments()
        return Module(name, tuple(data), tuple(routines))

    def _routine(self) -> Routine:
        """Parse a routine with its parameters, body and error handlers.

        :raises RapidSyntaxError: it is not valid.
        """
        start = self.start
        is_local = self.accept("LOCAL")
        kind = self.word
        self.step()
        if kind == "FUNC":
            self.identifier()  # the type of its result
        name_span = self.start, self.stop
        name = self.identifier()
        parameters: tuple[Parameter, ...] = ()
        if kind != "TRAP":
            self.expect("(")
            parameters = self._parameters()
        body, handler = self.block(), list[Statement]()
        while self.word in ("ERROR", "UNDO", "BACKWARD"):
            self.step()
            if self.accept("("):  # the numbers of the errors, which are not needed
                self.arguments(")")
                self.expect(")")
            handler += self.block()
        self.expect(f"END{kind}")
        return Routine(
            kind=kind,
            name=name,
            name_span=name_span,
            parameters=parameters,
            body=body,
            handler=tuple(handler),
            start=start,
            stop=self.previous_stop,
            is_local=is_local,
        )

    def _parameters(self) -> tuple[Parameter, ...]:
        """Parse the parameters of a routine, from behind the opening bracket to behind the closing one.

        :raises RapidSyntaxError: they are not valid.
        """
        parameters: list[Parameter] = []
        while not self.accept(")"):
            self.accept(",")  # the first parameter and alternatives have no comma before them
            parameters.append(self._parameter())
        return tuple(parameters)

    def _parameter(self) -> Parameter:
        r"""Parse a parameter: ``num x``, ``INOUT num x{*}``, the optional ``\switch x``, or its alternative ``|num x``.

        :raises RapidSyntaxError: it is not valid.
        """
        is_alternative = self.accept("|")
        is_optional = self.accept("\\") or is_alternative
        is_changeable = self.word in ("VAR", "PERS", "INOUT")
        if is_changeable:
            self.step()
        type_ = self.identifier()
        spelling = self.text[self.start : self.stop]  # of the name, which is the next token now
        name = self.identifier()
        if is_optional:  # its own name, also if another name replaces it here: calls in other modules name it
            name = spelling.upper()
        if type_ == "SWITCH":  # has no value that a routine could change
            return Parameter(name, type_, is_changeable=False, is_optional=is_optional)
        if self.accept("{"):  # the dimensions of an array
            self._skip_beyond("}")
        return Parameter(name, type_, is_changeable=is_changeable, is_optional=is_optional)

    def _skip_beyond(self, end: str) -> None:
        """Step over all tokens up to and including a word or symbol.

        :raises RapidSyntaxError: the text ends before it.
        """
        while not self.accept(end):
            self.step()
            if self.kind == "end":
                raise self.fault(end)


def modules(text: str, renamed: Mapping[str, Mapping[str, str]] | None = None) -> tuple[Module, ...]:
    """Return the modules of a file.

    :param renamed: module → name → name that replaces it in this module, all in upper case.
    :raises RapidSyntaxError: the text is not RAPID.
    """
    return tuple(Parser(text, renamed=renamed).modules())


def all_statements(statements: tuple[Statement, ...]) -> Iterator[Statement]:
    """Yield statements, each followed by the statements inside it: branches of IF and TEST, bodies of loops."""
    for statement in statements:
        yield statement
        if isinstance(statement, Conditional):
            for _, body in statement.branches:
                yield from all_statements(body)
        elif isinstance(statement, Loop):
            yield from all_statements(statement.body)


def calls(statement: Statement) -> Iterator[Expression]:
    """Yield the calls of functions in the expressions of a statement; statements inside it are not searched."""
    unvisited: list[Expression | None] = []
    match statement:
        case Instruction():
            unvisited += [argument.value for argument in statement.arguments]
        case Assignment():
            unvisited += [statement.target, statement.value]
        case Declaration():
            unvisited.append(statement.value)
        case Conditional():
            unvisited += [statement.subject, *(condition for condition, _ in statement.branches)]
        case Loop():
            unvisited += statement.bounds
    while unvisited:
        expression = unvisited.pop()
        if expression is None or expression.kind in ("numbers", "number"):
            continue
        if expression.kind == "call":
            yield expression
        unvisited += [item.value if isinstance(item, Argument) else item for item in expression.items]
