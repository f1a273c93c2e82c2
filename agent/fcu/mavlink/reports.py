"""Messages that report the state of the vessel to a station: one function each, which returns None without data.

All units and ranges are those of the public MAVLink definitions. Values that this autopilot cannot know are set to
"unknown" as defined there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Callable

import agent
from agent.fcu.control.allocation import pulse_width_us
from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.vehicle import modes, navigation
from agent.fcu.vehicle.mission_progress import COMPLETE, UNDER_WAY
from agent.mavlink.exchange import HEADING_DEVIATION
from agent.navigation.geodetic import STANDARD_GRAVITY_MPS2
from agent.wire import dialect as mav

Report = Callable[[MavlinkHub, int], Any]

_INT32 = 2147483647
# EKF_STATUS_FLAGS
_EKF_ATTITUDE, _EKF_VELOCITY_HORIZ, _EKF_VELOCITY_VERT = 1, 2, 4
_EKF_POS_HORIZ_REL, _EKF_POS_HORIZ_ABS, _EKF_POS_VERT_ABS = 8, 16, 32
_EKF_PRED_POS_HORIZ_REL, _EKF_PRED_POS_HORIZ_ABS, _EKF_UNINITIALIZED = 256, 512, 1024

_MASK_POSITION = 0x0DF8  # only x, y and z are used
_MASK_VELOCITY = 0x0DC7  # only vx, vy and vz are used
_MASK_COURSE = 0x09C7  # velocity and yaw
_MASK_TURN = 0x05C7  # velocity and yaw rate

_PROBLEM_BITS = {
    "INS": mav.MAV_SYS_STATUS_SENSOR_3D_GYRO | mav.MAV_SYS_STATUS_SENSOR_3D_ACCEL,
    "AHRS": mav.MAV_SYS_STATUS_AHRS,
    "EKF": mav.MAV_SYS_STATUS_AHRS,
    "Compass": mav.MAV_SYS_STATUS_SENSOR_3D_MAG,
    "GPS": mav.MAV_SYS_STATUS_SENSOR_GPS,
    "Baro": mav.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
}
_PRESENT = mav.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS | mav.MAV_SYS_STATUS_PREARM_CHECK | mav.MAV_SYS_STATUS_GEOFENCE
for _bits in _PROBLEM_BITS.values():
    _PRESENT |= _bits

_LANDED_ON_GROUND = 1

# The ArduRover release with the same services. Ground stations choose their parameter descriptions by it.
ARDUROVER_VERSION = (4, 5, 0)
_OFFICIAL = 255
_CAPABILITIES = (
    mav.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mav.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mav.MAV_PROTOCOL_CAPABILITY_FTP
    | mav.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mav.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mav.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mav.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
)


def _boot_ms(now_ns: int) -> int:
    """The agent's clock as `time_boot_ms`."""
    return (now_ns // 1_000_000) & 0xFFFFFFFF


def _whole(value: float, limit: int) -> int:
    """Round a value and limit it to an integer field."""
    return round(min(max(value, -limit), limit))


def _float32(value: float) -> float:
    """Limit a value to the range of a 32-bit float."""
    return min(max(value, -3e38), 3e38)


def attitude(hub: MavlinkHub, now_ns: int) -> Any:
    estimate = hub.autopilot.state.estimate
    return mav.MAVLink_attitude_message(
        _boot_ms(now_ns), estimate.roll_rad, estimate.pitch_rad, estimate.yaw_rad, *estimate.gyro_frd_radps
    )


def attitude_quaternion(hub: MavlinkHub, now_ns: int) -> Any:
    estimate = hub.autopilot.state.estimate
    return mav.MAVLink_attitude_quaternion_message(_boot_ms(now_ns), *estimate.quat_ned_frd, *estimate.gyro_frd_radps)


def local_position(hub: MavlinkHub, now_ns: int) -> Any | None:
    estimate = hub.autopilot.state.estimate
    if not estimate.position_valid:
        return None
    return mav.MAVLink_local_position_ned_message(
        _boot_ms(now_ns), *map(_float32, estimate.pos_ned_m), *map(_float32, estimate.vel_ned_mps)
    )


def global_position(hub: MavlinkHub, now_ns: int) -> Any | None:
    autopilot = hub.autopilot
    estimate, frame, home = autopilot.state.estimate, autopilot.estimator.frame, autopilot.navigator.home
    if frame is None or not estimate.position_valid:
        return None
    north_m, east_m, down_m = estimate.pos_ned_m
    lat_deg, lon_deg = frame.to_geodetic(north_m, east_m)
    alt_m = frame.alt_m - down_m
    relative_m = alt_m - (home.alt_m if home is not None else frame.alt_m)
    vx, vy, vz = (_whole(100.0 * v, 32767) for v in estimate.vel_ned_mps)
    return mav.MAVLink_global_position_int_message(
        _boot_ms(now_ns),
        _whole(lat_deg * 1e7, _INT32),
        _whole(lon_deg * 1e7, _INT32),
        _whole(alt_m * 1e3, _INT32),
        _whole(relative_m * 1e3, _INT32),
        vx,
        vy,
        vz,
        round(math.degrees(estimate.yaw_rad) * 100.0) % 36000,
    )


def origin(hub: MavlinkHub, now_ns: int) -> Any | None:
    frame = hub.autopilot.estimator.frame
    if frame is None:
        return None
    lat, lon = round(frame.lat_deg * 1e7), round(frame.lon_deg * 1e7)
    return mav.MAVLink_gps_global_origin_message(
        lat, lon, _whole(frame.alt_m * 1e3, _INT32), max(0, now_ns // 1000) & 0xFFFFFFFFFFFFFFFF
    )


def home_position(hub: MavlinkHub, now_ns: int) -> Any | None:
    home, frame = hub.autopilot.navigator.home, hub.autopilot.estimator.frame
    if home is None:
        return None
    x_m = y_m = z_m = 0.0
    if frame is not None:
        x_m, y_m = frame.to_local(home.lat_deg, home.lon_deg)
        z_m = frame.alt_m - home.alt_m
    return mav.MAVLink_home_position_message(
        _whole(home.lat_deg * 1e7, _INT32),
        _whole(home.lon_deg * 1e7, _INT32),
        _whole(home.alt_m * 1e3, _INT32),
        _float32(x_m),
        _float32(y_m),
        _float32(z_m),
        [1.0, 0.0, 0.0, 0.0],
        0.0,
        0.0,
        0.0,
        max(0, now_ns // 1000) & 0xFFFFFFFFFFFFFFFF,
    )


def vfr_hud(hub: MavlinkHub, now_ns: int) -> Any:
    """VFR_HUD. No airspeed is measured, so the field contains the speed over ground."""
    autopilot = hub.autopilot
    estimate, frame = autopilot.state.estimate, autopilot.estimator.frame
    vn, ve, vd = estimate.vel_ned_mps
    speed_mps = _float32(math.hypot(vn, ve))
    throttles = hub.actuators.command[: autopilot.allocator.mixer.throttles]
    throttle = round(100.0 * min(abs(sum(throttles)) / max(len(throttles), 1), 1.0))
    alt_m = 0.0 if frame is None else frame.alt_m - estimate.pos_ned_m[2]
    heading_deg = round(math.degrees(estimate.yaw_rad)) % 360
    return mav.MAVLink_vfr_hud_message(speed_mps, speed_mps, heading_deg, throttle, _float32(alt_m), _float32(-vd))


def gps_raw(hub: MavlinkHub, now_ns: int) -> Any:
    """GPS_RAW_INT of the newest fix. Without one, it reports a missing receiver."""
    fix, unknown = hub.gnss, 65535
    if fix is None:
        return mav.MAVLink_gps_raw_int_message(0, 0, 0, 0, 0, unknown, unknown, unknown, unknown, 255)
    vn, ve, _ = fix.vel_ned_mps
    return mav.MAVLink_gps_raw_int_message(
        max(0, now_ns // 1000),
        fix.fix_type,
        _whole(fix.lat_deg * 1e7, _INT32),
        _whole(fix.lon_deg * 1e7, _INT32),
        _whole(fix.alt_m * 1e3, _INT32),
        unknown,
        unknown,
        min(round(100.0 * math.hypot(vn, ve)), 65534),
        round(math.degrees(math.atan2(ve, vn)) * 100.0) % 36000,
        fix.satellites,
        0,
        _whole(fix.horizontal_accuracy_m * 1e3, _INT32),
        _whole(fix.vertical_accuracy_m * 1e3, _INT32),
        _whole(fix.speed_accuracy_mps * 1e3, _INT32),
    )


def raw_imu(hub: MavlinkHub, now_ns: int) -> Any | None:
    """RAW_IMU in milli-g, milliradians per second and milligauss, as in ArduPilot."""
    imu, magnetometer = hub.imu, hub.magnetometer
    if imu is None:
        return None
    accel = (_whole(1e3 * a / STANDARD_GRAVITY_MPS2, 32767) for a in imu.accel_frd_mps2)
    gyro = (_whole(1e3 * w, 32767) for w in imu.gyro_frd_radps)
    field = (0.0, 0.0, 0.0) if magnetometer is None else magnetometer.field_frd_gauss
    temperature = _whole(100.0 * imu.temperature_degc, 32767) if math.isfinite(imu.temperature_degc) else 0
    return mav.MAVLink_raw_imu_message(
        max(0, now_ns // 1000), *accel, *gyro, *(_whole(1e3 * b, 32767) for b in field), 0, temperature
    )


def scaled_pressure(hub: MavlinkHub, now_ns: int) -> Any | None:
    sample = hub.barometer
    if sample is None:
        return None
    temperature = _whole(100.0 * sample.temperature_degc, 32767) if math.isfinite(sample.temperature_degc) else 0
    return mav.MAVLink_scaled_pressure_message(_boot_ms(now_ns), _float32(sample.pressure_pa / 100.0), 0.0, temperature)


def servo_output(hub: MavlinkHub, now_ns: int) -> Any:
    """SERVO_OUTPUT_RAW: the motor outputs, and the outputs that DO_SET_SERVO has set."""
    command = hub.actuators.command
    pulses = list(hub.autopilot.servos.widths_us)
    for output, part in zip(hub.autopilot.allocator.mixer.outputs, command):
        if output:
            pulses[output - 1] = pulse_width_us(part)
    return mav.MAVLink_servo_output_raw_message((now_ns // 1000) & 0xFFFFFFFF, 0, *pulses)


def rc_channels(hub: MavlinkHub, now_ns: int) -> Any | None:
    pulses = hub.autopilot.manual.widths_us(hub.autopilot.state.now_ns)
    if not any(pulses):
        return None
    channels = (list(pulses) + [0] * 18)[:18]
    return mav.MAVLink_rc_channels_message(_boot_ms(now_ns), 18, *(pulse or 65535 for pulse in channels), 255)


def ekf_status(hub: MavlinkHub, now_ns: int) -> Any:
    """EKF_STATUS_REPORT: innovations divided by their gates, which ArduPilot calls variances here."""
    return mav.MAVLink_ekf_status_report_message(_estimator_flags(hub), *_test_ratios(hub), 0.0, 0.0)


def estimator_status(hub: MavlinkHub, now_ns: int) -> Any | None:
    """ESTIMATOR_STATUS: the same ratios, and the accuracy of both horizontal axes together, as in a receiver."""
    variances = hub.autopilot.estimator.variances()
    if variances is None:
        return None
    return mav.MAVLink_estimator_status_message(
        max(0, now_ns // 1000),
        _estimator_flags(hub),
        *_test_ratios(hub),
        0.0,
        0.0,
        _float32(math.sqrt(2.0 * variances.horizontal_m2)),
        _float32(math.sqrt(variances.vertical_m2)),
    )


def heading_accuracy(hub: MavlinkHub, now_ns: int) -> Any | None:
    """NAMED_VALUE_FLOAT `yaw_std`: standard deviation of the heading."""
    variances = hub.autopilot.estimator.variances()
    if variances is None or not variances.heading_rad2 >= 0.0:
        return None
    return mav.MAVLink_named_value_float_message(
        _boot_ms(now_ns), HEADING_DEVIATION.encode(), _float32(math.sqrt(variances.heading_rad2))
    )


def _estimator_flags(hub: MavlinkHub) -> int:
    estimate = hub.autopilot.state.estimate
    flags = _EKF_ATTITUDE if estimate.attitude_valid else _EKF_UNINITIALIZED
    if estimate.position_valid:
        flags |= _EKF_VELOCITY_HORIZ | _EKF_VELOCITY_VERT | _EKF_POS_HORIZ_REL | _EKF_POS_HORIZ_ABS
        flags |= _EKF_POS_VERT_ABS | _EKF_PRED_POS_HORIZ_REL | _EKF_PRED_POS_HORIZ_ABS
    return flags


def _test_ratios(hub: MavlinkHub) -> tuple[float, ...]:
    ratios = hub.autopilot.estimator.ratios
    squares = (ratios.velocity, ratios.position, ratios.height, ratios.heading)
    return tuple(_float32(math.sqrt(max(square, 0.0))) for square in squares)


def _target(hub: MavlinkHub) -> tuple[int, float, float, float, float, float, float] | None:
    """Type mask, latitude, longitude, velocity north and east, yaw and yaw rate of the GUIDED target."""
    target = hub.autopilot.guided_target
    if target is None:
        return None
    yaw_rad = 0.0 if target.heading_rad is None else target.heading_rad
    if target.kind == navigation.POSITION:
        return _MASK_POSITION, target.lat_deg, target.lon_deg, 0.0, 0.0, 0.0, 0.0
    if target.kind == navigation.VELOCITY:
        mask = _MASK_VELOCITY if target.heading_rad is None else _MASK_COURSE
        return mask, 0.0, 0.0, target.north_mps, target.east_mps, yaw_rad, 0.0
    if target.kind == navigation.COURSE:
        north_mps, east_mps = target.speed_mps * math.cos(yaw_rad), target.speed_mps * math.sin(yaw_rad)
        return _MASK_COURSE, 0.0, 0.0, north_mps, east_mps, yaw_rad, 0.0
    yaw_rad = hub.autopilot.state.estimate.yaw_rad
    north_mps, east_mps = target.speed_mps * math.cos(yaw_rad), target.speed_mps * math.sin(yaw_rad)
    return _MASK_TURN, 0.0, 0.0, north_mps, east_mps, 0.0, target.turn_rate_radps


def target_local(hub: MavlinkHub, now_ns: int) -> Any | None:
    target, frame = _target(hub), hub.autopilot.estimator.frame
    if target is None or frame is None:
        return None
    mask, lat_deg, lon_deg, vn, ve, yaw_rad, yaw_rate_radps = target
    x_m, y_m = frame.to_local(lat_deg, lon_deg) if mask == _MASK_POSITION else (0.0, 0.0)
    return mav.MAVLink_position_target_local_ned_message(
        _boot_ms(now_ns),
        1,
        mask,
        _float32(x_m),
        _float32(y_m),
        0.0,
        vn,
        ve,
        0.0,
        0.0,
        0.0,
        0.0,
        yaw_rad,
        yaw_rate_radps,
    )


def target_global(hub: MavlinkHub, now_ns: int) -> Any | None:
    target = _target(hub)
    if target is None:
        return None
    mask, lat_deg, lon_deg, vn, ve, yaw_rad, yaw_rate_radps = target
    lat, lon = _whole(lat_deg * 1e7, _INT32), _whole(lon_deg * 1e7, _INT32)
    return mav.MAVLink_position_target_global_int_message(
        _boot_ms(now_ns), 6, mask, lat, lon, 0.0, vn, ve, 0.0, 0.0, 0.0, 0.0, yaw_rad, yaw_rate_radps
    )


def heartbeat(hub: MavlinkHub, now_ns: int) -> Any:
    """HEARTBEAT of a surface boat with ArduPilot."""
    autopilot = hub.autopilot
    base_mode = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    if autopilot.state.mode == modes.AUTO:
        base_mode |= mav.MAV_MODE_FLAG_AUTO_ENABLED
    if modes.BY_NUMBER[autopilot.state.mode].steers_itself:
        base_mode |= mav.MAV_MODE_FLAG_GUIDED_ENABLED
    elif autopilot.state.mode != modes.HOLD:
        base_mode |= mav.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    if autopilot.state.armed:
        base_mode |= mav.MAV_MODE_FLAG_SAFETY_ARMED
    if autopilot.failsafes.active:
        status = mav.MAV_STATE_CRITICAL
    elif autopilot.state.armed:
        status = mav.MAV_STATE_ACTIVE
    elif any(problem.check == "AHRS" for problem in autopilot.estimator.problems()):
        status = mav.MAV_STATE_CALIBRATING
    else:
        status = mav.MAV_STATE_STANDBY
    return mav.MAVLink_heartbeat_message(
        mav.MAV_TYPE_SURFACE_BOAT, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, base_mode, autopilot.state.mode, status, 3
    )


def sys_status(hub: MavlinkHub, now_ns: int) -> Any:
    """SYS_STATUS: present and healthy sensors, and the pre-arm check."""
    autopilot = hub.autopilot
    health = _PRESENT
    for problem in autopilot.estimator.problems():
        health &= ~_PROBLEM_BITS.get(problem.check, 0)
    if autopilot.failsafes.imu_lost:
        health &= ~_PROBLEM_BITS["INS"]
    if autopilot.prearm_problems():
        health &= ~mav.MAV_SYS_STATUS_PREARM_CHECK
    if autopilot.fence.breach.outside:
        health &= ~mav.MAV_SYS_STATUS_GEOFENCE
    enabled = _PRESENT if autopilot.fence.enabled else _PRESENT & ~mav.MAV_SYS_STATUS_GEOFENCE
    return mav.MAVLink_sys_status_message(_PRESENT, enabled, health, 0, 65535, -1, -1, 0, 0, 0, 0, 0, 0)


def system_time(hub: MavlinkHub, now_ns: int) -> Any:
    """SYSTEM_TIME: UTC after the first fix, 0 before."""
    return mav.MAVLink_system_time_message(hub.autopilot.utc_us or 0, _boot_ms(now_ns))


def nav_controller_output(hub: MavlinkHub, now_ns: int) -> Any | None:
    autopilot = hub.autopilot
    output = autopilot.navigator.output
    if output is None:
        return None
    return mav.MAVLink_nav_controller_output_message(
        0.0,
        0.0,
        round(math.degrees(output.heading_rad)),
        round(math.degrees(output.bearing_rad)),
        min(round(output.distance_m), 65535),
        0.0,
        autopilot.state.speed_error_mps,
        _float32(output.cross_track_m),
    )


def mission_current(hub: MavlinkHub, now_ns: int) -> Any:
    autopilot = hub.autopilot
    pilot, waypoints = autopilot.navigator.progress, autopilot.navigator.mission.waypoints()
    if not waypoints:
        state = 1
    elif pilot.state == COMPLETE:
        state = 5
    elif pilot.state == UNDER_WAY:
        state = 3 if autopilot.state.mode == modes.AUTO else 4
    else:
        state = 2
    seq = pilot.current or (waypoints[-1] if waypoints else 0)
    total = max(0, len(autopilot.navigator.mission.items) - 1)
    return mav.MAVLink_mission_current_message(seq, total, state, 1 if autopilot.state.mode == modes.AUTO else 2)


def battery_status(hub: MavlinkHub, now_ns: int) -> Any:
    """BATTERY_STATUS with unknown values, because nothing measures the battery."""
    return mav.MAVLink_battery_status_message(0, 0, 0, 32767, [65535] * 10, -1, -1, -1, -1, 0, 0, [0] * 4, 0, 0)


def autopilot_version(hub: MavlinkHub, now_ns: int) -> Any:
    """AUTOPILOT_VERSION: services of ARDUROVER_VERSION, with the agent's version as the middleware version."""
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


def extended_sys_state(hub: MavlinkHub, now_ns: int) -> Any:
    """EXTENDED_SYS_STATE: a boat is always on the ground."""
    return mav.MAVLink_extended_sys_state_message(0, _LANDED_ON_GROUND)


def fence_status(hub: MavlinkHub, now_ns: int) -> Any | None:
    fence = hub.autopilot.fence
    if not fence.enabled:
        return None
    breach = fence.breach
    return mav.MAVLink_fence_status_message(
        int(breach.outside), breach.count & 0xFFFF, breach.kind, _boot_ms(breach.time_ns), 0
    )


REPORTS: Mapping[int, Report] = {
    mav.MAVLINK_MSG_ID_ATTITUDE: attitude,
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: attitude_quaternion,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: local_position,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: global_position,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: origin,
    mav.MAVLINK_MSG_ID_HOME_POSITION: home_position,
    mav.MAVLINK_MSG_ID_VFR_HUD: vfr_hud,
    mav.MAVLINK_MSG_ID_GPS_RAW_INT: gps_raw,
    mav.MAVLINK_MSG_ID_RAW_IMU: raw_imu,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE: scaled_pressure,
    mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: servo_output,
    mav.MAVLINK_MSG_ID_RC_CHANNELS: rc_channels,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ekf_status,
    mav.MAVLINK_MSG_ID_ESTIMATOR_STATUS: estimator_status,
    mav.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: heading_accuracy,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: target_local,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: target_global,
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
