"""The occasional records of the flight log: each change once, at its instant, with the codes of ArduPilot."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from agent.fcu.dataflash import records
from agent.fcu.dataflash.flight_log import ChangeLog, LoopTimes, LoopWindow
from agent.fcu.dataflash.format import FORMATS
from agent.fcu.mission import make_mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.navigation.geodetic import Home, LocalProjection

S = 1_000_000_000


class Vehicle:
    """What the log reads of an autopilot."""

    def __init__(self, **parameters: float) -> None:
        self.parameters = Parameters(parameters)
        estimate = SimpleNamespace(position_valid=False)
        self.state = SimpleNamespace(mode=modes.MANUAL, armed=False, estimate=estimate)
        self.failsafes = SimpleNamespace(active=())
        self.fence = SimpleNamespace(enabled=False)
        self.estimator: Any = SimpleNamespace(frame=None)
        progress = SimpleNamespace(current=0)
        self.navigator: Any = SimpleNamespace(home=None, mission=make_mission([]), progress=progress)


class Log:
    """The records of each update."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self._records: list[bytes] = []
        self.changes = ChangeLog(self._records.append)
        self.update(1)

    def update(self, at_s: float) -> list[bytes]:
        self._records.clear()
        self.changes.update(round(at_s * S), self.vehicle)  # type: ignore[arg-type]
        return list(self._records)

    def items(self) -> list[bytes]:
        self._records.clear()
        self.changes.log_mission_items(9)
        return list(self._records)


def ev(at_us: int, number: int) -> bytes:
    return FORMATS["EV"].pack(at_us, number)


def err(at_us: int, subsystem: int, code: int) -> bytes:
    return FORMATS["ERR"].pack(at_us, subsystem, code)


@pytest.fixture
def log() -> Log:
    return Log(Vehicle())


def test_all_parameters_are_logged_first_and_then_those_that_change() -> None:
    vehicle = Vehicle(COMPASS_OFS_X=12.0, COMPASS_OFS_Y=-3.0, COMPASS_OFS_Z=5.0, CRUISE_SPEED=2.5)
    written: list[bytes] = []
    changes = ChangeLog(written.append)
    changes.update(2 * S, vehicle)  # type: ignore[arg-type]
    parameters = [record for record in written if len(record) == len(FORMATS["PARM"].pack(0, b"", 0.0, 0.0))]
    assert len(parameters) == len(list(vehicle.parameters))
    assert FORMATS["PARM"].pack(2_000_000, b"COMPASS_OFS_X", 12.0, 0.01) in parameters
    assert FORMATS["PARM"].pack(2_000_000, b"CRUISE_SPEED", 2.5, 3.0) in parameters
    assert changes.offset_mgauss == (12.0, -3.0, 5.0)
    log = Log(vehicle)
    vehicle.parameters.set("COMPASS_OFS_Y", 4.0)
    assert log.update(3.0) == [FORMATS["PARM"].pack(3_000_000, b"COMPASS_OFS_Y", 4.0, 0.01)]
    assert log.changes.offset_mgauss == (12.0, 4.0, 5.0)
    assert log.update(4.0) == []


def test_the_fence_is_logged_when_it_is_switched(log: Log) -> None:
    for at_s, enabled, number in ((2.0, True, 41), (3.0, False, 42)):
        log.vehicle.fence.enabled = enabled
        log.vehicle.parameters.set("FENCE_ENABLE", float(enabled))
        assert log.update(at_s)[1:] == [ev(round(at_s * 1e6), number)]


def test_a_mode_and_arming_are_logged_once(log: Log) -> None:
    log.vehicle.state.mode = modes.HOLD
    log.vehicle.state.armed = True
    check = int(log.vehicle.parameters["ARMING_CHECK"])
    assert log.update(2.0) == [
        FORMATS["MODE"].pack(2_000_000, modes.HOLD, modes.HOLD, 0),
        FORMATS["ARM"].pack(2_000_000, 1, check),
        ev(2_000_000, 10),
    ]
    assert log.update(2.1) == []
    log.vehicle.state.armed = False
    assert log.update(3.0) == [FORMATS["ARM"].pack(3_000_000, 0, check), ev(3_000_000, 11)]
    log.changes.set_armed(4_000_000, False)
    assert log.update(5.0) == []


def test_origin_and_home_are_logged_when_they_are_known_and_moved(log: Log) -> None:
    frame = LocalProjection(-8.8, -63.95, 50.0)
    log.vehicle.estimator.frame = frame
    assert log.update(2.0) == [records.position_mark(2_000_000, records.ORIGIN, -8.8, -63.95, 50.0)]
    for at_s, home in ((3.0, Home(-8.8, -63.95, 51.0)), (4.0, Home(-8.7, -63.95, 51.0))):
        log.vehicle.navigator.home = home
        at_us = round(at_s * 1e6)
        assert log.update(at_s) == [records.position_mark(at_us, records.HOME, *home), ev(at_us, 25)]
    assert log.update(5.0) == []


def test_a_lost_position_is_an_error_until_it_is_back(log: Log) -> None:
    estimate = log.vehicle.state.estimate
    logged = []
    for at_s, valid in ((2.0, True), (3.0, False), (4.0, False), (5.0, True), (6.0, True), (7.0, False)):
        log.vehicle.state.estimate = estimate = SimpleNamespace(position_valid=valid)
        logged.append(log.update(at_s))
    assert estimate.position_valid is False
    assert logged == [[], [err(3_000_000, 16, 2)], [], [err(5_000_000, 16, 0)], [], [err(7_000_000, 16, 2)]]


def test_failsafes_begin_and_end_with_their_subsystem_and_code(log: Log) -> None:
    log.vehicle.parameters.set("FENCE_TYPE", 6.0)
    log.update(2.0)
    logged = []
    for at_s, active in ((3.0, ("GCS",)), (4.0, ("GCS", "Fence")), (5.0, ("EKF", "IMU")), (6.0, ())):
        log.vehicle.failsafes.active = active
        logged.append(log.update(at_s))
    assert logged == [
        [err(3_000_000, 8, 1)],
        [err(4_000_000, 9, 6)],
        [err(5_000_000, 8, 0), err(5_000_000, 9, 0), err(5_000_000, 17, 1), err(5_000_000, 26, 1)],
        [err(6_000_000, 17, 0), err(6_000_000, 26, 0)],
    ]


def test_a_new_mission_is_logged_eight_items_a_cycle(log: Log) -> None:
    mission = make_mission([waypoint(-8.8 + 0.001 * number, -63.95, 0.0) for number in range(10)])
    log.vehicle.navigator.mission = mission
    items = mission.items
    assert log.update(2.0) == []
    expected = [records.mission_item("CMD", 9, seq, len(items), item) for seq, item in enumerate(items)]
    first = log.items()
    assert first == expected[:8]
    assert log.items() == expected[8:]
    assert log.items() == []


@pytest.mark.parametrize(
    ("mode", "armed", "shown"), [(modes.AUTO, True, 2), (modes.AUTO, False, None), (0, True, None)]
)
def test_the_item_that_a_vessel_executes_is_logged_while_it_sails_its_mission(
    log: Log, mode: int, armed: bool, shown: int | None
) -> None:
    mission = make_mission([waypoint(-8.8 + 0.001 * number, -63.95, 0.0) for number in range(3)])
    log.vehicle.navigator.mission = mission
    log.vehicle.state.mode, log.vehicle.state.armed = mode, armed
    log.vehicle.navigator.progress.current = 1
    log.update(2.0)
    log.vehicle.navigator.progress.current = 2
    expected = (
        [] if shown is None else [records.mission_item("MISE", 3_000_000, 2, len(mission.items), mission.items[2])]
    )
    assert log.update(3.0) == expected
    log.vehicle.navigator.progress.current = len(mission.items)  # beyond the last
    assert log.update(4.0) == []
    log.vehicle.navigator.progress.current = 0
    assert log.update(5.0) == []


# -- the loop


def stats(mean_ns: float, cycles: int) -> Any:
    return SimpleNamespace(run_mean_ns=mean_ns, cycles=cycles)


def test_a_window_counts_loops_of_more_than_1_2_periods_and_the_longest() -> None:
    window = LoopWindow(0, 50)  # a period of 20 ms
    for at_ms in (0, 20, 44, 69, 89, 114):
        window.add_loop(at_ms * 1_000_000)
    # Intervals: 20, 24 (not longer than 1.2 periods), 25, 20, 25
    assert window.finish(10 * S, []) == LoopTimes(2, 5, 25_000, 0)


@pytest.mark.parametrize(("at_s", "complete"), [(9.4, False), (9.5, True), (10.4, True)])
def test_a_window_ends_at_the_call_nearest_to_ten_seconds(at_s: float, complete: bool) -> None:
    window = LoopWindow(2 * S, 50)
    assert (window.finish(2 * S + round(at_s * S), []) is not None) is complete


def test_the_load_is_the_share_of_the_window_that_tasks_ran() -> None:
    window = LoopWindow(0, 50)
    first = window.finish(10 * S, [stats(1e6, 2000), stats(2e6, 500)])
    assert first is not None
    assert first.load == 300  # 2 s and 1 s of 10 s
    second = window.finish(20 * S, [stats(1e6, 3000), stats(2e6, 500)])
    assert second is not None
    assert second.load == 100  # 1 s more
    restarted = window.finish(30 * S, [stats(1e6, 10)])
    assert restarted is not None
    assert restarted.load == 0


def test_a_later_window_counts_its_own_loops() -> None:
    window = LoopWindow(0, 50)
    for at_ns in (0, S):
        window.add_loop(at_ns)
    assert window.finish(10 * S, []) == LoopTimes(1, 1, 1_000_000, 0)
    window.add_loop(round(1.01 * S))
    assert window.finish(20 * S, []) == LoopTimes(0, 1, 10_000, 0)
