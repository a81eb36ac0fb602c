"""`postproc robots add`: from a URDF to a model folder."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from msgspec import Struct

from postproc import kinematics
from postproc import robot as robots
from postproc.errors import InputError, ModelError
from postproc.files import read_text, toml, write_whole
from postproc.jobs.output_plan import protect
from postproc.robot.from_urdf import adopt

_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_COMMENT = "Written by `postproc robots add`. Units are in the names; assumed = true: not known of this robot."


class AddedRobot(Struct, frozen=True):
    """A model folder that was written.

    :param title: of the robot.
    :param folder: model folder.
    :param notes: what the user should know of it.
    """

    title: str
    folder: Path
    notes: tuple[str, ...]


def add_robot(
    urdf: Path, name: str | None = None, output: Path | None = None, *, overwrite: bool = False
) -> AddedRobot:
    """Make a model folder from the URDF of a KUKA arm.

    :param urdf: as ROS-Industrial writes them.
    :param name: of the robot and its folder; None = the name in the URDF.
    :param output: folder to write; None = one of that name in the working folder.
    :param overwrite: replace an existing model.
    :raises ModelError: the arm cannot be used.
    :raises InputError: a model exists already, or the name cannot be a folder's.
    """
    adopted = adopt(read_text(urdf, ModelError), urdf.name, name)
    known = name or re.sub(r"\W+", "_", adopted.content.name, flags=re.ASCII).strip("_")
    if not _NAME.fullmatch(known):
        raise InputError(f"{known!r} cannot be the name of a robot", advice="Give --name with letters, digits and _.")
    if known in robots.shipped():
        raise InputError(f"a shipped robot is called {known}", advice="Give another --name.")
    folder = output or Path(known)
    contents: dict[str, bytes | Iterable[bytes]] = {
        "model.toml": toml(adopted.content, _COMMENT),
        "robot.urdf": adopted.urdf(),
    }
    protect([urdf], folder, contents)
    there = [folder / file for file in contents if (folder / file).exists()]
    if there and not overwrite:
        raise InputError(
            "the folder holds a robot model already", file=str(there[0]), advice="Choose another -o, or --overwrite."
        )
    kinematics.closed_form(robots.assemble(known, adopted.content, adopted.chain))
    write_whole(folder, contents)
    return AddedRobot(adopted.content.name, folder, adopted.notes)
