"""Points of an array to which loops move: corrected in place, all at once, where only one motion uses each.

Other motions become statements, whose points `named_points` corrects one by one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from postproc.dialects.krl.language.expressions import parse_aggregate
from postproc.dialects.krl.language.motion_statements import MotionStatement, Point
from postproc.dialects.krl.language.positions import from_aggregate
from postproc.dialects.krl.language.tokens import word_at
from postproc.dialects.krl.layout import Elements, Layout
from postproc.program import Bools, Motions


def settled(
    layout: Layout, motions: Motions, mentions: Mapping[str, Sequence[int]], files: int, alone: Bools
) -> Layout:
    """Return the layout with those elements only whose numbers can be edited in place; the others are statements.

    :param mentions: see `named_points.mentions`.
    :param files: number of files that are written: the `.src` and its `.dat`.
    :param alone: (M,) True for motions with one target, all components of which their text has.
    """
    if not layout.elements:
        return layout
    points = [move.end for move in layout.statements.values()]
    points += [move.via for move in layout.statements.values() if move.via is not None]
    used = [(one.source.index, one.start) for one in (point.position.aggregate for point in points) if one is not None]
    for each in layout.elements:
        used += [(each.source.index, start) for start in each.literal[:, 0].tolist()]
    times = Counter(used)
    left, statements, spans = [], dict(layout.statements), layout.spans.copy()
    for each in layout.elements:
        known = all(offset in layout.understood for offset in mentions.get(each.name, ()))
        own = known and each.name not in layout.public and each.source.index < files and layout.carriage is None
        once = np.array([times[each.source.index, start] == 1 for start in each.literal[:, 0].tolist()])
        here = alone[each.row] & once & own
        left.append(Elements(each.row[here], each.literal[here], each.source, each.name))
        spans[each.row[~here]] = -1
        for row, literal in zip(each.row[~here].tolist(), each.literal[~here].tolist(), strict=True):
            statements[row] = _statement(layout, motions, row, each, literal)
    return replace(layout, statements=dict(sorted(statements.items())), elements=tuple(left), spans=spans)


def _statement(layout: Layout, motions: Motions, row: int, each: Elements, literal: Sequence[int]) -> MotionStatement:
    start, stop = layout.target[row].tolist()
    begin, end = layout.tail[row].tolist()
    keyword = int(layout.keyword[row])
    position = from_aggregate(parse_aggregate(each.source, *literal))
    return MotionStatement(
        int(layout.line[row]),
        int(motions.kind[row]),
        (keyword, keyword + len(word_at(layout.course.source.text, keyword, start))),
        Point(position, start, stop, each.name),
        "",
        None,
        None,
        begin,
        end,
        bool(motions.blend[row] > 0.0),
    )
