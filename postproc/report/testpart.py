"""Pages of a test part: the drawing with what the part will show, and measured against predicted deviations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from postproc.cell import Box
from postproc.frames import MM_PER_M, Array
from postproc.report.kit import (
    Axis,
    Cell,
    Curve,
    Drawing,
    Kind,
    Note,
    Notes,
    Page,
    Plot,
    Points,
    Row,
    Section,
    Table,
    Tile,
    Tiles,
    Verdict,
)
from postproc.testpart import features
from postproc.testpart.design import MOST_CHANGE, Design
from postproc.testpart.features import Cutting, Placement, Program
from postproc.testpart.model import Agreement, PartIdentification
from postproc.testpart.prior import Prior
from postproc.testpart.probing import TOP

_DRAWING_WIDTH = 900.0
"""Width of the drawing [px]."""
_ARC_CHORDS = 24
"""Chords of the half circle at the end of a slot: their height is below a pixel."""
_HIDDEN_SHARE = 0.9
"""A part does not show a parameter if more than this share of its standard deviation is left (assumed)."""
_LARGE_CHANGE = 0.3
"""Relative change of a joint that a part should show (assumed)."""
_PRODUCT = (
    "Forces and compliances scale against each other: twice the force on a robot half as compliant leaves the same "
    "surfaces. The part shows their product well; the scale alone is known only by its prior and by those of the "
    "compliances. The model and material.toml belong together. Different depths and directions of feed separate the "
    "joints, not the scale; a weight hung on the tool (--weight) or a measured force (identify forces) separates it."
)


def design_page(
    design: Design, prior: Prior, cutting: Cutting, programs: dict[Placement, Program], box: Box, robot: str
) -> bytes:
    """Return the page of a chosen part: drawing, features, and the accuracy of each parameter after it is measured.

    :param programs: program of the test part for each placement of the block.
    :param box: ranges of X, Y, Z that the block fills in `$BASE` [mm].
    :param robot: name of the robot, for the head of the page.
    """
    remarks = Notes(tuple(Note(text) for text in _remarks(design, prior)))
    sections = (
        Section("numbers", "What the part will show", (_design_tiles(design, programs),)),
        Section("drawing", "Drawing", _drawings(design, cutting, programs, box)),
        Section("steps", "How to use it", (Notes(_design_steps(programs, box), bulleted=True),)),
        Section("parameters", "What each parameter will be known to", (_parameter_table(design, prior), remarks)),
        Section("features", "Features", (_feature_table(design, programs),)),
    )
    feed = cutting.feed * MM_PER_M * 60.0
    subtitle = f"{robot}, tool {cutting.diameter * MM_PER_M:g} mm, {cutting.rpm:g} 1/min, {feed:.0f} mm/min"
    return b"".join(Page("Test part", "testpart", subtitle, sections).render())


def _design_tiles(design: Design, programs: dict[Placement, Program]) -> Tiles:
    """Return the tiles of a chosen part: its size, cutting time, and expected errors now and once it is measured."""
    tiles = (
        Tile("Features", str(len(design.features))),
        Tile("Probed points", str(sum(len(program.feature) for program in programs.values()))),
        Tile("Cutting time", f"{design.seconds / 60.0:.1f}", "min"),
        Tile("Expected error now, RMS", f"{design.before * MM_PER_M:.3f}", "mm"),
        Tile(
            "Expected error with the part, RMS",
            f"{design.after * MM_PER_M:.3f}",
            "mm",
            note=f"deflection {design.deflection * MM_PER_M:.2f} mm: {design.tests}",
        ),
    )
    return Tiles(tiles)


def _design_steps(programs: dict[Placement, Program], box: Box) -> tuple[Note, ...]:
    """Return the steps of a test part: clamp, touch off, cut, probe, identify.

    :param programs: program of the test part for each placement of the block.
    :param box: ranges of X, Y, Z that the block fills in `$BASE` [mm].
    """
    program_names = " ".join(placement.name for placement, program in programs.items() if len(program.feature))
    return (
        Note(
            f"Clamp a block of X {box.X[0]:g} … {box.X[1]:g}, Y {box.Y[0]:g} … {box.Y[1]:g}, "
            f"Z {box.Z[0]:g} … {box.Z[1]:g} mm in $BASE."
        ),
        Note(
            f"Touch the top of the block with the tool near the corners, at {_touch_texts(programs)}: it is at "
            f"Z {box.Z[1]:g} of $BASE. Leave it uncut there: it is probed with the features."
        ),
        *_cutting_steps(programs),
        *_weight_steps(programs),
        Note(
            "Probe the points of probing.csv in its order, in one clamping: T01.top … on the uncut top, then feature "
            "after feature: left, right, floor, step_floor of the half that was cut under load, then its ref_ points. "
            "Fill in deviation_mm: along the normal, positive where material is left; on the top, where it is higher."
        ),
        Note(
            "Where the part is probed does not matter: its position is found from the deviations. The points on the "
            "top say how deep the cuts are: a program that ran too high or too low is counted or refused."
        ),
        Note(
            "postproc identify part probing.csv --cell CELL --process testpart.process.toml "
            f"--program {program_names} -o MODEL"
        ),
    )


def _remarks(design: Design, prior: Prior) -> list[str]:
    """Return remarks on what the part cannot show."""
    remarks = [_PRODUCT]
    if design.sigma_without_weight is not None:
        remarks.append(f"Here {_weight_sentence(design, design.sigma_without_weight)}.")
    if (change_sentence := _unseen_change_sentence(design, prior)) is not None:
        remarks.append(f"{change_sentence[0].upper()}{change_sentence[1:]}.")
    return remarks


def _parameter_table(design: Design, prior: Prior) -> Table:
    """Return the table of standard deviations before and after the part is measured."""
    # design.sigma: after the part, as shares of those before; design.change: smallest relative change that is seen
    rows = []
    for k, parameter in enumerate(prior.parameters):
        prior_value, smallest_change = prior.values[k], float(design.change[k])
        sigma_percent = 100.0 * prior.sigma[k] / abs(prior_value) if prior_value else None
        is_change_seen = smallest_change < MOST_CHANGE
        change_text = f"{100.0 * smallest_change:.0f}" if is_change_seen else "not seen"
        rows.append(_parameter_row(parameter.title, sigma_percent, float(design.sigma[k]), change_text))
    # the last standard deviation, after those of the parameters, is that of the scale of the forces
    rows.append(
        _parameter_row("scale of the forces", 100.0 * float(prior.sigma[-1]), float(design.sigma[-1]), change_text="")
    )
    return Table(
        ("parameter", "now, σ %", "with the part, σ %", "change seen later, %", ""),
        tuple(rows),
        "Standard deviations of the parameters before and after the part, and the smallest change that the same part "
        "shows later",
        texts=(4,),
    )


def _parameter_row(name: str, prior_sigma: float | None, share: float, change_text: str) -> Row:
    """Return the row of a parameter: its standard deviation now and with the part, and whether the part shows it.

    :param prior_sigma: standard deviation now, in percent of the value; None if the value is 0.
    :param share: share of `prior_sigma` that is left once the part is measured, in [0, 1].
    :param change_text: smallest change that the same part shows later [%]; empty: not shown.
    """
    is_hidden = share > _HIDDEN_SHARE
    kind: Kind = "soft" if is_hidden else ""
    text = Cell("value not shown by this part" if is_hidden else "", kind)
    sigma_texts = ("-", "-") if prior_sigma is None else (f"{prior_sigma:.2g}", f"{prior_sigma * share:.2g}")
    return Row((name, *sigma_texts, change_text, text))


def _unseen_change_sentence(design: Design, prior: Prior) -> str | None:
    """Return a sentence on parameters whose value the part shows, but not a later change of 30 % (`_LARGE_CHANGE`).

    None if there are no such parameters.
    """
    names = [
        f"{parameter.name} ({100.0 * seen_change:.0f} %)" if seen_change < MOST_CHANGE else parameter.name
        for parameter, seen_change, sigma_share in zip(
            # the last standard deviation is that of the scale of the forces
            prior.parameters,
            design.change.tolist(),
            design.sigma[:-1],
            strict=True,
        )
        if seen_change > _LARGE_CHANGE and sigma_share <= _HIDDEN_SHARE
    ]
    if not names:
        return None
    return (
        f"a change of 30 % from one part to the next would not be seen for sure in {', '.join(names)}: cutting forces "
        "load them little here. A weight on the tool (--weight), the block higher and further away (--placement), or "
        "more depth shows more"
    )


def _touch_texts(programs: dict[Placement, Program]) -> str:
    """Return the touch-off points of the first placement in which something is cut, as text: `T01 X20 Y30, …` [mm]."""
    program = next(program for program in programs.values() if program.features)
    return ", ".join(
        f"{name.partition('.')[0]} X{x:g} Y{y:g}"  # name is such as T01.top
        for name, (x, y, _) in zip(program.feature, (program.point * MM_PER_M).tolist(), strict=True)
        if name.rpartition(".")[2] == TOP
    )


def _cutting_steps(programs: dict[Placement, Program]) -> list[Note]:
    """Return the steps to cut the part: one note for each placement of the block."""
    uncorrected = "uncorrected, in one clamping, with a sharp tool."
    if len(programs) == 1:
        return [Note(f"Cut testpart.src, or testpart.nc by your own post: {uncorrected}")]
    return [
        Note(
            f"With the block at {placement.title} of the cell cut {Path(placement.name).stem}.src, or {placement.name} "
            f"by your own post: {uncorrected}"
        )
        if len(program.feature)
        else Note(f"Nothing is cut with the block at {placement.title}: the same time shows more elsewhere.")
        for placement, program in programs.items()
    ]


def _weight_steps(programs: dict[Placement, Program]) -> list[Note]:
    """Return the steps to hang a weight on the tool; empty if the part has no gauge readings."""
    masses = [float(program.mass.max(initial=0.0)) for program in programs.values()]
    if max(masses) <= 0.0:
        return []
    return [
        Note(
            f"At each stop (M0) at the end: set a dial gauge under the tool to 0, hang {max(masses):g} kg on the tool, "
            "and write how far it moves down, in mm, into the row W01.gauge, W02.gauge … of probing.csv. Take the "
            "weight off before you go on."
        )
    ]


def _feature_table(design: Design, programs: dict[Placement, Program]) -> Table:
    """Return the table of the features [mm, deg] in `$BASE`.

    With several placements, also where the block is clamped.
    """
    rows = []
    block_frames = [placement.title for placement, program in programs.items() for _ in range(program.features)]
    has_placements = len(programs) > 1
    deflections = design.candidates.deflection[design.chosen] * MM_PER_M
    for index, feature in enumerate(design.features):
        cells = [f"F{index + 1:02d}"]
        if has_placements:
            cells.append(block_frames[index])
        cells += [
            feature.kind.title,
            f"{feature.kind.depth * MM_PER_M:g}",
            f"{feature.x * MM_PER_M:.1f}",
            f"{feature.y * MM_PER_M:.1f}",
            f"{np.degrees(feature.angle):.0f}",
            f"{deflections[index]:.3f}",
        ]
        rows.append(Row(tuple(cells)))
    head = ("kind", "depth, mm", "X, mm", "Y, mm", "direction, °", "deflection, mm")
    title = "Features with the largest expected deflection of the tool"
    if has_placements:
        return Table(("feature", "block at", *head), tuple(rows), title, texts=(1, 2))
    return Table(("feature", *head), tuple(rows), title, texts=(1,))


def _drawings(design: Design, cutting: Cutting, programs: dict[Placement, Program], box: Box) -> tuple[Drawing, ...]:
    """Return a drawing for each placement of the block in which something is cut."""
    drawings, first_feature = [], 0
    for placement, program in programs.items():
        feature_numbers = range(first_feature, first_feature + program.features)
        if not feature_numbers:
            continue
        caption = f"Block at {placement.title}, {placement.name}. " if len(programs) > 1 else ""
        drawings.append(_drawing(design, feature_numbers, cutting, box, program, caption))
        first_feature = feature_numbers.stop
    return tuple(drawings)


class _PlanView:
    """Plan view of a block: converts points in `$BASE` [m] to places of the drawing [px].

    :ivar height: height of the drawing [px]; its width is `_DRAWING_WIDTH`.
    """

    def __init__(self, box: Box) -> None:
        """Scale the drawing so that the block fills its width.

        :param box: ranges of X, Y, Z that the block fills in `$BASE` [mm].
        """
        self._low = np.array([box.X[0], box.Y[0]])
        self._scale = _DRAWING_WIDTH / (box.X[1] - box.X[0])
        self.height = self._scale * (box.Y[1] - box.Y[0])

    def xy(self, points: Array) -> Array:
        """Return the places (n, 2) in the drawing [px] of points (n, 2 or 3) in `$BASE` [m].

        Y of the drawing is down.
        """
        x, y = (points[:, :2] * MM_PER_M - self._low).T * self._scale
        return np.column_stack([x, self.height - y])

    def path(self, points: Array, style: str) -> str:
        """Return the closed line through points (n, 2 or 3) in `$BASE` [m] as an svg path.

        `style`: its svg attributes.
        """
        return f'<path d="M{" L".join(f"{x:.1f} {y:.1f}" for x, y in self.xy(points).tolist())}Z" {style}/>'

    def text(self, text: str, point: Array, rise: float, style: str) -> str:
        """Return an svg text centred about a point (3,) or (2,) in `$BASE` [m].

        :param rise: height of the base line of the text above the point [px]; negative: below it.
        :param style: svg attributes of the text.
        """
        x, y = self.xy(point[None])[0].tolist()
        return f'<text x="{x:.1f}" y="{y - rise:.1f}" text-anchor="middle" fill="currentColor" {style}>{text}</text>'


def _drawing(
    design: Design, feature_numbers: range, cutting: Cutting, box: Box, program: Program, caption: str
) -> Drawing:
    """Return the plan view of the block: outlines of grooves and trimmed halves, probed points, numbers.

    :param feature_numbers: indices of the features of this placement; others are shown as faint outlines.
    :param program: program of this placement.
    :param caption: sentence with which the note below the drawing begins; empty for a single placement.
    """
    plan = _PlanView(box)
    shapes = [
        f'<rect x="0" y="0" width="{_DRAWING_WIDTH:.0f}" height="{plan.height:.0f}" fill="none" stroke="currentColor"/>'
    ]
    for index, feature in enumerate(design.features):
        if index in feature_numbers:
            shapes += _feature_shapes(plan, feature, cutting, f"F{index + 1:02d}")
        else:
            faint = 'fill="none" stroke="currentColor" stroke-opacity="0.15"'
            shapes += _outlines(plan, feature, cutting, "", faint)
    shapes += [*_touch_off_shapes(plan, program), *_edge_labels(plan, box)]
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-60 -8 {_DRAWING_WIDTH + 70:.0f} {plan.height + 34:.0f}" '
        f'style="width:100%;max-height:40rem">{"".join(shapes)}</svg>'
    )
    return Drawing(
        svg,
        "Plan view of the block with the features",
        f"{caption}Seen from the spindle. Shaded: cut under load; dashed: trimmed by light passes. Dots: probed "
        "points, hollow ones on reference surfaces. Crosses: touch-off points on the uncut top. Behind each number the "
        "depth in mm.",
    )


def _edge_labels(plan: _PlanView, box: Box) -> list[str]:
    """Return the coordinates of the edges of the block [mm] as svg texts: X below the drawing, Y left of it."""
    # text, x and y of its base line [px] from the upper left corner, and which end of the text is at x
    labels = (
        (f"X {box.X[0]:g}", 0.0, plan.height + 18.0, "start"),
        (f"X {box.X[1]:g}", _DRAWING_WIDTH, plan.height + 18.0, "end"),
        (f"Y {box.Y[0]:g}", -6.0, plan.height, "end"),
        (f"Y {box.Y[1]:g}", -6.0, 12.0, "end"),
    )
    return [
        f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}" font-size="13" fill="currentColor">{text}</text>'
        for text, x, y, anchor in labels
    ]


def _feature_shapes(plan: _PlanView, feature: features.Feature, cutting: Cutting, name: str) -> list[str]:
    """Return a feature as svg elements: its surfaces, its probed points, its name with its depth [mm].

    :param name: number of the feature, such as F01.
    """
    areas = 'fill="currentColor" fill-opacity="0.12" stroke="currentColor"'
    hidden_lines = 'fill="none" stroke="currentColor" stroke-dasharray="4 3"'
    shapes = []
    for surface, style in (("groove", areas), ("step", areas), ("trim", hidden_lines)):
        shapes += _outlines(plan, feature, cutting, surface, style)
    for probe in features.probes(feature.kind, cutting):
        # the plan view shows no Z: the upper face may be at 0
        x, y = plan.xy(features.to_base(feature, 0.0, np.array([probe.point])))[0].tolist()
        fill = "none" if probe.name.startswith("ref") else "currentColor"  # hollow: on a reference surface
        shapes.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{fill}" stroke="currentColor"/>')
    style = 'font-size="15" font-weight="bold" paint-order="stroke" stroke="var(--card)" stroke-width="4"'
    middle = np.array([feature.x, feature.y])
    return [*shapes, plan.text(f"{name} · {feature.kind.depth * MM_PER_M:g}", middle, -5.0, style)]


def _outlines(plan: _PlanView, feature: features.Feature, cutting: Cutting, surface: str, style: str) -> list[str]:
    """Return the outlines of the passes of a feature that make a surface, as svg elements in a style.

    :param surface: beginning of the name of the surface; empty: all surfaces.
    :param style: svg attributes.
    """
    radius = 0.5 * cutting.diameter
    return [
        plan.path(_pass_outline(feature, begin, end, radius), style)
        for begin, end in _straight_passes(feature, cutting, surface)
    ]


def _touch_off_shapes(plan: _PlanView, program: Program) -> list[str]:
    """Return the touch-off points of a program as svg elements: crosses with their names, such as T01."""
    shapes = []
    for name, point in zip(program.feature, program.point, strict=True):
        if name.rpartition(".")[2] == TOP:
            x, y = plan.xy(point[None])[0].tolist()
            cross = f"M{x - 6:.1f} {y:.1f}H{x + 6:.1f}M{x:.1f} {y - 6:.1f}V{y + 6:.1f}"
            shapes.append(f'<path d="{cross}" stroke="currentColor"/>')
            shapes.append(plan.text(name.partition(".")[0], point, 9.0, 'font-size="13"'))
    return shapes


def _straight_passes(feature: features.Feature, cutting: Cutting, name: str) -> list[tuple[Array, Array]]:
    """Return start and end (2,) [m] of the straight passes of a feature that make a surface, in the feature's axes.

    :param name: beginning of the name of the surface; passes that make no surface have no name.
    """
    ends, start = [], np.zeros(3)
    for move in features.passes(feature.kind, cutting):
        end = np.array(move.end)
        if move.name and move.name.startswith(name):
            ends.append((start[:2], end[:2]))
        start = end
    return ends


def _pass_outline(feature: features.Feature, begin: Array, end: Array, radius: float) -> Array:
    """Return the outline (n, 2) in `$BASE` [m] of the area that the tool covers on a straight pass.

    :param begin: (2,) start of the pass in the axes of the feature [m], `end` (2,) its end.
    :param radius: of the tool [m].
    """
    pass_x, pass_y = end - begin
    direction = np.arctan2(pass_y, pass_x)
    # angles of the points of a half circle, from −90° to 90° about the direction
    turn = np.pi * (np.arange(_ARC_CHORDS + 1) / _ARC_CHORDS - 0.5)
    half_circles = [
        centre + radius * np.column_stack([np.cos(angle + turn), np.sin(angle + turn)])
        for centre, angle in ((end, direction), (begin, direction + np.pi))
    ]
    points = np.concatenate(half_circles)
    return features.to_base(feature, 0.0, np.column_stack([points, np.zeros(len(points))]))[:, :2]


def design_lines(design: Design, prior: Prior, cutting: Cutting, programs: dict[Placement, Program]) -> list[str]:
    """Return a chosen part as lines to print: features, expected errors, and what the part will show."""
    # standard deviations with the part, as shares of those now; the last is that of the scale of the forces
    names = [*(parameter.name for parameter in prior.parameters), "forces"]
    shares = list(zip(names, design.sigma, strict=True))
    sigma_texts = [f"{name} {100 * share:.0f} %" for name, share in shares if share <= _HIDDEN_SHARE]
    hidden_names = [name for name, share in shares if share > _HIDDEN_SHARE]
    placement_texts = [f"{placement.title}: {program.features}" for placement, program in programs.items()]
    lines = [
        f"{len(design.features)} features, {design.seconds / 60.0:.1f} min of cutting, "
        f"full cuts at {cutting.feed * MM_PER_M * 60:.0f} mm/min",
        *([f"block at {', '.join(placement_texts)}"] if len(programs) > 1 else []),
        f"expected error where you mill ({design.tests}): {design.before * MM_PER_M:.3f} mm now, "
        f"{design.after * MM_PER_M:.3f} mm with the part, of {design.deflection * MM_PER_M:.2f} mm deflection (RMS)",
        f"standard deviations left: {', '.join(sigma_texts)} of those now",
    ]
    if hidden_names:
        lines.append(f"not shown by this part: {', '.join(hidden_names)}")
    if (hidden_changes := _unseen_change_sentence(design, prior)) is not None:
        lines.append(hidden_changes)
    if design.sigma_without_weight is not None:
        lines.append(_weight_sentence(design, design.sigma_without_weight))
    return lines


def _weight_sentence(design: Design, sigma_without_weight: Array) -> str:
    """Return in words how well the scale of the forces is known with and without the weight on the tool.

    :param sigma_without_weight: standard deviations without the weight, as shares of the prior ones; the last is that
        of the scale of the forces.
    """
    return (
        f"the weight on the tool leaves {100 * design.sigma[-1]:.0f} % of the standard deviation of the forces; "
        f"without it {100 * sigma_without_weight[-1]:.0f} % would be left"
    )


def part_lines(data: PartIdentification) -> list[str]:
    """Return what was identified from a test part as lines to print: verdict, parameters, forces, errors, heights."""
    lines = [data.verdict.line]
    for name, entry in data.parameters.items():
        if entry.source == "prior":
            lines.append(f"{name} {entry.value:.4g} {entry.unit} (prior, not determined by the part)")
        elif entry.value is not None and entry.ci95 is not None and entry.prior is not None:
            lines.append(f"{name} {entry.value:.4g} ± {entry.ci95:.2g} {entry.unit} (was {entry.prior:.4g})")
    scale = data.force_scale
    lines.append(f"forces {scale.value:.3f} ± {scale.ci95:.2g} times those computed")
    lines.append(
        f"deviations {data.deviation_mm:.4f} mm RMS; the model before leaves {data.without_mm:.4f}, this one "
        f"{data.left_mm:.4f}; probe {data.sigma_mm:.4f}"
    )
    lines.append(f"unmodelled error {data.unmodelled_percent:.2g} % of the deflection")
    for error in data.touch_off:
        direction = "above" if error.lift_mm >= 0.0 else "below"
        frame = f" at {error.frame}" if len(data.touch_off) > 1 else ""
        lines.append(
            f"the program ran {abs(error.lift_mm):.3f} ± {error.ci95:.2g} mm {direction} its height over the uncut "
            f"top{frame}"
        )
    return lines


def agreement_lines(data: PartIdentification, agreement: Agreement) -> list[str]:
    """Return lines to print on the agreement of the cell's model with the part: holds, does not, or not decided."""
    state = "the model holds" if agreement.holds else "THE MODEL DOES NOT HOLD"
    return [
        f"NOT DECIDED: {agreement.fault}" if agreement.fault else f"{state}: {agreement.line}",
        f"deviations {data.deviation_mm:.4f} mm RMS, of which the model leaves {data.without_mm:.4f}; "
        f"probe {data.sigma_mm:.4f}",
    ]


def part_page(data: PartIdentification, name: str) -> bytes:
    """Return the page of a model from a test part as HTML in UTF-8.

    :param name: name of the model, for the head of the page.
    """
    is_refused = data.verdict.refused
    verdict = Verdict("failed" if is_refused else "ok", "Refused" if is_refused else "Usable", data.verdict.line)
    notes = [*(Note(f"{text}.", "warning") for text in data.warnings), Note(_PRODUCT)]
    sections = (
        Section("verdict", "Verdict", (verdict, _part_tiles(data))),
        Section("measured", "Measured and predicted", (_prediction_plot(data),), "half"),
        Section("errors", "Remaining errors", (_error_plot(data),), "half"),
        Section("parameters", "Parameters", (_interval_plot(data), _value_table(data))),
        Section("issues", "What to know", (Notes(tuple(notes), bulleted=True),)),
        Section("points", "Probed points", (_point_table(data),)),
    )
    return b"".join(Page("Model from a test part", name, f"{len(data.points)} probed points", sections).render())


def _part_tiles(data: PartIdentification) -> Tiles:
    """Return the tiles of a measured part: deviations that the models leave, force scale, heights of the programs."""
    tiles = (
        Tile("Deviations, RMS", f"{data.deviation_mm:.3f}", "mm"),
        Tile("Left by the model before", f"{data.without_mm:.4f}", "mm"),
        Tile("Left by this model", f"{data.left_mm:.4f}", "mm", note=f"noise of the probe {data.sigma_mm:g} mm"),
        Tile("Forces over those computed", f"{data.force_scale.value:.3f}", note=f"± {data.force_scale.ci95:.2g}"),
        Tile("Unmodelled error", f"{data.unmodelled_percent:.2g}", "%", note="of the deflection"),
        *(
            Tile(
                "Program over the block",
                f"{error.lift_mm:+.3f}",
                "mm",
                note=f"± {error.ci95:.2g} by {len(error.points)} touch-off points, {error.frame}",
            )
            for error in data.touch_off
        ),
    )
    return Tiles(tiles)


def _prediction_plot(data: PartIdentification) -> Plot:
    """Return the plot of measured over predicted deviations [mm], predicted by the model before and by this model."""
    measured_mm = [point.measured_mm for point in data.points]
    names = [point.feature for point in data.points]
    span = [min(measured_mm), max(measured_mm)]
    return Plot(
        label="Measured over predicted deviation of each probed point",
        traces=[
            Curve(span, span, "measured = predicted", "soft", dashed=True),
            Points([p.before_mm for p in data.points], measured_mm, "model before", "before", hollow=True, texts=names),
            Points([p.after_mm for p in data.points], measured_mm, "this model", "after", texts=names),
        ],
        x=Axis(title="predicted, mm"),
        y=Axis(title="measured, mm"),
        note="With the position of the part, the radius of the tool and the path without force as found.",
    )


def _error_plot(data: PartIdentification) -> Plot:
    """Return the plot of the error of each point, predicted from all other points [µm], with 95 % intervals."""
    errors = Points(
        [float(number) for number in range(len(data.points))],
        [1e3 * point.error_mm for point in data.points],  # mm to µm
        "predicted from all others",
        "after",
        half=[1.96e3 * point.sigma_mm for point in data.points],  # ±1.96 σ: 95 % of a normal distribution; mm to µm
        texts=[point.feature for point in data.points],
    )
    return Plot(
        label="Error of each point predicted from all others",
        traces=[errors],
        x=Axis(title="probed point"),
        y=Axis(title="error, µm"),
    )


def _interval_plot(data: PartIdentification) -> Plot:
    """Return the plot of the change of each parameter, and of the forces, against its prior value [%].

    Changes have 95 % intervals; parameters without an interval or a prior value are left out.
    """
    names, changes, half_widths = list[str](), list[float](), list[float | None]()
    entries = {**data.parameters, "forces": data.force_scale}
    for name, entry in entries.items():
        if entry.value is None or entry.ci95 is None or not entry.prior:
            continue
        names.append(name)
        changes.append(100.0 * (entry.value / entry.prior - 1.0))
        half_widths.append(100.0 * entry.ci95 / abs(entry.prior))
    rows = [float(k) for k in range(len(names))]
    return Plot(
        label="Change of each parameter against the model before, with its 95 % interval",
        traces=[Points(changes, rows, "this model", "after", half=half_widths, across=True, texts=names)],
        x=Axis(title="change against the model before, %"),
        y=Axis(categories=names),
        height=60 + 36 * len(names),  # [px]: axis, and a line for each name
    )


def _value_table(data: PartIdentification) -> Table:
    """Return the table of the parameters and of the scale of the forces, with 95 % intervals and prior values."""
    rows = []
    for name, entry in {**data.parameters, "scale of the forces": data.force_scale}.items():
        origin = "prior" if entry.source == "prior" else "part"
        unit = "" if entry.unit == "1" else entry.unit
        rows.append(Row((name, f"{entry.value:.4g}", f"{entry.ci95:.2g}", unit, f"{entry.prior:.4g}", origin)))
    return Table(
        ("parameter", "value", "± 95 %", "unit", "before", "from"),
        tuple(rows),
        "Parameters with 95 % intervals",
        texts=(3, 5),
    )


def _point_table(data: PartIdentification) -> Table:
    """Return the table of the probed points [mm]: measured and predicted deviations, error and its uncertainty."""
    rows = []
    for point in data.points:
        values = (point.measured_mm, point.before_mm, point.after_mm, point.error_mm, point.sigma_mm)
        rows.append(Row((point.feature, *(f"{value:.4f}" for value in values))))
    head = ("feature", "measured, mm", "model before", "this model", "error from others", "σ of that")
    return Table(head, tuple(rows), "Deviations of the probed points", sortable=True)
