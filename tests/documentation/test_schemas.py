"""The schemas that are shipped: those of the readers, and they accept and refuse what the readers do."""

from __future__ import annotations

import json
import tomllib

import pytest

from postproc.jobs.first_steps import SCHEMAS, schema_file
from tests.commands import printed
from tests.documentation import schemas
from tests.documentation.pages import block
from tests.places import ROOT


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_schema_is_that_of_the_reader_and_the_reference(name):
    advice = "run python -m tests.documentation.schemas"
    assert schema_file(name).read_text(encoding="utf-8") == schemas.written(name), advice
    assert set(SCHEMAS) == set(schemas.STRUCTURES)


def keys(content, table, at):
    """Yield tables and keys of data that a schema does not know, by its $defs; a small validator of names."""
    table = table if "$ref" not in table else content["$defs"][table["$ref"].rsplit("/", 1)[1]]
    for name, value in at.items():
        known = table.get("properties", {}).get(name, table.get("additionalProperties"))
        if not known:
            yield name
            continue
        for choice in known.get("anyOf", [known]):
            if isinstance(value, dict) and ("$ref" in choice or choice.get("type") == "object"):
                yield from keys(content, choice, value)


@pytest.mark.parametrize("name", SCHEMAS)
def test_the_example_of_the_reference_has_no_key_that_the_schema_does_not_know(name):
    content = json.loads(schema_file(name).read_text(encoding="utf-8"))
    data = tomllib.loads(block(f"{name}.toml", "toml"))
    assert list(keys(content, content, data)) == []
    assert list(keys(content, content, {**data, "wrong": 1})) == ["wrong"]


def test_numbers_have_units_and_ranges_and_keys_descriptions():
    tables = json.loads(schema_file("cell").read_text(encoding="utf-8"))["$defs"]
    largest = tables["Output"]["properties"]["max_correction_mm"]
    assert largest["description"] == "a larger correction is an error [mm]"
    assert largest["exclusiveMinimum"] == 0
    for table in tables.values():
        for key, described in table["properties"].items():
            assert described.get("type") != "number" or "description" in described or "$ref" in described, key


def test_the_command_prints_it_and_init_names_it(tmp_path):
    assert json.loads(printed("schema", "process"))["title"] == "process.toml of postproc"
    cell = tmp_path / "cell.toml"
    printed("init", cell, "--robot", "kuka_kr270", "--base", "1500,-200,700", "--tool", "0,0,350")
    assert cell.read_text().splitlines()[0] == f"#:schema {schema_file('cell').as_uri()}"
    assert schema_file("cell").is_relative_to(ROOT)
