"""The frame of a page: one self-contained file, with its styles, scripts and numbers."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from msgspec import Struct
from numpy.typing import NDArray

from postproc.frames import Array
from postproc.report.kit.parts import Note, Part, Section, safe_json

_TYPES = {"f": "<f4", "i": "<i4", "b": "|u1"}


class ColumnDescription(Struct, frozen=True):
    """A column in the bytes: its name, type and number of values (1 = the same everywhere)."""

    name: str
    type: str
    count: int


class Columns(Struct, frozen=True):
    """Columns of one length.

    :param length: of each.
    :param descriptions: the columns in the order of their bytes.
    :param text: their bytes, base64.
    """

    length: int
    descriptions: tuple[ColumnDescription, ...]
    text: str

    @classmethod
    def of(cls, columns: Mapping[str, Array | NDArray[np.int64] | NDArray[np.bool_]]) -> Columns:
        """Pack columns (n,): numbers in single precision, whole ones in 32 bits, booleans in a byte.

        A column that is the same everywhere is held as one number.
        """
        buffers, descriptions = [], []
        for name, values in sorted(columns.items(), key=lambda entry: entry[1].dtype.kind == "b"):
            exact = np.asarray(values).astype(_TYPES[values.dtype.kind])
            if len(exact) and (exact == exact[0]).all():
                exact = exact[:1]
            buffers.append(exact.tobytes())
            descriptions.append(ColumnDescription(name, exact.dtype.str[1:], len(exact)))
        length = max((len(values) for values in columns.values()), default=0)
        return cls(length, tuple(descriptions), base64.b64encode(b"".join(buffers)).decode())


@cache
def template() -> Template:
    """Return the template of all pages."""
    environment = Environment(
        autoescape=True,
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html")


_SCRIPTS_OF_PAGE = ("selection", "tables", "side")
_DRAWING = ("packed", "columns", "theme", "stage", "cursor", "camera", "over", "sketch", "space", "plots")
_LIBRARY = b"<!-- library -->"
_COLUMNS = b"<!-- columns -->"
_TEXT = b"<!-- text -->"


class Page(Struct, frozen=True):
    """A page.

    :param kind: such as "Deviation report".
    :param title: name of the program or model.
    :param subtitle: a line below the title.
    :param sections: in order.
    :param footer: sentences at the end.
    :param facts: data of the scripts in addition to the columns: a structure that msgspec can encode.
    :param columns: numbers that views show, by name.
    :param scripts: package and names of further scripts, in the order in which they need each other.
    :param record: a line of the head: for whom, when and with what it was made; empty: none.
    :param texts: long texts that scripts show, by name.
    """

    kind: str
    title: str
    subtitle: str
    sections: tuple[Section, ...]
    footer: tuple[Note, ...] = ()
    facts: object = None
    columns: Mapping[str, Columns] = {}
    scripts: tuple[tuple[str, str], ...] = ()
    record: str = ""
    texts: Mapping[str, str] = {}

    drawn_kinds: ClassVar[frozenset[str]] = frozenset({"plot", "view"})

    def render(self) -> Iterator[bytes]:
        """Yield the page as HTML in UTF-8; the library that draws plots is left out if there are none."""
        plots = any(_has_part(section.parts, self.drawn_kinds) for section in self.sections)
        script_names = (*_SCRIPTS_OF_PAGE, *(_DRAWING if plots else ()))
        names = [*(("postproc.report.kit", name) for name in script_names), *(self.scripts if plots else ())]
        text = (
            template()
            .render(
                page=self,
                plots=plots,
                style=_file_text("postproc.report.kit", "templates/style.css"),
                scripts=[_file_text(package, f"scripts/{name}.js") for package, name in names],
                page_facts=safe_json(self.facts),
                columns={name: safe_json(columns.descriptions) for name, columns in self.columns.items()},
            )
            .encode(errors="replace")
        )
        for columns in self.columns.values():
            head, _, text = text.partition(_COLUMNS)
            yield from (head, columns.text.encode())
        for content in self.texts.values():
            head, _, text = text.partition(_TEXT)
            yield from (head, deflate(content.encode(errors="replace")))
        head, library_mark, remaining_text = text.partition(_LIBRARY)
        yield head
        if library_mark:
            yield library()
        yield remaining_text


_LEVEL = 1
"""Level of compression: pages are 11 % larger than by level 4, but each process that writes one takes 0.05 s less."""


@cache
def library() -> bytes:
    """Return the script of plotly, deflated, in base64; `scripts/packed.js` unpacks it.

    It is taken from the installed package; its Python side, which is large, is not imported.
    """
    script = (_package_folder("plotly") / "package_data" / "plotly.min.js").read_bytes()
    return deflate(script)


def deflate(content: bytes) -> bytes:
    """Return content as `scripts/packed.js` unpacks it: deflated, in base64."""
    return base64.b64encode(zlib.compress(content, _LEVEL))


@cache
def _package_folder(package: str) -> Path:
    """Return the folder of an installed package, without importing it.

    :raises ModuleNotFoundError: it is not installed.
    """
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"{package} is not installed: pip install {package}")
    return Path(spec.origin).parent


def _has_part(parts: tuple[Part, ...], templates: frozenset[str]) -> bool:
    """Return whether one of the parts, or of the parts inside them, is shown by one of the templates."""
    return any(part.template in templates or _has_part(getattr(part, "parts", ()), templates) for part in parts)


@cache
def _file_text(package: str, name: str) -> str:
    """Return the text of a file of an installed package, `name` relative to its folder."""
    return (_package_folder(package) / name).read_text(encoding="utf-8")
