"""Worker processes on this machine, each of which converts one program after the other, and workers of a Dask cluster.

A worker writes nothing but staged files. So it can be ended at any moment: by Ctrl-C, by the end of the process that
started it, or for lack of memory. Both ends of the pipes to local workers are in this module. A worker of a cluster
does each task in a process of its own.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from postproc.cell import Cell
from postproc.errors import PostprocError
from postproc.jobs import inputs
from postproc.jobs.conversion import convert, failure
from postproc.jobs.output_plan import Task
from postproc.jobs.programs import FAILED, Outcome, Settings, load_setup
from postproc.robot import RobotModel
from postproc.version import VERSION

_START = "from postproc.jobs.workers import main; main()"


class LocalWorkers:
    """Processes on this machine, each driven by a thread that waits for its results.

    :param count: number of processes; each is started when there is a task for it.
    :param settings: settings of all tasks.
    """

    def __init__(self, count: int, settings: Settings) -> None:
        self._settings = settings
        self._threads = ThreadPoolExecutor(count)
        self._free_processes: SimpleQueue[_Process] = SimpleQueue()
        self._processes: set[_Process] = set()  # free and working processes
        self._lock = threading.Lock()
        self._is_ending = False

    def begin(self, task: Task) -> Future[Outcome]:
        """Begin a task as soon as there is a free process; return its future."""
        return self._threads.submit(self._work, task)

    def outcome(self, future: Future[Outcome], task: Task) -> Outcome | None:
        """Return the outcome of a task that has ended; None if no process could be started for it."""
        del task  # an argument of `Workers.outcome` that is not needed here
        return None if isinstance(future.exception(), OSError) else future.result()

    def lost_outcome(self, task: Task) -> None:
        """Return None: a local process that ends is noticed by its thread, which then makes the outcome."""

    def end(self) -> None:
        """End the processes at once."""
        with self._lock:
            self._is_ending = True
            for process in self._processes:
                process.kill()
        self._threads.shutdown(cancel_futures=True)
        for process in self._processes:
            process.wait()

    def _work(self, task: Task) -> Outcome:
        """Run a task in a free process; return its outcome, a failure if the process ends meanwhile."""
        process = self._process()
        try:
            outcome = process.work(task, self._settings)
        except EOFError:
            with self._lock:
                self._processes.discard(process)
            return _crash_outcome(task, process.wait())
        self._free_processes.put(process)
        return outcome

    def _process(self) -> _Process:
        """Return a free process, or a new one if none is free.

        :raises OSError: the workers are ending, or no process can be started.
        """
        with contextlib.suppress(Empty):
            return self._free_processes.get_nowait()
        with self._lock:
            if self._is_ending:
                raise OSError
            process = _Process()
            self._processes.add(process)
            return process


def work_in_process(task: Task, settings: Settings) -> Outcome:
    """Run a task in a new process, which is ended afterwards; return its outcome.

    If the process ends by itself, the outcome is a failure.

    :raises OSError: no process can be started.
    """
    process = _Process()
    try:
        return process.work(task, settings)
    except EOFError:
        return _crash_outcome(task, process.wait())
    finally:
        process.kill()
        process.wait()


class _Process:
    """A worker process on this machine.

    :raises OSError: the process cannot be started.
    """

    def __init__(self) -> None:
        # in a session of its own: Ctrl-C and a closed terminal reach only the process that waits for it
        session_options: dict[str, Any] = {"start_new_session": True}
        if sys.platform == "win32":
            session_options = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        path = os.pathsep.join(entry or str(os.getcwd()) for entry in sys.path)  # noqa: PTH109
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _START],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ, "PYTHONPATH": path},  # one thread, as in `cli`
            **session_options,
        )

    def work(self, task: Task, settings: Settings) -> Outcome:
        """Send a task to the process, and wait for the outcome.

        :raises EOFError: the process ended before it sent an outcome.
        """
        try:
            assert self._process.stdin is not None
            assert self._process.stdout is not None
            pickle.dump((task, settings), self._process.stdin)
            self._process.stdin.flush()
            outcome: Outcome = pickle.load(self._process.stdout)
        except Exception as cause:
            raise EOFError from cause
        return outcome

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()

    def wait(self) -> int:
        """Wait until the process ends; return its exit code, or minus the signal that ended it."""
        code = self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()
        return code


def _crash_outcome(task: Task, code: int) -> Outcome:
    """Return the failure of a task whose process ended.

    :param code: exit code of the process, or minus the number of a signal.
    """
    exit_text = f"signal {-code}" if code < 0 else f"exit code {code}"
    program = task.job.program
    message = f"{program}: its worker process ended ({exit_text}), perhaps for lack of memory. Use fewer --jobs."
    return Outcome(str(program), FAILED, message=message, keeps_old_files=True)


def main() -> None:
    """Run a worker: tasks from standard input, outcomes to standard output, until the other end is closed."""
    outcomes = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # other output goes to standard error, not between the outcomes
    logging.captureWarnings(True)
    for name in ("SIGINT", "SIGHUP", "SIGBREAK"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)  # the process that started this worker ends it
    tasks: SimpleQueue[tuple[Task, Settings]] = SimpleQueue()
    threading.Thread(target=_receive, args=(tasks,), daemon=True).start()
    code = 0
    try:
        while True:
            pickle.dump(_convert_task(*tasks.get()), outcomes)
            outcomes.flush()
    except BrokenPipeError:
        pass
    except BaseException:
        traceback.print_exc()
        code = 1
    os._exit(code)  # at once: the thread that reads tasks may still wait


def _receive(tasks: SimpleQueue[tuple[Task, Settings]]) -> None:
    """Read tasks from standard input into a queue; end this process as soon as the other end of the pipe is closed."""
    try:
        while True:
            tasks.put(pickle.load(sys.stdin.buffer))
    except (EOFError, OSError, pickle.UnpicklingError):
        os._exit(0)


@lru_cache(maxsize=1)
def _setup(settings: Settings) -> tuple[Cell, RobotModel]:
    """Return cell and robot of the settings; read once for all tasks with the same settings.

    :raises PostprocError: one of them cannot be read.
    """
    return load_setup(settings)


def _convert_task(task: Task, settings: Settings) -> Outcome:
    """Run a task in this process; return its outcome, a failure if the set-up cannot be read."""
    try:
        cell, robot = _setup(settings)
    except Exception as cause:
        return failure(task.job, cause)
    return convert(task, settings, cell, robot)


OtherCode = tuple[str, str]
"""Address of a worker with other code, and the version of its postproc; empty: it has no postproc."""
PATIENCE = 10.0
"""Time to wait for an answer of the scheduler, or for a worker, before the work is given up [s]."""
_SIGN_TIMEOUT = 60.0
"""Time without a sign of life of a worker after which its tasks are given up [s]."""
_LOOK = 5.0
"""Time between two questions to the scheduler about its workers [s] (assumed)."""
_ADDRESS = re.compile(r"(tcp|tls)://(\[[\da-fA-F:.]+\]|[\w.-]+):\d{1,5}")


class Cluster(Struct, frozen=True):
    """A Dask cluster. Its scheduler and workers execute what they are sent: it must be on a trusted network, or TLS.

    Its workers must see the same files under the same paths, and have the same postproc.

    :param address: address of the scheduler, such as ``tcp://10.0.0.5:8786`` or ``tls://10.0.0.5:8786``.
    :param ca: file of the authority that signed the certificates (PEM), for ``tls://``.
    :param certificate: file of the certificate of this process (PEM).
    :param key: file of the key of this certificate (PEM). For files that are None, those of Dask's configuration are
        used.
    """

    address: str
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None


class _Sign(NamedTuple):
    """Last sign of life of a worker, by the clock of the scheduler and by that of this machine [s]."""

    scheduler_s: float
    machine_s: float


class ClusterWorkers:
    """Workers of a Dask cluster, which do each task in a process of its own if they have the same code.

    :param settings: settings of all tasks.
    :raises PostprocError: Dask is not installed, no scheduler answers, or it has no workers.
    """

    _futures: dict[Path, Any]
    """Program → future of its task."""
    _signs: dict[str, _Sign]
    """Address of a worker → its last sign of life."""
    _worker_of_task: dict[str, str]
    """Key of a task → address of the worker that has it."""

    def __init__(self, cluster: Cluster, settings: Settings) -> None:
        self._cluster = cluster
        self._settings = replace(settings, cell=settings.cell.resolve())
        self._client = _connect(cluster)
        self._code = inputs.code_sum()
        self._last_answer = self._last_look = time.monotonic()
        self._futures, self._signs, self._worker_of_task = {}, {}, {}

    def begin(self, task: Task) -> Any:
        """Send a task to the cluster; return its future."""
        content = pickle.dumps((_absolute(task), self._settings))
        future = self._client.submit(_work_function(), self._code, content, pure=False)
        self._futures[task.job.program] = future
        return future

    def outcome(self, future: Any, task: Task) -> Outcome:
        """Return the outcome of a task that has ended, with the path of the program on this machine.

        A task that was cancelled or could not be run, and a worker with other code, give a failure.
        """
        self._last_answer = time.monotonic()
        program = str(task.job.program)
        if future.cancelled():
            return self._loss_outcome(task)
        try:
            outcome: Outcome | OtherCode = future.result(timeout=PATIENCE)
        except Exception as cause:
            message = f"{program}: the cluster could not convert it: {cause!r}"
            return Outcome(program, FAILED, message=message, keeps_old_files=True)
        if isinstance(outcome, Outcome):
            return replace(outcome, program=program)
        worker, version = outcome
        installation = f"postproc {version} with other code" if version else "no postproc"
        message = (
            f"{program}: the worker {worker} of the Dask cluster at {self._cluster.address} has {installation}, this "
            f"machine has postproc {VERSION}. Install the same on all of them."
        )
        return Outcome(program, FAILED, message=message, keeps_old_files=True)

    def lost_outcome(self, task: Task) -> Outcome | None:
        """Return a failure if the cluster or the worker of a task has not responded for some time; else None.

        The time limit is `PATIENCE` for the cluster and `_SIGN_TIMEOUT` for a worker.
        """
        self._update_workers()
        if time.monotonic() > self._last_answer + PATIENCE:
            return self._loss_outcome(task)
        worker = self._worker_of_task.get(self._futures[task.job.program].key)
        if worker is None or time.monotonic() < self._signs[worker].machine_s + _SIGN_TIMEOUT:
            return None
        message = (
            f"{task.job.program}: the worker {worker} of the Dask cluster has given no sign of life for "
            f"{_SIGN_TIMEOUT:g} s. Restart it, and convert this program again."
        )
        return Outcome(str(task.job.program), FAILED, message=message, keeps_old_files=True)

    def _update_workers(self) -> None:
        """Ask the scheduler for signs of life of the workers and for their tasks, every `_LOOK` seconds at most.

        If the scheduler does not answer, nothing is updated.
        """
        time_s = time.monotonic()
        is_due = time_s >= self._last_look + min(_LOOK, PATIENCE / 4.0)
        if not is_due or self._client.status != "running":
            return
        self._last_look = time_s
        with suppress(Exception):  # without an answer `_last_answer` stays, and `lost_outcome` gives up in time
            workers = self._client.sync(self._client.scheduler.identity, callback_timeout=PATIENCE)["workers"]
            self._last_answer = time_s if workers else self._last_answer
            for address, worker in workers.items():
                last_sign = self._signs.get(address)
                if last_sign is None or last_sign.scheduler_s != worker["last_seen"]:  # a new sign of life
                    self._signs[address] = _Sign(worker["last_seen"], time_s)
            tasks = self._client.sync(self._client.scheduler.processing, workers=None, callback_timeout=PATIENCE)
            self._worker_of_task = {
                key: worker for worker, keys in tasks.items() if worker in self._signs for key in keys
            }

    def end(self) -> None:
        """Cancel tasks that have not begun. The cluster finishes the others, whose staged files stay."""
        with suppress(Exception):
            self._client.cancel([future for future in self._futures.values() if not future.done()])
        self._client.close(timeout=2)

    def _loss_outcome(self, task: Task) -> Outcome:
        """Return the failure of a task whose scheduler or workers are gone."""
        program = task.job.program
        message = f"{program}: the Dask scheduler at {self._cluster.address} or all its workers are gone."
        return Outcome(str(program), FAILED, message=message, keeps_old_files=True)


def _connect(cluster: Cluster) -> Any:
    """Return a client of a scheduler that has workers.

    :raises PostprocError: Dask is not installed, or no scheduler with workers answers.
    """
    try:
        import distributed
    except ImportError:
        raise PostprocError(
            "--scheduler needs dask.distributed, which is not installed. Install it with: pip install 'postproc[dask]'"
        ) from None
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # outcomes say that a worker or the scheduler is lost
    address = cluster.address
    if not _ADDRESS.fullmatch(address):
        raise PostprocError(f"{address} is no address of a Dask scheduler. Give tcp://HOST:PORT or tls://HOST:PORT.")
    security = _security(cluster)
    try:
        client: Any = distributed.Client(address, security=security, timeout=PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError) as cause:
        raise PostprocError(f"no Dask scheduler answers at {address} ({cause})") from cause
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except (OSError, TimeoutError) as cause:
        client.close(timeout=2)
        raise PostprocError(
            f"the Dask scheduler at {address} has no workers. Start some on the machines that shall do the work: "
            f"dask worker {address}"
        ) from cause
    return client


def _work_function() -> Callable[[str, bytes], Outcome | OtherCode]:
    """Return the function that a worker of a cluster runs.

    It is a local function, which Dask sends as code: the postproc of the worker may be another version that lacks it.
    """

    def work(code: str, content: bytes) -> Any:
        """Return the outcome of a task on another machine; if its code differs, address and version of the worker.

        postproc is imported within the function, because the machine may have another version or none.

        :param code: checksum of the code of postproc on the machine that sends the task.
        :param content: pickled task and settings.
        """
        import pickle

        from distributed import get_worker

        try:
            from postproc.jobs.inputs import code_sum
            from postproc.version import VERSION

            is_same, version = code_sum() == code, VERSION
        except ImportError:
            is_same, version = False, ""
        if not is_same:
            return get_worker().address, version
        from postproc.jobs.workers import work_in_process

        return work_in_process(*pickle.loads(content))

    return work


def _security(cluster: Cluster) -> Any:
    """Return Dask's object with the certificates for ``tls://``; None for ``tcp://``.

    :raises PostprocError: certificates are missing or cannot be used.
    """
    from distributed.security import Security

    if not cluster.address.startswith("tls://"):
        return None
    files = {"tls_ca_file": cluster.ca, "tls_client_cert": cluster.certificate, "tls_client_key": cluster.key}
    try:
        security = Security(require_encryption=True, **{name: str(path) for name, path in files.items() if path})
        context = security.get_connection_args("client").get("ssl_context")
    except OSError as cause:  # ssl.SSLError is one, too
        raise PostprocError(f"the certificates for {cluster.address} cannot be used ({cause})") from cause
    if context is None:
        raise PostprocError(
            f"{cluster.address} needs certificates. Give --tls-ca, --tls-cert and --tls-key, or name them in Dask's "
            "configuration (distributed.comm.tls)."
        )
    return security


def _absolute(task: Task) -> Task:
    """Return a task with absolute paths, which hold on other machines too."""
    job = task.job
    forces = None if job.forces is None else job.forces.resolve()
    job = replace(job, program=job.program.resolve(), output=job.output.resolve(), forces=forces)
    return replace(
        task, job=job, records=tuple(replace(record, folder=record.folder.resolve()) for record in task.records)
    )
