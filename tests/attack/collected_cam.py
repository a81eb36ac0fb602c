"""Collected cutter-location files and RAPID modules against small readers that share no code with the package.

What is compared of a cutter-location file: each GOTO outside of a cycle is a target, in order; below each GOTO of a
cycle there is a target on the axis of the hole; each arc turns about a centre that a CIRCLE states. Of a RAPID module:
each target of a Cartesian move is one that the text states as numbers.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.dialects import apt
from postproc.dialects.apt.reader import APT
from postproc.dialects.rapid.dialect import RAPID
from postproc.dialects.text import decode
from postproc.errors import PostprocError
from postproc.frames import Array
from postproc.program import CIRC, Program
from tests.dialects.gcode_reading import forward
from tests.dialects.rapid_reading import place

APT_NAMES = {*APT.extensions, ".1", ".2", ".8", ".clt"}
"""Creo adds a version: part.ncl.1."""
RAPID_NAMES = {".mod", ".modx", ".prg", ".sys", ".sysx"}
NEAR_MM = 1e-3
ON_CIRCLE_MM = 0.03
_COMMENT, _CONTINUED = re.compile(r"\$\$[^\r\n]*"), re.compile(r"\$[ \t]*\r?\n")
_MOVING = re.compile(r"GOHOME|RETRCT|FROM|GODLTA|TLON|GOTO/[^\n]*[A-Z]")
MODULE = re.compile(r"(?im)^\s*MODULE\s+\w")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?"
_POSITION = re.compile(rf"\[\s*\[\s*({_NUMBER})\s*,\s*({_NUMBER})\s*,\s*({_NUMBER})\s*\]\s*,\s*\[", re.IGNORECASE)
_COMPUTED = re.compile(r"(?i)\bOFFS\b|\bRELTOOL\b|\.trans\b|:=\s*\[*\w*[a-z]\w*\s*[+*]")


class Stated(NamedTuple):
    """Places that a cutter-location file states [mm].

    :param places: of GOTO outside of cycles, without repeated ones.
    :param holes: of GOTO in cycles.
    :param centres: of CIRCLE and MOVARC.
    """

    places: list[Array]
    holes: list[Array]
    centres: list[Array]


def stated(text: str) -> Stated:
    """Read the places of a cutter-location file."""
    body = _CONTINUED.sub("", _COMMENT.sub("", text)).upper().replace(" ", "").replace("\t", "")
    found = Stated([], [], [])
    unit, in_cycle = 1.0, False
    for statement in body.splitlines():
        word, _, rest = statement.partition("/")
        if word in ("FINI", "END"):
            break
        if word in ("UNITS", "UNIT"):
            unit = 25.4 if rest.startswith("IN") else 10.0 if rest.startswith("CM") else 1.0
        elif word == "CYCLE":
            in_cycle = rest not in ("OFF", "INIT", "CLEAR", "")
        elif word in ("GOTO", "CIRCLE", "MOVARC"):
            point = np.array([float(number) for number in rest.split(",")[:3]]) * unit
            if word != "GOTO":
                found.centres.append(point)
            elif in_cycle:
                found.holes.append(point)
            elif not found.places or np.abs(point - found.places[-1]).max() > NEAR_MM / 1e3:
                found.places.append(point)
    return found


def difference(program: Program, text: str) -> str:
    """Return the first difference between a program and the places that its file states; empty if there is none."""
    expected, motions = stated(text), program.motions
    ends = motions.target[:, :3, 3] * 1e3
    is_new = np.append(True, np.abs(np.diff(ends, axis=0)).max(axis=1) > NEAR_MM / 1e3)
    places = ends[is_new]  # as in the text: without tool changes, where the tip stays, and ends of whole circles
    is_plain = not expected.holes and not _MOVING.search(_COMMENT.sub("", text).upper())
    last = -1
    for k, point in enumerate(expected.places):
        steps = np.flatnonzero(np.abs(places[last + 1 :] - point).max(axis=1) < NEAR_MM)
        if not len(steps):
            return f"GOTO {k + 1} at {point.tolist()} is no target"
        if steps[0] and is_plain:
            return f"{steps[0]} targets before GOTO {k + 1} are not in the file"
        last += 1 + int(steps[0])
    for top in expected.holes:
        offset = ends - top
        axis = -motions.target[:, :3, 2]  # from the tip to the spindle
        height = np.einsum("ni,ni->n", offset, axis)
        if not ((np.abs(offset - height[:, None] * axis).max(axis=1) < NEAR_MM) & (height < -NEAR_MM)).any():
            return f"no target below the hole at {top.tolist()}"
    for arc in np.flatnonzero(motions.kind == CIRC):
        centre, normal = motions.centre[arc] * 1e3, motions.normal[arc]
        offset = np.array(expected.centres) - centre if expected.centres else np.full((1, 3), np.inf)
        across = offset - (offset @ normal)[:, None] * normal
        if "TLON" not in text and np.linalg.norm(across, axis=1).min() > ON_CIRCLE_MM:
            return f"line {motions.line[arc]}: no CIRCLE is about the centre {centre.tolist()}"
    return ""


def tried_apt(path: Path, cell: Cell) -> tuple[str, str]:
    """Return what came of a cutter-location file: a word, and the reason."""
    document = decode(path.name, path.read_bytes())
    tools = {number: replace(cell.tool) for number in re.findall(r"LOAD(?:TL\s*/|/TOOL,)\s*(\d+)", document.text)}
    try:
        program = apt.read(document, replace(cell, tools=tools), forward, "part")
    except PostprocError as error:
        return "refused", str(getattr(error, "problem", error))
    found = difference(program, document.text)
    return ("differs", found) if found else ("same", "")


def tried_rapid(path: Path) -> tuple[str, str]:
    """Return what came of a RAPID module: a word, and the reason."""
    document, robot = decode(path.name, path.read_bytes()), place()
    if not MODULE.search(document.text):
        return "no module", ""
    try:
        program = RAPID.read([document], robot.cell, robot.forward, path.stem)
    except PostprocError as error:
        problem = str(getattr(error, "problem", error))
        return ("no motions" if "no motions" in problem or "no PROC" in problem else "refused"), problem
    places = np.array([[float(number) for number in match] for match in _POSITION.findall(document.text)])
    if _COMPUTED.search(document.text):
        return "read, with computed targets", ""
    motions = program.motions
    for n in np.flatnonzero(np.isnan(np.asarray(motions.joints[:])).all(axis=1)):
        end = motions.target[n, :3, 3] * 1e3
        if not len(places) or np.abs(places - end).max(axis=1).min() > NEAR_MM:
            return "differs", f"line {motions.line[n]}: {end.tolist()} is not stated"
    return "same", ""
