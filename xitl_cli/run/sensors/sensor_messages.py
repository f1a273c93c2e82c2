"""Samples of the simulated sensors as MAVLink messages: xitl's own messages, and those of the public "common" set."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from agent.navigation.gps_time import GpsTime
from agent.wire import dialect
from sim_core.sensors.barometer import BarometerSample
from sim_core.sensors.gnss import GnssSample
from sim_core.sensors.imu import ImuSample
from sim_core.sensors.magnetometer import MagnetometerSample

if TYPE_CHECKING:
    from sim_core.sensors.odometry import OdometrySample
    from sim_core.sensors.rangefinder import RangefinderSample, ScanSample
    from sim_core.sensors.spec import ObstacleScannerSpec, RangefinderSpec

Message = Any  # the generated codec is untyped


def imu(stamp_us: int, sample: ImuSample, row: int = 0) -> Message:
    """Return XITL_IMU of one unit."""
    gyro, accel = sample.gyro_frd_radps[row].tolist(), sample.accel_frd_mps2[row].tolist()
    return dialect.MAVLink_xitl_imu_message(stamp_us, gyro, accel, float(sample.temperature_degc[row]))


def gnss(stamp_us: int, sample: GnssSample) -> Message:
    """Return XITL_GNSS."""
    return dialect.MAVLink_xitl_gnss_message(
        stamp_us,
        round(float(sample.lat_deg[0]) * 1e7),
        round(float(sample.lon_deg[0]) * 1e7),
        round(float(sample.alt_m[0]) * 1e3),
        sample.vel_ned_mps[0].tolist(),
        float(sample.horizontal_accuracy_m[0]),
        float(sample.vertical_accuracy_m[0]),
        float(sample.speed_accuracy_mps[0]),
        int(sample.fix_type[0]),
        int(sample.satellites[0]),
    )


def magnetometer(stamp_us: int, sample: MagnetometerSample, row: int = 0) -> Message:
    """Return XITL_MAGNETOMETER of one unit."""
    return dialect.MAVLink_xitl_magnetometer_message(stamp_us, sample.field_frd_gauss[row].tolist())


def barometer(stamp_us: int, sample: BarometerSample, row: int = 0) -> Message:
    """Return XITL_BAROMETER of one unit."""
    return dialect.MAVLink_xitl_barometer_message(
        stamp_us, float(sample.pressure_pa[row]), float(sample.temperature_degc[row])
    )


LASER, ULTRASOUND = 0, 1  # MAV_DISTANCE_SENSOR
CUSTOM_ORIENTATION = 100
LOCAL_FRD, BODY_FRD = 20, 12  # MAV_FRAME
VISION = 2  # MAV_ESTIMATOR_TYPE
ORIENTATIONS = {
    (1.0, 0.0, 0.0): 0,
    (0.0, 1.0, 0.0): 2,
    (-1.0, 0.0, 0.0): 4,
    (0.0, -1.0, 0.0): 6,
    (0.0, 0.0, -1.0): 24,
    (0.0, 0.0, 1.0): 25,
}
"""MAV_SENSOR_ORIENTATION of the six directions of the body. Other directions are custom, with a quaternion."""

_NO_DILUTION = 6  # ignore_flags: horizontal and vertical dilution


def distance_sensor(number: int, rangefinder: RangefinderSpec) -> Callable[[int, RangefinderSample], Message]:
    """Return an encoder of DISTANCE_SENSOR with this number. Out of its limits, a unit reads just outside of them."""
    low_cm, high_cm = round(rangefinder.min_range_m * 100), round(rangefinder.max_range_m * 100)
    length = math.hypot(*rangefinder.direction_frd)
    x, y, z = (component / length for component in rangefinder.direction_frd)
    orientation = ORIENTATIONS.get((x, y, z), CUSTOM_ORIENTATION)
    quaternion = _from_bow(x, y, z) if orientation == CUSTOM_ORIENTATION else (0.0, 0.0, 0.0, 0.0)
    kind = ULTRASOUND if rangefinder.through == "water" else LASER
    beam_rad = math.radians(rangefinder.beam_deg)
    variance_cm2 = min(round((rangefinder.noise_m * 100) ** 2), 254)

    def encode(stamp_us: int, sample: RangefinderSample) -> Message:
        range_m = float(sample.range_m[0])
        range_cm = high_cm + 1 if range_m * 100 > high_cm else round(range_m * 100)
        if range_cm < low_cm:
            range_cm = low_cm - 1
        return dialect.MAVLink_distance_sensor_message(
            stamp_us // 1000 % 2**32,
            low_cm,
            high_cm,
            range_cm,
            kind,
            number,
            orientation,
            variance_cm2,
            beam_rad,
            beam_rad,
            quaternion,
        )

    return encode


def gps_input(gps_id: int) -> Callable[[int, GnssSample], Message]:
    """Return an encoder of GPS_INPUT for this receiver."""
    clock = GpsTime.fixed()

    def encode(stamp_us: int, sample: GnssSample) -> Message:
        week, of_week_ms = clock.week_and_ms(stamp_us * 1000)
        north_mps, east_mps, down_mps = sample.vel_ned_mps[0].tolist()
        return dialect.MAVLink_gps_input_message(
            stamp_us,
            gps_id,
            _NO_DILUTION,
            of_week_ms,
            week,
            int(sample.fix_type[0]),
            round(float(sample.lat_deg[0]) * 1e7),
            round(float(sample.lon_deg[0]) * 1e7),
            float(sample.alt_m[0]),
            0.0,
            0.0,
            north_mps,
            east_mps,
            down_mps,
            float(sample.speed_accuracy_mps[0]),
            float(sample.horizontal_accuracy_m[0]),
            float(sample.vertical_accuracy_m[0]),
            int(sample.satellites[0]),
        )

    return encode


def obstacle_distance(scanner: ObstacleScannerSpec) -> Callable[[int, ScanSample], Message]:
    """Return an encoder of OBSTACLE_DISTANCE, with the bow in the middle of the first of 72 sectors."""
    low_cm, high_cm = round(scanner.min_range_m * 100), round(scanner.max_range_m * 100)

    def encode(stamp_us: int, sample: ScanSample) -> Message:
        ranges_cm = [
            high_cm + 1 if range_m * 100 > high_cm else max(round(range_m * 100), low_cm)
            for range_m in sample.range_m[0].tolist()
        ]
        return dialect.MAVLink_obstacle_distance_message(
            stamp_us, LASER, ranges_cm, 5, low_cm, high_cm, 5.0, 0.0, BODY_FRD
        )

    return encode


def odometry(velocity_noise_mps: float, rate_noise_radps: float) -> Callable[[int, OdometrySample], Message]:
    """Return an encoder of ODOMETRY, in the level FRD axes of its start, with the velocity in the body."""
    velocity = _diagonal((velocity_noise_mps,) * 3 + (rate_noise_radps,) * 3)

    def encode(stamp_us: int, sample: OdometrySample) -> Message:
        place_m, turn_rad = float(sample.position_deviation_m[0]), float(sample.yaw_deviation_rad[0])
        return dialect.MAVLink_odometry_message(
            stamp_us,
            LOCAL_FRD,
            BODY_FRD,
            *sample.pos_local_m[0].tolist(),
            sample.quat_local_frd[0].tolist(),
            *sample.vel_frd_mps[0].tolist(),
            *sample.gyro_frd_radps[0].tolist(),
            _diagonal((place_m,) * 3 + (turn_rad,) * 3),
            velocity,
            0,
            VISION,
            100,
        )

    return encode


def _diagonal(deviations: tuple[float, ...]) -> list[float]:
    """Return the upper triangle of a 6 by 6 covariance, row by row."""
    return [deviations[row] ** 2 if row == column else 0.0 for row in range(6) for column in range(row, 6)]


def _from_bow(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the shortest turn from the bow to this unit vector, w x y z: (1 + a.b, a x b), normalised."""
    w = 1.0 + x
    length = math.sqrt(w * w + y * y + z * z)
    return w / length, 0.0, -z / length, y / length
