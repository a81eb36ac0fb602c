"""What the pages for users say: their code blocks, and the keys and columns that they describe."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
FORMATS = (ROOT / "FORMATS.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    """Return what stands below a heading of FORMATS.md up to the next one."""
    (found,) = re.findall(rf"^#+ {re.escape(title)}\n(.*?)(?=^#+ |\Z)", _without_blocks(FORMATS), re.M | re.S)
    return _blocks_back(found)


def block(title: str, language: str) -> str:
    """Return the first code block of a section of FORMATS.md."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", section(title), re.M | re.S)
    return found


def described(title: str) -> list[str]:
    """Return what the first column of the table of a section names, in order."""
    rows = re.findall(r"^\| (`[^|]*) \|", section(title), re.M)
    return [name for row in rows for name in re.findall(r"`([^`]+)`", row)]


def consoles() -> list[tuple[list[str], str]]:
    """Return the arguments of each command that the README shows with its output, and that output."""
    found = re.findall(r"^```console\n\$ postproc ([^\n]*)\n(.*?)^```$", README, re.M | re.S)
    return [(shlex.split(command), shown) for command, shown in found]


def commands(text: str) -> list[list[str]]:
    """Return the arguments of each `postproc …` that a text shows as a line of its own; `\\` continues a line."""
    joined = re.sub(r"\\\n\s*", " ", text)
    found = re.findall(r"^(?:\$ |.*&& |\s*)postproc ([a-z].*)$", joined, re.M)
    return [shlex.split(line) for line in found]


def code(language: str) -> list[str]:
    """Return the code blocks of one language in the README."""
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.M | re.S)


def _without_blocks(text: str) -> str:
    """Hide `#` at the beginning of lines in code blocks: they are comments, not headings."""
    return re.sub(r"^```.*?^```$", lambda m: m[0].replace("\n#", "\n\0"), text, flags=re.M | re.S)


def _blocks_back(text: str) -> str:
    return text.replace("\n\0", "\n#")
