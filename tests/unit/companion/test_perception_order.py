"""When clouds and pings are processed, and what the host gets of them: with doubles of odometry and avoidance."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from agent.companion import perception as perceiving
from agent.companion.clouds import CloudReassembler, PointCloud, cloud_messages
from agent.companion.odometry import RegisteredCloud
from agent.companion.perception import MOST_PINGS, MOST_WAITING, UNAIDED_CLOUDS, Perception
from agent.companion.rigid_motion import exponential
from agent.companion.settings import CompanionParameters
from agent.companion.sonar import SonarPing, ping_messages
from agent.wire import dialect as mav

MS = 1_000_000
POSE = exponential(np.array([1.0, -2.0, 0.5, 0.0, 0.0, math.pi / 2.0]))


class Odometry:
    """Places every cloud at POSE, without its first point."""

    def __init__(self, range_m: float, voxel_m: float, motion: Any) -> None:
        self.asked, self.registered = (range_m, voxel_m), list[int]()
        self.unaided, self.poses, self.poses_refused, self.points_refused = 0, 11, 12, 13

    def register(self, stamp_ns: int, points: Any, offset_s: Any) -> RegisteredCloud | None:
        self.registered.append(stamp_ns // MS)
        kept = np.arange(len(points)) > 0
        return RegisteredCloud(stamp_ns + 100 * MS, POSE, np.array([3.0, 0.25, -0.5]), points[kept], kept)

    def pose_at(self, stamp_ns: int) -> Any:
        return None if stamp_ns < 0 else POSE


class Bench:
    """A perception in lockstep whose avoidance only counts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **settings: float) -> None:
        monkeypatch.setattr(perceiving, "LidarOdometry", Odometry)
        parameters = CompanionParameters()
        for name, value in settings.items():
            parameters._set(name, value)
        self.seen: list[int] = []
        self.said: list[str] = []
        self.avoidance = SimpleNamespace(
            vehicle=SimpleNamespace(history=SimpleNamespace(newest_ns=None)),
            add_cloud=lambda stamp_ns, *rest: self.seen.append(stamp_ns // MS),
            tracker=SimpleNamespace(total=21), commands=SimpleNamespace(detours=22, stops=23, manoeuvre=2),
            detector=SimpleNamespace(unplaced=24, early=25),
            cameras=SimpleNamespace(received=26, matched=27, dropped=28, early=29),
        )  # fmt: skip
        self.perception = Perception(parameters, cast(Any, self.avoidance), True, self.said.append)
        self.number = 0

    @property
    def registered(self) -> list[int]:
        odometry: Any = self.perception._odometry
        return cast("list[int]", odometry.registered)

    def knows(self, newest_ms: int | None) -> None:
        self.avoidance.vehicle.history.newest_ns = None if newest_ms is None else newest_ms * MS

    def cloud(self, stamp_ms: int) -> None:
        """Two points; the second one is 125 ms after the stamp."""
        points = np.array([[9.0, 0.0, 0.0], [20.05, 4.05, -1.05]], dtype=np.float32)
        offset_s, shine = np.array([0.0, 0.125], dtype=np.float32), np.array([3, 200], dtype=np.uint8)
        cloud = PointCloud(mav.XITL_CLOUD_KIND_LIDAR, self.number, stamp_ms * MS, points, offset_s, shine)
        self.number += 1
        for message in cloud_messages(cloud):
            assert self.perception.handle(message, 0)

    def ping(self, number: int, stamp_ms: int) -> None:
        level = np.full(200, 15, dtype=np.uint8)
        level[99] = 180
        made = SonarPing(number, stamp_ms * MS, 100, (0.0, 0.0, 0.0), 2.0 * 0.1 / 1500.0, 1500.0, level)
        for message in ping_messages(made):
            assert self.perception.handle(message, 0)

    def process(self, now_ms: int = 0) -> list[Any]:
        return list(self.perception.process(lambda: now_ms * MS))


@pytest.mark.parametrize(
    ("newest_ms", "now_ms", "aided", "is_due"),
    [
        (None, 125, 1.0, True),  # no autopilot
        (125, 125, 1.0, True),
        (124, 275, 1.0, False),
        (124, 276, 1.0, True),  # it waited for 150 ms
        (-375, 125, 1.0, False),
        (-376, 125, 1.0, True),  # too far to extrapolate
        (124, 125, 0.0, True),
    ],
)
def test_a_cloud_waits_for_the_motion_up_to_its_end(
    monkeypatch: pytest.MonkeyPatch, newest_ms: int | None, now_ms: int, aided: float, is_due: bool
) -> None:
    """It ends at 125 ms. The avoidance gets it at once."""
    bench = Bench(monkeypatch, ODO_AIDED=aided)
    bench.knows(newest_ms)
    bench.cloud(0)
    assert bool(bench.process(now_ms)) is is_due
    assert (bench.seen, bench.registered) == ([0], [0] * is_due)
    assert bench.perception.status(0).latency == pytest.approx((now_ms - 125) * 1e-3 * is_due)


def test_of_more_clouds_than_may_wait_the_first_is_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    bench.knows(50)
    for number in range(MOST_WAITING + 1):
        assert bench.registered == []
        bench.cloud(100 * number)
        bench.process(100)
    assert bench.registered == [0]


def test_a_registered_cloud_is_reported_and_mapped_at_its_second_look(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, ODO_RANGE=99.0, ODO_VOXEL=0.5)
    bench.cloud(1000)
    (odometry,) = bench.process(1100)
    assert (odometry.time_usec, odometry.frame_id, odometry.child_frame_id) == (1_100_000, 20, 12)
    assert (odometry.x, odometry.y, odometry.z) == pytest.approx(POSE[:3, 3].tolist())
    assert [abs(part) for part in odometry.q] == pytest.approx([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)], abs=1e-9)
    assert (odometry.vx, odometry.vy, odometry.vz, odometry.rollspeed) == (3.0, 0.25, -0.5, 0.0)
    assert (odometry.estimator_type, math.isnan(odometry.pose_covariance[0]), odometry.quality) == (6, True, 0)
    bench.cloud(1100)
    _, *chunks = bench.process(1200)
    (mapped,) = [cloud for wire in [CloudReassembler()] for chunk in chunks for cloud in wire.handle(chunk)]
    assert (mapped.kind, mapped.number, mapped.stamp_ns) == (mav.XITL_CLOUD_KIND_LIDAR_MAP, 1, 1200 * MS)
    expected = POSE[:3, :3] @ (20.05, 4.05, -1.05) + POSE[:3, 3]
    np.testing.assert_allclose(mapped.points_m, [expected], atol=0.01)
    assert mapped.intensity.tolist() == [200]
    assert cast(Any, bench.perception._odometry).asked == (99.0, 0.5)


def test_a_ping_waits_for_a_cloud_that_began_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    bench.knows(0)
    bench.cloud(0)
    bench.ping(1, -1)
    bench.ping(2, 0)
    assert bench.process(100) == []
    assert bench.perception.status(0).pings == 1, "the first one is older than the cloud, and has no pose"
    bench.knows(125)
    _, *chunks = bench.process(100)
    (mapped,) = [cloud for wire in [CloudReassembler()] for chunk in chunks for cloud in wire.handle(chunk)]
    assert (mapped.kind, mapped.number, mapped.stamp_ns) == (mav.XITL_CLOUD_KIND_SONAR_MAP, 1, 0)
    np.testing.assert_allclose(mapped.points_m, [POSE[:3, :3] @ (0.0, 9.95, 0.0) + POSE[:3, 3]], atol=0.01)
    assert mapped.intensity.tolist() == [180]


def test_of_more_pings_than_may_wait_the_first_is_mapped(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    bench.knows(0)
    bench.cloud(0)
    for number in range(MOST_PINGS + 1):
        assert bench.perception.status(0).pings == 0
        bench.ping(number, 10 + number)
        bench.process(100)
    assert bench.perception.status(0).pings == 1


@pytest.mark.parametrize(("aided", "reports"), [(1.0, 1), (0.0, 0)])
def test_a_run_without_the_autopilots_motion_is_reported_once(
    monkeypatch: pytest.MonkeyPatch, aided: float, reports: int
) -> None:
    bench = Bench(monkeypatch, ODO_AIDED=aided)
    for number, unaided in enumerate((UNAIDED_CLOUDS - 1, UNAIDED_CLOUDS, UNAIDED_CLOUDS)):
        cast(Any, bench.perception._odometry).unaided = unaided
        bench.cloud(100 * number)
        bench.process(100 * number)
        assert len(bench.said) == reports * (number > 0)


def test_the_status_has_the_counts_of_all_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch)
    for number in range(MOST_WAITING + 2):
        bench.cloud(100 * number)
    bench.process(2000)
    bench.ping(3, 500)
    bench.process(2000)
    status = bench.perception.status(7_654_321)
    counts = {name: getattr(status, name) for name in status.fieldnames if name != "latency"}
    assert counts == {
        "time_usec": 7_654, "clouds": 5, "clouds_partial": 0, "chunks_lost": 0, "clouds_dropped": 2, "points": 10,
        "points_refused": 13, "pings": 1, "poses": 11, "poses_refused": 12, "map_points": 2, "obstacles": 21,
        "detours": 22, "stops": 23, "manoeuvre": 2, "clouds_unplaced": 24, "clouds_early": 25, "detections": 26,
        "detections_matched": 27, "detections_dropped": 28, "detections_early": 29,
    }  # fmt: skip
    assert status.latency == pytest.approx(2.0 - 0.525)


def test_without_a_map_only_poses_are_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, MAP_ENABLE=0.0)
    for number in range(3):
        bench.cloud(100 * number)
        bench.ping(number, 100 * number + 50)
        (message,) = bench.process(1000)
        assert message.get_type() == "ODOMETRY"
    assert bench.perception.status(0).map_points == 0
