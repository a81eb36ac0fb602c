"""Written programs in the cell simulator of the tests: where the loaded tool is at targets."""

from __future__ import annotations

import csv
import io
import tomllib

import numpy as np
import pytest

from postproc import report, robot
from tests.oracle import cell_sim
from tests.oracle.arm import Arm
from tests.places import SAMPLES

MICROMETRE = 1e-6


def simulator(cell_file):
    raw = tomllib.loads((SAMPLES / cell_file).read_text(encoding="utf-8"))
    arm = Arm.load(robot.find(raw["robot"]))
    frame = lambda table: tuple(raw[table].get(k, 0.0) for k in "XYZABC")  # noqa: E731
    return cell_sim.Cell(arm, raw["start"]["joints"], frame("base"), frame("tool"))


def written(result, home=None):
    texts = {d.name.rpartition(".")[2].lower(): d.to_bytes().decode() for d in result.documents}
    return cell_sim.read(texts["src"], texts.get("dat", ""), home)


def rows_of(result):
    text = b"".join(report.targets_csv(result)).decode()
    return [{k: float(v) if v else None for k, v in row.items()} for row in csv.DictReader(io.StringIO(text))]


def check_targets(result, sim, moves, every):
    """At targets the loaded tip stands within 1 µm of nominal under the force of targets.csv."""
    rows = rows_of(result)
    cartesian = [i for i, move in enumerate(moves) if "frame" in move]
    assert len(rows) == len(cartesian)
    worst = 0.0
    for index, _, _, q in sim.run(moves):
        row = rows[cartesian.index(index)] if len(cartesian) < 2000 else rows[index - (len(moves) - len(rows))]
        assert int(row["output_line"]) == moves[index]["line"]
        if index % every == 0:
            wrench = np.array([row[k] for k in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")])
            tip = sim.tip(moves[index], q, wrench)
            nominal = np.array([row[k] for k in "XYZ"]) / 1000
            worst = max(worst, float(np.linalg.norm(tip - nominal)))
            assert row["after_mm"] == pytest.approx(1000 * np.linalg.norm(tip - nominal), abs=2e-4)
    assert worst <= MICROMETRE + 1e-7
    return rows
