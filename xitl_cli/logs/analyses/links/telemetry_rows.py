"""What an autopilot logs of its own links: MAV, RAD, UART, TSYN."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants, grid, number
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.table import Table, by_instance, first_of

DROP_WARNING = 0.05
LEAST_PACKETS = 50  # fewer say nothing of a link
MARGIN_LOW = 10.0  # RSSI less noise of a SiK radio, in its own steps of about half a dB
TRIP_WARNING_MS = 500.0
LONGEST_TRIP_MS = 1e6  # what ArduPilot subtracts the wrong way round goes below 0 and comes out near 2^64
ROUND = 1 << 16  # counts of packets are of 16 bits


def section(log: Log, instants: Instants) -> Section | None:
    parts = [of(log, instants) for of in (_channels, _radio, _serial, _trips)]
    found = [part for part in parts if part is not None]
    if not found:
        return None
    return Section(
        "links",
        "Links",
        tuple(fact for part in found for fact in part.facts),
        tuple(finding for part in found for finding in part.findings),
        tuple(each for part in found for each in part.grids),
        tuple(plot for part in found for plot in part.plots),
    )


def _grown(table: Table, column: str) -> NDArray[np.int64]:
    """(N,) by how much a count of 16 bits grew at each row."""
    values = np.asarray(table.values(column, raw=True)).astype(np.int64)
    grown: NDArray[np.int64] = np.diff(values, prepend=values[:1]) % ROUND
    return np.where(grown < ROUND // 2, grown, 0)


def _channels(log: Log, instants: Instants) -> Section | None:
    table = log.tables.get("MAV")
    if table is None or not {"txp", "rxp", "rxdp"} <= set(table.columns):
        return None
    channels = by_instance(table)
    rows: list[tuple[Value, ...]] = []
    findings = []
    for channel, mine in channels.items():
        sent, received, dropped = (int(_grown(mine, name).sum()) for name in ("txp", "rxp", "rxdp"))
        slowed = int(np.max(np.asarray(mine.values("ss", raw=True)), initial=0)) if "ss" in mine.columns else None
        rows.append((channel, sent, received, dropped, slowed))
        of = received + dropped
        if dropped and of >= LEAST_PACKETS:
            at = np.flatnonzero(_grown(mine, "rxdp"))
            begin, end = int(mine.stamp_ns[at[0]]), int(mine.stamp_ns[at[-1]])
            findings.append(
                Finding(
                    "links.dropped",
                    Severity.WARNING if dropped / of > DROP_WARNING else Severity.NOTICE,
                    f"The autopilot missed {dropped} of {of} packets sent to it on channel {channel} "
                    f"({100.0 * dropped / of:.1f} %), from {instants.text(begin)} to {instants.text(end)}",
                    (Evidence("MAV", "rxdp", begin, end, str(dropped)),),
                    "Look at the radio, its antenna and the baud rate of that port; several senders with one system "
                    "number look the same.",
                )
            )
    heard = sum(int(_grown(mine, "rxp").sum()) for mine in channels.values())
    if heard >= LEAST_PACKETS and not findings:
        said = f"None of {heard} MAVLink packets sent to the autopilot was missed"
        findings.append(Finding("links.received_whole", Severity.OK, said))
    columns = ("channel", "packets sent", "received", "missed", "stream slowed by, most (ms)")
    facts = (Fact("channels", "MAVLink channels", len(channels)),)
    return Section("links", "", facts, tuple(findings), (grid("channels", "MAVLink channels", columns, rows),))


def _radio(log: Log, instants: Instants) -> Section | None:
    table = log.tables.get("RAD")
    if table is None or not {"RSSI", "Noise"} <= set(table.columns) or not len(table):
        return None
    facts: list[Fact] = []
    traces: list[Trace] = []
    findings = []
    for strength, noise, where in (("RSSI", "Noise", "at the vehicle"), ("RemRSSI", "RemNoise", "at the ground")):
        if not {strength, noise} <= set(table.columns):
            continue
        level, floor = (np.asarray(table.values(name), dtype=np.float64) for name in (strength, noise))
        margin = level - floor
        low = np.flatnonzero(margin < MARGIN_LOW)
        facts.append(Fact(f"{strength.lower()}_margin", f"Signal over noise {where}, least", number(margin.min(), 0)))
        traces += [Trace(strength, table.stamp_ns, level), Trace(noise, table.stamp_ns, floor)]
        if len(low):
            begin, end = int(table.stamp_ns[low[0]]), int(table.stamp_ns[low[-1]])
            findings.append(
                Finding(
                    "links.radio_margin",
                    Severity.WARNING,
                    f"The radio's signal {where} was within {MARGIN_LOW:.0f} steps of the noise in {len(low)} of "
                    f"{len(table)} reports, first at {instants.text(begin)}",
                    (Evidence("RAD", strength, begin, end, f"{margin.min():.0f}"),),
                    "Look at antennas and their place, at the distance then, and at what else transmits nearby.",
                )
            )
    for name, label in (("RxErrors", "Radio: receive errors"), ("Fixed", "Radio: errors corrected")):
        if name in table.columns:
            facts.append(Fact(f"radio_{name.lower()}", label, int(_grown(table, name).sum())))
    plots = (Plot("radio", "Telemetry radio", "steps of about 0.5 dB", tuple(traces)),)
    return Section("links", "", tuple(facts), tuple(findings), plots=plots)


def _serial(log: Log, instants: Instants) -> Section | None:
    table = log.tables.get("UART")
    if table is None or not {"Tx", "Rx"} <= set(table.columns):
        return None
    rows: list[tuple[Value, ...]] = []
    findings = []
    for port, mine in by_instance(table).items():
        sent, received = (np.nan_to_num(np.asarray(mine.values(name), dtype=np.float64)) for name in ("Tx", "Rx"))
        lost = np.zeros(len(mine))
        if "RxDp" in mine.columns:
            lost = np.nan_to_num(np.asarray(mine.values("RxDp"), dtype=np.float64))
        rows.append((port, *(number(value, 0) for value in (sent.mean(), sent.max(), received.mean(), received.max()))))
        at = np.flatnonzero(lost > 0.0)
        if len(at):
            begin, end = int(mine.stamp_ns[at[0]]), int(mine.stamp_ns[at[-1]])
            findings.append(
                Finding(
                    "links.serial_overflow",
                    Severity.WARNING,
                    f"Serial port {port} lost bytes it had received, up to {lost.max():.0f} a second, first at "
                    f"{instants.text(begin)}",
                    (Evidence("UART", "RxDp", begin, end, f"{lost.max():.0f} B/s"),),
                    "They came faster than they were read: look at the long loops then, or use DMA on that port.",
                )
            )
    columns = ("port", "sent, mean (B/s)", "most (B/s)", "received, mean (B/s)", "most (B/s) ")
    grids: tuple[Grid, ...] = (grid("serial_ports", "Serial ports", columns, rows),)
    return Section("links", "", (), tuple(findings), grids)


def _trips(log: Log, instants: Instants) -> Section | None:
    table = log.tables.get("TSYN")
    column = None if table is None else first_of(table, ("RTT",))
    if table is None or column is None or not len(table):
        return None
    trip_ms = np.asarray(table.values(column, raw=True), dtype=np.float64) * 1e-3
    good = np.isfinite(trip_ms) & (trip_ms >= 0.0) & (trip_ms < LONGEST_TRIP_MS)
    if not good.any():
        return None
    p50, p99 = np.percentile(trip_ms[good], (50.0, 99.0))
    findings = []
    if p99 > TRIP_WARNING_MS:
        worst = int(np.argmax(np.where(good, trip_ms, -1.0)))
        at_ns = int(table.stamp_ns[worst])
        findings.append(
            Finding(
                "links.round_trip",
                Severity.WARNING,
                f"One round trip in a hundred took {p99:.0f} ms or more, the longest {trip_ms[worst]:.0f} ms at "
                f"{instants.text(at_ns)}",
                (Evidence("TSYN", column, at_ns, value=f"{trip_ms[worst]:.0f} ms"),),
                "A companion that controls over this link sees it late: look at its load and the link's rate.",
            )
        )
    facts = (
        Fact("round_trip_p50_ms", "Round trip, median", number(p50, 2), "ms"),
        Fact("round_trip_p99_ms", "Round trip, 99 %", number(p99, 2), "ms"),
        Fact("round_trips_impossible", "Round trips that cannot be", int(np.sum(~good))),
    )
    plot = Plot("round_trip", "Round trip", "ms", (Trace("TSYN.RTT", table.stamp_ns[good], trip_ms[good], "points"),))
    return Section("links", "", facts, tuple(findings), plots=(plot,))
