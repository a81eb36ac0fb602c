"""The template of pages is compiled once, where Python keeps what it compiled."""

import sys

import jinja2
import pytest

from postproc.report.kit import templating


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """Where compiled modules and templates go; each test begins without any."""
    monkeypatch.setattr(sys, "pycache_prefix", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    templating.template.cache_clear()
    yield lambda: [*tmp_path.rglob("*.cache")]
    templating.template.cache_clear()


def again():
    templating.template.cache_clear()
    return templating.template()


def test_what_was_compiled_is_not_compiled_again(kept, monkeypatch):
    templating.template()
    (file,) = kept()
    assert file.parent.name == "templates"

    def compiled(*_):
        raise AssertionError

    monkeypatch.setattr(jinja2.Environment, "compile", compiled)
    assert again().name == "page.html"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(AssertionError):
        again()


def test_a_template_that_was_changed_is_compiled_again(kept, tmp_path, monkeypatch):
    monkeypatch.setattr(templating, "_FOLDER", tmp_path)
    for text in ("one", "two"):
        (tmp_path / "page.html").write_text(text)
        assert again().render() == text


def test_nothing_is_kept_where_that_is_not_wanted(kept, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert templating.template().name == "page.html"
    assert kept() == []


def test_a_place_where_nothing_can_be_kept_stops_no_page(kept, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError("No space left on device")

    monkeypatch.setattr("jinja2.bccache.FileSystemBytecodeCache.dump_bytecode", full)
    assert templating.template().name == "page.html"
    assert kept() == []
