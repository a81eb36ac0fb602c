"""`postproc robots add`: from a URDF to a model folder."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from msgspec import Struct

from postproc import kinematics
from postproc import robot as robots
from postproc.errors import InputError, ModelError
from postproc.files import read_text, toml, write_whole
from postproc.frames import MM_PER_M
from postproc.jobs.output_plan import protect
from postproc.robot import JOINTS, shapes
from postproc.robot.from_urdf import Adopted, adopt
from postproc.robot.shapes import LinkShape
from postproc.robot.urdf import Geometry, geometries

_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_COMMENT = "Written by `postproc robots add`. Units are in the names; assumed = true: not known of this robot."
_TRIANGLES = 1000
"""Triangles of a link that pages draw."""


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
    text = read_text(urdf, ModelError)
    adopted = adopt(text, urdf.name, name)
    known = name or re.sub(r"\W+", "_", adopted.content.name, flags=re.ASCII).strip("_")
    if not _NAME.fullmatch(known):
        raise InputError(f"{known!r} cannot be the name of a robot", advice="Give --name with letters, digits and _.")
    if known in robots.shipped():
        raise InputError(f"a shipped robot is called {known}", advice="Give another --name.")
    folder = output or Path(known)
    meshes, notes = _meshes(geometries(text, urdf.name), urdf, adopted)
    contents: dict[str, bytes | Iterable[bytes]] = {
        "model.toml": toml(adopted.content, _COMMENT),
        "robot.urdf": adopted.urdf({key: _file(*key) for key in meshes}),
        **{_file(*key): surface.stl() for key, surface in meshes.items()},
    }
    protect([urdf], folder, contents)
    there = [folder / file for file in contents if (folder / file).exists()]
    if there and not overwrite:
        raise InputError(
            "the folder holds a robot model already", file=str(there[0]), advice="Choose another -o, or --overwrite."
        )
    kinematics.closed_form(robots.assemble(known, adopted.content, adopted.chain))
    write_whole(folder, contents)
    return AddedRobot(adopted.content.name, folder, (*adopted.notes, *notes))


def _file(carrier: int, kind: str) -> str:
    """Return the name of the mesh of a link."""
    name = "base" if carrier < 0 else JOINTS[carrier]
    return f"{name}.stl" if kind == "visual" else f"{name}_collision.stl"


def _meshes(
    named: Sequence[Geometry], urdf: Path, adopted: Adopted
) -> tuple[dict[tuple[int, str], LinkShape], list[str]]:
    """Return the shapes of the links in the frames of the model: those that are drawn, simplified, and solids.

    :returns: (carrier, "visual" or "collision") → surface, and notes. A link without <collision> has its hull.
    """
    if not named:
        return {}, ["the URDF names no shapes: pages draw the arm as solids of revolution"]
    drawn, missing = shapes.read([each for each in named if each.drawn], urdf)
    solid, more = shapes.read([each for each in named if not each.drawn], urdf)
    drawn, solid = (
        [each.moved(adopted.moved[each.carrier + 1]) for each in shapes.joined(found)] for found in (drawn, solid)
    )
    with_drawing = {each.carrier for each in drawn}
    with_solid = {each.carrier for each in solid}
    solids = solid + [each.hull() for each in drawn if each.carrier not in with_solid]
    drawings = drawn + [each for each in solid if each.carrier not in with_drawing]
    simple = [shapes.simplified(each, _TRIANGLES) for each in drawings]
    kept = [each for each, _ in simple]
    notes = [f"a shape is left out: {problem}" for problem in dict.fromkeys(missing + more)]
    if kept:
        count, was = (sum(len(each.faces) for each in some) for some in (kept, drawings))
        size = 16 * (count + sum(len(each.points) for each in kept))  # three numbers of 4 bytes each, in base64
        less = (
            ""
            if count == was
            else f" of {was}, corners moved by at most {max(moved for _, moved in simple) * MM_PER_M:.2g} mm"
        )
        notes.append(f"shapes of {len(kept)} links: {count} triangles{less}; {size / 1000:.0f} kB in a page")
    elif notes:
        notes.append("pages draw the arm as solids of revolution")
    out = {(each.carrier, "visual"): each for each in kept}
    return out | {(each.carrier, "collision"): each for each in solids}, notes
