"""What the vessel did, as three formats tell it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from pymavlink import DFReader, mavutil

from tests.recorded import GUST, MISSION_TLOG
from tests.recorded_run import recorded_run
from xitl_cli.logs import open_log, signals
from xitl_cli.logs.signals.series import make_series


def of_type(name: str) -> list[object]:
    log = DFReader.DFReader_binary(str(GUST), zero_time_base=False)
    found = []
    while (message := log.recv_match(type=name)) is not None:
        found.append(message)
    log.close()
    return found


@pytest.mark.medium
def test_an_ardupilot_log_tells_motion_as_its_messages_do() -> None:
    attitudes = of_type("ATT")
    with open_log(GUST) as log:
        yaw, roll, true_yaw = signals.yaw(log), signals.roll(log), signals.yaw(log, "truth")
        place, true_place = signals.position_ned(log), signals.position_ned(log, "truth")
        speed, outputs = signals.ground_speed(log), signals.outputs(log)
    assert yaw is not None
    assert yaw.stamp_ns.tolist() == [message.TimeUS * 1000 for message in attitudes]
    assert yaw.values == pytest.approx([message.Yaw for message in attitudes])
    assert roll is not None
    assert roll.values == pytest.approx([message.Roll for message in attitudes])
    # ArduPilot's own simulator knows better than its estimator by a degree and a few metres, no more.
    assert true_yaw is not None
    apart = (true_yaw.interpolated(yaw.stamp_ns) - yaw.values + 180.0) % 360.0 - 180.0
    assert np.nanmax(np.abs(apart)) < 5.0
    assert place is not None
    assert true_place is not None
    assert true_place.origin == place.origin
    assert np.nanmax(np.abs(true_place.path.interpolated(place.path.stamp_ns)[:, :2] - place.path.values[:, :2])) < 3.0
    # The square of 60 by 40 m, and nobody farther than its diagonal from its corner.
    assert np.ptp(place.path.values[:, 0]) == pytest.approx(60.0, abs=15.0)
    assert np.hypot(*place.path.values[:, :2].T).max() < 90.0
    assert speed is not None
    assert speed.source == "XKF1.VN, VE"
    assert sorted(outputs) == [1, 3, 17, 18]
    assert outputs[3].unit == "us"


@pytest.mark.medium
def test_an_ardupilot_log_tells_states() -> None:
    with open_log(GUST) as log:
        modes, armed, texts = signals.modes(log), signals.armed(log), signals.texts(log)
    assert [span.text for span in modes] == ["AUTO"]
    assert [span.from_ns for span in armed] == [42_513_821_000]
    said = [(text.at_ns // 1000, text.text) for text in texts]
    assert said == [(message.TimeUS, message.Message) for message in of_type("MSG")]  # in the order of the file


@pytest.mark.medium
def test_telemetry_tells_the_same_kind_of_things() -> None:
    heard = mavutil.mavlogfile(str(MISSION_TLOG))
    yaws = []
    while (message := heard.recv_match(type="ATTITUDE")) is not None:
        yaws.append(np.degrees(message.yaw) % 360.0)
    heard.close()
    with open_log(MISSION_TLOG) as log:
        yaw, place, modes = signals.yaw(log), signals.position_geodetic(log), signals.modes(log)
        armed, outputs = signals.armed(log), signals.outputs(log)
    assert yaw is not None
    assert yaw.values == pytest.approx(yaws, abs=1e-4)  # single precision
    assert place is not None
    assert place.values[0, :2] == pytest.approx([-8.803, -63.95], abs=0.01)
    assert [span.text for span in modes] == ["MANUAL", "AUTO"]
    assert len(armed) == 1
    assert {1, 3} <= set(outputs)


@pytest.mark.slow
def test_a_recording_of_ours_tells_estimate_and_truth() -> None:
    run = recorded_run("sitl", 12.0)
    summary = json.loads((run / "summary.json").read_text())
    with open_log(run / "run.mcap") as log:
        state = log.tables["/truth/state"]
        true_ned, quaternion = state.values("position_ned_m"), state.values("quaternion_ned_frd")
        place, true_place = signals.position_ned(log), signals.position_ned(log, "truth")
        true_yaw, yaw = signals.yaw(log, "truth"), signals.yaw(log)
        armed, beats = signals.armed(log), log.tables["/link/agent/rx:HEARTBEAT"]
        heard_ns = int(beats.stamp_ns[(beats.values("base_mode", raw=True) & 128) != 0][0])
    assert true_place is not None
    assert true_place.path.values == pytest.approx(true_ned, abs=1e-9)
    w, x, y, z = quaternion.T
    expected = np.degrees(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))) % 360.0
    assert true_yaw is not None
    assert (true_yaw.values - expected + 180.0) % 360.0 - 180.0 == pytest.approx(np.zeros(len(w)), abs=1e-9)
    # The site of the profile, found from a fix and a position: one metre is 9e-6 degrees.
    assert true_place.origin == pytest.approx((-8.8, -63.95, 70.0), abs=1e-4)
    assert true_place.origin[:2] == pytest.approx((-8.8, -63.95), abs=1e-9)
    assert place is not None
    assert yaw is not None
    assert 0 <= heard_ns - armed[0].from_ns <= 1_000_000_000  # once a second
    since = place.path.stamp_ns >= heard_ns  # what the summary goes by
    apart = (place.path.values - true_place.path.interpolated(place.path.stamp_ns))[since, :2]
    rms = float(np.sqrt(np.nanmean(np.sum(apart**2, axis=1))))
    # The truth is recorded at 50 Hz and interpolated here, the summary takes that of the very step; and one estimate at
    # either end of 18 s at 10 Hz is one or not: under 1 in 100.
    assert rms == pytest.approx(summary["estimation"]["position_rms_m"], rel=0.01)


def test_a_series_keeps_only_what_can_be_compared() -> None:
    stamps = np.array([0, 10, 5, 20, 30, 30], dtype=np.int64)
    values = np.array([1.0, 2.0, 99.0, np.nan, 4.0, 99.0])
    found = make_series(stamps, values, "m", "T.x")
    assert found is not None
    assert found.stamp_ns.tolist() == [0, 10, 30]
    assert found.values.tolist() == [1.0, 2.0, 4.0]
    assert found.dropped == 3
    assert make_series(stamps[:0], values[:0], "m", "T.x") is None
    assert make_series(stamps[3:4], values[3:4], "m", "T.x") is None


def test_an_angle_goes_the_short_way_round() -> None:
    found = make_series(np.array([0, 10], dtype=np.int64), np.array([350.0, 10.0]), "deg", "T.x", turns=True)
    assert found is not None
    assert found.interpolated(np.array([-1, 5, 10], dtype=np.int64)) == pytest.approx([np.nan, 0.0, 10.0], nan_ok=True)


def test_a_demand_that_is_0_throughout_is_none():
    """Rover writes 0 into ATT.DesYaw; what it steers to is in NTUN."""
    stamps = np.arange(10) * 100_000_000
    attitude = MadeTable("ATT", stamps, {"Yaw": np.full(10, 80.0), "DesYaw": np.zeros(10)})
    assert signals.yaw_desired(MadeLog(attitude)) is None
    steered = MadeTable("NTUN", stamps, {"DesYaw": np.full(10, 90.0)})
    found = signals.yaw_desired(MadeLog(attitude, steered))
    assert found is not None
    assert (found.source, found.values[0]) == ("NTUN.DesYaw", 90.0)
