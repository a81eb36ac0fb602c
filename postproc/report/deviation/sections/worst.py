"""The worst places."""

import numpy as np

from postproc.frames import MM_PER_M, Array, norm
from postproc.program import Ints, distinct
from postproc.report.deviation.content import Deviation
from postproc.report.deviation.places import correction
from postproc.report.digits import estimate, rounded
from postproc.report.kit import Row, Section, Table

_EACH = 12


def section(told: Deviation) -> Section | None:
    """Return a table of the worst place of each of the worst lines, before and after."""
    result = told.result
    if not len(result) or told.nothing is not None:
        return None
    measures = [result.before] + ([result.after] if told.compared else [])
    bound = [] if result.bound is None else [result.bound]
    every = (_worst(measure, result.rapid, result.source_line) for measure in measures + bound)
    rows = distinct(np.concatenate([*every]))
    rows = rows[np.argsort(-result.before[rows], kind="stable")]
    force, moved = norm(result.wrench[rows, :3]), norm(correction(result)[rows]) * MM_PER_M
    head = ["Source line", "Output line", "On the move", "Before, mm" if told.compared else "Predicted, mm"]
    head += ["After, mm"] if told.compared else []
    head += ["On the part (95 %), mm"] if bound else []
    head += ["Force, N"] + (["Correction, mm"] if told.compared else [])
    out = []
    for index, row in enumerate(rows.tolist()):
        cells = [str(result.source_line[row]), str(result.output_line[row]), f"{result.t[row]:.3f}"]
        u95 = None if result.bound is None else float(result.bound[row]) * MM_PER_M
        cells += [estimate(float(measure[row]) * MM_PER_M, u95) for measure in measures]
        cells += [] if u95 is None else [rounded(u95)]
        cells += [f"{force[index]:.0f}"] + ([estimate(float(moved[index]), u95)] if told.compared else [])
        out.append(Row(tuple(cells), told.places.of(row), int(result.source_line[row])))
    table = Table(tuple(head), tuple(out), "The worst places, one for each line of the program", sortable=True)
    return Section("worst", "Worst places", (table,))


def _worst(measure: Array, rapid: np.ndarray, line: Ints) -> Ints:
    """Return the rows of the largest value of each of the lines with the largest ones."""
    value = np.where(rapid, -1.0, np.nan_to_num(measure, nan=np.inf))
    count = min(len(value), 400 * _EACH)
    largest = np.argpartition(-value, count - 1)[:count]
    order = largest[np.argsort(-value[largest], kind="stable")]
    _, first = np.unique(line[order], return_index=True)
    return order[np.sort(first)[:_EACH]]
