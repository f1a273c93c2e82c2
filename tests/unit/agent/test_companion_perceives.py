"""The companion as a node that is given clouds: what it tells the host, and what it counts."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import pytest
from node_host import LOCKSTEP, START, STOP, Host, of, texts

from agent.companion import obstacle_avoidance
from agent.companion.clouds import CloudReassembler, PointCloud, cloud_messages
from agent.companion.obstacle_avoidance import ObstacleAvoidance
from agent.companion.role import CompanionRole
from agent.wire import dialect as mav

pytest.importorskip("kiss_icp", reason="KISS-ICP is not installed")

CLOUD_NS = 100_000_000


def walls(number: int, forward_m: float) -> PointCloud:
    """2000 points of two walls to the sides and one ahead, from a vessel that has gone so far."""
    rng = np.random.default_rng(number)
    along, up = rng.uniform(2.0, 40.0, 900), rng.uniform(-3.0, 0.5, 900)
    sides = [np.stack([along - forward_m % 1.0, np.full(900, side), up], axis=1) for side in (-12.0, 9.0)]
    end = np.stack([np.full(200, 45.0 - forward_m), rng.uniform(-12, 9, 200), rng.uniform(-3, 0.5, 200)], axis=1)
    points = np.concatenate([*sides, end]).astype(np.float32)
    offset = np.sort(rng.uniform(0.0, 0.0999, len(points))).astype(np.float32)
    intensity = np.full(len(points), 50, dtype=np.uint8)
    return PointCloud(mav.XITL_CLOUD_KIND_LIDAR, number, number * CLOUD_NS, points, offset, intensity)


class Companion:
    """In lockstep, a tick of 20 ms at a time."""

    def __init__(self) -> None:
        self.host = Host(CompanionRole())
        self.host.run(START, LOCKSTEP)
        self.tick = 0
        self.said: list[Any] = []

    def clouds(self, count: int, keep: Any = lambda number, chunk: True) -> None:
        """So many clouds of 0.1 s, of which the chunks that `keep` says arrive."""
        for number in range(count):
            for message in cloud_messages(walls(number, 0.05 * number)):
                if keep(number, message.chunk):
                    self.said += self.host.send(message)
            self.ticks(5)

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick += 1
            self.said += self.host.send(mav.MAVLink_xitl_tick_message(self.tick * 20_000, self.tick))

    def end(self) -> Any:
        self.ticks(60)
        return of("XITL_COMPANION_STATUS", [*self.said, *self.host.run(STOP)])[-1]


@pytest.mark.medium
def test_clouds_become_poses_and_a_map() -> None:
    companion = Companion()
    companion.clouds(10)
    status = companion.end()
    assert (status.clouds, status.clouds_partial, status.chunks_lost, status.poses) == (10, 0, 0, 10)
    poses = of("ODOMETRY", companion.said)
    assert [pose.time_usec for pose in poses] == sorted(pose.time_usec for pose in poses)
    assert (poses[0].frame_id, poses[0].child_frame_id) == (20, 12)
    mapped = [cloud for message in of("XITL_CLOUD", companion.said) for cloud in CloudReassembler().handle(message)]
    assert {cloud.kind for cloud in mapped} <= {mav.XITL_CLOUD_KIND_LIDAR_MAP}
    # 18 000 points fall on 26 600 cells of the side walls; Poisson says that 15 % of these are seen twice.
    assert 1_000 < status.map_points < 0.15 * 26_600 + 1_000


@pytest.mark.medium
def test_each_tick_is_answered_with_itself() -> None:
    companion = Companion()
    companion.clouds(2)
    answered = [message.tick for message in of("XITL_TICK", companion.said)]
    assert answered == list(range(1, 11))


@pytest.mark.medium
def test_a_lost_chunk_costs_its_points_and_is_counted() -> None:
    whole, partly = Companion(), Companion()
    whole.clouds(4)
    partly.clouds(4, keep=lambda number, chunk: (number, chunk) != (1, 7))
    status = partly.end()
    assert (status.clouds, status.clouds_partial, status.chunks_lost) == (3, 1, 1)
    assert status.points == whole.end().points - 25
    assert status.poses == 4


@pytest.mark.medium
def test_a_lost_cloud_is_a_longer_step() -> None:
    companion = Companion()
    companion.clouds(6, keep=lambda number, chunk: number != 3)
    status = companion.end()
    assert (status.clouds, status.poses, status.poses_refused) == (5, 5, 0)


@pytest.mark.medium
def test_clouds_of_damage_do_no_harm() -> None:
    companion = Companion()
    companion.clouds(3)
    rng = np.random.default_rng(1)
    for number in range(200):
        points = bytes(rng.integers(0, 256, 225, dtype=np.uint8))
        origin = tuple(float(value) for value in rng.choice([0.0, np.nan, np.inf, 1e9], 3))
        fields = (origin, number, int(rng.integers(0, 9)), int(rng.integers(0, 9)), 0, int(rng.integers(0, 256)))
        companion.said += companion.host.send(
            mav.MAVLink_xitl_cloud_message(int(rng.integers(0, 1 << 40)), *fields, points)
        )
        companion.ticks(1)
    assert companion.end().poses >= 3


def test_without_odometry_it_says_so_and_looks_out_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "kiss_icp.config", None)
    companion = Companion()
    companion.clouds(2)
    said = "".join(texts(companion.said))
    assert said.startswith("the odometry needs KISS-ICP")
    assert said.count("KISS-ICP") == 1
    assert (companion.end().clouds, companion.end().poses) == (2, 0)


def test_without_numpy_it_is_there_and_says_why_it_is_blind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "agent.companion.perception", None)
    companion = Companion()
    companion.clouds(2)
    said = "".join(texts(companion.said))
    assert said.startswith("No perception: ")
    assert said.endswith("pip install 'numpy>=1.21' kiss-icp")
    assert len(of("XITL_TICK", companion.said)) == 10


def test_the_settings_of_the_first_detection_are_those_of_the_avoidance(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[dict[str, Any]] = []

    class Avoidance(ObstacleAvoidance):
        def __init__(self, **settings: Any) -> None:
            given.append(settings)
            super().__init__(**settings)

    monkeypatch.setattr(obstacle_avoidance, "ObstacleAvoidance", Avoidance)
    host = Host(CompanionRole())
    host.run(START)
    values = {
        "AVD_MARGIN": 4.0, "AVD_HORIZON": 9.0, "WP_SPEED": 2.0, "HULL_LENGTH": 7.0, "HULL_WIDTH": 3.0,
        "HULL_WATER": 0.25, "AVD_RANGE": 80.0, "AVD_ENABLE": 0.0, "AVD_VESSELS": 1.0,
        "LIDAR_YAW": 90.0, "ODO_ENABLE": 0.0,
    }  # fmt: skip
    for name, value in values.items():
        host.send(mav.MAVLink_param_set_message(1, 1, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32))
    host.send(mav.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))
    assert given == [], "it begins with the first data of a sensor"
    for _ in range(2):
        host.send(mav.MAVLink_xitl_detection_message(0, (0.0, 0.0, 0.0), 0.1, 0.1, 0.1, 0.2, 0.9, b"person"))
    (settings,) = given
    assert settings == {
        "margin_m": 4.0, "horizon_s": 9.0, "speed_mps": 2.0, "length_m": 7.0, "width_m": 3.0, "waterline_m": 0.25,
        "range_m": 80.0, "avoids": False, "vessels": True, "view_yaw_rad": pytest.approx(math.pi / 2),
    }  # fmt: skip
    (status,) = of("XITL_COMPANION_STATUS", host.live(0.7))[:1]
    assert status.detections == 2
