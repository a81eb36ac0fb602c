"""Bodies that were checked for collisions, in the view of the path: the tool on the flange, obstacles in place."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from postproc import report
from postproc.cell import Box, Collision, HolderTable, ObstacleTable
from postproc.collision import Scene
from postproc.correction.collisions import SmallestClearance
from tests import fabricated
from tests.kr270 import CELL
from tests.pages import browser as browsers

pytestmark = browsers.needs_chromium


def test_tool_and_obstacles_are_drawn_where_they_are(browser, tmp_path):
    result = fabricated.result(20)
    cell = replace(
        CELL,
        collision=Collision(
            holder=[HolderTable(diameter_mm=60, length_mm=80)],
            obstacles=[ObstacleTable(name="vice", box=Box((20, 60), (40, 80), (-20, 60)))],
        ),
    )
    scene = Scene.of(result.robot, cell, result.program.tools[0], result.program.bases[0])
    result = fabricated.with_changes(
        result, clearance=SmallestClearance(0.0123, ("cutter", "vice"), 5, scene, scene.remarks)
    )
    (tmp_path / "page.html").write_bytes(b"".join(report.page(result)))
    place = 7
    with browsers.opened(browser, tmp_path / "page.html") as page:
        assert "12.3 mm, cutter and vice, line 5" in page.locator("#limits").inner_text()
        assert "capsules of assumed radius" in page.locator("#verdict").text_content()
        drawn = page.evaluate("(i) => { const v = robot.vertices(i); return [v.x, v.y, v.z]; }", place)
        tip = page.evaluate("(i) => { const f = robot.frames(i).at(-1); return f.map((row) => row[3]); }", place)
        colours = page.evaluate("[...new Set(robot.faces.facecolor)].length")
        page.locator("#view3d-robot").check()
        page.wait_for_timeout(500)
    drawn = np.array(drawn).T
    assert colours == 3
    for x in (20, 60):
        for y in (40, 80):
            for z in (-20, 60):
                assert np.linalg.norm(drawn - [x, y, z], axis=1).min() < 0.01
    # the end of the cutter, a circle of 60 mm around the tip
    distance = np.linalg.norm(drawn - np.array(tip), axis=1)
    assert np.count_nonzero(np.abs(distance - 30.0) < 0.3) >= 30
