"""The companion's odometry and map made anew from a recording, with the code that ran in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from agent.companion.clouds import Cloud, Clouds, cloud_messages
from agent.companion.echoes import echo_points
from agent.companion.inertial import Motions
from agent.companion.mapping import LIDAR, SONAR, CloudMap
from agent.companion.odometry import LidarOdometry, OdometryError, Placed
from agent.companion.perceiver import PATIENCE_NS
from agent.companion.pings import Ping
from agent.companion.pose_history import AHEAD_NS
from agent.companion.settings import Settings, checked
from agent.companion.vehicle import VehicleView
from agent.wire.codec import Message
from sim_core import frames
from xitl_cli.errors import UserError
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.log import Log
from xitl_cli.mapping.clouds import clouds, pings, told
from xitl_cli.profile.schema import Profile, RunProfile
from xitl_cli.profile.yaml_file import parse_yaml
from xitl_cli.run.directory import PROFILE


@dataclass(frozen=True, slots=True, eq=False)
class Rebuilt:
    """The odometry (FRD where it began), the map (n, 3) in its frame, and what could not be used.

    source (n,): 0 lidar, 1 sonar.
    """

    trajectory: Trajectory
    points_odom_m: NDArray[np.float32]
    intensity: NDArray[np.uint8]
    source: NDArray[np.uint8]
    clouds: int
    pings: int
    poses_refused: int
    points_refused: int


def rebuild(log: Log, profile: RunProfile | None) -> Rebuilt:
    """From /lidar/points and /sonar/ping, with the settings of the run's companion.

    Clouds go through the coding of the wire first, so that the odometry is given what it was given in the run, as it is
    what the autopilot said of its motion. Raises UserError without clouds and without KISS-ICP.
    """
    settings = _settings(profile)
    autopilot = _Autopilot(told(log) if settings["ODO_AIDED"] else iter(()), profile)
    try:
        odometry = LidarOdometry(settings["ODO_RANGE"], settings["ODO_VOXEL"], motion=autopilot.motions.of)
    except OdometryError as error:
        raise UserError(f"{log.path}: {error}") from error
    cloud_map = CloudMap(settings["MAP_CELL"], settings["MAP_RANGE"])
    wire, placed, count = Clouds(), list[Placed](), 0
    echoes = pings(log)
    heard = 0
    for cloud in clouds(log):
        count += 1
        autopilot.hear(cloud.end_ns)
        for sent in _over_the_wire(wire, cloud):
            found = odometry.register(sent.stamp_ns, sent.points_m, sent.offset_s)
            if found is not None:
                placed.append(found)
                cloud_map.add(found.pose_odom, found.points_frd_m, sent.intensity[found.kept], LIDAR)
        while heard < len(echoes) and echoes[heard].stamp_ns <= cloud.end_ns:
            _hear(cloud_map, odometry, echoes[heard])
            heard += 1
    parts = [cloud_map.whole(source) for source in (LIDAR, SONAR)]
    return Rebuilt(
        trajectory_of(placed),
        np.concatenate([part.points_odom_m for part in parts]),
        np.concatenate([part.intensity for part in parts]),
        np.repeat(np.array([LIDAR, SONAR], dtype=np.uint8), [len(part.intensity) for part in parts]),
        count,
        heard,
        odometry.poses_refused,
        odometry.points_refused,
    )


class _Autopilot:
    """What it said in the run, heard again as the companion heard it.

    That begins to listen with its first cloud. In lockstep its clock still shows the exchange before when it hears.
    """

    def __init__(self, said: Iterator[tuple[int, Message]], profile: RunProfile | None) -> None:
        self._view = VehicleView()
        self.motions = Motions(self._view.history, lambda stamp_ns: stamp_ns)
        self._told = said
        self._next = next(said, None)
        self._begun = False
        lockstep = profile is not None and profile.clock.mode == "lockstep"
        self._behind_ns = round(1e9 / profile.clock.exchange_rate_hz) if profile is not None and lockstep else 0

    def hear(self, end_ns: int) -> None:
        """Until it has told of this instant, as long as a companion waits for it."""
        history = self._view.history
        while self._next is not None and self._next[0] <= end_ns + PATIENCE_NS:
            late_ns = 0 if history.newest_ns is None else end_ns - history.newest_ns
            if self._next[0] > end_ns and history.newest_ns is not None and not 0 < late_ns <= AHEAD_NS:
                return
            stamp_ns, message = self._next
            if self._begun or stamp_ns > end_ns:
                self._begun = True
                self._view.take(message, stamp_ns - self._behind_ns)
            self._next = next(self._told, None)


def trajectory_of(placed: list[Placed]) -> Trajectory:
    """Poses by their instants."""
    if not placed:
        return Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 4)))
    poses = np.array([one.pose_odom for one in placed])
    stamps = np.array([one.stamp_ns for one in placed], dtype=np.int64)
    return Trajectory(stamps, poses[:, :3, 3], frames.matrix_to_quat(poses[:, :3, :3]))


def profile_of(log: Log) -> RunProfile | None:
    """The profile kept in the recording; None where there is none that this version understands."""
    data = log.attachment(PROFILE) if isinstance(log, McapLog) else None
    if data is None:
        return None
    try:
        entry = parse_yaml(data.decode(errors="replace"), PROFILE)
        return None if entry is None else Profile.model_validate(entry.plain()).runnable()
    except (ValidationError, UserError):
        return None


def _settings(profile: RunProfile | None) -> dict[str, float]:
    defaults = Settings()
    values = {name: defaults[name] for name in defaults}
    companion = None if profile is None else profile.companion
    if companion is not None:
        values |= {name: checked(name, value) for name, value in companion.parameters.items()}
    return values


def _over_the_wire(wire: Clouds, cloud: Cloud) -> list[Cloud]:
    return [whole for message in cloud_messages(cloud) for whole in wire.take(message)]


def _hear(cloud_map: CloudMap, odometry: LidarOdometry, ping: Ping) -> None:
    pose = odometry.pose_at(ping.stamp_ns)
    if pose is not None:
        points_frd_m, intensity = echo_points(ping)
        cloud_map.add(pose, points_frd_m, intensity, SONAR)
