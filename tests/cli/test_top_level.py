"""What every command does alike: faults, interrupts, warnings of libraries, exit codes."""

from __future__ import annotations

import json
import os
import pickle
import pkgutil
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import postproc
from postproc.errors import Issue, PostprocError, ProgramError
from postproc.kinematics import UnreachableError
from tests.commands import invoke
from tests.places import ROOT
from tests.processes import CELL_16, COMMAND, programs

FAULT = (
    r"Error: (?:p00.src: )?unexpected ZeroDivisionError: oops\. This is a fault of postproc: please report it with the "
    r"program and the cell\. The traceback is in (.*postproc-fault-.*\.log)\.\n"
)


@pytest.fixture(autouse=True)
def temporary_files(work_folder, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(work_folder))


def oops(*_, **__):
    raise ZeroDivisionError("oops")


@pytest.fixture(params=["robots", "convert"])
def faulty(request, monkeypatch):
    """A command with a fault: of the command itself, or in one of its programs."""
    programs(1)
    monkeypatch.setattr(
        "postproc.robot.shipped_models" if request.param == "robots" else "postproc.correction.process", oops
    )
    return ["robots"] if request.param == "robots" else ["convert", "p00.src", "--cell", CELL_16]


def test_a_fault_is_one_line_and_a_file_with_the_traceback(faulty):
    done = invoke(*faulty)
    assert done.exit_code == 1
    (path,) = re.fullmatch(FAULT, done.stderr).groups()
    text = Path(path).read_text()
    assert text.startswith("Traceback (most recent call last):")
    assert text.endswith("ZeroDivisionError: oops\n")


@pytest.mark.parametrize("in_front", [True, False])
def test_debug_shows_the_traceback_wherever_it_stands(faulty, in_front):
    done = invoke(*["--debug", *faulty] if in_front else [*faulty, "--debug"])
    assert done.exit_code == 1
    assert "Traceback (most recent call last):" in done.stderr
    assert "The traceback is in" not in done.stderr
    assert list(Path().glob("postproc-fault-*")) == []


def test_where_no_file_can_be_written_debug_is_what_helps(faulty, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", "nowhere")
    assert "with --debug" in invoke(*faulty).stderr


def test_a_fault_of_a_worker_is_told_by_the_process_that_waits():
    programs(2)
    Path("sitecustomize.py").write_text(
        "import postproc.correction as p\ndef oops(*_, **__):\n    raise ZeroDivisionError('oops')\np.process = oops\n"
    )
    done = subprocess.run(
        [*COMMAND, "convert", ".", "--cell", CELL_16, "--jobs", "2"],
        capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": str(Path.cwd())},
    )  # fmt: skip
    assert done.returncode == 1
    assert len(re.findall(FAULT.replace("p00", r"p0\d"), done.stderr)) == 2
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("cause", "message"), [(MemoryError(), "not enough memory"), (PostprocError("no"), "no")])
def test_what_is_no_fault_is_told_as_it_is(monkeypatch, cause, message):
    def stop():
        raise cause

    monkeypatch.setattr("postproc.robot.shipped_models", stop)
    done = invoke("robots")
    assert (done.exit_code, done.stderr) == (1, f"Error: {message}\n")


def test_what_the_machine_refuses_is_no_fault_of_postproc():
    long = "a" * 300
    for arguments in (["x.nc", "-o", long], [f"{long}.nc"]):
        Path("x.nc").write_text("G0 X0\n")
        done = invoke("convert", *arguments, cell=CELL_16)
        assert done.exit_code == 1
        assert re.fullmatch(r"Error: .*File name too long.*\n", done.stderr)
        assert "fault" not in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="names that are no text")
def test_a_program_whose_name_is_no_text_is_told():
    Path(os.fsdecode(b"bad\xff.nc")).write_text("G0 X0\n")
    done = invoke("convert", ".", cell=CELL_16)
    assert done.exit_code == 1
    assert done.stderr == "Error: bad?.nc: its name is not UTF-8. Rename the file.\n"


@pytest.mark.skipif(sys.platform != "linux", reason="names that are no text")
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_in_a_folder_a_name_that_is_no_text_fails_alone(jobs):
    for name in (b"a.nc", b"bad\xff.nc", b"c.nc"):
        Path(os.fsdecode(name)).write_text("G21 G90\nG0 X0 Y0 Z20\nG1 Z-1 F300\nX5\nG0 Z20\nM30\n")
    arguments = ["convert", ".", "--cell", CELL_16, "-o", "out", "--jobs", jobs]
    done = invoke(*arguments)
    assert done.exit_code == 1
    assert done.stderr == "Error: bad?.nc: its name is not UTF-8. Rename the file.\n"
    assert sorted(path.name for path in Path("out").glob("*.src")) == ["a.src", "c.src"]
    assert "bad?.nc: its name is not UTF-8" in Path("out/index.html").read_text()
    entries = json.loads(invoke(*arguments, "--json").stdout)["programs"]
    assert [entry["exit_code"] for entry in entries] == [0, 1, 0]
    named = invoke("convert", "a.nc", os.fsdecode(b"bad\xff.nc"), "-o", "other", cell=CELL_16)
    assert (named.exit_code, Path("other").exists()) == (1, False)
    placed = invoke("place", ".", "-o", "other", cell=CELL_16)
    assert (placed.exit_code, placed.stderr) == (1, done.stderr)


def test_an_interrupt_has_an_exit_code_of_its_own(monkeypatch):
    def stop():
        raise KeyboardInterrupt

    monkeypatch.setattr("postproc.robot.shipped_models", stop)
    done = invoke("robots")
    assert (done.exit_code, done.stderr) == (130, "Interrupted.\n")


@pytest.mark.parametrize("debug", [False, True])
def test_warnings_of_libraries_are_for_debug_only(debug):
    code = (
        "import warnings, postproc.robot as r; from postproc.__main__ import main\n"
        "r.shipped_models = lambda: warnings.warn('overflow encountered in multiply', RuntimeWarning) or {'x': 1 / 0}\n"
        "main()"
    )
    arguments = ["robots", "--debug"] if debug else ["robots"]
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert ("overflow encountered" in done.stderr) == debug


def every_error() -> list[type[PostprocError]]:
    for module in pkgutil.walk_packages(postproc.__path__, "postproc."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    found, new = [], [PostprocError]
    while new:
        found += new
        new = [kind for parent in new for kind in parent.__subclasses__()]
    return sorted(set(found), key=lambda kind: kind.__qualname__)


@pytest.mark.parametrize("kind", every_error(), ids=lambda kind: kind.__qualname__)
def test_every_exception_passes_from_one_process_to_another(kind):
    cause = kind.__new__(kind, "part.nc:7: odd word.")  # whatever its constructor takes
    cause.rows, cause.issue, cause.line = (3, 5), Issue("error", "unreachable", "no", 12), 7
    again = pickle.loads(pickle.dumps(cause))
    assert type(again) is kind
    assert (str(again), vars(again)) == (str(cause), vars(cause))


def test_what_an_exception_carries_is_what_was_given():
    again = pickle.loads(pickle.dumps(UnreachableError([3, 5])))
    assert (str(again), again.rows) == (str(UnreachableError([3, 5])), (3, 5))
    cause = ProgramError("odd word", file="part.nc", line=7, further_errors=[ProgramError("odder", line=9)])
    again = pickle.loads(pickle.dumps(cause))
    assert (str(again), again.line, again.further_errors[0].line) == (str(cause), 7, 9)


def test_the_command_and_the_module_are_the_same():
    done = subprocess.run([*COMMAND, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("postproc ")


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads as Linux lists them")
@pytest.mark.parametrize(("wanted", "threads"), [({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, min(2, os.cpu_count() or 1))])
def test_one_program_is_one_thread_unless_the_user_wants_more(wanted, threads):
    count = "atexit.register(lambda: print(len(os.listdir('/proc/self/task')), file=sys.stderr))"
    script = f"import atexit, os, sys; from postproc.cli import main; {count}; main()"
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", script, "robots", "kuka_kr270"],
        env=free | wanted,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr.split() == [str(threads)]


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="counts threads as Linux lists them")
def test_tests_compute_in_one_thread():
    script = "import os; import tests.conftest; import numpy; print(len(os.listdir('/proc/self/task')))"
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, env=free, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["1"]
