"""Dask clusters: who may send work to them, and workers that do not start."""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from distributed.comm.core import CommClosedError
from distributed.protocol.pickle import dumps

from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign import cluster

distributed = pytest.importorskip("distributed")
ALONE = {"processes": False, "dashboard_address": None, "host": "127.0.0.1"}
pytestmark = pytest.mark.slow
NEVER_S = 0.01


def test_own_workers_that_are_slow_to_start_are_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "OWN_WORKERS_S", NEVER_S)
    late = r"not all 1 worker processes of the campaign started within 0\.01 s"
    with pytest.raises(UserError, match=late), cluster.local_workers(1, "slow"):
        pass


def test_a_scheduler_without_workers_is_told_with_the_command_that_starts_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "WORKERS_S", NEVER_S)
    with distributed.LocalCluster(n_workers=0, protocol="tcp://", **ALONE) as somebodys:
        address = somebodys.scheduler_address
        none = f"has no workers; start some with `dask worker {address}"
        with pytest.raises(cluster.SchedulerAwayError, match=none), cluster.workers_at(address, "alone", None):
            pass


def listening(process: psutil.Process) -> set[tuple[str, int]]:
    """Addresses and ports that a process accepts connections on."""
    found = process.net_connections(kind="tcp")
    return {(one.laddr.ip, one.laddr.port) for one in found if one.status == psutil.CONN_LISTEN}


@pytest.fixture(scope="module")
def own_workers() -> Iterator[list[psutil.Process]]:
    """The processes of a campaign's own workers, two of them."""
    before = set(psutil.Process().children())
    with cluster.local_workers(2, "guarded"):
        yield [child for child in psutil.Process().children() if child not in before]


def test_own_workers_and_their_scheduler_listen_on_loopback_only(own_workers: list[psutil.Process]) -> None:
    assert len(own_workers) == 2
    for process in (psutil.Process(), *own_workers):
        addresses = listening(process)
        assert addresses
        assert {address for address, _ in addresses} == {"127.0.0.1"}


async def run_there(address: str, security: Any) -> Any:
    """What a Dask server returns for a function that a stranger sends."""
    arguments = security.get_connection_args("client") if security is not None else {}
    async with asyncio.timeout(3):
        async with distributed.rpc(address, connection_args=arguments) as server:
            return await server.run(function=dumps(os.getpid), args=dumps(()), kwargs=dumps({}), wait=True)


def test_a_dask_server_runs_the_function_of_a_client_that_it_accepts() -> None:
    with distributed.LocalCluster(n_workers=1, protocol="tcp://", **ALONE) as open_to_all:
        address = open_to_all.workers[0].address
        assert asyncio.run(run_there(address, None))["result"] == os.getpid()


@pytest.mark.parametrize("scheme", ["tcp", "tls"])
def test_own_workers_run_nothing_for_a_client_without_the_campaigns_certificate(
    own_workers: list[psutil.Process], scheme: str
) -> None:
    strangers = distributed.Security.temporary() if scheme == "tls" else None
    for address, port in listening(own_workers[0]):
        with pytest.raises((OSError, CommClosedError)):
            asyncio.run(run_there(f"{scheme}://{address}:{port}", strangers))


def written(folder: Path, security: Any) -> cluster.TlsFiles:
    """Certificate and key of a security that is in memory, as files."""
    folder.mkdir()
    certificate, key = folder / "cert.pem", folder / "key.pem"
    certificate.write_text(security.tls_client_cert)
    key.write_text(security.tls_client_key)
    return cluster.TlsFiles(str(certificate), str(certificate), str(key))


def test_a_scheduler_with_tls_is_reached_with_its_files_and_with_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_S", 3.0)
    theirs = distributed.Security.temporary()
    with distributed.LocalCluster(n_workers=1, protocol="tls://", security=theirs, **ALONE) as somebodys:
        address = somebodys.scheduler_address
        files = written(tmp_path / "theirs", theirs)
        with cluster.workers_at(address, "encrypted", None, files) as workers:
            assert workers.threads > 0
        others = written(tmp_path / "others", distributed.Security.temporary())
        with (
            pytest.raises(cluster.SchedulerAwayError, match="does not answer"),
            cluster.workers_at(address, "refused", None, others),
        ):
            pass


@pytest.mark.skipif(sys.platform == "win32", reason="has no shared directory for temporary files")
def test_own_workers_use_no_scratch_directory_that_another_user_may_have_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask writes lock files into /tmp/dask-scratch-space; a link there would have it overwrite any file."""
    precious = tmp_path / "precious"
    precious.write_text("kept")
    shared = tmp_path / "dask-scratch-space"
    shared.mkdir()
    for name in ("global.lock", "purge.lock"):
        (shared / name).symlink_to(precious)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)  # read anew
    with cluster.local_workers(1, "scratch"):
        (own,) = tmp_path.glob("xitl-campaign-*")
        assert own.stat().st_mode & 0o777 == 0o700
        assert {path.name for path in shared.iterdir()} == {"global.lock", "purge.lock"}
    assert precious.read_text() == "kept"
    assert not own.exists()
