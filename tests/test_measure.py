"""The counts of `tests.measure`."""

from tests.measure import modules_of, newest, prose, single_clients


def test_modules_with_one_client_are_found(tmp_path):
    package = tmp_path / "part"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "one.py").write_text("x = 1\n")
    (package / "two.py").write_text("from part.one import x\n")
    (package / "three.py").write_text("from part import two\nimport part.four\n")
    (package / "four.py").write_text(
        "import re\nfrom part.two import (\n    x,\n)\nA = re.compile('what_stands_here')\n"
    )
    modules = modules_of(package)
    assert single_clients(modules) == {"part.one", "part.four"}
    assert modules["part.four"].imports == 4
    assert (modules["part.four"].regexes, modules["part.four"].idioms) == (1, 1)


def test_sentences_and_paragraphs_are_counted_without_code():
    words, mean, longest, idioms = prose(
        "# Title\n\nOne two `a b c` four. Five six.\n\n```\nx y z\n```\n- it stands here\n"
    )
    assert (words, longest, idioms) == (9, 6, 1)
    assert mean == 3.0


def test_the_newest_section_of_a_changelog_is_measured():
    assert newest("# Changelog\n\nHead.\n\n## 0.2\n\n- b\n\n### Changes results\n\n- c\n\n## 0.1\n\n- a\n").split() == (
        ["0.2", "-", "b", "###", "Changes", "results", "-", "c"]
    )
