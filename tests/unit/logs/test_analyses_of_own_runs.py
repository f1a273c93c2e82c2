"""A run of our own with a fault of known time: what its logs say of it."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.golden import Golden
from xitl_cli.logs import open_log
from xitl_cli.logs.model.sections import Section, Severity

PROFILE = """
extends: [sitl, faults/gnss-dropout]
clock: {duration_s: 70.0}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("dropout")
    (directory / "dropout.yaml").write_text(PROFILE)
    arguments = ["sim", "-p", "dropout.yaml", "--out", "run"]
    subprocess.run(
        [sys.executable, "-m", "xitl_cli.main", *arguments],
        cwd=directory,
        check=False,
        capture_output=True,
        timeout=120,
    )
    return directory / "run"


def section(path: Path, name: str) -> Section:
    with open_log(path) as log:
        found: Section | None = importlib.import_module(f"xitl_cli.plugins.logs.analyses.{name}").analyse(log)
    assert found is not None
    return found


def facts(found: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in found.facts}


def severities(found: Section) -> dict[str, Severity]:
    return {finding.key: finding.severity for finding in found.findings}


@pytest.mark.slow
def test_the_autopilots_log_tells_of_the_lost_position(run: Path) -> None:
    """No fix from 40 to 60 s: a failsafe after 5 s of coasting ends AUTO, and the position returns as a step."""
    log = run / "autopilot.bin"
    assert facts(section(log, "vehicle"))["firmware"] == "xitl embedded autopilot"
    modes = section(log, "modes")
    assert severities(modes) == {"modes.failsafe": Severity.CRITICAL}
    assert 44.0 < (modes.findings[0].evidence[0].at_ns or 0) * 1e-9 < 46.0
    assert severities(section(log, "events")) == {
        "events.error.16.2": Severity.WARNING,
        "events.error.17.1": Severity.WARNING,
    }
    assert severities(section(log, "estimator"))["estimator.position_lost"] is Severity.CRITICAL
    assert "EKF failsafe" in section(log, "missions").findings[0].sentence


@pytest.mark.slow
def test_the_run_names_the_failsafe_that_stopped_it(run: Path, golden: Golden) -> None:
    from json import loads

    why = loads((run / "summary.json").read_text())["verdict"]["why"]
    golden("reason", why, "45.0 s")
    modes = section(run / "run.mcap", "modes")
    assert severities(modes) == {"modes.failsafe": Severity.CRITICAL}
    golden("finding", modes.findings[0].sentence)


@pytest.mark.slow
def test_the_recording_tells_how_far_off_the_estimate_was(run: Path) -> None:
    from json import loads

    found = facts(section(run / "run.mcap", "estimator"))
    summary = loads((run / "summary.json").read_text())
    # The summary takes every estimate while armed, as this does; the recording has what telemetry brought of them.
    assert found["position_error_rms_m"] == pytest.approx(summary["estimation"]["position_rms_m"], rel=0.1)
    assert found["yaw_error_rms_deg"] == pytest.approx(summary["estimation"]["heading_rms_deg"], rel=0.1)
    assert facts(section(run / "run.mcap", "missions"))["waypoints_reached"] == 1
