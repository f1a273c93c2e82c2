"""What the items of a mission do: stages, conditions, what is done on the way; a vessel that goes where it is told."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import pairwise, strict_zip

from agent.fcu.control.guidance import GuidanceGains, GuidanceInput
from agent.fcu.mission import (
    CHANGE_SPEED,
    COMMANDS,
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    DELAY,
    DO_JUMP_TAG,
    GUIDED_ENABLE,
    GUIDED_LIMITS,
    JUMP_TAG,
    LOITER_TIME,
    LOITER_TURNS,
    LOITER_UNLIMITED,
    RETURN_HOME,
    SET_SERVO,
    SET_YAW_SPEED,
    STAGES,
    MissionItem,
    jump,
    make_mission,
    waypoint,
)
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.mission_progress import CONDITIONS, STAGE_BEGINNINGS, MissionProgress, until_time_of_day_s
from agent.navigation.geodetic import LocalProjection

FRAME = LocalProjection(-8.8, -63.95, 50.0)
GAINS = GuidanceGains.from_parameters(Parameters())
DT_S = 0.1


def at(north_m: float, east_m: float, command: int = 16, *parameters: float) -> MissionItem:
    return do(command, *parameters)._replace(
        **dict(strict_zip(("lat_deg", "lon_deg"), FRAME.to_geodetic(north_m, east_m)))
    )


def do(command: int, *parameters: float) -> MissionItem:
    return MissionItem(command, parameters=(*parameters, *[0.0] * (4 - len(parameters))))


class Vessel:
    """Turns and goes at once as the mission says. said: what the mission says; performed: items handed out."""

    def __init__(self, *items: MissionItem, perform: Callable[[MissionItem], str] | None = None) -> None:
        self.said: list[str] = []
        self.performed: list[int] = []
        self.north_m = self.east_m = self.yaw_rad = self.speed_mps = self.time_s = 0.0
        self.track: list[tuple[float, float]] = []
        give = {} if perform is None else {"perform": perform}
        mission = make_mission([at(0.0, 0.0), *items])
        self.progress = MissionProgress(mission, 2.0, lambda _, text: self.said.append(text), **give)

    def sail(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Whether the mission, or `until`, ended it."""
        for _ in range(round(seconds / DT_S)):
            here = (self.north_m, self.east_m)
            output = self.progress.steer(GuidanceInput(GAINS, FRAME, here, self.yaw_rad, self.speed_mps, 0.0, DT_S))
            if output is None or (until is not None and until()):
                return True
            self.yaw_rad, self.speed_mps = output.heading_rad, output.speed_mps
            self.north_m += self.speed_mps * math.cos(self.yaw_rad) * DT_S
            self.east_m += self.speed_mps * math.sin(self.yaw_rad) * DT_S
            self.track.append((self.north_m, self.east_m))
            self.time_s += DT_S
        return False


def test_every_stage_has_a_beginning() -> None:
    assert set(STAGE_BEGINNINGS) == set(STAGES)
    assert not set(CONDITIONS) & set(STAGES)


@pytest.mark.parametrize(("radius_m", "sense"), [(10.0, 1.0), (-10.0, -1.0)])
def test_turns_are_sailed_around_a_place(radius_m: float, sense: float) -> None:
    vessel = Vessel(at(30.0, 0.0, LOITER_TURNS, 2.0, 0.0, radius_m), at(60.0, 0.0))
    assert vessel.sail(300.0, lambda: vessel.progress.current == 2)
    around = vessel.track[-1000:]
    off_m = [abs(math.hypot(north - 30.0, east) - 10.0) for north, east in around[len(around) // 2 :]]
    assert max(off_m) < 1.0
    angles = [math.atan2(east, north - 30.0) for north, east in vessel.track]
    steps = [math.remainder(b - a, 2.0 * math.pi) for a, b in pairwise(angles)]
    # Two turns in that sense, and the way onto the circle.
    assert sense * sum(steps[len(steps) // 4 :]) > 2.0 * math.pi
    assert 2.0 * 2.0 * math.pi * 10.0 / 2.0 <= vessel.time_s < 2.0 * 2.0 * math.pi * 10.0 / 1.0 + 30.0


def test_a_circle_is_no_tighter_than_the_vessel_turns_nor_faster_than_it_may() -> None:
    vessel = Vessel(at(20.0, 0.0, LOITER_TURNS, 1.0, 0.0, 0.0))
    assert vessel.sail(200.0)
    assert "Circle: radius increased to TURN_RADIUS (3.0)" in vessel.said
    assert "Circle: max speed is 1.6" in vessel.said  # 30 deg/s at 3 m


def test_delays_stay_where_the_vessel_comes_to_rest() -> None:
    vessel = Vessel(at(20.0, 0.0), do(DELAY, 7.0), at(40.0, 0.0))
    assert vessel.sail(60.0, lambda: vessel.progress.current == 2)
    began_s, north_m = vessel.time_s, vessel.north_m
    assert vessel.sail(60.0, lambda: vessel.progress.current == 3)
    assert vessel.time_s - began_s == pytest.approx(7.0, abs=0.3)
    assert vessel.north_m == pytest.approx(north_m, abs=GAINS.loiter_radius_m)
    assert "Delaying 7 sec" in vessel.said
    assert vessel.progress.drain_reached() == [1, 2]


@pytest.mark.parametrize(
    ("clock", "utc_s", "seconds"),
    [
        ((12.0, 30.0, 0.0), 12 * 3600.0, 1800.0),
        ((12.0, 0.0, 0.0), 12 * 3600.0 + 1.0, 86_399.0),
        ((-1.0, 5.0, 0.0), 3 * 3600.0 + 240.0, 60.0),
        ((-1.0, -1.0, 10.0), 3600.0 + 15.0, 55.0),
        ((-1.0, -1.0, -1.0), 0.0, 0.0),
        ((12.0, 0.0, 0.0), None, 0.0),
    ],
)
def test_a_delay_may_end_at_a_time_of_day(clock: tuple[float, ...], utc_s: float | None, seconds: float) -> None:
    assert until_time_of_day_s(clock, utc_s) == pytest.approx(seconds)


def test_a_heading_is_turned_to_absolute_or_from_the_present_one() -> None:
    vessel = Vessel(do(SET_YAW_SPEED, 90.0, 0.5), do(SET_YAW_SPEED, 45.0, -9.0, 1.0))
    vessel.sail(0.2)
    assert (math.degrees(vessel.yaw_rad), vessel.speed_mps) == (pytest.approx(90.0), 0.5)
    vessel.sail(0.1, lambda: False)
    assert (math.degrees(vessel.yaw_rad), vessel.speed_mps) == (pytest.approx(135.0), -2.0)  # no faster than WP_SPEED


def test_a_loiter_takes_its_time_and_one_without_end_has_none() -> None:
    vessel = Vessel(at(5.0, 0.0, LOITER_TIME, 4.0), at(10.0, 0.0, LOITER_UNLIMITED), at(20.0, 0.0))
    assert not vessel.sail(200.0)
    assert vessel.progress.current == 2
    assert vessel.said == [
        "Mission: 1 LoitTime",
        "Reached waypoint #1. Loiter for 4 seconds",
        "Finished active loiter",
        "Mission: 2 LoitUnlim",
        "Reached waypoint #2",
    ]


def test_an_item_without_a_place_is_where_the_vessel_is() -> None:
    vessel = Vessel(at(10.0, 0.0), waypoint(0.0, 0.0), at(20.0, 0.0))
    assert vessel.sail(60.0)
    assert vessel.progress.drain_reached() == [1, 2, 3]
    assert max(abs(east) for _, east in vessel.track) < 0.1


def test_conditions_hold_up_what_comes_after_them_and_not_the_vessel() -> None:
    performed: list[tuple[int, float, float]] = []
    vessel = Vessel(
        do(CONDITION_DELAY, 3.0),
        do(SET_SERVO, 5.0, 1700.0),
        do(CONDITION_DISTANCE, 8.0),
        do(SET_SERVO, 6.0, 1600.0),
        at(40.0, 0.0),
        perform=lambda item: performed.append((int(item.parameters[0]), vessel.time_s, vessel.north_m)) or "",
    )
    assert vessel.sail(60.0)
    (fifth, after_s, north_m), (sixth, _, near_m) = performed
    assert (fifth, sixth) == (5, 6)
    assert after_s == pytest.approx(3.0, abs=0.3)
    assert 4.0 < north_m < 7.0  # it went on
    assert 8.0 - 4 * 2.0 * DT_S < 40.0 - near_m < 8.0  # an item a cycle
    assert vessel.said[:3] == ["Mission: 1 CondDelay", "Mission: 5 WP", "Mission: 2 SetServo"]


def test_what_waited_in_vain_is_left_out_in_words() -> None:
    vessel = Vessel(do(CONDITION_DELAY, 1000.0), do(SET_SERVO, 5.0, 1700.0), at(10.0, 0.0), at(20.0, 0.0))
    assert vessel.sail(60.0)
    assert "Skipping cmd #183 SetServo: condition not met" in vessel.said


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (206, "Skipping cmd #206 SetCamTrigDst: no camera"),
        (201, "Skipping cmd #201 SetROI: no mount"),
        (181, "Skipping cmd #181 SetRelay: no relay"),
        (211, "Skipping cmd #211 Gripper: no gripper"),
        (42600, "Skipping cmd #42600 Winch: no winch"),
        (42702, "Skipping cmd #42702 NavScriptTime: no script"),
        (22, "Skipping invalid cmd #22"),
        (115, "Skipping invalid cmd #115"),
    ],
)
def test_what_a_boat_cannot_do_is_passed_over_and_said(command: int, words: str) -> None:
    vessel = Vessel(do(command, 1.0), at(10.0, 0.0))
    assert vessel.sail(30.0)
    assert vessel.progress.drain_reached() == [2]
    assert vessel.said[0] == f"Mission: 1 {COMMANDS[command].name}"
    assert words in vessel.said


def test_no_item_is_passed_over_in_silence() -> None:
    for command in sorted(set(COMMANDS) - {177, 601}):
        vessel = Vessel(do(command, 1.0, 1.0, 1.0, 1.0), at(3.0, 0.0))
        vessel.sail(30.0)
        assert f"Mission: 1 {COMMANDS[command].name}" in " | ".join(vessel.said)


def test_a_speed_that_is_none_changes_nothing() -> None:
    for speed_mps in (-1.0, -2.0, 0.0, 0.04):
        vessel = Vessel(do(CHANGE_SPEED, 1.0, 1.5), do(CHANGE_SPEED, 1.0, speed_mps), at(10.0, 0.0))
        vessel.sail(1.0)
        assert vessel.progress.speed_mps == 1.5
        assert [text for text in vessel.said if text.startswith("speed")] == ["speed: 1.5 m/s"]


def test_items_behind_the_last_waypoint_are_done() -> None:
    vessel = Vessel(at(5.0, 0.0), do(206, 5.0), do(SET_SERVO, 5.0, 1700.0))
    assert vessel.sail(30.0)
    assert [text for text in vessel.said if text.startswith("Mission:")] == [
        "Mission: 1 WP",
        "Mission: 2 SetCamTrigDst",
        "Mission: 3 SetServo",
    ]


def test_jumps_by_tag_are_counted() -> None:
    vessel = Vessel(do(JUMP_TAG, 7.0), at(4.0, 0.0), at(8.0, 0.0), do(DO_JUMP_TAG, 7.0, 1.0), at(12.0, 0.0))
    assert vessel.sail(90.0)
    assert vessel.progress.drain_reached() == [2, 3, 2, 3, 5]
    assert "Mission: 4 Jump 1/1" in vessel.said
    assert "Mission: 1 Tag 7" in vessel.said


def test_a_jump_to_a_tag_that_is_not_there_ends_the_mission() -> None:
    vessel = Vessel(at(4.0, 0.0), do(DO_JUMP_TAG, 9.0, 1.0), at(12.0, 0.0))
    assert vessel.sail(30.0)
    assert vessel.progress.drain_reached() == [1]
    assert "Mission: 2 JumpToTag to 9: no such item, mission ends" in vessel.said


def test_a_servo_may_blink_by_a_jump() -> None:
    performed: list[int] = []
    items = [do(SET_SERVO, 5.0, 1700.0), do(SET_SERVO, 5.0, 1300.0), jump(1, 3), at(30.0, 0.0)]
    vessel = Vessel(*items, perform=lambda item: performed.append(int(item.parameters[1])) or "")
    vessel.sail(3.0)
    assert performed == [1700, 1300] * 4
    assert vessel.progress.current == 4


@pytest.mark.parametrize(
    ("limits", "item"),
    [((5.0, 0.0, 0.0, 0.0), do(GUIDED_ENABLE, 1.0)), ((0.0,) * 4, at(0.0, 1.0, GUIDED_ENABLE, 1.0))],
)
def test_guided_ends_at_its_limits_or_its_place(limits: tuple[float, ...], item: MissionItem) -> None:
    vessel = Vessel(do(GUIDED_LIMITS, *limits), item, at(5.0, 0.0))
    vessel.sail(0.1)
    assert vessel.progress.hands_over or limits[0] == 0.0
    assert vessel.sail(8.0, lambda: vessel.progress.current == 3)
    assert not vessel.progress.hands_over


def test_home_is_a_stage_and_the_mission_goes_on_after_it() -> None:
    vessel = Vessel(at(8.0, 0.0), do(RETURN_HOME), at(0.0, 8.0))
    assert vessel.sail(60.0)
    assert vessel.progress.drain_reached() == [1, 2, 3]


ANY_ITEM = st.builds(
    do, st.sampled_from(sorted(COMMANDS)), *[st.sampled_from([-1.0, 0.0, 0.4, 1.0, 2.0, 7.0, 1e9])] * 4
) | st.builds(at, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.sampled_from(sorted(COMMANDS)), st.just(1.0))


@pytest.mark.medium
@given(st.lists(ANY_ITEM, min_size=1, max_size=12))
def test_any_items_keep_the_guidance_finite(items: list[MissionItem]) -> None:
    items = [item for item in items if item.command != 177 or 1 <= item.parameters[0] <= len(items)]
    vessel = Vessel(*items)
    for _ in range(40):
        vessel.sail(0.3)
        assert math.isfinite(vessel.yaw_rad + vessel.speed_mps + vessel.north_m + vessel.east_m)
