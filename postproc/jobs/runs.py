"""Convert or predict programs: in this process, in several, or on a Dask cluster."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Protocol

import msgspec
from msgspec.structs import replace

from postproc import files, interrupts
from postproc.cell import Cell
from postproc.jobs.conversion import convert
from postproc.jobs.output_plan import OVERVIEW, OutputPlan, Task, removed_programs
from postproc.jobs.programs import GOOD, Job, Outcome, Settings, load_setup
from postproc.report.index import Entry, ReportEntry, index_page
from postproc.robot import RobotModel

if TYPE_CHECKING:
    from postproc.jobs.workers import Cluster

_POLL_S = 0.2
"""Time between two checks for a signal [s]: on Windows a signal does not end a wait."""
_HEAD = b"<!-- Overview by postproc.\n-->\n"
_REPORT = ".report.json"


class Workers(Protocol):
    """Processes that convert programs, here or elsewhere."""

    def begin(self, task: Task) -> Any:
        """Begin a task as soon as there is a free process; return its future."""
        ...

    def outcome(self, future: Any, task: Task) -> Outcome | None:
        """Return the outcome of a task that has ended; None if no process could be started for it."""
        ...

    def lost_outcome(self, task: Task) -> Outcome | None:
        """Return a failure if the processes for a task are gone; None while it may still be done."""
        ...

    def end(self) -> None:
        """End the processes at once, also those that are working."""
        ...


def convert_all(
    jobs: Sequence[Job],
    settings: Settings,
    *,
    workers: int = 1,
    cluster: Cluster | None = None,
    waiting: Callable[[str], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Iterator[Outcome]:
    """Convert or predict programs; yield each outcome as soon as it is known (not in the order of the jobs).

    A program that fails does not stop the others. After an interrupt (Ctrl-C) unfinished programs are dropped. Finished
    programs are complete in their places; their outcomes are yielded, then `KeyboardInterrupt` is raised. Other runs
    into the same folders wait until this run is done. At the end a folder of several programs gets an overview,
    `index.html`.

    :param jobs: jobs from `find_jobs`.
    :param settings: settings for all jobs.
    :param workers: number of local processes; 1: this process, which is also used if no other can be started.
    :param cluster: cluster that is used in place of local processes; None: there is none.
    :param waiting: called with a sentence if another run has to be waited for; None: not reported.
    :param progress: called during sweeps of a stock in this process, see `process_forces.read`; None: not reported.
    :raises PostprocError: the cell or the robot is unusable, an output must not be written, or there is no cluster.
    """
    jobs = _with_same_stock(jobs)
    with interrupts.defer(), contextlib.ExitStack() as folder_lock:
        with interrupts.allow():
            folder_lock.enter_context(files.lock({job.output for job in jobs}, waiting))
            plan = OutputPlan(jobs, settings)
            cell, robot = load_setup(settings)
        for folder in {job.output for job in plan.jobs}:
            files.remove_leftovers(folder)
        outcomes: list[Outcome] = []
        try:
            for outcome in _outcomes(plan, settings, cell, robot, workers=workers, cluster=cluster, progress=progress):
                outcomes.append(outcome)
                yield outcome
        finally:
            for folder in {job.output for job in plan.jobs}:
                files.remove_leftovers(folder)
        if len(outcomes) == len(plan.jobs):  # not after an interrupt
            subprogram_outcomes = [_caller_outcome(job, outcomes, settings) for job in jobs if job.callers]
            outcomes += subprogram_outcomes
            yield from subprogram_outcomes
            _write_overviews(plan.overviews, jobs, outcomes)


_MOST_COMPARED = 40
"""Most programs with one process whose cuts are compared: each process of a run sweeps all of them."""


def _with_same_stock(jobs: Sequence[Job]) -> list[Job]:
    """Return jobs that know the other programs of the run with the same process, if these are not too many."""
    jobs_of_process: dict[Path, list[Job]] = {}
    for job in jobs:
        if job.process is not None and not job.callers:
            jobs_of_process.setdefault(job.process, []).append(job)
    partners = {
        id(job): tuple(other for other in group if other is not job)
        for group in jobs_of_process.values()
        if len(group) <= _MOST_COMPARED
        for job in group
    }
    return [replace(job, same_stock=partners.get(id(job), ())) for job in jobs]


def _outcomes(
    plan: OutputPlan,
    settings: Settings,
    cell: Cell,
    robot: RobotModel,
    *,
    workers: int,
    cluster: Cluster | None,
    progress: Callable[[int, int], None] | None,
) -> Iterator[Outcome]:
    """Yield the outcomes of a plan until all programs are done or a signal has come; see `convert_all`."""
    if cluster is not None:
        from postproc.jobs.workers import ClusterWorkers  # late: only runs with processes need it

        plan.divide(cell)
        yield from _worker_outcomes(plan, ClusterWorkers(cluster, settings), settings, cell, robot)
    elif workers > 1 and len(plan.jobs) > 1:
        from postproc.jobs.workers import LocalWorkers

        plan.divide(cell)
        yield from _worker_outcomes(plan, LocalWorkers(min(workers, len(plan.jobs)), settings), settings, cell, robot)
    else:
        for task in plan.ready():
            with interrupts.allow():
                outcome = convert(task, settings, cell, robot, progress)
            yield from plan.accept(task, outcome)
            if interrupts.is_pending():
                return


def _worker_outcomes(
    plan: OutputPlan, workers: Workers, settings: Settings, cell: Cell, robot: RobotModel
) -> Iterator[Outcome]:
    """Yield the outcomes of a plan that workers execute.

    After a signal, only programs that are already converted are put in their places.

    :param workers: processes that do the tasks.
    :param settings, cell, robot: for a task for which no process could be started: it is done in this process.
    """
    results: SimpleQueue[Any] = SimpleQueue()
    running: dict[Any, Task] = {}

    def begin() -> None:
        """Begin the tasks of all programs that do not wait for another program."""
        for task in plan.ready():
            future = workers.begin(task)
            running[future] = task
            future.add_done_callback(results.put)

    try:
        begin()
        while running:
            is_interrupted = interrupts.is_pending()
            try:
                future = results.get(block=not is_interrupted, timeout=_POLL_S)
            except Empty:
                if is_interrupted:
                    return
                for future, task in list(running.items()):
                    if (loss := workers.lost_outcome(task)) is not None:
                        del running[future]
                        yield from plan.accept(task, loss)
                continue
            if (finished_task := running.pop(future, None)) is None:  # it was reported as lost before
                continue
            outcome = workers.outcome(future, finished_task)
            if outcome is None:
                with interrupts.allow():
                    outcome = convert(finished_task, settings, cell, robot)
            yield from plan.accept(finished_task, outcome)
            if not is_interrupted:
                begin()
    finally:
        workers.end()


def _caller_outcome(job: Job, outcomes: Sequence[Outcome], settings: Settings) -> Outcome:
    """Return the outcome of a program that others call: a sentence that names the callers with which it was written.

    :param outcomes: outcomes of the programs that were converted.
    """
    callers = ", ".join(path.name for path in job.callers)
    file = str(job.output / job.program.name)
    partners = ", ".join(sorted(Path(outcome.program).name for outcome in outcomes if file in outcome.written_files))
    is_unchanged = any(file in outcome.copied_files for outcome in outcomes)
    names = "it" if partners == callers else partners  # "called by A: written with it"
    if settings.mode == "predict":
        result = "read with them"
    elif is_unchanged:
        result = f"written with {names}, unchanged"
    else:
        result = f"corrected with {names}" if partners else "not written with them"
    message = f"{job.program}: called by {callers}: {result}. Name the file to convert it alone."
    return Outcome(str(job.program), GOOD, message=message)


def _write_overviews(folders: Sequence[Path], jobs: Sequence[Job], outcomes: Sequence[Outcome]) -> None:
    """Write an overview into each of some folders, with the programs of this run and of earlier runs.

    :param jobs: jobs of the run; `outcomes`: their outcomes, in any order.
    :raises InputError: an overview cannot be written.
    """
    outcome_of_program = {outcome.program: outcome for outcome in outcomes}
    removed = removed_programs(jobs) if folders else {}
    for folder in folders:
        folder_outcomes = [outcome_of_program[str(job.program)] for job in jobs if job.output == folder]
        entries = [
            Entry(
                Path(outcome.program).name,
                page="",
                content=None,
                message=failure_reason(outcome),
                called=outcome.is_skipped,
            )
            for outcome in folder_outcomes
            if outcome.summary is None
        ]
        write_overview(folder, entries, removed)


def write_overview(folder: Path, entries: Sequence[Entry], removed: Collection[Path]) -> None:
    """Write the overview of a folder: the programs that were written to it, and further programs.

    :param entries: entries of programs that were not written.
    :param removed: reports of the folder whose program is no longer there.
    :raises InputError: it cannot be written.
    """
    removed_pages = {_page_of(report) for report in removed}
    reported_entries = [replace(entry, is_removed=entry.page in removed_pages) for entry in reported_programs(folder)]
    content = files.seal(_HEAD + index_page([*entries, *reported_entries], folder.resolve().name))
    files.write_whole(folder, {OVERVIEW: content})


def reported_programs(folder: Path) -> list[Entry]:
    """Return the programs that were written to a folder, as their reports state."""
    return [entry for path in sorted(folder.glob(f"*{_REPORT}")) if (entry := _entry(path)) is not None]


def failure_reason(outcome: Outcome) -> str:
    """Return why a program was not written: its message, or its errors."""
    return outcome.message or "; ".join(issue.message for issue in outcome.issues if issue.level == "error")


def _entry(path: Path) -> Entry | None:
    """Return the overview entry of a report file; None if the file is unreadable, or the report of a prediction."""
    try:
        content = msgspec.convert(json.loads(path.read_bytes()), ReportEntry)
        if content.mode == "predict":
            return None
        return Entry(content.program, _page_of(path), content)
    except (OSError, ValueError):
        return None


def _page_of(report: Path) -> str:
    """Return the name of the page of a report file."""
    return report.name.removesuffix(_REPORT) + ".report.html"
