"""Many programs: one after the other, in local processes, or on a Dask cluster; and one that no file holds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from postproc import interrupts
from postproc.dialects import registry
from postproc.files import remove_leftovers
from postproc.jobs import outputs, overview
from postproc.jobs.cluster import Cluster, convert_on_cluster
from postproc.jobs.conversion import convert_one, converted
from postproc.jobs.job import Job
from postproc.jobs.outcome import Outcome, Settings
from postproc.jobs.pool import Pool
from postproc.jobs.setup import load_setup
from postproc.program import Program


def convert_all(
    jobs: Sequence[Job], settings: Settings, *, workers: int = 1, cluster: Cluster | None = None
) -> Iterator[Outcome]:
    """Work through jobs; yield each outcome as soon as it is known (not in the order of the jobs).

    A program that fails does not stop the others. After an interrupt (Ctrl-C) no program is begun; those that are being
    written are finished, of the others there is nothing, and `KeyboardInterrupt` is raised when all that is written has
    been yielded. A cluster finishes the programs that its workers have begun. When all is done a folder of several
    programs gets an overview, `index.html`.

    :param jobs: from `find_jobs`.
    :param settings: for all of them.
    :param workers: local processes; 1 = in this one, as also if no process can be started.
    :param cluster: to work on instead.
    :raises PostprocError: the cell or the robot is unusable, an output must not be written, or there is no cluster.
    """
    with interrupts.held_back():
        with interrupts.heard():
            outputs.check(jobs, settings.cell, settings.mode, overwrite=settings.overwrite)
            cell, robot = load_setup(settings)
        for folder in {job.output for job in jobs}:
            remove_leftovers(folder)
        done: list[Outcome] = []
        for outcome in _outcomes(jobs, settings, workers, cluster, lambda job: convert_one(job, settings, cell, robot)):
            done.append(outcome)
            yield outcome
        if len(done) == len(jobs):
            overview.write(jobs, done, settings.mode)


def _outcomes(
    jobs: Sequence[Job],
    settings: Settings,
    workers: int,
    cluster: Cluster | None,
    convert: Callable[[Job], Outcome],
) -> Iterator[Outcome]:
    """Yield the outcomes of jobs; `convert` does one in this process."""
    if cluster is not None:
        yield from convert_on_cluster(jobs, settings, cluster)
        return
    waiting = deque(jobs)
    if workers > 1 and len(jobs) > 1:
        yield from Pool(waiting, settings).outcomes(min(workers, len(jobs)))
    while waiting and not interrupts.came():
        yield convert(waiting.popleft())


def convert_program(
    program: Program, settings: Settings, output: Path, forces: Path | None = None, to: str | None = None
) -> Outcome:
    """Convert a program that is not in a file, and write its files: the way in for hosts, which have moves and no text.

    All is as for a file: it is read back, simulated and marked; its documents are the text that lines of issues and
    forces refer to. A name that the controller does not allow is made valid.

    :param program: as a reader makes it; `load_setup` gives what is needed to make one.
    :param settings: what is to be done with it.
    :param output: folder to write into.
    :param forces: CSV file with its forces; lines are those of its first document.
    :param to: dialect to write; None = its own if that is written, else KRL.
    :returns: what came of it; whatever is wrong with the program is told there.
    :raises PostprocError: the cell or the robot is unusable, or an output must not be written.
    """
    written_as, writer = registry.written_in(program.dialect, to)
    name = program.name if written_as == program.dialect else writer.valid(program.name)
    job = Job(Path(program.documents[0].name), program.dialect, output, forces, name, to=to)
    with interrupts.held_back():
        with interrupts.heard():
            outputs.check([job], settings.cell, settings.mode, overwrite=settings.overwrite)
            cell, robot = load_setup(settings)
        remove_leftovers(output)
        return converted(job, settings, cell, robot, lambda: replace(program, name=job.stem))
