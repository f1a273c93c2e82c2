"""A boat on a river with things adrift, an autopilot that answers, a lidar: what a lookout is tried on.

The boat is kinematic: its guidance is the embedded autopilot's, its turn rate and acceleration are limited, the current
carries it, waves heave and tilt it. What the autopilot tells of its pose is wrong by what a good estimator is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agent.companion.obstacle_avoidance import ObstacleAvoidance
from agent.companion.rigid_motion import quaternion_from_euler, rotation_matrix
from agent.fcu.control.guidance import CourseOverGround, GuidanceGains, GuidanceState, follow_leg, make_leg, wrap_angle
from agent.fcu.parameters import Parameters
from agent.navigation.geodetic import LocalProjection
from agent.wire import dialect as mav
from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water, WaveSpec
from sim_core.environment.waves import FlatWater, realise_waves
from sim_core.sensors.lidar import BodyTrack, Lidar
from sim_core.sensors.optics import WaterSeen
from sim_core.sensors.spec import LidarSpec
from sim_core.world.debris import Body
from sim_core.world.ray_backends import make_caster
from sim_core.world.rays import Bodies, Scene

FRAME_S, STEP_S = 0.1, 0.02
AUTO, GUIDED, HOLD = 10, 15, 4
GAINS = GuidanceGains.from_parameters(Parameters())
ORIGIN = LocalProjection(-8.8, -63.95, 0.0)
HULL_M = (2.3, 1.6)
WATERLINE_M = 0.15
_STRAYS_M, _STRAYS_RAD = 0.3, math.radians(0.3)


@dataclass
class Adrift:
    """A body at pos_ne_m when the run begins; it goes with the current, and by vel_ne_mps besides."""

    body: Body
    pos_ne_m: tuple[float, float]
    heading_rad: float = 0.0
    vel_ne_mps: tuple[float, float] = (0.0, 0.0)
    turn_radps: float = 0.0


@dataclass
class River:
    """waypoints_ne_m: the mission; the boat starts at start_ne_m, at speed, on its way to the first."""

    waypoints_ne_m: Sequence[tuple[float, float]]
    start_ne_m: tuple[float, float] = (0.0, 0.0)
    current_ne_mps: tuple[float, float] = (0.0, 0.0)
    wave_height_m: float = 0.0
    wave_period_s: float = 2.5
    adrift: Sequence[Adrift] = ()
    scene: Scene = field(default_factory=Scene)
    seed: int = 0
    speed_mps: float = 3.0
    points_hz: float = 100_000.0


class Trial:
    """One run; afterwards `least_m` (hull to each body), `seen_at_m` (bow to each body), `modes`, `watch`."""

    def __init__(self, river: River, watch: ObstacleAvoidance | None = None) -> None:
        self.river = river
        self.watch = ObstacleAvoidance() if watch is None else watch
        self.rng = np.random.default_rng(river.seed)
        waves: Any = FlatWater()
        if river.wave_height_m:
            sea = WaveSpec("jonswap", river.wave_height_m, river.wave_period_s, float(self.rng.uniform(0, 360)))
            waves = realise_waves(sea, Water(), self.rng)
        self.environment = Environment(waves=waves)
        self.caster = make_caster(river.scene)
        self.lidar = Lidar(LidarSpec(position_frd_m=(1.0, 0.0, -0.8)))
        self.time_s = 0.0
        self.pos = np.array(river.start_ne_m)
        course = math.atan2(river.waypoints_ne_m[0][1] - self.pos[1], river.waypoints_ne_m[0][0] - self.pos[0])
        self.yaw, self.turn, self.through_mps = course, 0.0, river.speed_mps
        self.mode = AUTO
        self.silent = False  # the companion is heard no more
        self.current_item = 1
        self.guidance = GuidanceState()
        self._line_from(river.start_ne_m)
        self.course = CourseOverGround()
        self.velocity: tuple[float, float] | None = None
        self.place: np.ndarray | None = None
        self.target_s = -9.0
        self.stray = np.zeros(5)  # north, east, roll, pitch, yaw
        self.least_m = [math.inf] * len(river.adrift)
        self.seen_at_m: list[float | None] = [None] * len(river.adrift)
        self.modes: list[tuple[float, int]] = [(0.0, AUTO)]
        self.manoeuvres: list[int] = []
        self.cross_m: list[float] = []
        self.sent: list[Any] = []
        self.false = 0
        self.least_scene_m = math.inf

    # -- the world

    def bodies_at(self, time_s: float) -> Bodies:
        adrift = self.river.adrift
        places = np.array([self.place_of(one, time_s) for one in adrift]).reshape(-1, 2)
        lift = np.asarray(self.environment.surface_ned_z_m(time_s, places))
        depth = np.array([one.body.middle_below_surface_m for one in adrift])
        vel = np.array([(*self._drift(one), 0.0) for one in adrift]).reshape(-1, 3)
        turned = [one.heading_rad + one.turn_radps * time_s for one in adrift]
        rot = np.array([rotation_matrix(quaternion_from_euler(0.0, 0.0, yaw)) for yaw in turned]).reshape(-1, 3, 3)
        return Bodies(tuple(one.body.mesh for one in adrift), np.column_stack([places, lift + depth]), vel, rot)

    def _drift(self, one: Adrift) -> tuple[float, float]:
        (cn, ce), (vn, ve) = self.river.current_ne_mps, one.vel_ne_mps
        return cn + vn, ce + ve

    def place_of(self, one: Adrift, time_s: float) -> tuple[float, float]:
        vn, ve = self._drift(one)
        return one.pos_ne_m[0] + vn * time_s, one.pos_ne_m[1] + ve * time_s

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """The true place (3,) and attitude (3, 3): the hull rides on the waves that are longer than it."""
        ahead = np.array((math.cos(self.yaw), math.sin(self.yaw)))
        right = np.array((-ahead[1], ahead[0]))
        points = np.array((self.pos + ahead, self.pos - ahead, self.pos + 0.6 * right, self.pos - 0.6 * right))
        bow, stern, starboard, port = self.environment.surface_ned_z_m(self.time_s, points).tolist()
        pitch, roll = math.atan2(stern - bow, 2.0), math.atan2(starboard - port, 1.2)
        down = 0.25 * (bow + stern + starboard + port) - WATERLINE_M
        return np.array((*self.pos, down)), rotation_matrix(quaternion_from_euler(roll, pitch, self.yaw))

    # -- the autopilot

    def _line_from(self, start: tuple[float, float]) -> None:
        points = self.river.waypoints_ne_m
        number = self.current_item - 1
        after = points[number + 1] if number + 1 < len(points) else None
        self.line = make_leg(start, points[number], after)

    def _step(self) -> None:
        current = np.array(self.river.current_ne_mps)
        bow = np.array((math.cos(self.yaw), math.sin(self.yaw)))
        vel = self.through_mps * bow + current
        speed = float(vel @ bow)
        heading, wanted = self.yaw, 0.0
        if self.mode == AUTO:
            self.guidance, output = follow_leg(
                GAINS, self.guidance, self.line, tuple(self.pos), self.yaw, speed, self.river.speed_mps, STEP_S
            )
            heading, wanted = output.heading_rad, output.speed_mps
            self.cross_m.append(output.cross_track_m)
            if output.reached:
                if self.current_item < len(self.river.waypoints_ne_m):
                    self.current_item += 1
                    self._line_from(self.river.waypoints_ne_m[self.current_item - 2])
                else:
                    self.set_mode(HOLD)
        elif self.mode == GUIDED:
            if self.velocity is not None and self.time_s - self.target_s > 3.0:
                self.velocity, self.place = None, self.pos + vel
            if self.velocity is not None and math.hypot(*self.velocity) > 0.05:
                made = math.atan2(self.velocity[1], self.velocity[0])
                heading = self.course.heading_rad(GAINS, made, tuple(vel), STEP_S)
                wanted = math.hypot(*self.velocity)
            elif self.place is not None:
                off = self.place - self.pos
                distance = float(np.hypot(*off))
                if distance > 2.0:
                    heading = math.atan2(off[1], off[0])
                    wanted = min(0.4 * distance, 1.5) * max(math.cos(heading - self.yaw), 0.0)
        rate = min(max(1.5 * wrap_angle(heading - self.yaw), -0.45), 0.45)
        self.turn += min(max(rate - self.turn, -1.57 * STEP_S), 1.57 * STEP_S)
        self.yaw = wrap_angle(self.yaw + self.turn * STEP_S)
        self.through_mps += min(max(2.0 * (wanted - speed), -0.9), 0.7) * STEP_S
        self.through_mps = max(self.through_mps, -0.5)
        self.pos = self.pos + vel * STEP_S
        self.vel = vel
        self.time_s += STEP_S

    def set_mode(self, mode: int) -> None:
        if mode == AUTO and self.mode != AUTO:
            self.guidance = GuidanceState()
            self._line_from(tuple(self.pos))
        if mode == GUIDED:
            self.velocity, self.place, self.course = (
                None,
                self.pos + getattr(self, "vel", np.zeros(2)),
                CourseOverGround(),
            )
        if mode != self.mode:
            self.modes.append((self.time_s, mode))
        self.mode = mode

    def order(self, message: Any) -> list[Any]:
        """What the autopilot does and answers."""
        kind = message.get_type()
        self.sent.append(message)
        points = self.river.waypoints_ne_m
        if kind == "MISSION_REQUEST_LIST":
            return [mav.MAVLink_mission_count_message(0, 0, len(points) + 1, 0)]
        if kind == "MISSION_REQUEST_INT":
            where = ORIGIN.to_geodetic(*((0.0, 0.0) if message.seq == 0 else points[message.seq - 1]))
            lat, lon = (round(1e7 * degrees) for degrees in where)
            return [mav.MAVLink_mission_item_int_message(0, 0, message.seq, 6, 16, 0, 1, 0, 0, 0, 0, lat, lon, 0.0, 0)]
        if kind == "PARAM_REQUEST_READ":
            return [mav.MAVLink_param_value_message(b"WP_SPEED", self.river.speed_mps, 9, 1, 0)]
        if kind == "COMMAND_LONG" and message.command == mav.MAV_CMD_DO_SET_MODE:
            self.set_mode(int(message.param2))
            return [mav.MAVLink_command_ack_message(message.command, 0)]
        if kind == "SET_POSITION_TARGET_LOCAL_NED" and self.mode == GUIDED:
            self.target_s = self.time_s
            if message.type_mask & 7:
                self.velocity, self.place = (message.vx, message.vy), None
            else:
                self.velocity, self.place = None, np.array((message.x, message.y))
        return []

    def _tell(self, tick: int) -> list[Any]:
        boot_ms = round(self.time_s * 1e3)
        said: list[Any] = []
        pos, rot = self.pose()
        if tick % 2 == 0:
            roll, pitch, yaw = self.stray[2:]
            stray = rotation_matrix(quaternion_from_euler(roll, pitch, yaw))
            quat = _quaternion_of(rot @ stray)
            said.append(mav.MAVLink_attitude_quaternion_message(boot_ms, *quat, 0.0, 0.0, self.turn))
        if tick % 5 == 0:
            self.stray *= math.exp(-0.1 / 20.0)
            scale = np.array([_STRAYS_M] * 2 + [_STRAYS_RAD] * 3)
            self.stray += scale * math.sqrt(2 * 0.1 / 20.0) * self.rng.standard_normal(5)
            where = pos + np.array((*self.stray[:2], 0.0))
            vel = np.array((*self.vel, 0.0)) + 0.03 * self.rng.standard_normal(3)
            said.append(mav.MAVLink_local_position_ned_message(boot_ms, *where.tolist(), *vel.tolist()))
        if tick % 50 == 0:
            mode = mav.MAV_MODE_FLAG_SAFETY_ARMED | mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            said.append(mav.MAVLink_heartbeat_message(11, 0, mode, self.mode, 4, 3))
            lat, lon = (round(1e7 * degrees) for degrees in ORIGIN.to_geodetic(0.0, 0.0))
            said.append(mav.MAVLink_gps_global_origin_message(lat, lon, 0, 0))
        if tick % 25 == 0:
            said.append(mav.MAVLink_mission_current_message(self.current_item, len(self.river.waypoints_ne_m)))
        return said

    def say(self, messages: list[Any]) -> None:
        """To the companion, which may answer."""
        for message in messages:
            message.get_header().srcSystem = message.get_header().srcComponent = 1
            for answer in self.watch.handle(message, round(self.time_s * 1e9)):
                self.say(self.order(answer))

    # -- a run

    def run(self, seconds: float) -> Trial:
        """Until then, or until the mission is over."""
        self.vel = np.array(self.river.current_ne_mps)
        tick = round(self.time_s / STEP_S)
        poses, stamps = [self.pose()], [round(self.time_s * 1e9)]
        began_s = self.time_s
        while self.time_s < seconds and self.mode != HOLD:
            self.say(self._tell(tick))
            self._step()
            tick += 1
            poses.append(self.pose())
            stamps.append(round(self.time_s * 1e9))
            if tick % round(FRAME_S / STEP_S):
                continue
            if not self.silent:
                self._look(began_s, stamps, poses, tick)
            self._judge()
            poses, stamps, began_s = poses[-1:], stamps[-1:], self.time_s
        return self

    def _look(self, began_s: float, stamps: list[int], poses: list[Any], tick: int) -> None:
        track = BodyTrack(
            np.array(stamps), np.array([pose[0] for pose in poses]), np.array([pose[1] for pose in poses])
        )
        water = WaterSeen.around(self.environment, began_s, poses[0][0])
        scan = self.lidar.scan(track, self.caster, water, self.rng, self.bodies_at(began_s))
        self.watch.add_cloud(scan.stamp_ns, scan.points_frd_m, scan.offset_s, scan.intensity)
        if tick % 10 == 0:
            for message in self.watch.plan(round(self.time_s * 1e9)):
                self.say(self.order(message))
        self.manoeuvres.append(self.watch.commands.manoeuvre)

    def _judge(self) -> None:
        now_ns = round(self.time_s * 1e9)
        tracks = self.watch.tracker.confirmed
        bow = self.pos + 0.5 * HULL_M[0] * np.array((math.cos(self.yaw), math.sin(self.yaw)))
        near = [False] * len(tracks)
        for number, one in enumerate(self.river.adrift):
            place = np.array(self.place_of(one, self.time_s))
            heading = one.heading_rad + one.turn_radps * self.time_s
            axis = place + np.outer(
                np.linspace(-1, 1, 21) * one.body.half_axis_m, (math.cos(heading), math.sin(heading))
            )
            self.least_m[number] = min(
                self.least_m[number], float(_hull_gap(self.pos, self.yaw, axis).min()) - one.body.radius_m
            )
            for index, track in enumerate(tracks):
                if np.hypot(*(track.position_at(now_ns) - place)) < 2.0 + 0.5 * one.body.length_m:
                    near[index] = True
                    if self.seen_at_m[number] is None:
                        gap = np.hypot(*(axis - bow).T).min() - one.body.radius_m
                        self.seen_at_m[number] = float(gap)
        self.false = max(self.false, len(tracks) - sum(near))


def _hull_gap(pos: np.ndarray, yaw: float, points: np.ndarray) -> np.ndarray:
    """From the outline of the hull to points (n, 2); 0 inside."""
    off = points - pos
    forward = off @ np.array((math.cos(yaw), math.sin(yaw)))
    right = off @ np.array((-math.sin(yaw), math.cos(yaw)))
    return np.hypot(np.maximum(np.abs(forward) - 0.5 * HULL_M[0], 0), np.maximum(np.abs(right) - 0.5 * HULL_M[1], 0))


def _quaternion_of(rot: np.ndarray) -> list[float]:
    """w, x, y, z of a rotation of less than half a turn about anything but the vertical."""
    yaw, pitch = math.atan2(rot[1, 0], rot[0, 0]), -math.asin(max(-1.0, min(1.0, rot[2, 0])))
    roll = math.atan2(rot[2, 1], rot[2, 2])
    return quaternion_from_euler(roll, pitch, yaw).tolist()
