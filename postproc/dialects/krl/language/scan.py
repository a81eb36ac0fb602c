"""Names that whole files define, declare and call, found by regular expressions without parsing statements.

A folder may hold thousands of programs, of which one needs a few: these functions find out which.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator

from msgspec import Struct

from postproc.dialects.krl.language.tokens import names_in

_FIRST = r"(?:\A|(?<=[\r\n]))[ \t]*"
"""The beginning of a line, behind any line end."""
_BEGINS = r"^[ \t]*"
"""The beginning of a line behind a line feed: found in a sixth of the time that `_FIRST` takes."""
_HEAD = r"(?P<public>GLOBAL[ \t]+)?DEF(?:FCT[ \t]+\w+(?:[ \t]*\[[ ,\t]*\])?)?[ \t]+(?P<name>[A-Za-z_$][\w$]*)"
_FLAGS = re.IGNORECASE | re.ASCII | re.MULTILINE
_ROUTINE = re.compile(_BEGINS + _HEAD, _FLAGS)
_WHOLE_ROUTINE = re.compile(
    rf"{_BEGINS}{_HEAD}[^\r\n]*(?P<body>.*?){_BEGINS}END(?:FCT)?[ \t]*(?:;|\r|\n|\Z)", _FLAGS | re.DOTALL
)
DEF_LINE = re.compile(rf"{_FIRST}(?:GLOBAL[ \t]+)?DEF[ \t][^\r\n]*(\r{{0,2}}\n|\r)", re.IGNORECASE)
"""The line of a DEF; its group is the line end."""
_HEAD_NAME = re.compile(rf"{_FIRST}(?:GLOBAL[ \t]+)?(?:DEF|DEFDAT)[ \t]+(?P<name>[A-Za-z_$][\w$]*)", _FLAGS)
_CODE = re.compile(r"^[ \t]*[^\s;&]", re.MULTILINE)
_NO_CODE = re.compile(r"\"[^\"\r\n]*\"|;[^\r\n]*")
_CALL = re.compile(r"([A-Za-z_]\w*)[ \t]*\(", re.ASCII)
_MOTION = re.compile(r"\bS?(?:PTP|LIN|CIRC|SPL)", re.IGNORECASE)
_GLOBAL = re.compile(rf"{_BEGINS}(?:DECL[ \t]+)?GLOBAL\b[^;\r\n]*", _FLAGS)
_GLOBAL_VARIABLE = re.compile(
    rf"{_BEGINS}(?:(?:DECL|CONST)[ \t]+)*GLOBAL[ \t]+(?:(?:DECL|CONST)[ \t]+)*\w+[ \t]+(\w+)", _FLAGS
)
_ASSIGNMENT = re.compile(rf"{_BEGINS}([A-Za-z_]\w*)[^=\r\n;\"']*=(?!=)", _FLAGS)
_DECLARATION = re.compile(rf"{_BEGINS}(?:DECL|INT|REAL|BOOL|CHAR|POS|E6POS|FRAME|AXIS|E6AXIS)\b[^;=\r\n]*", _FLAGS)
_IMPORT = re.compile(r"/R1/(\w+)[ \t]*\.\.", _FLAGS)
_WORD = re.compile(r"\"[^\"\r\n]*\"|;[^\r\n]*|[A-Za-z_$][\w$]*", re.ASCII)


class RoutineHead(Struct, frozen=True):
    """The line of a DEF or DEFFCT.

    :param name: upper case.
    :param is_global: True for GLOBAL.
    :param start: offset of the beginning of the line.
    :param is_empty: True if the body of the routine has no code; False too if the body was not read.
    """

    name: str
    is_global: bool
    start: int
    is_empty: bool = False


def routines(text: str) -> Iterator[RoutineHead]:
    """Yield all routines of a text, also those without END; their bodies are not read."""
    for match in _ROUTINE.finditer(text):
        yield RoutineHead(match["name"].upper(), bool(match["public"]), match.start())


def whole_routines(text: str) -> Iterator[RoutineHead]:
    """Yield the routines of a text that have an END, with `is_empty`."""
    for match in _WHOLE_ROUTINE.finditer(text):
        is_empty = _CODE.search(match["body"]) is None
        yield RoutineHead(match["name"].upper(), bool(match["public"]), match.start(), is_empty)


def global_routines(text: str) -> frozenset[str]:
    """Return the names, upper case, of the GLOBAL routines of a text."""
    return frozenset(routine.name for routine in routines(text) if routine.is_global)


def global_variables(text: str) -> frozenset[str]:
    """Return the names, upper case, of GLOBAL variables that a `.dat` declares."""
    return frozenset(name.upper() for name in _GLOBAL_VARIABLE.findall(text))


def assigned_variables(text: str) -> frozenset[str]:
    """Return the names, upper case, of variables that a `.src` assigns but does not declare."""
    local_names = set().union(*map(names_in, _DECLARATION.findall(text)))
    return frozenset(name.upper() for name in _ASSIGNMENT.findall(text)) - local_names


def global_lines(text: str) -> list[str]:
    """Return the lines that begin with GLOBAL or DECL GLOBAL, without comments."""
    return _GLOBAL.findall(text)


def global_declarations(text: str) -> list[str]:
    """Return the lines that begin with GLOBAL or DECL GLOBAL and define no routine, without comments."""
    return [line for line in global_lines(text) if _ROUTINE.match(line) is None]


def code_without_comments(text: str) -> str:
    """Return code without comments and strings."""
    return _NO_CODE.sub(" ", text)


def called_names(code: str) -> set[str]:
    """Return the names, upper case, in front of a bracket in code without comments: names that may be called.

    Words of KRL and functions of the controller are among them; routines that the code defines are not.
    """
    return {name.upper() for name in _CALL.findall(code)} - {routine.name for routine in routines(code)}


def has_motion(code: str) -> bool:
    """Return whether code without comments contains a word that begins like a motion: PTP, LIN, CIRC, SPL …"""
    return _MOTION.search(code) is not None


def imported_files(data: str) -> set[str]:
    """Return the names, upper case, of the files from which a `.dat` imports variables."""
    return {name.upper() for name in _IMPORT.findall(data)}


def words(text: str) -> Iterator[tuple[str, int]]:
    """Yield the names and strings outside of comments: text as spelled, strings with quotes, and its offset."""
    for match in _WORD.finditer(text):
        if match[0][0] != ";":
            yield match[0], match.start()


def names(text: str) -> set[str]:
    """Return the names in a text, upper case; names in strings count, names in comments do not."""
    return set().union(*(names_in(word) for word, _ in words(text)))


def name_places(text: str, names_to_find: Collection[str]) -> Iterator[tuple[str, int]]:
    """Yield each occurrence of `names_to_find` in a text, in comments too: the name as spelled, and its offset."""
    pattern = rf"(?<![\w$])(?:{'|'.join(map(re.escape, names_to_find))})(?![\w$])"
    for match in re.finditer(pattern, text, _FLAGS) if names_to_find else ():
        yield match[0], match.start()


def text_with_name(text: str, name: str) -> str:
    """Return the text of a file with another name behind its first DEF or DEFDAT; unchanged if it has none."""
    match = _HEAD_NAME.search(text)
    return text if match is None else text[: match.start("name")] + name + text[match.end("name") :]
