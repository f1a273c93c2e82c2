"""Runs in forked processes: as separate as fresh ones, with the same exit codes, and replaced when a server ends."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.patience import wait_until
from xitl_cli.plugins.campaign.run_server import ForkedRun, RunServers
from xitl_cli.plugins.campaign.warden import MARK, end_marked

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="runs are forked on Linux only")
ENDLESS = ("sim", "sitl", "--pace", "1", "--duration", "600", "--overwrite", "--out")


@pytest.fixture
def servers() -> Iterator[RunServers]:
    made = RunServers()
    yield made
    made.close()


class Started:
    """Starts runs in a folder, with a mark for each."""

    def __init__(self, servers: RunServers, folder: Path) -> None:
        self._servers, self._folder = servers, folder
        self.errors = folder / "errors.txt"

    def __call__(self, *arguments: str, mark: str) -> ForkedRun:
        with self.errors.open("wb") as errors:
            run = self._servers.start(arguments, {**os.environ, "OPENBLAS_NUM_THREADS": "1", MARK: mark}, errors)
        assert run is not None
        return run

    def endless(self, mark: str) -> ForkedRun:
        """Return a run that has begun and does not end by itself."""
        out = self._folder / mark
        run = self(*ENDLESS, str(out), mark=mark)
        wait_until(lambda: (out / "run.mcap").exists())
        return run


@pytest.fixture
def started(servers: RunServers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Started:
    monkeypatch.chdir(tmp_path)
    return Started(servers, tmp_path)


def parent_and_session(pid: int) -> tuple[int, int]:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return int(fields[1]), int(fields[3])


@pytest.mark.medium
def test_exit_codes_and_errors_are_those_of_the_command(started: Started) -> None:
    for arguments, code, text in (
        (("--version",), 0, ""),
        (("sim", "nowhere"), 2, "error: there is no profile 'nowhere'"),
        (("sim", "mitl", "--set", "clock.duration_s=0.1", "--out", "run"), 1, ""),
    ):
        run = started(*arguments, mark="codes")
        assert run.wait() == code
        run.release()
        assert started.errors.read_text().startswith(text)
    assert Path("run/summary.json").exists()


@pytest.mark.medium
def test_a_run_has_its_own_session_folder_and_mark_and_its_end_leaves_the_server(
    started: Started, tmp_path: Path
) -> None:
    parents = set()
    for mark in ("first", "second"):
        run = started.endless(mark)
        parent, session = parent_and_session(run.pid)
        assert session == run.pid
        assert Path(f"/proc/{run.pid}/cwd").resolve() == tmp_path.resolve()
        assert f"{MARK}={mark}".encode() in Path(f"/proc/{run.pid}/environ").read_bytes()
        assert not run.ends_within(0.0)
        assert end_marked(mark) >= 1
        assert run.wait() == -signal.SIGKILL
        run.release()
        parents.add(parent)
    assert len(parents) == 1


@pytest.mark.medium
def test_a_run_whose_server_is_killed_counts_as_killed_and_another_server_takes_over(started: Started) -> None:
    run = started.endless("lost")
    os.kill(parent_and_session(run.pid)[0], signal.SIGKILL)
    assert run.wait() == -signal.SIGKILL
    assert end_marked("lost") >= 1  # a process that is ending is counted again
    run.release()
    again = started("--version", mark="again")
    assert again.wait() == 0
    again.release()


@pytest.mark.medium
def test_modules_that_a_run_needed_are_imported_before_the_next(servers: RunServers, started: Started) -> None:
    assert "agent.assembly" not in servers.modules
    run = started("sim", "sitl", "--duration", "0.1", "--out", "run", mark="learned")
    assert run.wait() == 0
    run.release()
    assert servers.modules
    known = list(servers.modules)
    run = started("sim", "sitl", "--duration", "0.1", "--out", "again", mark="learned")
    assert run.wait() == 0
    run.release()
    assert servers.modules == known


def test_other_systems_start_fresh_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    with (tmp_path / "errors.txt").open("wb") as errors:
        assert RunServers().start(["--version"], {}, errors) is None
