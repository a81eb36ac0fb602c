"""Brackets, strings and lists in a piece of code: where they end."""

from __future__ import annotations

from postproc.dialects.krl.language.source import Source

_PAIRS = {"(": ")", "[": "]", "{": "}"}
_DEEPEST = 100


def matching(source: Source, start: int, stop: int) -> int:
    """Return the offset of the bracket that closes the one at `start`.

    :raises ProgramError: there is none before `stop`.
    """
    text = source.text
    open_: list[str] = []
    offset = start
    while offset < stop:
        char = text[offset]
        if char == '"':
            offset = text.find('"', offset + 1, stop)
            if offset < 0:
                break
        elif char in _PAIRS:
            open_.append(_PAIRS[char])
            if len(open_) > _DEEPEST:
                raise source.error(
                    f"more than {_DEEPEST} brackets are nested", start, "Write it as several statements."
                )
        elif char in ")]}":
            if open_.pop() != char:
                break
            if not open_:
                return offset
        offset += 1
    raise source.error(f"{text[start]} is not closed", start, "Check that the line is complete.")


def split(source: Source, start: int, stop: int) -> list[tuple[int, int]]:
    """Return the spans between the commas of a list, brackets and strings skipped; an empty list has none."""
    text = source.text
    spans: list[tuple[int, int]] = []
    begin = offset = start
    while offset < stop:
        char = text[offset]
        if char in _PAIRS:
            offset = matching(source, offset, stop)
        elif char == '"':
            offset = text.find('"', offset + 1, stop)
            if offset < 0:
                raise source.error("a string is not closed", start)
        elif char == ",":
            spans.append((begin, offset))
            begin = offset + 1
        offset += 1
    if spans or text[start:stop].strip():
        spans.append((begin, stop))
    return spans


def beyond(source: Source, start: int, stop: int) -> int:
    """Return where a value that is not looked into ends: at a comma or a closing bracket that is not its own."""
    text, offset = source.text, start
    while offset < stop and text[offset] not in ",)]}":
        if text[offset] in _PAIRS:
            offset = matching(source, offset, stop)
        elif text[offset] == '"':
            offset = text.find('"', offset + 1, stop)
            if offset < 0:
                return stop
        offset += 1
    return offset


def skip_blanks(text: str, start: int, stop: int) -> int:
    """Return the offset of what is no blank, `stop` if there is nothing."""
    while start < stop and text[start] in " \t":
        start += 1
    return start
