"""Odometry and map rebuilt from a recording, compared with the truth and the run's result."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.companion.autopilot_state import AutopilotState
from agent.companion.clouds import CloudReassembler, cloud_messages
from agent.companion.mapping import LIDAR, NO_POINTS, SONAR, CloudMap, MapPoints
from agent.companion.odometry import LidarOdometry, OdometryError, RegisteredCloud
from agent.companion.odometry_filters import AutopilotMotionSource
from agent.companion.perception import PATIENCE_NS
from agent.companion.pose_history import AHEAD_NS
from agent.companion.settings import CompanionParameters, checked_parameter
from agent.companion.sonar import echo_points
from agent.wire.codec import Message
from sim_core import frames
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.logs.export.files import make_directory
from xitl_cli.logs.model.log import Log
from xitl_cli.mapping.accuracy import apart, perception_sections
from xitl_cli.mapping.clouds import SeenPoints, clouds, map_points, online, pings, read_autopilot_messages, truth
from xitl_cli.mapping.map_files import MapFormat, points_of, write_map, write_text, write_tum
from xitl_cli.profile.files.catalogue import PROFILE
from xitl_cli.profile.load import recorded_profiles
from xitl_cli.profile.schema import RunProfile


@dataclass(frozen=True, slots=True, eq=False)
class Rebuilt:
    """The odometry, the map in its frame, and counts of unusable data."""

    trajectory: Trajectory
    """FRD at its start."""
    points_odom_m: NDArray[np.float32]
    """(n, 3)."""
    intensity: NDArray[np.uint8]
    source: NDArray[np.uint8]
    """(n,): 0 lidar, 1 sonar."""
    seen_ns: NDArray[np.int64]
    """(m,): stamps of the clouds of the lidar points."""
    clouds: int
    pings: int
    poses_refused: int
    points_refused: int


def rebuild(log: Log, profile: RunProfile | None) -> Rebuilt:
    """Rebuild odometry and map from /lidar/points and /sonar/ping, with the settings of the run's companion.

    Clouds are first encoded as on the wire, so that the odometry gets the same input as in the run. It also gets the
    autopilot's motion messages. Raises UserError without clouds and without KISS-ICP.
    """
    defaults = CompanionParameters()
    settings = {name: defaults[name] for name in defaults}
    if profile is not None and profile.companion is not None:
        parameters = profile.companion.parameters
        settings |= {name: checked_parameter(name, value) for name, value in parameters.items()}
    autopilot = _Autopilot(read_autopilot_messages(log) if settings["ODO_AIDED"] else iter(()), profile)
    try:
        odometry = LidarOdometry(settings["ODO_RANGE"], settings["ODO_VOXEL"], motion=autopilot.motions.motion_between)
    except OdometryError as error:
        raise UserError(f"{log.path}: {error}") from error
    cloud_map = CloudMap(settings["MAP_CELL"], settings["MAP_RANGE"])
    wire, registered, count = CloudReassembler(), list[RegisteredCloud](), 0
    seen = list[NDArray[np.int64]]()
    parts: dict[int, list[MapPoints]] = {LIDAR: [], SONAR: []}
    echoes = pings(log)
    used = 0
    for cloud in clouds(log):
        count += 1
        autopilot.hear(cloud.end_ns)
        for message in cloud_messages(cloud):  # as on the wire
            for received in wire.handle(message):
                result = odometry.register(received.stamp_ns, received.points_m, received.offset_s)
                if result is not None:
                    registered.append(result)
                    intensity = received.intensity[result.kept]
                    added = cloud_map.add(result.pose_odom, result.points_frd_m, intensity, LIDAR)
                    parts[LIDAR].append(added)
                    seen.append(np.full(len(added.intensity), received.stamp_ns))
        while used < len(echoes) and echoes[used].stamp_ns <= cloud.end_ns:
            pose = odometry.pose_at(echoes[used].stamp_ns)
            if pose is not None:
                parts[SONAR].append(cloud_map.add(pose, *echo_points(echoes[used]), SONAR))
            used += 1
    mapped = [NO_POINTS, *parts[LIDAR], *parts[SONAR]]
    return Rebuilt(
        trajectory_of(registered),
        np.concatenate([part.points_odom_m for part in mapped]),
        np.concatenate([part.intensity for part in mapped]),
        np.repeat(
            np.array([LIDAR, SONAR], dtype=np.uint8),
            [sum(len(part.intensity) for part in parts[source]) for source in (LIDAR, SONAR)],
        ),
        np.concatenate([np.empty(0, np.int64), *seen]),
        count,
        used,
        odometry.poses_refused,
        odometry.points_refused,
    )


class _Autopilot:
    """The autopilot's messages of the run, in the timing of the companion.

    The companion begins to listen with its first cloud. In lockstep its clock still shows the previous exchange when a
    message arrives.
    """

    def __init__(self, messages: Iterator[tuple[int, Message]], profile: RunProfile | None) -> None:
        self._view = AutopilotState()
        self.motions = AutopilotMotionSource(self._view.history, lambda stamp_ns: stamp_ns)
        self._messages = messages
        self._next = next(messages, None)
        self._begun = False
        lockstep = profile is not None and profile.clock.mode == "lockstep"
        self._behind_ns = round(1e9 / profile.clock.exchange_rate_hz) if profile is not None and lockstep else 0

    def hear(self, end_ns: int) -> None:
        """Handle messages until they reach this instant, with the companion's limit on the wait."""
        history = self._view.history
        while self._next is not None and self._next[0] <= end_ns + PATIENCE_NS:
            late_ns = 0 if history.newest_ns is None else end_ns - history.newest_ns
            if self._next[0] > end_ns and history.newest_ns is not None and not 0 < late_ns <= AHEAD_NS:
                return
            stamp_ns, message = self._next
            if self._begun or stamp_ns > end_ns:
                self._begun = True
                self._view.handle(message, stamp_ns - self._behind_ns)
            self._next = next(self._messages, None)


def trajectory_of(placed: list[RegisteredCloud]) -> Trajectory:
    """Return the poses by their instants."""
    if not placed:
        return Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 4)))
    poses = np.array([cloud.pose_odom for cloud in placed])
    stamps = np.array([cloud.stamp_ns for cloud in placed], dtype=np.int64)
    return Trajectory(stamps, poses[:, :3, 3], frames.matrix_to_quat(poses[:, :3, :3]))


def profile_of(log: Log) -> RunProfile | None:
    """Return the profile in the recording, or None when this version cannot read it."""
    profiles = recorded_profiles(log.attachment(PROFILE))
    return next((profile for profile in profiles if profile.vessel == log.vessel), None)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Result of `measure`."""

    report: dict[str, Any]
    """Values for JSON."""
    rebuilt: Rebuilt
    truth: Trajectory | None
    """Body FRD to NED."""
    online: Trajectory | None
    """Poses that the companion sent in the run."""


def measure(log: Log) -> Measured:
    """Rebuild odometry and map and compare them. Raises UserError without clouds and without KISS-ICP."""
    from xitl_cli.scenery import Scenery

    profile = profile_of(log)
    boom = None if profile is None else Scenery(profile).boom
    rebuilt = rebuild(log, profile)
    true, in_run = truth(log), online(log)
    by_lidar = SeenPoints(rebuilt.points_odom_m[rebuilt.source == LIDAR], rebuilt.seen_ns)
    offline = perception_sections(true, rebuilt.trajectory, by_lidar, boom)
    report: dict[str, Any] = {
        "recording": str(log.path),
        "clouds": rebuilt.clouds,
        "pings": rebuilt.pings,
        "poses_refused": rebuilt.poses_refused,
        "points_refused": rebuilt.points_refused,
        "offline": {"odometry": offline.odometry, "mapping": offline.mapping},
        "online": None,
        "difference": None,
    }
    if in_run is not None:
        points = map_points(log)
        accuracy = perception_sections(true, in_run, points["lidar"], boom)
        report["online"] = {"odometry": accuracy.odometry, "mapping": accuracy.mapping}
        # Root mean square distance from the points of the rebuilt map to the nearest points of the run's map
        whole = np.concatenate([part.points_odom_m for part in points.values()])
        map_rms_m = None
        if len(rebuilt.points_odom_m) and len(whole):
            from scipy.spatial import KDTree  # type: ignore[import-untyped]

            off_m, _ = KDTree(whole).query(rebuilt.points_odom_m)
            map_rms_m = round(float(np.sqrt(np.mean(off_m**2))), 4)
        report["difference"] = {**apart(rebuilt.trajectory, in_run), "map_rms_m": map_rms_m}
    return Measured(report, rebuilt, true, in_run)


def written(measured: Measured, directory: Path, kind: MapFormat) -> list[Path]:
    """Write the files and return them; earlier ones are replaced. Raises UserError when they cannot be written."""
    make_directory(directory)
    rebuilt = measured.rebuilt
    packed = points_of(rebuilt.points_odom_m, rebuilt.intensity, rebuilt.source)
    files = [directory / f"map.{kind}"]
    write_map(files[0], packed, kind)
    trajectories = {"trajectory": rebuilt.trajectory, "truth": measured.truth, "online": measured.online}
    for name, trajectory in trajectories.items():
        if trajectory is not None:
            files.append(directory / f"{name}.tum")
            write_tum(files[-1], trajectory)
    files.append(directory / "map.json")
    write_text(files[-1], json.dumps(measured.report, indent=2, allow_nan=False) + "\n")
    return files
