"""Pictures of a plan as inline SVG: the poses, the plan among others, the number of poses."""

from __future__ import annotations

from html import escape

import numpy as np

from postproc.frames import Array
from postproc.plan.measurement_plan import PlanResult
from postproc.plan.shapes import BoxShape
from postproc.report.charts import WIDTH, ticks

_LEFT, _RIGHT = 64, 24
_PLOT = WIDTH - _LEFT - _RIGHT
_AZIMUTH, _ELEVATION = np.radians(-50.0), np.radians(22.0)
_SIDE = np.array([-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0])
_UP = np.array([-np.sin(_ELEVATION) * np.cos(_AZIMUTH), -np.sin(_ELEVATION) * np.sin(_AZIMUTH), np.cos(_ELEVATION)])
_VIEWS = {
    "seen from the side, X →, Z ↑": np.array([[1.0, 0, 0], [0, 0, 1.0]]),
    "seen from above, X →, Y ↑": np.array([[1.0, 0, 0], [0, 1.0, 0]]),
}
_COLUMNS = 5
_ARROW = 0.45

CSS = """
.arm{fill:none;stroke:var(--after);stroke-linejoin:round;stroke-linecap:round}
.arm.faint{stroke-opacity:.35}.shadow{fill:none;stroke:var(--rule);stroke-width:4;stroke-linejoin:round;stroke-linecap:round}
.pull{fill:none;stroke:var(--before);stroke-width:2.5;stroke-linecap:round}.hook{fill:var(--before)}
.seen{fill:var(--ink)}.ray{stroke:var(--soft);stroke-width:.7;stroke-dasharray:3 4;fill:none}
.eye{fill:var(--force)}.thing{fill:none;stroke:var(--warn);stroke-width:1}
.ground{fill:none;stroke:var(--rule);stroke-width:1}
.bar{fill:var(--soft);fill-opacity:.45}.mine{stroke:var(--after);stroke-width:2.5;fill:none}
.other{stroke:var(--before);stroke-width:2;fill:none;stroke-dasharray:5 4}
.dot{fill:var(--after)}.dot.other{fill:var(--card);stroke-dasharray:none}
.panel{font-weight:600}
"""


def _path(points: Array, closed: bool = False) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + ("Z" if closed else "")


class _Frame:
    """Where metres of a projection come to lie in a picture."""

    def __init__(self, projection: Array, seen: Array, box: tuple[float, float, float, float]) -> None:
        flat = seen @ projection.T
        low, high = flat.min(axis=0), flat.max(axis=0)
        left, top, width, height = box
        self.projection = projection
        self.scale = float(min(width / (high[0] - low[0]), height / (high[1] - low[1])))
        size = (high - low) * self.scale
        self.origin = np.array([left + (width - size[0]) / 2, top + (height + size[1]) / 2])
        self.low = low

    def __call__(self, points: Array) -> Array:
        flat = (points @ self.projection.T - self.low) * self.scale
        return np.asarray(self.origin + flat * [1.0, -1.0])


class _Scene:
    """Points of all poses [m]: joints of the arm, markers, arrows of the load; and what stands around."""

    def __init__(self, result: PlanResult) -> None:
        site, plan = result.site, result.plan
        posed = site.arm.pose(plan.q)
        o = posed.origin
        base = np.zeros_like(o[:, :1])
        hook = posed.point(site.load_point[None])
        column = np.concatenate([base[..., :2], o[:, 1:2, 2:]], axis=2)
        self.joints = np.concatenate([base, column, o[:, 1:5], posed.flange[:, None, :3, 3], hook], axis=1)
        self.markers = posed.point(site.points)
        force = result.force / np.linalg.norm(result.force, axis=1, keepdims=True)
        self.hook, self.tip = hook[:, 0], hook[:, 0] + _ARROW * force
        self.tracker = site.tracker
        self.floor = site.floor
        self.things = [_corners(obstacle) for obstacle in site.obstacles]

    def extent(self, near: bool = False) -> Array:
        """Return points that the picture must hold; `near`: without tracker and obstacles."""
        parts = [self.joints.reshape(-1, 3), self.tip]
        if not near:
            parts += [*self.things, *([] if self.tracker is None else [self.tracker[None]])]
        points = np.concatenate(parts)
        shadow = points.copy()
        shadow[:, 2] = self.floor
        return np.concatenate([points, shadow]) if not near else np.concatenate([points, [[0.0, 0.0, self.floor]]])


_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]


def _corners(obstacle: object) -> Array:
    """Return the eight corners of a box, or of the box around a mesh."""
    signs = np.array([[1 if corner >> axis & 1 else -1 for axis in range(3)] for corner in range(8)])
    if isinstance(obstacle, BoxShape):
        rotation, shift = obstacle.to_box[:3, :3], obstacle.to_box[:3, 3]
        return np.asarray((signs * obstacle.half - shift) @ rotation)
    vertices = obstacle.vertices  # type: ignore[attr-defined]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.asarray(0.5 * (low + high) + 0.5 * signs * (high - low))


def overview(result: PlanResult) -> str:
    """Return all poses in two views, from the side and from above, with tracker and obstacles."""
    scene = _Scene(result)
    half, height = WIDTH / 2, 360
    parts = []
    for index, (title, projection) in enumerate(_VIEWS.items()):
        left = index * half
        frame = _Frame(projection, scene.extent(), (left + 20, 30, half - 40, height - 50))
        if index == 0:
            ground = frame(np.array([[0.0, 0.0, scene.floor]]))[0, 1]
            parts.append(f'<path class="axis" d="M{left + 10:.0f} {ground:.1f}H{left + half - 10:.0f}"/>')
        parts += _around(scene, frame)
        for joints, hook, tip in zip(scene.joints, scene.hook, scene.tip, strict=True):
            parts.append(f'<path class="arm faint" stroke-width="3" d="{_path(frame(joints))}"/>')
            parts.append(f'<path class="pull" d="{_path(frame(np.array([hook, tip])))}"/>')
        parts.append(f'<text class="tick" x="{left + 20:.0f}" y="16">{title}</text>')
    return _svg(height, "All poses from the side and from above", parts)


def _around(scene: _Scene, frame: _Frame) -> list[str]:
    parts = []
    for corners in scene.things:
        flat = frame(corners)
        parts.append(f'<path class="thing" d="{"".join(_path(flat[[a, b]]) for a, b in _EDGES)}"/>')
    if scene.tracker is not None:
        x, y = frame(scene.tracker[None])[0]
        parts.append(f'<path class="eye" d="M{x:.1f} {y - 7:.1f}l6 11h-12z"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{y + 17:.1f}" text-anchor="middle">tracker</text>')
    return parts


def panels(result: PlanResult) -> str:
    """Return each pose by itself: arm, its shadow on the floor, markers, pull of the load."""
    scene = _Scene(result)
    count = len(result.plan)
    width = WIDTH / _COLUMNS
    height = 190.0
    seen = scene.extent(near=True)
    shadow = seen.copy()
    shadow[:, 2] = scene.floor
    parts = []
    for index in range(count):
        left, top = index % _COLUMNS * width, index // _COLUMNS * height
        frame = _Frame(
            np.array([_SIDE, _UP]), np.concatenate([seen, shadow]), (left + 8, top + 22, width - 16, height - 34)
        )
        square = np.array([[x, y, scene.floor] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        parts.append(f'<path class="ground" d="{_path(frame(square), closed=True)}"/>')
        flat = scene.joints[index].copy()
        flat[:, 2] = scene.floor
        parts.append(f'<path class="shadow" d="{_path(frame(flat))}"/>')
        joints = frame(scene.joints[index])
        for row, thickness in ((0, 9), (1, 9), (2, 7), (3, 6), (4, 5), (5, 4), (6, 2)):
            parts.append(f'<path class="arm" stroke-width="{thickness}" d="{_path(joints[row : row + 2])}"/>')
        hook, tip = frame(np.array([scene.hook[index], scene.tip[index]]))
        parts.append(f'<path class="pull" d="{_path(np.array([hook, tip]))}"/>')
        parts.append(f'<circle class="hook" cx="{tip[0]:.1f}" cy="{tip[1]:.1f}" r="4"/>')
        parts += [f'<circle class="seen" cx="{x:.1f}" cy="{y:.1f}" r="1.8"/>' for x, y in frame(scene.markers[index])]
        level = result.plan.q[index, 1] * 180.0 / np.pi
        parts.append(
            f'<text class="panel" x="{left + 8:.0f}" y="{top + 14:.0f}">{index + 1}</text>'
            f'<text class="tick" x="{left + 30:.0f}" y="{top + 14:.0f}">A2 {level:.1f}°</text>'
        )
    rows = -(-count // _COLUMNS)
    return _svg(int(rows * height), "Each pose with its load", parts)


def among_others(own: float, random: Array, serial: float | None, unit: str) -> str:
    """Return a histogram of random plans with this plan and the serial one marked; all in `unit`."""
    height, base = 210, 160
    # some random plans are hopeless: the picture ends where 97 % of them are in
    top = max(float(np.quantile(random, 0.97)), serial or 0.0, own) * 1.05
    counts, edges = np.histogram(np.clip(random, 0.0, top), bins=60, range=(0.0, top))
    place = _LEFT + edges / top * _PLOT
    parts = []
    for value in ticks(0.0, top, 8):
        x = _LEFT + value / top * _PLOT
        parts.append(f'<path class="grid" d="M{x:.1f} 44V{base}"/>')
        parts.append(f'<text class="tick" x="{x:.1f}" y="{base + 18}" text-anchor="middle">{value:g}</text>')
    for count, left, right in zip(counts, place[:-1], place[1:], strict=True):
        if count:
            tall = count / counts.max() * (base - 60)
            parts.append(
                f'<rect class="bar" x="{left:.1f}" y="{base - tall:.1f}" width="{right - left - 1:.1f}" '
                f'height="{tall:.1f}"/>'
            )
    parts.append(f'<path class="axis" d="M{_LEFT} {base}H{WIDTH - _RIGHT}"/>')
    marks = [(own, "this plan", "mine", 14), (float(np.median(random)), "median of random plans", "other", 14)]
    if serial is not None:
        marks.append((serial, "semi-intuitive plan", "other", 32))
    for value, label, style, y in marks:
        x = _LEFT + value / top * _PLOT
        side, shift = ("end", -6) if x > WIDTH - 260 else ("start", 6)
        parts.append(f'<path class="{style}" d="M{x:.1f} {y - 10}V{base}"/>')
        parts.append(
            f'<text class="note" x="{x + shift:.1f}" y="{y}" text-anchor="{side}">{escape(label)} {value:.3g}</text>'
        )
    label = f"criterion (root: RMS distance that remains), {unit}"
    parts.append(f'<text class="tick" x="{WIDTH - _RIGHT}" y="{base + 38}" text-anchor="end">{label}</text>')
    return _svg(height, "This plan among random plans", parts)


def against_number(number: Array, own: Array, random: Array, chosen: int, unit: str) -> str:
    """Return the criterion against the number of poses, for plans like this one and for random ones."""
    height, base, top = 260, 205, 20
    high = float(min(random.max(), 4.0 * own.max())) * 1.05
    x = _LEFT + (number - number[0]) / max(number[-1] - number[0], 1) * _PLOT
    parts = []
    for value in ticks(0.0, high, 5):
        y = base - value / high * (base - top)
        parts.append(f'<path class="grid" d="M{_LEFT} {y:.1f}H{WIDTH - _RIGHT}"/>')
        parts.append(f'<text class="tick" x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    for values, style, label in ((random, "other", "random plans, median"), (own, "mine", "best plan found")):
        spots = np.column_stack([x, base - np.minimum(values, high) / high * (base - top)])
        parts.append(f'<path class="{style}" d="{_path(spots)}"/>')
        parts += [f'<circle class="dot {style}" cx="{a:.1f}" cy="{b:.1f}" r="3.5"/>' for a, b in spots]
        end = max(float(spots[-1, 1]) + (16.0 if style == "mine" else -9.0), 14.0)
        parts.append(f'<text class="note" x="{x[-1]:.1f}" y="{end:.1f}" text-anchor="end">{label}</text>')
    for row in np.flatnonzero(number == chosen):
        a, b = x[row], base - own[row] / high * (base - top)
        parts.append(f'<circle class="mark" cx="{a:.1f}" cy="{b:.1f}" r="6"/>')
        parts.append(
            f'<text class="note" x="{a:.1f}" y="{b + 20:.1f}" text-anchor="middle">this plan {own[row]:.3g}</text>'
        )
    for place, count in zip(x, number, strict=True):
        parts.append(f'<text class="tick" x="{place:.1f}" y="{base + 18}" text-anchor="middle">{count}</text>')
    parts.append(f'<path class="axis" d="M{_LEFT} {base}H{WIDTH - _RIGHT}"/>')
    parts.append(f'<text class="tick" x="{WIDTH - _RIGHT}" y="{base + 38}" text-anchor="end">number of poses</text>')
    parts.append(f'<text class="tick" x="{_LEFT}" y="{top - 8}">{unit}</text>')
    return _svg(height, "Criterion against the number of poses", parts)


def _svg(height: int, label: str, parts: list[str]) -> str:
    return (
        f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(label)}">'
        f"<title>{escape(label)}</title>{''.join(parts)}</svg>"
    )
