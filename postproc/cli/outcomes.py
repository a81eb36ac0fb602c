"""Work through the programs of a command, show the progress, and print the outcomes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from postproc.cli.faults import fault_message
from postproc.progress import as_lines, line_writer

if TYPE_CHECKING:
    from postproc.jobs import Job, Outcome, Settings
    from postproc.jobs.workers import Cluster


def work(
    ctx: click.Context,
    jobs: Sequence[Job],
    settings: Settings,
    *,
    as_json: bool,
    workers: int = 1,
    cluster: Cluster | None = None,
) -> None:
    """Convert or predict programs and print their outcomes; end the command with the exit code of the worst outcome.

    :param as_json: print JSON instead of summaries.
    :param workers: number of programs at the same time.
    :param cluster: Dask cluster that does the work; None: this machine.
    """
    outcomes = run_jobs(ctx, jobs, settings, as_json=as_json, workers=workers, cluster=cluster)
    ctx.exit(worst_code(outcomes))


def run_jobs(
    ctx: click.Context,
    jobs: Sequence[Job],
    settings: Settings,
    *,
    as_json: bool,
    workers: int = 1,
    cluster: Cluster | None = None,
) -> list[Outcome]:
    """Convert or predict programs, print their outcomes and return them in the order of the jobs.

    Parameters as of `work`.

    An interrupt prints what is written, and ends the command.

    :raises PostprocError: the work cannot begin or go on.
    """
    from postproc.errors import PostprocError
    from postproc.jobs import convert_all, leftover_note, removed_programs_note

    outcome_of: dict[str, Outcome] = {}
    try:
        run = partial(convert_all, jobs, settings, workers=workers, cluster=cluster, waiting=say)
        for outcome in _show_progress(run, len(jobs)):
            outcome_of[outcome.program] = outcome
    except (KeyboardInterrupt, PostprocError) as cause:
        # subprograms are written with the programs that call them
        remark = leftover_note(
            [job for job in jobs if not job.callers and str(job.program) not in outcome_of], settings.mode
        )
        if isinstance(cause, PostprocError):
            if remark:
                click.echo(remark, err=True)
            raise
        print_failures(outcome_of.values())
        count = sum(bool(outcome.written_files) for outcome in outcome_of.values())
        others_sentence = (
            "of the others nothing is" if cluster is None else "the cluster may still finish those it has begun"
        )
        text = (
            f"Interrupted: {count} of {len(jobs)} programs are written, and whole; {others_sentence}. {remark}".rstrip()
        )
        with contextlib.suppress(OSError):  # the terminal may be gone
            click.echo(text, err=True)
        ctx.exit(128 + getattr(cause, "number", 2))  # 128 + number of the signal; 2: Ctrl-C
    outcomes = [outcome_of[str(job.program)] for job in jobs]
    _print_outcomes(outcomes, jobs, as_json=as_json)
    if note := removed_programs_note(jobs, settings.mode):
        say(note)
    return outcomes


def say(sentence: str) -> None:
    """Print a sentence on stderr."""
    click.echo(sentence, err=True)


def print_outcome(outcome: Outcome, job: Job, *, as_json: bool = False) -> None:
    """Print one line on a converted program on stdout, or the reason of its failure on stderr.

    With `as_json` an entry of JSON is printed on stdout in either case.
    """
    print_failures([outcome])
    if as_json:
        import json

        click.echo(json.dumps(_as_entry(outcome), allow_nan=False))
    elif outcome.summary is not None:
        verdict = outcome.summary.verdict
        reasons = verdict.reasons[:1] if verdict.state != "ok" else []  # the first reason at most
        sentences = " ".join([verdict.headline, *reasons])
        click.echo(f"{Path(outcome.program).name}: {_outcome_text(outcome)} to {job.output}. {sentences}")


def _show_progress(run: Callable[..., Iterator[Outcome]], count: int) -> Iterator[Outcome]:
    """Yield the outcomes of a run, and show its progress on stderr: programs, and moves of a tool through the stock.

    For the window as lines, on a terminal as bars, else not at all.

    :param run: function that starts the work and yields outcomes; its keyword `progress` takes a function of the number
        of done and of all moves.
    :param count: number of programs.
    """
    import sys

    if as_lines():
        show = line_writer()
        yield from run(progress=lambda done, total: show("moves through the stock", done / max(total, 1)))
        return
    if not sys.stderr.isatty():
        yield from run()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("programs", total=count)
        sweep = progress.add_task("moves through the stock", visible=False)

        def show_sweep(done: int, total: int) -> None:
            """Show the number of moves that the tool has swept; hide the bar at the end."""
            progress.update(sweep, completed=done, total=total, visible=done < total)

        for outcome in run(progress=show_sweep):
            progress.update(task, advance=1, description=Path(outcome.program).name)
            yield outcome


def _print_outcomes(outcomes: Sequence[Outcome], jobs: Sequence[Job], *, as_json: bool) -> None:
    """Print the outcomes of programs: failures on stderr; a summary, or a table of several programs, on stdout.

    With ``--quiet`` only failures and JSON are printed.
    """
    from postproc import report
    from postproc.cli.terminal import display
    from postproc.files import json_bytes

    print_failures(outcomes)
    if as_json:
        content = {"exit_code": worst_code(outcomes), "programs": [_as_entry(outcome) for outcome in outcomes]}
        click.echo(json_bytes(content).decode(), nl=False)
    elif click.get_current_context().find_root().params.get("quiet"):
        return
    elif len(outcomes) == 1 and outcomes[0].summary is not None:
        click.echo(report.program_text(outcomes[0].summary, display()))
        names = ", ".join(Path(path).name for path in outcomes[0].written_files)
        click.echo(f"written to {jobs[0].output}: {names}")
    elif len(outcomes) > 1:
        rows = [
            report.ProgramRow(
                outcome.program,
                outcome.summary,
                _outcome_text(outcome),
                is_skipped=outcome.is_skipped,
            )
            for outcome in outcomes
        ]
        click.echo(report.programs_table(rows, display()))
        for page in dict.fromkeys(job.output / "index.html" for job in jobs):
            if page.is_file():
                click.echo(f"overview: {page}")


def print_failures(outcomes: Iterable[Outcome]) -> None:
    """Print on stderr the reasons why programs failed or were skipped; nothing for other programs."""
    from postproc.report import issue_entry, issue_line

    for outcome in outcomes:
        if outcome.message:
            text = fault_message(outcome.message, outcome.traceback) if outcome.traceback else outcome.message
            click.echo(text if outcome.is_skipped else f"Error: {text}", err=True)
        for issue in outcome.issues:
            click.echo(issue_line(issue_entry(issue), outcome.program), err=True)
        if outcome.issues:
            click.echo(f"Error: {outcome.program}: nothing is written.", err=True)
        if outcome.earlier_remark:
            click.echo(outcome.earlier_remark, err=True)


def _as_entry(outcome: Outcome) -> dict[str, object]:
    """Return the outcome as an entry of the JSON output."""
    import msgspec

    from postproc.report import issue_entry

    entry: dict[str, object] = {"program": outcome.program, "exit_code": outcome.code}
    if outcome.summary is not None:
        entry |= {**msgspec.to_builtins(outcome.summary), "program": outcome.program}
    elif outcome.is_skipped:
        entry["skipped"] = outcome.message
    else:
        entry |= {"error": outcome.message, "issues": [issue_entry(issue) for issue in outcome.issues]}
        entry |= {"earlier": outcome.earlier_remark}
    return {**entry, "written": list(outcome.written_files)}


def _outcome_text(outcome: Outcome) -> str:
    """Return the outcome in a few words: written, skipped, not to be run or FAILED; new name and number of warnings.

    A program that is written, but whose verdict is red, is not to be run.
    """
    if outcome.summary is None:
        return "skipped: a subprogram" if outcome.is_skipped else "FAILED"
    issues = outcome.summary.issues
    warnings = sum(issue.level == "warning" for issue in issues)
    state_text = "not to be run" if outcome.code else "written"
    # issue "name": the name of the program was not valid and was changed
    new_names = [Path(path).name for path in outcome.written_files[:1] if any(issue.kind == "name" for issue in issues)]
    return (
        state_text
        + "".join(f" as {name}" for name in new_names)
        + (f", {warnings} warning{'s' if warnings > 1 else ''}" if warnings else "")
    )


def worst_code(outcomes: Iterable[Outcome]) -> int:
    """Return the exit code of a command with these outcomes: 1 for a failure is worse than 3 for a red verdict.

    Only a failure leaves no program.
    """
    codes = {outcome.code for outcome in outcomes}
    return 1 if 1 in codes else max(codes, default=0)
