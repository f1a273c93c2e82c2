"""Orders in any sequence and of any values; arming by the bits of ARMING_CHECK; home."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
from boat import LAT_DEG, LON_DEG, degrees
from hypothesis import given, settings
from hypothesis import strategies as st
from steered_boat import SteeredBoat

from agent.fcu.fence import CIRCLE_IN, CIRCLE_OUT, POLYGON_IN, POLYGON_OUT, FenceItem
from agent.fcu.mission import COMMANDS, MissionItem, change_speed, item_problem, jump, make_mission, waypoint
from agent.fcu.parameters import TABLE
from agent.fcu.vehicle import modes
from agent.mavlink.parameter_rows import REAL32

ANY = st.floats() | st.sampled_from([0.0, 1.0, -1.0, 3.0, LAT_DEG, LON_DEG])
NEAR = st.floats(-100.0, 100.0)
SMALL = [-1.0, 0.0, 1.0, 2.0, 5.0]
WHOLE = st.integers(-(2**31), 2**31) | st.integers(-2, 20)
STICK = st.none() | st.integers(-1001, 1001)
PLACE = st.tuples(NEAR, NEAR).map(lambda place: degrees(*place))
ITEMS = st.lists(
    st.one_of(
        PLACE.map(lambda place: waypoint(*place, hold_s=0.1)),
        st.builds(MissionItem, st.sampled_from(sorted(COMMANDS)), parameters=st.tuples(*[st.sampled_from(SMALL)] * 4)),
        st.builds(jump, st.integers(1, 3), st.integers(-1, 2)),
        st.builds(change_speed, st.floats(0.1, 3.0)),
    ),
    max_size=6,
)
FENCE = st.builds(
    FenceItem,
    st.sampled_from([16, 5000, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT]),
    ANY | st.just(LAT_DEG),
    ANY | st.just(LON_DEG),
    ANY,
    st.integers(-1, 4),
)
SETTABLE = [row for row in TABLE if not row.name.endswith("_FUNCTION")]  # what drives this boat stays what it is
ORDERS = st.one_of(
    st.tuples(st.just("set_mode"), st.sampled_from([*modes.NAMES, 2, -1])),
    st.tuples(st.just("arm"), st.booleans()),
    st.tuples(st.just("disarm")),
    st.tuples(st.just("go_to"), ANY, ANY),
    st.tuples(st.just("go_to_local"), ANY | NEAR, ANY | NEAR),
    st.tuples(st.just("set_velocity"), ANY, ANY, st.none() | ANY, st.none() | ANY),
    st.tuples(st.just("set_course"), ANY, ANY),
    st.tuples(st.just("set_turn_rate"), ANY, ANY),
    st.tuples(st.just("change_speed"), ANY),
    st.tuples(st.just("set_current"), WHOLE),
    st.tuples(st.just("start_mission")),
    st.tuples(st.just("jump_to_tag"), WHOLE),
    st.tuples(st.just("set_reverse"), st.booleans()),
    st.tuples(st.just("set_servo"), WHOLE, WHOLE),
    st.tuples(st.just("repeat_servo"), WHOLE, WHOLE, WHOLE, ANY),
    st.tuples(st.just("aux_function"), st.sampled_from([4, 11, 16, 24, 42, 54, 58, 59, 72, 81, 153, 999]), WHOLE),
    st.tuples(st.just("set_heading_and_thrust"), ANY, ANY),
    st.tuples(st.just("set_origin"), ANY, ANY, ANY),
    st.tuples(st.just("set_home"), ANY, ANY, ANY),
    st.tuples(st.just("set_home_here")),
    st.tuples(st.just("enable_fence"), st.booleans()),
    st.tuples(st.just("set_fence"), st.lists(FENCE, max_size=4)),
    st.tuples(st.just("rc_override"), st.lists(st.integers(0, 65535) | st.integers(800, 2200), max_size=20).map(tuple)),
    st.tuples(st.just("manual_control"), STICK, STICK, STICK, STICK),
    st.tuples(st.just("heard_ground_station"), st.integers(0, 255)),
    st.tuples(st.just("mission"), ITEMS),
    st.tuples(st.just("parameter"), st.sampled_from(SETTABLE), st.floats(0.0, 1.0)),
    st.tuples(st.just("wait"), st.integers(1, 40)),
)
TIMED = ("rc_override", "manual_control", "heard_ground_station")


@pytest.fixture(scope="module")
def ready() -> SteeredBoat:
    ship = SteeredBoat()
    ship.sail(12.0)
    return ship


def give(ship: SteeredBoat, name: str, values: tuple[Any, ...]) -> None:
    autopilot = ship.autopilot
    if name == "mission":
        items = [item for item in values[0] if not item_problem(item)]
        if all(item.command != 177 or 1 <= item.parameters[0] <= len(items) for item in items):
            autopilot.commands.set_mission(make_mission([waypoint(LAT_DEG, LON_DEG), *items]))
    elif name == "parameter":
        row, part = values
        value = row.low + part * (row.high - row.low)
        if choices := [choice for choice in row.choices if row.low <= choice <= row.high]:
            value = min(choices, key=lambda choice: abs(choice - value))
        autopilot.parameters.set(row.name, value if row.type == REAL32 else round(value))
    elif name != "wait":
        owner = next(part for part in (autopilot, autopilot.commands, autopilot.failsafes) if hasattr(part, name))
        answer = getattr(owner, name)(*values, *((ship.boat.time_ns,) if name in TIMED else ()))
        assert answer is None or isinstance(answer, (str, tuple))


@pytest.mark.medium
@settings(max_examples=200)
@given(st.sampled_from(list(modes.NAMES)), st.booleans(), st.lists(ORDERS, min_size=3, max_size=25))
def test_any_orders_in_any_sequence_keep_the_outputs_finite(
    ready: SteeredBoat, mode: int, armed: bool, orders: list[tuple[Any, ...]]
) -> None:
    ship = copy.deepcopy(ready)
    ship.autopilot.commands.set_mission(make_mission([waypoint(LAT_DEG, LON_DEG), waypoint(*degrees(30.0, 10.0))]))
    assert ship.autopilot.set_mode(mode) == ""
    if armed:
        assert ship.autopilot.arm() == ()
    for name, *values in orders:
        give(ship, name, tuple(values))
        for _ in range(values[0] if name == "wait" else 1):
            actuators = ship.autopilot.control(ship.boat.time_ns)
            assert all(math.isfinite(command) and abs(command) <= 1.0 for command in actuators.command)
            assert ship.autopilot.state.mode in modes.NAMES
            for _ in range(4):
                ship.boat.step(actuators.command)
                ship.sensors.feed(ship.boat, ship.autopilot.estimator)
        assert len(ship.autopilot.manual.widths_us(ship.autopilot.state.now_ns)) == 18
    assert math.isfinite(ship.autopilot.state.speed_error_mps)


def without_anything() -> SteeredBoat:
    """Samples of the IMU only."""
    ship = SteeredBoat()
    for _ in range(100):
        ship.autopilot.estimator.on_imu(ship.sensors.imu(ship.boat))
        ship.boat.step((0.0, 0.0))
    ship.autopilot.control(ship.boat.time_ns)
    return ship


@pytest.mark.parametrize(
    ("checks", "mode", "names"),
    [
        (1, modes.GUIDED, {"AHRS: EKF3 not started", "Roll (RC1) is not neutral", "Fence requires position"}),
        (64, modes.GUIDED, {"Roll (RC1) is not neutral", "Fence requires position"}),
        (16, modes.GUIDED, {"AHRS: EKF3 not started", "Fence requires position"}),
        (2 + 4, modes.GUIDED, {"Fence requires position"}),
        (0, modes.GUIDED, set()),
    ],
)
def test_arming_checks_are_bits(checks: int, mode: int, names: set[str]) -> None:
    ship = without_anything()
    for name, value in (("ARMING_CHECK", checks), ("FENCE_ENABLE", 1)):
        ship.autopilot.parameters.set(name, value)
    ship.autopilot.set_mode(mode)
    ship.autopilot.commands.manual_control(0, 500, 0, 0, ship.boat.time_ns)
    assert set(ship.autopilot.prearm_problems()) == names


def test_a_receiver_without_a_fix_matters_to_modes_that_steer_by_it() -> None:
    ship = SteeredBoat()
    ship.sensors.latency_ns = 10**12
    ship.sail(14.0)
    for mode in (modes.MANUAL, modes.ACRO, modes.HOLD):
        ship.autopilot.set_mode(mode)
        assert ship.autopilot.prearm_problems() == ()
    for mode in (modes.GUIDED, modes.RTL, modes.LOITER, modes.STEERING):
        ship.autopilot.set_mode(mode)
        assert ship.autopilot.prearm_problems() == ("GPS 1: Bad fix",)
    ship.autopilot.commands.set_mission(make_mission([waypoint(1.0, 1.0)]))
    ship.autopilot.parameters.set("INITIAL_MODE", modes.AUTO)
    ship.autopilot.reset()
    assert "Mode requires mission" in ship.autopilot.prearm_problems()


def test_by_force_the_checks_are_skipped_and_it_is_said() -> None:
    ship = without_anything()
    assert ship.autopilot.arm() != ()
    ship.autopilot.events.drain()
    assert ship.autopilot.arm(force=True) == ()
    assert [event.text for event in ship.autopilot.events.drain()] == ["Armed by force, checks skipped"]


@pytest.mark.medium
def test_home_moves_at_arming_unless_it_was_set() -> None:
    ship = SteeredBoat()
    assert "before there is a position" in ship.autopilot.commands.set_home(*degrees(5.0, 5.0), 0.0)
    ship.sail(12.0)
    first = ship.autopilot.navigator.home
    assert first is not None
    ship.boat.current_ne_mps = (1.0, 0.0)
    ship.sail(10.0)
    assert ship.autopilot.navigator.home == first
    ship.autopilot.arm()
    assert ship.autopilot.navigator.home != first
    assert ship.autopilot.commands.set_home(*degrees(5.0, 5.0), 7.0) == ""
    ship.autopilot.disarm()
    ship.autopilot.arm()
    assert ship.autopilot.navigator.home == (*degrees(5.0, 5.0), 7.0)
    assert ship.autopilot.commands.set_home_here() == ""
    assert ship.autopilot.navigator.home.lat_deg > first.lat_deg


def test_going_on_from_an_item() -> None:
    ship = SteeredBoat()
    items = [waypoint(*degrees(north_m, 0.0)) for north_m in (0.0, 10.0, 20.0, 30.0)]
    ship.autopilot.commands.set_mission(make_mission([*items[:3], change_speed(2.0), items[3], change_speed(1.0)]))
    assert ship.autopilot.commands.set_current(2) == ""
    assert ship.autopilot.navigator.progress.current == 2
    assert ship.autopilot.commands.set_current(3) == ""
    assert ship.autopilot.navigator.progress.current == 4
    assert ship.autopilot.commands.set_current(0) == ""
    assert ship.autopilot.navigator.progress.current == 1
    assert "no waypoint comes after it" in ship.autopilot.commands.set_current(5)
