"""What a companion found in a run, recorded as it comes and held against the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from agent.companion.clouds import Cloud, Clouds
from agent.wire import dialect
from sim_core import frames
from sim_core.frames import Array
from sim_core.geodesy import LocalFrame
from sim_core.kinematics import Kinematics
from sim_core.simulation import SimulationState
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.profile.schema import RunProfile
from xitl_cli.recording.perception import Source
from xitl_cli.recording.recorder import Recorder
from xitl_cli.run.companion.line import CompanionLine, NoCompanion
from xitl_cli.run.companion.obstacle_score import ObstacleScore
from xitl_cli.run.scenery import Scenery
from xitl_cli.run.sensing import local_frame

TRUTH_RATE_HZ = 50.0
SEEN_RATE_HZ = 10.0
_MANOEUVRES = {
    dialect.XITL_MANOEUVRE_NONE: "none",
    dialect.XITL_MANOEUVRE_DETOUR: "detour",
    dialect.XITL_MANOEUVRE_STOP: "stop",
    dialect.XITL_MANOEUVRE_RETURN: "return",
}
_SOURCES: dict[int, Source] = {dialect.XITL_CLOUD_KIND_LIDAR_MAP: "lidar", dialect.XITL_CLOUD_KIND_SONAR_MAP: "sonar"}
_ZEROS = (0,) * len(dialect.MAVLink_xitl_companion_status_message.fieldnames)
_UNCOUNTED = ("time_usec", "latency", "manoeuvre")


class NoFindings:
    """Nobody finds anything."""

    def begin(self, recorder: Recorder, now_ns: Callable[[], int]) -> None:
        """The run starts; `now_ns` is simulation time."""

    def look(self, step: int, sim_ns: int, state: SimulationState, motion: Kinematics) -> None:
        """The truth, after each physics step, counted from 1."""


class Findings(NoFindings):
    """Takes what the companion says (`take`) and what the autopilot says of its origin (`hear_autopilot`).

    Poses and maps are in the frame `odom`: forward, right, down of the body where the odometry began. status: the
    latest XITL_COMPANION_STATUS, None before the first.
    """

    def __init__(self, frame: LocalFrame, score: ObstacleScore, physics_rate_hz: float) -> None:
        self.status: Any = None
        self.score = score
        self.clouds = Clouds()
        self.maps: dict[Source, list[Cloud]] = {source: [] for source in _SOURCES.values()}
        self._frame = frame
        self._every_truth = max(round(physics_rate_hz / TRUTH_RATE_HZ), 1)
        self._every_seen = max(round(physics_rate_hz / SEEN_RATE_HZ), 1)
        self._origin_ned_m = np.zeros(3)
        self._odometry: list[Any] = []
        self._truth: list[tuple[int, Array, Array]] = []
        self._recorder: Recorder | None = None
        self._now_ns: Callable[[], int] = lambda: 0
        self._handlers: dict[int, Callable[[Any], None]] = {
            dialect.MAVLINK_MSG_ID_ODOMETRY: self._on_odometry,
            dialect.MAVLINK_MSG_ID_XITL_CLOUD: self._on_cloud,
            dialect.MAVLINK_MSG_ID_XITL_OBSTACLE: self._on_obstacle,
            dialect.MAVLINK_MSG_ID_XITL_COMPANION_STATUS: self._on_status,
        }

    def begin(self, recorder: Recorder, now_ns: Callable[[], int]) -> None:
        self._recorder, self._now_ns = recorder, now_ns

    def look(self, step: int, sim_ns: int, state: SimulationState, motion: Kinematics) -> None:
        if step % self._every_truth == 0:
            self._truth.append((sim_ns, motion.pos_ned_m[0], motion.quat_ned_frd[0]))
        if step % self._every_seen == 0:
            rotation = motion.rot_ned_frd[0]
            self.score.see(motion.pos_ned_m[0], math.atan2(rotation[1, 0], rotation[0, 0]), state.debris)

    def take(self, message: Any) -> None:
        """A message of the companion."""
        handler = self._handlers.get(message.get_msgId())
        if handler is not None and self._recorder is not None:
            handler(message)

    def hear_autopilot(self, message: Any) -> None:
        """GPS_GLOBAL_ORIGIN is where the autopilot's local frame is, which obstacles are told in."""
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
            place = (message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
            self._origin_ned_m = self._frame.ned(*np.array([place]).T)[0]
            self.score.origin_ne_m = (float(self._origin_ned_m[0]), float(self._origin_ned_m[1]))

    # What was found

    def odometry(self) -> Trajectory:
        """Poses of the companion's odometry, in `odom`."""
        stamps = np.array([message.time_usec * 1000 for message in self._odometry], dtype=np.int64)
        places = np.array([(message.x, message.y, message.z) for message in self._odometry], dtype=float)
        turns = np.array([message.q for message in self._odometry], dtype=float)
        return Trajectory(stamps, places.reshape(-1, 3), turns.reshape(-1, 4))

    def truth(self) -> Trajectory:
        """The body's true poses, in NED."""
        stamps = np.array([stamp for stamp, _, _ in self._truth], dtype=np.int64)
        places = np.array([place for _, place, _ in self._truth]).reshape(-1, 3)
        return Trajectory(stamps, places, np.array([quat for _, _, quat in self._truth]).reshape(-1, 4))

    def map_points(self, source: Source) -> tuple[Array, Array]:
        """(k, 3) in `odom` and their intensity (k,)."""
        clouds = self.maps[source]
        if not clouds:
            return np.empty((0, 3)), np.empty(0, dtype=np.uint8)
        return (
            np.concatenate([cloud.points_m for cloud in clouds]).astype(float),
            np.concatenate([cloud.intensity for cloud in clouds]),
        )

    def companion(self) -> dict[str, Any]:
        """The summary's section: the last status that came, all zeros before the first."""
        status = dialect.MAVLink_xitl_companion_status_message(*_ZEROS) if self.status is None else self.status
        counts = {name: getattr(status, name) for name in status.fieldnames if name not in _UNCOUNTED}
        lost = {"map_chunks_lost": self.clouds.chunks_lost}
        return {**counts, **lost, "latency_s": status.latency, "manoeuvre": _MANOEUVRES.get(status.manoeuvre, "?")}

    # One message each

    def _on_odometry(self, message: Any) -> None:
        assert self._recorder is not None
        if not all(map(math.isfinite, (message.x, message.y, message.z, *message.q))) or not any(message.q):
            return
        if not self._odometry:
            self._place_odom(message.time_usec * 1000)
        self._odometry.append(message)
        pose = np.eye(4)
        quat = frames.quat_normalize(np.array(message.q, dtype=float))
        pose[:3, :3], pose[:3, 3] = frames.quat_to_matrix(quat), (message.x, message.y, message.z)
        velocity = np.array((message.vx, message.vy, message.vz))
        self._recorder.perception.odometry(message.time_usec * 1000, pose, velocity)

    def _place_odom(self, stamp_ns: int) -> None:
        """Where `odom` is on the map: the body's true pose when the odometry began."""
        if self._truth and self._recorder is not None:
            _, place, quat = min(self._truth, key=lambda pose: abs(pose[0] - stamp_ns))
            self._recorder.perception.odom_frame(self._now_ns(), place, quat)

    def _on_cloud(self, message: Any) -> None:
        assert self._recorder is not None
        for cloud in self.clouds.take(message):
            source = _SOURCES.get(cloud.kind)
            if source is not None:
                self.maps[source].append(cloud)
                self._recorder.perception.map_points(self._now_ns(), cloud.points_m, cloud.intensity, source)

    def _on_obstacle(self, message: Any) -> None:
        assert self._recorder is not None
        self.score.hear(message)
        message.pos_ned = (np.array(message.pos_ned) + self._origin_ned_m).tolist()
        self._recorder.perception.obstacle(self._now_ns(), message)

    def _on_status(self, message: Any) -> None:
        assert self._recorder is not None
        self.status = message
        self._recorder.perception.companion(self._now_ns(), message)


def findings_of(profile: RunProfile, scenery: Scenery, companion: NoCompanion | CompanionLine) -> NoFindings:
    """Ears for a companion, where there is one, and the truth of the world it looks at."""
    if not isinstance(companion, CompanionLine):
        return NoFindings()
    sensors, hull = profile.sensors, profile.vehicle.hull
    looks = sensors is not None and sensors.lidar is not None
    standing = scenery.caster() if looks else None
    score = ObstacleScore((hull.length_m, hull.width_m), standing, scenery.water_down_m)
    findings = Findings(local_frame(profile.site), score, profile.clock.physics_rate_hz)
    companion.on_message, companion.on_forward = findings.take, findings.hear_autopilot
    return findings
