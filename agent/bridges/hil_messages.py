"""Our samples as the HIL messages of the MAVLink standard.

The standard does not define the dilutions `eph` and `epv` of HIL_GPS. Here, as in PX4, they are the position
accuracies, one sigma, in centimetres. Speed accuracy has no field.
"""

from __future__ import annotations

import math

from agent.bridges.readings import InertialSample, Navigation, ReceiverFix
from agent.navigation.gps_time import unix_us
from agent.navigation.measurements import BarometerMeasurement, MagnetometerMeasurement
from agent.navigation.position_filter import standard_height_m
from agent.wire import dialect as mav
from agent.wire.codec import Message

ACCEL, GYRO, FIELD, BAROMETER = 0x7, 0x38, 0x1C0, 0x1A00
"""Bits of HIL_SENSOR.fields_updated. PX4 accepts a barometer only with pressure, pressure altitude and temperature."""

_UNKNOWN = 0xFFFF


def updated_fields(sample: object) -> int:
    """Return the bits of HIL_SENSOR.fields_updated for a magnetometer or barometer sample, 0 for any other sample."""
    if isinstance(sample, MagnetometerMeasurement):
        return FIELD
    return BAROMETER if isinstance(sample, BarometerMeasurement) else 0


def sensor_message(sample: InertialSample, updated: int) -> Message:
    """Return HIL_SENSOR, stamped with the sensors' clock.

    updated: bits of the fields that are new since the last message.
    """
    height_m = standard_height_m(max(sample.pressure_pa, 0.0))
    message: Message = mav.MAVLink_hil_sensor_message(
        sample.stamp_ns // 1000, *sample.accel_frd_mps2, *sample.gyro_frd_radps, *sample.field_frd_gauss,
        sample.pressure_pa * 0.01, 0.0, height_m, sample.temperature_degc, updated,
    )  # fmt: skip
    return message


def gps_message(fix: ReceiverFix) -> Message:
    """Return HIL_GPS, stamped with UTC."""
    north, east, down = fix.vel_ned_mps
    course_deg = math.degrees(math.atan2(east, north)) % 360.0
    message: Message = mav.MAVLink_hil_gps_message(
        unix_us(fix.gps_ns), fix.fix_type, round(fix.lat_deg * 1e7), round(fix.lon_deg * 1e7), round(fix.alt_m * 1e3),
        _accuracy_cm(fix.horizontal_accuracy_m), _accuracy_cm(fix.vertical_accuracy_m),
        min(_cmps(math.hypot(north, east)), _UNKNOWN - 1), _cmps(north), _cmps(east), _cmps(down),
        round(course_deg * 100.0) % 36000, fix.satellites,
    )  # fmt: skip
    return message


def state_message(navigation: Navigation, gyro_frd_radps: tuple[float, float, float]) -> Message:
    """Return HIL_STATE_QUATERNION of our own solution, without airspeed and specific force."""
    message: Message = mav.MAVLink_hil_state_quaternion_message(
        navigation.stamp_ns // 1000, list(navigation.quat_ned_frd), *gyro_frd_radps,
        round(navigation.lat_deg * 1e7), round(navigation.lon_deg * 1e7), round(navigation.alt_m * 1e3),
        *(_cmps(speed) for speed in navigation.vel_ned_mps), 0, 0, 0, 0, 0,
    )  # fmt: skip
    return message


def _accuracy_cm(accuracy_m: float) -> int:
    return min(max(round(accuracy_m * 100.0), 0), _UNKNOWN - 1)


def _cmps(speed_mps: float) -> int:
    return min(max(round(speed_mps * 100.0), -32768), 32767)
