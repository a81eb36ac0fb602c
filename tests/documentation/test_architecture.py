"""docs/architecture.md against the code: its layers are the enforced ones, its names exist."""

from __future__ import annotations

import importlib
import re
import tomllib

import pytest

from tests.places import ROOT

TEXT = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
TOP = sorted(
    {path.stem for path in (ROOT / "postproc").iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
)
NAMES = sorted({name for name in re.findall(r"`([a-z_]+(?:\.\w+)+)`", TEXT) if name.split(".")[0] in TOP})


def found(name: str) -> bool:
    """Whether a dotted name below `postproc` is a module, or something in one."""
    module, rest = "postproc", name.split(".")
    while rest:
        try:
            importlib.import_module(f"{module}.{rest[0]}")
        except ModuleNotFoundError:
            break
        module = f"{module}.{rest.pop(0)}"
    thing = importlib.import_module(module)
    for part in rest:
        if not hasattr(thing, part):
            return False
        thing = getattr(thing, part)
    return True


@pytest.mark.parametrize("name", [name for name in NAMES if not name.endswith((".toml", ".py", ".json", ".urdf"))])
def test_name_exists(name):
    assert found(name)


def test_a_name_that_is_gone_would_be_noticed():
    assert found("forces.assign")
    assert not found("forces.no_such_function")
    assert not found("forces.no_such_module.function")


def test_layers_are_those_that_are_enforced():
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    (layers,) = (c["layers"] for c in config["contracts"] if c["containers"] == ["postproc"])
    rows = re.findall(r"^\| ((?:\(?`\w+`\)? ?)+) \|", TEXT, re.M)
    assert [set(re.findall(r"\w+", row)) for row in rows] == [set(re.findall(r"\w+", layer)) for layer in layers]


def test_every_module_has_its_layer():
    rows = re.findall(r"^\| ((?:\(?`\w+`\)? ?)+) \|", TEXT, re.M)
    assert {name for row in rows for name in re.findall(r"\w+", row)} == set(TOP) - {"__init__"}
