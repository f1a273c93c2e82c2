"""What the companion knows of its vehicle: poses at instants, the mission, who is heard."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from agent.companion.autopilot_state import AutopilotState, heading_rad
from agent.companion.pose_history import PoseHistory
from agent.companion.rigid_motion import quaternion_from_euler, rotation_matrix
from agent.mavlink.modes import AUTO
from agent.navigation.geodetic import LocalProjection
from agent.wire import dialect as mav

MS = 1_000_000
ORIGIN = LocalProjection(-8.8, -63.95, 0.0)


def sent(message: Any, system: int = 1, component: int = 1) -> Any:
    message.get_header().srcSystem, message.get_header().srcComponent = system, component
    return message


def heartbeat(mode: int = AUTO, armed: bool = True) -> Any:
    base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    return sent(mav.MAVLink_heartbeat_message(11, 3, base, mode, 4, 3))


def test_a_rotation_is_of_its_angles() -> None:
    """Against the product of the three elementary rotations (Fossen 2021, eq 2.31)."""
    roll, pitch, yaw = 0.2, -0.3, 1.1

    def about(axis: int, angle: float) -> np.ndarray:
        turned = np.eye(3)
        a, b = (axis + 1) % 3, (axis + 2) % 3
        turned[a, a] = turned[b, b] = math.cos(angle)
        turned[a, b], turned[b, a] = -math.sin(angle), math.sin(angle)
        return turned

    expected = about(2, yaw) @ about(1, pitch) @ about(0, roll)
    np.testing.assert_allclose(rotation_matrix(quaternion_from_euler(roll, pitch, yaw)), expected, atol=1e-12)


def test_poses_between_samples_lie_on_the_turn() -> None:
    """A boat that turns evenly at 0.5 rad/s and goes 3 m/s: the chord of 0.1 s is off the arc by 4e-5 rad at most."""
    history = PoseHistory()
    for tick in range(11):
        time_s = 0.1 * tick
        history.add_attitude(tick * 100 * MS, quaternion_from_euler(0.0, 0.0, 0.5 * time_s), np.array((0.0, 0.0, 0.5)))
        history.add_position(tick * 100 * MS, np.array((3.0 * time_s, 0.0, 0.1)), np.array((3.0, 0.0, 0.0)))
    for at_ns in (0, 130 * MS, 555 * MS, 1000 * MS, 1200 * MS):
        pose = history.pose_at(at_ns)
        assert pose is not None
        assert heading_rad(pose) == pytest.approx(0.5 * at_ns * 1e-9, abs=1e-4)
        np.testing.assert_allclose(pose.pos_ned_m, (3.0 * at_ns * 1e-9, 0.0, 0.1), atol=1e-9)
    assert history.pose_at(-1) is None
    assert history.pose_at(1600 * MS) is None


def test_what_is_no_number_is_no_pose() -> None:
    history = PoseHistory()
    history.add_attitude(0, np.array((math.nan, 0.0, 0.0, 0.0)), np.zeros(3))
    history.add_position(0, np.array((math.inf, 0.0, 0.0)), np.zeros(3))
    assert history.newest_ns is None


class Autopilot:
    """Holds a mission; every third answer is lost."""

    def __init__(self, items: list[tuple[int, float, float, float]], loses: bool = False) -> None:
        self.items = items
        self.loses = loses
        self.said = 0

    def answer(self, request: Any) -> list[Any]:
        kind = request.get_type()
        self.said += 1
        if self.loses and self.said % 3 == 0:
            return []
        if kind == "MISSION_REQUEST_LIST":
            return [sent(mav.MAVLink_mission_count_message(0, 0, len(self.items), 0))]
        if kind == "MISSION_REQUEST_INT":
            command, north, east, second = self.items[request.seq]
            lat, lon = (round(1e7 * degrees) for degrees in ORIGIN.to_geodetic(north, east))
            item = mav.MAVLink_mission_item_int_message(
                0, 0, request.seq, 6, command, 0, 1, 1.0, second, 0.0, 0.0, lat, lon, 0.0, 0
            )
            return [sent(item)]
        return []


def bring(view: AutopilotState, autopilot: Autopilot, seconds: float = 20.0) -> None:
    for now_ns in range(0, round(seconds * 1e9), 200 * MS):
        waiting = view.poll(now_ns)
        while waiting:
            for answer in autopilot.answer(waiting.pop(0)):
                waiting += view.handle(answer, now_ns)


MISSION = [(16, 0.0, 0.0, 0.0), (178, 0.0, 0.0, 2.5), (16, 50.0, 0.0, 0.0), (16, 50.0, 30.0, 0.0), (20, 0.0, 0.0, 0.0)]


@pytest.mark.parametrize("loses", [False, True])
def test_the_way_is_that_of_the_mission(loses: bool) -> None:
    view = AutopilotState()
    view.handle(heartbeat(), 0)
    lat, lon = (round(1e7 * degrees) for degrees in ORIGIN.to_geodetic(0.0, 0.0))
    view.handle(sent(mav.MAVLink_gps_global_origin_message(lat, lon, 0, 0)), 0)
    view.handle(sent(mav.MAVLink_mission_current_message(3, 4)), 0)
    assert view.path_ahead() is None
    bring(view, Autopilot(MISSION, loses))
    way = view.path_ahead()
    assert way is not None
    assert way.speed_mps == 2.5
    # 1e-7 degrees are 11 mm.
    np.testing.assert_allclose(way.points_ne_m, [(50.0, 0.0), (50.0, 30.0), (0.0, 0.0)], atol=0.02)


def test_the_origin_follows_from_a_place_told_both_ways() -> None:
    view = AutopilotState()
    view.handle(heartbeat(), 0)
    lat, lon = (round(1e7 * degrees) for degrees in ORIGIN.to_geodetic(40.0, -7.0))
    view.handle(sent(mav.MAVLink_attitude_message(100, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0)), 100 * MS)
    view.handle(sent(mav.MAVLink_local_position_ned_message(100, 40.0, -7.0, 0.0, 0.0, 0.0, 0.0)), 100 * MS)
    view.handle(sent(mav.MAVLink_global_position_int_message(100, lat, lon, 0, 0, 0, 0, 0, 0)), 100 * MS)
    view.handle(sent(mav.MAVLink_mission_current_message(3, 4)), 100 * MS)
    bring(view, Autopilot(MISSION))
    way = view.path_ahead()
    assert way is not None
    np.testing.assert_allclose(way.points_ne_m[1], (50.0, 30.0), atol=0.05)


def test_only_its_own_autopilot_counts() -> None:
    view = AutopilotState()
    view.handle(sent(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255, 190), 0)
    view.handle(sent(mav.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), 1, 191), 0)
    assert view.target is None
    view.handle(heartbeat(), 0)
    assert view.target == (1, 1)
    view.handle(sent(mav.MAVLink_heartbeat_message(11, 3, 0, 4, 4, 3), 2, 1), 0)
    assert view.mode == AUTO
    assert view.armed


def test_its_clock_is_that_of_the_quickest_message() -> None:
    """Stamps 5 s behind this clock, delays of 3 to 40 ms: what is known is the pose 3 ms late, wherever it came."""
    view = AutopilotState()
    view.handle(heartbeat(), 0)
    rng = np.random.default_rng(3)
    for tick in range(60):
        delay_ns = 3 * MS if tick == 10 else round(rng.uniform(4, 40) * MS)
        now_ns = 5_000_000_000 + tick * 50 * MS + delay_ns
        view.handle(sent(mav.MAVLink_attitude_message(tick * 50, 0, 0, 0.1 * tick * 0.05, 0, 0, 0.1)), now_ns)
        view.handle(sent(mav.MAVLink_local_position_ned_message(tick * 50, 3.0 * tick * 0.05, 0, 0, 3, 0, 0)), now_ns)
    pose = view.pose_at(5_000_000_000 + 2_500 * MS)
    assert pose is not None
    assert pose.pos_ned_m[0] == pytest.approx(3.0 * (2.5 - 0.003), abs=1e-6)


def test_an_autopilot_that_starts_again_is_followed() -> None:
    view = AutopilotState()
    view.handle(heartbeat(), 0)
    for boot_ms, now_s in ((60_000, 60.0), (60_100, 60.1), (500, 65.0), (600, 65.1)):
        view.handle(sent(mav.MAVLink_attitude_message(boot_ms, 0, 0, 0.0, 0, 0, 0)), round(now_s * 1e9))
        view.handle(sent(mav.MAVLink_local_position_ned_message(boot_ms, now_s, 0, 0, 0, 0, 0)), round(now_s * 1e9))
    pose = view.pose_at(65_100 * MS)
    assert pose is not None
    assert pose.pos_ned_m[0] == pytest.approx(65.1)
