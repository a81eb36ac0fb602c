"""Every command and option has a help text, with examples that parse; the reference shows what `--help` prints."""

from __future__ import annotations

import click
import pytest

from postproc.cli import main
from tests.documentation import pages
from tests.documentation.reference import every_command, reference

CONTEXTS = list(every_command())
PATHS = [ctx.command_path for ctx in CONTEXTS]
SHOWN = [
    (source, arguments)
    for source, text in [
        *((ctx.command_path, ctx.get_help()) for ctx in CONTEXTS),
        *((path.name, path.read_text(encoding="utf-8")) for path in pages.MARKDOWN if path != pages.COMMANDS),
    ]
    for arguments in pages.commands(text)
]


def test_the_reference_shows_the_help_of_every_command():
    shown = pages.COMMANDS.read_text(encoding="utf-8")
    told = "not what --help prints: run python -m tests.documentation.reference"
    assert shown.split() == reference().split(), told  # other versions of click break lines elsewhere


@pytest.mark.parametrize("ctx", CONTEXTS, ids=PATHS)
def test_command_has_help_and_an_example_of_itself(ctx):
    told = "the first sentence is too long for a list of 80 columns"
    assert ctx.parent is None or not ctx.command.get_short_help_str(61).endswith("..."), told
    examples = [" ".join(["postproc", *arguments]) for arguments in pages.commands(ctx.get_help())]
    assert any(example.startswith(ctx.command_path) for example in examples)
    assert "\\b" not in ctx.get_help(), r"a raw docstring: click does not see \b"


@pytest.mark.parametrize("ctx", CONTEXTS, ids=PATHS)
def test_every_option_has_help(ctx):
    silent = [p.name for p in ctx.command.params if isinstance(p, click.Option) and not p.help]
    assert silent == []


@pytest.mark.parametrize(("source", "arguments"), SHOWN, ids=[f"{s}: {' '.join(a)}" for s, a in SHOWN])
def test_every_command_shown_anywhere_can_be_given(source, arguments):
    ctx = main.make_context("postproc", list(arguments), resilient_parsing=False)
    while isinstance(ctx.command, click.Group) and (given := [*ctx._protected_args, *ctx.args]):
        name, found, rest = ctx.command.resolve_command(ctx, given)
        ctx = found.make_context(name, rest, parent=ctx)
    assert ctx.args == []


def test_a_wrong_option_would_be_noticed():
    convert = main.get_command(None, "convert")
    with pytest.raises(click.UsageError):
        convert.make_context("convert", ["part.nc", "--cell", "cell.toml", "--tolerence", "0.1"])
