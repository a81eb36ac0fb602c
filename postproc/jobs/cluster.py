"""Programs on the workers of a Dask cluster, each in a process of its own there (see `workers`)."""

from __future__ import annotations

import logging
import re
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from postproc.errors import PostprocError
from postproc.jobs.output_plan import Task
from postproc.jobs.settings import FAILED, Outcome, Settings
from postproc.version import VERSION

_PATIENCE = 10.0
"""Seconds that are waited for the scheduler, or for a worker, before the work is given up."""
_ADDRESS = re.compile(r"(tcp|tls)://(\[[\da-fA-F:.]+\]|[\w.-]+):\d{1,5}")


class Cluster(Struct, frozen=True):
    """A Dask cluster. Its scheduler and workers execute what they are sent: it must be on a trusted network, or TLS.

    Its workers must see the same files under the same paths, and have the same postproc.

    :param address: of the scheduler, e.g. ``tcp://10.0.0.5:8786`` or ``tls://10.0.0.5:8786``.
    :param ca: file of the authority that signed the certificates (PEM), for ``tls://``; None = of Dask's configuration.
    :param certificate: that this process shows (PEM).
    :param key: of the certificate (PEM).
    """

    address: str
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None


class ClusterWorkers:
    """Workers of a Dask cluster; each task is done in a process of its own there.

    :param settings: settings of all tasks.
    :raises PostprocError: there is no Dask, no scheduler answers, or it has no workers.
    """

    def __init__(self, cluster: Cluster, settings: Settings) -> None:
        self._cluster = cluster
        self._settings = replace(settings, cell=settings.cell.resolve())
        self._client = _connected(cluster)
        self._alive = time.monotonic()
        self._begun: list[Any] = []

    def begin(self, task: Task) -> Any:
        """Send a task to the cluster; return its future."""
        from postproc.jobs.workers import work_alone

        future = self._client.submit(work_alone, _absolute(task), self._settings, pure=False)
        self._begun.append(future)
        return future

    def outcome(self, future: Any, task: Task) -> Outcome:
        """Return what came of a task, with the name that the user knows."""
        self._alive = time.monotonic()
        if future.cancelled():
            return self._gone(task)
        try:
            outcome: Outcome = future.result(timeout=_PATIENCE)
        except Exception as cause:
            message = f"{task.job.program}: the cluster could not convert it: {cause!r}"
            return Outcome(str(task.job.program), FAILED, message=message, keeps_earlier=True)
        return replace(outcome, program=str(task.job.program))

    def lost(self, task: Task) -> Outcome | None:
        """Return a failure if the cluster has not been there for some time."""
        if self._client.status == "running" and self._client.scheduler_info()["workers"]:
            self._alive = time.monotonic()
        return self._gone(task) if time.monotonic() > self._alive + _PATIENCE else None

    def end(self) -> None:
        """Cancel what waits; the cluster finishes what it has begun, and leaves staged files."""
        with suppress(Exception):
            self._client.cancel([future for future in self._begun if not future.done()])
        self._client.close(timeout=2)

    def _gone(self, task: Task) -> Outcome:
        program = task.job.program
        message = f"{program}: the Dask scheduler at {self._cluster.address} or all its workers are gone."
        return Outcome(str(program), FAILED, message=message, keeps_earlier=True)


def _connected(cluster: Cluster) -> Any:
    """Return a client of a scheduler that has workers."""
    try:
        import distributed
    except ImportError:
        raise PostprocError(
            "--scheduler needs dask.distributed, which is not installed. Install it with: pip install 'postproc[dask]'"
        ) from None
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what it has to say about a lost peer, we say
    address = cluster.address
    if not _ADDRESS.fullmatch(address):
        raise PostprocError(f"{address} is no address of a Dask scheduler. Give tcp://HOST:PORT or tls://HOST:PORT.")
    security = _security(cluster)
    try:
        client: Any = distributed.Client(address, security=security, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError) as cause:
        raise PostprocError(f"no Dask scheduler answers at {address} ({cause})") from cause
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except (OSError, TimeoutError) as cause:
        client.close(timeout=2)
        raise PostprocError(
            f"the Dask scheduler at {address} has no workers. Start some on the machines that shall do the work: "
            f"dask worker {address}"
        ) from cause
    _check_versions(client, cluster)
    return client


def _check_versions(client: Any, cluster: Cluster) -> None:
    """Refuse workers with another version of postproc: their results would not be those of this one."""

    def version() -> str:  # sent as code: an older postproc need not know it
        try:
            from postproc import version as there
        except ImportError:
            return ""
        return there.VERSION

    other = {worker: found for worker, found in client.run(version).items() if found != VERSION}
    if other:
        client.close(timeout=2)
        worker, found = min(other.items())
        which = f"postproc {found}" if found else "no postproc"
        raise PostprocError(
            f"the worker {worker} of the Dask cluster at {cluster.address} has {which}, this machine has postproc "
            f"{VERSION}. Install the same version on all of them."
        )


def _security(cluster: Cluster) -> Any:
    """Return the certificates of ``tls://``; None for ``tcp://``."""
    from distributed.security import Security

    if not cluster.address.startswith("tls://"):
        return None
    given = {"tls_ca_file": cluster.ca, "tls_client_cert": cluster.certificate, "tls_client_key": cluster.key}
    try:
        security = Security(require_encryption=True, **{name: str(path) for name, path in given.items() if path})
        context = security.get_connection_args("client").get("ssl_context")
    except OSError as cause:  # ssl.SSLError too
        raise PostprocError(f"the certificates for {cluster.address} cannot be used ({cause})") from cause
    if context is None:
        raise PostprocError(
            f"{cluster.address} needs certificates. Give --tls-ca, --tls-cert and --tls-key, or name them in Dask's "
            "configuration (distributed.comm.tls)."
        )
    return security


def _absolute(task: Task) -> Task:
    """Return a task with paths that are the same on other machines."""
    job = task.job
    forces = None if job.forces is None else job.forces.resolve()
    job = replace(job, program=job.program.resolve(), output=job.output.resolve(), forces=forces)
    return replace(task, job=job, records=tuple(replace(record, at=record.at.resolve()) for record in task.records))
