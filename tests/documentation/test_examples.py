"""The examples in docstrings are run."""

from __future__ import annotations

import doctest
import importlib
import pkgutil

import pytest

import postproc
from tests.places import ROOT

MODULES = ["postproc", *(module.name for module in pkgutil.walk_packages(postproc.__path__, "postproc."))]
WITH_EXAMPLES = [
    name
    for name in MODULES
    if any(test.examples for test in doctest.DocTestFinder(recurse=True).find(importlib.import_module(name)))
]


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_of_a_module_print_what_they_say(name, monkeypatch):
    monkeypatch.chdir(ROOT)
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert result.failed == 0


def test_there_are_examples():
    assert {"postproc", "postproc.frames", "postproc.compensator"} <= set(WITH_EXAMPLES)
