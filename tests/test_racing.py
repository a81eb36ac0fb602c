"""Many processes that write into one folder: what one of them wrote is there, whole."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands import run
from tests.processes import CELL_16, COMMAND, LONG, programs, written

pytestmark = pytest.mark.usefixtures("work_folder")

WRITER = """
import sys
from pathlib import Path
from postproc.files import write_whole
folder, own = Path(sys.argv[1]), sys.argv[2].encode()
print(flush=True)
sys.stdin.readline()
for _ in range(int(sys.argv[3])):
    write_whole(folder, {name: own for name in ("part.src", "part.csv", "part.json")})
"""


def sets(folder: str) -> dict[str, bytes]:
    """Return the files of the programs in a folder; pages name the folder."""
    return {path.name: path.read_bytes() for path in Path(folder).iterdir() if path.suffix in (".src", ".csv")}


def test_runs_into_one_folder_leave_the_set_of_one_of_them():
    for place, force in (("a", 80), ("b", 240)):
        Path(place).mkdir()
        programs(2, place)
        for path in Path(place).glob("*.src"):
            path.write_text(path.read_text().replace("FX=80", f"FX={force}"))
        run("convert", place, "-o", f"alone_{place}", cell=CELL_16)
    alone = {place: sets(f"alone_{place}") for place in "ab"}
    assert alone["a"] != alone["b"]
    runs = [
        subprocess.Popen(
            [*COMMAND, "convert", place, "--cell", CELL_16, "-o", "out", "--jobs", jobs],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )
        for place, jobs in ("a1", "b2", "a2", "b1")
    ]  # fmt: skip
    told = [run.communicate(timeout=LONG)[1] for run in runs]
    assert [run.returncode for run in runs] == [0] * 4, told
    assert sets("out") in alone.values()
    assert written() == {"p00", "p01"}


def test_many_writers_never_leave_a_mixture_and_one_that_is_killed_blocks_nobody():
    command = [sys.executable, "-c", WRITER, "out"]
    writers = [
        subprocess.Popen([*command, f"writer {number}", "25"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for number in range(6)
    ]
    for writer in writers:
        writer.stdout.readline()
    for writer in writers:
        writer.stdin.write("go\n")
        writer.stdin.flush()
    writers[0].kill()
    for writer in writers:
        writer.communicate(timeout=LONG)
    assert [writer.returncode for writer in writers[1:]] == [0] * 5
    contents = {path.name: path.read_bytes() for path in Path("out").iterdir() if not path.name.startswith(".")}
    assert set(contents) == {"part.src", "part.csv", "part.json"}
    assert len(set(contents.values())) == 1
    assert not Path("out", ".postproc.lock").exists()
