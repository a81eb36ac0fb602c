"""The README's picture: the first drawing of the report of samples/pocket.nc, as a file of its own.

python -m tests.documentation.picture        # draws it anew
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from click.testing import CliRunner

from postproc.cli import main
from tests.documentation.pages import ROOT

PICTURE = ROOT / "samples" / "pocket.svg"


def drawing(page: str) -> str:
    """Return the first drawing of a page with the styles it needs, in the page's light colours."""
    (style,) = re.findall(r"<style>(.*?)</style>", page, re.S)
    colours = dict(re.findall(r"(--\w+):([^;}]+)", style.partition("@media")[0]))
    styles = re.sub(r"@media.*?\}\}", "", style, flags=re.S)
    styles = re.sub(r"var\((--\w+)\)", lambda name: colours[name[1]], styles)
    start, content = re.findall(r"(<svg [^>]*)>(.*?)</svg>", page, re.S)[0]
    used = {name for names in re.findall(r'class="([^"]*)"', content) for name in names.split()} | {"text"}
    rules = [
        rule.replace("svg ", "")
        for rule in re.findall(r"[^{}]+\{[^{}]*\}", styles)
        if set(re.findall(r"[\w-]+", rule.partition("{")[0])) & used
    ]
    width, height = re.findall(r'viewBox="0 0 (\d+) (\d+)"', start)[0]
    paper = f'<rect width="{width}" height="{height}" fill="{colours["--card"]}"/>'
    return f'{start} xmlns="http://www.w3.org/2000/svg"><style>{"".join(rules)}</style>{paper}{content}</svg>\n'


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        arguments = [
            "convert",
            str(ROOT / "samples" / "pocket.nc"),
            "--cell",
            str(ROOT / "samples" / "cell_kr270.toml"),
        ]
        CliRunner().invoke(main, [*arguments, "-o", folder], catch_exceptions=False)
        PICTURE.write_text(drawing((Path(folder) / "pocket.report.html").read_text(encoding="utf-8")), encoding="utf-8")
