"""Signals, killed processes, full and missing devices: nothing half-written, no traceback, nobody left behind."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.commands import invoke
from tests.places import CELL_FILE
from tests.plan import setting
from tests.processes import CELL_16, COMMAND, ENDINGS, LONG, Held, programs, run_process, written

resource = pytest.importorskip("resource", reason="POSIX")
pytestmark = [
    pytest.mark.usefixtures("work_folder"),
    pytest.mark.skipif(os.name != "posix", reason="POSIX signals and devices"),
]
CONVERT = ("convert", ".", "--cell", CELL_16, "-o", "out")
COMPUTING, MAKING = "postproc.correction:process", "postproc.files.writing:_write"
REPLACING = "postproc.files.writing:_replace"
MOUNTING = (
    shutil.which("unshare") is not None
    and not subprocess.run(
        ["unshare", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True, check=False
    ).returncode
)  # as root, if the container permits it; what stands in for it otherwise is never skipped


def converted() -> None:
    """Convert all programs in this process, where nothing is to happen to it."""
    done = invoke(*CONVERT, catch_exceptions=False)
    assert done.exit_code == 0, done.output


def said(stderr: str) -> tuple[int, int]:
    """How many programs are written, of how many, as it was told; nothing else may be told."""
    lines = stderr.splitlines()
    match = re.fullmatch(r"Interrupted: (\d+) of (\d+) programs are written, and whole; of the others .*", lines[-1])
    assert match, stderr
    assert len(lines) == 1, stderr
    return int(match[1]), int(match[2])


@pytest.mark.parametrize(
    ("jobs", "number", "at"),
    [
        (1, signal.SIGINT, f"{COMPUTING}:2"),
        (1, signal.SIGHUP, f"{MAKING}:6"),
        (2, signal.SIGINT, f"{COMPUTING}:2"),
        (2, signal.SIGTERM, f"{MAKING}:6"),
        (2, signal.SIGHUP, f"{COMPUTING}:2"),
    ],
)
def test_a_signal_ends_at_once_what_is_not_being_replaced(jobs, number, at):
    programs(6)
    held = Held(at, *CONVERT, "--jobs", str(jobs))
    held.waiting(jobs)
    held.signal(number)
    code, stdout, stderr = held.end()
    assert (code, stdout) == (128 + number, "")
    assert len(written()) == jobs
    assert said(stderr) == (jobs, 6)


@pytest.mark.parametrize(("jobs", "number"), [(1, signal.SIGINT), (2, signal.SIGINT), (2, signal.SIGTERM)])
def test_a_signal_waits_for_programs_that_are_being_replaced_and_counts_them(jobs, number):
    programs(6)
    held = Held(f"{REPLACING}:2", *CONVERT, "--jobs", str(jobs))
    held.waiting()
    held.signal(number)
    held.signal(number)
    held.go()
    code, stdout, stderr = held.end()
    assert (code, stdout) == (128 + number, "")
    count = len(written())
    assert count == 2 if jobs == 1 else 2 <= count <= 6  # what was converted by then is put in its place too
    assert said(stderr) == (count, 6)


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupt_at_any_moment_leaves_whole_programs_and_counts_them(jobs):
    programs(150)
    process = subprocess.Popen(
        [*COMMAND, *CONVERT, "--jobs", str(jobs)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    while process.poll() is None and not list(Path("out").glob("*.src")):
        time.sleep(0.01)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    stdout, stderr = process.communicate(timeout=LONG)
    if process.returncode == 0:  # it was through before it could be interrupted
        assert len(written()) == 150
        return
    assert (process.returncode, stdout) == (130, "")
    assert said(stderr) == (len(written()), 150)


@pytest.mark.parametrize("at", [f"{COMPUTING}:2", f"{MAKING}:6"])
def test_workers_of_a_killed_process_end_by_themselves_and_leave_nothing_half_written(at):
    programs(4)
    held = Held(at, *CONVERT, "--jobs", "2")
    held.waiting(2)
    held.signal(signal.SIGKILL)
    held.end()
    assert len(written()) <= 2
    converted()
    assert len(written()) == 4
    assert not [path for path in Path("out").iterdir() if path.name.startswith(".")]


def test_workers_end_also_where_ctrl_c_is_ignored():
    programs(4)
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # as a shell starts a process in the background
    try:
        held = Held(f"{COMPUTING}:2", *CONVERT, "--jobs", "2")
    finally:
        signal.signal(signal.SIGINT, before)
    held.waiting(2)
    held.signal(signal.SIGINT)
    held.signal(signal.SIGTERM)
    assert held.end()[0] == 128 + signal.SIGTERM
    assert len(written()) == 2


def test_a_killed_worker_costs_its_program_and_no_other():
    programs(5)
    held = Held(f"{COMPUTING}:2", *CONVERT, "--jobs", "2")
    os.kill(held.waiting(2)[0], signal.SIGKILL)
    held.go()
    code, stdout, stderr = held.end()
    assert code == 1
    assert re.fullmatch(r"Error: p\d\d.src: its worker process ended \(signal 9\), perhaps .*\n", stderr)
    assert len(written()) == 4
    assert len(re.findall(r"^p\d\d.src .* written", stdout, re.MULTILINE)) == 4


@pytest.mark.parametrize("at", [f"{REPLACING}:1", "os:fsync:3"])
def test_a_process_killed_while_it_writes_leaves_no_program_and_the_next_run_cleans_up(at):
    programs(1)
    held = Held(at, *CONVERT)
    held.waiting()
    held.signal(signal.SIGKILL)
    held.end()
    assert {path.suffix for path in Path("out").iterdir()} == {".tmp", ".lock"}
    converted()
    assert written() == {"p00"}


@pytest.mark.parametrize("at", ["os:rename:1", "os:rename:2", "os:rename:4", "os:replace:1", "os:replace:4"])
def test_a_process_killed_between_two_files_leaves_no_program_to_reports_of_another(at):
    programs(1)
    converted()
    source = Path("p00.src")
    source.write_text(source.read_text().replace("FX=80", "FX=160"))
    held = Held(at, *CONVERT)
    held.waiting()
    held.signal(signal.SIGKILL)
    held.end()
    Path("out").rename("left")
    Path("out").mkdir()
    for path in [path for path in Path("left").iterdir() if not path.name.startswith(".")]:
        path.rename(Path("out", path.name))
    assert Path("out/p00.src").exists() == (at == "os:rename:1")
    assert at != "os:rename:1" or written() == {"p00"}


def test_another_run_into_the_folder_waits_and_says_for_whom():
    programs(2)
    held = Held(f"{REPLACING}:1", "convert", "p00.src", *CONVERT[2:])
    held.waiting()
    command = [*COMMAND, "convert", "p01.src", *CONVERT[2:]]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as other:
        told = other.stderr.readline()
        assert re.fullmatch(rf".*out: waiting for process {held.process.pid} on .*, which writes into this .*\n", told)
        assert other.poll() is None
        held.go()
        assert held.end()[0] == 0
        assert other.wait(LONG) == 0
    assert written() == {"p00", "p01"}


def test_a_closed_pipe_behind_it_is_no_fault():
    programs(2)
    with subprocess.Popen([*COMMAND, *CONVERT], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert written() == {"p00", "p01"}


def test_without_shared_memory_several_processes_do_the_same():
    """`/dev/shm` is read-only for this command alone; where mounting is not permitted, semaphores are refused to it.

    The folder is mounted elsewhere too: files of tests may be in `/dev/shm`.
    """
    programs(3)
    if MOUNTING:
        hidden = "mount --bind . /mnt && mount -t tmpfs -o ro,size=4k tmpfs /dev/shm && cd /mnt"
        done = _mounted(hidden, *CONVERT, "--jobs", "2")
    else:
        done = _patched("import _multiprocessing; del _multiprocessing.SemLock", 2)
    assert (done.returncode, done.stderr) == (0, "")
    assert written() == {"p00", "p01", "p02"}


@pytest.mark.parametrize("missing", [1, 5])
@pytest.mark.parametrize("earlier", [False, True])
def test_a_full_disk_leaves_what_was_there_names_the_file_and_says_what_is_of_an_earlier_run(earlier, missing):
    programs(1)
    converted()
    sizes = [path.stat().st_size for path in Path("out").iterdir()]
    need = sum(-(-size // 4096) for size in sizes)
    Path("out").rename("earlier")
    Path("out").mkdir()
    filled = "cp -a earlier/. out" if earlier else "true"
    if MOUNTING:
        room = max(1, need * (1 + earlier) - missing) * 4
        full = f"mount -t tmpfs -o size={room}k tmpfs out && {filled} && trap 'cp -a out after' EXIT"
        done = _mounted(full, *CONVERT)
    else:
        subprocess.run(filled, shell=True, check=True)
        largest = max(sizes) - missing
        done = run_process(*CONVERT, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest)))
        Path("out").rename("after")
    assert done.returncode == 1
    first, *rest = done.stderr.splitlines()
    why = r"\((No space left on device|File too large)\)"
    kept = r"Nothing was written; existing files are unchanged\. .*"
    assert re.fullmatch(rf"Error: out(/p00\.[a-z.]+)?: cannot be written {why}\. {kept}", first)
    assert rest == (["There before, not of this run: out/p00.src."] if earlier else [])
    assert written("after") == ({"p00"} if earlier else set())


@pytest.mark.skipif(not MOUNTING, reason="mounting is not permitted; tests/test_writing.py has the same with a patch")
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_file_that_cannot_be_replaced_keeps_all_of_the_earlier_run(ending):
    programs(1)
    converted()
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    source = Path("p00.src")
    source.write_text(source.read_text().replace("FX=80", "FX=160"))
    done = _mounted(f"mount --bind out/p00{ending} out/p00{ending}", *CONVERT)
    assert done.returncode == 1
    first, second = done.stderr.splitlines()
    assert first.startswith(f"Error: out/p00{ending}: cannot be written (Device or resource busy). Nothing was written")
    assert second == "There before, not of this run: out/p00.src."
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


def _mounted(before: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command after something was mounted, in a mount namespace of its own."""
    script = f"set -e; {before}; {shlex.join([*COMMAND, *arguments])}"
    command = ["unshare", "--mount", "sh", "-c", script]
    return subprocess.run(command, capture_output=True, text=True, timeout=LONG, check=False)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 0), (signal.SIGTERM, 128 + signal.SIGTERM)])
def test_ctrl_c_ends_the_search_of_plan_with_the_best_plan_and_a_termination_without(tmp_path, number, code):
    setting.experiment(tmp_path)
    Path("poses.csv").write_text("A1,A2,A3,A4,A5,A6,Fx,Fy,Fz\n0,-70,110,0,50,0,100,50,300\n")
    size = ("--configurations", "4", "--q2-levels", "2")
    held = Held("postproc.plan.planning:random_values:1", "plan", "--experiment", "experiment.toml", "--cell",
                str(CELL_FILE), "--poses", "poses.csv", *size, "-o", "out/plan.csv")  # fmt: skip
    held.waiting()
    held.signal(number)
    ended, stdout, stderr = held.end()
    assert ended == code, stderr
    assert ("interrupted: this is the best plan so far" in stdout + stderr) == (code == 0)
    assert Path("out/plan.csv").exists() == (code == 0)
    assert code == 0 or stderr == "Interrupted.\n"


def test_where_no_process_can_be_started_the_work_goes_on_in_this_one():
    programs(3)
    done = _patched("subprocess.Popen = lambda *a, **k: (_ for _ in ()).throw(BlockingIOError(11, 'no more'))", 2)
    assert (done.returncode, done.stderr) == (0, "")
    assert written() == {"p00", "p01", "p02"}


def test_where_only_one_process_can_be_started_it_does_the_work():
    programs(3)
    limited = """
real, started = subprocess.Popen, []
def limited(*a, **k):
    started.append(1)
    if len(started) > 1:
        raise BlockingIOError(11, "no more")
    return real(*a, **k)
subprocess.Popen = limited
"""
    done = _patched(limited, 2)
    assert (done.returncode, done.stderr) == (0, "")
    assert written() == {"p00", "p01", "p02"}


def _patched(patch: str, jobs: int) -> subprocess.CompletedProcess[str]:
    code = f"import subprocess\n{patch}\nfrom postproc.__main__ import main; main()"
    command = [sys.executable, "-c", code, *CONVERT, "--jobs", str(jobs)]
    return subprocess.run(command, capture_output=True, text=True, timeout=LONG, check=False)


_AT_IMPORT = """
import signal, sys
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            signal.raise_signal({number})
sys.meta_path.insert(0, Interrupting())
from postproc.__main__ import main
main()
"""


@pytest.mark.parametrize(
    ("module", "number"),
    [
        ("click", signal.SIGINT),
        ("click", signal.SIGTERM),
        ("postproc.cli.convert", signal.SIGINT),
        ("numpy", signal.SIGINT),
        ("postproc.jobs.conversion", signal.SIGTERM),
        ("postproc.kinematics", signal.SIGINT),
    ],
)
def test_a_signal_while_it_starts_is_a_word_and_no_traceback(module, number):
    programs(1)
    code = _AT_IMPORT.format(module=module, number=int(number))
    done = subprocess.run([sys.executable, "-c", code, *CONVERT], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, "", "Interrupted.\n")
    assert not Path("out").exists()
