"""Sources of forces: made by hand, read by extension, added by other packages."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from msgspec.structs import replace

from postproc import forces, toolpath
from postproc.errors import ForceError, Issue
from postproc.forces import sources
from postproc.forces.sources import BASE, FEED, Knots, LawForces
from postproc.jobs import find_jobs
from tests.programs import program

MOVES = [("PTP", 0, 0, 0), ("LIN", 100, 0, 0), ("LIN", 100, 50, 0)]


@dataclass
class Rising:
    """A source that knows one motion: its force rises along it."""

    knots: Knots
    name: str = "rising"

    def along(self, program, path):
        assert len(path.length) == len(program.motions)
        return self.knots


def rising(**changes):
    values = {
        "motion": np.array([1, 1]),
        "t": np.array([0.0, 1.0]),
        "wrench": np.array([[0.0] * 6, [100.0, 0, 0, 0, 0, 0]]),
        "frame": np.array([BASE, BASE]),
    }
    return Rising(replace(Knots.along(**values), **changes))


def put_on(source, notes=()):
    made = program(MOVES, notes=notes)
    return made, forces.assign(made, toolpath.segments(made, np.eye(4)), source, "+Z", 1e-3)


def test_a_source_wins_over_comments_for_the_motions_it_knows():
    made, load = put_on(rising(), notes=[(1, (7.0, 0, 0, 0, 0, 0))])
    sample = toolpath.at(made, toolpath.segments(made, np.eye(4)), np.array([1, 2]), np.array([0.5, 1.0]))
    np.testing.assert_allclose(load.at(sample)[:, 0], [50, 7])


def test_what_a_source_states_besides_forces_goes_with_them():
    """Its issues, the motions of a cutting law and the stock; a law knows its units, so small forces are right."""
    known = {
        "issues": (Issue("info", "from-source", "words", 2),), "law_forces": LawForces((1.0, 2.0), np.array([1])),
        "stock": object(),
    }  # fmt: skip
    small = np.array([[0.0] * 6, [0.5, 0, 0, 0, 0, 0]])
    _, load = put_on(rising(wrench=small, **known), notes=[(3, (0.4, 0, 0, 0, 0, 0))])
    assert (load.law_forces, load.stock) == (known["law_forces"], known["stock"])
    kinds = [issue.kind for issue in load.issues]
    assert kinds == ["force-sources", "from-source"]
    _, load = put_on(rising(wrench=small), notes=[(3, (0.4, 0, 0, 0, 0, 0))])
    assert [issue.kind for issue in load.issues] == ["force-sources", "force-unit"]
    assert (load.law_forces, load.stock) == (None, None)
    _, load = put_on(None, notes=[(2, (70.0, 0, 0, 0, 0, 0))])
    assert (load.issues, load.law_forces, load.stock) == ((), None, None)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motion": np.array([1, 3])}, "a motion that does not exist"),
        ({"motion": np.array([2, 1])}, "motions out of order"),
        ({"t": np.array([0.5, 0.5])}, "places on one motion out of order"),
        ({"t": np.array([0.5, 1.5])}, "a place outside a motion"),
        ({"t": np.array([0.5, np.nan])}, "a place outside a motion"),
        ({"wrench": np.full((2, 6), np.nan)}, "a force that is not finite"),
        ({"sigma": np.full((2, 6), -1.0)}, "a standard deviation that is not finite, negative"),
        ({"frame": np.array([BASE, FEED])}, "two frames on one motion"),
        ({"frame": np.array([7, 7])}, "an unknown frame"),
        ({"frame": np.array([3, 3])}, "an unknown frame"),
        ({"frame": np.array([-1, -1])}, "an unknown frame"),
        ({"ramped": np.array([True, False])}, "a ramped motion with several knots"),
        ({"ramped": np.array([False, True])}, "a ramped motion with several knots"),
        ({"ramped": np.array([True, True])}, "a ramped motion with several knots"),
        ({"wrench": np.zeros((3, 6))}, "do not have one row per knot"),
    ],
)
def test_what_a_source_must_not_give_is_told_with_its_name_and_line(changes, message):
    with pytest.raises(ForceError, match=f"rising.*{message}|{message}.*rising|rising.*"):
        put_on(rising(**changes))
    with pytest.raises(ForceError, match=message) as caught:
        put_on(rising(**changes))
    if "one row per knot" not in message and "does not exist" not in message:
        assert caught.value.line == (3 if message == "motions out of order" else 2)


def test_deviations_of_knots_are_those_given_or_none():
    motion, wrench, frame, sigma = np.array([1, 2]), np.ones((2, 6)), np.zeros(2, dtype=int), np.full((2, 6), 3.0)
    for made in (
        Knots.throughout(motion, wrench, frame, sigma),
        Knots.along(motion, np.ones(2), wrench, frame, sigma),
    ):
        np.testing.assert_array_equal(made.sigma, sigma)
    for made in (Knots.throughout(motion, wrench, frame), Knots.along(motion, np.ones(2), wrench, frame)):
        np.testing.assert_array_equal(made.sigma, np.zeros((2, 6)))


def added(monkeypatch, **entries):
    found = tuple(EntryPoint(name, value, sources.GROUP) for name, value in entries.items())
    monkeypatch.setattr("importlib.metadata.entry_points", lambda *, group: found if group == sources.GROUP else ())


def test_a_file_is_read_by_the_package_that_names_its_extension(tmp_path, monkeypatch):
    module = type(sys)("made_up_reader")
    module.read = lambda path: rising()
    monkeypatch.setitem(sys.modules, "made_up_reader", module)
    added(monkeypatch, **{".Dyn": "made_up_reader:read", ".other": "no_such_module:read"})
    assert forces.read(tmp_path / "measured.DYN").name == "rising"


def test_a_folder_of_forces_holds_files_of_every_kind_that_is_read(tmp_path, monkeypatch):
    added(monkeypatch, **{".Dyn": "made_up_reader:read"})
    given = tmp_path / "forces"
    given.mkdir()
    for name in ("a.nc", "b.nc", "forces/A.dyn", "forces/b.forces.csv"):
        (tmp_path / name).write_text("")
    programs = [str(tmp_path / name) for name in ("a.nc", "b.nc")]
    assert [job.forces.name for job in find_jobs(programs, forces=given)] == ["A.dyn", "b.forces.csv"]
    for name, message in (
        ("a.csv", r"2 force files for a\.nc: A\.dyn and a\.csv"),
        ("b.csv", r"2 force files for b\.nc: b\.csv and b\.forces\.csv"),
    ):
        (given / name).write_text("")
        with pytest.raises(ForceError, match=message):
            find_jobs(programs, forces=given)
        (given / name).unlink()


def test_a_broken_reader_explains_itself_and_stops_nothing_else(tmp_path, monkeypatch):
    added(monkeypatch, **{".dyn": "no_such_module:read", ".csv": "no_such_module:read"})
    (tmp_path / "a.csv").write_text("line,Fx,Fy,Fz\n2,1,2,3\n")
    assert forces.read(tmp_path / "a.csv").name.endswith("a.csv")
    with pytest.raises(ForceError, match=r"a\.dyn: the reader of \.dyn files .* ModuleNotFoundError: .*no_such_module"):
        forces.read(tmp_path / "a.dyn")


def test_any_other_extension_is_taken_for_csv(tmp_path):
    (tmp_path / "forces.txt").write_text("line,Fx,Fy,Fz\n2,1,2,3\n")
    assert forces.read(tmp_path / "forces.txt").wrench[0].tolist() == [1, 2, 3, 0, 0, 0]
