"""The meshes of a model folder in the view of the path: each link where the arm has it."""

from __future__ import annotations

import numpy as np

from postproc import report, robot
from postproc.jobs.first_steps import add_robot
from tests import fabricated
from tests.pages import browser as browsers
from tests.test_link_shapes import in_root, meshes_in_a_package, ordered

pytestmark = browsers.needs_chromium


def test_links_with_meshes_are_drawn_where_the_arm_has_them(browser, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path, _, _ = meshes_in_a_package(np.random.default_rng(8), "stl")
    (tmp_path / "arm_support/meshes/5.stl").unlink()
    model = robot.load(add_robot(path, "mine").folder)
    result = fabricated.with_changes(fabricated.result(20), robot=model)
    (tmp_path / "page.html").write_bytes(b"".join(report.page(result)))
    place = 7
    base = np.linalg.inv(result.program.bases[0])
    surfaces = model.link_shapes(for_drawing=True)[0]
    expected = [1e3 * (points @ base[:3, :3].T + base[:3, 3]) for points in in_root(model, surfaces, result.q[place])]
    with browsers.opened(browser, tmp_path / "page.html") as page:
        assert page.evaluate("facts.links.map(([link]) => link)") == [0, 1, 2, 3, 4, 6]
        drawn = page.evaluate("(i) => { const v = robot.vertices(i); return [v.x, v.y, v.z]; }", place)
        faces = page.evaluate("[robot.faces.i, robot.faces.j, robot.faces.k].map((f) => Math.max(...f))")
    drawn = np.array(drawn).T
    assert max(faces) < len(drawn)
    for points in expected:
        apart = np.linalg.norm(points[:, None] - drawn[None], axis=2).min(axis=1)
        assert apart.max() < 0.05
    assert len(ordered(drawn)) > sum(len(points) for points in expected)  # A5 and the tool, as solids of revolution
