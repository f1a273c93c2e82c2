"""A mission without an autopilot, from true motions that the test places: progress, waiting and commands."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.kinematics import Kinematics
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.nodes.direct_control import IdealControl, OperatedControl, ScheduledControl, direct_control
from xitl_cli.run.operator.actions import CommandMotor, SteerVelocity

MS = 1_000_000


def profile(*settings: str) -> RunProfile:
    return load_profile("mitl", list(settings)).runnable()


def at(north_m: float, east_m: float, course_deg: float, speed_mps: float = 3.0, now_ns: int = 0) -> Any:
    """A step with a vessel at a place, under way along its heading."""
    attitude = Rotation.from_euler("Z", course_deg, degrees=True)
    x, y, z, w = attitude.as_quat().tolist()
    vel = attitude.apply([speed_mps, 0.0, 0.0])
    none = np.zeros((1, 3))
    motion = Kinematics(
        pos_ned_m=np.array([[north_m, east_m, 0.0]]), vel_ned_mps=vel[None], acc_ned_mps2=none,
        quat_ned_frd=np.array([[w, x, y, z]]), rot_ned_frd=attitude.as_matrix()[None], gyro_frd_radps=none,
        angular_acc_frd_radps2=none,
    )  # fmt: skip
    return cast(Any, SimpleNamespace(now_ns=now_ns, motion=motion))


def test_waypoints_are_counted_as_they_are_reached() -> None:
    """The vessel is moved from waypoint to waypoint, with the course of the leg that ends there."""
    control = IdealControl(profile())
    assert (control.progress.mode, control.progress.armed, control.progress.waits_for) == ("IDEAL", True, "")
    assert (control.progress.target, control.progress.reached) == (0, 0)
    north_m, east_m = 12.0, -16.0
    places = [(8.0, 6.0), (80.0, 60.0), (152.0, 114.0), (161.0, 102.0), (85.0, 45.0), (9.0, -12.0)]
    for number, place in enumerate(places):
        course_deg = math.degrees(math.atan2(place[1] - east_m, place[0] - north_m))
        control.exchange(at(north_m, east_m, course_deg))
        assert (control.progress.target, control.progress.reached) == (number, number)
        assert not control.progress.finished
        north_m, east_m = place
        control.exchange(at(north_m, east_m, course_deg))
        last = number == len(places) - 1
        assert (control.progress.target, control.progress.reached) == (None if last else number + 1, number + 1)
        assert control.progress.finished is control.progress.completed is last
    before = control.progress
    control.exchange(at(north_m, east_m, course_deg))
    assert control.command.motors == (0.0, 0.0)
    assert control.progress is before


def test_items_that_are_no_places_are_not_counted() -> None:
    """A change of speed between two waypoints, and one before them."""
    speed = "{command: 178, parameters: [1.0, 1.5, -1.0, 0.0]}"
    items = f"[{speed}, {{command: 16, place_ned_m: [40.0, 0.0]}}, {speed}, {{command: 16, place_ned_m: [80.0, 0.0]}}]"
    start = ["mission.start.north_m=0", "mission.start.east_m=0", "mission.waypoints_ned_m=[]"]
    control = IdealControl(profile(*start, f"mission.items={items}"))
    progress = []
    for north_m in (0.0, 20.0, 40.0, 60.0, 80.0):
        control.exchange(at(north_m, 0.0, 0.0, 1.5))
        progress.append((control.progress.target, control.progress.reached, control.progress.finished))
    assert progress == [(0, 0, False), (0, 0, False), (1, 1, False), (1, 1, False), (None, 2, True)]


@pytest.mark.parametrize(
    ("course_deg", "speed_mps", "faster", "turns"),
    [(0.0, 2.5, True, 0), (-4.0, 2.5, True, 1), (4.0, 2.5, True, -1), (0.0, 4.0, False, 0)],
)
def test_motors_follow_the_course_and_speed_of_the_leg(
    course_deg: float, speed_mps: float, faster: bool, turns: int
) -> None:
    """North along a leg at 3 m/s. With two propellers side by side, a turn to starboard needs more thrust to port."""
    start = ["mission.start.north_m=0", "mission.start.east_m=0", "mission.waypoints_ned_m=[[200.0, 0.0]]"]
    control = IdealControl(profile(*start, "mission.speed_mps=3"))
    for tick in range(60):
        control.exchange(at(20.0, 0.0, course_deg, speed_mps, tick * 20 * MS))
    first, second = control.command.motors
    assert (first + second > 1.5) is faster
    assert np.sign(round(first - second, 6)) == turns


def test_it_waits_for_the_other_vessels_with_neutral_commands() -> None:
    asked = ["B, C", "C", "", "B"]
    control = IdealControl(profile(), lambda: asked.pop(0))
    assert control.progress.waits_for == "B, C"
    control.exchange(at(12.0, -16.0, 100.0, 0.0))
    assert (control.progress.waits_for, control.command.motors) == ("C", (0.0, 0.0))
    control.exchange(at(12.0, -16.0, 100.0, 0.0))
    assert control.progress.waits_for == ""
    assert any(control.command.motors)
    control.exchange(at(12.0, -16.0, 100.0, 0.0))
    assert asked == ["B"], "it does not ask again"


def test_a_turn_rate_and_a_speed_are_steered_from_the_truth() -> None:
    control = OperatedControl(load_profile("mitl", ["driver.kind=ros", "ros.enabled=false"]).runnable())
    control.give(CommandMotor(number=1, command=0.5))
    for turn_rate_radps in (0.2, -0.2):
        control.give(SteerVelocity(speed_mps=2.0, turn_rate_radps=turn_rate_radps))
        for tick in range(20):
            control.exchange(at(0.0, 0.0, 30.0, 1.0, tick * 20 * MS))
        first, second = control.command.motors
        assert first + second > 0.05
        assert (first - second) * turn_rate_radps > 0.0
    control.give(CommandMotor(number=0, command=-0.25))
    control.exchange(at(0.0, 0.0, 30.0, 1.0))
    assert control.command == MotorCommand((-0.25, 0.0), armed=True), "the last of the two kinds of orders counts"


class Schedule:
    """Motors from 0 s on, others from 1 s on, none from 2 s on. The last change is at 2 s, the end at `end_ns`."""

    last_ns = 2000 * MS

    def __init__(self, end_ns: int | None) -> None:
        self.end_ns = end_ns

    def motors_at(self, now_ns: int) -> tuple[float, ...] | None:
        return None if now_ns >= self.last_ns else (0.5, 0.4) if now_ns < 1000 * MS else (-0.1, 0.2)


@pytest.mark.parametrize("end_ms", [None, 3000])
def test_a_script_is_completed_at_its_last_change_and_finished_at_its_end(end_ms: int | None) -> None:
    control = ScheduledControl(cast(Any, Schedule(None if end_ms is None else end_ms * MS)), "SCRIPT", 2)
    assert control.command == MotorCommand((0.5, 0.4), armed=True)
    seen = []
    for now_ms in (0, 999, 1000, 1999, 2000, 2999, 3000, 4000):
        control.exchange(at(0.0, 0.0, 0.0, now_ns=now_ms * MS))
        assert control.command.armed
        assert (control.progress.mode, control.progress.armed, control.progress.waypoints) == ("SCRIPT", True, ())
        seen.append((control.command.motors, control.progress.completed, control.progress.finished))
    first, second, ends = (0.5, 0.4), (-0.1, 0.2), end_ms is not None
    assert seen == [
        (first, False, False), (first, False, False), (second, False, False), (second, False, False),
        (second, True, False), (second, True, False), (second, True, ends), (second, True, ends),
    ]  # fmt: skip


def test_a_schedule_without_motors_at_the_start_begins_neutral() -> None:
    late: Any = SimpleNamespace(motors_at=lambda now_ns: None, end_ns=None, last_ns=0)
    assert ScheduledControl(late, "REPLAY", 3).command == MotorCommand((0.0, 0.0, 0.0), armed=True)


def test_the_control_is_that_of_the_driver() -> None:
    script = profile("driver.kind=script", "driver.script=[{at_s: 0, motors: [0.5, 0.4]}]", "clock.duration_s=9")
    control = direct_control(script)
    assert (control.progress.mode, control.command) == ("SCRIPT", MotorCommand((0.5, 0.4), armed=True))
    control = direct_control(profile())
    assert (control.progress.mode, control.command) == ("IDEAL", MotorCommand((0.0, 0.0), armed=True))
