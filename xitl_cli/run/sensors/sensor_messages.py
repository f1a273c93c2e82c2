"""Samples of the simulated sensors as the custom MAVLink messages of the host's link."""

from __future__ import annotations

from typing import Any

from agent.wire import dialect
from sim_core.sensors.barometer import BarometerSample
from sim_core.sensors.gnss import GnssSample
from sim_core.sensors.imu import ImuSample
from sim_core.sensors.magnetometer import MagnetometerSample

Message = Any  # the generated codec is untyped


def imu(stamp_us: int, sample: ImuSample) -> Message:
    """XITL_IMU."""
    gyro, accel = sample.gyro_frd_radps[0].tolist(), sample.accel_frd_mps2[0].tolist()
    return dialect.MAVLink_xitl_imu_message(stamp_us, gyro, accel, float(sample.temperature_degc[0]))


def gnss(stamp_us: int, sample: GnssSample) -> Message:
    """XITL_GNSS."""
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


def magnetometer(stamp_us: int, sample: MagnetometerSample) -> Message:
    """XITL_MAGNETOMETER."""
    return dialect.MAVLink_xitl_magnetometer_message(stamp_us, sample.field_frd_gauss[0].tolist())


def barometer(stamp_us: int, sample: BarometerSample) -> Message:
    """XITL_BAROMETER."""
    return dialect.MAVLink_xitl_barometer_message(
        stamp_us, float(sample.pressure_pa[0]), float(sample.temperature_degc[0])
    )
