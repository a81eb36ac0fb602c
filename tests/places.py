"""Where the files of the repository are that tests read."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "samples"
CELL_FILE = SAMPLES / "cell_kr270.toml"
"""The cell of most samples: a KR 270."""
ABB_CELL_FILE = SAMPLES / "cell_irb6700.toml"
