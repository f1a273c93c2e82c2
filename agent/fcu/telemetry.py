"""Telemetry: what the autopilot says on its own, each message at its rate."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from agent.fcu import modes
from agent.fcu.autopilot import Autopilot
from agent.fcu.pilot import COMPLETE, UNDER_WAY
from agent.wire import dialect as mav

Messages = list[Any]

RATES_HZ: Mapping[int, float] = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mav.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: 2.0,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 1.0,
}

_TEXT_BYTES = 50
_PROBLEM_BITS = {
    "IMU": mav.MAV_SYS_STATUS_SENSOR_3D_GYRO | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL,
    "AHRS": mav.MAV_SYS_STATUS_AHRS,
    "EKF": mav.MAV_SYS_STATUS_AHRS,
    "Compass": mav.MAV_SYS_STATUS_SENSOR_3D_MAG,
    "GPS": mav.MAV_SYS_STATUS_SENSOR_GPS,
    "Baro": mav.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
}
_PRESENT = mav.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS | mav.MAV_SYS_STATUS_PREARM_CHECK
for _bits in _PROBLEM_BITS.values():
    _PRESENT |= _bits


class Telemetry:
    """Builds the messages that are due. A message with nothing to say yet is left out."""

    def __init__(self, autopilot: Autopilot, rates_hz: Mapping[int, float] = RATES_HZ) -> None:
        self._autopilot = autopilot
        self._text_id = 0
        self._builders: dict[int, Callable[[int], Any]] = {
            mav.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mav.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude,
            mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._local_position,
            mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: self._navigation,
            mav.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._origin,
        }
        for message_id, rate_hz in rates_hz.items():
            if message_id not in self._builders or not 0.0 < rate_hz <= 1000.0:
                raise ValueError(f"telemetry: message {message_id} at {rate_hz:g} Hz; use {sorted(self._builders)}")
        self._periods_ns = {message_id: round(1e9 / rate_hz) for message_id, rate_hz in rates_hz.items()}
        self._due_ns: dict[int, int] = {}

    def due(self, now_ns: int) -> Messages:
        """What is due at `now_ns`, and every event since the last call."""
        messages: Messages = []
        for message_id, period_ns in self._periods_ns.items():
            due_ns = self._due_ns.get(message_id, now_ns)
            if due_ns - period_ns <= now_ns < due_ns:
                continue
            # On the grid of its period, unless the clock was set or a whole period was slept through.
            on_grid = due_ns <= now_ns < due_ns + period_ns
            self._due_ns[message_id] = (due_ns if on_grid else now_ns) + period_ns
            message = self._builders[message_id](now_ns)
            if message is not None:
                messages.append(message)
        for seq in self._autopilot.take_reached():
            messages.append(mav.MAVLink_mission_item_reached_message(seq))
        for event in self._autopilot.take_events():
            messages.extend(self.statustext(event.severity, event.text))
        return messages

    def one(self, message_id: int, now_ns: int) -> Any | None:
        """One message now, None when it is not known or has nothing to say."""
        builder = self._builders.get(message_id)
        return None if builder is None else builder(now_ns)

    def statustext(self, severity: int, text: str) -> Messages:
        """A sentence, in chunks of 50 bytes when it is longer."""
        data = text.encode("ascii", "replace")
        if len(data) <= _TEXT_BYTES:
            return [mav.MAVLink_statustext_message(severity, data)]
        self._text_id = self._text_id % 65535 + 1
        chunks = [data[at : at + _TEXT_BYTES] for at in range(0, min(len(data), 255 * _TEXT_BYTES), _TEXT_BYTES)]
        return [mav.MAVLink_statustext_message(severity, chunk, self._text_id, n) for n, chunk in enumerate(chunks)]

    def _heartbeat(self, now_ns: int) -> Any:
        autopilot = self._autopilot
        base_mode = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if autopilot.mode == modes.AUTO:
            base_mode |= mav.MAV_MODE_FLAG_AUTO_ENABLED | mav.MAV_MODE_FLAG_GUIDED_ENABLED
        if autopilot.mode == modes.MANUAL:
            base_mode |= mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        if autopilot.armed:
            base_mode |= mav.MAV_MODE_FLAG_SAFETY_ARMED
        if autopilot.failsafe:
            status = mav.MAV_STATE_CRITICAL
        elif autopilot.armed:
            status = mav.MAV_STATE_ACTIVE
        elif any(problem.startswith("AHRS") for problem in autopilot.estimator.problems()):
            status = mav.MAV_STATE_CALIBRATING
        else:
            status = mav.MAV_STATE_STANDBY
        return mav.MAVLink_heartbeat_message(
            mav.MAV_TYPE_SURFACE_BOAT, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode, autopilot.mode, status, 3
        )

    def _sys_status(self, now_ns: int) -> Any:
        health = _PRESENT
        for problem in self._autopilot.estimator.problems():
            health &= ~_PROBLEM_BITS.get(problem.split(":", 1)[0], 0)
        if self._autopilot.failsafe:
            health &= ~_PROBLEM_BITS["IMU"]
        if self._autopilot.prearm_problems():
            health &= ~mav.MAV_SYS_STATUS_PREARM_CHECK
        return mav.MAVLink_sys_status_message(_PRESENT, _PRESENT, health, 0, 65535, -1, -1, 0, 0, 0, 0, 0, 0)

    def _attitude(self, now_ns: int) -> Any:
        estimate = self._autopilot.estimate
        return mav.MAVLink_attitude_quaternion_message(
            _boot_ms(now_ns), *estimate.quat_ned_frd, *estimate.gyro_frd_radps
        )

    def _local_position(self, now_ns: int) -> Any | None:
        estimate = self._autopilot.estimate
        if not estimate.position_valid:
            return None
        return mav.MAVLink_local_position_ned_message(
            _boot_ms(now_ns), *map(_float32, estimate.pos_ned_m), *map(_float32, estimate.vel_ned_mps)
        )

    def _global_position(self, now_ns: int) -> Any | None:
        estimate, frame, home = self._autopilot.estimate, self._autopilot.estimator.frame, self._autopilot.home
        if frame is None or not estimate.position_valid:
            return None
        north_m, east_m, down_m = estimate.pos_ned_m
        lat_deg, lon_deg = frame.to_geodetic(north_m, east_m)
        alt_m = frame.alt_m - down_m
        relative_m = alt_m - (home.alt_m if home is not None else frame.alt_m)
        vx, vy, vz = (_whole(100.0 * v, 32767) for v in estimate.vel_ned_mps)
        return mav.MAVLink_global_position_int_message(
            _boot_ms(now_ns),
            _whole(lat_deg * 1e7, 2147483647),
            _whole(lon_deg * 1e7, 2147483647),
            _whole(alt_m * 1e3, 2147483647),
            _whole(relative_m * 1e3, 2147483647),
            vx,
            vy,
            vz,
            round(math.degrees(estimate.yaw_rad) * 100.0) % 36000,
        )

    def _navigation(self, now_ns: int) -> Any | None:
        autopilot = self._autopilot
        output = autopilot.pilot.output
        if output is None or autopilot.mode != modes.AUTO:
            return None
        return mav.MAVLink_nav_controller_output_message(
            0.0,
            0.0,
            round(math.degrees(output.heading_rad)),
            round(math.degrees(output.bearing_rad)),
            min(round(output.distance_m), 65535),
            0.0,
            autopilot.speed_error_mps,
            _float32(output.cross_track_m),
        )

    def _mission_current(self, now_ns: int) -> Any:
        autopilot = self._autopilot
        pilot, waypoints = autopilot.pilot, autopilot.mission.waypoints()
        if not waypoints:
            state = 1
        elif pilot.state == COMPLETE:
            state = 5
        elif pilot.state == UNDER_WAY:
            state = 3 if autopilot.mode == modes.AUTO else 4
        else:
            state = 2
        seq = pilot.current or (waypoints[-1] if waypoints else 0)
        total = max(0, len(autopilot.mission.items) - 1)
        return mav.MAVLink_mission_current_message(seq, total, state, 1 if autopilot.mode == modes.AUTO else 2)

    def _origin(self, now_ns: int) -> Any | None:
        frame = self._autopilot.estimator.frame
        if frame is None:
            return None
        lat, lon = round(frame.lat_deg * 1e7), round(frame.lon_deg * 1e7)
        return mav.MAVLink_gps_global_origin_message(
            lat, lon, _whole(frame.alt_m * 1e3, 2147483647), max(0, now_ns // 1000) & 0xFFFFFFFFFFFFFFFF
        )


def _boot_ms(now_ns: int) -> int:
    return (now_ns // 1_000_000) & 0xFFFFFFFF


def _whole(value: float, limit: int) -> int:
    return round(min(max(value, -limit), limit))


def _float32(value: float) -> float:
    return min(max(value, -3e38), 3e38)
