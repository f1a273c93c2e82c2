"""Runs of ours with faults on purpose: the autopilot's log tells each of them, when it was, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.recorded_run import recorded_run
from xitl_cli.logs import open_log
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Finding
from xitl_cli.plugins.logs.analyses import gnss, power, radio, sensors, vibration

S = 1e9
FAULTS = """\
extends: sitl
description: Sensors that fail one after another
faults:
  freeze: {from_s: 6.0, until_s: 14.0, magnetometer: {freeze: true}}
  imu: {from_s: 15.0, until_s: 15.6, imu: {dropout: 1.0}}
  gone: {from_s: 18.0, until_s: 20.0, gnss: {dropout: 1.0}}
  aside: {from_s: 22.0, until_s: 24.0, gnss: {position_bias_ned_m: [0.0, 6.0, 0.0]}}
"""


def findings(log_path: Path) -> list[Finding]:
    with DataFlashLog(log_path) as log:
        parts = [part.analyse(log) for part in (sensors, gnss, vibration, radio, power)]
    return [finding for part in parts if part is not None for finding in part.findings]


@pytest.mark.slow
def test_each_fault_is_told_with_its_time_and_nothing_else(tmp_path: Path) -> None:
    profile = tmp_path / "faulty.yaml"
    profile.write_text(FAULTS)
    log = recorded_run(str(profile), 26.0) / "autopilot.bin"
    found = {(finding.key, finding.evidence[0].message): finding.evidence for finding in findings(log)}
    # The autopilot's cycle is led by the inertial unit: without it, nothing that it measures is logged.
    led = {(key, message) for key in ("sensors.gap", "sensors.missing") for message in ("MAG", "BARO")}
    assert set(found) - led == {
        ("sensors.stuck", "MAG"),
        ("sensors.gap", "IMU"),
        ("gnss.silent", "GPS"),
        ("gnss.jump", "GPS"),
    }
    # Within a period of each sensor, and of the 0.12 s by which a fix is late.
    (stuck,) = found["sensors.stuck", "MAG"]
    assert stuck.at_ns == pytest.approx(6.0 * S, abs=0.05 * S)
    assert stuck.until_ns == pytest.approx(14.0 * S, abs=0.05 * S)
    (gap,) = found["sensors.gap", "IMU"]
    assert gap.at_ns == pytest.approx(15.0 * S, abs=0.02 * S)
    assert gap.until_ns == pytest.approx(15.6 * S, abs=0.02 * S)
    (silent,) = found["gnss.silent", "GPS"]
    assert silent.at_ns == pytest.approx(18.0 * S, abs=0.4 * S)
    assert silent.until_ns == pytest.approx(20.0 * S, abs=0.4 * S)
    jumps = [each.at_ns for each in found["gnss.jump", "GPS"]]
    assert jumps == pytest.approx([22.0 * S, 24.0 * S], abs=0.4 * S)


@pytest.mark.slow
def test_a_frozen_compass_does_not_hold_the_heading(tmp_path: Path) -> None:
    """The boat turns by 90 degrees while its compass repeats an old field, and soon after its gyroscope is silent."""
    profile = tmp_path / "faulty.yaml"
    profile.write_text(FAULTS)
    with open_log(recorded_run(str(profile), 26.0)) as log:
        estimate, truth = (_yaw_rad(log, topic) for topic in ("/estimate/odometry", "/truth/odometry"))
    error = estimate[1] - np.interp(estimate[0], *truth)
    assert np.ptp(truth[1]) > 1.5
    assert np.degrees(np.abs(error)).max() < 15.0
    assert np.degrees(np.abs(error[-50:])).max() < 3.0


def _yaw_rad(log: Log, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and continuous headings."""
    table = log.tables[topic]
    w, x, y, z = (np.asarray(table.values(f"pose.pose.orientation.{part}")) for part in "wxyz")
    return table.stamp_ns, np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
