"""Whether text is KRL: a grammar of its own (`krl.lark`), and rules of the controller that no grammar holds.

It shares no code with the package. `Refused` says which rule is broken, and in which line.
"""

from __future__ import annotations

import math
import re
from functools import cache, lru_cache
from pathlib import Path, PurePath

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedInput

LONGEST_NAME = 24
LONGEST_LINE = 989
"""No limit is published; so long are lines that controllers themselves write."""
CARTESIAN = {*"XYZABCST", *(f"E{n}" for n in range(1, 7))}
AXES = {*(f"A{n}" for n in range(1, 7)), *(f"E{n}" for n in range(1, 7))}
RESERVED = (
    "AND ANIN ANOUT BOOL BRAKE B_AND B_EXOR B_NOT B_OR CASE CHAR CIRC CIRC_REL CONST CONTINUE C_DIS C_ORI C_PTP "
    "C_SPL C_VEL DECL DEF DEFAULT DEFDAT DEFFCT DELAY DIGIN DO ELSE END ENDDAT ENDFCT ENDFOR ENDIF ENDLOOP "
    "ENDSPLINE ENDSWITCH ENDWHILE ENUM EXIT EXOR EXT EXTFCT EXTFCTP EXTP FALSE FOR GLOBAL GOTO HALT IF IMPORT INT "
    "INTERRUPT LIN LIN_REL LOOP MAXIMUM MINIMUM NOT OR PRIO PTP PTP_REL PTP_SPLINE PUBLIC REAL REPEAT RESUME RETURN "
    "SCIRC SCIRC_REL SEC SIGNAL SLIN SLIN_REL SPL SPL_REL SPLINE SPTP SPTP_REL STRUC SWITCH THEN TO TRIGGER TRUE "
    "UNTIL WAIT WHEN WHILE WITH"
)
_CODE = re.compile(r'((?:[^";]|"[^"]*"?)*)')
_FOLD = re.compile(r"\s*;\s*(END)?FOLD\b", re.IGNORECASE)


class Refused(AssertionError):
    """The text is no KRL that a controller takes."""


@lru_cache(maxsize=8)
def check(name, text):
    """Raise `Refused` unless the text of a file, `.src`, `.sub` or `.dat`, is KRL; return its tree.

    The last trees are kept: a text is asked about several times, before and after it is written.

    :param name: of the file: its main routine, or its data list, must have it.
    """
    data = name.lower().endswith(".dat")
    code, lines = code_of(name, text)
    try:
        tree = parser().parse(code, start="data" if data else "source")
    except UnexpectedInput as cause:
        place = lines[cause.line - 1] if 0 < cause.line <= len(lines) else ""
        raise Refused(f"{name}:{cause.line}: no KRL: {place.strip()!r} ({type(cause).__name__})") from None
    _Rules(name, tree).check()
    return tree


def takes(name, text):
    """Whether the text of a file is KRL; see `check`."""
    return not isinstance(_names_or_refusal(name, text), Refused)


@lru_cache(maxsize=1000)
def _names_or_refusal(name, text):
    """Names that the code of a file uses, and those that it declares or defines; or the refusal of `check`.

    Tests write the same files again and again: their names are kept, not their trees.
    """
    try:
        tree = check(name, text)
    except Refused as refusal:
        return refusal
    used, declared = set(), set()
    for subtree in tree.iter_subtrees():
        names = [str(child) for child in subtree.children if isinstance(child, Token) and child.type == "NAME"]
        if subtree.data in ("place", "call", "goto"):
            used.update(names[:1])
        else:
            declared.update(names)
    return used, declared


@cache
def parser():
    grammar = Path(__file__).with_name("krl.lark").read_text(encoding="utf-8")
    return Lark(
        grammar.replace("RESERVED)", RESERVED.replace(" ", "|") + ")"),
        parser="lalr", start=["source", "data"], propagate_positions=True, maybe_placeholders=False,
    )  # fmt: skip


def code_of(name, text):
    """The text without comments and headers, in upper case, line by line; and its lines. Folds must close."""
    lines = re.split(r"\r*\n|\r", text)
    code, folds, begun = [], [], False
    for number, line in enumerate(lines, 1):
        if re.search(r"[\x00-\x08\x0b\x0e-\x1f]", line):
            raise Refused(f"{name}:{number}: a control character")
        if len(line) > LONGEST_LINE:
            raise Refused(f"{name}:{number}: {len(line)} characters")
        if fold := _FOLD.match(line):
            if fold[1] and not folds:
                raise Refused(f"{name}:{number}: ENDFOLD without FOLD")
            if fold[1]:
                folds.pop()
            else:
                folds.append(number)
        if line.startswith("&"):
            if begun:
                raise Refused(f"{name}:{number}: a header behind the beginning of the program")
            line = ""
        plain = _CODE.match(line)[1].rstrip().replace("\f", " ")
        begun = begun or bool(plain.strip())
        code.append(re.sub("[a-z]+", lambda found: found[0].upper(), plain))
    if folds:
        raise Refused(f"{name}:{folds[-1]}: the fold does not end")
    return "\n".join(code) + "\n", lines


class _Rules:
    """Rules beyond the grammar, for one file."""

    def __init__(self, name, tree):
        self.name, self.tree = name, tree

    def refuse(self, place, why):
        line = place.line if isinstance(place, Token) else place.meta.line
        raise Refused(f"{self.name}:{line}: {why}")

    def check(self):
        for token in self.tree.scan_values(lambda value: isinstance(value, Token)):
            if token.type == "NAME" and len(token) > LONGEST_NAME and token[0] != "$":
                self.refuse(token, f"{token} has {len(token)} characters")
            if token.type == "NUMBER" and not math.isfinite(float(token)):
                self.refuse(token, f"{token} is not finite")
        for aggregate in self.tree.find_data("aggregate"):
            names = components(aggregate)
            if len(set(names)) < len(names):
                self.refuse(aggregate, "a component stands twice")
        for motion in self.tree.iter_subtrees_topdown():
            if motion.data in ("motion", "circle", "piece"):
                self.motion(motion)
        named = None
        if self.tree.data == "source":
            named = [self.routine(routine) for routine in self.tree.children]
            for one, name in enumerate(named):
                if name in named[:one]:
                    self.refuse(name, f"{name} is defined twice")
        first = named[0] if named else self.tree.children[0]
        if first != PurePath(self.name).stem.upper():
            self.refuse(first, f"{first} stands in the file {self.name}")

    def motion(self, motion):
        """Targets are Cartesian or axes, auxiliary points Cartesian."""
        points = [child for child in motion.children if isinstance(child, Tree) and child.data == "aggregate"]
        for number, point in enumerate(points):
            names = set(components(point))
            auxiliary = motion.data == "circle" and number == 0
            if not (names <= CARTESIAN or (names <= AXES and not auxiliary)):
                self.refuse(point, f"no position: {sorted(names)}")

    def routine(self, routine):
        body = routine.children[-1]
        labels = {}
        jumps = []
        self.walk(body, (), False, labels, jumps, routine.data == "function")
        for token, inside in jumps:
            if token not in labels:
                self.refuse(token, f"GOTO to {token}, which is nowhere")
            if labels[token] != inside[: len(labels[token])]:
                self.refuse(token, f"GOTO into a structure, to {token}")
        return next(child for child in routine.children if isinstance(child, Token) and child.type == "NAME")

    def walk(self, tree, inside, looped, labels, jumps, function):
        """Labels with the blocks that they stand in; EXIT only in loops, RETURN with a value only in functions."""
        for number, child in enumerate(tree.children):
            if not isinstance(child, Tree):
                continue
            if child.data == "label":
                if child.children[0] in labels:
                    self.refuse(child, f"the label {child.children[0]} stands twice")
                labels[child.children[0]] = inside
            elif child.data == "goto":
                jumps.append((child.children[0], inside))
            elif child.data == "exit" and not looped:
                self.refuse(child, "EXIT outside a loop")
            elif child.data == "leave" and (len(child.children) == 2) != function:
                self.refuse(child, "RETURN with a value in a DEF, or without one in a DEFFCT")
            elif child.data in ("block", "branch", "loop", "switch", "case", "default"):
                deeper = (*inside, number) if child.data == "block" else (*inside, -1 - number)
                self.walk(child, deeper, looped or child.data == "loop", labels, jumps, function)


def components(aggregate):
    """Names of the components of an aggregate, in order."""
    return [str(part.children[0]) for part in aggregate.children if isinstance(part, Tree)]


def unknown_names(files):
    """Names that the code of files uses, and that none of them declares or defines; without those of the system.

    :param files: name → text.
    :raises Refused: a text is not KRL; see `check`.
    """
    used, declared = set(), set()
    for name, text in files.items():
        names = _names_or_refusal(name, text)
        if isinstance(names, Refused):
            raise names
        used |= names[0]
        declared |= names[1]
    return {name for name in used - declared if name[0] != "$"}
