"""Obstacle avoidance, from clouds to commands: detection, tracking, collision check, avoidance course, command output.

    avoidance = ObstacleAvoidance(...)
    avoidance.handle(message, now_ns)               each message of the autopilot
    avoidance.add_cloud(stamp_ns, points_frd_m, offset_s, intensity)   each cloud of the lidar
    avoidance.plan(now_ns)                          5 times a second: to the autopilot
    avoidance.proximity_messages(now_ns)            5 to 10 times a second: to the autopilot, and the host
    avoidance.obstacle_messages(now_ns)             at any rate: to the host

Instants are on the companion's clock.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.companion.autopilot_state import AutopilotState, heading_rad
from agent.companion.avoidance import AvoidancePlanner, obstacles_near
from agent.companion.camera_fusion import CameraFusion
from agent.companion.command_output import CommandOutput
from agent.companion.detection import Cluster, ObstacleDetector, find_clusters
from agent.companion.pose_history import VehiclePose
from agent.companion.settings import TUNED
from agent.companion.tracking import CurrentEstimator, ObstacleTrack, ObstacleTracker
from agent.mavlink.exchange import Messages
from agent.wire import dialect as mav

Array = NDArray[np.float64]

SECTORS, SECTOR_DEG = 72, 5
_UNKNOWN = 65535
_LASER = 0  # MAV_DISTANCE_SENSOR
_FORWARD = 0  # MAV_SENSOR_ORIENTATION
_VIEW_SECTORS = 6  # to either side of the bow
_LEAST_CM = 50


def make_proximity_messages(
    points_ne_m: Array, pose: VehiclePose, stamp_ns: int, bow_m: float, range_m: float
) -> list[Any]:
    """Return OBSTACLE_DISTANCE from the body's origin, and DISTANCE_SENSOR from the bow, which is bow_m ahead of it.

    Empty sectors in view are one centimetre beyond the range. Empty sectors out of view are unknown.
    """
    most_cm = min(round(range_m * 100.0), 60_000)
    off = points_ne_m - pose.pos_ned_m[:2]
    bow_rad = heading_rad(pose)
    distance_m = np.hypot(off[:, 0], off[:, 1])
    bearing = np.arctan2(off[:, 1], off[:, 0]) - bow_rad
    sector = np.round(bearing / math.radians(SECTOR_DEG)).astype(np.int64) % SECTORS
    nearest_cm = np.full(SECTORS, np.inf)
    np.minimum.at(nearest_cm, sector, distance_m * 100.0)
    view = np.arange(SECTORS)
    ahead = np.minimum(view, SECTORS - view) <= _VIEW_SECTORS
    empty = np.where(ahead, most_cm + 1, _UNKNOWN)
    occupied = nearest_cm <= most_cm
    distances = np.where(occupied, np.maximum(np.where(occupied, nearest_cm, 0.0), _LEAST_CM), empty).astype(np.int64)
    time_usec = max(stamp_ns // 1000, 0)
    forward_m = distance_m[occupied[sector] & ahead[sector]]
    forward_cm = most_cm + 1 if not len(forward_m) else min(max(round((forward_m.min() - bow_m) * 100.0), 1), most_cm)
    view_rad = math.radians(SECTOR_DEG * (2 * _VIEW_SECTORS + 1))
    return [
        mav.MAVLink_obstacle_distance_message(
            time_usec, _LASER, distances.tolist(), SECTOR_DEG, _LEAST_CM, most_cm, float(SECTOR_DEG), 0.0,
            mav.MAV_FRAME_BODY_FRD,
        ),
        mav.MAVLink_distance_sensor_message(
            (time_usec // 1000) & 0xFFFFFFFF, 1, most_cm, forward_cm, _LASER, 0, _FORWARD, 255, view_rad, view_rad
        ),
    ]  # fmt: skip


class ObstacleAvoidance:
    """Detects, tracks and avoids obstacles, in the autopilot's local NED. Its parts have the counters.

    margin_m: clearance between hull and obstacle.
    horizon_s: horizon of the collision check.
    speed_mps: speed of the vessel if its mission sets none.
    length_m, width_m: size of the vessel.
    waterline_m: depth of the water level below the body's origin.
    range_m: obstacles farther away are ignored.
    avoids: False only detects and tracks.
    view_yaw_rad: direction of the lidar, clockwise from the bow.
    vessels: long objects may be other vessels.
    """

    def __init__(
        self,
        margin_m: float = 3.0,
        horizon_s: float = 12.0,
        speed_mps: float = 3.0,
        length_m: float = 2.3,
        width_m: float = 1.6,
        waterline_m: float = 0.15,
        range_m: float = 60.0,
        avoids: bool = True,
        view_yaw_rad: float = 0.0,
        vessels: bool = False,
    ) -> None:
        self.vehicle = AutopilotState()
        self.tracker = ObstacleTracker(vessels)
        self.detector = ObstacleDetector(range_m, waterline_m)
        self.cameras = CameraFusion(waterline_m)
        self._current = CurrentEstimator()
        begin_m = TUNED.begin_share * margin_m
        planner = AvoidancePlanner(margin_m, begin_m, horizon_s, 0.5 * math.hypot(length_m, width_m))
        self.commands = CommandOutput(planner, begin_m, speed_mps)
        self._bow_m = 0.5 * length_m
        self._range_m = range_m
        self._avoids = avoids
        self._view_yaw_rad = view_yaw_rad
        self._waiting: list[tuple[int, NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]] = []
        self._clusters: list[Cluster] = []  # of the last clouds
        self._cloud_ns: int | None = None
        self._looked_ns = 0

    def handle(self, message: Any, now_ns: int) -> Messages:
        """Handle a message of the autopilot. Return the replies: requests for the mission and for rates."""
        replies = self.vehicle.handle(message, now_ns)
        if message.get_msgId() == mav.MAVLINK_MSG_ID_COMMAND_ACK:
            self.commands.handle_acknowledgement(message, self.vehicle)
        return replies

    def add_cloud(
        self,
        stamp_ns: int,
        points_frd_m: NDArray[np.float32],
        offset_s: NDArray[np.float32],
        intensity: NDArray[np.uint8],
    ) -> None:
        """Add points (n, 3) in body FRD. Each was taken `offset_s` (n,) after `stamp_ns`. intensity: (n,).

        Detect in clouds with a known pose. The others wait for the autopilot's next messages.
        """
        self._waiting.append((stamp_ns, points_frd_m, offset_s, intensity))
        while self._waiting:
            stamp_ns, points, offset_s, intensity = self._waiting[0]
            newest_ns = self.vehicle.history.newest_ns
            last_s = float(np.nanmax(offset_s)) if len(offset_s) else 0.0
            known = newest_ns is not None and newest_ns >= stamp_ns + round(last_s * 1e9)
            if not known and len(self._waiting) <= TUNED.look_waiting_clouds:
                return
            self._waiting.pop(0)
            if self.detector.add_cloud(self.vehicle.history, stamp_ns, points, offset_s, intensity):
                self._cloud_ns = stamp_ns
                pose = self.vehicle.pose_at(stamp_ns)
                if pose is None:
                    continue
                bow_rad = heading_rad(pose)
                self._current.update(stamp_ns, pose.vel_ned_mps, bow_rad, self.vehicle.yaw_rate_radps)
                if 0 <= stamp_ns - self._looked_ns < TUNED.look_ns:
                    continue
                self._looked_ns = stamp_ns
                reach_m = self.detector.water_reach_m
                pos, view_rad, drift = pose.pos_ned_m[:2], bow_rad + self._view_yaw_rad, self._current.current_ne_mps
                self._clusters = find_clusters(self.detector.frames, pos, TUNED.doubtful_share * reach_m)
                self.tracker.update(stamp_ns, self._clusters, pos, view_rad, reach_m, drift)

    def plan(self, now_ns: int) -> Messages:
        """Return messages to the autopilot: mode changes, targets, requests. No targets while the path is free."""
        messages = self.vehicle.poll(now_ns)
        if not self._avoids:
            return messages
        pose = None if self._is_blind(now_ns) else self.vehicle.pose_at(now_ns)
        if pose is None:
            return messages
        pos = pose.pos_ned_m[:2]
        structure = self.tracker.structure.within(pos, TUNED.look_structure_m)
        around = obstacles_near(now_ns, self.tracker.confirmed, structure, pos)
        messages.extend(self.commands.update(self.vehicle, pose, around, self._current.current_ne_mps, now_ns))
        return messages

    def _is_blind(self, now_ns: int) -> bool:
        return self._cloud_ns is None or now_ns - self._cloud_ns > TUNED.look_stale_ns

    def proximity_messages(self, now_ns: int) -> Messages:
        """Return OBSTACLE_DISTANCE and DISTANCE_SENSOR, nothing without clouds or pose."""
        pose = None if self._is_blind(now_ns) else self.vehicle.pose_at(now_ns)
        if pose is None:
            return []
        points = [cluster.points_ne_m for cluster in self._clusters]
        points.append(self.tracker.structure.within(pose.pos_ned_m[:2], self._range_m))
        points.extend(_outline(track, now_ns) for track in self.tracker.confirmed)
        return make_proximity_messages(np.concatenate(points), pose, now_ns, self._bow_m, self._range_m)

    def obstacle_messages(self, now_ns: int) -> Messages:
        """Return an XITL_OBSTACLE of every confirmed track, with its class after the newest images."""
        self.cameras.update(self.vehicle.history, self.tracker.confirmed)
        pose = self.vehicle.pose_at(now_ns)
        if pose is None:
            return []
        bow = pose.pos_ned_m[:2] + self._bow_m * pose.rot_ned_frd[:2, 0]
        messages: Messages = []
        for track in self.tracker.confirmed:
            # Range and closing speed are those of its point that is nearest to the bow.
            off = _outline(track, now_ns) - bow
            nearest = off[int(np.argmin(np.hypot(off[:, 0], off[:, 1])))]
            range_m = float(np.hypot(*nearest))
            closing_mps = -float(nearest @ (track.state[2:] - pose.vel_ned_mps[:2])) / max(range_m, 0.1)
            middle = track.position_at(now_ns) - pose.pos_ned_m[:2]
            bearing_rad = math.remainder(math.atan2(middle[1], middle[0]) - heading_rad(pose), math.tau)
            label, share = self.cameras.class_of(track.number)
            down_m = float(pose.pos_ned_m[2]) + self.detector.waterline_m - 0.5 * track.height_m
            messages.append(
                mav.MAVLink_xitl_obstacle_message(
                    max(track.seen_ns // 1000, 0),
                    (*track.position_at(now_ns).tolist(), down_m),
                    (*track.state[2:].tolist(), 0.0),
                    (track.length_m, track.width_m, track.height_m),
                    track.heading_rad,
                    range_m,
                    closing_mps,
                    track.number,
                    min(track.points, 65535),
                    min(track.hits, 65535),
                    bearing_rad,
                    share,
                    label.encode("ascii", "replace")[:16],
                )
            )
        return messages


def _outline(track: ObstacleTrack, now_ns: int) -> NDArray[np.float64]:
    """Points along the edge of the track's box, (n, 2)."""
    along = np.array((math.cos(track.heading_rad), math.sin(track.heading_rad)))
    across = np.array((-along[1], along[0]))
    forward, right = 0.5 * track.length_m, 0.5 * track.width_m
    steps = np.linspace(-1.0, 1.0, 7)
    sides = [forward * s * along + r * right * across for s in steps for r in (-1.0, 1.0)]
    points: NDArray[np.float64] = track.position_at(now_ns) + np.array(sides)
    return points
