"""What a station steers by from one moment to the next: targets for GUIDED, and sticks for the manual modes.

None of these messages has an answer in the protocol, so a refusal is a sentence alone.
"""

from __future__ import annotations

import math
from typing import Any

from agent.fcu import modes
from agent.fcu.mavlink.vehicle import Vehicle
from agent.wire import dialect as mav

Messages = list[Any]

_POSITION_IGNORED = mav.POSITION_TARGET_TYPEMASK_X_IGNORE | mav.POSITION_TARGET_TYPEMASK_Y_IGNORE
_VELOCITY_IGNORED = mav.POSITION_TARGET_TYPEMASK_VX_IGNORE | mav.POSITION_TARGET_TYPEMASK_VY_IGNORE
_ACCELERATION_IGNORED = mav.POSITION_TARGET_TYPEMASK_AX_IGNORE | mav.POSITION_TARGET_TYPEMASK_AY_IGNORE
_YAW_IGNORED = mav.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_YAW_RATE_IGNORED = mav.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_GLOBAL_FRAMES = (0, 3, 5, 6, 10, 11)
_BODY_FRAMES = (mav.MAV_FRAME_BODY_NED, mav.MAV_FRAME_BODY_OFFSET_NED, mav.MAV_FRAME_BODY_FRD)
_OFFSET_FRAMES = (mav.MAV_FRAME_LOCAL_OFFSET_NED, *_BODY_FRAMES)
_LOCAL_FRAMES = (mav.MAV_FRAME_LOCAL_NED, *_OFFSET_FRAMES)
_NO_AXIS = 32767


class Targets:
    """Passes on what fits together; the autopilot judges the numbers."""

    def __init__(self, vehicle: Vehicle, system_id: int) -> None:
        self._vehicle = vehicle
        self._autopilot = vehicle.autopilot
        self._system_id = system_id

    # -- GUIDED

    def on_local(self, m: Any, now_ns: int) -> Messages:
        """SET_POSITION_TARGET_LOCAL_NED: in the frame of the origin, or from where the vessel is and heads."""
        if not self._may_steer("Local target", m, _LOCAL_FRAMES, now_ns):
            return []
        estimate = self._autopilot.estimate
        turned_rad = estimate.yaw_rad if m.coordinate_frame in _BODY_FRAMES else 0.0
        if not m.type_mask & _POSITION_IGNORED:
            north_m, east_m = _rotated(m.x, m.y, turned_rad)
            if m.coordinate_frame in _OFFSET_FRAMES:
                north_m, east_m = north_m + estimate.pos_ned_m[0], east_m + estimate.pos_ned_m[1]
            if not math.isfinite(north_m + east_m):
                self._vehicle.warn(f"Local target refused: position {m.x:g}, {m.y:g} is none")
                return []
            self._autopilot.go_to_local(north_m, east_m)
            return []
        return self._steer("Local target", m, turned_rad, now_ns)

    def on_global(self, m: Any, now_ns: int) -> Messages:
        """SET_POSITION_TARGET_GLOBAL_INT."""
        if not self._may_steer("Global target", m, _GLOBAL_FRAMES, now_ns):
            return []
        if not m.type_mask & _POSITION_IGNORED:
            self._autopilot.go_to(m.lat_int / 1e7, m.lon_int / 1e7)
            return []
        return self._steer("Global target", m, 0.0, now_ns)

    def _may_steer(self, name: str, m: Any, frames: tuple[int, ...], now_ns: int) -> bool:
        if m.coordinate_frame not in frames:
            known = ", ".join(map(str, frames))
            self._vehicle.warn(f"{name} refused: frame {m.coordinate_frame} is not supported; use {known}")
            return False
        if self._autopilot.mode != modes.GUIDED:
            self._vehicle.warn(f"{name} ignored: not in GUIDED")
            return False
        return True

    def _steer(self, name: str, m: Any, turned_rad: float, now_ns: int) -> Messages:
        """By velocity, heading and turn rate, in the combinations that ArduRover takes."""
        mask = m.type_mask
        velocity = not mask & _VELOCITY_IGNORED
        yaw_rad = None if mask & _YAW_IGNORED else m.yaw + turned_rad
        yaw_rate_radps = None if mask & _YAW_RATE_IGNORED else m.yaw_rate
        if mask & _ACCELERATION_IGNORED != _ACCELERATION_IGNORED or mask & _POSITION_IGNORED in (1, 2):
            self._vehicle.warn(f"{name} refused: type mask {mask:#06x} asks for what a boat does not do")
            return []
        given = [m.vx, m.vy] if velocity else []
        given += [value for value in (yaw_rad, yaw_rate_radps) if value is not None]
        if not given or not all(map(math.isfinite, given)):
            why = "nothing in it counts" if not given else "not all of its values are numbers"
            self._vehicle.warn(f"{name} refused: {why}")
            return []
        if not velocity:
            if yaw_rate_radps is not None:
                self._autopilot.set_turn_rate(yaw_rate_radps, 0.0)
            elif yaw_rad is not None:
                self._autopilot.set_course(yaw_rad, 0.0)
            return []
        body = m.coordinate_frame in _BODY_FRAMES
        if body and yaw_rate_radps is not None and yaw_rad is None:
            self._autopilot.set_turn_rate(yaw_rate_radps, math.copysign(math.hypot(m.vx, m.vy), m.vx))
            return []
        north_mps, east_mps = _rotated(m.vx, m.vy, turned_rad)
        self._autopilot.set_velocity(north_mps, east_mps, yaw_rad, yaw_rate_radps)
        return []

    # -- sticks

    def on_override(self, m: Any, now_ns: int) -> Messages:
        """RC_CHANNELS_OVERRIDE."""
        self._heard(m, now_ns)
        widths_us = tuple(getattr(m, f"chan{number}_raw") for number in range(1, 19))
        self._autopilot.rc_override(widths_us, now_ns)
        return []

    def on_manual(self, m: Any, now_ns: int) -> Messages:
        """MANUAL_CONTROL: 32767 stands for an axis that is not there."""
        if m.target not in (0, self._system_id):
            return []
        self._heard(m, now_ns)
        axes = [None if value == _NO_AXIS else value for value in (m.x, m.y, m.z, m.r)]
        self._autopilot.manual_control(axes[0], axes[1], axes[2], axes[3], now_ns)
        return []

    def _heard(self, m: Any, now_ns: int) -> None:
        """Who steers is there."""
        self._autopilot.heard_ground_station(m.get_srcSystem(), now_ns)


def _rotated(forward: float, right: float, yaw_rad: float) -> tuple[float, float]:
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return forward * cos - right * sin, forward * sin + right * cos
