"""Runs as tasks of a Dask scheduler that is made up: what is submitted, returned and refused."""

from __future__ import annotations

import platform
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

from agent import __version__
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign import cluster
from xitl_cli.plugins.campaign.cluster import DaskWorkers, SchedulerAwayError, workers_at
from xitl_cli.plugins.campaign.execution import RunTask, run_point, stop_runs

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.medium
ROW = {"number": 3, "status": "completed"}
WORKERS = {"tcp://a:1": {"nthreads": 2}, "tcp://b:1": {"nthreads": 3}}


class Future:
    """Ends when it is told to."""

    def __init__(self) -> None:
        self.status, self.released = "finished", False
        self.outcome: Any = ROW
        self._callbacks: list[Callable[[Future], None]] = []

    def add_done_callback(self, callback: Callable[[Future], None]) -> None:
        self._callbacks.append(callback)

    def end(self, outcome: Any = ROW, status: str = "finished") -> None:
        self.outcome, self.status = outcome, status
        for callback in self._callbacks:
            callback(self)

    def result(self, timeout: float) -> Any:
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome

    def release(self) -> None:
        self.released = True


class Client:
    """A scheduler with two workers of two and three threads."""

    def __init__(self, address: str = "", **options: Any) -> None:
        self.options = {"address": address, **options}
        self.status, self.dashboard_link = "running", "http://head:8787"
        self.submitted: list[tuple[Any, ...]] = []
        self.futures: list[Future] = []
        self.cancelled: list[Future] = []
        self.ran: list[tuple[Any, ...]] = []
        self.closed = self.asked = 0
        self.workers = WORKERS
        self.packages = {
            "python": platform.python_version(),
            **{name: version(name) for name in ("dask", "distributed")},
        }
        self.of_worker: Any = {"xitl": __version__, "folder": True}

    def scheduler_info(self, n_workers: int | None = None) -> dict[str, Any]:
        self.asked += 1
        if n_workers is not None and not isinstance(self, NewClient):
            raise TypeError("unexpected argument")
        return {"workers": self.workers}

    def submit(self, function: Any, task: RunTask, *, key: str, pure: bool) -> Future:
        self.submitted.append((function, task, key, pure))
        self.futures.append(Future())
        return self.futures[-1]

    def cancel(self, futures: list[Future], force: bool) -> None:
        self.cancelled += futures

    def run(self, function: Any, *arguments: Any, **options: Any) -> Any:
        self.ran.append((function, *arguments))
        if isinstance(self.of_worker, Exception):
            raise self.of_worker
        return {"tcp://a:1": self.of_worker}

    def wait_for_workers(self, count: int, timeout: float) -> None:
        if count > len(self.workers):
            raise OSError("no workers")

    def get_versions(self, check: bool) -> dict[str, Any]:
        packages = {"packages": self.packages}
        return {"scheduler": packages, "workers": {"tcp://a:1": packages}}

    def close(self, timeout: float) -> None:
        self.closed += 1


class NewClient(Client):
    """Knows a limit of the workers that it describes."""


def task(number: int = 3) -> RunTask:
    return RunTask(number, "extends: mitl\n", "mitl", (), (), 60.0, None, None, "campaign")


def test_a_run_is_a_task_with_a_key_of_its_own() -> None:
    client = Client()
    workers = DaskWorkers(client, "boats", "tcp://head:8786")
    assert workers.next(0.0) is None
    workers.submit(task())
    workers.submit(task())  # again, because the first attempt was lost
    assert [(function, key, pure) for function, _, key, pure in client.submitted] == [
        (run_point, "xitl-boats-3-1", False),
        (run_point, "xitl-boats-3-2", False),
    ]
    first, second = client.futures
    first.end()
    assert workers.next(0.0) is None  # of the attempt before
    assert not first.released
    second.end()
    assert workers.next(0.0) == (3, ROW)
    assert second.released


@pytest.mark.parametrize("kind", [Client, NewClient])
def test_twice_the_threads_and_one_run_are_kept_at_the_scheduler(kind: type[Client]) -> None:
    client = kind()
    workers = DaskWorkers(client, "boats", "tcp://head:8786")
    assert (workers.threads, workers.capacity) == (5, 11)
    asked = client.asked
    client.workers = {}
    assert workers.threads == 5  # it is not asked for each run
    assert client.asked == asked
    workers = DaskWorkers(client, "boats", "tcp://head:8786")
    assert (workers.threads, workers.capacity) == (0, 3)


def test_the_dashboard_needs_bokeh(monkeypatch: pytest.MonkeyPatch) -> None:
    workers = DaskWorkers(Client(), "boats", "tcp://head:8786")
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    assert workers.dashboard is None
    monkeypatch.setattr(cluster, "find_spec", lambda name: name)
    assert workers.dashboard == "http://head:8787"


def ended(outcome: Any, status: str = "finished") -> Any:
    """What a run that ends so returns."""
    client = Client()
    workers = DaskWorkers(client, "boats", "tcp://head:8786")
    workers.submit(task())
    client.futures[0].end(outcome, status)
    return workers.next(0.0)


def foreign(name: str, module: str, base: type[Exception]) -> Exception:
    error: Exception = type(name, (base,), {"__module__": module})("it went")
    return error


def test_a_lost_worker_is_a_run_without_a_row() -> None:
    assert ended(distributed.KilledWorker("task", None, 3)) == (3, None)


@pytest.mark.parametrize(
    ("outcome", "status"),
    [
        (ROW, "cancelled"),
        (ROW, "lost"),
        (TimeoutError("60 s"), "finished"),
        (foreign("CommClosedError", "distributed.comm.core", OSError), "finished"),
        (foreign("CancelledError", "concurrent.futures", Exception), "finished"),
        (foreign("Gone", "asyncio.exceptions", Exception), "finished"),
    ],
)
def test_a_scheduler_that_went_away_is_said(outcome: Any, status: str) -> None:
    with pytest.raises(SchedulerAwayError, match="tcp://head:8786: the scheduler does not respond; completed runs are"):
        ended(outcome, status)


def test_errors_of_a_worker_remain_what_they_are() -> None:
    with pytest.raises(UserError, match=r"/runs: cannot store runs there \(No space left on device\)"):
        ended(OSError(28, "No space left on device", "/runs"))
    with pytest.raises(UserError, match="a worker: cannot store runs there"):
        ended(OSError(28, "No space left on device"))
    with pytest.raises(ZeroDivisionError):
        ended(ZeroDivisionError())


@pytest.mark.parametrize(("status", "away"), [("running", False), ("connecting", False), ("closed", True)])
def test_waiting_for_a_run_notices_a_closed_connection(status: str, away: bool) -> None:
    client = Client()
    client.status = status
    workers = DaskWorkers(client, "boats", "tcp://head:8786")
    if away:
        with pytest.raises(SchedulerAwayError):
            workers.next(0.0)
    else:
        assert workers.next(0.0) is None


def test_a_run_that_cannot_be_submitted_is_said() -> None:
    client = Client()
    client.submit = lambda *_, **__: 1 / 0  # type: ignore[assignment, method-assign]
    with pytest.raises(SchedulerAwayError):
        DaskWorkers(client, "boats", "tcp://head:8786").submit(task())


def test_the_end_cancels_what_is_left_and_ends_runs() -> None:
    client = Client()
    workers = DaskWorkers(client, "boats", "tcp://head:8786")
    workers.submit(task())
    workers.stop()
    assert client.cancelled == client.futures
    assert client.ran == [(stop_runs, "boats")]


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> Client:
    """The scheduler that answers."""
    made = Client()

    def connected(address: str, **options: Any) -> Client:
        made.options = {"address": address, **options}
        return made

    monkeypatch.setattr(distributed, "Client", connected)
    return made


def test_workers_of_a_scheduler_are_checked_and_released(client: Client, tmp_path: Path) -> None:
    with workers_at("tcp://head:8786", "boats", tmp_path) as workers:
        assert workers.threads == 5
        assert client.ran == [(cluster._worker_facts, str(tmp_path))]
        assert client.closed == 0
    assert client.ran[-1] == (stop_runs, "boats")
    assert client.closed == 1
    assert client.options["address"] == "tcp://head:8786"


def refused(client: Client, folder: Path | None = None) -> str:
    with pytest.raises(UserError) as error, workers_at("tcp://head:8786", "boats", folder):
        pass
    assert client.closed == 1
    return str(error.value)


def test_a_scheduler_without_workers(client: Client) -> None:
    client.workers = {}
    assert refused(client).startswith("tcp://head:8786: the scheduler has no workers; start some with `dask worker")


@pytest.mark.parametrize(("name", "said"), [("python", "Python"), ("dask", "dask"), ("distributed", "distributed")])
def test_other_versions_are_refused(name: str, said: str, client: Client) -> None:
    client.packages[name] = "3.0.1"
    theirs = "3.0" if name == "python" else "3.0.1"
    assert f"the scheduler has {said} {theirs} (here " in refused(client)


def test_another_patch_of_python_is_fine(client: Client) -> None:
    major, minor, _ = platform.python_version_tuple()
    client.packages["python"] = f"{major}.{minor}.99"
    with workers_at("tcp://head:8786", "boats", None):
        pass


def test_a_worker_needs_the_same_xitl_and_the_folder(client: Client, tmp_path: Path) -> None:
    client.of_worker = {"xitl": "0.0.1", "folder": True}
    assert f"worker tcp://a:1 has xitl 0.0.1 (here {__version__})" in refused(client)
    client.closed, client.of_worker = 0, {"xitl": __version__, "folder": False}
    assert f"worker tcp://a:1 does not see {tmp_path}; choose an --out on a shared disk" in refused(client, tmp_path)
    client.closed, client.of_worker = 0, ModuleNotFoundError("No module named 'xitl_cli'")
    assert "workers have no xitl (No module named 'xitl_cli')" in refused(client)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            OSError("Timed out trying to connect to tcp://head:8786 after 3 s\nand so on"),
            "does not answer (Timed out trying to connect to tcp://head:8786)",
        ),
        (RuntimeError(""), "does not answer (RuntimeError)"),
        (ValueError("missing port"), "is not an address of a scheduler (missing port)"),
        (TypeError("no string"), "is not an address of a scheduler (no string)"),
    ],
)
def test_a_scheduler_that_cannot_be_reached(error: Exception, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def connected(*_: Any, **__: Any) -> Client:
        raise error

    monkeypatch.setattr(distributed, "Client", connected)
    with pytest.raises(SchedulerAwayError) as told, workers_at("tcp://head:8786", "boats", None):
        pass
    assert str(told.value).startswith(f"--on tcp://head:8786: {said}; start a scheduler")


def test_facts_of_a_worker(tmp_path: Path) -> None:
    own = cluster._worker_facts(None)
    assert (own["xitl"], own["folder"]) == (__version__, True)
    assert cluster._worker_facts(str(tmp_path))["folder"]
    assert not cluster._worker_facts(str(tmp_path / "nowhere"))["folder"]
    assert own["dask"] == version("dask")
