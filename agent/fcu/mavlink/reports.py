"""The messages that tell a station how the vessel is: one function each, None when there is nothing to say yet.

All units and ranges are those of the public MAVLink definitions; what this autopilot cannot know has the value that
stands for unknown there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import agent
from agent.fcu import modes
from agent.fcu.mavlink.motion_reports import MOTION_REPORTS, boot_ms, float32
from agent.fcu.mavlink.vehicle import Vehicle
from agent.fcu.pilot import COMPLETE, UNDER_WAY
from agent.wire import dialect as mav

Report = Callable[[Vehicle, int], Any]

_PROBLEM_BITS = {
    "IMU": mav.MAV_SYS_STATUS_SENSOR_3D_GYRO | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL,
    "AHRS": mav.MAV_SYS_STATUS_AHRS,
    "EKF": mav.MAV_SYS_STATUS_AHRS,
    "Compass": mav.MAV_SYS_STATUS_SENSOR_3D_MAG,
    "GPS": mav.MAV_SYS_STATUS_SENSOR_GPS,
    "Baro": mav.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
}
_PRESENT = mav.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS | mav.MAV_SYS_STATUS_PREARM_CHECK | mav.MAV_SYS_STATUS_GEOFENCE
for _bits in _PROBLEM_BITS.values():
    _PRESENT |= _bits

_STEERS_ITSELF = (modes.AUTO, modes.RTL, modes.LOITER, modes.GUIDED)
_TAKES_INPUT = (modes.MANUAL, modes.ACRO, modes.STEERING)
_LANDED_ON_GROUND = 1

# The release of ArduRover whose services these are; ground stations choose their parameter descriptions by it.
ARDUROVER_VERSION = (4, 5, 0)
_OFFICIAL = 255
_CAPABILITIES = (
    mav.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
)


def heartbeat(vehicle: Vehicle, now_ns: int) -> Any:
    """A surface boat under ArduPilot."""
    autopilot = vehicle.autopilot
    base_mode = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    if autopilot.mode == modes.AUTO:
        base_mode |= mav.MAV_MODE_FLAG_AUTO_ENABLED
    if autopilot.mode in _STEERS_ITSELF:
        base_mode |= mav.MAV_MODE_FLAG_GUIDED_ENABLED
    if autopilot.mode in _TAKES_INPUT:
        base_mode |= mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    if autopilot.armed:
        base_mode |= mav.MAV_MODE_FLAG_SAFETY_ARMED
    if autopilot.failsafes:
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


def sys_status(vehicle: Vehicle, now_ns: int) -> Any:
    """Which sensors are there and well, and whether arming would be refused."""
    autopilot = vehicle.autopilot
    health = _PRESENT
    for problem in autopilot.estimator.problems():
        health &= ~_PROBLEM_BITS.get(problem.split(":", 1)[0], 0)
    if autopilot.failsafe:
        health &= ~_PROBLEM_BITS["IMU"]
    if autopilot.prearm_problems():
        health &= ~mav.MAV_SYS_STATUS_PREARM_CHECK
    if autopilot.fence.breach.outside:
        health &= ~mav.MAV_SYS_STATUS_GEOFENCE
    enabled = _PRESENT if autopilot.fence.enabled else _PRESENT & ~mav.MAV_SYS_STATUS_GEOFENCE
    return mav.MAVLink_sys_status_message(_PRESENT, enabled, health, 0, 65535, -1, -1, 0, 0, 0, 0, 0, 0)


def system_time(vehicle: Vehicle, now_ns: int) -> Any:
    """The receivers here tell no date: the UTC field stays 0."""
    return mav.MAVLink_system_time_message(0, boot_ms(now_ns))


def nav_controller_output(vehicle: Vehicle, now_ns: int) -> Any | None:
    autopilot = vehicle.autopilot
    output = autopilot.navigation
    if output is None:
        return None
    return mav.MAVLink_nav_controller_output_message(
        0.0,
        0.0,
        round(math.degrees(output.heading_rad)),
        round(math.degrees(output.bearing_rad)),
        min(round(output.distance_m), 65535),
        0.0,
        autopilot.speed_error_mps,
        float32(output.cross_track_m),
    )


def mission_current(vehicle: Vehicle, now_ns: int) -> Any:
    autopilot = vehicle.autopilot
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


def battery_status(vehicle: Vehicle, now_ns: int) -> Any:
    """Nothing measures the battery."""
    return mav.MAVLink_battery_status_message(0, 0, 0, 32767, [65535] * 10, -1, -1, -1, -1, 0, 0, [0] * 4, 0, 0)


def autopilot_version(vehicle: Vehicle, now_ns: int) -> Any:
    """Services as of ARDUROVER_VERSION; the own version as that of the middleware."""
    major, minor, patch = (int(part) if part.isdigit() else 0 for part in (agent.__version__ + ".0.0").split(".")[:3])
    nothing = [0] * 8
    return mav.MAVLink_autopilot_version_message(
        _CAPABILITIES,
        _version(*ARDUROVER_VERSION) | _OFFICIAL,
        _version(major, minor, patch),
        0,
        0,
        nothing,
        nothing,
        nothing,
        0,
        0,
        0,
        [0] * 18,
    )


def _version(major: int, minor: int, patch: int) -> int:
    return (major & 0xFF) << 24 | (minor & 0xFF) << 16 | (patch & 0xFF) << 8


def extended_sys_state(vehicle: Vehicle, now_ns: int) -> Any:
    """A boat is never in the air."""
    return mav.MAVLink_extended_sys_state_message(0, _LANDED_ON_GROUND)


def fence_status(vehicle: Vehicle, now_ns: int) -> Any | None:
    fence = vehicle.autopilot.fence
    if not fence.enabled:
        return None
    breach = fence.breach
    return mav.MAVLink_fence_status_message(
        int(breach.outside), breach.count & 0xFFFF, breach.kind, boot_ms(breach.time_ns), 0
    )


REPORTS: Mapping[int, Report] = {
    **MOTION_REPORTS,
    mav.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mav.MAVLINK_MSG_ID_SYS_STATUS: sys_status,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: system_time,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: nav_controller_output,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: mission_current,
    mav.MAVLINK_MSG_ID_BATTERY_STATUS: battery_status,
    mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: autopilot_version,
    mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: extended_sys_state,
    mav.MAVLINK_MSG_ID_FENCE_STATUS: fence_status,
}
