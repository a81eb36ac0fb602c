"""One process at a time writes into a folder."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from filelock import BaseFileLock

_NAME = ".postproc.lock"
_POSIX = os.name == "posix"
_POLL = 0.1
"""Seconds between two attempts to take a lock that another process has (assumed)."""
_ATTEMPTS_BEFORE_MESSAGE = 3
"""Attempts before a message is shown (assumed)."""
_ATTEMPTS_WITHOUT_FOLDER = 100
"""Attempts to lock a folder that does not exist: on a missing drive it cannot be made."""
_locked_folders: set[Path] = set()
"""Folders that this process has locked, resolved."""


@contextlib.contextmanager
def lock(folders: Iterable[Path], waiting: Callable[[str], None] | None = None) -> Iterator[None]:
    """Lock folders against other processes of postproc, which wait until the lock is released.

    A folder is made if needed, and removed if it is still empty at the end. The lock is the operating system's
    (`flock`, `LockFileEx`), so a killed process leaves no lock. On a network drive without such locks,
    `filelock` uses the existence of a file that names the process. A folder that this process has locked is not locked
    again. A folder in which no file can be made is not locked: nothing can be written there either.

    :param waiting: is called once with a sentence when another process has a lock; None: nothing is said.
    """
    with contextlib.ExitStack() as locks:
        unlocked_folders = {folder.resolve() for folder in folders} - _locked_folders
        # the same order in each process: else two could wait for each other
        for folder in sorted(unlocked_folders):
            locks.enter_context(_lock_folder(folder, waiting))
        yield


@contextlib.contextmanager
def _lock_folder(folder: Path, waiting: Callable[[str], None] | None) -> Iterator[None]:
    """Lock a folder inside the context; make it if it is missing, and remove it afterwards if nothing was written.

    Goes on without a lock on drives that have none.

    :param waiting: is called with a message if another process has the lock.
    """
    from filelock import FileLock  # takes 15 ms, where files are written only

    new_folders = _missing_folders(folder)
    file_lock = FileLock(folder / _NAME)
    _acquire(file_lock, folder, waiting)
    _locked_folders.add(folder)
    try:
        is_lock_of_system = (
            file_lock.__class__ is FileLock
        )  # else filelock itself writes the file that names the process
        if file_lock.is_locked and is_lock_of_system:
            with contextlib.suppress(OSError):
                (folder / _NAME).write_text(_this_process(), encoding="utf-8")
        yield
    finally:
        _locked_folders.discard(folder)
        if file_lock.is_locked:
            if _POSIX:  # removed while locked: a process that has it open notices, and makes another
                with contextlib.suppress(OSError):
                    (folder / _NAME).unlink()
            file_lock.release()
        if not _POSIX:
            with contextlib.suppress(OSError):
                (folder / _NAME).unlink()
        for path in new_folders:
            with contextlib.suppress(OSError):
                path.rmdir()  # where nothing was written


def _acquire(file_lock: BaseFileLock, folder: Path, waiting: Callable[[str], None] | None) -> None:
    """Make a folder and wait for its lock; goes on without it if the folder cannot be made or the drive has no locks.

    :param waiting: is called with a message if another process has the lock.
    """
    from filelock import Timeout

    attempts = attempts_without_folder = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a drive without locks
        while True:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                file_lock.acquire(timeout=0)
                break
            except Timeout:
                attempts += 1
                if attempts == _ATTEMPTS_BEFORE_MESSAGE and waiting is not None:
                    waiting(f"{folder}: waiting for {_holder(folder)}, which writes into this folder.")
                time.sleep(_POLL)
            except FileNotFoundError:  # another process has just removed the empty folder, or it cannot be made
                attempts_without_folder += 1
                if attempts_without_folder > _ATTEMPTS_WITHOUT_FOLDER:
                    break
            except OSError:
                break


def _missing_folders(folder: Path) -> list[Path]:
    """Return the missing folders of a path, innermost first."""
    return [path for path in (folder, *folder.parents) if not path.exists()]


def _this_process() -> str:
    """Return what the lock file says of this process: number, machine, command and time."""
    command = " ".join(sys.argv[1:2])
    return f"process {os.getpid()} on {socket.gethostname()} (postproc {command}, since {time.strftime('%H:%M:%S')})"


def _holder(folder: Path) -> str:
    """Return the description of the process that holds the lock, from the lock file."""
    with contextlib.suppress(OSError, UnicodeDecodeError):
        description = (folder / _NAME).read_text(encoding="utf-8").strip()
        if description.startswith("process "):
            return description
        number, *machine = description.split() or [""]
        if number.isdecimal():  # as filelock writes it where there are no locks
            return f"process {number} on {' '.join(machine[:1])}"
    return "another process"
