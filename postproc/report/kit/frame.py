"""The frame of a page: one file that loads nothing, with its styles, scripts and numbers in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from postproc.report.kit.appearance import sections
from postproc.report.kit.columns import Columns
from postproc.report.kit.html import Html, element
from postproc.report.kit.parts import Note, Part, Section, View
from postproc.report.kit.plots import Plot, encoded

_ALWAYS, _DRAWING = ("selection", "tables"), ("columns", "theme", "stage", "plots")
_POLICY = "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; img-src data: blob:"
"""A page loads nothing."""


@dataclass(frozen=True, slots=True)
class Page:
    """A page.

    :param kind: what kind of page it is.
    :param title: what it is about.
    :param subtitle: a line below the title.
    :param sections: in order.
    :param footer: sentences at the end.
    :param facts: what scripts need to know beside the columns: a structure that msgspec can encode.
    :param columns: numbers that views show, by name.
    :param scripts: package and names of further scripts, in the order in which they need each other.
    """

    kind: str
    title: str
    subtitle: str
    sections: tuple[Section, ...]
    footer: tuple[Note, ...] = ()
    facts: object = None
    columns: Mapping[str, Columns] = field(default_factory=dict)
    scripts: tuple[tuple[str, str], ...] = ()

    def render(self) -> Iterator[bytes]:
        """Yield the page as HTML in UTF-8; what needs no plot is without the library that draws them."""
        plots = any(_drawn(section.parts) for section in self.sections)
        shared = (*_ALWAYS, *(_DRAWING if plots else ()))
        names = [*(("postproc.report.kit", name) for name in shared), *(self.scripts if plots else ())]
        yield _encoded(Html("<!DOCTYPE html>\n"), Html('<html lang="en">\n'), self._head(), Html("\n<body>\n"))
        yield _encoded(*self._body())
        if plots:
            yield from (b"<script>", library(), b"</script>\n")
        for name, columns in self.columns.items():
            told = Html(encoded(columns.described))
            yield _encoded(element("script", told, type="application/json", class_="columns", data_name=name))
            yield from (b'<script type="application/octet-stream">', columns.text.encode(), b"</script>\n")
        yield _encoded(element("script", Html(encoded(self.facts)), type="application/json", id="page-facts"))
        for package, name in names:
            yield _encoded(element("script", Html(f"\n{_text(package, f'scripts/{name}.js')}\n")))
        yield b"</body>\n</html>\n"

    def _head(self) -> Html:
        return element(
            "head",
            element("meta", charset="utf-8"),
            element("meta", http_equiv="Content-Security-Policy", content=_POLICY),
            element("meta", name="viewport", content="width=device-width, initial-scale=1"),
            element("meta", name="color-scheme", content="light dark"),
            element("title", f"{self.title}: {self.kind.lower()}"),
            element("style", Html(_text("postproc.report.kit", "style.css"))),
        )

    def _body(self) -> Iterator[Html]:
        side = [section for section in self.sections if section.width == "side"]
        others = [section for section in self.sections if section.width != "side"]
        links = (element("a", section.title, href=f"#{section.id}") for section in others)
        yield element("a", "To the content", class_="skip", href="#main")
        yield element(
            "header",
            element("p", self.kind, class_="kind"),
            element("h1", self.title),
            element("p", self.subtitle),
            element("nav", *links, aria_label="Sections"),
        )
        yield element(
            "div",
            element("main", sections(others), id="main"),
            element("aside", sections(side)) if side else "",
            class_="page with-side" if side else "page",
        )
        yield element("footer", *(element("p", note.text) for note in self.footer))


def library() -> bytes:
    """Return the script of plotly from the installed package; its Python side, which is large, is not imported."""
    spec = find_spec("plotly")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("plotly is not installed: pip install plotly")
    return (Path(spec.origin).parent / "package_data" / "plotly.min.js").read_bytes()


def _drawn(parts: tuple[Part, ...]) -> bool:
    """Whether some of the parts, or of those in them, are drawn by a script."""
    return any(isinstance(part, Plot | View) or _drawn(getattr(part, "parts", ())) for part in parts)


def _encoded(*html: Html) -> bytes:
    return "".join(html).encode(errors="replace")


@cache
def _text(package: str, name: str) -> str:
    return (files(package) / name).read_text(encoding="utf-8")
