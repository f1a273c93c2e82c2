"""The results of a companion computer in a run: recorded as they arrive, scored against the truth, saved as files."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from struct import Struct
from tempfile import TemporaryFile, gettempdir
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from agent.companion.clouds import CloudReassembler
from agent.wire import dialect
from sim_core import frames
from sim_core.frames import Array
from sim_core.geodesy import LocalFrame
from sim_core.world.rays import Bodies
from sim_core.world.structures import LogBoom
from xitl_cli.errors import UserError
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.mapping.accuracy import perception_sections
from xitl_cli.mapping.clouds import SeenPoints
from xitl_cli.mapping.map_files import points_of, write_map, write_tum
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MAP_SOURCES, MapSource
from xitl_cli.run.core import directory
from xitl_cli.run.core.node import RunContext, RunNode, RunStep, SimulationClock
from xitl_cli.run.core.scores import ObstacleScore
from xitl_cli.run.world.world import local_frame
from xitl_cli.scenery import Scenery

TRUTH_RATE_HZ = 50.0
TRUTH_KEPT_S = 10.0  # an odometry message that is later has no truth
SEEN_RATE_HZ = 10.0
_MANOEUVRES = {
    dialect.XITL_MANOEUVRE_NONE: "none",
    dialect.XITL_MANOEUVRE_DETOUR: "detour",
    dialect.XITL_MANOEUVRE_STOP: "stop",
    dialect.XITL_MANOEUVRE_RETURN: "return",
}
_SOURCES: dict[int, MapSource] = {
    dialect.XITL_CLOUD_KIND_LIDAR_MAP: "lidar",
    dialect.XITL_CLOUD_KIND_SONAR_MAP: "sonar",
}
_ZEROS = (0,) * len(dialect.MAVLink_xitl_companion_status_message.fieldnames)
_UNCOUNTED = ("time_usec", "latency", "manoeuvre")
_POSE = np.dtype([("stamp_ns", "<i8"), ("numbers", "<f8", 7)])
_PACK_POSE = Struct("<q7d").pack
_MAP_POINT = np.dtype([("stamp_ns", "<i8"), ("point_odom_m", "<f4", 3), ("intensity", "u1")])
"""stamp_ns: of the cloud that brought it."""


class _Kept:
    """Records of a run in a temporary file, because a long run has millions. Raises UserError on a full disk."""

    def __init__(self, record: np.dtype[Any]) -> None:
        self._record = record
        self._file = TemporaryFile(buffering=0)  # noqa: SIM115  read after the run, when nodes are closed
        self._bytes = 0
        finalize(self, self._file.close)

    def __len__(self) -> int:
        return self._bytes // self._record.itemsize

    def add(self, records: bytes) -> None:
        try:
            self._file.write(records)
        except OSError as error:
            raise UserError(
                f"{gettempdir()}: the companion's results cannot be kept ({error.strerror}); free space and run again"
            ) from error
        self._bytes += len(records)

    def read(self) -> NDArray[Any]:
        self._file.seek(0)
        return np.frombuffer(self._file.read(), dtype=self._record, count=len(self))


def _trajectory(kept: _Kept) -> Trajectory:
    poses = kept.read()
    return Trajectory(poses["stamp_ns"], poses["numbers"][:, :3], poses["numbers"][:, 3:])


class FindingsNode(RunNode):
    """Handles the messages of the companion (`handle`) and the origin from the autopilot (`handle_autopilot`).

    Poses and maps are in the frame `odom`: forward, right, down of the body at the start of the odometry. status: the
    latest XITL_COMPANION_STATUS, None before the first.
    """

    def __init__(
        self, frame: LocalFrame, score: ObstacleScore, physics_rate_hz: float, boom: LogBoom | None = None
    ) -> None:
        self.status: Any = None
        self.score = score
        self.clouds = CloudReassembler()
        self._maps = {source: _Kept(_MAP_POINT) for source in _SOURCES.values()}
        self._frame = frame
        self._boom = boom
        self._every_truth = max(round(physics_rate_hz / TRUTH_RATE_HZ), 1)
        self._every_seen = max(round(physics_rate_hz / SEEN_RATE_HZ), 1)
        self.sense_every = math.gcd(self._every_truth, self._every_seen)
        self._origin_ned_m = np.zeros(3)
        self._recent: deque[tuple[int, Array, Array]] = deque(maxlen=round(TRUTH_KEPT_S * TRUTH_RATE_HZ))
        self._odometry, self._truth = _Kept(_POSE), _Kept(_POSE)
        self._recorder: Recorder | None = None
        self._clock: SimulationClock | None = None
        self._handlers: dict[int, Callable[[Any], None]] = {
            dialect.MAVLINK_MSG_ID_ODOMETRY: self._on_odometry,
            dialect.MAVLINK_MSG_ID_XITL_CLOUD: self._on_cloud,
            dialect.MAVLINK_MSG_ID_XITL_OBSTACLE: self._on_obstacle,
            dialect.MAVLINK_MSG_ID_XITL_COMPANION_STATUS: self._on_status,
        }

    def begin(self, context: RunContext) -> None:
        self._recorder, self._clock = context.recorder, context.clock

    def sense(self, step: RunStep) -> None:
        number, now_ns, motion = step.number, step.now_ns, step.motion
        if number % self._every_truth == 0:
            self._recent.append((now_ns, motion.pos_ned_m[0], motion.quat_ned_frd[0]))
        if number % self._every_seen == 0:
            rotation = motion.rot_ned_frd[0]
            self.score.see(motion.pos_ned_m[0], math.atan2(rotation[1, 0], rotation[0, 0]), step.state.debris)

    def handle(self, message: Any) -> None:
        """Handle a message of the companion."""
        handler = self._handlers.get(message.get_msgId())
        if handler is not None and self._recorder is not None:
            handler(message)

    def handle_autopilot(self, message: Any) -> None:
        """Handle GPS_GLOBAL_ORIGIN, the origin of the autopilot's local frame, in which obstacles are reported."""
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
            place = (message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
            self._origin_ned_m = self._frame.ned(*np.array([place]).T)[0]
            self.score.origin_ne_m = (float(self._origin_ned_m[0]), float(self._origin_ned_m[1]))

    # Results

    def odometry(self) -> Trajectory:
        """Return the poses of the companion's odometry, in `odom`."""
        return _trajectory(self._odometry)

    def truth(self) -> Trajectory:
        """Return the true poses of the body at the same instants, in NED, for poses that arrived in time."""
        return _trajectory(self._truth)

    def map_points(self, source: MapSource) -> tuple[Array, NDArray[np.uint8]]:
        """Return the points (k, 3) in `odom` and their intensity (k,)."""
        points = self._maps[source].read()
        return points["point_odom_m"].astype(float), points["intensity"].copy()

    def companion(self) -> dict[str, Any]:
        """Return the latest status, with zeros before the first."""
        status = dialect.MAVLink_xitl_companion_status_message(*_ZEROS) if self.status is None else self.status
        counts = {name: getattr(status, name) for name in status.fieldnames if name not in _UNCOUNTED}
        lost = {"map_chunks_lost": self.clouds.chunks_lost}
        return {**counts, **lost, "latency_s": status.latency, "manoeuvre": _MANOEUVRES.get(status.manoeuvre, "?")}

    def report(self) -> dict[str, Any]:
        points = self._maps["lidar"].read()
        seen = SeenPoints(points["point_odom_m"].copy(), points["stamp_ns"].copy())
        accuracy = perception_sections(self.truth(), self.odometry(), seen, self._boom)
        return {
            "odometry": accuracy.odometry,
            "mapping": {**accuracy.mapping, "sonar_points": len(self._maps["sonar"])},
            "obstacles": self.score.report(),
            "companion": self.companion(),
            "warnings": list(self._drops()),
        }

    def _drops(self) -> Iterator[str]:
        """Yield a sentence for each kind of data that the companion dropped after the autopilot's first pose."""
        status = self.status
        if status is None:
            return
        clouds = status.clouds_unplaced - status.clouds_early
        detections = status.detections_dropped - status.detections_early
        if clouds:
            yield (
                f"the companion looked for no obstacles in {clouds} clouds, because it did not know the "
                "pose of the vessel at their instants; check the rates of ATTITUDE_QUATERNION and LOCAL_POSITION_NED"
            )
        if detections:
            yield (
                f"the companion did not use {detections} of {status.detections} detections of cameras, "
                "because their pose was unknown or too many came at once; lower the cameras' rate_hz"
            )

    def save(self, folder: Path) -> None:
        """Save the map, the trajectory and the truth, if there is an odometry."""
        odometry = self.odometry()
        if not len(odometry.stamp_ns):
            return
        parts = [self.map_points(source) for source in MAP_SOURCES]
        packed = points_of(
            np.concatenate([points for points, _ in parts]).astype(np.float32),
            np.concatenate([intensity for _, intensity in parts]),
            np.concatenate([np.full(len(points), number, np.uint8) for number, (points, _) in enumerate(parts)]),
        )
        write_map(folder / directory.MAP, packed, "ply")
        write_tum(folder / directory.TRAJECTORY, odometry)
        write_tum(folder / directory.TRUTH, self.truth())

    # One message each

    def _step_ns(self) -> int:
        return 0 if self._clock is None else self._clock.step_ns

    def _on_odometry(self, message: Any) -> None:
        assert self._recorder is not None
        if not all(map(math.isfinite, (message.x, message.y, message.z, *message.q))) or not any(message.q):
            return
        stamp_ns = message.time_usec * 1000
        quat = frames.quat_normalize(np.array(message.q, dtype=float))
        place = np.array((message.x, message.y, message.z))
        self._odometry.add(_PACK_POSE(stamp_ns, *place.tolist(), *quat.tolist()))
        if self._recent and stamp_ns >= self._recent[0][0]:
            true_place, true_quat = self._true_pose(stamp_ns)
            if not len(self._truth):
                self._recorder.perception.odom_frame(self._step_ns(), true_place, true_quat)
            self._truth.add(_PACK_POSE(stamp_ns, *true_place.tolist(), *true_quat.tolist()))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = frames.quat_to_matrix(quat), place
        velocity = np.array((message.vx, message.vy, message.vz))
        self._recorder.perception.odometry(stamp_ns, pose, velocity)

    def _true_pose(self, stamp_ns: int) -> tuple[Array, Array]:
        """Return place and attitude at an instant of the last seconds, by linear interpolation of the truth."""
        recent = self._recent
        after = bisect_left(recent, stamp_ns, key=lambda pose: pose[0])
        if after in (0, len(recent)):
            _, place, quat = recent[min(after, len(recent) - 1)]
            return place, quat
        (start_ns, start, start_quat), (end_ns, end, end_quat) = recent[after - 1], recent[after]
        share = (stamp_ns - start_ns) / (end_ns - start_ns)
        if float(start_quat @ end_quat) < 0.0:  # the shorter way
            end_quat = -end_quat
        return start + share * (end - start), frames.quat_normalize(start_quat + share * (end_quat - start_quat))

    def _on_cloud(self, message: Any) -> None:
        assert self._recorder is not None
        for cloud in self.clouds.handle(message):
            source = _SOURCES.get(cloud.kind)
            if source is not None:
                points = np.empty(len(cloud.points_m), dtype=_MAP_POINT)
                points["stamp_ns"], points["point_odom_m"] = cloud.stamp_ns, cloud.points_m
                points["intensity"] = cloud.intensity
                self._maps[source].add(points.tobytes())
                self._recorder.perception.map_points(self._step_ns(), cloud.points_m, cloud.intensity, source)

    def _on_obstacle(self, message: Any) -> None:
        assert self._recorder is not None
        self.score.hear(message)
        message.pos_ned = (np.array(message.pos_ned) + self._origin_ned_m).tolist()
        self._recorder.perception.obstacle(self._step_ns(), message)

    def _on_status(self, message: Any) -> None:
        assert self._recorder is not None
        self.status = message
        self._recorder.perception.companion(self._step_ns(), message)


def findings_from_profile(
    profile: RunProfile,
    scenery: Scenery,
    others: Callable[[], Bodies] | None = None,
    tide_m: Callable[[], float] = lambda: 0.0,
) -> FindingsNode:
    """Return the findings for the companion of the profile, with the truth of its world.

    others, tide_m: as in ObstacleScore.
    """
    sensors, vessel = profile.sensors, profile.vehicle
    looks = sensors is not None and sensors.lidar is not None
    standing = scenery.caster() if looks else None
    score = ObstacleScore((vessel.length_m, vessel.width_m), standing, scenery.water_down_m, others, tide_m)
    return FindingsNode(local_frame(profile.site), score, profile.clock.physics_rate_hz, scenery.boom)
