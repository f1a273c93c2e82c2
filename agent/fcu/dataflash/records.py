"""Records of a flight log, each from the values that it reports. Times are whole microseconds of the agent's clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent.fcu.control.allocation import pulse_width_us
from agent.fcu.control.guidance import GuidanceOutput
from agent.fcu.control.manual_control import Sticks
from agent.fcu.dataflash.format import FORMATS
from agent.fcu.mission import MissionItem
from agent.fcu.vehicle_state import Actuators
from agent.navigation.geodetic import Home, LocalProjection
from agent.navigation.gps_time import GpsTime
from agent.navigation.measurements import (
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
    StateEstimate,
    Vector3,
)
from agent.navigation.position_filter import EstimateVariances, InnovationRatios
from agent.timing.tasks import TaskMiss, TaskStats, quantile_us

_IMU, _GPS, _GPA, _MAG, _BARO = (FORMATS[name].pack for name in ("IMU", "GPS", "GPA", "MAG", "BARO"))
_ATT, _POS, _XKF1, _XKF4, _XKQ = (FORMATS[name].pack for name in ("ATT", "POS", "XKF1", "XKF4", "XKQ"))
_XKV1 = FORMATS["XKV1"].pack
_RCIN, _RCOU, _NTUN, _ORGN = (FORMATS[name].pack for name in ("RCIN", "RCOU", "NTUN", "ORGN"))
_STER, _THR, _TASK, _TSKQ, _MISS = (FORMATS[name].pack for name in ("STER", "THR", "TASK", "TSKQ", "MISS"))

# XKF4.SS, as ArduPilot's filter status: attitude; velocity and position; constant position mode.
_ATTITUDE, _POSITION, _CONSTANT_POSITION = 0x01, 0x3E, 0x80
ORIGIN, HOME = 0, 1  # ORGN.Type


def imu(now_us: int, sample: ImuMeasurement) -> bytes:
    """IMU."""
    stamp_ns, (gx, gy, gz), (ax, ay, az), temperature_degc = sample
    return _IMU(now_us, 0, gx, gy, gz, ax, ay, az, temperature_degc, stamp_ns // 1000)


def gnss(now_us: int, sample: GnssMeasurement, last_us: int, gps_time: GpsTime | None) -> bytes:
    """GPS and GPA. last_us: time of the last fix. Week and time are 0 without a date, as in ArduPilot."""
    vn, ve, vd = sample.vel_ned_mps
    week, of_week_ms = (0, 0) if gps_time is None else gps_time.week_and_ms(sample.stamp_ns)
    fix = _GPS(
        now_us,
        0,
        sample.fix_type,
        of_week_ms,
        week,
        sample.satellites,
        sample.lat_deg,
        sample.lon_deg,
        sample.alt_m,
        math.hypot(vn, ve),
        _compass_deg(math.atan2(ve, vn)),
        vd,
        1,
        sample.stamp_ns // 1000,
    )
    return fix + _GPA(
        now_us,
        0,
        sample.horizontal_accuracy_m,
        sample.vertical_accuracy_m,
        sample.speed_accuracy_mps,
        1,
        now_us // 1000,
        (now_us - last_us) // 1000,
    )


def magnetometer(now_us: int, sample: MagnetometerMeasurement, offset_mgauss: Vector3) -> bytes:
    """MAG: the field with the offsets added, in whole milligauss, as in ArduPilot."""
    (mx, my, mz), (ox, oy, oz) = sample.field_frd_gauss, offset_mgauss
    field = (_whole(1e3 * mx + ox), _whole(1e3 * my + oy), _whole(1e3 * mz + oz))
    return _MAG(now_us, 0, *field, _whole(ox), _whole(oy), _whole(oz), sample.stamp_ns // 1000)


def barometer(now_us: int, sample: BarometerMeasurement) -> bytes:
    """BARO."""
    return _BARO(now_us, 0, sample.pressure_pa, sample.temperature_degc, sample.stamp_ns // 1000)


def attitude(now_us: int, estimate: StateEstimate, desired_yaw_rad: float) -> bytes:
    """ATT. The desired roll and pitch are zero."""
    roll_deg, pitch_deg = math.degrees(estimate.roll_rad), math.degrees(estimate.pitch_rad)
    yaw_deg = math.degrees(estimate.yaw_rad) % 360.0
    return _ATT(now_us, 0.0, roll_deg, 0.0, pitch_deg, math.degrees(desired_yaw_rad) % 360.0, yaw_deg)


def outputs(now_us: int, actuators: Actuators, channels: Sequence[int]) -> bytes:
    """RCOU: the first 14 channels, 0 for unused ones."""
    pulses = dict(zip(channels, map(pulse_width_us, actuators.command)))
    return _RCOU(now_us, *(pulses.get(channel, 0) for channel in range(1, 15)))


def inputs(now_us: int, channels_us: tuple[int, ...]) -> bytes:
    """RCIN: the first 14 channels."""
    return _RCIN(now_us, *(channels_us + (0,) * 14)[:14])


def position(now_us: int, estimate: StateEstimate, frame: LocalProjection, home: Home | None) -> bytes:
    """POS. Without a home, it uses the origin."""
    north_m, east_m, down_m = estimate.pos_ned_m
    lat_deg, lon_deg = frame.to_geodetic(north_m, east_m)
    alt_m = frame.alt_m - down_m
    return _POS(now_us, lat_deg, lon_deg, alt_m, alt_m - (frame if home is None else home).alt_m, -down_m)


def solution(
    now_us: int, estimate: StateEstimate, gyro_bias_frd_radps: Vector3, frame: LocalProjection | None
) -> bytes:
    """XKF1."""
    return _XKF1(
        now_us,
        0,
        math.degrees(estimate.roll_rad),
        math.degrees(estimate.pitch_rad),
        math.degrees(estimate.yaw_rad) % 360.0,
        *estimate.vel_ned_mps,
        *estimate.pos_ned_m,
        *map(math.degrees, gyro_bias_frd_radps),
        0.0 if frame is None else frame.alt_m,
    )


def health(now_us: int, estimate: StateEstimate, ratios: InnovationRatios) -> bytes:
    """XKQ and XKF4: square roots of the ratios, accepted below 1."""
    status = _ATTITUDE if estimate.attitude_valid else 0
    status |= _POSITION if estimate.position_valid else _CONSTANT_POSITION
    roots = (math.sqrt(ratio) for ratio in (ratios.velocity, ratios.position, ratios.height, ratios.heading))
    return _XKQ(now_us, 0, *estimate.quat_ned_frd) + _XKF4(now_us, 0, *roots, status)


def variances(now_us: int, of: EstimateVariances, yaw_rad: float) -> bytes:
    """XKV1. The variance of the heading appears in the first and last part of the quaternion, as of a level vessel.

    Tilt and gyro bias have no variances.
    """
    quarter = 0.25 * of.heading_rad2
    attitude = (quarter * math.sin(0.5 * yaw_rad) ** 2, math.nan, math.nan, quarter * math.cos(0.5 * yaw_rad) ** 2)
    level, down = (of.speed_m2ps2, of.speed_m2ps2, of.climb_m2ps2), (of.horizontal_m2, of.horizontal_m2, of.vertical_m2)
    return _XKV1(now_us, 0, *attitude, *level, *down, math.nan, math.nan)


def navigation(now_us: int, output: GuidanceOutput, yaw_rad: float) -> bytes:
    """NTUN."""
    bearing_deg, heading_deg = _compass_deg(output.bearing_rad), _compass_deg(output.heading_rad)
    yaw_cdeg = _whole(100.0 * math.degrees(yaw_rad)) % 36000
    return _NTUN(now_us, output.distance_m, bearing_deg, heading_deg, yaw_cdeg, output.cross_track_m)


def control(now_us: int, sticks: Sticks, speed_mps: float, desired_mps: float, turn_rate_radps: float) -> bytes:
    """STER and THR. desired_mps: NaN without a speed demand."""
    turn_rate_degps = math.degrees(turn_rate_radps)
    steer = _STER(now_us, _whole(4500.0 * sticks.steering), speed_mps * turn_rate_radps, turn_rate_degps)
    return steer + _THR(now_us, _whole(100.0 * sticks.throttle), desired_mps, speed_mps)


def position_mark(now_us: int, kind: int, lat_deg: float, lon_deg: float, alt_m: float) -> bytes:
    """ORGN."""
    return _ORGN(now_us, kind, lat_deg, lon_deg, alt_m)


def mission_item(name: str, now_us: int, seq: int, total: int, item: MissionItem) -> bytes:
    """CMD or MISE."""
    place = (item.lat_deg, item.lon_deg, item.alt_m, item.frame)
    return FORMATS[name].pack(now_us, total, seq, item.command, *item.parameters, *place)


def task(now_us: int, index: int, stats: TaskStats) -> bytes:
    """TASK and TSKQ: counts since the start."""
    starts, runs = stats.start_jitter_histogram, stats.run_histogram
    longest_start_us, longest_run_us = stats.start_jitter_max_ns // 1000, stats.run_max_ns // 1000
    counts = _TASK(
        now_us,
        index,
        stats.name,
        stats.rate_hz,
        stats.cycles,
        stats.missed,
        stats.skipped,
        longest_start_us,
        stats.start_jitter_mean_ns * 1e-3,
        longest_run_us,
        stats.run_mean_ns * 1e-3,
    )
    return counts + _TSKQ(
        now_us,
        index,
        quantile_us(starts, 0.5, longest_start_us),
        quantile_us(starts, 0.99, longest_start_us),
        stats.worst_start_ns // 1000,
        quantile_us(runs, 0.5, longest_run_us),
        quantile_us(runs, 0.99, longest_run_us),
        stats.worst_run_ns // 1000,
    )


def missed_deadline(now_us: int, missed: TaskMiss) -> bytes:
    """MISS."""
    late_us, run_us = (missed.start_ns - missed.due_ns) // 1000, (missed.end_ns - missed.start_ns) // 1000
    return _MISS(now_us, missed.task, missed.cycle, missed.due_ns // 1000, late_us, run_us, missed.skipped)


def _compass_deg(angle_rad: float) -> float:
    return math.degrees(angle_rad) % 360.0


def _whole(value: float) -> int | float:
    """Round a value in range. The format handles other values."""
    return round(value) if abs(value) < 1e9 else value
