"""What obstacle avoidance reports of its tracks, and when it looks and plans: around a vessel that the test places."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from agent.companion import obstacle_avoidance
from agent.companion.obstacle_avoidance import ObstacleAvoidance
from agent.companion.pose_history import VehiclePose
from agent.companion.settings import TUNED
from agent.wire import dialect as mav

S = 1_000_000_000
EAST = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Turns body FRD into NED, with the bow to the east."""


class Track:
    """A box that drifts. state: north and east, and their speeds at 0 s."""

    def __init__(self, *state: float, length_m: float = 4.0, width_m: float = 2.0, heading_rad: float = 0.0) -> None:
        self.state = np.array(state)
        self.length_m, self.width_m, self.height_m, self.heading_rad = length_m, width_m, 1.0, heading_rad
        self.number, self.points, self.hits, self.seen_ns, self.hidden_m = 7, 70_000, 5, 3_000_999, 0.0

    def position_at(self, now_ns: int) -> np.ndarray:
        return np.asarray(self.state[:2] + self.state[2:] * now_ns * 1e-9)


def heads_east(*tracks: Track, **keys: Any) -> ObstacleAvoidance:
    """At 100 N 200 E, 0.3 m below its origin's height, at 2 m/s, with these tracks."""
    pose = VehiclePose(np.array([100.0, 200.0, 0.3]), EAST, np.array([0.0, 2.0, 0.0]))
    made = ObstacleAvoidance(**keys)
    structure = SimpleNamespace(within=lambda pos, range_m: np.empty((0, 2)))
    made.tracker = cast(Any, SimpleNamespace(confirmed=list(tracks), structure=structure, update=None))
    made.vehicle = cast(
        Any,
        SimpleNamespace(
            pose_at=lambda now_ns: pose, history=SimpleNamespace(newest_ns=0), poll=lambda now_ns: ["poll"],
            yaw_rate_radps=0.1,
        ),
    )  # fmt: skip
    made.cameras = cast(
        Any, SimpleNamespace(update=lambda *given: None, class_of=lambda number: ("b\u00fcoy" + 20 * "x", 0.75))
    )
    return made


def test_a_track_is_reported_by_its_nearest_point_to_the_bow() -> None:
    """A box of 4 m by 2 m, its length to the north, 20 m east and 5 m north of the vessel at 1 s."""
    track = Track(105.0, 219.0, 0.0, 1.0)
    made = heads_east(track, length_m=2.0)
    (message,) = made.obstacle_messages(S)
    assert list(message.pos_ned) == pytest.approx([105.0, 220.0, 0.3 + 0.15 - 0.5])
    assert list(message.vel_ned) == [0.0, 1.0, 0.0]
    assert list(message.size) == [4.0, 2.0, 1.0]
    # The bow is at 201 E. The nearest of the points of the box is its southern corner: 3 m north, 18 m east.
    assert message.range == pytest.approx(math.hypot(3.0, 18.0))
    assert message.closing_speed == pytest.approx(1.0 * 18.0 / math.hypot(3.0, 18.0))  # 2 m/s after 1 m/s
    assert message.bearing == pytest.approx(-math.atan2(5.0, 20.0))  # to port
    assert (message.id, message.points, message.hits) == (7, 65535, 5)
    assert (message.time_usec, message.label, message.label_share) == (3000, "b?oy" + 12 * "x", 0.75)


def test_a_track_dead_ahead_closes_with_the_speed_of_the_vessel() -> None:
    made = heads_east(Track(100.0, 220.0, 0.0, 0.0), length_m=2.0)
    (message,) = made.obstacle_messages(0)
    assert message.range == pytest.approx(18.0)
    assert message.closing_speed == pytest.approx(2.0)
    assert message.bearing == pytest.approx(0.0)


def test_without_a_pose_nothing_is_reported() -> None:
    made = heads_east(Track(100.0, 220.0, 0.0, 0.0))
    made.vehicle.pose_at = lambda now_ns: None  # type: ignore[method-assign, assignment, return-value]
    assert made.obstacle_messages(0) == []
    made._cloud_ns = 0
    assert made.proximity_messages(0) == []


@pytest.mark.parametrize(
    ("age_ns", "looks"), [(None, False), (TUNED.look_stale_ns, True), (TUNED.look_stale_ns + 1, False)]
)
def test_without_new_clouds_it_is_blind(age_ns: int | None, looks: bool) -> None:
    made = heads_east(Track(100.0, 220.0, 0.0, 0.0), length_m=2.0)
    planned: list[Any] = []
    made.commands = cast(Any, SimpleNamespace(update=lambda *given: (planned.append(given), ["course"])[1]))
    now_ns = 10 * S
    made._cloud_ns = None if age_ns is None else now_ns - age_ns
    assert made.plan(now_ns) == (["poll", "course"] if looks else ["poll"])
    near = made.proximity_messages(now_ns)
    assert [message.get_msgId() for message in near] == (
        [mav.MAVLINK_MSG_ID_OBSTACLE_DISTANCE, mav.MAVLINK_MSG_ID_DISTANCE_SENSOR] if looks else []
    )
    if looks:
        assert near[1].current_distance == 1800  # from the bow to the near side of the box
        assert near[0].distances[0] == 1900  # from the body's origin


def test_one_that_does_not_avoid_only_detects() -> None:
    made = heads_east(avoids=False)
    made._cloud_ns = S
    assert made.plan(S) == ["poll"]


class Detector:
    """Stands in for the detector. added: stamps of the clouds that it got."""

    frames: Any = None
    water_reach_m = 40.0
    waterline_m = 0.15

    def __init__(self, accepts: bool = True) -> None:
        self.added: list[int] = []
        self._accepts = accepts

    def add_cloud(self, history: Any, stamp_ns: int, points: Any, offset_s: Any, intensity: Any) -> bool:
        self.added.append(stamp_ns)
        return self._accepts


def looking(monkeypatch: pytest.MonkeyPatch, accepts: bool = True) -> tuple[ObstacleAvoidance, Detector, list[int]]:
    """An avoidance, its detector, and the stamps of the looks for obstacles."""
    made = heads_east(view_yaw_rad=0.5)
    detector = Detector(accepts)
    made.detector = cast(Any, detector)
    made._current = cast(Any, SimpleNamespace(update=lambda *given: None, current_ne_mps=np.zeros(2)))
    looks: list[int] = []

    def update(stamp_ns: int, clusters: Any, pos: Any, view_rad: float, reach_m: float, drift: Any) -> None:
        assert view_rad == pytest.approx(math.pi / 2 + 0.5)
        assert reach_m == 40.0
        looks.append(stamp_ns)

    def find(frames: Any, pos: Any, reach_m: float) -> list[Any]:
        assert reach_m == pytest.approx(TUNED.doubtful_share * 40.0)
        return []

    made.tracker.update = update  # type: ignore[method-assign, assignment]
    monkeypatch.setattr(obstacle_avoidance, "find_clusters", find)
    return made, detector, looks


def add(made: ObstacleAvoidance, stamp_ns: int, last_s: float = 0.05) -> None:
    points = np.zeros((2, 3), np.float32)
    made.add_cloud(stamp_ns, points, np.array([0.0, last_s], np.float32), np.zeros(2, np.uint8))


def test_a_cloud_waits_until_the_pose_of_its_last_point_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    made, detector, _ = looking(monkeypatch)
    made.vehicle.history.newest_ns = S + 40_000_000  # type: ignore[misc]
    add(made, S)
    assert detector.added == []
    made.vehicle.history.newest_ns = S + 250_000_000  # type: ignore[misc]
    add(made, S + 100_000_000)
    assert detector.added == [S, S + 100_000_000]
    add(made, S + 300_000_000)
    assert len(detector.added) == 2


def test_more_clouds_than_may_wait_are_used_without_a_later_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    made, detector, _ = looking(monkeypatch)
    made.vehicle.history.newest_ns = None  # type: ignore[misc]
    for number in range(TUNED.look_waiting_clouds + 1):
        assert detector.added == []
        add(made, number)
    assert detector.added == [0]


def test_obstacles_are_looked_for_at_their_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    made, _, looks = looking(monkeypatch)
    made.vehicle.history.newest_ns = 100 * S  # type: ignore[misc]
    stamps = [TUNED.look_ns, 2 * TUNED.look_ns - 1, 2 * TUNED.look_ns, 3 * TUNED.look_ns + 5, S // 1000]
    for stamp_ns in stamps:
        add(made, stamp_ns)
    assert looks == [stamps[0], stamps[2], stamps[3], stamps[4]]  # after a step back of the clock at once


def test_a_cloud_that_the_detector_refuses_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    made, _, looks = looking(monkeypatch, accepts=False)
    made.vehicle.history.newest_ns = 100 * S  # type: ignore[misc]
    add(made, S)
    assert (looks, made._is_blind(S)) == ([], True)
