"""The surface of a part in a real browser."""

from __future__ import annotations

import numpy as np
import pytest

from postproc.report import page as rendered
from postproc.report.surface import Surface
from tests import fabricated
from tests.pages.browser import needs_chromium, opened

pytestmark = needs_chromium


def test_each_facet_has_the_colour_of_its_deviation(browser, tmp_path):
    x, y = np.meshgrid(np.arange(10) * 0.02, np.arange(5) * 0.005)
    low = np.stack([x.ravel(), y.ravel(), np.zeros(50)], axis=1)
    corners = low[:, None] + np.array([[0, 0, 0], [0.02, 0, 0], [0, 0.005, 0]])
    before = np.linspace(-1e-3, 5e-4, 50)
    row = np.arange(50) + 30
    before[7], row[7] = np.nan, -1
    result = fabricated.with_changes(fabricated.result(), bound=np.full(100, 3e-5))
    normal, none = np.tile([0.0, 0, 1], (50, 1)), np.full(50, -1)
    surface = Surface(corners, normal, before, 0.02 * before, np.full(50, 3e-5), row, np.zeros(50), none)
    path = tmp_path / "part.html"
    path.write_bytes(b"".join(rendered(result, 1e-5, surface=surface)))
    with opened(browser, path) as page:
        page.wait_for_function("document.querySelector('#surface-view canvas') !== null")
        mesh = "document.getElementById('surface-view').data[0]"
        assert page.evaluate(f"{mesh}.intensity") == pytest.approx(np.delete(before, 7) * 1e3, rel=1e-6)
        assert page.evaluate(f"[{mesh}.cmin, {mesh}.cmax]") == pytest.approx([-1.0, 1.0])
        assert page.evaluate("document.getElementById('surface-view').data[1].i.length") == 1
        page.locator("#surface-colour").select_option("u95")
        assert page.evaluate(f"{mesh}.intensity")[0] == pytest.approx(0.03)
        page.locator("#surface tbody tr").first.click()
        line = int(page.locator("#surface tbody tr").first.get_attribute("data-source-line"))
        assert int(page.locator("#place dd").first.inner_text()) == line
