"""JSON Schemas of the TOML files: the structures of the readers, with the comments of the reference as descriptions.

`python -m tests.documentation.schemas` writes them into postproc/schemas, from where `postproc schema` prints them.
"""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path

import msgspec

from postproc.cell import CellFile
from postproc.identification.readings import Experiment
from postproc.machining.process import ProcessFile
from postproc.robot import ModelFile
from tests.documentation import schema
from tests.documentation.pages import block
from tests.places import ROOT

FOLDER = ROOT / "postproc" / "schemas"
STRUCTURES = {"cell": CellFile, "process": ProcessFile, "model": ModelFile, "experiment": Experiment}
_COMMENT = re.compile(r"(\w+) = .*?#\s*(?:\[[^\]]*\]\s*)?(.*)$")
_UNITS = {
    "mm": "mm", "deg": "deg", "kg": "kg", "kW": "kW", "percent": "%", "rpm": "1/min", "MB": "MB",
    "urad_per_Nm": "µrad/(N·m)", "um_per_N": "µm/N", "N_per_mm2": "N/mm²", "N_per_mm": "N/mm", "m_per_s": "m/s",
    "mm_per_min": "mm/min", "N": "N", "N_per_m": "N/m", "Nm_per_rad": "N·m/rad",
}  # fmt: skip
"""Units by the end of a key."""


def written(name: str) -> str:
    """Return the schema of a file as it is shipped."""
    content = msgspec.json.schema(STRUCTURES[name])
    comments = _comments(STRUCTURES[name], block(f"{name}.toml", "toml"))
    classes = {cls.__name__: cls for cls, _ in schema.keys(STRUCTURES[name])} | _classes(STRUCTURES[name])
    for title, table in content["$defs"].items():
        if "description" in table:  # msgspec before 0.23 keeps the indentation of docstrings
            table["description"] = inspect.cleandoc(table["description"])
        for key, described in table.get("properties", {}).items():
            owner = schema.owner_of(classes[title], key) if title in classes else None
            text = comments.get((owner, key)) or described.get("description", "")
            text = "" if text in ("mm", "degrees", *_UNITS.values()) else text.removeprefix(", ")
            if unit := _unit(key, described):
                text = f"{text} [{unit}]".strip()
            if text:
                described["description"] = text
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"{name}.toml of postproc"}
    return json.dumps({**head, **content}, ensure_ascii=False, indent=1) + "\n"


def _classes(structure: type) -> dict[str, type]:
    """Return all structures within a structure by name."""
    found, todo = {}, [msgspec.inspect.type_info(structure)]
    while todo:
        kind = todo.pop()
        if isinstance(kind, msgspec.inspect.StructType) and kind.cls.__name__ not in found:
            found[kind.cls.__name__] = kind.cls
            todo += [field.type for field in kind.fields]
        todo += getattr(kind, "types", ())
        todo += [inner for name in ("item_type", "value_type", "type") if (inner := getattr(kind, name, None))]
        todo += getattr(kind, "item_types", ())
    return found


def _comments(structure: type, example: str) -> dict[tuple[type, str], str]:
    """Return what the example of the reference says of each key, by the structure that declares it."""
    texts, table = {}, []
    for line in example.splitlines():
        if header := re.match(r"\[\[?([\w.\-]+)\]\]?(?:\s*#\s*(.*))?", line):
            table = header[1].split(".")
            *_, last = schema._way(structure, table)
            if header[2]:
                texts.setdefault(last, header[2])
        elif (key := re.match(r"(\w+) = ", line)) and (comment := _COMMENT.match(line)):
            *_, last = schema._way(structure, [*table, key[1]])
            texts.setdefault(last, comment[2])
    return texts


def _unit(key: str, described: dict) -> str | None:
    if described.get("type") == "number" and key in "XYZABC":
        return "mm" if key in "XYZ" else "deg"
    ends = [end for end in _UNITS if key == end or key.endswith(f"_{end}")]
    return _UNITS[max(ends, key=len)] if ends else None


def main() -> None:
    for name in STRUCTURES:
        Path(FOLDER / f"{name}.schema.json").write_text(written(name), encoding="utf-8")


if __name__ == "__main__":
    main()
