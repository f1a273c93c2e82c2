"""Who hears AIS, each in its own way: AIS_VESSEL or ADSB_VEHICLE by MAVLink, or sentences on a line."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any

from agent.wire import dialect
from agent.wire.transport import Transport
from xitl_cli.run.traffic.ais import KNOT_MPS, AisPosition, AisStatic, sentences
from xitl_cli.run.traffic.transponder import AisTransmission

Send = Callable[[Any], object]
AisReceiver = Callable[[AisTransmission], object]

FASTEST_TENTHS = 1022  # of a knot, and more
SURFACE_VEHICLE, GEOMETRIC = 18, 1  # ADSB_EMITTER_TYPE, ADSB_ALTITUDE_TYPE
_SHIFTED = 0xFFFFFF  # an ICAO address has 24 bits, which the serial number of an MMSI fits


class HeardVessels:
    """A receiver that puts what a vessel is beside where it is, and hands both to `told` with each position."""

    def __init__(self, told: Callable[[AisPosition, AisStatic | None], object]) -> None:
        self._told = told
        self._static: dict[int, AisStatic] = {}

    def __call__(self, heard: AisTransmission) -> None:
        """One transmission; what a vessel is comes with its next position."""
        if isinstance(heard.report, AisStatic):
            self._static[heard.report.mmsi] = heard.report
        else:
            self._told(heard.report, self._static.get(heard.report.mmsi))


def mavlink_receiver(send: Send) -> AisReceiver:
    """AIS_VESSEL, as ArduPilot makes it of what it hears."""
    return HeardVessels(lambda position, static: send(ais_vessel(position, static)))


def px4_receiver(send: Send) -> AisReceiver:
    """ADSB_VEHICLE: PX4 reads no AIS, and passes this one on to its ground stations."""
    return HeardVessels(lambda position, static: send(adsb_vehicle(position, static)))


class SentenceReceiver:
    """A receiver with a line of its own, whose sentences somebody reads; unsent: bytes that the line did not take."""

    def __init__(self, line: Transport) -> None:
        self.unsent = 0
        self._line = line
        self._sequence, self._channel = count(), count()

    def __call__(self, heard: AisTransmission) -> None:
        """One transmission, on the two channels in turn."""
        for payload in heard.payloads():
            channel, sequence = "AB"[next(self._channel) % 2], next(self._sequence)
            for sentence in sentences(payload, channel, sequence):
                if not self._line.send(sentence):
                    self.unsent += len(sentence)


def ais_vessel(position: AisPosition, static: AisStatic | None) -> Any:
    """The message, in the steps of AIS: a ten-thousandth of a minute, a tenth of a knot, of a degree.

    Its turn rate is in ddeg/s (common.xml of MAVLink; ArduPilot 4.7 still sends cdeg/s).
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
    what = static or AisStatic(position.mmsi)
    ends = what.dimensions
    if min(ends.bow_m, ends.stern_m, ends.port_m, ends.starboard_m) > 0:
        flags |= dialect.AIS_FLAGS_VALID_DIMENSIONS
    flags |= dialect.AIS_FLAGS_VALID_CALLSIGN if what.callsign else 0
    flags |= dialect.AIS_FLAGS_VALID_NAME if what.name else 0
    return dialect.MAVLink_ais_vessel_message(
        position.mmsi,
        _e7(position.lat_deg, 91.0),
        _e7(position.lon_deg, 181.0),
        course_cdeg,
        heading_cdeg,
        round(tenths * KNOT_MPS * 10.0),
        turn_ddegps,
        position.status,
        what.ship_type,
        ends.bow_m,
        ends.stern_m,
        ends.port_m,
        ends.starboard_m,
        what.callsign.upper().encode("ascii", "replace"),
        what.name.upper().encode("ascii", "replace"),
        0,
        flags,
    )


def adsb_vehicle(position: AisPosition, static: AisStatic | None) -> Any:
    """The same as far as that message can tell it, at sea level; the last 24 bits of the MMSI are its address."""
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
