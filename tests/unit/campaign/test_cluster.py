"""Workers that do not come: this machine's own, and those of somebody's scheduler."""

from __future__ import annotations

import pytest

from xitl_cli.campaign import cluster
from xitl_cli.errors import UserError

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow
NEVER_S = 0.01


def test_own_workers_that_are_slow_to_start_are_told_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "OWN_WORKERS_S", NEVER_S)
    late = r"not all of the campaign's 1 worker processes were up within 0\.01 s"
    with pytest.raises(UserError, match=late), cluster.local_workers(1, "slow"):
        pass


def test_a_scheduler_without_workers_is_told_with_the_command_that_starts_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "WORKERS_S", NEVER_S)
    alone = {"n_workers": 0, "processes": False, "dashboard_address": None, "host": "127.0.0.1", "protocol": "tcp://"}
    with distributed.LocalCluster(**alone) as somebodys:
        address = somebodys.scheduler_address
        none = f"has no workers; start some with `dask worker {address}"
        with pytest.raises(cluster.SchedulerAwayError, match=none), cluster.workers_at(address, "alone", None):
            pass
