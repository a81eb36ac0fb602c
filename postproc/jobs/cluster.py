"""Programs on the workers of a Dask cluster, each in a process of its own there (see `jobs.pool`)."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from postproc import interrupts
from postproc.errors import PostprocError
from postproc.jobs.job import Job
from postproc.jobs.outcome import FAILED, Outcome, Settings

_PATIENCE = 10.0
"""Seconds that are waited for the scheduler, or for a worker, before the work is given up."""
_ADDRESS = re.compile(r"(tcp|tls)://(\[[\da-fA-F:.]+\]|[\w.-]+):\d{1,5}")
_POLL = 0.2
"""Seconds between two looks at the cluster and at whether a signal came."""


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


def convert_on_cluster(lines: Sequence[Sequence[Job]], settings: Settings, cluster: Cluster) -> Iterator[Outcome]:
    """Work through jobs on a cluster, those of a line one after the other; yield each outcome as it comes.

    When a signal asks for the end (`interrupts.came`), what waits is cancelled; the cluster finishes what it has begun.

    :raises PostprocError: there is no Dask, no scheduler answers, or it has no workers.
    """
    client = _connected(cluster)
    try:
        yield from _outcomes(client, lines, settings, cluster)
    finally:
        client.close(timeout=2)


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
    return client


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


def _outcomes(client: Any, lines: Sequence[Sequence[Job]], settings: Settings, cluster: Cluster) -> Iterator[Outcome]:
    from postproc.jobs.pool import work_alone  # what runs processes is imported where there are some

    done: SimpleQueue[Any] = SimpleQueue()
    settings = replace(settings, cell=settings.cell.resolve())
    waiting: dict[Any, Sequence[Job]] = {}

    def begin(line: Sequence[Job]) -> None:
        future = client.submit(work_alone, _absolute(line[0]), settings, pure=False)
        waiting[future] = line
        future.add_done_callback(done.put)

    for line in lines:
        begin(line)
    alive = time.monotonic()
    while waiting:
        with suppress(Empty):
            future = done.get(timeout=_POLL)
            job, *later = waiting.pop(future)
            if later and not interrupts.came():
                begin(later)
            yield _outcome(future, job, cluster)
            continue
        if interrupts.came():
            client.cancel(list(waiting))
            return
        if client.status == "running" and client.scheduler_info()["workers"]:
            alive = time.monotonic()
        elif time.monotonic() > alive + _PATIENCE:
            for job in (job for line in waiting.values() for job in line):
                yield _lost(job, cluster)
            return


def _absolute(job: Job) -> Job:
    forces = None if job.forces is None else job.forces.resolve()
    return replace(job, program=job.program.resolve(), output=job.output.resolve(), forces=forces)


def _outcome(future: Any, job: Job, cluster: Cluster) -> Outcome:
    """Return what came of a job, with the name the user knows."""
    if future.cancelled():
        return _lost(job, cluster)
    try:
        outcome: Outcome = future.result(timeout=_PATIENCE)
    except Exception as cause:
        return Outcome(str(job.program), FAILED, message=f"{job.program}: the cluster could not do it: {cause!r}")
    return replace(outcome, program=str(job.program))


def _lost(job: Job, cluster: Cluster) -> Outcome:
    message = f"{job.program}: the Dask scheduler at {cluster.address} or all its workers are gone."
    return Outcome(str(job.program), FAILED, message=message)
