"""MicroStrain 3DM-GQ7, for ArduPilot with EAHRS_TYPE 7, including its Linux builds, for instance on a BeagleBone.

There is no set-up: packets flow as soon as a peer is connected, and the driver never answers. The driver repeats the
last fix of its receiver with every filter packet, fifty times a second. So GPS1_DELAY_MS must contain half the interval
between two fixes in addition to the latency of the receiver.

Layout and units: MIP Data Communications Protocol manual of the 3DM-GQ7 (HBK MicroStrain). A packet is `u`, `e`, the
descriptor set, the length of its fields, the fields, and a two-byte Fletcher checksum over all bytes before it. A field
is its length (including the length byte), the descriptor and the values, big-endian. Quaternions are (w, x, y, z).
"""

from __future__ import annotations

import math
import struct
from itertools import accumulate

from agent.bridges.ahrs import LISTEN, Ahrs, open_line
from agent.bridges.injector import InjectorError
from agent.bridges.readings import InertialSample, Navigation, ReceiverFix
from agent.bridges.vehicle_link import VehicleLink
from agent.navigation.gps_time import SECOND_NS, WEEK_S

STANDARD_GRAVITY_MPS2 = 9.80665
SENSORS, FILTER, RECEIVER_1 = 0x80, 0x82, 0x91
FULL_NAVIGATION = 4  # state of the filter

_FIX_KINDS = {2: 1, 3: 0, 4: 0, 5: 5, 6: 6}
"""Map from GPS_FIX_TYPE to the unit's code: 2D, 3D, 3D with corrections, RTK float and RTK fixed."""
_NO_FIX = 3

_TIME = struct.Struct(">BBdHH")
_SENSOR_FIELDS = struct.Struct(">BBf BB3f BB3f BB3f")
_FILTER_FIELDS = struct.Struct(">BB3H BB3dH BB3fH BB4fH BB3fH BB3fH")
_RECEIVER_FIELDS = struct.Struct(">BBBBHH BB4d2fH BB8fH BB7fH")
_ALL_VALID = 0xFFFF


def packet(descriptor_set: int, fields: bytes) -> bytes:
    """Return a packet: header, fields and checksum."""
    content = bytes((0x75, 0x65, descriptor_set, len(fields))) + fields
    return content + checksum(content)


def checksum(content: bytes) -> bytes:
    """Fletcher checksum of two bytes without carry: sum of the bytes, and sum of those sums."""
    return bytes((sum(content) & 0xFF, sum(accumulate(content)) & 0xFF))


def pack_inertial_frame(sample: InertialSample) -> bytes:
    """Pressure (mbar), field (gauss), specific force (standard gravity) and rate (rad/s), FRD."""
    fx, fy, fz = sample.accel_frd_mps2
    g = STANDARD_GRAVITY_MPS2
    fields = _SENSOR_FIELDS.pack(
        6, 0x17, sample.pressure_pa * 1e-2,
        14, 0x06, *sample.field_frd_gauss,
        14, 0x04, fx / g, fy / g, fz / g,
        14, 0x05, *sample.gyro_frd_radps,
    )  # fmt: skip
    return packet(SENSORS, fields)


def pack_solution_frame(navigation: Navigation) -> bytes:
    """State of the filter, position (deg, m), velocity (m/s), attitude, and uncertainties of position and velocity.

    The height field is defined above the ellipsoid; we send the height above mean sea level. The time is the time of
    the newest fix, not of the filter. ArduPilot's driver uses it as the time of the fix. If it advances more than 20
    times a second, ArduPilot treats the receiver as lagging and unhealthy.
    """
    n = navigation
    horizontal_m, speed_mps = n.horizontal_accuracy_m, n.speed_accuracy_mps
    fields = _FILTER_FIELDS.pack(
        8, 0x10, FULL_NAVIGATION, 3, 0,
        28, 0x01, n.lat_deg, n.lon_deg, n.alt_m, 1,
        16, 0x02, *n.vel_ned_mps, 1,
        20, 0x03, *n.quat_ned_frd, 1,
        16, 0x08, horizontal_m, horizontal_m, n.vertical_accuracy_m, 1,
        16, 0x09, speed_mps, speed_mps, speed_mps, 1,
    )  # fmt: skip
    return packet(FILTER, _time(n.fix_gps_ns) + fields)


def pack_receiver_frame(fix: ReceiverFix, receiver: int = RECEIVER_1) -> bytes:
    """A fix: type and satellites, position with one sigma (deg, m), velocity (m/s), dilutions of precision."""
    d = fix.dilution
    north, east, down = fix.vel_ned_mps
    ground_mps = math.hypot(north, east)
    course_deg = math.degrees(math.atan2(east, north)) % 360.0
    course_accuracy_deg = math.degrees(math.atan2(fix.speed_accuracy_mps, ground_mps))
    fields = _RECEIVER_FIELDS.pack(
        8, 0x0B, _FIX_KINDS.get(fix.fix_type, _NO_FIX), fix.satellites, 0, _ALL_VALID,
        44, 0x03, fix.lat_deg, fix.lon_deg, fix.alt_m, fix.alt_m,
        fix.horizontal_accuracy_m, fix.vertical_accuracy_m, _ALL_VALID,
        36, 0x05, north, east, down, math.hypot(ground_mps, down), ground_mps, course_deg,
        fix.speed_accuracy_mps, course_accuracy_deg, _ALL_VALID,
        32, 0x07, d.geometric, d.position, d.horizontal, d.vertical, d.time, d.north, d.east, _ALL_VALID,
    )  # fmt: skip
    return packet(receiver, _time(fix.gps_ns) + fields)


def _time(gps_ns: int) -> bytes:
    """Seconds of the week, and the week, both marked valid."""
    week, rest_ns = divmod(gps_ns, WEEK_S * SECOND_NS)
    return _TIME.pack(14, 0xD3, rest_ns * 1e-9, week, 3)


class MicroStrain7(Ahrs):
    """MicroStrain unit.

    It sends a solution only after the receiver's first fix, because the driver reads the height there.
    """

    title = "MicroStrain 7"

    @classmethod
    def open(cls, url: str, vehicle: VehicleLink) -> MicroStrain7:
        """Open the line at `url`. Raises InjectorError and TransportError."""
        if not url:
            raise InjectorError("sensor-link: microstrain7 needs the port of the autopilot, as udp://127.0.0.1:14800")
        if url.startswith("udp://") and url.endswith(LISTEN):
            raise InjectorError(
                f"sensor-link: {url}: this driver sends nothing, so its address stays unknown; "
                "start the autopilot with udpin:0.0.0.0:PORT and connect to udp://HOST:PORT"
            )
        return cls(open_line(url))

    def handle_bytes(self, chunk: bytes) -> bool:
        self.counts.junk += len(chunk)
        return False

    def is_accepted(self) -> bool:
        return self._line.connected

    def hint(self) -> str:
        return "check EAHRS_TYPE 7, SERIALn_PROTOCOL 36, and that this is port n"

    def inertial_frame(self, sample: InertialSample) -> bytes | None:
        return pack_inertial_frame(sample) if self._line.connected else None

    def solution_frame(self, navigation: Navigation) -> bytes | None:
        return pack_solution_frame(navigation) if self._line.connected else None

    def receiver_frame(self, fix: ReceiverFix) -> bytes | None:
        return pack_receiver_frame(fix) if self._line.connected else None
