"""The study runs from a copy of the samples alone, and its tables say what its page says."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_study_prints_the_tables_of_its_page(tmp_path):
    shutil.copytree(ROOT / "samples" / "paper_study", tmp_path / "study")
    command = [sys.executable, "study.py"]
    run = subprocess.run(command, cwd=tmp_path / "study", capture_output=True, text=True, check=True)
    page = (ROOT / "samples" / "paper_study" / "README.md").read_text(encoding="utf-8")

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
    assert "Table 1" in run.stdout
    assert "Table 2" in run.stdout
