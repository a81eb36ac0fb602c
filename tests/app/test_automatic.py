"""Programs are corrected as they arrive: once, when they are quiet, with their process, while the switch is on."""

from __future__ import annotations

import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from postproc.app.automatic import AutomaticConversion
from postproc.app.server import Window
from postproc.app.workspace import Workspace
from postproc.errors import InputError
from postproc.jobs.arrivals import Arrivals
from tests.app.conftest import answering
from tests.app.test_window import looked_at, opened
from tests.pages.browser import needs_chromium
from tests.test_currency import PROGRAM


@pytest.fixture
def folder(shop):
    return shop.resolve()


@pytest.fixture
def arrivals(folder):
    return Arrivals(folder, folder / "corrected", folder / "corrected" / "cell.toml")


def ready(arrivals, *seconds, busy=()):
    """The names that are ready at the last of some times."""
    return [[path.name for path in arrivals.ready(second, busy)] for second in seconds][-1]


def test_a_program_is_ready_once_it_is_quiet_and_again_when_an_input_changes(arrivals, folder):
    assert ready(arrivals, 0.0, 0.9) == []
    assert ready(arrivals, 1.1) == ["part.nc"]
    arrivals.finish(folder / "part.nc")
    assert ready(arrivals, 2.2, 9.0) == []
    for number, name in enumerate(("part.nc", "corrected/part.process.toml", "corrected/cell.toml",
                                   "corrected/material.toml", "model/model.toml")):  # fmt: skip
        path = folder / name
        path.write_bytes(path.read_bytes() + b"\n")
        assert ready(arrivals, 10.0 * number + 10.0) == [], "it has just changed"
        assert ready(arrivals, 10.0 * number + 12.0) == ["part.nc"], name
        arrivals.finish(folder / "part.nc")


def test_a_program_is_ready_again_when_a_file_that_it_calls_arrives_or_changes(arrivals, folder):
    (folder / "part.nc").write_text(PROGRAM.replace("M30", "M98 P400\nM30"))
    assert ready(arrivals, 0.0, 1.1) == ["part.nc"]
    arrivals.finish(folder / "part.nc")
    for start, text in ((10.0, "O400\nG1 X1\nM99\n"), (20.0, "O400\nG1 X12\nM99\n")):
        (folder / "0400.txt").write_text(text)
        assert ready(arrivals, start) == []
        assert ready(arrivals, start + 1.1) == ["part.nc"]
        arrivals.finish(folder / "part.nc")


def test_a_program_whose_forces_are_not_stated_waits_for_them(arrivals, folder):
    (folder / "other.nc").write_text(PROGRAM)
    assert ready(arrivals, 0.0, 2.0) == ["part.nc"]
    shutil.copy(folder / "corrected" / "part.process.toml", folder / "corrected" / "other.process.toml")
    assert ready(arrivals, 3.0, 5.0) == ["other.nc", "part.nc"]
    (folder / "with_forces.nc").write_text("(FORCE FX=1 FY=2 FZ=3 FRAME=FEED)\n" + PROGRAM)
    assert ready(arrivals, 6.0, 8.0) == ["other.nc", "part.nc", "with_forces.nc"]


def test_what_a_command_has_worked_on_is_finished(arrivals, folder):
    assert ready(arrivals, 0.0, 2.0, busy=["part.nc"]) == []
    process = folder / "corrected" / "part.process.toml"
    process.write_bytes(process.read_bytes() + b"\n")  # the command may write it: `start` does
    assert ready(arrivals, 3.0, 9.0) == []


def test_a_program_that_changes_while_a_command_works_on_it_is_ready_again(arrivals, folder):
    assert ready(arrivals, 0.0, 0.5, busy=["part.nc"]) == []
    (folder / "part.nc").write_text(PROGRAM + "\n\n")
    assert ready(arrivals, 1.0, busy=["part.nc"]) == []
    assert ready(arrivals, 2.0) == []
    assert ready(arrivals, 4.0) == ["part.nc"]


def test_a_program_that_is_taken_away_and_put_back_is_ready(arrivals, folder):
    program = folder / "part.nc"
    assert ready(arrivals, 0.0, busy=["part.nc"]) == []
    assert ready(arrivals, 1.0, 5.0) == []
    program.rename(folder / "part.away")
    assert ready(arrivals, 6.0) == []
    (folder / "part.away").rename(program)
    assert ready(arrivals, 7.0, 9.0) == ["part.nc"]


def test_a_program_that_others_call_is_left_to_them(arrivals, folder):
    (folder / "corrected" / "process.toml").write_bytes((folder / "corrected" / "part.process.toml").read_bytes())
    (folder / "main.src").write_text("DEF main()\nsub()\nEND\n")
    (folder / "sub.src").write_text("DEF sub()\nEND\n")
    assert ready(arrivals, 0.0, 2.0) == ["main.src", "part.nc"]


def test_without_a_cell_nothing_is_ready(arrivals, folder):
    (folder / "corrected" / "cell.toml").unlink()
    assert ready(arrivals, 0.0, 2.0) == []


def steps(automatic, runs, *seconds):
    """What has been begun after looks at some times."""
    for second in seconds:
        automatic.step(second)
    return [arguments for _, _, arguments in runs.begun]


class Commands:
    """Stands in for `Runs`: commands begin, and end when a test says so."""

    def __init__(self):
        self.runs, self.begun, self.fault = [], [], None

    def begin(self, key, title, arguments):
        if self.fault is not None:
            raise self.fault
        self.begun.append((key, title, arguments))
        return self.by_user(key, arguments)

    def by_user(self, key, arguments, code=None):
        number, is_running = len(self.runs), code is None
        self.runs.append(SimpleNamespace(number=number, key=key, arguments=tuple(arguments), is_running=is_running))
        return self.runs[-1]

    def runs_since(self, number):
        return self.runs[number:]

    def end(self):
        for run in self.runs:
            run.is_running = False


@pytest.fixture
def runs():
    return Commands()


COMMAND = ["convert", "part.nc", "--cell", "corrected/cell.toml"]
COMMAND += ["--process", "corrected/part.process.toml", "-o", "corrected"]


def test_only_what_is_not_current_is_begun_and_nothing_while_a_command_runs(folder, runs):
    automatic = AutomaticConversion(Workspace(folder), runs)
    assert steps(automatic, runs, 0.0, 2.0, 4.0) == [], "the result is current"
    (folder / "part.nc").write_text(PROGRAM + "\n")
    runs.by_user("other.nc", ["convert"])
    assert steps(automatic, runs, 5.0, 7.0) == []
    runs.end()
    assert steps(automatic, runs, 8.0, 20.0) == [COMMAND]
    runs.end()
    assert steps(automatic, runs, 30.0, 40.0) == [COMMAND], "once, whatever came of it"


def test_what_a_user_has_had_corrected_is_not_begun_again_however_short_it_ran(folder, runs):
    (folder / "part.nc").write_text(PROGRAM + "\n")
    automatic = AutomaticConversion(Workspace(folder), runs)
    assert steps(automatic, runs, 0.0) == []
    runs.by_user("part.nc", ["start", "part.nc"], code=1)
    assert steps(automatic, runs, 0.5, 3.0, 5.0) == []
    (folder / "part.nc").write_text(PROGRAM + "\n\n")
    runs.by_user("part.nc", ["place", "part.nc"], code=0)
    assert steps(automatic, runs, 6.0, 8.0) == [COMMAND], "the search for a place corrects nothing"


def test_a_material_that_changes_while_its_program_is_corrected_counts_afterwards(folder, runs):
    (folder / "part.nc").write_text(PROGRAM + "\n")
    automatic = AutomaticConversion(Workspace(folder), runs)
    assert steps(automatic, runs, 0.0, 2.0) == [COMMAND]
    material = folder / "corrected" / "material.toml"
    material.write_bytes(material.read_bytes() + b"\n")
    assert steps(automatic, runs, 3.0, 5.0) == [COMMAND]
    runs.end()
    assert steps(automatic, runs, 6.0, 8.0) == [COMMAND, COMMAND]


def test_a_program_that_could_not_be_begun_is_tried_again(folder, runs):
    (folder / "part.nc").write_text(PROGRAM + "\n")
    automatic = AutomaticConversion(Workspace(folder), runs)
    assert steps(automatic, runs, 0.0) == []
    runs.fault = InputError("4 commands run already")
    with pytest.raises(InputError):
        automatic.step(2.0)
    runs.fault = None
    assert steps(automatic, runs, 3.0) == [COMMAND]


def test_a_program_waits_until_no_other_would_be_written_to_the_same_files(folder, runs):
    (folder / "part.nc").write_text(PROGRAM + "\n")
    (folder / "part.tap").write_text(PROGRAM)
    automatic = AutomaticConversion(Workspace(folder), runs)
    assert steps(automatic, runs, 0.0, 2.0, 4.0) == []
    (folder / "part.tap").unlink()
    assert steps(automatic, runs, 5.0, 7.0) == [COMMAND]


@pytest.mark.parametrize("seed", range(12))
def test_whatever_happens_each_program_is_begun_once_for_each_of_its_contents(folder, runs, monkeypatch, seed):
    """Files arrive and change, users begin commands and switch, commands end: in any order, nothing is forgotten.

    The results are those of a stand-in: a command reads the program when it begins, and its result is that content.
    """
    results, random = {}, np.random.default_rng(seed)
    shutil.copy(folder / "corrected" / "part.process.toml", folder / "corrected" / "process.toml")
    workspace, names = Workspace(folder), ["part.nc", "a.nc", "b.nc"]

    def content(name):
        return (folder / name).read_text() if (folder / name).is_file() else None

    def items(_):
        return [
            SimpleNamespace(name=name, is_current=results.get(name) == content(name), name_fault="")
            for name in names
            if content(name)
        ]

    def begin(key, title, arguments):
        begun.append((key, content(key)))
        results[key] = content(key)
        return runs.by_user(key, arguments)

    begun = []
    monkeypatch.setattr(Workspace, "items", items)
    monkeypatch.setattr(runs, "begin", begin)
    automatic, time_s = AutomaticConversion(workspace, runs), 0.0
    events = ("write", "write", "user", "end", "end", "switch", "remove", "nothing", "nothing")
    for number in range(150):
        time_s += random.choice([0.5, 0.5, 2.0])
        name = str(random.choice(names))
        match str(random.choice(events)):
            case "write":
                (folder / name).write_text(f"{PROGRAM}({number})\n")
            case "user" if content(name) and all(not run.is_running for run in runs.runs):
                results[name] = content(name)
                runs.by_user(name, ["convert", name])
            case "end":
                runs.end()
            case "switch":
                automatic.switch(is_on=not automatic.is_on)
            case "remove":
                (folder / name).unlink(missing_ok=True)
            case _:
                pass
        automatic.step(time_s)
    automatic.switch(is_on=True)
    for _ in range(12):
        time_s += 2.0
        runs.end()
        automatic.step(time_s)
    assert all(results.get(name) == content(name) for name in names if content(name)), "nothing was forgotten"
    assert len(begun) == len(set(begun)), "nothing was begun twice"
    assert begun, "something was begun"


def test_the_switch_is_kept_in_the_folder(folder, runs):
    (folder / "part.nc").write_text(PROGRAM + "\n")
    automatic = AutomaticConversion(Workspace(folder), runs)
    automatic.switch(is_on=False)
    again = AutomaticConversion(Workspace(folder), runs)
    assert not again.is_on
    assert steps(again, runs, 0.0, 2.0, 4.0) == []
    again.switch(is_on=True)
    assert AutomaticConversion(Workspace(folder), runs).is_on
    assert len(steps(again, runs, 5.0, 7.0)) == 1


@needs_chromium
def test_a_program_that_is_copied_into_the_folder_is_corrected_and_shown(browser, folder):
    shutil.copy(folder / "corrected" / "part.process.toml", folder / "corrected" / "process.toml")
    with Window(folder, 0) as window, answering(window), opened(browser, window) as page:
        window.automatic.start()
        page.get_by_role("button", name="Turn it off").click()
        page.get_by_role("button", name="Turn it on").wait_for()
        (folder / "other.nc").write_text(PROGRAM.replace("X40", "X35"))
        row = page.get_by_role("row", name="other.nc")
        row.wait_for()
        row.get_by_text("Not corrected yet").wait_for()  # the page has shown it by itself
        looked_at(page, "40-off")
        page.wait_for_timeout(2500)
        assert window.runs.latest_run("other.nc") is None
        page.get_by_role("button", name="Turn it on").click()
        row.get_by_role("link", name="Working").or_(row.get_by_role("link", name="look at it")).wait_for()
        looked_at(page, "41-working")
        row.get_by_role("link", name="look at it").wait_for()
        assert (folder / "corrected" / "other.src").is_file()
        (folder / "broken.nc").write_text("G1 X5 (no feed)\nM30\n")
        page.get_by_role("link", name="Nothing was written: see why").click()
        assert "broken.nc" in page.get_by_label("Output of the command").inner_text()
        window.automatic.stop()
