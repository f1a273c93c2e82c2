"""AIS vessels: a table by MMSI, filled from AIS_VESSEL and forwarded to every ground station."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

from agent.mavlink.exchange import Messages
from agent.wire import dialect as mav

MOST_VESSELS = 100
TIMEOUT_NS = 600_000_000_000  # ArduPilot's AIS_TIME_OUT: three reports of a vessel at anchor
AGAIN_NS = 30_000_000_000  # repeat interval, so that a late station receives unchanged vessels too, as from ArduPilot
EVERY_NS = 50_000_000  # one vessel at a time
_MOST_LAT, _MOST_LON = 900_000_000, 1_800_000_000


class HeardVessel(NamedTuple):
    """Last AIS_VESSEL of a vessel, and its time of arrival."""

    message: Any
    heard_ns: int


class TrafficTable:
    """Newest report of each vessel. A vessel that is silent for TIMEOUT_NS is dropped.

    Beyond MOST_VESSELS, the vessel that was silent for longest is dropped.
    """

    def __init__(self) -> None:
        self.refused = 0
        """Number of messages without an MMSI or a valid position."""
        self.dropped = 0
        """Number of vessels dropped for lack of room."""
        self._vessels: dict[int, HeardVessel] = {}

    def __len__(self) -> int:
        return len(self._vessels)

    def __iter__(self) -> Iterator[HeardVessel]:
        """Iterate in the order of arrival, the newest last."""
        return iter(self._vessels.values())

    def add(self, message: Any, now_ns: int) -> None:
        """Add an AIS_VESSEL."""
        if not message.MMSI or abs(message.lat) > _MOST_LAT or abs(message.lon) > _MOST_LON:
            self.refused += 1
            return
        self.forget_silent(now_ns)
        if self._vessels.pop(message.MMSI, None) is None and len(self._vessels) >= MOST_VESSELS:
            del self._vessels[next(iter(self._vessels))]
            self.dropped += 1
        self._vessels[message.MMSI] = HeardVessel(message, now_ns)

    def forget_silent(self, now_ns: int) -> None:
        """Drop the vessels that were silent for too long."""
        while self._vessels:
            oldest = next(iter(self._vessels))
            if 0 <= now_ns - self._vessels[oldest].heard_ns <= TIMEOUT_NS:
                return
            del self._vessels[oldest]


class HasTraffic(Protocol):
    """Holder of the table, which is a new one after a restart."""

    traffic: TrafficTable


class TrafficReports:
    """AIS_VESSEL messages for one station: each vessel after an update, and again after AGAIN_NS."""

    def __init__(self, hub: HasTraffic) -> None:
        self._hub = hub
        self._sent: dict[int, tuple[int, int]] = {}  # by MMSI: time of arrival and time of sending
        self._spoke_ns: int | None = None

    def poll(self, now_ns: int) -> Messages:
        """Return the vessel that has waited for longest, with the time since its report, at most every EVERY_NS."""
        table = self._hub.traffic
        if not len(table) or (self._spoke_ns is not None and 0 <= now_ns - self._spoke_ns < EVERY_NS):
            return []
        table.forget_silent(now_ns)
        for message, heard_ns in table:
            known = self._sent.get(message.MMSI)
            if known is None or known[0] != heard_ns or not 0 <= now_ns - known[1] < AGAIN_NS:
                self._sent[message.MMSI] = heard_ns, now_ns
                self._spoke_ns = now_ns
                values = {name: getattr(message, f"_{name}_raw", getattr(message, name)) for name in message.fieldnames}
                values["tslc"] = min(message.tslc + max(now_ns - heard_ns, 0) // 1_000_000_000, 65535)
                return [mav.MAVLink_ais_vessel_message(**values)]
        if len(self._sent) > 2 * MOST_VESSELS:
            heard = {vessel.message.MMSI for vessel in table}
            self._sent = {mmsi: sent for mmsi, sent in self._sent.items() if mmsi in heard}
        return []
