"""Clouds, echoes, map points and poses of a recording of xitl, in axes forward, right, down."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agent.companion.sonar import SonarPing
from tests.unit.logs.made_log import MadeLog, MadeTable
from xitl_cli.errors import UserError
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.mapping.clouds import at, clouds, map_points, mounting, online, pings, truth
from xitl_cli.record.topics import LIDAR_POINT, MAP_POINT, MAP_SOURCES

S = 1_000_000_000
EAST = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]  # turned by 90° about the third axis


def frames(name: str, kind: np.dtype, *points: list[tuple], stride: int | None = None, cut: int = 0) -> MadeTable:
    data = np.empty(len(points), dtype=object)
    for number, each in enumerate(points):
        packed = np.array(each, dtype=kind).tobytes()
        data[number] = packed[: len(packed) - cut]
    strides = np.full(len(points), stride or kind.itemsize)
    return MadeTable(name, 7 + S * np.arange(len(points)), {"point_stride": strides, "data": data})


def test_frames_of_the_lidar() -> None:
    one, two = [(1.0, 2.0, 3.0, 0.25, 9), (4.0, -5.0, -6.0, 0.5, 255)], [(0.0, 0.0, 1.0, 0.0, 0)]
    first, empty, last = clouds(MadeLog(frames("/lidar/points", LIDAR_POINT, one, [], two)))
    np.testing.assert_array_equal(first.points_m, [[1.0, -2.0, -3.0], [4.0, 5.0, 6.0]])
    np.testing.assert_array_equal(first.offset_s, [0.25, 0.5])
    assert first.intensity.tolist() == [9, 255]
    assert [(each.number, each.stamp_ns, len(each.points_m)) for each in (first, empty, last)] == [
        (0, 7, 2), (1, S + 7, 0), (2, 2 * S + 7, 1),
    ]  # fmt: skip


def test_more_frames_than_are_read_at_once() -> None:
    many = frames("/lidar/points", LIDAR_POINT, *([(float(row), 0.0, 0.0, 0.0, 0)] for row in range(1030)))
    found = list(clouds(MadeLog(many)))
    assert [each.points_m[0, 0] for each in found] == list(range(1030))
    assert [each.stamp_ns for each in found] == many.stamp_ns.tolist()


@pytest.mark.parametrize(("stride", "cut"), [(16, 0), (18, 0), (None, 1)])
def test_points_of_another_layout_are_refused(stride: int | None, cut: int) -> None:
    table = frames("/lidar/points", LIDAR_POINT, [(1.0, 2.0, 3.0, 0.25, 9)], stride=stride, cut=cut)
    with pytest.raises(UserError, match="/lidar/points has not the format of xitl"):
        list(clouds(MadeLog(table)))


def test_points_of_the_map_by_their_source_and_time() -> None:
    assert MAP_SOURCES == ("lidar", "sonar")
    table = frames(
        "/companion/map", MAP_POINT,
        [(1.0, 2.0, 3.0, 9, 0), (4.0, 5.0, 6.0, 9, 1), (7.0, 8.0, 9.0, 9, 0)], [], [(0.0, 0.0, 1.0, 0, 1)],
    )  # fmt: skip
    found = map_points(MadeLog(table))
    np.testing.assert_array_equal(found["lidar"].points_odom_m, [[1.0, -2.0, -3.0], [7.0, -8.0, -9.0]])
    np.testing.assert_array_equal(found["lidar"].seen_ns, [7, 7])
    np.testing.assert_array_equal(found["sonar"].points_odom_m, [[4.0, -5.0, -6.0], [0.0, 0.0, -1.0]])
    np.testing.assert_array_equal(found["sonar"].seen_ns, [7, 2 * S + 7])
    none = map_points(MadeLog())
    assert [none[source].points_odom_m.shape for source in MAP_SOURCES] == [(0, 3), (0, 3)]


def test_echoes_of_the_sonar() -> None:
    """Sequences are bytes, or numbers padded with NaN, as the reader of the file gives them."""
    columns = {
        "number": [3, 4], "angle_grad": [100, 399], "position_frd_m": [[1.0, 0.5, 2.0], [1.0, 0.5, 2.5]],
        "sample_period_s": [1e-4, 2e-4], "sound_speed_mps": [1480.0, 1500.0],
    }  # fmt: skip
    numbers = MadeTable("/sonar/ping", [5, 9], columns | {"intensity": [[1.0, 200.0, np.nan], [0.0, 7.0, 255.0]]})
    raw = np.empty(2, dtype=object)
    raw[:] = [bytes([1, 200]), bytes([0, 7, 255])]
    for table in (numbers, MadeTable("/sonar/ping", [5, 9], columns | {"intensity": raw})):
        found = pings(MadeLog(table))
        assert [each.intensity.tolist() for each in found] == [[1, 200], [0, 7, 255]]
        assert all(isinstance(each, SonarPing) for each in found)
        assert [tuple(each)[:6] for each in found] == [
            (3, 5, 100, (1.0, 0.5, 2.0), 1e-4, 1480.0),
            (4, 9, 399, (1.0, 0.5, 2.5), 2e-4, 1500.0),
        ]
    assert pings(MadeLog()) == []


def odometry(at_ns: list[int], places: list[list[float]], quats: list[list[float]]) -> MadeTable:
    columns = {f"pose.pose.position.{axis}": np.array(places)[:, number] for number, axis in enumerate("xyz")}
    columns |= {f"pose.pose.orientation.{axis}": np.array(quats)[:, number] for number, axis in enumerate("wxyz")}
    return MadeTable("/companion/odometry", at_ns, columns)


def test_poses_of_the_odometry_are_turned_into_frd() -> None:
    log = MadeLog(odometry([1, 2], [[1.0, 2.0, 3.0], [4.0, -5.0, 6.0]], [[2.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5]]))
    found = online(log)
    assert found is not None
    np.testing.assert_array_equal(found.stamp_ns, [1, 2])
    np.testing.assert_array_equal(found.pos_m, [[1.0, -2.0, -3.0], [4.0, 5.0, -6.0]])
    # half a turn about x on both sides: the components y and z change sign; and of length one
    np.testing.assert_allclose(found.quat_wxyz, [[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, -0.5, -0.5]])
    assert online(MadeLog()) is None
    assert truth(MadeLog()) is None


def test_poses_that_are_no_poses_or_go_back_are_left_out() -> None:
    one = [1.0, 0.0, 0.0, 0.0]
    table = MadeTable(
        "/truth/state", [0, 10, 20, 20, 15, 30, 40, 50],
        {
            "position_ned_m": [[float(row), 0.0, np.nan if row == 1 else 0.0] for row in range(8)],
            "quaternion_ned_frd": [one, one, one, EAST, one, [0.3, 0.0, 0.4, 0.0], [0.3, 0.0, 0.41, 0.0], EAST],
        },
    )  # fmt: skip
    found = truth(MadeLog(table))
    assert found is not None
    np.testing.assert_array_equal(found.stamp_ns, [0, 20, 40, 50])
    np.testing.assert_array_equal(found.pos_m[:, 0], [0.0, 2.0, 6.0, 7.0])
    np.testing.assert_allclose(np.linalg.norm(found.quat_wxyz, axis=1), 1.0)
    alone = MadeTable("/truth/state", [3], {"position_ned_m": [[0.0, 0.0, 0.0]], "quaternion_ned_frd": [one]})
    assert truth(MadeLog(alone)) is None
    none = MadeTable("/truth/state", [], {"position_ned_m": np.empty((0, 3)), "quaternion_ned_frd": np.empty((0, 4))})
    assert truth(MadeLog(none)) is None


def test_a_pose_between_two_others() -> None:
    quats = np.array([[1.0, 0.0, 0.0, 0.0], EAST, -np.array(EAST)])
    whole = Trajectory(np.array([100, 200, 400]), np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 4.0], [1.0, 2.0, 8.0]]), quats)
    found = at(whole, np.array([99, 100, 150, 200, 350, 400, 401]))
    np.testing.assert_array_equal(found.stamp_ns, [100, 150, 200, 350, 400])
    np.testing.assert_allclose(
        found.pos_m, [[0.0, 0.0, 0.0], [0.5, 1.0, 2.0], [1.0, 2.0, 4.0], [1.0, 2.0, 7.0], [1.0, 2.0, 8.0]]
    )
    # Half of the turn at half of the time; the same attitude with the other sign is no turn.
    half = [np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)]
    expected = np.array([quats[0], half, EAST, EAST, EAST])
    np.testing.assert_allclose(np.abs(np.sum(found.quat_wxyz * expected, axis=1)), 1.0)


def transforms(name: str, *links: tuple[str, str, list[float], list[float]]) -> MadeTable:
    columns: dict[str, Any] = {}
    for number, (parent, child, place_m, quat) in enumerate(links):
        start = f"transforms[{number}]"
        columns |= {f"{start}.header.frame_id": [parent], f"{start}.child_frame_id": [child]}
        columns |= {f"{start}.transform.translation.{axis}": [place_m[i]] for i, axis in enumerate("xyz")}
        columns |= {f"{start}.transform.rotation.{axis}": [quat[i]] for i, axis in enumerate("wxyz")}
    return MadeTable(name, [0], columns)


def test_where_a_frame_is_on_the_vessel() -> None:
    none = [1.0, 0.0, 0.0, 0.0]
    log = MadeLog(
        transforms(
            "/boat/tf_static", ("boat/base_link", "mast", [1.0, 0.0, 2.0], EAST),
            ("mast", "lidar", [0.5, 0.0, 0.0], EAST),
            ("map", "buoy", [9.0, 9.0, 9.0], none), ("a", "b", [1.0, 0.0, 0.0], none),
            ("b", "a", [1.0, 0.0, 0.0], none),
        ),
        transforms("/tf", ("base_link", "moving", [7.0, 0.0, 0.0], none)),
    )  # fmt: skip
    turn, shift_m = mounting(log, "lidar")
    # Half a metre before the mast, which looks to port, is half a metre to port of it; two quarters are half a turn.
    np.testing.assert_allclose(turn, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    np.testing.assert_allclose(shift_m, [1.0, 0.5, 2.0])
    for frame in ("base_link", "boat/base_footprint", "buoy", "moving", "a", "unknown"):
        turn, shift_m = mounting(log, frame)
        np.testing.assert_array_equal(turn, np.eye(3))
        np.testing.assert_array_equal(shift_m, np.zeros(3))
