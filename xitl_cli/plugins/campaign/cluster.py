"""Dask: workers on this machine, or those of a scheduler by address.

A Dask scheduler and its workers run all code that a client sends. The cluster on this machine therefore listens on
loopback only. It accepts only holders of a certificate that is made for the campaign and never written to a permanent
file.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import platform
import queue
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

from agent import __version__
from agent.machine import usable_processors
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.extras import CAMPAIGN
from xitl_cli.plugins.campaign.execution import Row, RunTask, prepare_for_runs, run_point, stop_runs

LOOPBACK = "127.0.0.1"
CONNECT_S = 10.0
WORKERS_S = 30.0
"""Timeout for workers of an external scheduler; OWN_WORKERS_S is for workers that this process starts."""
OWN_WORKERS_S = 180.0
_CAPACITY_EVERY_S = 2.0
_SCRATCH = "temporary-directory"
_SETTINGS = {
    "distributed.scheduler.allowed-failures": 0,  # the campaign counts attempts
    "distributed.scheduler.worker-saturation": 1.0,  # no run waits at a worker that may be killed
    "distributed.worker.daemon": False,
    "distributed.scheduler.active-memory-manager.start": False,
    # Dask monitors its work, which runs in other processes here: this took 2 % of a core.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.tick.limit": "60s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.memory.monitor-interval": "5s",
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
}


class SchedulerAwayError(UserError):
    """A scheduler is not reachable, or not any more."""


def check_installed() -> None:
    """Raise UserError when packages of the extra are missing."""
    CAMPAIGN.require("a campaign needs")


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """PEM files to reach a scheduler by TLS. None: use Dask's configuration."""

    ca_file: str | None = None
    """Certificates of the authority that signed the cluster's certificates."""
    certificate: str | None = None
    """Certificate of this client, signed by that authority."""
    key: str | None = None
    """Key of the certificate; None if the certificate's file contains it."""

    def security(self, address: str) -> Any:
        """Return Dask's description of a client's TLS.

        Raises UserError for a file that cannot be read, a `tls://` address without files, and files without `tls://`.
        """
        from distributed import Security

        files = {"tls_ca_file": self.ca_file, "tls_client_cert": self.certificate, "tls_client_key": self.key}
        security: Any = Security(**{name: path for name, path in files.items() if path is not None})
        encrypted = address.startswith("tls://")
        if any(files.values()) and not encrypted:
            raise UserError(f"--on {address}: --tls-ca-file, --tls-cert and --tls-key need an address tls://host:port")
        if encrypted and not (security.tls_ca_file and security.tls_client_cert):
            raise UserError(
                f"--on {address}: TLS needs --tls-ca-file and --tls-cert, or distributed.comm.tls of Dask's settings"
            )
        try:
            security.get_connection_args("client")
        except OSError as error:  # includes ssl.SSLError
            why = error.strerror or str(error)
            raise UserError(
                f"--on {address}: the TLS files cannot be used ({why}); give PEM files that exist"
            ) from None
        return security


def is_open(address: str) -> bool:
    """Return True if a scheduler's address is on a network and without TLS."""
    scheme, _, host = address.rpartition("://")
    return scheme != "tls" and not host.startswith(("127.", "localhost:", "[::1]"))


class DaskWorkers:
    """Runs as tasks of a Dask scheduler; use `local_workers` or `workers_at`."""

    def __init__(self, client: Any, campaign: str, where: str) -> None:
        self._client, self._campaign, self._where = client, campaign, where
        self._ended: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        self._futures: dict[int, Any] = {}
        self._submitted = 0
        self._threads, self._asked_s = 0, -_CAPACITY_EVERY_S

    @property
    def dashboard(self) -> str | None:
        """Address of Dask's dashboard, if bokeh is installed."""
        if find_spec("bokeh") is None:
            return None
        link: str | None = self._client.dashboard_link
        return link

    @property
    def threads(self) -> int:
        """Number of parallel runs."""
        if time.monotonic() - self._asked_s >= _CAPACITY_EVERY_S:
            try:
                scheduler = self._client.scheduler_info(n_workers=-1)
            except TypeError:  # older versions had no limit
                scheduler = self._client.scheduler_info()
            self._threads = sum(worker["nthreads"] for worker in scheduler["workers"].values())
            self._asked_s = time.monotonic()
        return self._threads

    @property
    def capacity(self) -> int:
        """Twice the number of parallel runs: the others wait at the scheduler, so that no worker waits for this
        process.
        """
        return 2 * max(self.threads, 1) + 1

    def submit(self, task: RunTask) -> None:
        """See `engine.Workers`."""
        self._submitted += 1
        key = f"xitl-{self._campaign}-{task.number}-{self._submitted}"
        try:
            future = self._client.submit(run_point, task, key=key, pure=False)
        except Exception as error:
            raise self._away() from error
        self._futures[task.number] = future
        future.add_done_callback(lambda done: self._ended.put((task.number, done)))

    def next(self, wait_s: float) -> tuple[int, Row | None] | None:
        """See `engine.Workers`."""
        try:
            number, future = self._ended.get(timeout=wait_s)
        except queue.Empty:
            if self._client.status not in ("running", "connecting", "newly-created"):
                raise self._away() from None
            return None
        if future is not self._futures.get(number):
            return None  # of a previous attempt
        return number, self._row(future)

    def _row(self, future: Any) -> Row | None:
        from distributed import KilledWorker

        if future.status in ("cancelled", "lost"):
            raise self._away()
        try:
            row: Row = future.result(timeout=60)
        except KilledWorker:
            return None
        except OSError as error:
            if isinstance(error, TimeoutError) or type(error).__module__.startswith("distributed"):
                raise self._away() from error
            raise UserError(f"{error.filename or 'a worker'}: cannot store runs there ({error.strerror})") from None
        except Exception as error:
            if type(error).__module__.startswith(("distributed", "concurrent", "asyncio")):
                raise self._away() from error
            raise
        future.release()
        return row

    def _away(self) -> SchedulerAwayError:
        return SchedulerAwayError(
            f"{self._where}: the scheduler does not respond; completed runs are kept; continue with --resume"
        )

    def stop(self) -> None:
        """Cancel running and waiting runs."""
        with contextlib.suppress(Exception):
            self._client.cancel(list(self._futures.values()), force=True)
        with contextlib.suppress(Exception):
            self._client.run(stop_runs, self._campaign, on_error="ignore")


def _silence_logs() -> None:
    """Silence Dask's loggers, some of which have a separate level. xitl reports problems itself."""
    for name in [name for name in logging.root.manager.loggerDict if name.split(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextlib.contextmanager
def local_workers(count: int | None, campaign: str) -> Iterator[DaskWorkers]:
    """Run a scheduler in this process and worker processes of one thread on this machine, one per core by default.

    A killed worker is replaced. All workers end when this process ends for any reason. They listen on loopback and use
    TLS with a certificate of this campaign alone. Their scratch files are in a directory that only this user may enter.
    Dask's default is a shared name in /tmp, which another user may create first.
    """
    check_installed()
    import dask
    from distributed import Client, LocalCluster, Security

    security = Security.temporary()
    count = count or usable_processors()
    _silence_logs()
    with (
        tempfile.TemporaryDirectory(prefix="xitl-campaign-", ignore_cleanup_errors=True) as scratch,
        dask.config.set({**_SETTINGS, _SCRATCH: scratch}),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # for example for a dashboard port in use
        with (
            LocalCluster(
                n_workers=0,
                processes=True,
                host=LOOPBACK,
                protocol="tls://",
                security=security,
                dashboard_address=f"{LOOPBACK}:0",
                silence_logs=logging.CRITICAL,
            ) as cluster,
            Client(cluster, set_as_default=False) as client,
            _WorkerProcesses(cluster.scheduler_address, count, security, scratch),
        ):
            if not _workers_connect(client, count, OWN_WORKERS_S):
                raise UserError(
                    f"not all {count} worker processes of the campaign started within {OWN_WORKERS_S:g} s; "
                    "free memory and processors on this machine, or start fewer with --workers"
                )
            workers = DaskWorkers(client, campaign, cluster.scheduler_address)
            try:
                yield workers
            finally:
                workers.stop()


class _WorkerProcesses:
    """A constant number of processes `python -m xitl_cli.plugins.campaign.cluster ADDRESS SCRATCH`.

    Each reads the campaign's certificate and key from its standard input: other users see neither.
    """

    def __init__(self, address: str, count: int, security: Any, scratch: str) -> None:
        self._command = [sys.executable, "-m", "xitl_cli.plugins.campaign.cluster", address, scratch]
        self._credentials = f"{json.dumps([security.tls_worker_cert, security.tls_worker_key])}\n".encode()
        self._closing = threading.Event()
        self._processes = [self._started() for _ in range(count)]
        self._keeper = threading.Thread(target=self._keep, name="campaign workers", daemon=True)

    def _started(self) -> subprocess.Popen[bytes]:
        # Its standard input ends with this process, which ends the worker. Only this process gets a Ctrl-C at the
        # terminal.
        process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        assert process.stdin is not None
        with contextlib.suppress(OSError):  # a worker that has already ended is replaced
            process.stdin.write(self._credentials)
            process.stdin.flush()
        return process

    def _keep(self) -> None:
        while not self._closing.wait(0.2):
            for number, process in enumerate(self._processes):
                if process.poll() is not None:
                    self._close(process)
                    self._processes[number] = self._started()

    def _close(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()

    def __enter__(self) -> _WorkerProcesses:
        self._keeper.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._closing.set()
        self._keeper.join()
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()
            self._close(process)


@contextlib.contextmanager
def workers_at(address: str, campaign: str, folder: Path | None, tls: TlsFiles | None = None) -> Iterator[DaskWorkers]:
    """Use the workers of an existing scheduler. folder: of kept runs, which workers must see.

    tls: files for a `tls://` address. Raises UserError before any run in these cases: the scheduler does not answer or
    has no workers, versions differ, or TLS files are unusable.
    """
    check_installed()
    from distributed import Client

    security = (tls or TlsFiles()).security(address)
    _silence_logs()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # this module reports differences
        try:
            client = Client(address, timeout=CONNECT_S, set_as_default=False, security=security)
        except (OSError, ValueError, RuntimeError, TypeError) as error:
            reason = str(error).split("\n")[0].split(" after ")[0].strip() or type(error).__name__
            wrong = isinstance(error, (ValueError, TypeError))
            problem = "is not an address of a scheduler" if wrong else "does not answer"
            raise SchedulerAwayError(
                f"--on {address}: {problem} ({reason}); start a scheduler with `dask scheduler`, or remove --on"
            ) from None
        try:
            if not _workers_connect(client, 1, WORKERS_S):
                raise SchedulerAwayError(
                    f"{address}: the scheduler has no workers; start some with `dask worker {address} --nthreads 1`"
                )
            _check_workers(client, address, folder)
            workers = DaskWorkers(client, campaign, address)
            try:
                yield workers
            finally:
                workers.stop()
        finally:
            with contextlib.suppress(Exception):
                client.close(timeout=5)


def _workers_connect(client: Any, count: int, timeout_s: float) -> bool:
    try:
        client.wait_for_workers(count, timeout=timeout_s)
    except OSError:  # timeout, or the scheduler has gone
        return False
    return True


def _own_versions() -> dict[str, str]:
    from importlib.metadata import version

    python = ".".join(platform.python_version_tuple()[:2])
    return {"Python": python, "dask": version("dask"), "distributed": version("distributed")}


def _worker_facts(folder: str | None) -> dict[str, Any]:
    """Return facts about a worker."""
    return {**_own_versions(), "xitl": __version__, "folder": folder is None or os.path.isdir(folder)}  # noqa: PTH112


def _refuse_other(address: str, who: str, theirs: dict[str, Any], own: dict[str, str]) -> None:
    different = [f"{name} {theirs[name]} (here {version})" for name, version in own.items() if theirs[name] != version]
    if different:
        raise UserError(f"--on {address}: {who} has {', '.join(different)}; install the same versions on both sides")


def _check_workers(client: Any, address: str, folder: Path | None) -> None:
    """Raise UserError if the scheduler or a worker has other versions than this process, or a worker has another xitl,
    or none, or does not see the folder.
    """
    own = _own_versions()
    versions = client.get_versions(check=False)
    members = [("the scheduler", versions["scheduler"])]
    members += [(f"worker {worker}", facts) for worker, facts in versions["workers"].items()]
    for member, facts in members:
        packages = facts["packages"]
        theirs = {"Python": ".".join(packages["python"].split(".")[:2])}
        theirs |= {name: packages[name] for name in ("dask", "distributed")}
        _refuse_other(address, member, theirs, own)
    try:
        facts = client.run(_worker_facts, None if folder is None else str(folder.absolute()))
    except (ImportError, AttributeError) as error:
        raise UserError(f"--on {address}: workers have no xitl ({error}); install xitl {__version__} there") from None
    for worker, of_worker in facts.items():
        _refuse_other(address, f"worker {worker}", of_worker, {"xitl": __version__})
        if not of_worker["folder"]:
            raise UserError(
                f"--on {address}: worker {worker} does not see {folder}; choose an --out on a shared disk, or use "
                "`recordings: none` in the plan"
            )


async def _work(address: str, scratch: str, certificate: str, key: str) -> None:
    """Run a worker of one thread on loopback until its scheduler ends. certificate, key: PEM, of the campaign.

    scratch: directory for Dask's files.
    """
    import dask
    from distributed import Security, Worker

    security = Security(
        require_encryption=True,
        tls_ca_file=certificate,
        tls_client_cert=certificate,
        tls_client_key=key,
        tls_worker_cert=certificate,
        tls_worker_key=key,
    )
    own: dict[str, Any] = {"host": LOOPBACK, "dashboard_address": f"{LOOPBACK}:0", "security": security}
    with dask.config.set({**_SETTINGS, _SCRATCH: scratch}):
        async with Worker(address, nthreads=1, memory_limit=0, dashboard=False, **own) as worker:
            await worker.finished()


def _end_with_parent() -> None:
    """Wait for the end of standard input, then end this process at once."""
    with contextlib.suppress(OSError):
        while os.read(0, 1024):
            pass
    os._exit(0)


if __name__ == "__main__":
    certificate, key = json.loads(os.fdopen(0, "rb", buffering=0, closefd=False).readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    prepare_for_runs()
    asyncio.run(_work(sys.argv[1], sys.argv[2], certificate, key))
