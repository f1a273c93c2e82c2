"""Binary frames of a VectorNav unit, as pure functions.

Layout and units: VN-300 User Manual and ICD (VectorNav Technologies), section on binary output messages, for the three
outputs that an ArduPilot asks for. A frame is the sync byte, the groups and their fields, the values little-endian, and
a CRC16-CCITT over all but the sync byte, big-endian. Quaternions are (x, y, z, w).
"""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx

from agent.bridges.samples import InertialSample, Navigation, ReceiverFix

SYNC = b"\xfa"
INERTIAL_HEADER = bytes.fromhex("01 2107")  # common: time of startup, rate, acceleration, IMU, field and pressure
SOLUTION_HEADER = bytes.fromhex("31 0100 0601 1306")  # common: time; attitude: angles, quaternion, its uncertainty; INS
RECEIVER_HEADER = bytes.fromhex("49 0300 B826 1800")  # common: time, GPS time; receiver 1; receiver 2: satellites, fix

_INERTIAL = struct.Struct("<Q17f")
_SOLUTION = struct.Struct("<Q3f4f3fH3d3f2f")
_RECEIVER = struct.Struct("<QQBB3d3f3ff7fBB")

TRACKING = 2  # mode of INS status: GNSS and attitude within what the unit promises
HAS_FIX = 1 << 2
INERTIAL_FAULT, FIELD_FAULT, RECEIVER_FAULT = 1 << 5, 1 << 6, 1 << 7


def framed(content: bytes) -> bytes:
    """Sync byte and checksum around groups, fields and values."""
    return SYNC + content + crc_hqx(content, 0).to_bytes(2, "big")


def inertial_frame(sample: InertialSample) -> bytes:
    """Rate (rad/s), specific force (m/s²), field (gauss) in FRD, temperature (degC), pressure (kPa).

    Compensated and uncompensated values are the same: what the unit would take off is not simulated.
    """
    gyro, accel = sample.gyro_frd_radps, sample.accel_frd_mps2
    values = _INERTIAL.pack(
        sample.stamp_ns,
        *gyro,
        *accel,
        *accel,
        *gyro,
        *sample.field_frd_gauss,
        sample.temperature_degc,
        sample.pressure_pa * 1e-3,
    )
    return framed(INERTIAL_HEADER + values)


def solution_frame(navigation: Navigation, faults: int = 0) -> bytes:
    """Attitude (deg, and as a quaternion), place (deg, m) and velocity (m/s) with their uncertainty (deg, m, m/s)."""
    w, x, y, z = navigation.quat_ned_frd
    yaw, pitch, roll = (math.degrees(angle) for angle in reversed(navigation.euler_rad))
    tilt_deg, heading_deg = navigation.tilt_accuracy_deg, navigation.heading_accuracy_deg
    values = _SOLUTION.pack(
        navigation.stamp_ns,
        yaw,
        pitch,
        roll,
        x,
        y,
        z,
        w,
        heading_deg,
        tilt_deg,
        tilt_deg,
        TRACKING | HAS_FIX | faults,
        navigation.lat_deg,
        navigation.lon_deg,
        navigation.alt_m,
        *navigation.vel_ned_mps,
        navigation.horizontal_accuracy_m,
        navigation.speed_accuracy_mps,
    )
    return framed(SOLUTION_HEADER + values)


def receiver_frame(fix: ReceiverFix) -> bytes:
    """A fix of the receiver: place (deg, m), velocity (m/s), one sigma of both, dilutions of precision.

    The second antenna of the unit has the same satellites and the same kind of fix.
    """
    d = fix.dilution
    horizontal_m = fix.horizontal_accuracy_m
    values = _RECEIVER.pack(
        fix.stamp_ns,
        fix.gps_ns,
        fix.satellites,
        fix.fix_type,
        fix.lat_deg,
        fix.lon_deg,
        fix.alt_m,
        *fix.vel_ned_mps,
        horizontal_m,
        horizontal_m,
        fix.vertical_accuracy_m,
        fix.speed_accuracy_mps,
        d.geometric,
        d.position,
        d.time,
        d.vertical,
        d.horizontal,
        d.north,
        d.east,
        fix.satellites,
        fix.fix_type,
    )
    return framed(RECEIVER_HEADER + values)
