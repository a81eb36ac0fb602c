"""Text from users and hosts made safe for robot programs: it never becomes a statement.

Writers of programs use these functions, and the posts of CAM hosts too: `install_post` copies this file next to them.
So it needs only the standard library of Python 3.8.
"""

from __future__ import annotations

import re

MAX_COMMENT = 400
"""Characters of a comment; controllers write lines of up to 989 characters."""
LONGEST_STRING = 80
"""Characters of a string: the limit of a message on the controller's panel."""

# line ends of any editor, C0 and C1 control characters except the tab, and characters that reverse or hide text
_CONTROL = re.compile("[\x00-\x08\x0a-\x1f\x7f-\x9f\u2028\u2029\u200b-\u200f\u202a-\u202e\u2060-\u2069\ufeff]+")
_IN_STRING = str.maketrans({'"': "'", "{": "(", "}": ")", "\t": " "})


def one_line(text: str, max_length: int = MAX_COMMENT) -> str:
    """Return a text as one line: control characters become blanks, and the rest is cut off."""
    line = _CONTROL.sub(" ", text).strip()
    return line if len(line) <= max_length else line[: max_length - 1] + "…"


def string_content(text: str) -> str:
    """Return a text for a string in double quotes: one line without double quotes and braces."""
    return one_line(text.translate(_IN_STRING), LONGEST_STRING).replace("…", "...")[:LONGEST_STRING]
