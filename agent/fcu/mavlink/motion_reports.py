"""The reports of motion: attitude, position, targets, and the sensors and pulses behind them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from agent.fcu.control import guided
from agent.fcu.control.allocation import pulse_width_us
from agent.fcu.local_frame import STANDARD_GRAVITY_MPS2
from agent.fcu.mavlink.vehicle import Vehicle
from agent.wire import dialect as mav

_INT32 = 2147483647
# EKF_STATUS_FLAGS
_EKF_ATTITUDE, _EKF_VELOCITY_HORIZ, _EKF_VELOCITY_VERT = 1, 2, 4
_EKF_POS_HORIZ_REL, _EKF_POS_HORIZ_ABS, _EKF_POS_VERT_ABS = 8, 16, 32
_EKF_PRED_POS_HORIZ_REL, _EKF_PRED_POS_HORIZ_ABS, _EKF_UNINITIALIZED = 256, 512, 1024

_MASK_POSITION = 0x0DF8  # only x, y and z count
_MASK_VELOCITY = 0x0DC7  # only vx, vy and vz count
_MASK_COURSE = 0x09C7  # velocity and yaw
_MASK_TURN = 0x05C7  # velocity and yaw rate


def boot_ms(now_ns: int) -> int:
    """The agent's clock as `time_boot_ms`."""
    return (now_ns // 1_000_000) & 0xFFFFFFFF


def whole(value: float, limit: int) -> int:
    """A value as an integer field of that limit has it."""
    return round(min(max(value, -limit), limit))


def float32(value: float) -> float:
    """A value that fits the wire."""
    return min(max(value, -3e38), 3e38)


def attitude(vehicle: Vehicle, now_ns: int) -> Any:
    estimate = vehicle.autopilot.estimate
    return mav.MAVLink_attitude_message(
        boot_ms(now_ns), estimate.roll_rad, estimate.pitch_rad, estimate.yaw_rad, *estimate.gyro_frd_radps
    )


def attitude_quaternion(vehicle: Vehicle, now_ns: int) -> Any:
    estimate = vehicle.autopilot.estimate
    return mav.MAVLink_attitude_quaternion_message(boot_ms(now_ns), *estimate.quat_ned_frd, *estimate.gyro_frd_radps)


def local_position(vehicle: Vehicle, now_ns: int) -> Any | None:
    estimate = vehicle.autopilot.estimate
    if not estimate.position_valid:
        return None
    return mav.MAVLink_local_position_ned_message(
        boot_ms(now_ns), *map(float32, estimate.pos_ned_m), *map(float32, estimate.vel_ned_mps)
    )


def global_position(vehicle: Vehicle, now_ns: int) -> Any | None:
    autopilot = vehicle.autopilot
    estimate, frame, home = autopilot.estimate, autopilot.estimator.frame, autopilot.home
    if frame is None or not estimate.position_valid:
        return None
    north_m, east_m, down_m = estimate.pos_ned_m
    lat_deg, lon_deg = frame.to_geodetic(north_m, east_m)
    alt_m = frame.alt_m - down_m
    relative_m = alt_m - (home.alt_m if home is not None else frame.alt_m)
    vx, vy, vz = (whole(100.0 * v, 32767) for v in estimate.vel_ned_mps)
    return mav.MAVLink_global_position_int_message(
        boot_ms(now_ns),
        whole(lat_deg * 1e7, _INT32),
        whole(lon_deg * 1e7, _INT32),
        whole(alt_m * 1e3, _INT32),
        whole(relative_m * 1e3, _INT32),
        vx,
        vy,
        vz,
        round(math.degrees(estimate.yaw_rad) * 100.0) % 36000,
    )


def origin(vehicle: Vehicle, now_ns: int) -> Any | None:
    frame = vehicle.autopilot.estimator.frame
    if frame is None:
        return None
    lat, lon = round(frame.lat_deg * 1e7), round(frame.lon_deg * 1e7)
    return mav.MAVLink_gps_global_origin_message(
        lat, lon, whole(frame.alt_m * 1e3, _INT32), max(0, now_ns // 1000) & 0xFFFFFFFFFFFFFFFF
    )


def home_position(vehicle: Vehicle, now_ns: int) -> Any | None:
    home, frame = vehicle.autopilot.home, vehicle.autopilot.estimator.frame
    if home is None:
        return None
    x_m = y_m = z_m = 0.0
    if frame is not None:
        x_m, y_m = frame.to_local(home.lat_deg, home.lon_deg)
        z_m = frame.alt_m - home.alt_m
    return mav.MAVLink_home_position_message(
        whole(home.lat_deg * 1e7, _INT32),
        whole(home.lon_deg * 1e7, _INT32),
        whole(home.alt_m * 1e3, _INT32),
        float32(x_m),
        float32(y_m),
        float32(z_m),
        [1.0, 0.0, 0.0, 0.0],
        0.0,
        0.0,
        0.0,
        max(0, now_ns // 1000) & 0xFFFFFFFFFFFFFFFF,
    )


def vfr_hud(vehicle: Vehicle, now_ns: int) -> Any:
    """No airspeed is measured; a boat's station shows the speed over ground there."""
    autopilot = vehicle.autopilot
    estimate, frame = autopilot.estimate, autopilot.estimator.frame
    vn, ve, vd = estimate.vel_ned_mps
    speed_mps = float32(math.hypot(vn, ve))
    motors = vehicle.actuators.command
    throttle = round(100.0 * min(abs(sum(motors)) / max(len(motors), 1), 1.0))
    alt_m = 0.0 if frame is None else frame.alt_m - estimate.pos_ned_m[2]
    heading_deg = round(math.degrees(estimate.yaw_rad)) % 360
    return mav.MAVLink_vfr_hud_message(speed_mps, speed_mps, heading_deg, throttle, float32(alt_m), float32(-vd))


def gps_raw(vehicle: Vehicle, now_ns: int) -> Any:
    """The newest fix; without one, a receiver that is not there."""
    fix, unknown = vehicle.gnss, 65535
    if fix is None:
        return mav.MAVLink_gps_raw_int_message(0, 0, 0, 0, 0, unknown, unknown, unknown, unknown, 255)
    vn, ve, _ = fix.vel_ned_mps
    return mav.MAVLink_gps_raw_int_message(
        max(0, now_ns // 1000),
        fix.fix_type,
        whole(fix.lat_deg * 1e7, _INT32),
        whole(fix.lon_deg * 1e7, _INT32),
        whole(fix.alt_m * 1e3, _INT32),
        unknown,
        unknown,
        min(round(100.0 * math.hypot(vn, ve)), 65534),
        round(math.degrees(math.atan2(ve, vn)) * 100.0) % 36000,
        fix.satellites,
        0,
        whole(fix.horizontal_accuracy_m * 1e3, _INT32),
        whole(fix.vertical_accuracy_m * 1e3, _INT32),
        whole(fix.speed_accuracy_mps * 1e3, _INT32),
    )


def raw_imu(vehicle: Vehicle, now_ns: int) -> Any | None:
    """In milli-g, milliradians a second and milligauss, as ArduPilot fills it."""
    imu, magnetometer = vehicle.imu, vehicle.magnetometer
    if imu is None:
        return None
    accel = (whole(1e3 * a / STANDARD_GRAVITY_MPS2, 32767) for a in imu.accel_frd_mps2)
    gyro = (whole(1e3 * w, 32767) for w in imu.gyro_frd_radps)
    field = (0.0, 0.0, 0.0) if magnetometer is None else magnetometer.field_frd_gauss
    temperature = whole(100.0 * imu.temperature_degc, 32767) if math.isfinite(imu.temperature_degc) else 0
    return mav.MAVLink_raw_imu_message(
        max(0, now_ns // 1000), *accel, *gyro, *(whole(1e3 * b, 32767) for b in field), 0, temperature
    )


def scaled_pressure(vehicle: Vehicle, now_ns: int) -> Any | None:
    sample = vehicle.barometer
    if sample is None:
        return None
    temperature = whole(100.0 * sample.temperature_degc, 32767) if math.isfinite(sample.temperature_degc) else 0
    return mav.MAVLink_scaled_pressure_message(boot_ms(now_ns), float32(sample.pressure_pa / 100.0), 0.0, temperature)


def servo_output(vehicle: Vehicle, now_ns: int) -> Any:
    """Outputs 1 and 3 are port and starboard, as ArduRover wires a boat with skid steering."""
    command = vehicle.actuators.command
    pulses = [0] * 16
    pulses[0], pulses[2] = pulse_width_us(command[0]), pulse_width_us(command[1])
    return mav.MAVLink_servo_output_raw_message((now_ns // 1000) & 0xFFFFFFFF, 0, *pulses)


def rc_channels(vehicle: Vehicle, now_ns: int) -> Any | None:
    pulses = vehicle.autopilot.rc_channels
    if not any(pulses):
        return None
    channels = (list(pulses) + [0] * 18)[:18]
    return mav.MAVLink_rc_channels_message(boot_ms(now_ns), 18, *(pulse or 65535 for pulse in channels), 255)


def ekf_status(vehicle: Vehicle, now_ns: int) -> Any:
    """The innovations over their gates, which is what ArduPilot calls variances here."""
    estimator, estimate = vehicle.autopilot.estimator, vehicle.autopilot.estimate
    ratios = estimator.ratios
    flags = _EKF_ATTITUDE if estimate.attitude_valid else _EKF_UNINITIALIZED
    if estimate.position_valid:
        flags |= _EKF_VELOCITY_HORIZ | _EKF_VELOCITY_VERT | _EKF_POS_HORIZ_REL | _EKF_POS_HORIZ_ABS
        flags |= _EKF_POS_VERT_ABS | _EKF_PRED_POS_HORIZ_REL | _EKF_PRED_POS_HORIZ_ABS
    return mav.MAVLink_ekf_status_report_message(
        flags,
        float32(math.sqrt(max(ratios.velocity, 0.0))),
        float32(math.sqrt(max(ratios.position, 0.0))),
        float32(math.sqrt(max(ratios.height, 0.0))),
        float32(math.sqrt(max(ratios.heading, 0.0))),
        0.0,
        0.0,
    )


def _target(vehicle: Vehicle) -> tuple[int, float, float, float, float, float, float] | None:
    """Type mask, latitude, longitude, velocity north and east, yaw and yaw rate of what GUIDED steers for."""
    target = vehicle.autopilot.guided_target
    if target is None:
        return None
    yaw_rad = 0.0 if target.heading_rad is None else target.heading_rad
    if target.kind == guided.POSITION:
        return _MASK_POSITION, target.lat_deg, target.lon_deg, 0.0, 0.0, 0.0, 0.0
    if target.kind == guided.VELOCITY:
        mask = _MASK_VELOCITY if target.heading_rad is None else _MASK_COURSE
        return mask, 0.0, 0.0, target.north_mps, target.east_mps, yaw_rad, 0.0
    if target.kind == guided.COURSE:
        north_mps, east_mps = target.speed_mps * math.cos(yaw_rad), target.speed_mps * math.sin(yaw_rad)
        return _MASK_COURSE, 0.0, 0.0, north_mps, east_mps, yaw_rad, 0.0
    yaw_rad = vehicle.autopilot.estimate.yaw_rad
    north_mps, east_mps = target.speed_mps * math.cos(yaw_rad), target.speed_mps * math.sin(yaw_rad)
    return _MASK_TURN, 0.0, 0.0, north_mps, east_mps, 0.0, target.turn_rate_radps


def target_local(vehicle: Vehicle, now_ns: int) -> Any | None:
    target, frame = _target(vehicle), vehicle.autopilot.estimator.frame
    if target is None or frame is None:
        return None
    mask, lat_deg, lon_deg, vn, ve, yaw_rad, yaw_rate_radps = target
    x_m, y_m = frame.to_local(lat_deg, lon_deg) if mask == _MASK_POSITION else (0.0, 0.0)
    return mav.MAVLink_position_target_local_ned_message(
        boot_ms(now_ns), 1, mask, float32(x_m), float32(y_m), 0.0, vn, ve, 0.0, 0.0, 0.0, 0.0, yaw_rad, yaw_rate_radps
    )


def target_global(vehicle: Vehicle, now_ns: int) -> Any | None:
    target = _target(vehicle)
    if target is None:
        return None
    mask, lat_deg, lon_deg, vn, ve, yaw_rad, yaw_rate_radps = target
    lat, lon = whole(lat_deg * 1e7, _INT32), whole(lon_deg * 1e7, _INT32)
    return mav.MAVLink_position_target_global_int_message(
        boot_ms(now_ns), 6, mask, lat, lon, 0.0, vn, ve, 0.0, 0.0, 0.0, 0.0, yaw_rad, yaw_rate_radps
    )


MOTION_REPORTS: Mapping[int, Callable[[Vehicle, int], Any]] = {
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
    mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: target_local,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: target_global,
}
