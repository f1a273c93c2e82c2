"""What is left behind when something breaks inside a run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader

from xitl_cli.profile import load_profile
from xitl_cli.run import session
from xitl_cli.run.ideal_pilot import IdealPilot
from xitl_cli.run.view import NoView


def test_a_fault_of_our_own_is_seen_and_still_leaves_summary_and_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exchange = IdealPilot.exchange

    def breaks(self, sim_ns, motion):
        if sim_ns > 500_000_000:
            raise ZeroDivisionError("a fault")
        exchange(self, sim_ns, motion)

    monkeypatch.setattr(IdealPilot, "exchange", breaks)
    with pytest.raises(ZeroDivisionError, match="a fault"):
        session.run(load_profile("mitl"), tmp_path / "run", False, NoView)
    told = json.loads((tmp_path / "run/summary.json").read_text())
    assert told["ended"] == "failed"
    assert "ZeroDivisionError" in told["error"]
    with (tmp_path / "run/run.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file).iter_messages(topics=["/truth/state"])) == 25
