"""A page read as any program would read it: its elements, the numbers in it, and whether it loads anything."""

from __future__ import annotations

import base64
import json
import re
from html.parser import HTMLParser

import numpy as np

_VOID = {"meta", "br", "hr", "img", "input", "link"}


class ReadPage(HTMLParser):
    """Every element is closed, nothing is loaded; texts by id of their section, scripts apart."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[tuple[str, dict[str, str | None]]] = []
        self.ids: list[str] = []
        self.plots: list[dict] = []
        self.rows: list[dict[str, str | None]] = []
        self.data: dict[str, str] = {}
        self.tables: dict[str, tuple[str, str]] = {}
        self._text: list[tuple[tuple[str, ...], str]] = []
        self._last = ""
        self.feed(text)
        self.close()
        assert self.open == [], "elements that are not closed"
        assert len(set(self.ids)) == len(self.ids)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        assert not ({"src", "action", "data", "srcset"} & set(given)), f"{tag} loads something"
        assert tag not in ("link", "iframe", "object", "embed", "base")
        assert tag != "a" or re.fullmatch(r"#[\w-]+|[\w%.-]+\.html", given["href"] or ""), "a link to elsewhere"
        if "id" in given:
            self.ids.append(given["id"] or "")
        if "data-source-line" in given or "data-place" in given:
            self.rows.append({**given, "in": self.section})
        if tag not in _VOID:
            self.open.append((tag, given))

    def handle_endtag(self, tag):
        assert self.open.pop()[0] == tag

    def handle_data(self, data):
        tag, given = self.open[-1] if self.open else ("", {})
        if tag != "script":
            if tag != "style":
                self._text.append(((self.section,), data))
            return
        if given.get("id"):
            self.data[str(given["id"])] = data
        if given.get("type") == "application/json" and len(given) == 1:
            self.plots.append(json.loads(data))
        if given.get("class") == "columns":
            self._last = str(given["data-name"])
            self.tables[self._last] = (data, "")
        elif given.get("type") == "application/octet-stream":
            self.tables[self._last] = (self.tables[self._last][0], data)

    @property
    def section(self) -> str:
        return next((str(given["id"]) for tag, given in self.open if tag == "section"), "")

    def text(self, section: str | None = None) -> str:
        """All text, or that of a section, with single spaces."""
        parts = [text for (where,), text in self._text if section is None or where == section]
        return re.sub(r"\s+", " ", " ".join(parts)).strip()

    @property
    def facts(self) -> dict:
        return json.loads(self.data["page-facts"])

    def columns(self, name: str = "places") -> dict[str, np.ndarray]:
        """The columns of a table of the page."""
        described, packed = self.tables[name]
        content = base64.b64decode(packed)
        out, at = {}, 0
        entries = json.loads(described)
        length = max(entry["count"] for entry in entries)
        for entry in entries:
            kind = np.dtype(entry["type"])
            values = np.frombuffer(content, kind, entry["count"], at)
            at += values.nbytes
            out[entry["name"]] = np.repeat(values, length) if len(values) == 1 else values
        assert at == len(content)
        return out


def read_page(content: bytes) -> ReadPage:
    """Read a page; it names no address but those of XML namespaces in the plot library."""
    text = content.decode()
    page = ReadPage(text)
    assert not re.search(r"\b(nan|inf)\b", page.text().lower())
    assert "default-src 'none'" in text
    return page
