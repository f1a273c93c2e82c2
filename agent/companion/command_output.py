"""Command output of the avoidance: takes control from the mission when its path is blocked, and returns it when free.

It commands in GUIDED and takes over only from AUTO. If anybody else changes the mode, it sends nothing until the
autopilot is in AUTO again. It also sends nothing while the pose is unknown: an autopilot in GUIDED stops when its
targets stop.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.companion.autopilot_state import AutopilotState, heading_rad
from agent.companion.avoidance import (
    FREE,
    STAY,
    AvoidanceChoice,
    AvoidancePlanner,
    Obstacles,
    PathLegs,
    crab_heading_rad,
    leg_course_rad,
)
from agent.companion.pose_history import VehiclePose
from agent.companion.settings import TUNED
from agent.mavlink.commands import command_long
from agent.mavlink.exchange import Messages
from agent.mavlink.modes import AUTO, GUIDED
from agent.wire import dialect as mav

Array = NDArray[np.float64]

NONE, DETOUR, STOP, RETURN = (
    int(mav.XITL_MANOEUVRE_NONE),
    int(mav.XITL_MANOEUVRE_DETOUR),
    int(mav.XITL_MANOEUVRE_STOP),
    int(mav.XITL_MANOEUVRE_RETURN),
)

_ASK_AGAIN_NS = 500_000_000
_ASKS = 6
_VELOCITY_AND_YAW = 0x9C7  # POSITION_TARGET_TYPEMASK: all but vx, vy, vz and yaw ignored
_POSITION_ONLY = 0xDF8


class CommandOutput:
    """Commands the autopilot. `update` returns the messages. begin_m: a path with less clearance is blocked."""

    def __init__(self, planner: AvoidancePlanner, begin_m: float, speed_mps: float) -> None:
        self.manoeuvre = NONE
        self.detours = 0
        self.stops = 0
        self.refused = 0  # mode changes that the autopilot did not make
        self._planner = planner
        self._begin_m = begin_m
        self._speed_mps = speed_mps
        self._wanted: int | None = None  # requested mode without acknowledgement yet
        self._asked_ns = 0
        self._asks = 0
        self._engaged = False
        self._blocked = 0
        self._free = 0
        self._course_rad: float | None = None
        self._stay_ne_m: Array | None = None

    def handle_acknowledgement(self, message: Any, vehicle: AutopilotState) -> None:
        """Handle a COMMAND_ACK."""
        if message.command != mav.MAV_CMD_DO_SET_MODE or self._wanted is None:
            return
        wanted, self._wanted = self._wanted, None
        if message.result == mav.MAV_RESULT_ACCEPTED:
            vehicle.set_mode(wanted)
        else:
            self.refused += 1
        if vehicle.mode != GUIDED:
            self._release()

    def update(
        self, vehicle: AutopilotState, pose: VehiclePose | None, around: Obstacles, current_ne_mps: Array, now_ns: int
    ) -> Messages:
        """Return the messages to the autopilot. Called about 5 times a second. current_ne_mps: estimated current."""
        way = vehicle.path_ahead()
        if vehicle.target is None or not vehicle.armed or vehicle.mode not in (AUTO, GUIDED):
            self._release()
            return []
        if pose is None or way is None:
            return []
        if self._wanted is not None:
            return self._ask(vehicle.target, self._wanted, now_ns)
        if self._engaged and vehicle.mode == AUTO:
            self._release()
        if not self._engaged and vehicle.mode != AUTO:
            return []
        pos, vel, bow = pose.pos_ned_m[:2], pose.vel_ned_mps[:2], heading_rad(pose)
        legs = _legs(way.points_ne_m, pos)
        speed = way.speed_mps or self._speed_mps
        ahead = self._planner.check_collision(legs, pos, vel, bow, speed, around)
        if not self._engaged:
            self._blocked = self._blocked + 1 if ahead.blocked else 0
            is_soon = ahead.after_s < TUNED.blocked_soon_s
            if self._blocked < (TUNED.blocked_plans if is_soon else TUNED.blocked_far_plans):
                return []
            self._engaged = True
            return self._ask(vehicle.target, GUIDED, now_ns)
        stays = self._stay_ne_m is not None
        choice = self._planner.choose_course(
            legs, pos, vel, bow, speed, around, self._course_rad, stays, current_ne_mps
        )
        course_rad, off_m = leg_course_rad(legs, pos)
        self._free = self._free + 1 if choice.kind == FREE and ahead.clearance_m >= self._begin_m + TUNED.freer_m else 0
        made_good = math.atan2(vel[1], vel[0]) if math.hypot(*vel.tolist()) > 0.7 else bow
        turned = abs(math.remainder(made_good - course_rad, math.tau))
        along_m, _ = legs.offsets_m(np.zeros(1, dtype=np.int64), pos[None])
        near_end = float(legs.length_m[0] - along_m[0]) < TUNED.end_m  # returning to the leg is pointless
        back = near_end or (abs(off_m) < TUNED.back_m and turned < math.radians(TUNED.back_deg))
        if self._free >= TUNED.free_plans and back:
            return self._ask(vehicle.target, AUTO, now_ns)
        if choice.kind == STAY:
            return [self._stay(vehicle.target, pos, vel, around, current_ne_mps)]
        return [self._go(vehicle.target, choice, course_rad, current_ne_mps)]

    def _release(self) -> None:
        self._engaged, self._wanted, self._course_rad, self._stay_ne_m = False, None, None, None
        self._blocked = self._free = self._asks = 0
        self.manoeuvre = NONE

    def _ask(self, target: tuple[int, int], mode: int, now_ns: int) -> Messages:
        if self._wanted == mode and now_ns - self._asked_ns < _ASK_AGAIN_NS:
            return []
        self._asks = self._asks + 1 if self._wanted == mode else 1
        if self._asks > _ASKS:
            self.refused += 1
            self._release()
            return []
        self._wanted, self._asked_ns = mode, now_ns
        return [
            command_long(target, mav.MAV_CMD_DO_SET_MODE, float(mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), float(mode))
        ]

    def _stay(self, target: tuple[int, int], pos: Array, vel: Array, around: Obstacles, current_ne_mps: Array) -> Any:
        """Hold a position. A commanded speed of zero through the water would drift with the current."""
        place = self._planner.waiting_position(pos, vel, around, current_ne_mps)
        if self._stay_ne_m is None or math.hypot(*(place - self._stay_ne_m).tolist()) > TUNED.moved_m:
            self._stay_ne_m = place
        self._enter(STOP)
        self._course_rad = None
        return _target_message(target, _POSITION_ONLY, self._stay_ne_m, np.zeros(2), 0.0)

    def _go(self, target: tuple[int, int], choice: AvoidanceChoice, leg_rad: float, current_ne_mps: Array) -> Any:
        """Command a velocity and its heading, because not all autopilots compensate for the current."""
        self._stay_ne_m = None
        free = choice.kind == FREE
        course_rad = leg_rad if free else choice.course_rad
        self._course_rad = None if free else course_rad
        self._enter(RETURN if free else DETOUR)
        vel_ne_mps = choice.speed_mps * np.array((math.cos(course_rad), math.sin(course_rad)))
        yaw_rad = crab_heading_rad(course_rad, choice.speed_mps, current_ne_mps)
        return _target_message(target, _VELOCITY_AND_YAW, np.zeros(2), vel_ne_mps, yaw_rad)

    def _enter(self, manoeuvre: int) -> None:
        """Enter a manoeuvre and count it.

        A detour lasts until the vessel is back on the leg, even if the course changes.
        """
        if self.manoeuvre == NONE and manoeuvre != STOP:
            self.detours += 1
        if manoeuvre == STOP and self.manoeuvre != STOP:
            self.stops += 1
        self.manoeuvre = manoeuvre


def _legs(points_ne_m: tuple[tuple[float, float], ...], pos: Array) -> PathLegs:
    """Return the legs ahead.

    Start them here when the vessel is past the end of the first leg, to which the autopilot returns.
    """
    points = np.array(points_ne_m)
    legs = PathLegs(points)
    along_m, _ = legs.offsets_m(np.zeros(1, dtype=np.int64), pos[None])
    if float(along_m[0]) > float(legs.length_m[0]):
        points[0] = pos - 1e-3 * legs.along[0]
        return PathLegs(points)
    return legs


def _target_message(target: tuple[int, int], mask: int, pos_ne_m: Array, vel_ne_mps: Array, yaw_rad: float) -> Any:
    (north, east), (vn, ve) = pos_ne_m.tolist(), vel_ne_mps.tolist()
    return mav.MAVLink_set_position_target_local_ned_message(
        0, *target, mav.MAV_FRAME_LOCAL_NED, mask, north, east, 0.0, vn, ve, 0.0, 0.0, 0.0, 0.0, yaw_rad, 0.0
    )
