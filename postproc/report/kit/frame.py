"""The frame of a page: one file that loads nothing, with its styles, scripts and numbers in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar

from msgspec import Struct

from postproc.report.kit.columns import Columns
from postproc.report.kit.parts import Note, Part, Section
from postproc.report.kit.plots import encoded

_ALWAYS = ("selection", "tables")
_DRAWING = ("columns", "theme", "stage", "cursor", "camera", "over", "sketch", "space", "plots")
_LIBRARY = b"<!-- library -->"
_COLUMNS = b"<!-- columns -->"
_PIECE = 65_536
"""Bytes of the library that are read at once: memory for all of it would take longer than to read it."""


class Page(Struct, frozen=True):
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
    columns: Mapping[str, Columns] = {}
    scripts: tuple[tuple[str, str], ...] = ()

    drawn: ClassVar[frozenset[str]] = frozenset({"plot", "view"})

    def render(self) -> Iterator[bytes]:
        """Yield the page as HTML in UTF-8; what needs no plot is without the library that draws them."""
        from postproc.report.kit.templating import template  # with jinja2, where a page is made

        plots = any(_holds(section.parts, self.drawn) for section in self.sections)
        shared = (*_ALWAYS, *(_DRAWING if plots else ()))
        names = [*(("postproc.report.kit", name) for name in shared), *(self.scripts if plots else ())]
        text = (
            template()
            .render(
                page=self,
                plots=plots,
                style=_text("postproc.report.kit", "templates/style.css"),
                scripts=[_text(package, f"scripts/{name}.js") for package, name in names],
                told=encoded(self.facts),
                columns={name: encoded(columns.described) for name, columns in self.columns.items()},
            )
            .encode(errors="replace")
        )
        for columns in self.columns.values():
            before, _, text = text.partition(_COLUMNS)
            yield from (before, columns.text.encode())
        before, drawn, rest = text.partition(_LIBRARY)
        yield before
        if drawn:
            yield from library()
        yield rest


def library() -> Iterator[bytes]:
    """Yield the script of plotly from the installed package; its Python side, which is large, is not imported."""
    with (_folder("plotly") / "package_data" / "plotly.min.js").open("rb") as file:
        while piece := file.read(_PIECE):
            yield piece


@cache
def _folder(package: str) -> Path:
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"{package} is not installed: pip install {package}")
    return Path(spec.origin).parent


def _holds(parts: tuple[Part, ...], templates: frozenset[str]) -> bool:
    return any(part.template in templates or _holds(getattr(part, "parts", ()), templates) for part in parts)


@cache
def _text(package: str, name: str) -> str:
    return (_folder(package) / name).read_text(encoding="utf-8")
