"""The mutants of a source file: the same text with one small fault.

A mutant replaces one range of the text; the rest is kept to the byte. Docstrings, annotations, decorators, messages of
exceptions and imports have none.

| kind | faults |
|---|---|
| sign | + for -, - for +, a unary minus dropped |
| operator | × for ÷, a product for a power, a product of matrices the other way round, sin for cos, min for max |
| factor | a number changed, a factor, a divisor or a summand dropped |
| condition | negated, its boundary moved, constant; `and` for `or`, & for \\|, all for any; `not` dropped |
| dropped | a statement left out: a call, an assignment to what has a value, an early return, raise, break, continue |
| index | an index, a slice or an axis shifted by one, two indices of an einsum exchanged, a transposition dropped |
| argument | two arguments of a call, one behind the other, exchanged; not of `max` and the like |
| unit | a factor between units, `MM_PER_M`, the other way round |
"""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

BINARY = {
    ast.Add: ("sign", "+", "-"), ast.Sub: ("sign", "-", "+"), ast.Mult: ("operator", "*", "/"),
    ast.Div: ("operator", "/", "*"), ast.Pow: ("operator", "**", "*"), ast.FloorDiv: ("operator", "//", "*"),
    ast.Mod: ("operator", "%", "*"), ast.BitAnd: ("condition", "&", "|"), ast.BitOr: ("condition", "|", "&"),
    ast.BitXor: ("condition", "^", "&"),
}  # fmt: skip
NEGATED = {
    ast.Lt: ("<", ">="), ast.LtE: ("<=", ">"), ast.Gt: (">", "<="), ast.GtE: (">=", "<"), ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="), ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"), ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}  # fmt: skip
BOUNDARY = {ast.Lt: ("<", "<="), ast.LtE: ("<=", "<"), ast.Gt: (">", ">="), ast.GtE: (">=", ">")}
_PAIRS = (
    "sin cos|arcsin arccos|min max|minimum maximum|argmin argmax|nanmin nanmax|floor ceil|any all|zeros ones|"
    "zeros_like ones_like"
)
OTHER_NAME = {a: b for pair in _PAIRS.split("|") for a, b in (pair.split(), pair.split()[::-1])}
SYMMETRIC = {
    "min",
    "max",
    "minimum",
    "maximum",
    "fmin",
    "fmax",
    "hypot",
    "array_equal",
    "union1d",
    "logical_and",
    "swapaxes",
}
"""Functions whose arguments may change places."""
AXES = {"axis", "axis1", "axis2", "k"}
_UNIT = re.compile(r"[A-Z_]*_PER_[A-Z]+")


class Mutant(NamedTuple):
    """One fault in one file.

    :param file: relative to the root of the repository.
    :param line: the first line that is changed, from 1.
    :param kind: sign, operator, factor, condition, dropped, index, argument or unit.
    :param start: range of bytes that is replaced,
    :param end: and where it ends.
    :param new: the text in its place.
    :param before: the lines that are changed, as one line without indentation,
    :param after: and as they are then.
    :param lines: first and last line of the statement: a test that executes none of these cannot see the fault.
    :param in_function: the statement is in a function; others are executed at import.
    """

    file: str
    line: int
    kind: str
    start: int
    end: int
    new: str
    before: str
    after: str
    lines: tuple[int, int]
    in_function: bool

    def text(self, source: bytes) -> bytes:
        """Return the file with the fault."""
        return source[: self.start] + self.new.encode() + source[self.end :]


def mutants_of(path: Path, root: Path) -> list[Mutant]:
    """Return all mutants of a file, in the order of its text, each text once."""
    source = path.read_bytes()
    found, seen = [], {source}
    for mutant in sorted(_Walk(source, path.relative_to(root).as_posix()).all(), key=lambda m: (m.start, m.end, m.new)):
        text = mutant.text(source)
        if text not in seen:
            seen.add(text)
            found.append(mutant)
    return found


def compiles(text: bytes) -> bool:
    """Return whether it is Python: some faults leave a text that is none."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # 2.0[0] is a fault too
            compile(text, "mutant", "exec", dont_inherit=True)
    except (SyntaxError, ValueError):
        return False
    return True


class _Walk:
    """All faults of one text."""

    def __init__(self, source: bytes, file: str) -> None:
        self.source, self.file = source, file
        self.starts = [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.lines, self.in_function = (0, 0), False
        self.indices: set[int] = set()

    def all(self) -> Iterator[Mutant]:
        """Return the faults of all statements."""
        self.tree = ast.parse(self.source)
        yield from self._body(self.tree.body, set())

    def _body(self, body: list[ast.stmt], known: set[str], *, whole: bool = False) -> Iterator[Mutant]:
        """Return those of statements; `known` are the names that have a value before them.

        :param whole: they are all of a function: without a return it would return nothing, which every test sees.
        """
        for statement in body:
            if whole and isinstance(statement, ast.Return):
                self.lines = (statement.lineno, statement.end_lineno or statement.lineno)
                yield from self._expressions([statement.value] if statement.value else [])
                continue
            yield from self._statement(statement, known)
            known |= {n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}

    def _statement(self, node: ast.stmt, known: set[str]) -> Iterator[Mutant]:
        nested = [getattr(node, name) for name in ("body", "orelse", "finalbody") if getattr(node, name, None)]
        nested += [each.body for each in (*getattr(node, "handlers", ()), *getattr(node, "cases", ()))]
        last = nested[0][0].lineno - 1 if nested else node.end_lineno
        self.lines = (node.lineno, max(node.lineno, last or 0))
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            if isinstance(node, ast.FunctionDef):
                yield from self._expressions([*node.args.defaults, *filter(None, node.args.kw_defaults)])
                outer, self.in_function = self.in_function, True
                arguments = {a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)}
                yield from self._body(node.body, arguments, whole=True)
                self.in_function = outer
            else:
                yield from self._body(node.body, set())
            return
        yield from self._dropped(node, known)
        if isinstance(node, ast.AugAssign):
            yield from self._augmented(node)
        if isinstance(node, ast.If | ast.While):
            yield from self._constant(node.test)
        if not isinstance(node, ast.Import | ast.ImportFrom | ast.Raise):
            fields = (value for name, value in ast.iter_fields(node) if name not in ("annotation", "type_params"))
            children = (child for value in fields for child in (value if isinstance(value, list) else [value]))
            yield from self._expressions([child for child in children if isinstance(child, ast.expr | ast.withitem)])
        for part in nested:
            yield from self._body(part, set(known))

    def _expressions(self, nodes: list[ast.AST]) -> Iterator[Mutant]:
        for top in nodes:
            if isinstance(top, ast.Constant) and isinstance(top.value, str):
                continue  # docstrings among them
            for node in _walk(top):
                handler = getattr(self, "_on_" + type(node).__name__.lower(), None)
                if handler is not None:
                    yield from handler(node)
                for test in (
                    [node.test]
                    if isinstance(node, ast.IfExp)
                    else node.ifs
                    if isinstance(node, ast.comprehension)
                    else []
                ):
                    yield from self._constant(test)

    def _dropped(self, node: ast.stmt, known: set[str]) -> Iterator[Mutant]:
        if isinstance(node, ast.Assign):
            dropped = all(not isinstance(n, ast.Name) or n.id in known for n in _targets(node))
        elif isinstance(node, ast.Expr):
            dropped = not isinstance(node.value, ast.Constant)
        elif isinstance(node, ast.Return):
            dropped = bool(node.value)
        else:
            dropped = isinstance(node, ast.AugAssign | ast.Raise | ast.Continue | ast.Break | ast.Delete)
        if dropped:
            yield self._mutant(node, "dropped", *self._range(node), "pass")

    def _constant(self, test: ast.expr) -> Iterator[Mutant]:
        if not isinstance(test, ast.Constant):
            for value in ("True", "False"):
                yield self._mutant(test, "condition", *self._range(test), value)

    def _on_binop(self, node: ast.BinOp) -> Iterator[Mutant]:
        start, end = self._range(node)
        if isinstance(node.op, ast.MatMult):
            at, after = self._operator(node.left, node.right, "@")
            left, right = self._text(start, at), self._text(after, end)
            yield self._mutant(node, "operator", start, end, f"{right} @ {left}")
            return
        if type(node.op) not in BINARY or _is_text(node.left):
            return
        kind, symbol, other = BINARY[type(node.op)]
        at, after = self._operator(node.left, node.right, symbol)
        yield self._mutant(node, kind, at, after, other)
        neutral = (
            1.0 if isinstance(node.op, ast.Mult | ast.Div) else 0.0
        )  # 1.0 * RAD_PER_DEG: without it nothing changes
        if isinstance(node.op, ast.Add | ast.Sub | ast.Mult | ast.Div) and not _is_number(node.right, neutral):
            yield self._mutant(node, "factor", start, end, self._text(start, at))
        if isinstance(node.op, ast.Add | ast.Mult) and not _is_number(node.left, neutral):
            yield self._mutant(node, "factor", start, end, self._text(after, end))

    def _augmented(self, node: ast.AugAssign) -> Iterator[Mutant]:
        if type(node.op) in BINARY and not _is_text(node.value):
            kind, symbol, other = BINARY[type(node.op)]
            at, after = self._operator(node.target, node.value, symbol + "=")
            yield self._mutant(node, kind, at, after, other + "=")

    def _on_unaryop(self, node: ast.UnaryOp) -> Iterator[Mutant]:
        if isinstance(node.op, ast.USub | ast.Not | ast.Invert):
            kind = "sign" if isinstance(node.op, ast.USub) else "condition"
            start, end = self._range(node)
            symbol = 3 if isinstance(node.op, ast.Not) else 1
            if kind == "condition" or not isinstance(node.operand, ast.Constant):
                yield self._mutant(node, kind, start, end, self._text(start + symbol, end))
            elif node.operand.value:
                yield self._mutant(node, kind, start, start + 1, "")

    def _on_boolop(self, node: ast.BoolOp) -> Iterator[Mutant]:
        symbol, other = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield self._mutant(node, "condition", *self._operator(left, right, symbol), other)

    def _on_compare(self, node: ast.Compare) -> Iterator[Mutant]:
        operands = [node.left, *node.comparators]
        for left, operator, right in zip(operands, node.ops, operands[1:], strict=False):
            for symbol, other in filter(None, (NEGATED.get(type(operator)), BOUNDARY.get(type(operator)))):
                yield self._mutant(node, "condition", *self._operator(left, right, symbol), other)

    def _on_constant(self, node: ast.Constant) -> Iterator[Mutant]:
        if id(node) in self.indices:
            return
        new = _other_number(node.value)
        if new is not None:
            yield self._mutant(node, "condition" if isinstance(node.value, bool) else "factor", *self._range(node), new)

    def _on_call(self, node: ast.Call) -> Iterator[Mutant]:
        function = node.func
        name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
        length = node.args[0] if node.args else None
        if isinstance(length, ast.Tuple) and length.elts:
            length = length.elts[0]
        is_empty = length is not None and _is_number(length, 0)  # zeros and ones of length 0 are the same
        if name in OTHER_NAME and not is_empty:
            end = self._range(function)[1]
            yield self._mutant(function, "operator", end - len(name), end, OTHER_NAME[name])
        first = node.args[0] if node.args else None
        if name == "einsum" and isinstance(first, ast.Constant) and isinstance(first.value, str):
            start, end = self._range(first)
            text = self._text(start, end)
            for place in range(1, len(text) - 1):
                pair = text[place : place + 2]
                if pair.isalpha() and pair[0] != pair[1]:
                    yield self._mutant(first, "index", start + place, start + place + 2, pair[::-1])
        for keyword in node.keywords:
            if name == "zip" and keyword.arg == "strict":  # only checks what is so
                self.indices.add(id(keyword.value))
            if keyword.arg in AXES:
                yield from self._shifted(keyword.value, both=False)
        if name in ("sum", "cumsum", "mean", "swapaxes", "moveaxis", "diff", "concatenate", "stack", "expand_dims"):
            for argument in node.args:
                yield from self._shifted(argument, both=False)
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name == "reshape":  # numpy takes any negative length for the one that it computes
            lengths = [length for each in node.args for length in getattr(each, "elts", [each]) if _whole(length) == -1]
            self.indices |= {id(getattr(length, "operand", length)) for length in lengths}
        equal_factors = _equal_factors(node) if name == "einsum" else set()
        for left, right in zip(node.args, node.args[1:], strict=False) if name not in SYMMETRIC else ():
            is_clipped = name == "clip" and left is node.args[0]  # the middle one of three numbers in any order
            if is_clipped or (id(left), id(right)) in equal_factors:
                continue
            if not any(isinstance(argument, ast.Starred) or _is_text(argument) for argument in (left, right)):
                (start, left_end), (right_start, end) = self._range(left), self._range(right)
                between = self.source[left_end:right_start].decode()
                exchanged = self._text(right_start, end) + between + self._text(start, left_end)
                yield self._mutant(node, "argument", start, end, exchanged)

    def _on_name(self, node: ast.Name) -> Iterator[Mutant]:
        if isinstance(node.ctx, ast.Load) and _UNIT.fullmatch(node.id):
            yield self._mutant(node, "unit", *self._range(node), f"(1.0 / {node.id})")

    def _on_subscript(self, node: ast.Subscript) -> Iterator[Mutant]:
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for part in parts:
            if isinstance(part, ast.Slice):
                for each in (part.lower, part.upper, part.step):
                    yield from self._shifted(each)
            else:
                yield from self._shifted(part, both=False)

    def _shifted(self, node: ast.expr | None, *, both: bool = True) -> Iterator[Mutant]:
        """Return the neighbours of a whole number that is written; one of them if the other is most often no index."""
        value = _whole(node)
        if node is not None and value is not None:
            self.indices |= {id(node), id(getattr(node, "operand", node))}
            for new in (value - 1, value + 1) if both else (value - 1 if value > 0 else value + 1,):
                yield self._mutant(node, "index", *self._range(node), str(new))

    def _on_attribute(self, node: ast.Attribute) -> Iterator[Mutant]:
        if node.attr == "T":
            end = self._range(node)[1]
            yield self._mutant(node, "index", self._range(node.value)[1], end, "")

    def _operator(self, left: ast.expr, right: ast.expr, symbol: str) -> tuple[int, int]:
        """Return the range of the operator between two operands."""
        start, end = self._range(left)[1], self._range(right)[0]
        between = re.sub(rb"#[^\n]*", lambda found: b" " * len(found[0]), self.source[start:end])
        spaced = rb"\s+".join(re.escape(word) for word in symbol.encode().split())
        found = re.search(rb"(?<![*/])" + spaced + rb"(?![*/])" if symbol in "*/" else spaced, between)
        assert found, (self.file, left.lineno, symbol)
        return start + found.start(), start + found.end()

    def _range(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self.starts[node.lineno - 1] + node.col_offset, self.starts[node.end_lineno - 1] + node.end_col_offset

    def _text(self, start: int, end: int) -> str:
        return self.source[start:end].decode().strip()

    def _mutant(self, node: ast.expr | ast.stmt, kind: str, start: int, end: int, new: str) -> Mutant:
        line = self.source[:start].count(b"\n") + 1
        first, last = self.starts[line - 1], self.source.find(b"\n", end)
        whole = self.source[first : last if last >= 0 else None]
        changed = whole[: start - first] + new.encode() + whole[end - first :]
        before, after = (" ".join(text.decode().split()) for text in (whole, changed))
        return Mutant(self.file, line, kind, start, end, new, before, after, self.lines, self.in_function)


def _targets(node: ast.Assign) -> list[ast.expr]:
    flat = []
    for target in node.targets:
        flat += target.elts if isinstance(target, ast.Tuple) else [target]
    return flat


def _is_number(node: ast.expr, value: float) -> bool:
    return isinstance(node, ast.Constant) and node.value == value


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _whole(node: ast.expr | None) -> int | None:
    """Return the whole number that is written, or None."""
    sign = 1
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        node, sign = node.operand, -1
    if isinstance(node, ast.Constant) and type(node.value) is int:
        return sign * node.value
    return None


def _other_number(value: object) -> str | None:
    """Return a number (or truth value) in place of another, as text; None for other constants."""
    if isinstance(value, bool):
        return str(not value)
    if isinstance(value, int):
        return str(value + 1)
    if isinstance(value, float):
        return repr(value * 2.0) if value else "1.0"
    return None


def _equal_factors(einsum: ast.Call) -> set[tuple[int, int]]:
    """Return the neighbours with the same subscripts among the factors of an einsum: they may change places."""
    first = einsum.args[0]
    if not (isinstance(first, ast.Constant) and isinstance(first.value, str)):
        return set()
    subscripts, factors = first.value.partition("->")[0].split(","), einsum.args[1:]
    pairs = zip(subscripts, subscripts[1:], factors, factors[1:], strict=False)
    return {(id(left), id(right)) for of_left, of_right, left, right in pairs if of_left == of_right}


def _walk(top: ast.AST) -> Iterator[ast.AST]:
    """Return the nodes below an expression, without those of formatted text: it is for people, and has no places."""
    if not isinstance(top, ast.JoinedStr):
        yield top
        for child in ast.iter_child_nodes(top):
            yield from _walk(child)
