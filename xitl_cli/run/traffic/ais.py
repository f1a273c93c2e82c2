"""AIS messages as bytes: ITU-R M.1371-5 payloads in six-bit characters, in the !AIVDM sentences of a receiver.

Pure functions. Fields and their widths are from the recommendation, annex 8. The armouring and the sentence are from
NMEA 0183 as the gpsd project describes them (AIVDM/AIVDO protocol decoding).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import NamedTuple

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
