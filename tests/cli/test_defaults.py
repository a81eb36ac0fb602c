"""A job that is run from Python does what its command does without options."""

from __future__ import annotations

import msgspec
import pytest

from postproc.cli import main
from postproc.jobs.comparison_files import CompareRequest
from postproc.jobs.first_steps import CellRequest
from postproc.jobs.identification_files import ElastostaticsRequest
from postproc.jobs.place_files import PlaceRequest
from postproc.jobs.plan_files import CompensatorRequest, PlanRequest
from postproc.jobs.process_forces import ForcesRequest
from postproc.jobs.runs import Settings
from postproc.plan import Options
from postproc.plan.compensator import CompensatorOptions

COUNTS = {
    CellRequest: 2, CompareRequest: 2, CompensatorOptions: 3, CompensatorRequest: 5, ElastostaticsRequest: 4,
    ForcesRequest: 2, Options: 5, PlaceRequest: 2, PlanRequest: 8, Settings: 3,
}  # fmt: skip
"""Fields at least, of each struct, that an option sets."""


@pytest.mark.parametrize(
    ("words", "struct"),
    [
        ("compare", CompareRequest), ("convert", Settings), ("forces", ForcesRequest),
        ("identify elastostatics", ElastostaticsRequest), ("init", CellRequest), ("place", PlaceRequest),
        ("plan compensator", CompensatorOptions), ("plan compensator", CompensatorRequest), ("plan poses", Options),
        ("plan poses", PlanRequest),
    ],
)  # fmt: skip
def test_defaults_of_a_job_are_those_of_its_command(words, struct):
    command = main
    for word in words.split():
        command = command.get_command(None, word)
    options = {
        option.name.removeprefix("q2_") if struct is Options else option.name: option for option in command.params
    }
    compared = 0
    for field in msgspec.structs.fields(struct):
        option = options.get(field.name)
        if option is None or field.required:
            continue
        if option.is_flag:
            expected = False
        elif isinstance(option.default, (int, float, str)):
            expected = option.default
        elif words != "init":  # it sets only those that are given
            expected = None
        else:
            continue
        if (struct, field.name) == (CompensatorOptions, "margin"):
            expected *= 0.017453292519943295  # [rad]
        assert field.default == expected, field.name
        compared += 1
    assert compared >= COUNTS[struct]
