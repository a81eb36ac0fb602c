"""Metadata and packaging files agree with each other and with the code."""

from __future__ import annotations

import re
import tomllib

from postproc.version import VERSION
from tests.places import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_the_citation_names_this_version_and_licence():
    text = (ROOT / ".github" / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.*)$", text, re.M)[1] == VERSION
    assert re.search(r"^license: (.*)$", text, re.M)[1] == PROJECT["license"]


def test_the_versions_of_python_that_are_promised_are_tested():
    promised = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    matrix = re.search(r"python: \[(.*)\]", (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))[1]
    assert promised == re.findall(r"3\.\d+", matrix)
    assert PROJECT["requires-python"] == f">={promised[0]}"


def test_the_conda_environment_has_the_bounds_of_the_project():
    text = (ROOT / ".packaging" / "conda" / "environment.yml").read_text(encoding="utf-8")
    least = dict(re.findall(r"- ([a-z]+) >=([\d.]+)", text))
    bounds = dict(re.findall(r"([a-z]+)>=([\d.]+)", "\n".join(PROJECT["dependencies"])))
    assert least.pop("python") == PROJECT["requires-python"].removeprefix(">=")
    assert least.pop("pinocchio") == bounds["pin"]
    assert least == {name: bounds[name] for name in least}
    assert least


def test_the_image_installs_from_this_repository():
    text = (ROOT / ".packaging" / "Dockerfile").read_text(encoding="utf-8")
    assert "COPY . /source" in text
    assert 'ENTRYPOINT ["postproc"]' in text
