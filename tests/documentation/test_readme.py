"""README and guides are followed: their commands, their Python, their files and links."""

from __future__ import annotations

import contextlib
import io
import re

import pytest

from tests.documentation import pages
from tests.places import ROOT

_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]\d+)?(?![\w.])")
_CLOSE = 0.05
_PLANS = 0.4
"""Another processor rounds otherwise, and a search may then end at another plan that is as good, with other poses."""


def same(shown, actual, within=_CLOSE):
    """Equal texts but for the last digits of numbers; a line `…` stands for some lines."""
    lines = iter(actual.splitlines())
    skip = False
    for line in shown.splitlines():
        if line.strip() == "…":
            skip = True
            continue
        found = next(lines, None)
        while skip and found is not None and not _alike(line, found):
            found = next(lines, None)
        skip = False
        assert found is not None, f"not printed: {line}"
        assert _alike(line, found), f"shown:   {line}\nprinted: {found}"
        for a, b in zip(_NUMBER.findall(line), _NUMBER.findall(found), strict=True):
            assert float(a) == pytest.approx(float(b), rel=within, abs=1e-9), f"shown:   {line}\nprinted: {found}"
    assert next(lines, None) is None


def _alike(line, other):
    return _NUMBER.sub("#", line).split() == _NUMBER.sub("#", other).split()


CONSOLES = pages.consoles()


@pytest.mark.parametrize(
    "index", range(len(CONSOLES)), ids=[f"{page}: {' '.join(arguments[:2])}" for page, arguments, _ in CONSOLES]
)
def test_each_command_prints_what_its_page_shows(readme, index):
    _, arguments, shown = CONSOLES[index]
    result = readme[1][index]
    assert result.exit_code == 0, result.output
    same(shown, result.output, _PLANS if arguments[0] == "plan" else _CLOSE)


def test_the_readme_has_at_most_200_lines():
    assert len(pages.README.splitlines()) <= 200


def test_the_python_example_prints_what_its_page_shows(readme, monkeypatch):
    monkeypatch.chdir(readme[0])
    text = pages.PYTHON.read_text(encoding="utf-8")
    code, shown = re.search(r"```python\n(.*?)```\n\n```\n(.*?)```", text, re.DOTALL).groups()
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(code, {})
    same(shown, out.getvalue())


def test_every_file_and_link_of_a_page_exists():
    for path in pages.MARKDOWN:
        name, text = path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")
        for file in re.findall(r"(?:samples|tests|postproc|robot_models)/[\w./]+\.\w+", text):
            assert (ROOT / file).is_file(), f"{name}: {file}"
        for target in re.findall(r"\]\((?!http)([^)]+)\)", text):
            file, _, anchor = target.partition("#")
            page = (path.parent / file) if file else path
            assert page.exists(), f"{name}: {target}"
            if anchor:
                assert anchor in anchors(page.read_text(encoding="utf-8")), f"{name}: {target}"


def test_every_page_is_in_the_navigation_of_the_site():
    config = (ROOT / ".mkdocs.yml").read_text(encoding="utf-8")
    listed = set(re.findall(r"[\w/-]+\.md", config))
    assert listed == {path.relative_to(pages.DOCS).as_posix() for path in pages.DOCS.rglob("*.md")}


def anchors(text):
    """The anchors that GitHub makes of headings."""
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_a_number_that_is_wrong_would_be_noticed():
    same("RMS 1.00 mm\n…\nend 3", "RMS 1.01 mm\na\nb\nend 3")
    for other in ("RMS 1.10 mm\nend 3", "RMS 1.01 m\nend 3", "RMS 1.00 mm\nend 3\nmore", "RMS 1.00 mm"):
        with pytest.raises(AssertionError):
            same("RMS 1.00 mm\n…\nend 3", other)
