"""Short forms of `make soak-long` and `make chaos`: the same programs and checks, in less than a minute."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import environment

from tests.bench.soak_long import soak
from tests.chromium import CHROMIUM

pytestmark = pytest.mark.realtime
ROOT = Path(__file__).parents[2]
for package in ("embreex", "kiss_icp", "msgspec", "viser", "websockets"):
    pytest.importorskip(package)


def test_a_short_soak_counts_everything_and_reads_its_split_recording(tmp_path: Path) -> None:
    result = soak(tmp_path / "soak", duration_s=44.0, seed=1, split_s=12.0, sample_s=2.0, ask_s=3.0)
    assert result["problems"] == []
    assert set(result["processes"]) == {"host", "agent", "companion", "view"}
    assert result["recording"]["files"] == 4
    assert result["view"]["browsers"] >= 1
    if CHROMIUM is not None:
        assert result["clients"]["browser"]["frames drawn"] >= 1
    for request in ("parameters", "mission", "files"):
        assert result["clients"]["station 255"][f"{request} answered"] >= 1
    assert all(link["sent"] > 500 for link in result["links"])


def test_eight_random_events_break_nothing(tmp_path: Path) -> None:
    """This seed draws eight different events, in three runs."""
    command = [sys.executable, "-m", "tests.chaos", "--seed", "252", "--events", "8", "--out", str(tmp_path / "chaos")]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads((tmp_path / "chaos" / "chaos.json").read_text())
    assert len(result["outcomes"]) == result["events"] == 8
    assert len({outcome["event"] for outcome in result["outcomes"]}) == 8
    assert any(outcome["neutral_s"] for outcome in result["outcomes"])
    assert any(outcome["unreadable_s"] is not None for outcome in result["outcomes"])
