"""What a companion said, kept small and held against the truth of the same instant."""

from __future__ import annotations

import tracemalloc
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.companion.clouds import PointCloud, cloud_messages
from agent.wire import dialect as mav
from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.geodesy import LocalFrame
from sim_core.world.debris import no_debris
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.core.scores import ObstacleScore
from xitl_cli.run.nodes.findings import FindingsNode

S = 1_000_000_000


class Heard:
    """Stands in for the recorder: the names of what it was told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self.told.append(name)


def findings() -> tuple[FindingsNode, Heard]:
    heard = Heard()
    found = FindingsNode(LocalFrame(-8.8, -63.95, 70.0), ObstacleScore((2.3, 1.6)), physics_rate_hz=400.0)
    context: Any = SimpleNamespace(recorder=SimpleNamespace(perception=heard), clock=SimpleNamespace(step_ns=0))
    found.begin(context)
    return found, heard


def look(found: FindingsNode, step: int) -> None:
    """A vessel that makes 2 m/s to the north and turns by 0.1 rad/s."""
    seconds = step / 400.0
    quat = euler_to_quat(np.array([[0.0, 0.0, 0.1 * seconds]])) * (-1.0) ** (step // 8)  # both signs: the same attitude
    motion = SimpleNamespace(
        pos_ned_m=np.array([[2.0 * seconds, 0.0, 0.0]]), quat_ned_frd=quat, rot_ned_frd=quat_to_matrix(quat)
    )
    world = SimpleNamespace(state=SimpleNamespace(debris=no_debris()))
    found.sense(RunStep(step, step * S // 400, world, motion))  # type: ignore[arg-type]


def odometry(stamp_ns: int, *place: float, q: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> Any:
    numbers = (0.0,) * 6
    return mav.MAVLink_odometry_message(stamp_ns // 1000, 20, 12, *place, q, *numbers, [0.0] * 21, [0.0] * 21)


@pytest.mark.medium
def test_each_pose_has_the_truth_of_its_own_instant() -> None:
    found, heard = findings()
    for step in range(1, 2001):
        look(found, step)
        if step % 40 == 0:
            found.handle(odometry((step - 12) * S // 400, 2.0 * (step - 12) / 400.0, 0.0, 0.0))
    truth, said = found.truth(), found.odometry()
    np.testing.assert_array_equal(truth.stamp_ns, said.stamp_ns)
    np.testing.assert_allclose(truth.pos_m, said.pos_m, atol=1e-9)
    yaw = 2.0 * np.arctan(truth.quat_wxyz[:, 3] / truth.quat_wxyz[:, 0])
    np.testing.assert_allclose(yaw, 0.1e-9 * truth.stamp_ns, atol=1e-9)
    assert heard.told.count("odom_frame") == 1
    assert heard.told.count("odometry") == 50


@pytest.mark.medium
def test_a_pose_that_comes_far_too_late_has_no_truth() -> None:
    found, _ = findings()
    for step in range(1, 400 * 12):
        look(found, step)
    found.handle(odometry(S // 2, 1.0, 0.0, 0.0))
    assert (len(found.odometry().stamp_ns), len(found.truth().stamp_ns)) == (1, 0)
    assert found.report()["odometry"]["ate_rms_m"] is None


@pytest.mark.parametrize("q", [(0.0, 0.0, 0.0, 0.0), (np.nan, 0.0, 0.0, 1.0)])
def test_a_pose_that_is_none_is_left_out(q: tuple[float, ...]) -> None:
    found, heard = findings()
    look(found, 8)
    found.handle(odometry(8 * S // 400, 0.0, 0.0, 0.0, q=q))
    found.handle(odometry(8 * S // 400, np.inf, 0.0, 0.0))
    assert (len(found.odometry().stamp_ns), heard.told) == (0, [])


def test_a_map_comes_together_from_its_parts() -> None:
    found, _ = findings()
    points = np.arange(180, dtype=np.float32).reshape(-1, 3) / 4.0
    for number, kind in enumerate((mav.XITL_CLOUD_KIND_LIDAR_MAP, mav.XITL_CLOUD_KIND_SONAR_MAP)):
        cloud = PointCloud(
            kind, 1, 0, points[: 60 - number], np.zeros(60 - number, np.float32), np.full(60 - number, 7, np.uint8)
        )
        for message in cloud_messages(cloud, (10.0, 10.0, 10.0)):
            found.handle(message)
    places, intensity = found.map_points("lidar")
    np.testing.assert_allclose(places, points, atol=0.0051)
    assert set(intensity.tolist()) == {7}
    assert len(found.map_points("sonar")[0]) == 59


@pytest.mark.medium
def test_the_memory_of_poses_and_maps_does_not_grow() -> None:
    found, heard = findings()
    none = np.zeros(20, np.float32), np.zeros(20, np.uint8)
    messages = [
        message
        for number in range(300)
        for kind in (mav.XITL_CLOUD_KIND_LIDAR_MAP, mav.XITL_CLOUD_KIND_SONAR_MAP)
        for message in (
            *cloud_messages(PointCloud(kind, number, number * S, np.full((20, 3), number, np.float32), *none)),
            odometry(number * S, 1.0, 0.0, 0.0),
        )
    ]

    def traced_bytes(first: int, end: int) -> int:
        for message in messages[first:end]:
            found.handle(message)
        heard.told.clear()
        return tracemalloc.get_traced_memory()[0]

    look(found, 400)
    tracemalloc.start()
    try:
        before = traced_bytes(0, 200)
        after = traced_bytes(200, 1200)
    finally:
        tracemalloc.stop()
    assert after - before < 1000 * 10  # less than a byte for each point
    places, _ = found.map_points("lidar")
    assert places[:, 0].tolist() == np.repeat(np.arange(300), 20).tolist()
    assert len(found.odometry().stamp_ns) == 600


def status(**counts: int) -> Any:
    message = mav.MAVLink_xitl_companion_status_message(
        *(0,) * len(mav.MAVLink_xitl_companion_status_message.fieldnames)
    )
    for name, count in counts.items():
        setattr(message, name, count)
    return message


def test_data_without_a_pose_are_counted_and_reported_unless_the_run_has_just_begun() -> None:
    found, _ = findings()
    found.handle(status(clouds=200, clouds_unplaced=31, clouds_early=31, detections_dropped=9, detections_early=9))
    report = found.report()
    assert (report["companion"]["clouds_unplaced"], report["companion"]["clouds_early"]) == (31, 31)
    assert report["warnings"] == []
    found.handle(status(clouds_unplaced=38, clouds_early=31, detections=90, detections_dropped=14, detections_early=9))
    clouds, detections = found.report()["warnings"]
    assert "no obstacles in 7 clouds" in clouds
    assert "5 of 90 detections" in detections
