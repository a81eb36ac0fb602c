"""Commands of a window: stopped, ended with it, and none while a file that they read is changed."""

from __future__ import annotations

import contextlib
import html
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from urllib.parse import urlencode

import pytest

from postproc.app.runs import Run, Runs
from postproc.errors import InputError
from tests.app.test_access import ask
from tests.test_currency import PROGRAM

WATCH = ("watch", "idle", "--cell", "corrected/cell.toml")
"""A command that runs until it is stopped; of an empty folder: one that prints ends by its closed stdout anyway."""
PATIENCE_S = 60.0


@pytest.fixture
def shop(shop):
    (shop / "idle").mkdir()
    (shop / "corrected" / "place-part").mkdir()
    (shop / "corrected" / "place-part" / "place.toml").write_text("[base]\nX = 1600.0\nY = 0.0\nZ = 700.0\nA = 0.0\n")
    return shop


def until(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_command_is_stopped_by_the_end_of_its_pipe(shop):
    run = Run(0, "part.nc", "Watch", WATCH, shop)
    until(lambda: run.text)
    assert run.code is None
    run.stop()
    run.wait(PATIENCE_S)
    assert (run.code, run.is_stopped) == (128 + signal.SIGTERM, True)


STARTER = """
import sys, time
from pathlib import Path
from postproc.app.runs import Run
run = Run(0, "part.nc", "Watch", sys.argv[2:], Path(sys.argv[1]))
while not run.text:
    time.sleep(0.05)
print(run._process.pid, flush=True)
time.sleep(600)
"""


def test_commands_of_a_killed_window_end(shop):
    window = subprocess.Popen([sys.executable, "-c", STARTER, str(shop), *WATCH], stdout=subprocess.PIPE, text=True)
    command = int(window.stdout.readline())
    os.kill(command, 0)
    window.kill()
    window.wait()
    window.stdout.close()

    def gone():
        try:
            os.kill(command, 0)
        except ProcessLookupError:
            return True
        with contextlib.suppress(OSError), open(f"/proc/{command}/stat") as status:  # noqa: PTH123 - a name of the system
            return status.read().rpartition(")")[2].split()[0] == "Z"
        return False

    until(gone)


def test_questions_of_a_command_have_no_answer(shop):
    run = Run(0, "part.nc", "Start", ("start", "part.nc", "--no-open", "-o", "elsewhere"), shop)
    run.wait(PATIENCE_S)
    assert run.code == 2
    assert "there is no terminal to ask on" in run.text


def test_how_far_a_search_is(shop):
    cell = shop / "corrected" / "cell.toml"
    cell.write_text(cell.read_text().partition("[collision]")[0])  # bodies would take most of the time
    region = ("--region", "X=1450:1550,Y=-50:50")
    run = Run(0, "part.nc", "Place", ("place", "part.nc", "--cell", "corrected/cell.toml", *region, "-o", "out"), shop)
    shares = []
    while run.code is None:
        shares.append(run.share)
        time.sleep(0.01)
    assert run.code in (0, 1), run.text
    assert (run.share, run.step) == (1.0, "places")
    assert "\x1e" not in run.text
    stated = [share for share in shares if share is not None]
    assert stated == sorted(stated)


def test_the_list_of_programs_changes_with_a_command_that_fails_between_two_looks(shop):
    from postproc.app.server import Window
    from tests.app.conftest import answering

    def stamp():
        return json.loads(ask(window, "GET", "/programs.json")[2])["stamp"]

    with Window(shop, 0) as window, answering(window):
        (shop / "broken.nc").write_text("G1 X5\n")
        before = stamp()
        assert stamp() == before
        run = window.runs.begin("broken.nc", "Correct", ("convert", "broken.nc", "--cell", "corrected/cell.toml"))
        run.wait(PATIENCE_S)
        assert run.is_failure, "it has written nothing"
        after = stamp()
        assert after != before
        window.automatic.switch(is_on=False)
        assert stamp() != after


def test_a_file_that_commands_read_is_not_changed_while_one_runs(shop):
    runs, changed = Runs(shop), []
    run = runs.begin("part.nc", "Watch", WATCH)
    with pytest.raises(InputError, match="nothing was changed"):
        runs.edit(lambda: changed.append("edit"))
    with pytest.raises(InputError, match="nothing was changed"):
        runs.begin("other.nc", "Correct", WATCH, lambda: changed.append("begin"))
    assert (changed, runs.begin("part.nc", "Watch", WATCH)) == ([], run)
    with pytest.raises(InputError, match="runs already: nothing was begun"):
        runs.begin("part.nc", "Correct", ("convert", "part.nc"))
    runs.stop_all()
    runs.edit(lambda: changed.append("edit"))
    assert changed == ["edit"]


def test_a_place_is_not_taken_while_a_command_runs(shop):
    from postproc.app.server import Window
    from tests.app.conftest import answering

    with Window(shop, 0) as window, answering(window):
        cell = window.workspace.cell.read_bytes()
        run = window.runs.begin("other.nc", "Watch", WATCH)
        status, _, page = ask(window, "POST", "/take-place", urlencode({"name": "part.nc"}).encode())
        assert status == 400
        assert b"nothing was changed" in page
        assert window.workspace.cell.read_bytes() == cell
        status, _, page = ask(window, "POST", "/cell", b"base.X=1700")
        assert status == 400
        assert b'name="base.X" value="1700"' in page, "what was typed is still on the page"
        assert window.workspace.cell.read_bytes() == cell
        run.stop()
        run.wait(PATIENCE_S)
        assert ask(window, "POST", "/take-place", urlencode({"name": "part.nc"}).encode())[0] == 303
        assert b"X = 1600" in window.workspace.cell.read_bytes()


def test_frames_by_number_that_move_with_the_base_are_taken_into_the_cell(shop):
    from postproc.app.server import Window
    from tests.app.conftest import answering

    with Window(shop, 0) as window, answering(window):
        path = window.workspace.cell
        path.write_text(path.read_text() + "\n[base_data.3]  # table\nX = 1500.0  # measured\nZ = 700.0\n")
        place = shop / "corrected" / "place-part" / "place.toml"
        place.write_text(place.read_text() + "[base_data.3]\nX = 1600.5\nY = 0.0\nZ = 700.0\nA = 0.0\n")
        assert ask(window, "POST", "/take-place", urlencode({"name": "part.nc"}).encode())[0] == 303
        assert "[base_data.3]  # table\nX = 1600.5  # measured\nZ = 700" in path.read_text()
        cell = tomllib.loads(path.read_text())
        assert cell["base"]["X"] == 1600
        assert cell["base_data"]["3"] == {"X": 1600.5, "Y": 0, "Z": 700, "A": 0}


@pytest.mark.parametrize("name", ["part.apt", "PART.NC", "part.src"])
def test_programs_that_would_be_written_to_the_same_files_are_refused(shop, name):
    from postproc.app.workspace import Workspace

    workspace = Workspace(shop.resolve())
    (shop / name).write_text("x")
    with pytest.raises(InputError, match="its files would be those of"):
        workspace.usable_program("part.nc")
    assert [item.is_current for item in workspace.items()] == [False, False]
    (shop / name).unlink()
    assert workspace.usable_program("part.nc").name == "part.nc"
    with open(shop / "part.nc", "rb") as file, pytest.raises(InputError, match="its files would be those of"):  # noqa: PTH123
        workspace.add(name, file, 10)


def test_names_that_become_one_on_the_controller_are_the_same(shop):
    from postproc.app.workspace import Workspace

    for name in ("my part.nc", "my_part.nc"):
        (shop / name).write_text("G0 X1\n")
    with pytest.raises(InputError, match="its files would be those of"):
        Workspace(shop.resolve()).usable_program("my part.nc")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no files of these names")
@pytest.mark.parametrize("name", ["x<y.nc", 'it"s.nc', "a\\b.nc", "-o.nc"])
def test_a_name_that_the_window_cannot_use_is_named_in_the_list(shop, name):
    from postproc.app.server import Window
    from tests.app.conftest import answering

    (shop / name).write_text("G0 X1\n")
    with Window(shop, 0) as window, answering(window):
        status, _, page = ask(window, "GET", "/")
        assert status == 200
        assert b"Rename it: its name has a character" in page
        assert ask(window, "GET", "/setup?" + urlencode({"name": name}))[0] == 400
        assert ask(window, "GET", "/setup?name=part.nc")[0] == 200


def test_answers_are_kept_while_another_command_works_on_the_program(shop):
    from postproc.app.server import Window
    from tests.app.conftest import answering

    (shop / "with_forces.nc").write_text("(FORCE FX=1 FY=2 FZ=3 FRAME=FEED)\n" + PROGRAM)
    with Window(shop, 0) as window, answering(window):
        run = window.runs.begin("with_forces.nc", "Correct with_forces.nc", WATCH)
        window.workspace.cell.unlink()
        answers = {"robot": "kuka_kr270", "base/X": 1500, "base/Y": 0, "base/Z": 700.25, "tool/Z": 350}
        answers |= {"tool/X": 0, "tool/Y": 0, "clearance": 50}
        status, _, page = ask(window, "POST", "/setup?name=with_forces.nc", urlencode(answers).encode())
        assert status == 200
        assert b"runs already: nothing was begun" in page
        assert b'name="base/Z" value="700.25"' in page
        assert window.runs.count == 1
        run.stop()


def test_an_edit_in_another_window_is_not_undone(shop):
    from postproc.app.server import Window
    from tests.app.conftest import answering

    with Window(shop, 0) as window, answering(window):
        page = ask(window, "GET", "/cell")[2].decode()
        shown = html.unescape(re.search('name="shown" value="([^"]*)"', page)[1])
        form = {"base.X": "1500", "base.Z": "700", "tool.Z": "350", "shown": shown}

        def save(**changes):
            posted = form | {name.replace("_", "."): text for name, text in changes.items()}
            return ask(window, "POST", "/cell", urlencode(posted).encode())

        assert save(base_X="1510")[0] == 303
        assert save(tool_Z="352")[0] == 303, "this window still shows X = 1500, and has not changed it"
        content = tomllib.loads(window.workspace.cell.read_text())
        assert (content["base"]["X"], content["tool"]["Z"]) == (1510, 352)
        status, _, page = save(base_X="1520")
        assert status == 400
        assert b"base.X was 1500 when you opened this page, and is now 1510 in the file" in page
        assert b'name="base.X" value="1520"' in page
        form["shown"] = html.unescape(re.search('name="shown" value="([^"]*)"', page.decode())[1])
        assert save(base_X="1520", tool_Z="352")[0] == 303, "seen, and wanted"
        assert tomllib.loads(window.workspace.cell.read_text())["base"]["X"] == 1520
