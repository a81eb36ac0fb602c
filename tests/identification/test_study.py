"""The study runs from a copy of the samples alone, and its tables say what its page says."""

import re
import shutil
import subprocess
import sys

import numpy as np

from tests.places import ROOT


def test_study_prints_the_tables_of_its_page(tmp_path):
    """Of the first two robots; the third takes as long as both: `python samples/paper_study/study.py`."""
    shutil.copytree(ROOT / "samples" / "paper_study", tmp_path / "study")
    command = [sys.executable, "study.py", "--robot", "ideal", "--robot", "rig"]
    run = subprocess.run(command, cwd=tmp_path / "study", capture_output=True, text=True, check=True)
    page = (ROOT / "samples" / "paper_study" / "README.md").read_text(encoding="utf-8")
    page = page.partition("Table 2. Compliances [µrad/(N·m)], real robot")[0]

    def factors(text):
        return [
            tuple(map(float, row))
            for row in re.findall(r"^RMS +[\d.]+ +[\d.]+ +[\d.]+ +([\d.]+) +([\d.]+)", text, re.M)
        ]

    printed = factors(run.stdout)
    assert len(printed) == 2
    for (serial, enhanced), (serial_page, enhanced_page) in zip(printed, factors(page), strict=True):
        assert abs(serial / serial_page - 1) < 0.05  # another BLAS may choose another plan
        assert abs(enhanced / enhanced_page - 1) < 0.1
    for method in ("enhanced", r"serial \(Dumas 2011\)"):
        rows = re.findall(rf"^identified, {method} +(?:\d\.\d+ +){{5}}", run.stdout, re.M)
        assert len(rows) == 2  # both robots, with values for k1 … k5
    found = re.findall(r"^ratio ([\d.]+) = ([\d.]+) by .* × ([\d.]+) by the plan", run.stdout, re.M)
    told = re.findall(r"^ratio ([\d.]+) = ([\d.]+) by .* × ([\d.]+) by the plan", page, re.M)
    assert len(found) == len(told) == 2
    np.testing.assert_allclose(np.array(found, dtype=float), np.array(told, dtype=float), rtol=0.1)
    k_c = re.search(r"rig robot(?:.*\n)+?identified, enhanced.* ([\d.e+]+) ± ([\d.e+]+)\n", run.stdout)
    assert float(k_c[1]) > 2.0 * float(k_c[2])  # this robot lets the compensator be seen
    assert "Table 1" in run.stdout
    assert "Table 2" in run.stdout
