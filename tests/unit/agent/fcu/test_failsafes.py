"""Failsafes: each acts, says so once, and says when it is over."""

from __future__ import annotations

import pytest
from boat import LAT_DEG, LON_DEG, degrees
from steered_boat import SteeredBoat

from agent.fcu.mission import make_mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.failsafes import FailsafeMonitor
from agent.navigation.position_filter import InnovationRatios

SECOND = 1_000_000_000
AFAR = make_mission([waypoint(LAT_DEG, LON_DEG), waypoint(*degrees(500.0, 0.0))])


def under_way(mode: int, **parameters: float) -> SteeredBoat:
    ship = SteeredBoat(FS_GCS_ENABLE=parameters.pop("FS_GCS_ENABLE", 1), **parameters)
    ship.autopilot.commands.set_mission(AFAR)
    ship.set_out(mode)
    return ship


def hear(ship: SteeredBoat, seconds: float, system_id: int = 255) -> None:
    for _ in range(round(seconds)):
        ship.autopilot.failsafes.heard_ground_station(system_id, ship.boat.time_ns)
        ship.sail(1.0)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("action", "mode"),
    [(0, "AUTO"), (1, "RTL"), (2, "HOLD"), (3, "SMART_RTL"), (4, "SMART_RTL"), (5, "disarmed"), (6, "LOITER")],
)
def test_ground_station_lost_and_found(action: int, mode: str) -> None:
    ship = under_way(modes.AUTO, FS_ACTION=action)
    hear(ship, 3)
    ship.sail(5.0)  # one second of the last hear, FS_GCS_TIMEOUT 5 s, FS_TIMEOUT 1.5 s: 0.5 s to go
    assert ship.mode == "AUTO"
    assert ship.autopilot.failsafes.active == ()
    ship.sail(2.0)
    if mode == "disarmed":
        assert not ship.autopilot.state.armed
    else:
        assert ship.mode == mode
        assert ship.autopilot.failsafes.active == ("GCS",)
    ship.sail(3.0)
    said = [text for text in ship.said if text.startswith("GCS failsafe: no heartbeat for 5 s")]
    assert len(said) == 1
    hear(ship, 2)
    assert ship.said.count("GCS failsafe over: ground station is back") == 1
    assert ship.autopilot.failsafes.active == ()
    if mode != "disarmed":
        assert ship.mode == mode  # what it did stays done


@pytest.mark.medium
def test_going_on_in_auto_but_not_in_guided() -> None:
    ship = under_way(modes.AUTO, FS_GCS_ENABLE=2)
    hear(ship, 1)
    ship.sail(8.0)
    assert ship.mode == "AUTO"
    assert "GCS failsafe: no heartbeat for 5 s, continuing in AUTO" in ship.said
    ship.autopilot.set_mode(modes.GUIDED)
    hear(ship, 1)
    ship.sail(8.0)
    assert ship.mode == "HOLD"


@pytest.mark.medium
@pytest.mark.parametrize(("action", "mode"), [(3, "RTL"), (4, "HOLD")])
def test_without_a_path_for_smart_rtl_the_next_mode_of_the_action_is_chosen(action: int, mode: str) -> None:
    ship = under_way(modes.AUTO, FS_ACTION=action, SRTL_POINTS=0)
    hear(ship, 1)
    ship.sail(8.0)
    assert ship.mode == mode


@pytest.mark.medium
@pytest.mark.parametrize("mode", [modes.HOLD, modes.RTL])
def test_a_vessel_that_holds_or_returns_keeps_its_mode_without_a_ground_station(mode: int) -> None:
    ship = under_way(mode, FS_ACTION=6)
    hear(ship, 1)
    ship.sail(8.0)
    assert ship.autopilot.failsafes.active == ("GCS",)
    assert ship.mode == modes.NAMES[mode]


@pytest.mark.medium
def test_a_station_never_heard_of_or_another_one_is_not_missed() -> None:
    ship = under_way(modes.AUTO)
    ship.sail(10.0)
    hear(ship, 1, system_id=77)
    ship.sail(10.0)
    assert (ship.mode, ship.autopilot.failsafes.active) == ("AUTO", ())


@pytest.mark.medium
def test_sticks_are_let_go_when_their_station_is_lost() -> None:
    ship = under_way(modes.MANUAL, FS_ACTION=0, RC_OVERRIDE_TIME=-1)
    hear(ship, 1)
    ship.hold_sticks(1.0, 0, 800)
    assert ship.command[0] > 0.5
    ship.sail(8.0)
    assert ship.command == (0.0, 0.0)
    assert set(ship.autopilot.manual.widths_us(ship.autopilot.state.now_ns)) == {0}


@pytest.mark.medium
@pytest.mark.parametrize(("action", "mode", "times"), [(0, "GUIDED", 0), (1, "HOLD", 1), (2, "GUIDED", 1)])
def test_position_lost_and_found(action: int, mode: str, times: int) -> None:
    ship = under_way(modes.GUIDED, FS_EKF_ACTION=action)
    ship.sail(2.0)
    ship.sensors.latency_ns = 10**12  # no more fixes
    ship.sail(7.0)
    assert ship.mode == mode
    assert ship.command == (0.0, 0.0)
    lost = [text for text in ship.said if text.startswith("EKF failsafe: position lost")]
    assert len(lost) == times
    ship.sensors.late.clear()
    ship.sensors.latency_ns = 120_000_000
    ship.sail(3.0)
    assert ship.said.count("EKF failsafe over") == times
    assert ship.mode == mode


def test_a_compass_and_a_receiver_that_disagree_are_bad_after_a_second() -> None:
    watches = FailsafeMonitor(Parameters())
    good = InnovationRatios(0.3, 0.3, 0.3, 0.3)
    for bad in (
        InnovationRatios(0.7, 0.7, 0.0, 0.0),  # position and velocity over 0.8 squared
        InnovationRatios(0.0, 0.7, 0.0, 0.7),  # velocity and compass
        InnovationRatios(0.0, 2.6, 0.0, 0.0),  # velocity far over
    ):
        assert not watches.update_ekf(False, bad, True, 0)
        assert not watches.update_ekf(False, bad, True, SECOND - 1)
        assert watches.update_ekf(False, bad, True, SECOND)
        assert watches.ekf.active
        assert not watches.update_ekf(False, bad, True, 2 * SECOND)
        assert watches.update_ekf(False, good, False, 3 * SECOND)
        assert not watches.ekf.active
    for fair in (InnovationRatios(9.0, 0.0, 9.0, 0.0), InnovationRatios(0.0, 0.7, 0.0, 0.0)):
        assert not watches.update_ekf(False, fair, True, 4 * SECOND)
        assert not watches.update_ekf(False, fair, True, 9 * SECOND)


def test_a_threshold_of_zero_accepts_all_test_ratios() -> None:
    monitor = FailsafeMonitor(Parameters({"FS_EKF_THRESH": 0.0}))
    for second in range(5):
        assert not monitor.update_ekf(False, InnovationRatios(100.0, 100.0, 100.0, 100.0), True, second * SECOND)


@pytest.mark.parametrize(("accepted", "armed", "lost"), [(0, False, False), (0, True, True), (1, False, True)])
def test_a_silent_imu_is_lost_after_its_first_sample_or_when_armed(accepted: int, armed: bool, lost: bool) -> None:
    monitor = FailsafeMonitor(Parameters({"FS_IMU_TIMEOUT": 0.5}))
    assert not monitor.update_imu(accepted, armed, 0)
    assert not monitor.update_imu(accepted, armed, SECOND // 2)
    assert monitor.update_imu(accepted, armed, SECOND // 2 + 1) == lost
    assert monitor.imu.active == lost


def test_a_disarmed_vessel_does_not_need_a_ground_station() -> None:
    monitor = FailsafeMonitor(Parameters({"FS_GCS_ENABLE": 1}))
    monitor.heard_ground_station(255, 0)
    for second in range(30):
        assert not monitor.update_gcs(False, second * SECOND)
    assert not monitor.gcs.active


def test_disarming_does_not_end_the_failsafe_of_a_lost_ground_station() -> None:
    monitor = FailsafeMonitor(Parameters({"FS_GCS_ENABLE": 1}))
    monitor.heard_ground_station(255, 0)
    changes = [second for second in range(20) if monitor.update_gcs(True, second * SECOND)]
    assert len(changes) == 1
    assert not any(monitor.update_gcs(False, second * SECOND) for second in range(20, 40))
    assert monitor.gcs.active
    monitor.heard_ground_station(255, 40 * SECOND)
    assert monitor.update_gcs(False, 40 * SECOND)
    assert not monitor.gcs.active


def test_a_clock_that_is_set_back_starts_the_wait_again() -> None:
    watches = FailsafeMonitor(Parameters({"FS_GCS_ENABLE": 1}))
    watches.heard_ground_station(255, 100 * SECOND)
    assert not watches.update_gcs(True, 106 * SECOND)
    assert not watches.update_gcs(True, 0)
    assert not watches.update_gcs(True, 106 * SECOND)
    assert watches.update_gcs(True, 108 * SECOND)


def test_after_a_silence_of_the_imu_the_first_fix_is_waited_for_but_not_for_ever() -> None:
    watches = FailsafeMonitor(Parameters())
    now_ns, accepted = 0, 1

    def look(position_lost: bool) -> bool:
        watches.update_imu(accepted, True, now_ns)
        return watches.update_ekf(position_lost, InnovationRatios(), True, now_ns)

    assert not look(False)
    now_ns = 5 * SECOND
    assert not look(True)
    assert watches.active == ("IMU",)
    accepted, now_ns = 2, 6 * SECOND
    assert not look(True)
    assert watches.active == ()
    for tenth in range(1, 30):
        accepted, now_ns = accepted + 1, 6 * SECOND + tenth * SECOND // 10
        assert not look(True)
    accepted, now_ns = accepted + 1, 9 * SECOND
    assert look(True)
    assert watches.active == ("EKF",)
