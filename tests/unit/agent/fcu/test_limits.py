"""Values on either side of each limit: of measurements, of the fence, of servos and of orders."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from boat import SILENT, STEP_NS, Boat, Sensors

from agent.fcu.fence import (
    CIRCLE_IN,
    CIRCLE_OUT,
    MOST_ITEMS,
    POLYGON_IN,
    POLYGON_OUT,
    RETURN_POINT,
    Fence,
    FenceBreach,
    FenceError,
    FenceItem,
    check,
    fence_item_problem,
)
from agent.fcu.mavlink import reports
from agent.fcu.mission import (
    FENCE_ENABLE,
    REPEAT_SERVO,
    SET_HOME,
    SET_SERVO,
    MissionItem,
    MissionSequence,
    make_mission,
    waypoint,
)
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle.commands import ServoOutputs
from agent.fcu.vehicle.mission_progress import COMPLETE
from agent.fcu.vehicle.navigation import COURSE, POSITION, TURN, VELOCITY, GuidedTarget
from agent.navigation.estimator import Estimator
from agent.navigation.geodetic import Home, LocalProjection
from agent.navigation.measurements import (
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
)

SECOND = 1_000_000_000
MS = 1_000_000
LAT_DEG, LON_DEG = -8.8, -63.95
NO_NUMBER = (math.nan, math.inf, -math.inf)


def fix(stamp_ns: int, **changes: Any) -> GnssMeasurement:
    return GnssMeasurement(stamp_ns, LAT_DEG, LON_DEG, 60.0, (0.0, 0.0, 0.0))._replace(**changes)


@pytest.fixture(scope="module")
def ready() -> tuple[Estimator, int]:
    """An estimator at rest with everything known, and its time."""
    estimator, boat, sensors = Autopilot().estimator, Boat(), Sensors(1, SILENT)
    while boat.time_ns < 12 * SECOND:
        sensors.feed(boat, estimator)
        boat.step((0.0, 0.0))
    assert estimator.problems() == ()
    return estimator, boat.time_ns - STEP_NS


def gnss_problem(estimator: Estimator) -> str:
    return next((problem.text for problem in estimator.problems() if problem.check == "GPS"), "")


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({}, ""),
        ({"fix_type": 3, "satellites": 6, "horizontal_accuracy_m": 10.0}, ""),
        ({"fix_type": 2}, "GPS 1: Bad fix"),
        ({"satellites": 5}, "AHRS: GPS numsats 5 (needs 6)"),
        ({"horizontal_accuracy_m": 10.01}, "AHRS: GPS horiz error 10.0m (needs 10.0)"),
    ],
)
def test_a_fix_is_good_enough_or_the_problem_is_told(
    ready: tuple[Estimator, int], changes: dict[str, Any], problem: str
) -> None:
    estimator, now_ns = ready
    stamp_ns = max(now_ns, estimator._fix_seen_ns or 0) + 1
    assert estimator.on_gnss(fix(stamp_ns, **changes))
    assert gnss_problem(estimator) == problem


@pytest.mark.parametrize(
    ("changes", "plausible"),
    [
        ({"lat_deg": -90.0, "lon_deg": 180.0}, True),
        ({"lat_deg": 90.1}, False),
        ({"lon_deg": -180.1}, False),
        ({"alt_m": -9_999.0}, True),
        ({"alt_m": 10_000.0}, False),
        ({"vel_ned_mps": (60.0, -60.0, 52.0)}, True),
        ({"vel_ned_mps": (60.0, -60.0, 53.0)}, False),
        ({"horizontal_accuracy_m": 0.0, "vertical_accuracy_m": 0.0, "speed_accuracy_mps": 0.0}, True),
        *[({name: -0.1}, False) for name in ("horizontal_accuracy_m", "vertical_accuracy_m", "speed_accuracy_mps")],
        *[({name: 1e6}, False) for name in ("horizontal_accuracy_m", "vertical_accuracy_m", "speed_accuracy_mps")],
        *[({name: value}, False) for name in ("lat_deg", "lon_deg", "alt_m") for value in NO_NUMBER],
        *[({"vel_ned_mps": (0.0, value, 0.0)}, False) for value in NO_NUMBER],
    ],
)
def test_a_fix_that_cannot_be_is_refused(changes: dict[str, Any], plausible: bool) -> None:
    estimator = Autopilot().estimator
    assert estimator.on_gnss(fix(1, **changes)) is plausible
    assert estimator.refused["gnss"] == int(not plausible)


@pytest.mark.parametrize(
    ("gyro", "accel", "plausible"),
    [
        ((20.0, 20.0, 20.6), (0.0, 0.0, -9.8), True),
        ((20.0, 20.0, 20.7), (0.0, 0.0, -9.8), False),
        ((0.0, 0.0, 0.0), (0.0, -113.0, 113.0), True),
        ((0.0, 0.0, 0.0), (0.0, -113.2, 113.2), False),
        ((math.nan, 0.0, 0.0), (0.0, 0.0, -9.8), False),
        ((0.0, 0.0, 0.0), (0.0, math.inf, -9.8), False),
    ],
)
def test_an_inertial_sample_beyond_2000_degrees_a_second_or_16_g_is_refused(
    gyro: tuple[float, float, float], accel: tuple[float, float, float], plausible: bool
) -> None:
    """35 rad/s and 160 m/s² in all."""
    estimator = Autopilot().estimator
    assert estimator.on_imu(ImuMeasurement(STEP_NS, gyro, accel)) is plausible
    assert (estimator.refused["imu"], estimator.imu_accepted) == (int(not plausible), int(plausible))


@pytest.mark.parametrize(
    ("field_gauss", "plausible"),
    [
        ((0.0, 0.08, 0.061), True),
        ((0.0, 0.08, 0.059), False),
        ((0.96, 0.0, -0.719), True),
        ((0.96, 0.0, -0.721), False),
        ((math.nan, 0.2, 0.2), False),
    ],
)
def test_a_field_that_is_not_the_earth_s_is_refused(field_gauss: tuple[float, float, float], plausible: bool) -> None:
    """Below 0.1 and above 1.2 gauss."""
    estimator = Estimator(Parameters({f"COMPASS_OFS_{axis}": 0.0 for axis in "XYZ"}))
    assert estimator.on_magnetometer(MagnetometerMeasurement(1, field_gauss)) is plausible
    assert estimator.refused["magnetometer"] == int(not plausible)


@pytest.mark.parametrize("late_ns", [0, 1])
def test_a_sample_is_at_most_a_quarter_of_a_second_ahead_of_the_inertial_unit(
    ready: tuple[Estimator, int], late_ns: int
) -> None:
    """250 ms: the order of messages explains no more."""
    estimator, now_ns = ready
    at_ns = now_ns + 250 * MS + late_ns
    before = dict(estimator.refused)
    pressure = BarometerMeasurement(at_ns, 100_600.0, 20.0)
    assert estimator.on_barometer(pressure) is (late_ns == 0)
    assert estimator.refused["barometer"] - before["barometer"] == late_ns
    assert estimator.on_gnss(fix(at_ns)) is (late_ns == 0)
    assert estimator.on_magnetometer(MagnetometerMeasurement(at_ns, (0.25, 0.0, 0.1))) is (late_ns == 0)


def test_the_origin_can_be_set_once() -> None:
    estimator = Autopilot().estimator
    assert estimator.set_origin(1.0, 2.0, 3.0)
    assert not estimator.set_origin(4.0, 5.0, 6.0)
    assert estimator.frame is not None
    assert (estimator.frame.lat_deg, estimator.frame.lon_deg, estimator.frame.alt_m) == (1.0, 2.0, 3.0)


# -- fence


def fenced(**parameters: float) -> Fence:
    return Fence(Parameters({"FENCE_ENABLE": 1.0, "FENCE_MARGIN": 2.0, **parameters}))


def test_a_breach_begins_outside_and_ends_at_the_margin_inside() -> None:
    fence = fenced()
    assert not fence.update_breach(0.0, 1)
    assert fence.update_breach(-1e-9, 2)
    assert (fence.breach.outside, fence.breach.count, fence.breach.kind, fence.breach.time_ns) == (True, 1, 3, 2)
    assert not fence.update_breach(-5.0, 3), "it is not new"
    assert not fence.update_breach(1.999, 4)
    assert fence.breach.outside
    assert not fence.update_breach(2.0, 5)
    assert (fence.breach.outside, fence.breach.count, fence.breach.time_ns) == (False, 1, 2)
    assert fence.update_breach(-1.0, 6)
    assert (fence.breach.count, fence.breach.time_ns) == (2, 6)
    fence.forget_breach()
    fence.breach = FenceBreach(count=65_534)
    for stamp_ns in (7, 8):
        assert fence.update_breach(-1.0, stamp_ns)
        assert fence.breach.count == 65_535
        fence.forget_breach()


def test_a_fence_that_is_off_has_no_breach() -> None:
    parameters = Parameters({"FENCE_ENABLE": 1.0})
    fence = Fence(parameters)
    assert fence.update_breach(-1.0, 1)
    parameters.set("FENCE_ENABLE", 0.0)
    assert not fence.enabled
    assert not fence.update_breach(-1.0, 2)
    assert not fence.breach.outside
    assert not fence.update_breach(-1.0, 3)


@pytest.mark.parametrize(
    ("kinds", "items", "names"),
    [
        (2.0, 0, "Circle fence"),
        (2.0, 1, "Circle fence"),
        (4.0, 1, "Polygon fence"),
        (4.0, 0, " fence"),
        (6.0, 1, "Circle and Polygon fences"),
        (6.0, 0, "Circle fence"),
    ],
)
def test_active_fences_are_named(kinds: float, items: int, names: str) -> None:
    fence = fenced(FENCE_TYPE=kinds)
    fence.replace([FenceItem(CIRCLE_IN, LAT_DEG, LON_DEG, 50.0)] * items)
    assert fence.names == names


@pytest.mark.parametrize(
    ("item", "good"),
    [
        (FenceItem(RETURN_POINT, 90.0, -180.0), True),
        (FenceItem(RETURN_POINT, 90.1, 0.0), False),
        (FenceItem(RETURN_POINT, 0.0, 180.1), False),
        (FenceItem(RETURN_POINT - 1, 0.0, 0.0), False),
        (FenceItem(CIRCLE_OUT + 1, 0.0, 0.0), False),
        (FenceItem(POLYGON_IN, 0.0, 0.0, vertex_count=3), True),
        (FenceItem(POLYGON_OUT, 0.0, 0.0, vertex_count=2), False),
        (FenceItem(CIRCLE_IN, 0.0, 0.0, 0.01), True),
        (FenceItem(CIRCLE_IN, 0.0, 0.0, 0.0), False),
        (FenceItem(CIRCLE_OUT, 0.0, 0.0, 999_999.0), True),
        (FenceItem(CIRCLE_OUT, 0.0, 0.0, 1e6), False),
        (FenceItem(CIRCLE_OUT, 0.0, 0.0, math.nan), False),
    ],
)
def test_items_of_a_fence(item: FenceItem, good: bool) -> None:
    assert (fence_item_problem(item) == "") is good


def test_a_fence_is_checked_as_a_whole() -> None:
    circle = FenceItem(CIRCLE_IN, 0.0, 0.0, 5.0)
    corner = FenceItem(POLYGON_IN, 0.0, 0.0, vertex_count=3)
    check([circle] * MOST_ITEMS)
    with pytest.raises(FenceError, match="fence has 201 items; at most 200 fit"):
        check([circle] * (MOST_ITEMS + 1))
    check([circle, *[corner] * 3, *[corner] * 3, circle])
    with pytest.raises(FenceError, match="fence item 3: a polygon of 3 corners ends early"):
        check([circle, corner, corner, circle])
    with pytest.raises(FenceError, match="fence item 2: a polygon of 3 corners ends early"):
        check([circle, corner, corner])
    with pytest.raises(FenceError, match="fence item 2: a polygon of 3 corners ends early"):
        check([circle, corner, corner._replace(vertex_count=4), corner])


def test_the_clearance_is_the_least_of_all_areas() -> None:
    """A circle of 100 m around home, a square of 80 m, and a hole of 5 m at (20, 0) in it."""
    frame = LocalProjection(LAT_DEG, LON_DEG, 0.0)

    def at(north_m: float, east_m: float) -> tuple[float, float]:
        return frame.to_geodetic(north_m, east_m)

    corners = [
        FenceItem(POLYGON_IN, *at(n, e), vertex_count=4) for n, e in ((-40, -40), (40, -40), (40, 40), (-40, 40))
    ]
    items = [*corners, FenceItem(RETURN_POINT, *at(0.0, 0.0)), FenceItem(CIRCLE_OUT, *at(20.0, 0.0), 5.0)]
    fence, home = fenced(FENCE_TYPE=6.0, FENCE_RADIUS=100.0), Home(*at(0.0, -70.0), 0.0)
    fence.replace(items)
    expected = {(0.0, 0.0): 15.0, (20.0, 3.0): -2.0, (-30.0, 5.0): 10.0, (-50.0, 0.0): -10.0, (0.0, 30.0): 0.0}
    for place, clearance_m in expected.items():
        assert fence.clearance_m(frame, home, *at(*place)) == pytest.approx(clearance_m, abs=0.01), place
    corner_m = -math.hypot(10.0, 30.0)
    assert fence.clearance_m(frame, None, *at(50.0, -70.0)) == pytest.approx(corner_m, abs=0.01)
    fence.replace([])
    assert fence.clearance_m(frame, None, *at(0.0, 0.0)) == math.inf
    assert fence.clearance_m(frame, home, *at(0.0, 0.0)) == pytest.approx(30.0, abs=0.01)


# -- servos and orders


@pytest.mark.parametrize(
    ("output", "width_us", "problem"),
    [
        (1, 500, ""),
        (16, 2500, ""),
        (2, 0, ""),
        (2, 499, "Servo at 499 us; use 500 to 2500, 0 for none"),
        (2, 2501, "Servo at 2501 us; use 500 to 2500, 0 for none"),
        (0, 1500, "Servo 0 does not exist; use 1 to 16"),
        (17, 1500, "Servo 17 does not exist; use 1 to 16"),
        (3, 1500, "ServoRelayEvent: Channel 3 is already in use"),
    ],
)
def test_servos_have_limits(output: int, width_us: int, problem: str) -> None:
    for order in ("set", "repeat"):
        servos = ServoOutputs(driven=(3,))
        if order == "set":
            assert servos.set(output, width_us) == problem
        else:
            assert servos.repeat(output, width_us, 1, 1.0) == problem
            servos.update(0)
        expected = [0] * 16
        if not problem:
            expected[output - 1] = width_us
        assert servos.widths_us == expected


def moved(servos: ServoOutputs, times_ms: list[int], output: int = 5) -> list[int]:
    widths_us = []
    for time_ms in times_ms:
        servos.update(time_ms * MS)
        widths_us.append(servos.widths_us[output - 1])
    return widths_us


def test_a_servo_moves_to_and_fro_by_half_periods() -> None:
    servos = ServoOutputs()
    assert servos.repeat(5, 1900, 2, 1.0) == ""
    times_ms = [0, 100, 499, 500, 999, 1000, 1500, 2000, 5000]
    assert moved(servos, times_ms) == [1900, 1900, 1900, 1500, 1500, 1900, 1500, 1500, 1500]
    servos.repeat(5, 1100, 1, 0.0)
    assert moved(servos, [6000, 6001, 6002]) == [1100, 1500, 1500], "without a period: at each cycle"
    servos.repeat(5, 1900, -1, 1.0)
    assert moved(servos, [7000, 8000]) == [1500, 1500]
    servos.repeat(5, 1900, 5, 10_000.0)
    hour_ms = 3_600_000
    assert moved(servos, [0, hour_ms // 2 - 1, hour_ms // 2]) == [1900, 1900, 1500], "at most an hour"
    assert moved(servos, [hour_ms // 2 - 1]) == [1900], "a clock that was set back"
    assert servos.set(6, 1700) == ""
    assert moved(servos, [hour_ms * 9]) == [1500], "another output does not end it"
    assert servos.set(5, 1600) == ""
    assert moved(servos, [hour_ms * 20, hour_ms * 30]) == [1600, 1600]


def pilot(mode: int = modes.MANUAL, **parameters: float) -> Autopilot:
    made = Autopilot(Parameters(parameters))
    made.state.mode = mode
    return made


def mission(count: int = 4) -> MissionSequence:
    return make_mission([waypoint(LAT_DEG, LON_DEG + 1e-4 * number) for number in range(count)])


@pytest.mark.parametrize(
    ("speed_mps", "good"),
    [(0.0, False), (0.049, False), (0.05, True), (100.0, True), (100.1, False), (math.nan, False), (-1.0, False)],
)
def test_speeds_have_limits(speed_mps: float, good: bool) -> None:
    autopilot = pilot(modes.GUIDED)
    assert (autopilot.commands.change_speed(speed_mps) == "") is good
    assert autopilot.navigator.asked_mps == (speed_mps if good else None) or not good


def test_a_speed_is_for_the_mission_in_auto_and_needs_a_mode_with_speeds() -> None:
    autopilot = pilot(modes.AUTO)
    assert autopilot.commands.change_speed(1.5) == ""
    assert autopilot.navigator.progress.speed_mps == 1.5
    assert pilot(modes.HOLD).commands.change_speed(1.5) == "HOLD has no speed to change"


@pytest.mark.parametrize(
    ("seq", "current", "words"),
    [
        (0, 1, ""),
        (1, 1, ""),
        (3, 3, ""),
        (4, None, "mission item 4 does not exist; the mission has 4 items"),
        (-1, None, "mission item -1 does not exist; the mission has 4 items"),
    ],
)
def test_the_current_item_is_one_of_the_mission(seq: int, current: int | None, words: str) -> None:
    autopilot = pilot()
    autopilot.commands.set_mission(mission())
    before = autopilot.navigator.progress.current
    assert autopilot.commands.set_current(seq) == words
    assert autopilot.navigator.progress.current == (before if current is None else current)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ((LAT_DEG, LON_DEG, 99_999.0), ""),
        ((LAT_DEG, LON_DEG, 1e5), "altitude 100000 m is not valid; use 0"),
        ((LAT_DEG, LON_DEG, math.nan), "altitude nan m is not valid; use 0"),
        ((LAT_DEG, LON_DEG, -1e5), "altitude -100000 m is not valid; use 0"),
    ],
)
def test_home_and_origin_have_an_altitude(place: tuple[float, float, float], words: str) -> None:
    autopilot = pilot()
    refused = f"Origin refused: {words}" if words else ""
    assert autopilot.commands.set_origin(*place) == refused
    known = pilot()
    assert known.commands.set_home(LAT_DEG, LON_DEG, 0.0) == "home cannot be set before there is a position"
    assert known.estimator.set_origin(LAT_DEG, LON_DEG, 0.0)
    assert known.commands.set_home(*place) == words
    if not words:
        assert known.navigator.home == Home(*place)
        assert known.navigator.home_is_set
        assert known.commands.set_origin(*place) == "Origin refused: the origin is set already"
    assert known.commands.set_home_here() == "home cannot be set here: no position"


@pytest.mark.parametrize(("north_m", "east_m", "good"), [(9e5, -9e5, True), (1e6, 0.0, False), (0.0, -1e6, False)])
def test_a_local_target_is_nearer_than_1000_km(north_m: float, east_m: float, good: bool) -> None:
    autopilot = pilot(modes.GUIDED)
    assert autopilot.commands.go_to_local(1.0, 2.0) == "a local target needs a position"
    autopilot.estimator.set_origin(0.0, 0.0, 0.0)
    assert (autopilot.commands.go_to_local(north_m, east_m) == "") is good
    assert (autopilot.navigator.guided.target is not None) is good


def item(command: int, *parameters: float) -> MissionItem:
    return MissionItem(command, parameters=(*parameters, *(0.0,) * (4 - len(parameters))))  # type: ignore[arg-type]


def test_actions_of_a_mission_set_servos_the_fence_and_home() -> None:
    autopilot = pilot()
    commands = autopilot.commands
    commands.perform(item(SET_SERVO, 5.0, 1700.0))
    assert autopilot.servos.widths_us[4] == 1700
    commands.perform(item(REPEAT_SERVO, 6.0, 1800.0, 1.0, 2.0))
    autopilot.servos.update(0)
    assert autopilot.servos.widths_us[5] == 1800
    for wanted, enabled in ((1.0, 1.0), (2.0, 1.0), (0.0, 0.0), (2.0, 0.0)):
        commands.perform(item(FENCE_ENABLE, wanted))
        assert autopilot.parameters["FENCE_ENABLE"] == enabled
    autopilot.estimator.set_origin(LAT_DEG, LON_DEG, 0.0)
    place = MissionItem(SET_HOME, LAT_DEG, LON_DEG, 5.0)
    commands.perform(place)
    assert autopilot.navigator.home == Home(LAT_DEG, LON_DEG, 5.0)
    autopilot.events.drain()
    commands.perform(place._replace(parameters=(1.0, 0.0, 0.0, 0.0)))
    assert [event.text for event in autopilot.events.drain()] == ["home cannot be set here: no position"]


@pytest.mark.parametrize(
    ("function", "position", "refusal"),
    [(11, 3, "switch position 3; use 0 to 2"), (99, 2, "Invalid channel option (99)")],
)
def test_switches_that_do_not_exist_are_refused(function: int, position: int, refusal: str) -> None:
    assert pilot().commands.aux_function(function, position) == refusal


def test_switches_act_at_their_high_position() -> None:
    autopilot = pilot()
    commands = autopilot.commands
    commands.set_mission(mission())
    progress = autopilot.navigator.progress
    for position, enabled in ((2, 1.0), (1, 0.0), (2, 1.0), (0, 0.0)):
        assert commands.aux_function(11, position) == ""
        assert autopilot.parameters["FENCE_ENABLE"] == enabled
    commands.set_current(3)
    for position, current in ((0, 3), (1, 3), (2, 1)):
        assert commands.aux_function(24, position) == ""
        assert min(progress.current, 3) == current
    for position, items in ((0, 4), (1, 4), (2, 0)):
        assert commands.aux_function(58, position) == ""
        assert len(autopilot.navigator.mission.items) == items
    for position in (0, 1, 2):
        assert commands.aux_function(54, position) == ""
        assert (autopilot.state.mode == modes.HOLD) is (position == 2)
    for function, position, armed in ((81, 0, True), (81, 1, True), (81, 2, False), (153, 1, True), (153, 0, False)):
        autopilot.state.armed = True
        assert commands.aux_function(function, position) == ""
        assert autopilot.state.armed is armed, (function, position)
    assert commands.aux_function(153, 2) != "", "it is not ready to arm"


def test_a_mission_that_is_complete_is_not_under_way() -> None:
    autopilot = pilot(modes.AUTO)
    autopilot.commands.set_mission(mission())
    autopilot.state.armed = True
    progress = autopilot.navigator.progress
    autopilot.commands.set_current(3)
    assert autopilot.commands.start_mission() == ""
    assert progress.current == 3, "it goes on"
    progress.state = COMPLETE
    autopilot.commands.start_mission()
    assert progress.current < 3


@pytest.mark.parametrize(
    ("target", "mask", "expected"),
    [
        (GuidedTarget(POSITION, 1.5, -2.5), "_MASK_POSITION", (1.5, -2.5, 0.0, 0.0, 0.0, 0.0)),
        (GuidedTarget(VELOCITY, north_mps=1.0, east_mps=-2.0), "_MASK_VELOCITY", (0.0, 0.0, 1.0, -2.0, 0.0, 0.0)),
        (
            GuidedTarget(VELOCITY, north_mps=1.0, east_mps=-2.0, heading_rad=0.5),
            "_MASK_COURSE",
            (0.0, 0.0, 1.0, -2.0, 0.5, 0.0),
        ),
        (
            GuidedTarget(COURSE, heading_rad=math.radians(30.0), speed_mps=2.0),
            "_MASK_COURSE",
            (0.0, 0.0, math.sqrt(3.0), 1.0, math.radians(30.0), 0.0),
        ),
        (
            GuidedTarget(TURN, turn_rate_radps=0.25, speed_mps=2.0),
            "_MASK_TURN",
            (0.0, 0.0, 2.0 * math.cos(0.7), 2.0 * math.sin(0.7), 0.0, 0.25),
        ),
    ],
)
def test_a_target_is_reported_with_what_is_steered_by(target: GuidedTarget, mask: str, expected: Any) -> None:
    state = SimpleNamespace(estimate=SimpleNamespace(yaw_rad=0.7))
    hub: Any = SimpleNamespace(autopilot=SimpleNamespace(guided_target=target, state=state))
    told = reports._target(hub)
    assert told is not None
    assert told[0] == getattr(reports, mask)
    assert told[1:] == pytest.approx(expected)
