"""Missions: home first, what is refused, and how one is sailed through."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.fcu.control.guidance import GuidanceGains, GuidanceInput
from agent.fcu.mission import (
    COMMANDS,
    FOREVER,
    JUMP,
    LOITER_TIME,
    LOITER_UNLIMITED,
    MOST_ITEMS,
    RETURN_HOME,
    SET_YAW_SPEED,
    MissionError,
    MissionItem,
    MissionSequence,
    change_speed,
    item_problem,
    jump,
    make_mission,
    waypoint,
)
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.mission_progress import COMPLETE, MissionProgress
from agent.navigation.geodetic import Home, LocalProjection

FRAME = LocalProjection(-8.8, -63.95, 50.0)
GAINS = GuidanceGains.from_parameters(Parameters())


def now(pos_ne_m: tuple[float, float], yaw_rad: float, speed_mps: float) -> GuidanceInput:
    return GuidanceInput(GAINS, FRAME, pos_ne_m, yaw_rad, speed_mps, wanted_mps=0.0, dt_s=0.02)


def at(north_m: float, east_m: float) -> MissionItem:
    return waypoint(*FRAME.to_geodetic(north_m, east_m))


@pytest.mark.parametrize(
    ("item", "field", "words"),
    [
        (waypoint(91.0, 0.0), 5, "mission item 1: position 91, 0 is not on Earth"),
        (waypoint(math.nan, 5.0), 5, "not on Earth"),
        (waypoint(5.0, 180.5), 6, "not on Earth"),
        (waypoint(1.0, 1.0, math.inf), 7, "altitude"),
        (waypoint(1.0, 1.0, 83_000.0), 7, "altitude"),
        (change_speed(math.nan), 2, "parameter 2 of ChangeSpeed is nan"),
        (MissionItem(999), 0, "command 999 is not supported"),
        (waypoint(1.0, 1.0, hold_s=math.nan), 1, "parameter 1 of WP is nan"),
        (MissionItem(LOITER_TIME, 95.0, 1.0), 5, "not on Earth"),
        (MissionItem(SET_YAW_SPEED, parameters=(0.0, 0.0, 0.0, math.inf)), 4, "parameter 4 of SetYawSpd is inf"),
    ],
)
def test_a_bad_item_is_named(item: MissionItem, field: int, words: str) -> None:
    problem = item_problem(item)
    assert problem is not None
    assert problem.field == field
    with pytest.raises(MissionError, match=words):
        make_mission([at(0.0, 0.0), item])
    make_mission([item, at(1.0, 1.0)])  # as home it is never sailed to


def test_too_many_items() -> None:
    with pytest.raises(MissionError, match="at most"):
        make_mission([at(0.0, 0.0)] * (MOST_ITEMS + 1))


def test_home_alone_is_the_empty_mission() -> None:
    assert make_mission([at(0.0, 0.0)]) == make_mission([]) == MissionSequence()


def test_speeds_count_from_their_place_on() -> None:
    items = [at(0, 0), change_speed(2.0), at(10, 0), at(20, 0), change_speed(1.5), change_speed(1.2), at(30, 0)]
    pilot = MissionProgress(make_mission(items), 3.0)
    speeds, reached = [], []
    for north in range(31):
        pilot.steer(now((float(north), 0.0), 0.0, 1.0))
        speeds.append((pilot.current, pilot.speed_mps))
        reached += pilot.drain_reached()
    assert reached == [2, 3, 6]
    # what stands before a waypoint is done on the way to it, one item a cycle
    assert list(dict.fromkeys(speeds)) == [(2, 2.0), (3, 2.0), (6, 2.0), (6, 1.5), (6, 1.2), (0, 1.2)]
    assert pilot.state == COMPLETE


def test_legs_join_waypoints_and_the_first_starts_at_the_vessel() -> None:
    pilot = MissionProgress(make_mission([at(0, 0), at(50, 50), at(50, 150)]), 3.0)
    output = pilot.steer(now((50.0, 0.0), 0.0, 1.0))
    assert output is not None
    assert output.cross_track_m == 0.0
    assert output.bearing_rad == pytest.approx(math.pi / 2.0)
    pilot.steer(now((50.0, 49.0), 0.0, 1.0))
    output = pilot.steer(now((45.0, 60.0), 0.0, 1.0))
    assert output is not None
    assert output.cross_track_m == pytest.approx(5.0)  # right of a leg to the east is south


def test_waypoints_on_top_of_each_other_are_ticked_off() -> None:
    pilot = MissionProgress(make_mission([at(0, 0), at(5, 5), at(5, 5), at(5, 5)]), 3.0)
    outputs = [pilot.steer(now((5.0, 5.0), 0.0, 0.0)) for _ in range(4)]
    assert outputs[-1] is None
    assert pilot.drain_reached() == [1, 2, 3]


def visited(items: list[MissionItem], most: int = 50) -> list[int]:
    """What is sailed to, in order, by a vessel that is always there already."""
    return sailed(MissionProgress(make_mission(items), 3.0), items, most)


def sailed(pilot: MissionProgress, items: list[MissionItem], most: int = 50) -> list[int]:
    """What such a vessel sails to from now on."""
    order: list[int] = []
    while len(order) < most and pilot.current:
        order.append(pilot.current)
        item = items[pilot.current]
        pilot.steer(now(FRAME.to_local(item.lat_deg, item.lon_deg), 0.0, 0.0))
    return order


def test_jumps_are_made_so_often() -> None:
    items = [at(0, 0), at(10, 0), at(20, 0), jump(1, 2), at(30, 0)]
    assert visited(items) == [1, 2, 1, 2, 1, 2, 4]
    assert visited([*items[:3], jump(1, 0), items[4]]) == [1, 2, 4]
    assert visited([*items[:3], jump(1, FOREVER), items[4]], 20) == [1, 2] * 10
    assert visited([at(0, 0), at(10, 0), jump(4, 1), at(20, 0), at(30, 0)]) == [1, 4]
    nested = [at(0, 0), at(10, 0), jump(1, 1), at(20, 0), jump(3, 1)]
    assert visited(nested) == [1, 1, 3, 3]


def test_jumps_in_a_ring_end_the_mission() -> None:
    assert visited([at(0, 0), at(10, 0), jump(3, FOREVER), jump(2, FOREVER)]) == [1]
    assert visited([at(0, 0), jump(1, FOREVER), at(10, 0)]) == []


def test_looking_ahead_for_the_corner_makes_no_jump() -> None:
    items = [at(0, 0), at(50, 0), at(50, 50), jump(1, 1)]
    pilot = MissionProgress(make_mission(items), 3.0)
    for _ in range(10):
        pilot.steer(now((10.0, 0.0), 0.0, 1.0))
    assert sailed(pilot, items) == [1, 2, 1, 2]  # the only jump is still to be made


def test_holding_takes_its_time_and_counts_as_reached_then() -> None:
    items = [at(0, 0), waypoint(*FRAME.to_geodetic(10.0, 0.0), hold_s=2.0), at(20.0, 0.0)]
    pilot = MissionProgress(make_mission(items), 3.0)
    seconds = 0.0
    while pilot.current == 1:
        output = pilot.steer(now((10.0, 0.0), 0.3, 0.0))
        assert output is not None
        assert output.speed_mps >= 0.0
        seconds += 0.02
    assert seconds == pytest.approx(2.0, abs=0.06)
    assert pilot.drain_reached() == [1]


def test_loitering_here_for_ever_and_going_home() -> None:
    pilot = MissionProgress(make_mission([at(0, 0), MissionItem(LOITER_UNLIMITED)]), 3.0)
    for _ in range(2000):
        output = pilot.steer(now((7.0, 7.0), 0.0, 0.0))
        assert output is not None
    assert output.distance_m < 1e-6
    assert pilot.current == 1
    pilot = MissionProgress(make_mission([at(0, 0), MissionItem(RETURN_HOME)]), 3.0)
    assert pilot.steer(now((30.0, 40.0), 0.0, 0.0)).distance_m == pytest.approx(50.0)
    pilot.start_leg()
    pilot.home = Home(*FRAME.to_geodetic(30.0, 0.0), 0.0)
    assert pilot.steer(now((30.0, 40.0), 0.0, 0.0)).distance_m == pytest.approx(40.0)


@pytest.mark.medium
@given(
    st.sampled_from([*COMMANDS, 999]),
    st.tuples(*[st.floats()] * 4),
    st.tuples(*[st.floats()] * 3),
)
def test_any_fields_are_checked(command: int, parameters, place) -> None:
    item = MissionItem(command, *place, parameters)
    if item_problem(item) is None:
        assert all(math.isfinite(value) for value in parameters[: COMMANDS[command].parameters])


def test_what_ardurover_keeps_is_no_problem() -> None:
    for command in COMMANDS:
        assert item_problem(MissionItem(command)) is None
        assert item_problem(MissionItem(command, parameters=(-1.0, 1e9, 3.5, -0.0))) is None


STEPS = st.one_of(
    st.builds(waypoint, st.floats(-8.81, -8.79), st.floats(-63.96, -63.94), hold_s=st.sampled_from([0.0, 0.1])),
    st.builds(jump, st.integers(1, 5), st.integers(-1, 3)),
    st.builds(change_speed, st.floats(0.1, 5.0)),
    st.just(MissionItem(RETURN_HOME)),
    st.builds(
        lambda command, *parameters: MissionItem(command, parameters=parameters),
        st.sampled_from(sorted(COMMANDS.keys() - {JUMP})),
        *[st.sampled_from([-1.0, 0.0, 0.5, 1.0, 3.0, 1e9])] * 4,
    ),
)


@pytest.mark.medium
@given(st.lists(STEPS, min_size=5, max_size=12), st.lists(st.integers(1, 5), max_size=4))
def test_any_mission_can_be_sailed_from_anywhere(items: list[MissionItem], starts: list[int]) -> None:
    pilot = MissionProgress(make_mission([at(0, 0), *items]), 3.0)
    for start in (1, *starts):
        pilot.resume_from(start)
        for _ in range(30):
            output = pilot.steer(now((0.0, 0.0), 0.0, 1.0)._replace(dt_s=0.05))
            if output is None:
                assert pilot.state == COMPLETE
                break
            assert math.isfinite(output.heading_rad + output.speed_mps)
            assert pilot.current in pilot.mission.waypoints()
