"""AIS: a vessel's transponder, the messages as bytes, and receivers that send MAVLink or sentences on a line.

transponder  report times (ITU-R M.1371-5, annex 1, tables 1 and 2) and content
messages     ITU-R M.1371-5 payloads in six-bit characters; fields and their widths are from annex 8
sentences    !AIVDM of NMEA 0183 as the gpsd project describes them (AIVDM/AIVDO protocol decoding)
receivers    AIS_VESSEL or ADSB_VEHICLE by MAVLink, or sentences on a line
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import count
from operator import xor
from typing import Any, Literal, NamedTuple

import numpy as np

from agent.wire import dialect
from agent.wire.transport import Transport
from sim_core.dataclass import dataclass
from sim_core.geodesy import LocalFrame
from xitl_cli.run.traffic.self_report import SelfReport

KNOT_MPS = 1852.0 / 3600.0
UNDER_WAY, AT_ANCHOR, MOORED = 0, 1, 5  # navigational status
NO_TURN, NO_SPEED, NO_COURSE, NO_HEADING = -128, 1023, 3600, 511
NO_LATITUDE_DEG, NO_LONGITUDE_DEG = 91.0, 181.0
NO_SECOND = 60
GNSS = 1  # type of the position fixing device: GPS
PART_CHARACTERS = 60  # of a payload in one sentence, which NMEA 0183 limits to 82 characters in total
CARRIER_SENSE_STATE = 0b110_0000_0000_0000_0110  # communication state of a class B carrier-sense unit


@dataclass(frozen=True, slots=True)
class AisPosition:
    """Content of a position report. None: not available."""

    mmsi: int
    lat_deg: float | None
    lon_deg: float | None
    speed_mps: float | None = None
    course_deg: float | None = None
    """Over ground."""
    heading_deg: float | None = None
    """True heading."""
    turn_rate_degpmin: float | None = None
    """Positive to starboard."""
    accurate: bool = False
    """The position error is below 10 m."""
    second: int = NO_SECOND
    """Second of UTC."""
    status: int = UNDER_WAY
    raim: bool = False
    """The receiver monitors its integrity."""


@dataclass(frozen=True, slots=True)
class AisDimensions:
    """Whole metres from the reported place to the vessel's ends and sides; all 0: not available."""

    bow_m: int = 0
    stern_m: int = 0
    port_m: int = 0
    starboard_m: int = 0

    @classmethod
    def around(cls, length_m: float, beam_m: float, ahead_m: float = 0.0) -> AisDimensions:
        """Return the dimensions of a hull with its middle `ahead_m` ahead of the reported place.

        They are rounded up, because a hull of 2 m is no point, and are at least 1: ArduPilot reads 0 as not available.
        """
        half_m, side_m = 0.5 * length_m, 0.5 * beam_m
        ends = [max(math.ceil(end_m - 1e-9), 1) for end_m in (half_m + ahead_m, half_m - ahead_m, side_m, side_m)]
        return cls(*(min(end, most) for end, most in zip(ends, (511, 511, 63, 63), strict=True)))


@dataclass(frozen=True, slots=True)
class AisStatic:
    """Static data of a vessel."""

    mmsi: int
    name: str = ""
    callsign: str = ""
    ship_type: int = 0
    """Code of the recommendation, table 53."""
    dimensions: AisDimensions = AisDimensions()
    draught_m: float = 0.0
    """0 if not available."""
    imo: int = 0
    fixing_device: int = GNSS
    destination: str = ""
    eta: tuple[int, int, int, int] = (0, 0, 24, 60)
    """Month, day, hour, minute; the default means not available."""


class AisPayload(NamedTuple):
    """Armoured characters, and the number of fill bits in the last one."""

    characters: str
    fill_bits: int


def class_a_position(report: AisPosition, radio: int = 0) -> AisPayload:
    """Return message 1. radio: communication state."""
    return _payload(
        (6, 1), (2, 0), (30, report.mmsi), (4, report.status), (8, turn_indicator(report.turn_rate_degpmin)),
        *_motion(report), (2, 0), (3, 0), (1, int(report.raim)), (19, radio),
    )  # fmt: skip


def class_b_position(report: AisPosition, radio: int = CARRIER_SENSE_STATE) -> AisPayload:
    """Return message 18 of a carrier-sense unit without a display, on the whole marine band."""
    carrier_sense, display, dsc, band, managed, assigned, selector = 1, 0, 1, 1, 1, 0, 1
    flags = (carrier_sense, display, dsc, band, managed, assigned, int(report.raim), selector)
    return _payload(
        (6, 18), (2, 0), (30, report.mmsi), (8, 0), *_motion(report), (2, 0), *((1, flag) for flag in flags),
        (19, radio),
    )  # fmt: skip


def class_a_static(vessel: AisStatic) -> AisPayload:
    """Return message 5."""
    month, day, hour, minute = vessel.eta
    return _payload(
        (6, 5), (2, 0), (30, vessel.mmsi), (2, 0), (30, vessel.imo), *_text(vessel.callsign, 7),
        *_text(vessel.name, 20), (8, vessel.ship_type), *_dimensions(vessel), (4, vessel.fixing_device), (4, month),
        (5, day), (5, hour), (6, minute), (8, min(round(vessel.draught_m * 10.0), 255)), *_text(vessel.destination, 20),
        (1, 0), (1, 0),
    )  # fmt: skip


def class_b_static(vessel: AisStatic) -> tuple[AisPayload, AisPayload]:
    """Return message 24, parts A and B."""
    head = (6, 24), (2, 0), (30, vessel.mmsi)
    name = _payload(*head, (2, 0), *_text(vessel.name, 20))
    rest = _payload(
        *head, (2, 1), (8, vessel.ship_type), *_text("", 7), *_text(vessel.callsign, 7), *_dimensions(vessel),
        (4, vessel.fixing_device), (2, 0),
    )  # fmt: skip
    return name, rest


def sentences(payload: AisPayload, channel: str = "A", sequence: int = 0) -> tuple[bytes, ...]:
    """Return !AIVDM with checksum and CR LF, in several parts if needed. sequence: 0 to 9, connects the parts."""
    characters, fill_bits = payload
    parts = [characters[at : at + PART_CHARACTERS] for at in range(0, len(characters), PART_CHARACTERS)]
    number = f"{sequence % 10}" if len(parts) > 1 else ""
    bodies = [
        f"AIVDM,{len(parts)},{at},{number},{channel},{part},{fill_bits if at == len(parts) else 0}"
        for at, part in enumerate(parts, 1)
    ]
    return tuple(f"!{body}*{reduce(xor, body.encode()):02X}\r\n".encode() for body in bodies)


def turn_indicator(turn_rate_degpmin: float | None) -> int:
    """Return 4.733 times the square root of the rate, signed, at most 126 (708°/min); NO_TURN without a rate."""
    if turn_rate_degpmin is None:
        return NO_TURN
    return round(math.copysign(min(4.733 * math.sqrt(abs(turn_rate_degpmin)), 126.0), turn_rate_degpmin))


def _motion(report: AisPosition) -> tuple[tuple[int, int], ...]:
    """Return speed, accuracy, place, course, heading and second, which are the same in both classes."""
    speed, course, heading = NO_SPEED, NO_COURSE, NO_HEADING
    if report.speed_mps is not None:
        speed = min(round(abs(report.speed_mps) / KNOT_MPS * 10.0), 1022)
    if report.course_deg is not None:
        course = round(report.course_deg * 10.0) % 3600
    if report.heading_deg is not None:
        heading = round(report.heading_deg) % 360
    lon_deg = NO_LONGITUDE_DEG if report.lon_deg is None else report.lon_deg
    lat_deg = NO_LATITUDE_DEG if report.lat_deg is None else report.lat_deg
    return (
        (10, speed), (1, int(report.accurate)), (28, round(lon_deg * 600_000.0)), (27, round(lat_deg * 600_000.0)),
        (12, course), (9, heading), (6, report.second),
    )  # fmt: skip


def _dimensions(vessel: AisStatic) -> tuple[tuple[int, int], ...]:
    ends = vessel.dimensions
    return (9, ends.bow_m), (9, ends.stern_m), (6, ends.port_m), (6, ends.starboard_m)


def _text(text: str, characters: int) -> Sequence[tuple[int, int]]:
    """Return six-bit ASCII, filled up with @. Other characters become a question mark."""
    codes = [ord(letter) if " " <= letter <= "_" else ord("?") for letter in text.upper()[:characters]]
    return [(6, code & 0x3F) for code in codes] + [(6, 0)] * (characters - len(codes))


def _payload(*fields: tuple[int, int]) -> AisPayload:
    """Return the armoured payload, from the widths and values of the fields; negative values in two's complement."""
    bits = sum(width for width, _ in fields)
    value = 0
    for width, field in fields:
        value = value << width | field & (1 << width) - 1
    fill_bits = -bits % 6
    value <<= fill_bits
    sixes = [value >> at & 0x3F for at in range(bits + fill_bits - 6, -1, -6)]
    return AisPayload("".join(chr(six + 48 if six < 40 else six + 56) for six in sixes), fill_bits)


AisClass = Literal["class-a", "class-b"]
STATIC_S = 360.0  # between two static reports, class A and B
AT_REST_S, MOORED_AND_MOVING_S = 180.0, 10.0
HEADING_MEAN_S, TURNED_DEG, STRAIGHT_AGAIN_S = 30.0, 5.0, 20.0  # annex 2, 4.3.3: definition of a change of course
SLOW_MPS = 0.2  # below it the course over ground is noise


def reporting_interval_s(ais_class: AisClass, speed_mps: float, moored: bool = False, turning: bool = False) -> float:
    """Return the time between two position reports."""
    knots = speed_mps / KNOT_MPS
    if ais_class == "class-b":
        return 30.0 if knots > 2.0 else AT_REST_S
    if moored:
        return MOORED_AND_MOVING_S if knots > 3.0 else AT_REST_S
    if knots <= 14.0:
        return 10.0 / 3.0 if turning else 10.0
    if knots <= 23.0:
        return 2.0 if turning else 6.0
    return 2.0


@dataclass(frozen=True, slots=True)
class AisTransmission:
    """One transmission of a transponder: a position or static data."""

    ais_class: AisClass
    report: AisPosition | AisStatic
    place_ne_m: tuple[float, float]
    """Position of its antenna."""

    def payloads(self) -> tuple[AisPayload, ...]:
        """Return the payloads of the radio messages."""
        if isinstance(self.report, AisPosition):
            return ((class_a_position if self.ais_class == "class-a" else class_b_position)(self.report),)
        return (class_a_static(self.report),) if self.ais_class == "class-a" else class_b_static(self.report)


class CourseChange:
    """Whether a vessel turns: its heading differs from the mean of the last 30 s, or did less than 20 s ago."""

    def __init__(self) -> None:
        self._headings: deque[tuple[int, float, float]] = deque()
        self._north = self._east = 0.0  # sums over the headings
        self._straight_ns: int | None = None

    def update(self, now_ns: int, heading_rad: float) -> bool:
        """Update with the heading. Call it at every check."""
        headings = self._headings
        headings.append((now_ns, math.cos(heading_rad), math.sin(heading_rad)))
        self._north += headings[-1][1]
        self._east += headings[-1][2]
        while now_ns - headings[0][0] > HEADING_MEAN_S * 1e9:
            _, north, east = headings.popleft()
            self._north -= north
            self._east -= east
        mean_rad = math.atan2(self._east, self._north)
        off_deg = abs(math.degrees(math.remainder(heading_rad - mean_rad, 2.0 * math.pi)))
        if off_deg > TURNED_DEG:
            self._straight_ns = now_ns + round(STRAIGHT_AGAIN_S * 1e9)
        return self._straight_ns is not None and now_ns < self._straight_ns


class Transponder:
    """The transponder of one vessel.

    It starts at `first_s` of simulation time, or at the vessel's first report if that is later. It then sends a
    position and static data. vessel: static data; its MMSI is in every report.
    """

    def __init__(self, ais_class: AisClass, vessel: AisStatic, frame: LocalFrame, first_s: float = 0.0) -> None:
        self.vessel = vessel
        self.sent = 0
        self._class: AisClass = ais_class
        self._frame = frame
        self._first_ns = round(first_s * 1e9)
        self._turn = CourseChange()
        self._spoke_ns: int | None = None
        self._static_ns = 0

    def due(self, now_ns: int, report: SelfReport | None) -> list[AisTransmission]:
        """Return the transmissions that are due, from the vessel's report. Call it some ten times a second."""
        if report is None:
            return []
        turning = self._turn.update(now_ns, report.yaw_rad)
        if self._spoke_ns is None:
            if now_ns < self._first_ns:
                return []
        else:
            interval_s = reporting_interval_s(self._class, math.hypot(*report.vel_ne_mps), not report.armed, turning)
            if now_ns - self._spoke_ns < round(interval_s * 1e9):
                return []
        begins = self._spoke_ns is None
        self._spoke_ns = now_ns
        lat, lon, _ = self._frame.geodetic(np.array([[*report.pos_ne_m, 0.0]]))
        north_mps, east_mps = report.vel_ne_mps
        speed_mps = math.hypot(north_mps, east_mps)
        position = AisPosition(
            self.vessel.mmsi,
            float(lat[0]),
            float(lon[0]),
            speed_mps,
            math.degrees(math.atan2(east_mps, north_mps)) % 360.0 if speed_mps > SLOW_MPS else None,
            math.degrees(report.yaw_rad) % 360.0,
            math.degrees(report.yaw_rate_radps) * 60.0,
            report.accurate,
            now_ns // 1_000_000_000 % 60,
            UNDER_WAY if report.armed else MOORED,
        )
        sent = [AisTransmission(self._class, position, report.pos_ne_m)]
        if begins or now_ns - self._static_ns >= STATIC_S * 1e9:
            self._static_ns = now_ns
            sent.append(AisTransmission(self._class, self.vessel, report.pos_ne_m))
        self.sent += len(sent)
        return sent


Send = Callable[[Any], object]
AisReceiver = Callable[[AisTransmission], object]

FASTEST_TENTHS = 1022  # of a knot; this value means this speed or more
SURFACE_VEHICLE, GEOMETRIC = 18, 1  # ADSB_EMITTER_TYPE, ADSB_ALTITUDE_TYPE
_SHIFTED = 0xFFFFFF  # an ICAO address has 24 bits, enough for the serial number of an MMSI


class HeardVessels:
    """A receiver that combines a vessel's static data with its position, and passes both to `told` at each position."""

    def __init__(self, told: Callable[[AisPosition, AisStatic | None], object]) -> None:
        self._told = told
        self._static: dict[int, AisStatic] = {}

    def __call__(self, heard: AisTransmission) -> None:
        """Receive one transmission. Static data are passed on with the next position."""
        if isinstance(heard.report, AisStatic):
            self._static[heard.report.mmsi] = heard.report
        else:
            self._told(heard.report, self._static.get(heard.report.mmsi))


def mavlink_receiver(send: Send) -> AisReceiver:
    """Return a receiver that sends AIS_VESSEL, as ArduPilot does for AIS."""
    return HeardVessels(lambda position, static: send(ais_vessel(position, static)))


def px4_receiver(send: Send) -> AisReceiver:
    """Return a receiver that sends ADSB_VEHICLE. PX4 reads no AIS, and forwards this message to its ground stations."""
    return HeardVessels(lambda position, static: send(adsb_vehicle(position, static)))


class SentenceReceiver:
    """A receiver with a separate line for its sentences. unsent: bytes that the line did not accept."""

    def __init__(self, line: Transport) -> None:
        self.unsent = 0
        self._line = line
        self._sequence, self._channel = count(), count()

    def __call__(self, heard: AisTransmission) -> None:
        """Send one transmission, on the two channels in turn."""
        for payload in heard.payloads():
            channel, sequence = "AB"[next(self._channel) % 2], next(self._sequence)
            for sentence in sentences(payload, channel, sequence):
                if not self._line.send(sentence):
                    self.unsent += len(sentence)


def ais_vessel(position: AisPosition, static: AisStatic | None) -> Any:
    """Return the message, with the resolution of AIS: a ten-thousandth of a minute, a tenth of a knot, of a degree.

    The turn rate is in ddeg/s (common.xml of MAVLink; ArduPilot 4.7 still sends cdeg/s).
    """
    flags = dialect.AIS_FLAGS_POSITION_ACCURACY if position.accurate else 0
    tenths = 0
    if position.speed_mps is not None:
        tenths = min(round(position.speed_mps / KNOT_MPS * 10.0), FASTEST_TENTHS)
        flags |= dialect.AIS_FLAGS_VALID_VELOCITY
        flags |= dialect.AIS_FLAGS_HIGH_VELOCITY if tenths == FASTEST_TENTHS else 0
    course_cdeg = 0
    if position.course_deg is not None:
        course_cdeg = round(position.course_deg * 10.0) % 3600 * 10
        flags |= dialect.AIS_FLAGS_VALID_COG
    heading_cdeg = 0xFFFF if position.heading_deg is None else round(position.heading_deg) % 360 * 100
    turn_ddegps = 0
    if position.turn_rate_degpmin is not None:
        turn_ddegps = round(min(max(position.turn_rate_degpmin / 6.0, -126.0), 126.0))
        flags |= dialect.AIS_FLAGS_VALID_TURN_RATE
    vessel = static or AisStatic(position.mmsi)
    ends = vessel.dimensions
    if min(ends.bow_m, ends.stern_m, ends.port_m, ends.starboard_m) > 0:
        flags |= dialect.AIS_FLAGS_VALID_DIMENSIONS
    flags |= dialect.AIS_FLAGS_VALID_CALLSIGN if vessel.callsign else 0
    flags |= dialect.AIS_FLAGS_VALID_NAME if vessel.name else 0
    return dialect.MAVLink_ais_vessel_message(
        position.mmsi,
        _e7(position.lat_deg, 91.0),
        _e7(position.lon_deg, 181.0),
        course_cdeg,
        heading_cdeg,
        round(tenths * KNOT_MPS * 10.0),
        turn_ddegps,
        position.status,
        vessel.ship_type,
        ends.bow_m,
        ends.stern_m,
        ends.port_m,
        ends.starboard_m,
        vessel.callsign.upper().encode("ascii", "replace"),
        vessel.name.upper().encode("ascii", "replace"),
        0,
        flags,
    )


def adsb_vehicle(position: AisPosition, static: AisStatic | None) -> Any:
    """Return ADSB_VEHICLE with the available fields, at sea level. The last 24 bits of the MMSI are the address."""
    flags = dialect.ADSB_FLAGS_VALID_COORDS | dialect.ADSB_FLAGS_VALID_ALTITUDE
    flags |= dialect.ADSB_FLAGS_VALID_HEADING if position.course_deg is not None else 0
    flags |= dialect.ADSB_FLAGS_VALID_VELOCITY if position.speed_mps is not None else 0
    name = "" if static is None else static.callsign or static.name
    flags |= dialect.ADSB_FLAGS_VALID_CALLSIGN if name else 0
    return dialect.MAVLink_adsb_vehicle_message(
        position.mmsi & _SHIFTED,
        _e7(position.lat_deg, 91.0),
        _e7(position.lon_deg, 181.0),
        GEOMETRIC,
        0,
        round((position.course_deg or 0.0) * 100.0) % 36000,
        round((position.speed_mps or 0.0) * 100.0),
        0,
        name.upper()[:8].encode("ascii", "replace"),
        SURFACE_VEHICLE,
        0,
        flags,
        0,
    )


def _e7(degrees: float | None, unknown: float) -> int:
    return round(round((unknown if degrees is None else degrees) * 600_000.0) / 600_000.0 * 1e7)
