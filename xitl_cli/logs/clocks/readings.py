"""Readings of two clocks at the same events, for each kind of log.

DataFlash   in logs of xitl, the sensors' clock (SampleUS), which is simulation time; GPS time and the autopilot's clock
            (GPA.SMS: arrival of the message); UTC of PM.R
MCAP        in recordings of xitl, /clocks: simulation time and the host's clock (PS1), the host's and each node's;
            telemetry's time_boot_ms; stamps in the headers of ROS messages
tlog        time_boot_ms of each autopilot, its SYSTEM_TIME and TIMESYNC, against arrival at the ground station
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Flags, Selection, Stamps, Table, by_instance, first_of, rising
from xitl_cli.logs.signals import px4


@dataclass(frozen=True, slots=True)
class ClockReadings:
    """(N,) instants on two clocks."""

    key: str
    """Stable name for machines."""
    first: str
    """Name of the first clock."""
    second: str
    """Name of the second clock."""
    at_ns: Stamps
    """(N,) on the log's own time."""
    first_ns: Stamps
    second_ns: Stamps
    message: str
    """Message with the readings."""
    fields: str
    """Fields with the readings."""
    late: bool = False
    """True if the second clock was read after the event by a delay with a minimum but no maximum. If False, errors have
    no preferred sign."""
    floor_ns: Stamps | None = None
    """Of exchanges: (N,) least possible offset; second minus first is the greatest possible. Otherwise None."""
    resolution_s: float = 0.0
    """Step of the coarser clock."""
    slack_s: float = 0.0
    """Largest distance of a reading from its event, to the event before or after."""

    def __len__(self) -> int:
        return len(self.first_ns)

    def __getitem__(self, rows: slice | Flags | NDArray[np.intp]) -> ClockReadings:
        return replace(
            self,
            at_ns=self.at_ns[rows],
            first_ns=self.first_ns[rows],
            second_ns=self.second_ns[rows],
            floor_ns=None if self.floor_ns is None else self.floor_ns[rows],
        )

    @property
    def offset_ns(self) -> Stamps:
        """(N,) second minus first; for exchanges the greatest possible offset."""
        return self.second_ns - self.first_ns

    @property
    def level_ns(self) -> Stamps:
        """(N,) the most likely offset; for exchanges half way between the bounds."""
        offset_ns = self.offset_ns
        return offset_ns if self.floor_ns is None else self.floor_ns + (offset_ns - self.floor_ns) // 2

    def within(self, farthest_ns: int) -> ClockReadings:
        """Readings without impossible values, farther than `farthest_ns` from the zero of their clock."""
        clocks = [self.first_ns, self.second_ns] if self.floor_ns is None else [
            self.first_ns, self.second_ns, self.floor_ns,
        ]  # fmt: skip
        good = np.ones(len(self), dtype=np.bool_)
        for clock_ns in clocks:
            good &= (clock_ns > -farthest_ns) & (clock_ns < farthest_ns)
        return self if good.all() else self[good]

    def in_order(self) -> ClockReadings:
        """Readings without values that the first clock repeats or shows out of order; values after a step back are
        omitted."""
        ahead = rising(self.first_ns)
        return self if ahead.all() else self[ahead]

    def thinned(self, most: int) -> ClockReadings:
        """The best reading of each of `most` groups of equal size: the least delayed, or the middle of the group."""
        if len(self) <= most:
            return self
        group = np.arange(len(self)) * most // len(self)
        offset_ns = self.offset_ns
        if self.floor_ns is not None:
            badness = offset_ns - self.floor_ns
        elif self.late:
            badness = offset_ns
        else:
            badness = np.zeros(len(self), dtype=np.int64)
        order = np.lexsort((badness, group))
        starts = np.searchsorted(group[order], np.arange(most))
        if self.floor_ns is None and not self.late:
            order = np.lexsort((offset_ns, group))
            ends = np.append(starts[1:], len(self))
            starts = (starts + ends) // 2
        return self[np.sort(order[starts])]


LOG, HOST, SIMULATION, UTC = "the recorder's clock", "the host's clock", "simulation time", "UTC"
AUTOPILOT = "the autopilot's clock"
GPS_EPOCH_S = 315_964_800  # 1980-01-06 in Unix time
WEEK_MS = 604_800_000
GPS_LEAP_S = 18  # GPS minus UTC since 2017
EARLIEST_UTC_NS = 1_262_304_000_000_000_000  # 2010: before it, a receiver or a clock has not been set
LATEST_UTC_NS = 4_102_444_800_000_000_000  # 2100
FEWEST = 3
MOST_TOPICS = 6
STAMP = "header.stamp"
SAMPLED = ("IMU", "BARO", "MAG", "GPS")
GPS_SLACK_S = 20e-3  # between two loops, behind other messages: fixes arrive this unevenly
LONGER_WAIT_NS = 100_000_000  # of a fix for its row in the log, beyond the usual time
LONGEST_TRIP_S = 10.0
LONGEST_TOPIC = 500_000  # rows; stamps need the whole topic to be read
BOOTED = ("ATTITUDE", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE_QUATERNION", "RC_CHANNELS", "SCALED_IMU2")


def boot_clock(system: int | str) -> str:
    """Name of an autopilot's clock since boot, by its MAVLink system or its node of a run."""
    return f"autopilot {system}" if isinstance(system, int) else system


def clock_readings(log: Log) -> list[ClockReadings]:
    """Every pair of clocks in this log with at least three readings."""
    by_format = {"dataflash": _from_dataflash, "tlog": _from_telemetry}
    return [readings for readings in by_format.get(log.format, _from_recording)(log) if len(readings) >= FEWEST]


def _from_dataflash(log: Log) -> Iterator[ClockReadings]:
    for name in SAMPLED:  # in logs of xitl: to the microsecond, whereas GPS time is in milliseconds
        sensor = log.tables.get(name)
        if sensor is not None and "SampleUS" in sensor.columns:
            sampled_ns, stamps = whole_numbers(sensor, "SampleUS") * 1000, sensor.stamp_ns
            clocks = f"samples.{name}", "the sensors' clock", AUTOPILOT
            fields = "SampleUS, TimeUS"
            yield ClockReadings(*clocks, stamps, sampled_ns, stamps, name, fields, late=True, resolution_s=1e-6)
            break
    gps = log.tables.get("GPS")
    if gps is not None:
        arrival = log.tables.get("GPA")
        arrivals = {} if arrival is None else by_instance(arrival)
        for number, table in by_instance(gps).items():
            readings = _gps_time(number, table, arrivals.get(number))
            if readings is not None:
                yield readings
    performance = log.tables.get("PM")
    if performance is not None and "R" in performance.columns:
        utc_ns = whole_numbers(performance, "R") * 1000
        known = (utc_ns > EARLIEST_UTC_NS) & (utc_ns < LATEST_UTC_NS)
        stamps = performance.stamp_ns
        clocks = "rtc", AUTOPILOT, UTC
        yield ClockReadings(*clocks, stamps, stamps, utc_ns, "PM", "TimeUS, R", resolution_s=1e-6)[known]


def _gps_time(number: int, table: Table, arrival: Table | None) -> ClockReadings | None:
    if not {"GWk", "GMS"} <= set(table.columns):
        return None
    week, ms = whole_numbers(table, "GWk"), whole_numbers(table, "GMS")
    set_ = (week > 0) & (week < 10_000) & (ms >= 0) & (ms < WEEK_MS)
    utc_ns = (week * WEEK_MS + ms) * 1_000_000 + (GPS_EPOCH_S - GPS_LEAP_S) * 1_000_000_000
    at_ns = table.stamp_ns
    came_ns, message, field = at_ns, "GPS", "GWk, GMS, TimeUS"
    if arrival is not None and "SMS" in arrival.columns:
        rows = _matching(at_ns, arrival.stamp_ns)
        came_ns = np.where(rows >= 0, whole_numbers(arrival, "SMS")[np.maximum(rows, 0)] * 1_000_000, -1)
        set_ &= (rows >= 0) & (came_ns > 0)
        # TimeUS is of the same clock: an arrival that is too early belongs to an earlier message.
        waited_ns = at_ns - came_ns
        set_ &= waited_ns < np.median(waited_ns[set_] if set_.any() else waited_ns) + LONGER_WAIT_NS
        message, field = "GPA", "GPS.GWk, GPS.GMS, SMS"
    set_[1:] &= came_ns[1:] != came_ns[:-1]  # a message logged twice, or a backlog that arrived at once
    clocks = "gps" if number == 0 else f"gps.{number}", f"GPS {number + 1}", AUTOPILOT
    return ClockReadings(
        *clocks, at_ns, utc_ns, came_ns, message, field, late=True, resolution_s=1e-3, slack_s=GPS_SLACK_S
    )[set_]


def _matching(wanted: Stamps, stamps: Stamps) -> NDArray[np.intp]:
    """Row of `stamps` with each wanted instant, -1 if there is none."""
    order = np.argsort(stamps, kind="stable")
    at = np.searchsorted(stamps[order], wanted)
    at = np.minimum(at, max(len(stamps) - 1, 0))
    if not len(stamps):
        return np.full(len(wanted), -1, dtype=np.intp)
    rows = order[at]
    return np.where(stamps[rows] == wanted, rows, -1)


def _from_recording(log: Log) -> Iterator[ClockReadings]:
    clocks = log.tables.get("/clocks")
    exchanges: list[ClockReadings] = []
    if clocks is not None and {"node", "host_ns", "node_ns", "round_trip_s"} <= set(clocks.columns):
        exchanges = list(_exchanges(clocks))
    yield from exchanges
    if all(readings.key == "clocks.PS1" for readings in exchanges):  # exchanges measure a clock better than arrivals
        yield from _boot_clocks(log, SIMULATION if log.base == "simulation" else LOG)
    # Header stamps of messages against the time of recording, unless they are equal by construction
    topics = 0
    for name, table in log.tables.items() if log.base != "simulation" else ():
        heavy = any(column.kind == "bytes" or -1 in column.shape for column in table.columns.values())
        if STAMP not in table.columns or heavy or len(table) > LONGEST_TOPIC or topics == MOST_TOPICS:
            continue
        header_ns, at_ns = whole_numbers(table, STAMP), table.stamp_ns
        if not len(at_ns) or not (at_ns - header_ns).any():
            continue
        topics += 1
        names, fields = (f"header.{name}", f"stamps of {name}", LOG), f"{STAMP}, log_time"
        yield ClockReadings(*names, at_ns, header_ns, at_ns, name, fields, late=True, resolution_s=1e-9)


def _exchanges(clocks: Table) -> Iterator[ClockReadings]:
    nodes = np.asarray(clocks.values("node"))
    names = sorted(set(nodes.tolist()))
    in_lockstep = "PS1" not in names
    for name in names:
        table = Selection(clocks, nodes == name)
        host_ns, node_ns, at_ns = whole_numbers(table, "host_ns"), whole_numbers(table, "node_ns"), table.stamp_ns
        if name == "PS1":
            read = at_ns, node_ns, host_ns, "/clocks", "PS1: node_ns, host_ns"
            yield ClockReadings("clocks.PS1", SIMULATION, HOST, *read, late=True, resolution_s=1e-9)
            continue
        trip_s = np.asarray(table.values("round_trip_s"), dtype=np.float64)
        good = np.isfinite(trip_s) & (trip_s >= 0.0) & (trip_s < LONGEST_TRIP_S)
        trip_ns = np.round(np.where(good, trip_s, 0.0) * 1e9).astype(np.int64)
        key, clock = f"clocks.{name}", f"the clock of {name}"
        read = at_ns, host_ns, node_ns, "/clocks", f"{name}: host_ns, node_ns, round_trip_s"
        if in_lockstep:  # simulation time stops on the way; the answer is from one of the adjacent ticks
            longest_s = max(float(np.max(trip_s[good], initial=0.0)), 1e-3)
            yield ClockReadings(key, SIMULATION, clock, *read, resolution_s=longest_s)[good]
        else:
            floor_ns = node_ns - host_ns - trip_ns
            # Largest lag of a simulated clock before it caught up: the excess of its bound over the
            # bound of the path.
            if not {"asymmetry_bound_s", "path_delay_s"} <= set(table.columns):
                slack_s = 0.0
            else:
                beyond_s = 2.0 * (table.values("asymmetry_bound_s") - table.values("path_delay_s"))
                slack_s = max(float(np.nanmax(beyond_s, initial=0.0)), 0.0)
            readings = ClockReadings(key, HOST, clock, *read, True, floor_ns, resolution_s=1e-9, slack_s=slack_s)
            yield readings[good]


def _from_telemetry(log: Log) -> Iterator[ClockReadings]:
    yield from _boot_clocks(log, "the ground station's clock")
    for system, table in _by_system(log.tables.get("SYSTEM_TIME")):
        if {"time_boot_ms", "time_unix_usec"} <= set(table.columns):
            utc_ns = whole_numbers(table, "time_unix_usec") * 1000
            known = (utc_ns > EARLIEST_UTC_NS) & (utc_ns < LATEST_UTC_NS)
            boot_ns = whole_numbers(table, "time_boot_ms") * 1_000_000
            clocks, fields = (f"system_time.{system}", boot_clock(system), UTC), "time_boot_ms, time_unix_usec"
            yield ClockReadings(*clocks, table.stamp_ns, boot_ns, utc_ns, "SYSTEM_TIME", fields, resolution_s=1e-3)[
                known
            ]
    for system, table in _by_system(log.tables.get("TIMESYNC")):
        if not {"tc1", "ts1"} <= set(table.columns):
            continue
        remote_ns, local_ns = whole_numbers(table, "tc1"), whole_numbers(table, "ts1")
        answered = (remote_ns > 0) & (local_ns > 0)
        clocks = f"timesync.{system}", "the ground station's monotonic clock", boot_clock(system)
        yield ClockReadings(
            *clocks, table.stamp_ns, local_ns, remote_ns, "TIMESYNC", "ts1, tc1", late=True, resolution_s=1e-6
        )[answered]


def _by_system(table: Table | None) -> list[tuple[int, Table]]:
    if table is None or "_sysid" not in table.columns:
        return []
    systems = table.values("_sysid", raw=True)
    return [(int(system), Selection(table, systems == system)) for system in np.unique(systems)]


def _booted(log: Log) -> Iterator[tuple[str, Table]]:
    """Messages with the time since boot, and the link that carried them."""
    if log.format == "tlog":
        for name, table in log.tables.items():
            if "time_boot_ms" in table.columns and name != "SYSTEM_TIME":
                yield "", table
        return
    for link in [name for name in log.tables if name.startswith("/link/") and name.endswith("/rx")]:
        for message in BOOTED:
            sent = log.tables.get(f"{link}:{message}")
            if sent is not None and "time_boot_ms" in sent.columns:
                yield link, sent


def _boot_clocks(log: Log, arrival: str) -> Iterator[ClockReadings]:
    """time_boot_ms of all messages of a system, against their arrival."""
    parts: dict[tuple[str, int], list[tuple[Stamps, Stamps, Stamps]]] = {}
    for link, table in _booted(log):
        for system, mine in _by_system(table):
            boot_ns = whole_numbers(mine, "time_boot_ms") * 1_000_000
            parts.setdefault((link, system), []).append((boot_ns, mine.stamp_ns, mine.file_offset))
    for (link, system), tables in sorted(parts.items()):
        boot_ns, at_ns, place = (np.concatenate(arrays) for arrays in zip(*tables, strict=True))
        order = np.argsort(place, kind="stable")
        known = order[boot_ns[order] > 0]
        clocks = f"boot.{system}.{link}" if link else f"boot.{system}", boot_clock(system), arrival
        stamps = at_ns[known], boot_ns[known], at_ns[known]
        message = f"{link}:*" if link else "*"
        yield ClockReadings(*clocks, *stamps, message, "time_boot_ms", late=True, resolution_s=1e-3)


def whole_numbers(table: Table, column: str) -> Stamps:
    """Whole numbers as stored; values that do not fit 63 bits become 0."""
    values = table.values(column, raw=True)
    if values.dtype.kind == "f":
        values = np.where(np.isfinite(values) & (np.abs(values) < 9e18), values, 0.0)
    elif values.dtype == np.uint64:
        values = np.where(values < np.uint64(1 << 63), values, np.uint64(0))
    whole: Stamps = np.asarray(values).astype(np.int64)
    return whole


# UTC of a log with time that counts from the start of an autopilot or of a run.

_FIX_3D = 3
_MOST_WEEKS = 10_000
_RECEIVED = "/rx"


@dataclass(frozen=True, slots=True)
class UtcOffset:
    """Offset of UTC from the stamps of a log."""

    offset_ns: int
    """UTC minus the log's stamps."""
    source: str
    """Source of the offset, worded to follow "UTC"."""


def utc_offset(log: Log) -> UtcOffset | None:
    """Return the median offset by the log's best source of UTC: GPS, the autopilot's clock or SYSTEM_TIME.

    None if there is no source.
    """
    if log.base == "utc":
        return UtcOffset(0, "of the receiving machine")
    for source, stamp_ns, utc_ns in _utc_sources(log):
        known = (utc_ns > EARLIEST_UTC_NS) & (utc_ns < LATEST_UTC_NS)
        if known.any():
            offset_ns = np.sort(utc_ns[known] - stamp_ns[known])
            return UtcOffset(int(offset_ns[len(offset_ns) // 2]), source)
    return None


def in_utc(stamp_ns: Stamps, utc: UtcOffset | None) -> Stamps:
    """Stamps in UTC; unchanged if UTC is unknown."""
    if utc is None:
        return stamp_ns
    return np.minimum(stamp_ns, np.iinfo(np.int64).max - max(utc.offset_ns, 0)) + utc.offset_ns


def _utc_sources(log: Log) -> Iterator[tuple[str, Stamps, Stamps]]:
    """Yield source, stamps and UTC at each stamp, without a plausibility check."""
    px4_utc = px4.utc(log)
    if px4_utc is not None:
        yield "by GPS", *px4_utc
    gps = log.tables.get("GPS")
    if gps is not None and "Status" in gps.columns:
        week, ms = first_of(gps, ("GWk", "Week")), first_of(gps, ("GMS", "TimeMS"))
        if week is not None and ms is not None:
            weeks = whole_numbers(gps, week)
            fixed = (np.asarray(gps.values("Status", raw=True)) >= _FIX_3D) & (weeks > 0) & (weeks < _MOST_WEEKS)
            since_ms = weeks[fixed] * WEEK_MS + whole_numbers(gps, ms)[fixed]
            yield "by GPS", gps.stamp_ns[fixed], since_ms * 1_000_000 + (GPS_EPOCH_S - GPS_LEAP_S) * 1_000_000_000
    performance = log.tables.get("PM")
    if performance is not None and "R" in performance.columns:
        yield "by PM.R", performance.stamp_ns, whole_numbers(performance, "R") * 1000
    names = ["SYSTEM_TIME"]
    if log.of_topics:
        names += [f"{topic}:SYSTEM_TIME" for topic in log.tables if topic.endswith(_RECEIVED)]
    for name in names:
        table = log.tables.get(name)
        if table is not None and "time_unix_usec" in table.columns:
            yield "by SYSTEM_TIME", table.stamp_ns, whole_numbers(table, "time_unix_usec") * 1000
