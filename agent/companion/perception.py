"""Perception of a run: odometry and map from clouds and pings, and obstacle avoidance from the same clouds."""

from __future__ import annotations

from collections import deque
from typing import Any, Callable

import numpy as np

from agent.companion.camera_fusion import ImageDetection
from agent.companion.clouds import CloudReassembler, PointCloud, cloud_messages
from agent.companion.mapping import LIDAR, SONAR, CloudMap, MapPoints
from agent.companion.obstacle_avoidance import ObstacleAvoidance
from agent.companion.odometry import LidarOdometry, OdometryError, no_motion
from agent.companion.odometry_filters import AutopilotMotionSource
from agent.companion.pose_history import AHEAD_NS
from agent.companion.rigid_motion import quaternion_of
from agent.companion.settings import CompanionParameters
from agent.companion.sonar import PingReassembler, SonarPing, echo_points
from agent.mavlink.exchange import Messages
from agent.wire import dialect as mav

WINDOW_NS = 20_000_000_000


class SensorClock:
    """Converts the sensors' clock to this machine's clock. The shortest recent delay of a cloud is taken as zero delay.

    In lockstep both clocks are the same.
    """

    def __init__(self, lockstep: bool) -> None:
        self._lockstep = lockstep
        self._since_ns: int | None = None
        self._least_ns: int | None = None
        self._before_ns: int | None = None

    def note_arrival(self, stamp_ns: int, now_ns: int) -> None:
        """Note that data complete at `stamp_ns` of the sensors' clock arrived at `now_ns` of this machine's clock."""
        took_ns = now_ns - stamp_ns
        if self._since_ns is None or now_ns - self._since_ns > WINDOW_NS:
            self._since_ns, self._before_ns, self._least_ns = now_ns, self._least_ns, took_ns
        elif self._least_ns is None or took_ns < self._least_ns:
            self._least_ns = took_ns

    def own_ns(self, stamp_ns: int) -> int:
        """Convert an instant of the sensors' clock to this machine's clock."""
        if self._lockstep or self._least_ns is None:
            return stamp_ns
        least_ns = self._least_ns if self._before_ns is None else min(self._least_ns, self._before_ns)
        return stamp_ns + least_ns


MOST_WAITING = 3
"""Clouds that may wait for the odometry. A companion that is too slow drops clouds and does not fall behind."""
PATIENCE_NS = 150_000_000
"""Time that a cloud waits for the autopilot's motion before it is registered without it."""
UNAIDED_CLOUDS = 300
"""Number of clouds without the autopilot's motion in a run before a report."""
MOST_PINGS = 32
"""Pings that may wait for a cloud."""
_LOCAL_FRD, _BODY_FRD = 20, 12  # MAV_FRAME
_UNKNOWN = [float("nan")] + [0.0] * 20
_LIDAR_ESTIMATOR = 6  # MAV_ESTIMATOR_TYPE


class Perception:
    """Odometry, map and obstacle avoidance of one run. `say(text)` reports to the user.

    parameters: current values.
    avoidance: runs on this machine's clock.
    """

    def __init__(
        self, parameters: CompanionParameters, avoidance: ObstacleAvoidance, lockstep: bool, say: Callable[[str], None]
    ) -> None:
        self.avoidance = avoidance
        self._clouds = CloudReassembler()
        self._pings = PingReassembler()
        self._clock = SensorClock(lockstep)
        self._waiting: deque[PointCloud] = deque()
        self._seen: deque[PointCloud] = deque()  # processed by the avoidance; waiting for the autopilot's motion
        self._aided = bool(parameters["ODO_AIDED"])
        self._say = say
        self._reported_unaided = False
        self._echoes: deque[SonarPing] = deque()
        self._clouds_dropped = self._pings_mapped = 0
        self._latency_s = 0.0
        self._numbers = {LIDAR: 0, SONAR: 0}
        self._odometry: LidarOdometry | None = None
        self._map: CloudMap | None = None
        if parameters["ODO_ENABLE"]:
            try:
                motions = AutopilotMotionSource(avoidance.vehicle.history, self._clock.own_ns)
                motion = motions.motion_between if self._aided else no_motion
                self._odometry = LidarOdometry(parameters["ODO_RANGE"], parameters["ODO_VOXEL"], motion=motion)
            except OdometryError as error:
                say(str(error))
        if parameters["MAP_ENABLE"] and self._odometry is not None:
            self._map = CloudMap(parameters["MAP_CELL"], parameters["MAP_RANGE"])

    @property
    def clouds(self) -> int:
        """Number of clouds received so far, complete or partial."""
        return self._clouds.clouds + self._clouds.clouds_partial

    def handle(self, message: Any, now_ns: int) -> bool:
        """Store a chunk of a cloud or a ping, or a detection of a camera. Return False for any other message."""
        if isinstance(message, mav.MAVLink_xitl_cloud_message):
            for cloud in self._clouds.handle(message):
                if cloud.kind != mav.XITL_CLOUD_KIND_LIDAR:
                    continue
                if len(cloud.offset_s):
                    self._clock.note_arrival(cloud.end_ns, now_ns)
                if len(self._waiting) == MOST_WAITING:
                    self._waiting.popleft()
                    self._clouds_dropped += 1
                self._waiting.append(cloud)
            return True
        if isinstance(message, mav.MAVLink_xitl_ping_message):
            self._echoes.extend(self._pings.handle(message))
            return True
        if isinstance(message, mav.MAVLink_xitl_detection_message):
            stamp_ns = self._clock.own_ns(message.time_usec * 1000)
            self.avoidance.cameras.add(ImageDetection.from_message(message, stamp_ns))
            return True
        return False

    def process(self, now_ns: Callable[[], int]) -> Messages:
        """Process the waiting clouds and pings. Return messages to the host."""
        messages: Messages = []
        while self._waiting:
            cloud = self._waiting.popleft()
            self.avoidance.add_cloud(
                self._clock.own_ns(cloud.stamp_ns), cloud.points_m, cloud.offset_s, cloud.intensity
            )
            self._seen.append(cloud)
        while self._seen and self._is_due(self._seen[0], now_ns()):
            cloud = self._seen.popleft()
            messages += self._register(cloud)
            if len(cloud.offset_s):
                self._latency_s = max(now_ns() - self._clock.own_ns(cloud.end_ns), 0) * 1e-9
        while self._echoes:
            # A waiting cloud that began before the ping will provide its pose.
            awaited = bool(self._seen) and self._seen[0].stamp_ns <= self._echoes[0].stamp_ns
            if awaited and len(self._echoes) <= MOST_PINGS:
                break
            messages += self._map_ping(self._echoes.popleft())
        return messages

    def _is_due(self, cloud: PointCloud, now_ns: int) -> bool:
        """Whether the autopilot's motion covers the cloud, or waiting for it is hopeless."""
        newest_ns = self.avoidance.vehicle.history.newest_ns
        if self._odometry is None or not self._aided or newest_ns is None:
            return True
        end_ns = self._clock.own_ns(cloud.end_ns)
        late_ns = end_ns - newest_ns
        hopeless = late_ns > AHEAD_NS or now_ns - end_ns > PATIENCE_NS or len(self._seen) > MOST_WAITING
        return late_ns <= 0 or hopeless

    def _register(self, cloud: PointCloud) -> Messages:
        if self._odometry is None:
            return []
        placed = self._odometry.register(cloud.stamp_ns, cloud.points_m, cloud.offset_s)
        if self._aided and self._odometry.unaided == UNAIDED_CLOUDS and not self._reported_unaided:
            self._reported_unaided = True
            self._say("the odometry uses clouds alone: the autopilot sent no attitude and velocity for 30 s of clouds")
        if placed is None:
            return []
        messages: Messages = [
            mav.MAVLink_odometry_message(  # at the cloud's last point, on the sensors' clock, of unknown quality
                placed.stamp_ns // 1000, _LOCAL_FRD, _BODY_FRD, *placed.pose_odom[:3, 3].tolist(),
                quaternion_of(placed.pose_odom[:3, :3]), *placed.vel_frd_mps.tolist(), 0.0, 0.0, 0.0,
                _UNKNOWN, _UNKNOWN, 0, _LIDAR_ESTIMATOR, 0,
            )
        ]  # fmt: skip
        if self._map is not None:
            added = self._map.add(placed.pose_odom, placed.points_frd_m, cloud.intensity[placed.kept])
            messages += self._map_messages(placed.stamp_ns, added, LIDAR)
        return messages

    def _map_ping(self, ping: SonarPing) -> Messages:
        self._pings_mapped += 1
        if self._odometry is None or self._map is None:
            return []
        pose = self._odometry.pose_at(ping.stamp_ns)
        if pose is None:
            return []
        points_frd_m, intensity = echo_points(ping)
        return self._map_messages(ping.stamp_ns, self._map.add(pose, points_frd_m, intensity, SONAR), SONAR)

    def _map_messages(self, stamp_ns: int, added: MapPoints, source: int) -> Messages:
        points = added.points_odom_m
        if not len(points):
            return []
        self._numbers[source] += 1
        origin = tuple(np.round(points.mean(axis=0)).tolist())
        still = np.zeros(len(points), dtype=np.float32)
        kind = source + 1
        return cloud_messages(PointCloud(kind, self._numbers[source], stamp_ns, points, still, added.intensity), origin)

    def status(self, now_ns: int) -> Any:
        """Return XITL_COMPANION_STATUS."""
        clouds, odometry, avoidance = self._clouds, self._odometry, self.avoidance
        poses, refused, points = (0, 0, 0) if odometry is None else (
            odometry.poses, odometry.poses_refused, odometry.points_refused
        )  # fmt: skip
        return mav.MAVLink_xitl_companion_status_message(
            now_ns // 1000, clouds.clouds, clouds.clouds_partial, clouds.chunks_lost + self._pings.chunks_lost,
            self._clouds_dropped, clouds.points, clouds.points_refused + points, self._pings_mapped, poses, refused,
            0 if self._map is None else len(self._map), avoidance.tracker.total, avoidance.commands.detours,
            avoidance.commands.stops, self._latency_s, avoidance.commands.manoeuvre, avoidance.detector.unplaced,
            avoidance.detector.early, avoidance.cameras.received, avoidance.cameras.matched, avoidance.cameras.dropped,
            avoidance.cameras.early,
        )  # fmt: skip
