"""From a program and its process to forces along its motions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from postproc.errors import MOST, ForceError, Issue, together
from postproc.frames import M_PER_MM, Array, inverse
from postproc.machining import stock as stocks
from postproc.machining.continuous import AlongMotions, without_steps
from postproc.machining.material import CuttingLaw
from postproc.machining.process import Process, box_corners
from postproc.machining.running import Running, running
from postproc.machining.stock import Stock
from postproc.machining.sweep import Cuts, Sweep
from postproc.machining.thinning import thinned
from postproc.machining.unseen import kept, refuse_unseen
from postproc.machining.ways import Shift, Ways, spindle, ways
from postproc.program import Bools, Program
from postproc.toolpath import Segments

_SAME = np.cos(np.radians(0.5))
"""Cosine of the angle between directions of the tool that are one."""
_INCH = 25.4
_HOLLOW = 0.02
"""Of the volume of a stock: more than this share too much in its map is told."""
_LARGE = 5.0
"""A path so many times as large as the stock, in X and in Y, is told."""
_DEEP = 4.0
"""Depths of cut beyond so many diameters are told: no cutter does that."""
_BATCH = 200_000
"""So many stations are kept before they are thinned out."""


class ProcessForces(Struct, frozen=True, eq=False):
    """What a process makes of a program.

    :param along: the forces along its cutting motions.
    :param cuts: wrench and engagement at stations on them, as many as show how they change, see `Cuts`.
    :param peak: (M, 2) largest force [N] and torque [N·m] within a turn on each motion.
    :param power: (M,) largest mean power of the spindle on each motion [W].
    :param turning: tool and spindle speed of each motion.
    :param stock: what is left of it, in the frame of `map_in_base`.
    :param map_in_base: (4, 4) frame of the map of the stock in `$BASE` of the first cutting motion.
    :param removed: volume [m³].
    :param issues: what the user should know.
    """

    along: AlongMotions
    cuts: Cuts
    peak: Array
    power: Array
    turning: Running
    stock: Stock
    map_in_base: Array
    removed: float
    issues: tuple[Issue, ...]

    def mesh(self) -> tuple[Array, NDArray[np.int64]]:
        """Return what is left of the stock as a closed mesh in `$BASE`: vertices (V, 3) [m], faces (F, 3)."""
        vertices, faces = stocks.mesh_of(self.stock)
        return vertices @ self.map_in_base[:3, :3].T + self.map_in_base[:3, 3], faces


def estimate(
    program: Program,
    path: Segments,
    process: Process,
    axis: str,
    ramp: float,
    *,
    stock: Path | None = None,
    base_axes: bool = False,
    shift: Shift | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ProcessForces:
    """Return the cutting forces of a program.

    :param path: where its motions start.
    :param axis: axis of the tool frame that points from the spindle to the tip: "+Z", "-Z", "+X" or "-X".
    :param ramp: over which length the force comes up where a motion begins [m].
    :param stock: mesh of the stock, instead of that of the process.
    :param base_axes: give all wrenches in `$BASE` axes.
    :param shift: displacement of the tip, see `Shift`.
    :param progress: called with the number of straight ways done, and of all.
    :raises ProgramError: a routine that cuts is not followed.
    :raises ForceError: what is not in the process, a stock that cannot be used, no contact at all, a spindle that
        stands still while it cuts, a tool that changes its direction while it cuts.
    """
    refuse_unseen(program)
    law = process.law()
    turning = running(program, process)
    cell = process.stock.resolution_mm * M_PER_MM
    setups = _setups(program, axis)
    material, told = _stock(process, setups[0].frame, cell, stock)
    start, removed = material.volume(), 0.0
    bounds = (*material.bounds, material.top)
    every = ways(program, path, turning, setups[0].frame, cell, shift)
    _check_speed(program, every, turning)
    total = len(every.motion)
    done, parts, sweeps, along = 0, [], [], []
    for number, setup in enumerate(setups):
        if number:
            removed += start - material.volume()
            left = material.volume()
            material = _turned(material, setups[number - 1].frame, setup.frame, cell)
            start = material.volume()
            told += _hollows(start, left)
        steps = ways(program, path, turning, setup.frame, cell, shift).of(setup.motions)
        sweep = Sweep(material, process, turning, program.motions.feed, law)
        cuts = _thinned(sweep, steps, _told_by(progress, done, total))
        done += len(steps.motion)
        sweeps.append(sweep)
        parts.append(cuts)
        stations = cuts.motion, cuts.t, cuts.wrench
        along.append(without_steps(program, path, stations, setup.frame, ramp, law.sigma, base_axes=base_axes))
    if not any(sweep.contact for sweep in sweeps):
        raise _no_contact(program, every, bounds, process, stock)
    cuts = Cuts.joined(parts)
    # where a tip stands that comes back from its deflection is no matter of a rapid move
    collided = set[int]() if shift is not None else set[int]().union(*(sweep.collided for sweep in sweeps))
    stood = set[int]().union(*(sweep.stood for sweep in sweeps))
    told += kept(program)
    told += _out_of_scale(every, bounds)
    told += _told(program, (collided, stood), law, cuts, turning, process)
    power = np.zeros(len(program.motions))
    np.maximum.at(power, cuts.motion, cuts.power)
    return ProcessForces(
        along=AlongMotions.joined(along),
        cuts=cuts,
        peak=np.max([sweep.peak for sweep in sweeps], axis=0),
        power=power,
        turning=turning,
        stock=material,
        map_in_base=setups[-1].frame,
        removed=removed + start - material.volume(),
        issues=tuple(told),
    )


def _told_by(progress: Callable[[int, int], None] | None, before: int, total: int) -> Callable[[int], None] | None:
    return None if progress is None else lambda done: progress(before + done, total)


def _thinned(sweep: Sweep, steps: Ways, progress: Callable[[int], None] | None) -> Cuts:
    """Return the stations that are needed; stations are thinned out as they come, so that few are kept at a time."""
    done: list[Cuts] = []
    open_: list[Cuts] = []
    waiting = 0
    for part in sweep.run(steps, progress):
        open_.append(part)
        waiting += len(part.t)
        if waiting > _BATCH:
            joined = Cuts.joined(open_)
            whole = int(np.searchsorted(joined.motion, joined.motion[-1], side="left"))
            rest, joined = joined.take(slice(whole, None)), joined.take(slice(None, whole))
            done.append(joined.take(thinned(joined.motion, joined.wrench)))
            open_, waiting = [rest], len(rest.t)
    joined = Cuts.joined(open_)
    return Cuts.joined([*done, joined.take(thinned(joined.motion, joined.wrench))])


class _Setup(Struct, frozen=True, eq=False):
    """Motions during which the tool keeps its direction.

    :param frame: (4, 4) frame of the map in `$BASE` of the first cutting motion: z from the tip to the spindle.
    :param motions: (M,) True for those motions.
    """

    frame: Array
    motions: Bools


def _setups(program: Program, axis: str) -> list[_Setup]:
    """Return what is cut in one direction of the tool each, in order.

    Motions that turn the tool without cutting belong to none.

    :raises ForceError: the tool changes its direction while it cuts, or from one cutting move to the next.
    """
    towards, cuts = spindle(program, axis), ~program.motions.rapid
    if not cuts.any():
        raise ForceError("no cutting move in this program", file=program.documents[0].name)
    turned = np.ones(len(towards))
    turned[1:] = np.einsum("ni,ni->n", towards[1:], towards[:-1])
    still = turned > _SAME
    first = towards[int(np.argmax(cuts))]
    if (towards[cuts] @ first > _SAME).all():
        return [_Setup(_frame(first), np.ones(len(towards), dtype=bool))]
    setups, rows, now, fresh = [], np.zeros(len(towards), dtype=bool), first, True
    for motion in range(len(towards)):
        same = bool(towards[motion] @ now > _SAME)
        if cuts[motion] and not (still[motion] and (same or fresh)):
            before = towards[motion - 1] if same or not still[motion] else now
            raise ForceError(
                "the tool changes its direction while it cuts, by "
                f"{np.degrees(np.arccos(np.clip(towards[motion] @ before, -1.0, 1.0))):.1f}°",
                file=program.documents[0].name,
                line=int(program.motions.line[motion]),
                advice="Forces are computed for one direction of the tool at a time: it may change in rapid moves. "
                "Give forces for such moves by [operations] or as a CSV file.",
            )
        if cuts[motion] and not same:
            setups.append(_Setup(_frame(now), rows))
            rows, now = np.zeros(len(towards), dtype=bool), towards[motion]
            same = True
        rows[motion] = same and still[motion]
        fresh = not cuts[motion]
    return [*setups, _Setup(_frame(now), rows)]


def _frame(towards: Array) -> Array:
    """Return the frame of the map (4, 4) in `$BASE` whose z is a direction (3,) from the tip to the spindle."""
    frame = np.eye(4)
    if towards[2] < 1.0 - 1e-9:
        x = np.array([1.0, 0.0, 0.0]) if abs(towards[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        y = np.cross(towards, x)
        y /= np.linalg.norm(y)
        frame[:3, :3] = np.stack([np.cross(y, towards), y, towards], axis=-1)
    return frame


def _turned(material: Stock, before: Array, frame: Array, cell: float) -> Stock:
    """Return what is left of a stock as a map for another direction of the tool."""
    vertices, faces = stocks.mesh_of(material)
    to_map = inverse(frame) @ before
    return stocks.from_mesh(vertices @ to_map[:3, :3].T + to_map[:3, 3], faces, cell)


def _stock(process: Process, frame: Array, cell: float, given: Path | None) -> tuple[Stock, list[Issue]]:
    """Return the map of the stock, and what there is to say of it."""
    table = process.stock
    if given is None and table.box is not None and table.file is not None:
        raise ForceError("[stock] has a box and a file", file=process.path, advice="Give one of them.")
    if given is None and table.file is not None:
        given = Path(process.path).parent / table.file
    to_map = inverse(frame)
    if given is None:
        if table.box is None:
            advice = "Give [stock] box or file, or --stock STOCK.stl."
            raise ForceError("no stock", file=process.path, advice=advice)
        low, high = box_corners(table.box)
        if np.array_equal(frame, np.eye(4)):
            return stocks.from_box(low, high, cell, process.path), []
        import trimesh

        box = trimesh.creation.box(bounds=np.stack([low, high]))
        vertices, faces, name = np.asarray(box.vertices), np.asarray(box.faces), process.path
        volume = float(np.prod(high - low))
    else:
        mesh, name = _mesh(given), str(given)
        pose = table.place.pose()
        vertices = np.asarray(mesh.vertices, dtype=float) * M_PER_MM @ pose[:3, :3].T + pose[:3, 3]
        faces, volume = np.asarray(mesh.faces, dtype=np.int64), abs(float(mesh.volume)) * M_PER_MM**3
    material = stocks.from_mesh(vertices @ to_map[:3, :3].T + to_map[:3, 3], faces, cell, name)
    return material, _hollows(material.volume(), volume)


def _hollows(mapped: float, volume: float) -> list[Issue]:
    """Tell where the map of a stock holds more than the stock: (volumes in m³)."""
    hollow = mapped / max(volume, 1e-18) - 1.0
    if hollow <= _HOLLOW:
        return []
    message = (
        "the stock has hollows or undercuts, seen along the tool: they are taken for material "
        f"({100 * hollow:.0f} % more than the mesh holds)"
    )
    return [Issue("warning", "hollow-stock", message)]


def _mesh(path: Path) -> Any:
    """Read a closed mesh.

    :raises ForceError: it cannot be read, holds no surface or is not closed.
    """
    import trimesh

    if not path.is_file():
        raise ForceError("no such file", file=str(path), advice="A stock is a closed mesh in mm: STL, OBJ, PLY, GLB.")
    try:
        mesh: Any = trimesh.load(path, force="mesh")
    except (ValueError, OSError, KeyError, IndexError, TypeError, NotImplementedError) as cause:
        raise ForceError(f"not a mesh that trimesh reads ({cause})", file=str(path)) from cause
    if len(getattr(mesh, "faces", [])) == 0 or not np.isfinite(mesh.vertices).all():
        raise ForceError("the mesh has no surface", file=str(path))
    if not mesh.is_watertight:
        mesh.merge_vertices()
    if not mesh.is_watertight:
        advice = "Close it in CAD or with a mesh repair tool: what is inside is not defined by an open surface."
        raise ForceError("the mesh of the stock is not closed", file=str(path), advice=advice)
    return mesh


def _check_speed(program: Program, steps: Ways, turning: Running) -> None:
    """A spindle without a speed cannot cut.

    :raises ForceError: no cutting move has one.
    """
    motion = np.unique(steps.motion[steps.cutting])
    if len(motion) and not (turning.rpm[motion] > 0.0).any():
        spun = [event for event in program.events if event.kind in ("spindle_on", "spindle_ccw")]
        first = int(program.motions.line[motion[0]])
        name = program.documents[0].name
        if spun:
            problem, line = "the spindle is started without a speed", spun[0].line
        else:
            problem, line = "the spindle is never started", first
        advice = "Give S and M3 in the program, or [tools.n] rpm in the process file."
        raise ForceError(problem, file=name, line=line, advice=advice)


def _told(
    program: Program, met: tuple[set[int], set[int]], law: CuttingLaw, cuts: Cuts, turning: Running, process: Process
) -> list[Issue]:
    """Return what the user should know.

    :param met: motions that met material: rapid ones, and those during which the spindle stands still.
    :raises ForceError: the spindle stands still on cutting moves that meet material.
    """
    lines, name = program.motions.line, program.documents[0].name
    collided, stood = met
    if stood:
        advice = "Start the spindle (M3 S…) before it cuts, or lift the tool."
        raise together(
            ForceError(
                "the tool is moved through material while the spindle stands still", file=name, line=line, advice=advice
            )
            for line in sorted({int(lines[motion]) for motion in stood})[: MOST + 1]
        )
    told = []
    if collided:
        hit = sorted({int(lines[motion]) for motion in collided})
        message = (
            f"a rapid move goes through material (line {', '.join(map(str, hit[:5]))}{' …' if len(hit) > 5 else ''})"
        )
        told.append(Issue("warning", "rapid-in-material", message, hit[0], count=len(hit)))
    if law.warning is not None:
        told.append(Issue("warning", "material", law.warning))
    diameter = np.array([process.tools[key].diameter_mm * M_PER_MM for key in turning.keys])
    deep = np.flatnonzero(cuts.depth > _DEEP * diameter[turning.tool[cuts.motion]])
    if len(deep):
        worst = deep[int(np.argmax(cuts.depth[deep]))]
        message = (
            f"a depth of cut of {cuts.depth[worst] * 1e3:.4g} mm, more than {_DEEP:g} diameters: check place and units "
            "of the stock (an inch is 25.4 mm)"
        )
        told.append(Issue("warning", "deep-cut", message, int(lines[cuts.motion[worst]]), count=len(deep)))
    return told


def _out_of_scale(steps: Ways, bounds: tuple[float, ...]) -> list[Issue]:
    """Tell where the path is many times as large as the stock, though it meets it."""
    x0, x1, y0, y1, _ = bounds
    low = np.minimum(steps.begin, steps.end)[steps.cutting, :2].min(axis=0)
    high = np.maximum(steps.begin, steps.end)[steps.cutting, :2].max(axis=0)
    ratio = float(((high - low) / np.maximum([x1 - x0, y1 - y0], 1e-9)).min())
    if ratio < _LARGE:
        return []
    message = (
        f"the path is {ratio:.0f} times as large as the stock in X and Y: check the units of both (an inch is 25.4 mm)"
    )
    return [Issue("warning", "stock-scale", message)]


def _no_contact(
    program: Program, steps: Ways, bounds: tuple[float, ...], process: Process, stock: Path | None
) -> ForceError:
    """Return what to say where the tool never meets the stock."""
    x0, x1, y0, y1, top = (1e3 * value for value in bounds)
    cutting = steps.cutting
    low = 1e3 * np.minimum(steps.begin, steps.end)[cutting].min(axis=0)
    high = 1e3 * np.maximum(steps.begin, steps.end)[cutting].max(axis=0)
    problem = (
        "the tool never meets the stock: cutting moves lie within "
        f"X {low[0]:.4g} … {high[0]:.4g}, Y {low[1]:.4g} … {high[1]:.4g}, Z {low[2]:.4g} … {high[2]:.4g} mm, the "
        f"stock within X {x0:.4g} … {x1:.4g}, Y {y0:.4g} … {y1:.4g}, top Z {top:.4g} mm"
    )
    advice = "Stock and program must be in the same frame ($BASE)."
    size, reach = np.array([x1 - x0, y1 - y0]), high[:2] - low[:2]
    ratio = float(np.max(reach) / max(float(np.max(size)), 1e-9))
    for factor in (_INCH, 1.0 / _INCH):
        if 0.3 < ratio / factor < 3.0 and (ratio > 5.0 or ratio < 0.2):
            advice += f" The stock is {'smaller' if factor > 1 else 'larger'} by about 25.4: is one of them in inches?"
    return ForceError(problem, file=str(stock or process.path), advice=advice)
