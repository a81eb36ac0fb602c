"""The stages of the budget of `convert` are places in the package as it is today."""

from tests.benchmarks.budget import STAGES
from tests.places import ROOT


def test_every_stage_is_a_place_in_the_package():
    paths = [f"/{path.relative_to(ROOT)}" for path in (ROOT / "postproc").rglob("*.py")]
    absent = [part for part in STAGES if part != "importlib" and not any(part in path for path in paths)]
    assert absent == []
