"""Files that belong together are replaced all or none, whatever fails in between."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from postproc.errors import InputError
from postproc.files import lock, remove_leftovers, write_whole

NEW = {"part.src": b"new program", "part.csv": b"new table", "part.json": b"new report"}
OLD = {"part.src": b"old program", "part.csv": b"old table", "part.json": b"old report"}


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "out"


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def failing(monkeypatch, name: str, nth: int, cause: BaseException) -> list[str]:
    """Let the n-th call of a function of `os` fail; return the names it was called with."""
    real, calls = getattr(os, name), []

    def wrapped(source, *rest, **options):
        calls.append(Path(str(source)).name)
        if len(calls) == nth:
            raise cause
        return real(source, *rest, **options)

    monkeypatch.setattr(os, name, wrapped)
    return calls


def test_all_files_are_written_also_from_pieces_made_as_they_are_written(folder):
    written = write_whole(folder, {"a": b"one", "b": (str(n).encode() for n in range(3))})
    assert written == [folder / "a", folder / "b"]
    assert content(folder) == {"a": b"one", "b": b"012"}


def test_the_first_goes_first_and_comes_last(folder, monkeypatch):
    write_whole(folder, OLD)
    gone = failing(monkeypatch, "rename", 0, OSError())
    come = failing(monkeypatch, "replace", 0, OSError())
    write_whole(folder, NEW)
    assert (gone, come) == (["part.src", "part.csv", "part.json"], ["part.json", "part.csv", "part.src"])
    assert content(folder) == NEW


SOME = {"part.csv": b"old table"}
STEPS = [
    *((earlier, "rename", nth) for earlier in (SOME, OLD) for nth in range(1, len(earlier) + 1)),
    *((earlier, "replace", nth) for earlier in ({}, SOME, OLD) for nth in range(1, len(NEW) + 1)),
]


@pytest.mark.parametrize(("earlier", "call", "nth"), STEPS)
@pytest.mark.parametrize("cause", [PermissionError(errno.EACCES, "Access is denied"), MemoryError()])
def test_whatever_step_of_the_replacing_fails_what_was_there_is_there_again(
    folder, monkeypatch, earlier, call, nth, cause
):
    folder.mkdir()
    for name, old in earlier.items():
        (folder / name).write_bytes(old)
    with monkeypatch.context() as patch:
        failing(patch, call, nth, cause)
        with pytest.raises((InputError, MemoryError)) as caught:
            write_whole(folder, NEW)
    assert content(folder) == earlier
    if isinstance(caught.value, InputError):
        assert "Access is denied" in str(caught.value)
        assert "no other program has the file open" in str(caught.value)


@pytest.mark.parametrize("name", NEW)
def test_a_file_that_another_program_has_open_is_named(folder, monkeypatch, name):
    write_whole(folder, OLD)
    real = os.rename

    def rename(source, target):
        if Path(source) == folder / name:  # as Windows answers when Excel has it open
            raise PermissionError(errno.EACCES, "The process cannot access the file", str(source))
        real(source, target)

    monkeypatch.setattr(os, "rename", rename)
    with pytest.raises(InputError, match="cannot access the file") as caught:
        write_whole(folder, NEW)
    assert caught.value.file == str(folder / name)
    assert content(folder) == OLD


@pytest.mark.parametrize("name", NEW)
def test_a_folder_in_the_place_of_a_file_is_named_and_stays(folder, name):
    write_whole(folder, {other: OLD[other] for other in OLD if other != name})
    (folder / name / "inside").mkdir(parents=True)
    with pytest.raises(InputError, match="a folder of that name is in the way") as caught:
        write_whole(folder, NEW)
    assert caught.value.file == str(folder / name)
    assert (folder / name / "inside").is_dir()
    assert {path.name for path in folder.iterdir()} == set(OLD)


def test_if_an_old_file_cannot_be_put_back_it_is_kept_and_the_message_says_where(folder, monkeypatch):
    write_whole(folder, OLD)
    real = os.rename

    def rename(source, target):
        if Path(target) == folder / "part.csv":
            raise PermissionError(errno.EACCES, "Access is denied")
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "rename", rename)
        failing(patch, "replace", 2, PermissionError(errno.EACCES, "Access is denied"))
        with pytest.raises(InputError, match=r"could not be put back: part\.csv") as caught:
            write_whole(folder, NEW)
    assert Path(caught.value.file, "part.csv").read_bytes() == OLD["part.csv"]
    assert (folder / "part.src").read_bytes() == OLD["part.src"]


def test_content_that_cannot_be_made_leaves_what_was_there(folder):
    def pieces():
        yield b"one"
        raise ZeroDivisionError

    write_whole(folder, OLD)
    with pytest.raises(ZeroDivisionError):
        write_whole(folder, {**NEW, "part.json": pieces()})
    assert content(folder) == OLD


def test_a_single_file_is_replaced_in_one_step(folder, monkeypatch):
    write_whole(folder, {"a.toml": b"old"})
    monkeypatch.setattr(os, "rename", None)
    write_whole(folder, {"a.toml": b"new"})
    assert content(folder) == {"a.toml": b"new"}


@pytest.mark.skipif(os.name != "posix", reason="symbolic links")
def test_a_link_is_replaced_and_what_it_points_to_is_left(folder, tmp_path):
    folder.mkdir()
    (tmp_path / "mine").write_bytes(b"mine")
    (folder / "part.src").symlink_to(tmp_path / "mine")
    write_whole(folder, NEW)
    assert content(folder) == NEW
    assert (tmp_path / "mine").read_bytes() == b"mine"


@pytest.mark.skipif(os.name != "posix", reason="rights of POSIX")
def test_files_have_the_rights_that_the_user_gives_to_new_files(folder):
    before = os.umask(0o027)
    try:
        write_whole(folder, NEW)
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o640}


@pytest.mark.skipif(os.name != "posix", reason="sends a POSIX signal")
def test_leftovers_of_a_killed_process_are_removed_and_those_of_a_living_one_are_locked(folder):
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom postproc.files import write_whole\n"
        "def wait():\n    print(flush=True)\n    time.sleep(1000)\n    yield b''\n"
        "write_whole(Path(sys.argv[1]), {'a': wait()})"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        assert {path.suffix for path in folder.iterdir()} == {".tmp", ".lock"}
        said = []

        def waiting(sentence):
            said.append(sentence)
            process.send_signal(signal.SIGKILL)

        with lock([folder], waiting):
            assert process.wait() == -signal.SIGKILL
            remove_leftovers(folder)
        assert f"{folder}: waiting for process {process.pid} on " in said[0]
        assert len(said) == 1
    assert not folder.exists() or list(folder.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_an_error_and_no_endless_wait(tmp_path, monkeypatch):
    def missing(self, *_, **__):
        raise FileNotFoundError(2, "no such drive", str(self))

    monkeypatch.setattr(Path, "mkdir", missing)
    with pytest.raises(InputError, match="cannot be written"):
        write_whole(tmp_path / "drive" / "out", {"part.src": b"x"})
