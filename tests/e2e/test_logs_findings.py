"""`xitl logs analyze --json` against what is known of a log: what was injected is reported, and no more."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.recorded import LOGS
from tests.recorded_run import recorded_faults


def analysed(*files: Path) -> dict[str, Any]:
    command = [sys.executable, "-m", "xitl_cli.main", "logs", "analyze", *map(str, files), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def keys(found: dict[str, Any], *severities: str) -> set[str]:
    return {finding["key"] for finding in found["findings"] if finding["severity"] in severities}


@pytest.mark.realtime
def test_a_cut_link_and_a_clock_that_leapt_are_reported_with_their_times() -> None:
    run = recorded_faults()
    found = analysed(run / "autopilot.bin", run / "run.mcap")
    named = keys(found, "notice", "warning", "critical")
    assert {"time_bases.step", "links.loss", "links.silence", "sensors.gap"} <= named
    told = {(finding["key"], finding["file"]): finding for finding in found["findings"]}
    for file in ("autopilot.bin", "run.mcap"):
        step = told["time_bases.step", file]
        (ahead_s,) = re.findall(r"stepped ([\d.]+) s ahead", step["sentence"])
        assert float(ahead_s) == pytest.approx(0.5, abs=0.01)  # what delays a message on a busy machine is in it
        assert step["evidence"][0]["at_s"] == pytest.approx(4.0, abs=0.25)  # clocks are read ten times a second
    assert told["links.silence", "run.mcap"]["evidence"][0]["at_s"] == pytest.approx(1.0, abs=0.2)
    assert "sensors.recording_pauses" not in keys(found, "warning", "critical")


@pytest.mark.slow
def test_gusts_differ_from_calm_by_the_steering_at_its_end() -> None:
    calm, gust = (analysed(LOGS / f"boat-auto-{name}.bin") for name in ("calm", "gust"))
    assert keys(calm, "warning", "critical") == set()
    assert keys(gust, "notice", "warning", "critical") - keys(calm, "notice") == {"radio.saturated"}
    assert keys(calm, "notice") <= keys(gust, "notice")
