"""A KRL program under another name: file, DEF and DEFDAT."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath

from postproc.program import Document

_HEAD = re.compile(r"((?:\A|(?<=[\r\n]))[ \t]*(?:GLOBAL[ \t]+)?(?:DEF|DEFDAT)[ \t]+)[A-Za-z_$][\w$]*", re.IGNORECASE)


def renamed(documents: Sequence[Document], name: str) -> tuple[Document, ...]:
    """Return the files of a program with another name; all else stays to the byte.

    :param documents: the `.src`, whose first DEF is the program, and its `.dat`.
    :param name: one that the controller accepts.
    """
    return tuple(
        replace(
            document,
            name=f"{name}{PurePath(document.name).suffix}",
            text=_HEAD.sub(lambda match: match[1] + name, document.text, count=1),
        )
        for document in documents
    )
