"""What the rebuilding of a map hands to the odometry and takes from it, with doubles of both ends."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from agent.companion.clouds import PointCloud
from agent.companion.odometry import RegisteredCloud
from agent.wire import dialect
from xitl_cli.mapping import rebuild as rebuilding
from xitl_cli.mapping.rebuild import rebuild, trajectory_of

MS = 1_000_000
LOG: Any = SimpleNamespace(path="made.mcap")


def cloud(number: int, points: list[tuple[float, float, float]], last_s: float = 0.1) -> PointCloud:
    offset_s = np.linspace(0.0, last_s, len(points)).astype(np.float32)
    xyz, shine = np.array(points, dtype=np.float32), np.arange(10, 10 + len(points), dtype=np.uint8)
    return PointCloud(dialect.XITL_CLOUD_KIND_LIDAR, number, number * 100 * MS, xyz, offset_s, shine)


def shifted(north_m: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = north_m
    return pose


class Odometry:
    """Goes 10 m north with each cloud, and refuses those of `refuses`. It drops each first point.

    Poses are known from 150 ms on.
    """

    made: list[Any]
    refuses: tuple[int, ...] = ()
    poses_refused, points_refused = 4, 5

    def __init__(self, range_m: float, voxel_m: float, motion: Any) -> None:
        self.made.append((range_m, voxel_m))

    def register(self, stamp_ns: int, points: Any, offset_s: Any) -> RegisteredCloud | None:
        number = stamp_ns // (100 * MS)
        if number in self.refuses:
            return None
        kept = np.arange(len(points)) > 0
        return RegisteredCloud(stamp_ns, shifted(10.0 * number), np.zeros(3), points[kept], kept)

    def pose_at(self, stamp_ns: int) -> np.ndarray | None:
        return shifted(stamp_ns / MS) if stamp_ns >= 150 * MS else None


def rebuilt(
    monkeypatch: pytest.MonkeyPatch, clouds: list[PointCloud], pings_ms: tuple[int, ...] = (), profile: Any = None,
    refuses: tuple[int, ...] = (),
) -> tuple[Any, list[Any]]:  # fmt: skip
    """The result, and the arguments of the odometry."""
    made: list[Any] = []
    monkeypatch.setattr(rebuilding, "LidarOdometry", type("Made", (Odometry,), {"made": made, "refuses": refuses}))
    monkeypatch.setattr(rebuilding, "clouds", lambda log: iter(clouds))
    monkeypatch.setattr(rebuilding, "read_autopilot_messages", lambda log: iter(()))
    monkeypatch.setattr(rebuilding, "pings", lambda log: [SimpleNamespace(stamp_ns=at_ms * MS) for at_ms in pings_ms])
    monkeypatch.setattr(
        rebuilding,
        "echo_points",
        lambda ping: (np.array([[0.0, 5.0, 0.0]], dtype=np.float32), np.array([99], np.uint8)),
    )
    return rebuild(LOG, profile), made


def test_points_of_two_clouds_and_echoes_are_mapped_with_their_source_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A cell of the lidar counts from its second cloud on. The pole stands at 30 m; the first point is dropped."""
    clouds = [cloud(number, [(1.0, 0.0, 0.0), (30.05 - 10.0 * number, 0.05, 0.05)]) for number in range(3)]
    found, _ = rebuilt(monkeypatch, clouds, pings_ms=(120, 150, 230, 301))
    assert (found.clouds, found.pings, found.poses_refused, found.points_refused) == (3, 3, 4, 5)
    np.testing.assert_allclose(
        found.points_odom_m, [(30.05, 0.05, 0.05), (150.0, 5.0, 0.0), (230.0, 5.0, 0.0)], atol=0.02
    )
    assert found.intensity.tolist() == [11, 99, 99]
    assert found.source.tolist() == [0, 1, 1]
    assert found.seen_ns.tolist() == [100 * MS]
    assert found.trajectory.stamp_ns.tolist() == [0, 100 * MS, 200 * MS]
    np.testing.assert_array_equal(found.trajectory.pos_m, [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (20.0, 0.0, 0.0)])
    np.testing.assert_allclose(np.abs(found.trajectory.quat_wxyz), [(1.0, 0.0, 0.0, 0.0)] * 3)


def test_a_refused_cloud_is_no_pose_and_no_points(monkeypatch: pytest.MonkeyPatch) -> None:
    clouds = [cloud(number, [(1.0, 0.0, 0.0), (30.05 - 10.0 * number, 0.05, 0.05)]) for number in range(3)]
    found, _ = rebuilt(monkeypatch, clouds, refuses=(1,))
    assert (found.clouds, found.trajectory.stamp_ns.tolist()) == (3, [0, 200 * MS])
    assert found.seen_ns.tolist() == [200 * MS]
    none, _ = rebuilt(monkeypatch, clouds, refuses=(0, 1, 2))
    assert (len(none.trajectory.stamp_ns), none.points_odom_m.shape, len(none.source)) == (0, (0, 3), 0)
    nothing = trajectory_of([])
    assert (nothing.stamp_ns.shape, nothing.pos_m.shape, nothing.quat_wxyz.shape) == ((0,), (0, 3), (0, 4))


def test_the_settings_are_those_of_the_runs_companion(monkeypatch: pytest.MonkeyPatch) -> None:
    parameters = {"ODO_RANGE": 80.0, "MAP_RANGE": 20.0}
    profile = SimpleNamespace(
        companion=SimpleNamespace(parameters=parameters), clock=SimpleNamespace(mode="lockstep", exchange_rate_hz=50.0)
    )
    clouds = [cloud(number, [(1.0, 0.0, 0.0), (30.05 - 10.0 * number, 0.05, 0.05)]) for number in range(4)]
    for given, range_m, seen_ms in (
        (None, 150.0, 100),
        (SimpleNamespace(companion=None, clock=profile.clock), 150.0, 100),
        (profile, 80.0, 300),  # the first two clouds saw it at more than 20 m
    ):
        found, made = rebuilt(monkeypatch, clouds, profile=given)
        assert made == [(range_m, 1.0)]
        assert found.seen_ns.tolist() == [seen_ms * MS]


class View:
    """An autopilot's state that knows the motion up to the number that a message is, in milliseconds."""

    def __init__(self, handled: list[tuple[int, int]]) -> None:
        self.history = SimpleNamespace(newest_ns=None)
        self._handled = handled

    def handle(self, message: int, now_ns: int) -> None:
        self._handled.append((message, now_ns // MS))
        self.history.newest_ns = message * MS


def heard(
    monkeypatch: pytest.MonkeyPatch, sent_ms: list[tuple[int, int]], mode: str = "realtime", aided: float = 1.0
) -> list[list[tuple[int, int]]]:
    """What the autopilot's state got before each of three clouds, which end at 100, 200 and 300 ms."""
    handled: list[tuple[int, int]] = []
    before: list[list[tuple[int, int]]] = []
    clouds = [cloud(number, [(1.0, 0.0, 0.0), (9.0, 0.0, 0.0)]) for number in range(3)]

    class Listening(Odometry):
        made: list[Any] = []  # noqa: RUF012

        def register(self, stamp_ns: int, points: Any, offset_s: Any) -> RegisteredCloud | None:
            before.append(handled.copy())
            handled.clear()
            return super().register(stamp_ns, points, offset_s)

    def messages(log: Any) -> Iterator[tuple[int, int]]:
        yield from ((at_ms * MS, number) for at_ms, number in sent_ms)

    monkeypatch.setattr(rebuilding, "LidarOdometry", Listening)
    monkeypatch.setattr(rebuilding, "AutopilotState", lambda: View(handled))
    monkeypatch.setattr(rebuilding, "clouds", lambda log: iter(clouds))
    monkeypatch.setattr(rebuilding, "pings", lambda log: [])
    monkeypatch.setattr(rebuilding, "read_autopilot_messages", messages)
    profile = SimpleNamespace(
        companion=SimpleNamespace(parameters={"ODO_AIDED": aided}),
        clock=SimpleNamespace(mode=mode, exchange_rate_hz=50.0),
    )
    rebuild(LOG, cast(Any, profile))
    return before


def test_the_companion_hears_from_its_first_cloud_on_and_until_it_knows_the_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each message is (sent, known up to): those before the end of the first cloud are not heard."""
    sent = [(50, 50), (100, 95), (120, 99), (130, 101), (140, 102), (210, 190), (220, 205), (290, 280), (310, 299)]
    assert heard(monkeypatch, sent) == [
        [(99, 120), (101, 130)],
        [(102, 140), (190, 210), (205, 220)],
        [(280, 290), (299, 310)],
    ]
    assert heard(monkeypatch, sent, aided=0.0) == [[], [], []]


def test_in_lockstep_the_companions_clock_shows_the_exchange_before(monkeypatch: pytest.MonkeyPatch) -> None:
    sent = [(120, 101), (220, 201), (320, 301)]
    assert heard(monkeypatch, sent, "lockstep") == [[(101, 100)], [(201, 200)], [(301, 300)]]


def test_a_cloud_waits_for_messages_of_150_milliseconds(monkeypatch: pytest.MonkeyPatch) -> None:
    sent = [(110, 90), (250, 91), (251, 92), (350, 93)]
    assert heard(monkeypatch, sent) == [[(90, 110), (91, 250)], [(92, 251), (93, 350)], []]


def test_all_messages_sent_before_the_end_of_a_cloud_are_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one of the second cloud already covers it."""
    sent = [(120, 101), (150, 201), (160, 202), (210, 203)]
    assert heard(monkeypatch, sent) == [[(101, 120)], [(201, 150), (202, 160)], [(203, 210)]]


def test_the_profile_is_that_of_the_logs_vessel(monkeypatch: pytest.MonkeyPatch) -> None:
    profiles: list[Any] = [SimpleNamespace(vessel=vessel) for vessel in ("lead", "wing")]
    monkeypatch.setattr(rebuilding, "recorded_profiles", lambda text: profiles)
    for vessel, expected in (("lead", profiles[0]), ("wing", profiles[1]), ("other", None)):
        log: Any = SimpleNamespace(vessel=vessel, attachment=lambda name: "")
        assert rebuilding.profile_of(log) is expected
