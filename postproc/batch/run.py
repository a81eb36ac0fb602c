"""Many programs: one after the other, in local processes, or on a Dask cluster."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import uuid
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from multiprocessing.process import BaseProcess
from typing import Any

from postproc.batch.convert import convert_one, load_setup
from postproc.batch.inputs import Job
from postproc.batch.interrupts import Interrupted, be_deaf, hear_once, ignored_by_children
from postproc.batch.outcome import FAILED, Outcome, Settings
from postproc.cell import Cell
from postproc.errors import PostprocError
from postproc.robot import RobotModel


def convert_all(
    jobs: Sequence[Job], settings: Settings, *, workers: int = 1, scheduler: str | None = None
) -> Iterator[Outcome]:
    """Work through jobs; yield each outcome as soon as it is known (not in the order of the jobs).

    A program that fails does not stop the others. An interrupt (Ctrl-C) is passed on to the workers; programs written
    by then are whole, of the others there is nothing (a cluster finishes the programs that its workers have begun).

    :param jobs: from `find_jobs`.
    :param settings: for all of them.
    :param workers: local processes; 1 = in this one. A script that asks for more must guard its start with
        ``if __name__ == "__main__":``.
    :param scheduler: address of a Dask scheduler, e.g. ``tcp://10.0.0.5:8786``. Its workers must see the same files
        under the same paths, and have the same postproc.
    :raises PostprocError: the cell or the robot is unusable, or there is no Dask.
    """
    cell, robot = load_setup(settings)
    if scheduler is not None:
        yield from _on_cluster(jobs, settings, scheduler)
    elif workers > 1 and len(jobs) > 1:
        yield from _in_processes(jobs, settings, min(workers, len(jobs)))
    else:
        for job in jobs:
            try:
                yield convert_one(job, settings, cell, robot)
            except Interrupted as cause:
                yield cause.outcome
                raise


@lru_cache(maxsize=1)
def _setup(settings: Settings, batch: str) -> tuple[Cell, RobotModel]:
    """Cell and robot, loaded once for each batch in each process."""
    return load_setup(settings)


def _work(job: Job, settings: Settings, batch: str) -> Outcome:
    try:
        cell, robot = _setup(settings, batch)
    except PostprocError as cause:
        return Outcome(str(job.program), FAILED, message=str(cause))
    return convert_one(job, settings, cell, robot)


def _in_processes(jobs: Sequence[Job], settings: Settings, workers: int) -> Iterator[Outcome]:
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=be_deaf)
    batch = uuid.uuid4().hex
    waiting: dict[Future[Outcome], Job] = {}
    try:
        with ignored_by_children():
            waiting |= {pool.submit(_hearing, job, settings, batch): job for job in jobs}
        for future in as_completed(list(waiting)):
            yield _outcome(future, waiting.pop(future))
    except KeyboardInterrupt:
        _end_work(pool, set(multiprocessing.active_children()) - others)
        yield from (_outcome(future, job) for future, job in waiting.items() if not future.cancelled())
        raise
    finally:
        _end_work(pool, set(multiprocessing.active_children()) - others if waiting else set())


def _end_work(pool: ProcessPoolExecutor, workers: Iterable[BaseProcess]) -> None:
    """Interrupt workers at their programs, and wait for the end of the pool."""
    pool.shutdown(wait=False, cancel_futures=True)
    if os.name == "posix":  # on Windows Ctrl-C has reached every process of the console by itself
        for worker in workers:
            if worker.pid is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(worker.pid, signal.SIGINT)
    pool.shutdown(wait=True, cancel_futures=True)


def _outcome(future: Future[Outcome], job: Job) -> Outcome:
    try:
        return future.result()
    except BrokenProcessPool:
        message = f"{job.program}: a worker process died, perhaps for lack of memory. Use fewer --jobs."
        return Outcome(str(job.program), FAILED, message=message)


def _hearing(job: Job, settings: Settings, batch: str) -> Outcome:
    """Work in a process of the pool: an interrupt ends the job at once and leaves nothing half-written."""
    try:
        hear_once()
        return _work(job, settings, batch)
    except Interrupted as cause:
        return cause.outcome
    except KeyboardInterrupt:
        return Outcome(str(job.program), FAILED, message=f"{job.program}: interrupted")
    finally:
        be_deaf()


def _on_cluster(jobs: Sequence[Job], settings: Settings, address: str) -> Iterator[Outcome]:
    try:
        import distributed
    except ImportError:
        raise PostprocError(
            "--scheduler needs dask.distributed, which is not installed. Install it with: pip install 'postproc[dask]'"
        ) from None
    try:
        client: Any = distributed.Client(address, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as cause:
        raise PostprocError(f"no Dask scheduler answers at {address} ({cause})") from cause
    batch = uuid.uuid4().hex
    with client:
        waiting = {}
        for job in jobs:
            absolute = Job(
                job.program.resolve(), job.dialect, job.output.resolve(), job.forces and job.forces.resolve()
            )
            waiting[client.submit(_work, absolute, _absolute(settings), batch, pure=False)] = job
        try:
            for future in distributed.as_completed(waiting, loop=client.loop):
                yield _from_cluster(future, waiting[future])
        except BaseException:
            client.cancel(list(waiting))
            raise


def _absolute(settings: Settings) -> Settings:
    return Settings(settings.cell.resolve(), settings.mode, settings.tolerance_mm, settings.linearize_arcs)


def _from_cluster(future: Any, job: Job) -> Outcome:
    try:
        outcome: Outcome = future.result()
    except Exception as cause:
        return Outcome(str(job.program), FAILED, message=f"{job.program}: the cluster could not do it: {cause}")
    return Outcome(str(job.program), outcome.code, outcome.summary, outcome.message, outcome.issues, outcome.written)
