"""AIS receivers: AIS_VESSEL or ADSB_VEHICLE by MAVLink, or sentences on a line."""

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
