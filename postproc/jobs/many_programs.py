"""Many programs: one after the other, in local processes, or on a Dask cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from postproc import interrupts
from postproc.files import remove_leftovers
from postproc.jobs import outputs, overview, shared_files
from postproc.jobs.conversion import convert_one
from postproc.jobs.job import Job
from postproc.jobs.outcome import GOOD, Outcome, Settings
from postproc.jobs.setup import load_setup

if TYPE_CHECKING:
    from postproc.jobs.cluster import Cluster


def convert_all(
    jobs: Sequence[Job], settings: Settings, *, workers: int = 1, cluster: Cluster | None = None
) -> Iterator[Outcome]:
    """Work through jobs; yield each outcome as soon as it is known (not in the order of the jobs).

    A program that fails does not stop the others. After an interrupt (Ctrl-C) no program is begun; those that are being
    written are finished, of the others there is nothing, and `KeyboardInterrupt` is raised when all that is written has
    been yielded. A cluster finishes the programs that its workers have begun. Programs that may correct one file in
    common are worked on one after the other: the first of them has it, however many work. When all is done a folder of
    several programs gets an overview, `index.html`.

    :param jobs: from `find_jobs`.
    :param settings: for all of them.
    :param workers: local processes; 1 = in this one, as also if no process can be started.
    :param cluster: to work on instead.
    :raises PostprocError: the cell or the robot is unusable, an output must not be written, or there is no cluster.
    """
    with interrupts.held_back():
        with interrupts.heard():
            own = [job for job in jobs if not job.callers]
            outputs.check(own, settings.cell, settings.mode, overwrite=settings.overwrite)
            cell, robot = load_setup(settings)
        own = shared_files.with_earlier(own, settings.mode)
        for folder in {job.output for job in own}:
            remove_leftovers(folder)
        done: list[Outcome] = []
        apart = settings.mode == "predict" or (workers == 1 and cluster is None)
        lines = [[job] for job in own] if apart else shared_files.lines(own, cell)
        convert = partial(convert_one, settings=settings, cell=cell, robot=robot)
        for outcome in _outcomes(lines, settings, workers, cluster, convert):
            done.append(outcome)
            yield outcome
        if len(done) == len(own):
            called = [_with_callers(job, done, settings) for job in jobs if job.callers]
            done += called
            yield from called
        if len(done) == len(jobs):
            overview.write(jobs, done, settings.mode)


def _with_callers(job: Job, done: Sequence[Outcome], settings: Settings) -> Outcome:
    """Return the outcome of a program that others call: it is corrected with those that it is written with."""
    callers = ", ".join(path.name for path in job.callers)
    file = str(job.output / job.program.name)
    by = ", ".join(sorted(Path(outcome.program).name for outcome in done if file in outcome.written))
    beside = any(file in outcome.copied for outcome in done)
    told = f"written beside {by} as it is" if beside else f"corrected with {by}" if by else "not written with them"
    if by == callers:
        told = "written beside as it is" if beside else "corrected with it"
    if settings.mode == "predict":
        told = "read with them"
    message = f"{job.program}: called by {callers}: {told}. Name the file to convert it alone."
    return Outcome(str(job.program), GOOD, message=message)


def _outcomes(
    lines: Sequence[Sequence[Job]],
    settings: Settings,
    workers: int,
    cluster: Cluster | None,
    convert: Callable[[Job], Outcome],
) -> Iterator[Outcome]:
    """Yield the outcomes of jobs, those of a line in its order; `convert` does one in this process."""
    if cluster is not None:
        from postproc.jobs.cluster import convert_on_cluster  # like what runs processes, imported where there is one

        yield from convert_on_cluster(lines, settings, cluster)
        return
    waiting = deque(lines)
    if workers > 1 and len(lines) > 1:
        from postproc.jobs.pool import Pool

        yield from Pool(waiting, settings).outcomes(min(workers, len(lines)))
    while waiting and not interrupts.came():
        job, *later = waiting.popleft()
        if later:
            waiting.appendleft(later)
        yield convert(job)
