"""Clouds, echoes and maps are placed by the true poses of a recording, which is made up here."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.companion.clouds import PointCloud
from xitl_cli.errors import UserError
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.mapping import clouds
from xitl_cli.plugins.studies.experiments import section_4_3_sitl_hitl
from xitl_cli.plugins.studies.experiments.section_4_3_sitl_hitl import boom_map
from xitl_cli.plugins.studies.experiments.section_4_4_lidar_sonar import fused_cloud

BEGAN_NS = 1_000_000_000
HALF = math.sqrt(0.5)
TRUTH = Trajectory(
    np.array([BEGAN_NS, 2 * BEGAN_NS]),
    np.array([[10.0, 20.0, -0.35], [11.0, 20.0, -0.35]]),
    np.array([[HALF, 0.0, 0.0, HALF]] * 2),
)
"""Bow to the east, carried to the north at 1 m/s for a second."""


def frame(number: int, stamp_ns: int, *points: tuple[float, float, float], offset_s: float = 0.0) -> PointCloud:
    places = np.array(points, dtype=np.float32)
    return PointCloud(
        0, number, stamp_ns, places, np.full(len(places), offset_s, dtype=np.float32), np.zeros(0, np.uint8)
    )


class Rows:
    def __init__(self, rows: int, **columns: Any) -> None:
        self._rows, self._columns = rows, columns

    def __len__(self) -> int:
        return self._rows

    def values(self, name: str, raw: bool = False) -> Any:
        return self._columns[name]


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Tables of the recording. Every fifth frame is used: the first and the sixth."""
    frames = [
        frame(0, BEGAN_NS, (5.0, 2.0, 0.4), (1.0, 1.0, 0.0), offset_s=0.5),
        *(frame(number, BEGAN_NS, (9.0, 9.0, 9.0)) for number in range(1, 5)),
        frame(5, 3 * BEGAN_NS, (4.0, 0.0, 0.2), (1.2, 0.9, 0.7), (0.0, 6.0, 3.0)),
    ]
    monkeypatch.setattr(clouds, "truth", lambda log: TRUTH)
    monkeypatch.setattr(clouds, "clouds", lambda log: iter(frames))
    monkeypatch.setattr(clouds, "pings", lambda log: [SimpleNamespace(stamp_ns=BEGAN_NS, at=7.0)])
    monkeypatch.setattr(
        "agent.companion.sonar.echo_points",
        lambda ping: (np.array([[ping.at, 1.0, 0.5], [1.0, 1.0, 0.5]]), np.zeros(2)),
    )
    return {}


def cloud(tables: dict[str, Any]) -> Any:
    return fused_cloud(SimpleNamespace(path=Path("run.mcap"), tables=tables))  # type: ignore[arg-type]


def test_points_are_placed_at_their_own_time_and_those_of_the_vessel_left_out(recorded: dict[str, Any]) -> None:
    """Ahead is east and starboard is south. Nearer than 1.5 m in plan is the vessel itself."""
    found = cloud(recorded)
    assert found.lidar_ned_m == pytest.approx(
        np.array(
            [
                [10.0 + 0.5 - 2.0, 20.0 + 5.0, 0.4 - 0.35],  # half a second later
                [11.0, 24.0, 0.2 - 0.35],  # beyond the end of the truth: at its end
                [11.0 - 6.0, 20.0, 3.0 - 0.35],
            ]
        ),
        abs=1e-5,
    )
    assert found.sonar_ned_m == pytest.approx(np.array([[10.0 - 1.0, 27.0, 0.15]]), abs=1e-5)
    assert found.water_down_m == pytest.approx(0.5 * (0.05 - 0.15))  # the median of what is within a metre
    assert (found.ranges_m, found.proximity) == ({}, {})


def test_a_recording_without_truth_or_points(recorded: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clouds, "clouds", lambda log: iter(()))
    monkeypatch.setattr(clouds, "pings", lambda log: [])
    found = cloud(recorded)
    assert (found.lidar_ned_m.shape, found.sonar_ned_m.shape, found.water_down_m) == ((0, 3), (0, 3), 0.0)
    monkeypatch.setattr(clouds, "truth", lambda log: None)
    with pytest.raises(UserError, match=r"run\.mcap: holds no true motion"):
        cloud(recorded)


def test_ranges_are_those_of_the_last_message_that_has_any(recorded: dict[str, Any]) -> None:
    """65535 stands for unknown, and a distance above the largest for nothing there; sectors go around to the stern."""
    recorded["/link/agent/tx:OBSTACLE_DISTANCE"] = Rows(
        3,
        distances=np.array([[100, 200, 300, 400], [65535, 1000, 1001, 250], [65535, 1001, 65535, 1001]]),
        max_distance=np.array([1000, 1000, 1000]),
        increment_f=np.array([90.0, 60.0, 60.0]),
        angle_offset=np.array([0.0, 30.0, 30.0]),
    )
    recorded["/link/agent/tx:DISTANCE_SENSOR"] = Rows(7)
    found = cloud(recorded)
    assert found.ranges_m == pytest.approx({90.0: 10.0, -150.0: 2.5})
    assert found.proximity == {"OBSTACLE_DISTANCE": 3, "DISTANCE_SENSOR": 7}
    recorded["/link/agent/tx:OBSTACLE_DISTANCE"] = Rows(0)
    assert cloud(recorded).ranges_m == {}


@pytest.fixture
def rebuilt(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """What `xitl map` makes of a recording: odometry from half a second on, and a map made again from the beginning."""
    result = SimpleNamespace(
        truth=TRUTH,
        online=SimpleNamespace(stamp_ns=np.array([BEGAN_NS + BEGAN_NS // 2])),
        rebuilt=SimpleNamespace(
            trajectory=SimpleNamespace(stamp_ns=np.array([0])), points_odom_m=np.array([[3.0, 0.0, 0.0]])
        ),
        report={"online": {"a": 1}, "offline": {"b": 2}, "difference": {"c": 3}, "other": 4},
    )
    seen = {
        "lidar": SimpleNamespace(points_odom_m=np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.5]])),
        "sonar": SimpleNamespace(points_odom_m=np.array([[0.0, 0.0, 4.0]])),
    }
    monkeypatch.setattr("xitl_cli.mapping.rebuild.measure", lambda log: result)
    monkeypatch.setattr("xitl_cli.mapping.rebuild.profile_of", lambda log: "a profile")
    monkeypatch.setattr(clouds, "map_points", lambda log: seen)
    boom = SimpleNamespace(centre_ned_m=np.array([[1.0, 2.0, 0.1], [3.0, 4.0, 0.1]]))
    monkeypatch.setattr("xitl_cli.scenery.Scenery", lambda profile: SimpleNamespace(boom=boom))

    class Opened:
        def __enter__(self) -> None:
            return None

        def __exit__(self, *_: object) -> None:
            return None

    monkeypatch.setattr(section_4_3_sitl_hitl, "open_log", lambda path: Opened())
    return result


def test_maps_are_placed_by_the_true_pose_at_the_start_of_their_odometry(rebuilt: SimpleNamespace) -> None:
    found = boom_map("hitl", Path("run.mcap"))
    assert found is not None
    north, east, down = 10.5, 20.0, -0.35  # after half a second
    assert found.online_ned_m == pytest.approx(
        np.array([[north, east + 1.0, down], [north - 2.0, east, down + 0.5], [north, east, down + 4.0]])
    )
    assert found.offline_ned_m == pytest.approx(np.array([[10.0, 23.0, -0.35]]))  # before the truth: at its start
    assert found.boom_ne_m.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert (found.name, dict(found.report)) == (
        "hitl",
        {"online": {"a": 1}, "offline": {"b": 2}, "difference": {"c": 3}},
    )


def test_a_run_without_a_map_and_a_river_without_a_boom(
    rebuilt: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("xitl_cli.mapping.rebuild.profile_of", lambda log: None)
    found = boom_map("sitl", Path("run.mcap"))
    assert found is not None
    assert found.boom_ne_m.shape == (0, 2)
    rebuilt.online.stamp_ns = np.empty(0)
    assert boom_map("sitl", Path("run.mcap")) is None
    rebuilt.online = None
    assert boom_map("sitl", Path("run.mcap")) is None
    rebuilt.online, rebuilt.truth = SimpleNamespace(stamp_ns=np.array([BEGAN_NS])), None
    assert boom_map("sitl", Path("run.mcap")) is None
