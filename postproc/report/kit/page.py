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
"""Types of the packed numbers by `numpy.dtype.kind`: floats, whole numbers, booleans."""


class ColumnDescription(Struct, frozen=True):
    """A column in the packed bytes: its name, its numpy type, and its number of values.

    1 if all rows have one value.
    """

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
        """Pack columns (n,): floats in single precision, whole numbers in 32 bits, booleans in a byte.

        A column of equal values is packed as one value.
        """
        buffers, descriptions = [], []
        # booleans last: a reader needs numbers of four bytes at multiples of four
        for name, values in sorted(columns.items(), key=lambda entry: entry[1].dtype.kind == "b"):
            packed = np.asarray(values).astype(_TYPES[values.dtype.kind])
            if len(packed) and (packed == packed[0]).all():
                packed = packed[:1]
            buffers.append(packed.tobytes())
            # without the byte order, which is the first character of dtype.str
            descriptions.append(ColumnDescription(name, packed.dtype.str[1:], len(packed)))
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


_PAGE_SCRIPTS = ("selection", "tables", "side")
"""Scripts of every page."""
_PLOT_SCRIPTS = ("packed", "columns", "theme", "stage", "cursor", "camera", "over", "sketch", "space", "plots")
_LIBRARY_MARK, _COLUMNS_MARK, _TEXT_MARK = b"<!-- library -->", b"<!-- columns -->", b"<!-- text -->"
"""Where the template has the plot library, the bytes of a table of columns, and a long text."""


class Page(Struct, frozen=True):
    """A page.

    :param kind: heading of the page, such as "Deviation report".
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
        """Yield the page as HTML in UTF-8, in pieces.

        A page without plots and views contains neither the plot library nor the scripts that need it.

        Large contents are put into the rendered template here, at their marks, so that the template need not copy them.
        """
        has_plots = any(_has_part(section.parts, self.drawn_kinds) for section in self.sections)
        script_names = (*_PAGE_SCRIPTS, *(_PLOT_SCRIPTS if has_plots else ()))
        names = [*(("postproc.report.kit", name) for name in script_names), *(self.scripts if has_plots else ())]
        text = (
            template()
            .render(
                page=self,
                plots=has_plots,
                style=_file_text("postproc.report.kit", "templates/style.css"),
                scripts=[_file_text(package, f"scripts/{name}.js") for package, name in names],
                page_facts=safe_json(self.facts),
                columns={name: safe_json(columns.descriptions) for name, columns in self.columns.items()},
            )
            .encode(errors="replace")
        )
        for columns in self.columns.values():
            head, _, text = text.partition(_COLUMNS_MARK)
            yield from (head, columns.text.encode())
        for content in self.texts.values():
            head, _, text = text.partition(_TEXT_MARK)
            yield from (head, deflate(content.encode(errors="replace")))
        head, library_mark, remaining_text = text.partition(_LIBRARY_MARK)
        yield head
        if library_mark:
            yield library()
        yield remaining_text


_COMPRESSION_LEVEL = 1
"""Level of compression: pages are 11 % larger than by level 4, but each process that writes one takes 0.05 s less."""


@cache
def library() -> bytes:
    """Return the script of plotly, deflated, in base64; `scripts/packed.js` unpacks it.

    The script is read from the installed package, without importing the Python part of plotly, which is large.
    """
    script = (_package_folder("plotly") / "package_data" / "plotly.min.js").read_bytes()
    return deflate(script)


def deflate(content: bytes) -> bytes:
    """Return the content deflated, in base64, as `scripts/packed.js` unpacks it."""
    return base64.b64encode(zlib.compress(content, _COMPRESSION_LEVEL))


@cache
def _package_folder(package: str) -> Path:
    """Return the folder of an installed package, without importing it.

    :raises ModuleNotFoundError: the package is not installed.
    """
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"{package} is not installed: pip install {package}")
    return Path(spec.origin).parent


def _has_part(parts: tuple[Part, ...], templates: frozenset[str]) -> bool:
    """Return whether one of the templates shows one of the parts, or a part nested in them, as in `Fold`."""
    return any(part.template in templates or _has_part(getattr(part, "parts", ()), templates) for part in parts)


@cache
def _file_text(package: str, name: str) -> str:
    """Return the text of a file of an installed package.

    :param name: path of the file, relative to the folder of the package.
    """
    return (_package_folder(package) / name).read_text(encoding="utf-8")
