"""Install posts in their hosts.

A host is a CAM program, such as FreeCAD; a post is the script with which it makes robot programs.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from postproc.errors import InputError

_SHARED_FOLDER = "postproc_host"
"""Folder next to the posts with the Python package that they share: it runs the command `postproc`."""
_SAFE_TEXT_MODULE = "safe_text.py"
"""Module of postproc that is copied into the shared folder, because the Python of a host cannot import postproc."""
_COMMAND_FILE = "command.json"
"""File in the shared folder with the command that runs postproc."""


@dataclass(frozen=True, slots=True)
class Host:
    """A CAM program that makes robot programs by a post.

    :param title: its name.
    :param post: file of the post.
    :param folders: where it looks for posts, the usual place first; those that exist are candidates. A place with `*`
        has a folder for each version, the newest of which is meant.
    :param use: what the user does in the host after the post is installed.
    """

    title: str
    post: str
    folders: tuple[str, ...]
    use: str


HOSTS = {
    "freecad": Host(
        title="FreeCAD",
        post="kuka_compensated_post.py",
        folders=(
            "~/.local/share/FreeCAD/v*/Macro",
            "~/Library/Application Support/FreeCAD/v*/Macro",
            "~/AppData/Roaming/FreeCAD/v*/Macro",
            "~/.local/share/FreeCAD/Macro",
            "~/.FreeCAD/Macro",
            "~/Library/Application Support/FreeCAD/Macro",
            "~/AppData/Roaming/FreeCAD/Macro",
        ),
        use="In the job's Output tab choose the processor kuka_compensated, with the arguments --cell CELL.toml "
        "--material NAME: stock and tools of the job give the forces (postproc forces --materials lists the names).",
    ),
    "robodk": Host(
        title="RoboDK",
        post="KUKA_KRC4_compensated.py",
        folders=(
            "C:/RoboDK/Posts",
            "~/RoboDK/Posts",
            "/opt/RoboDK/Posts",
            "/Applications/RoboDK.app/Contents/MacOS/Posts",
        ),
        use="Right-click the robot, 'Select Post Processor', KUKA_KRC4_compensated; the cell file is found as "
        "CELL.toml or cell.toml in the folder of the station, or by the environment variable POSTPROC_CELL.",
    ),
}


def _post_folder(host: Host, folder: Path | None) -> Path:
    """Return the folder of the host's post-processors.

    :param folder: as the user named it; None: the first of the host's usual places that exists.
    :raises InputError: the named folder does not exist, or the host is in none of its usual places.
    """
    if folder is not None:
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder")
        return folder
    for pattern in host.folders:
        for path in _candidate_folders(pattern):
            # where the folder of a version is, that of its posts may be missing: it is made with the first macro
            if path.is_dir() or "*" in pattern:
                return path
    first = next(Path(pattern).expanduser() for pattern in host.folders if "*" not in pattern)
    if first.parent.is_dir() and not first.anchor.startswith("C:"):  # on another system C:/… would be a relative path
        return first
    places = ", ".join(host.folders)
    raise InputError(f"{host.title} is in none of its usual places ({places}): name its folder of posts with --dir")


def _candidate_folders(pattern: str) -> list[Path]:
    """Return the folders that a pattern with `~`, and `*` in its last but one part, means; the newest version first.

    They need not exist; with `*` their parents do.
    """
    parent = Path(pattern).expanduser().parent

    def version(folder: Path) -> list[int]:
        """Return the numbers in the name of a folder: [1, 0] of v1-0."""
        return [int(number) for number in re.findall(r"\d+", folder.name)]

    parents = sorted(parent.parent.glob(parent.name), key=version, reverse=True) if "*" in pattern else [parent]
    return [folder / Path(pattern).name for folder in parents]


def install_post(name: str, folder: Path | None = None) -> list[Path]:
    """Copy the post of a host to the folder where the host looks for posts, with the command that runs this postproc.

    A host is a CAM program, such as FreeCAD. Its post needs the shared folder next to it.

    :param name: a key of `HOSTS`.
    :param folder: the folder of the host's posts; None: the first of its usual places that exists.
    :return: the written files.
    :raises InputError: there is no such place, or it cannot be written to.
    """
    host = HOSTS[name]
    target = _post_folder(host, folder)
    source = Path(__file__).parent
    shared_folder = target / _SHARED_FOLDER
    post = target / host.post
    package_file = shared_folder / "__init__.py"
    command_file = shared_folder / _COMMAND_FILE
    module_file = shared_folder / _SAFE_TEXT_MODULE
    try:
        shared_folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / host.post, post)
        shutil.copyfile(source / _SHARED_FOLDER / "__init__.py", package_file)
        shutil.copyfile(source.parent / _SAFE_TEXT_MODULE, module_file)
        content = {"command": _host_command(target)}
        command_file.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as cause:
        raise InputError(f"{target}: the post cannot be written there: {cause.strerror}.") from cause
    return [post, package_file, command_file, module_file]


def remove_post(name: str, folder: Path | None = None) -> list[Path]:
    """Remove the post of a host, a CAM program, from its folder of posts.

    The folder that posts share is removed too, unless it is still needed: the post of another host is in the folder.

    :param name: a key of `HOSTS`.
    :param folder: the folder of the host's posts; None: the first of its usual places that exists.
    :return: the removed files; empty if no post was there.
    :raises InputError: there is no such place, or it cannot be written to.
    """
    host = HOSTS[name]
    target = _post_folder(host, folder)
    other_posts = [target / other_host.post for other_host in HOSTS.values() if other_host is not host]
    is_shared_folder_needed = any(path.is_file() for path in other_posts)
    files = [target / host.post]
    if not is_shared_folder_needed:
        files += [target / _SHARED_FOLDER / file for file in ("__init__.py", _COMMAND_FILE, _SAFE_TEXT_MODULE)]
    existing_files = [path for path in files if path.is_file()]
    try:
        for path in existing_files:
            path.unlink()
        if not is_shared_folder_needed:
            shutil.rmtree(target / _SHARED_FOLDER, ignore_errors=True)
    except OSError as cause:
        raise InputError(f"{target}: the post cannot be removed: {cause.strerror}.") from cause
    return existing_files


def _host_command(folder: Path) -> list[str]:
    """Return the command that runs this postproc from the host.

    If postproc runs in WSL, the Linux of Windows, and the host on Windows, the command is run by `wsl`.

    :param folder: the folder of the host's posts.
    """
    words = [sys.executable, "-m", "postproc"]
    is_wsl = "microsoft" in platform.release().lower()
    is_on_windows_drive = folder.resolve().parts[1:2] == ("mnt",)  # /mnt/c/… is C:/…
    if not (is_wsl and is_on_windows_drive):
        return words
    distribution = os.environ.get("WSL_DISTRO_NAME")
    return ["wsl", *(["-d", distribution] if distribution else []), "--", *words]
