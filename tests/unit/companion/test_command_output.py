"""Which way around things the lookout goes, where it waits, and what it then sends, in closed situations."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.companion.autopilot_state import PathAhead
from agent.companion.avoidance import (
    AROUND,
    FREE,
    STAY,
    AvoidanceChoice,
    AvoidancePlanner,
    Obstacles,
    PathLegs,
    crab_heading_rad,
    simulate_courses,
)
from agent.companion.command_output import CommandOutput
from agent.companion.pose_history import VehiclePose
from agent.companion.rigid_motion import quaternion_from_euler, rotation_matrix
from agent.mavlink.modes import AUTO, GUIDED
from agent.wire import dialect as mav

HERE = np.zeros(2)
HULL_M, MARGIN_M = 1.4, 3.0
NORTHWARD = PathLegs(np.array([(0.0, 0.0), (200.0, 0.0)]))
EAST, WEST, STILL = np.array((0.0, 0.5)), np.array((0.0, -0.5)), np.zeros(2)

_NO_PLACE, _NO_SIZE = np.empty((0, 2)), np.empty(0)
NOTHING = Obstacles(_NO_PLACE, _NO_PLACE, _NO_SIZE, _NO_SIZE, _NO_SIZE, _NO_PLACE)


def planner() -> AvoidancePlanner:
    return AvoidancePlanner(MARGIN_M, 0.6 * MARGIN_M, 12.0, HULL_M)


def adrift(north_m: float, east_m: float, vel: np.ndarray, points: np.ndarray | None = None) -> Obstacles:
    """A thing 2 m by 2 m, and what stands."""
    one = np.ones(1)
    points = np.empty((0, 2)) if points is None else points
    return Obstacles(np.array([[north_m, east_m]]), vel[None], one, one, 0.0 * one, points)


def wall(east_m: float) -> np.ndarray:
    """Along the legs."""
    return np.column_stack([np.arange(-20.0, 80.0, 0.5), np.full(200, east_m)])


def choice(around: Obstacles, current: np.ndarray, legs: PathLegs = NORTHWARD, stays: bool = False) -> AvoidanceChoice:
    vel = STILL if stays else np.array((3.0, 0.0))
    return planner().choose_course(legs, HERE, vel, 0.0, 3.0, around, None, stays, current)


@pytest.mark.parametrize("current", [EAST, WEST])
@pytest.mark.parametrize("early_m", [-2.0, 0.0, 2.0])
def test_what_drifts_across_is_passed_up_the_current(current: np.ndarray, early_m: float) -> None:
    """It crosses the leg when the vessel gets there, a little sooner or later: behind it there is room at any time."""
    north_m = 30.0
    east_m = -(north_m / 3.0) * current[1] + math.copysign(early_m, current[1])
    boom = wall(10.0 * math.copysign(1.0, current[1]))
    best = choice(adrift(north_m, east_m, current, boom), current)
    assert best.kind == AROUND
    assert math.sin(best.course_rad) * current[1] < 0.0


def test_what_is_held_beside_a_free_way_is_let_alone() -> None:
    assert choice(adrift(20.0, 9.0, STILL, wall(10.0)), EAST).kind == FREE


def test_a_stop_past_the_end_of_the_legs_ends() -> None:
    """The mission's last place lies 3 m astern: there is no more to be gained than those."""
    back = PathLegs(np.array([(0.0, 0.0), (-3.0, 0.0)]))
    assert choice(NOTHING, EAST, back, stays=True).kind != STAY


def test_waiting_is_where_the_vessel_comes_to_rest_and_up_the_current_of_what_stands() -> None:
    vel = np.array((1.4, 0.0))
    at_rest = planner().waiting_position(HERE, vel, NOTHING, EAST)
    np.testing.assert_allclose(at_rest, (1.4, 0.0))  # v^2 / 2a of 0.7 m/s^2
    beside = NOTHING._replace(points_ne_m=wall(5.0))
    place = planner().waiting_position(HERE, vel, beside, EAST)
    assert place[0] == pytest.approx(1.4)
    assert 5.0 - place[1] >= 2.0 * MARGIN_M + HULL_M
    np.testing.assert_allclose(planner().waiting_position(HERE, vel, beside, STILL), (1.4, 0.0))


def test_the_heading_for_a_course_makes_up_for_the_current() -> None:
    """What is made good is the speed through the water along the heading, and the current."""
    for course in (0.0, 1.0, -2.5):
        over_ground = 3.0 * np.array((math.cos(course), math.sin(course)))
        heading = crab_heading_rad(course, 3.0, EAST)
        through = over_ground - EAST
        assert heading == pytest.approx(math.atan2(through[1], through[0]))
    assert crab_heading_rad(0.7, 3.0, STILL) == pytest.approx(0.7)


def test_only_what_is_off_the_legs_down_the_current_is_to_lee() -> None:
    pos = np.array((0.0, 4.0))
    legs, none, speed = NORTHWARD, np.zeros(1), np.array((3.0,))
    lee = [
        simulate_courses(legs, pos, STILL, 0.0, none, none, speed, 4.0, current).lee_m[0]
        for current in (EAST, WEST, STILL)
    ]
    off = simulate_courses(legs, pos, STILL, 0.0, none, none, speed, 4.0).off_m[0]
    assert lee == [pytest.approx(off), 0.0, 0.0]


def view(mode: int) -> Any:
    """An autopilot under way on its leg."""
    way = PathAhead(((0.0, 0.0), (200.0, 0.0)), 3.0)

    def set_mode(wanted: int) -> None:
        vehicle.mode = wanted

    vehicle = SimpleNamespace(target=(1, 1), armed=True, mode=mode, path_ahead=lambda: way, set_mode=set_mode)
    return vehicle


def engaged(around: Obstacles, current: np.ndarray, vel: tuple[float, float]) -> list[Any]:
    """What the helm sends once it has the vessel in GUIDED."""
    helm, vehicle = CommandOutput(planner(), 0.6 * MARGIN_M, 3.0), view(AUTO)
    pose = VehiclePose(np.zeros(3), rotation_matrix(quaternion_from_euler(0.0, 0.0, 0.0)), np.array((*vel, 0.0)))
    for tick in range(20):
        sent = helm.update(vehicle, pose, around, current, tick * 200_000_000)
        if vehicle.mode == GUIDED:
            return sent
        if sent:
            helm.handle_acknowledgement(mav.MAVLink_command_ack_message(mav.MAV_CMD_DO_SET_MODE, 0), vehicle)
    raise AssertionError("it was never engaged")


def test_a_detour_is_sent_as_a_velocity_with_the_heading_for_it() -> None:
    (sent,) = engaged(adrift(25.0, -4.0, EAST), EAST, (3.0, 0.0))
    ignored = sent.type_mask
    assert not ignored & (mav.POSITION_TARGET_TYPEMASK_VX_IGNORE | mav.POSITION_TARGET_TYPEMASK_YAW_IGNORE)
    assert ignored & mav.POSITION_TARGET_TYPEMASK_X_IGNORE
    made_good = math.atan2(sent.vy, sent.vx)
    assert math.sin(sent.yaw - made_good) < -0.05, "the bow is not up the current"


def test_a_stop_is_sent_as_a_place() -> None:
    across = np.column_stack([np.full(200, 6.0), np.linspace(-50.0, 50.0, 200)])
    (sent,) = engaged(adrift(7.0, 0.0, STILL, across), EAST, (0.3, 0.0))
    assert not sent.type_mask & mav.POSITION_TARGET_TYPEMASK_X_IGNORE
    assert sent.type_mask & mav.POSITION_TARGET_TYPEMASK_VX_IGNORE
    assert sent.x < 6.0 - HULL_M - 0.5 * MARGIN_M
