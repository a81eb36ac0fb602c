"""The documentation as data: code blocks, commands, and the keys and columns that the reference describes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

from tests.places import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCS = ROOT / "docs"
COMMANDS = DOCS / "reference" / "commands.md"
REFERENCE = {
    path.name: path.read_text(encoding="utf-8")
    for path in sorted((DOCS / "reference").glob("*.md"))
    if path != COMMANDS
}
"""The pages that describe files, keys and columns, by name of their file."""
FORMATS = "\n".join(REFERENCE.values())
FOLLOWED = [
    ROOT / "README.md",
    *(DOCS / "tutorials" / f"{name}.md" for name in ("first-day", "forces", "no-forces", "krl", "robot", "testpart")),
    *sorted((DOCS / "guide").glob("*.md")),
    *sorted((DOCS / "cam").glob("*.md")),
]
"""The pages whose commands are run, in the order in which they are run."""
PLANNING = DOCS / "guide" / "planning.md"
PYTHON = DOCS / "guide" / "python.md"
MARKDOWN = [*sorted(ROOT.glob("*.md")), *sorted(DOCS.rglob("*.md"))]


def section(title: str) -> str:
    """Return the text below a heading of the reference, up to the next heading."""
    (found,) = re.findall(rf"^#+ {re.escape(title)}\n(.*?)(?=^#+ |\Z)", _without_blocks(FORMATS), re.M | re.S)
    return _blocks_back(found)


def block(title: str, language: str) -> str:
    """Return the first code block of a section of the reference."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", section(title), re.M | re.S)
    return found


def described(title: str) -> list[str]:
    """Return what the first column of the table of a section names, in order."""
    rows = re.findall(r"^\| (`[^|]*) \|", section(title), re.M)
    return [name for row in rows for name in re.findall(r"`([^`]+)`", row)]


def consoles() -> list[tuple[str, list[str], str]]:
    """Return page, arguments and shown output of each command that a page shows with its output, in reading order."""
    return [
        (path.relative_to(ROOT).as_posix(), shlex.split(command), shown)
        for path in FOLLOWED
        for command, shown in re.findall(
            r"^```console\n\$ postproc ([^\n]*)\n(.*?)^```$", path.read_text(encoding="utf-8"), re.M | re.S
        )
    ]


def commands(text: str) -> list[list[str]]:
    """Return the arguments of each `postproc …` that a text shows as a line of its own; `\\` continues a line."""
    joined = re.sub(r"\\\n\s*", " ", text)
    found = re.findall(r"^(?:\$ |.*&& |\s*)postproc ([a-z].*)$", joined, re.M)
    return [shlex.split(line) for line in found]


def code(path: Path, language: str) -> list[str]:
    """Return the code blocks of one language in a page."""
    return re.findall(rf"^```{language}\n(.*?)^```$", path.read_text(encoding="utf-8"), re.M | re.S)


def _without_blocks(text: str) -> str:
    """Hide `#` at the beginning of lines in code blocks: they are comments, not headings."""
    return re.sub(r"^```.*?^```$", lambda m: m[0].replace("\n#", "\n\0"), text, flags=re.M | re.S)


def _blocks_back(text: str) -> str:
    return text.replace("\n\0", "\n#")
