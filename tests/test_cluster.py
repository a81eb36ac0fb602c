"""A Dask cluster does the same work; what is missing or goes away is told and leaves nothing half-written."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from postproc.errors import PostprocError
from postproc.jobs import Settings, convert_all, find_jobs, inputs
from postproc.jobs.workers import Cluster, ClusterWorkers
from postproc.version import VERSION
from tests.processes import CELL_16, Held, programs, written

distributed = pytest.importorskip("distributed", reason="an extra: pip install 'postproc[dask]'")
pytestmark = [
    pytest.mark.usefixtures("work_folder"),
    pytest.mark.filterwarnings("default"),  # what Dask leaves open when it is shut down is not ours
]
SETTINGS = Settings(Path(CELL_16))
BOUND = re.compile(r"Scheduler at:\s+(t\w+://\S+)")


def work(address: str, *tls: Path) -> dict[str, object]:
    jobs = find_jobs(["."], output=Path("out"))
    return {outcome.program: outcome for outcome in convert_all(jobs, SETTINGS, cluster=Cluster(address, *tls))}


def cluster(**options) -> object:
    return distributed.LocalCluster(threads_per_worker=1, dashboard_address=None, **options)


def test_it_does_the_same_work():
    programs(2)
    Path("bad.nc").write_text("G999 X1\n")
    with cluster(n_workers=1) as there:
        outcomes = work(there.scheduler_address)
    assert {name: outcome.code for name, outcome in outcomes.items()} == {"p00.src": 0, "p01.src": 0, "bad.nc": 1}
    assert written() == {"p00", "p01"}
    assert [outcome.code for outcome in convert_all(find_jobs(["."], output=Path("here")), SETTINGS)] == [1, 0, 0]
    for path in (path for path in Path("out").iterdir() if path.name != "index.html"):  # that names its folder
        assert path.read_bytes() == Path("here", path.name).read_bytes()


def test_without_dask_it_says_what_to_install(monkeypatch):
    programs(1)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(PostprocError, match=r"pip install 'postproc\[dask\]'"):
        work("tcp://127.0.0.1:1")


@pytest.mark.parametrize("address", ["127.0.0.1:8786", "http://127.0.0.1:8787", "tcp://127.0.0.1", "cluster"])
def test_what_is_no_address_is_told(address):
    programs(1)
    with pytest.raises(PostprocError, match="no address of a Dask scheduler"):
        work(address)


def test_without_a_scheduler_it_does_not_wait_for_ever(monkeypatch):
    programs(1)
    monkeypatch.setattr("postproc.jobs.workers.PATIENCE", 1.0)
    with pytest.raises(PostprocError, match="no Dask scheduler answers at tcp://127"):
        work("tcp://127.0.0.1:9")


def test_without_workers_it_does_not_wait_for_ever(monkeypatch):
    programs(1)
    monkeypatch.setattr("postproc.jobs.workers.PATIENCE", 1.0)
    with cluster(n_workers=0) as there, pytest.raises(PostprocError, match=r"has no workers\. Start some"):
        work(there.scheduler_address)
    assert not Path("out").exists()


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """An authority, a certificate that it signed, its key; and another authority."""
    folder = tmp_path_factory.mktemp("tls")

    def openssl(arguments: str) -> None:
        subprocess.run(["openssl", *arguments.split()], cwd=folder, check=True, capture_output=True)

    for name in ("ca", "other"):
        openssl(f"req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=authority -keyout {name}.key -out {name}.pem")
    openssl("req -newkey rsa:2048 -nodes -subj /CN=node -keyout node.key -out node.csr")
    openssl("x509 -req -in node.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 2 -out node.pem")
    return folder


@pytest.fixture
def encrypted(certificates):
    ca, pem, key = (str(certificates / name) for name in ("ca.pem", "node.pem", "node.key"))
    roles = {f"tls_{role}_{kind}": path for role in ("client", "scheduler", "worker") for kind, path in
             (("cert", pem), ("key", key))}  # fmt: skip
    security = distributed.Security(tls_ca_file=ca, require_encryption=True, **roles)
    with cluster(n_workers=1, security=security, protocol="tls://") as there:
        yield there.scheduler_address


def test_tls_with_certificates_given_or_of_dasks_configuration(encrypted, certificates):
    import dask

    assert encrypted.startswith("tls://")
    ca, pem, key = (certificates / name for name in ("ca.pem", "node.pem", "node.key"))
    programs(1)
    assert work(encrypted, ca, pem, key)["p00.src"].code == 0
    named = {"ca-file": str(ca), "client.cert": str(pem), "client.key": str(key)}
    with dask.config.set({f"distributed.comm.tls.{name}": path for name, path in named.items()}):
        assert work(encrypted)["p00.src"].code == 0
    assert written() == {"p00"}


def test_tls_without_certificates_with_wrong_ones_or_none_at_all_is_an_error(encrypted, certificates, monkeypatch):
    monkeypatch.setattr("postproc.jobs.workers.PATIENCE", 2.0)
    pem, key = certificates / "node.pem", certificates / "node.key"
    programs(1)
    with pytest.raises(PostprocError, match=r"needs certificates\. Give --tls-ca"):
        work(encrypted)
    with pytest.raises(PostprocError, match="cannot be used"):
        work(encrypted, certificates / "none.pem", pem, key)
    with pytest.raises(PostprocError, match="no Dask scheduler answers"):
        work(encrypted, certificates / "other.pem", pem, key)
    with pytest.raises(PostprocError, match="no Dask scheduler answers"):
        work(encrypted.replace("tls:", "tcp:"))


@pytest.mark.skipif(os.name != "posix", reason="kills processes")
@pytest.mark.parametrize("lost", ["scheduler", "worker"])
def test_a_lost_peer_is_told_and_leaves_nothing_half_written(lost):
    programs(4)
    with ExitStack() as processes:

        def started(*arguments: str, **options) -> subprocess.Popen[str]:
            command = [sys.executable, "-m", f"distributed.cli.{arguments[0]}", *arguments[1:], "--no-dashboard"]
            pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
            process = processes.enter_context(subprocess.Popen(command, **pipe, **options))
            processes.callback(process.kill)
            return process

        scheduler = started("dask_scheduler", "--host", "127.0.0.1", "--port", "0")
        (address,) = next(filter(None, map(BOUND.findall, scheduler.stdout)))
        held = Held("postproc.files.writing:_write:2", "convert", ".", "--cell", CELL_16, "-o", "out", "--scheduler",
                    address)  # fmt: skip
        options = ("--nworkers", "1", "--nthreads", "2", "--no-nanny")
        worker = started("dask_worker", address, *options, env=held.environment)
        held.waiting(2)
        {"scheduler": scheduler, "worker": worker}[lost].send_signal(signal.SIGKILL)
        if lost == "scheduler":
            held.go()
        code, _, stderr = held.end()
        assert code == 1
        assert stderr.count("the Dask scheduler at") == stderr.count("Error:") == 4, stderr
        worker.kill()
        worker.stdout.read()  # the pipe is closed when the last process that the worker has started is gone
        assert written() == set()  # what is in its place was put there by this process, and reported as written


def test_each_task_is_refused_by_a_worker_with_other_code_which_is_named(monkeypatch):
    """Also by one that joins after the others: nothing is asked at the connection."""
    programs(2)
    Path("out").mkdir()
    with cluster(n_workers=1) as there:
        monkeypatch.setattr("postproc.jobs.inputs.code_sum", lambda: "0" * 64)
        outcomes = work(there.scheduler_address)
        (worker,) = there.scheduler_info["workers"]
    assert [outcome.code for outcome in outcomes.values()] == [1, 1]
    said = (
        f"the worker {worker} of the Dask cluster at {there.scheduler_address} has postproc {VERSION} with other code"
    )
    assert all(said in outcome.message for outcome in outcomes.values())
    assert not list(Path("out").glob("*.src"))


@pytest.mark.skipif(os.name != "posix", reason="stops a process")
def test_a_frozen_worker_is_named(monkeypatch):
    programs(1)
    for name, seconds in (("_SIGN_TIMEOUT", 3.0), ("_LOOK", 0.2)):
        monkeypatch.setattr(f"postproc.jobs.workers.{name}", seconds)
    with cluster(n_workers=1) as there:
        (worker,) = there.scheduler_info["workers"]
        process = there.workers[0].pid
        begin = ClusterWorkers.begin

        def frozen(workers, task):
            os.kill(process, signal.SIGSTOP)
            return begin(workers, task)

        monkeypatch.setattr(ClusterWorkers, "begin", frozen)
        try:
            (outcome,) = work(there.scheduler_address).values()
        finally:
            os.kill(process, signal.SIGCONT)
    assert outcome.code == 1
    assert f"the worker {worker} of the Dask cluster has given no sign of life for 3 s" in outcome.message


def test_the_sum_of_the_code_is_that_of_names_and_contents(tmp_path):
    sums = []
    for name, text in (("a.py", "x"), ("a.py", "y"), ("b.py", "y"), ("b.txt", "z")):
        (tmp_path / name).write_text(text)
        sums.append(inputs.code_sum(tmp_path))
    assert len(set(sums)) == 3
    assert sums[2] == sums[3]
