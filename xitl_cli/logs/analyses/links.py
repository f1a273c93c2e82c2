"""Links: losses, latency and silence, as counted by both ends (/links) and as logged by an autopilot (MAV, RAD, UART,
TSYN)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from xitl_cli.logs.analyses.link_sequences import sequence_section
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Floats, Selection, Stamps, Table, by_instance, first_of
from xitl_cli.logs.signals.moments import moments
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.spans import spells

LOSS_WARNING, LOSS_CRITICAL = 0.01, 0.2
COUNTS = ("sent", "received", "lost", "gaps", "late", "repeated", "dropped", "unsent", "refused", "impaired")
LATENCIES = ("latency_p50_s", "latency_p99_s", "latency_max_s")
LATENCY_WARNING_S = 0.1
_TROUBLES = {
    "dropped": ("frames came damaged, unknown or from elsewhere", "Look at the line's quality and at who else sends."),
    "unsent": ("frames were not taken by the transport", "The link is slower than what it has to carry: lower rates."),
    "refused": ("frames were refused for their signature", "Give both ends the same key."),
}
"""By count of /links: the fate of these frames, and the recommended action."""


def count_section(log: Log, clock: LogClock) -> Section | None:
    table = log.tables.get("/links")
    if table is None or not {"name", *COUNTS} <= set(table.columns):
        return None
    names = np.asarray(table.values("name"))
    links = {str(name): Selection(table, names == name) for name in dict.fromkeys(names.tolist())}
    last = {name: _last_counts(link) for name, link in links.items()}
    times = {name: {field: _latest(link, field) for field in LATENCIES} for name, link in links.items()}
    findings = [finding for name, link in links.items() for finding in _count_findings(name, link, last[name], clock)]
    known = {name: of for name in links if last[name]["lost"] is not None and (of := _sent_count(last[name]))}
    if known and not findings:
        counted = " and ".join(f"{of} frames on {name}" for name, of in known.items())
        findings.append(Finding.ok("links.whole", f"None of {counted} was lost"))
    facts = []
    for name in links:
        key = name.replace(" ", "_")
        lost, of = _lost(last[name]), _sent_count(last[name])
        facts += [
            Fact(f"{key}_frames", f"{name}: frames", of or None),
            Fact(f"{key}_lost_percent", f"{name}: lost", rounded(100.0 * lost / of, 3) if of else None, "%"),
            Fact(f"{key}_latency_p99_ms", f"{name}: 99 % take at most", _ms(times[name]["latency_p99_s"]), "ms"),
        ]
    rows: list[tuple[Value, ...]] = [
        (name, *(last[name][count] for count in COUNTS), *(_ms(times[name][field]) for field in LATENCIES))
        for name in links
    ]
    columns = ("link", *COUNTS, "half take (ms)", "99 % take (ms)", "longest (ms)")
    return Section(
        "links",
        "Links",
        tuple(fact for fact in facts if fact.value is not None),
        tuple(findings),
        (Grid.limited("links", "Frames on each link, as both ends counted them", columns, rows),),
        _count_plots(links),
    )


def _last_counts(link: Table) -> dict[str, int | None]:
    """Last known value of each count. `lost` is None if the two ends did not agree in the end."""
    counts: dict[str, int | None] = {}
    for count in COUNTS:
        values = np.asarray(link.values(count, raw=True))
        known = np.flatnonzero(values >= 0)
        counts[count] = int(values[known[-1]]) if len(known) else None
        if count == "lost" and values[-1] < 0:
            counts[count] = None
    return counts


def _latest(link: Table, field: str) -> float | None:
    if field not in link.columns:
        return None
    values = np.asarray(link.values(field), dtype=np.float64)
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else None


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else rounded(1e3 * seconds)


def _lost(counts: dict[str, int | None]) -> int:
    """Losses by the counts of both ends, else at least those that the receiver misses."""
    lost = counts["lost"]
    return counts["gaps"] or 0 if lost is None else lost


def _sent_count(counts: dict[str, int | None]) -> int:
    """Frames sent; if unknown, received plus lost frames."""
    if counts["sent"] is not None:
        return counts["sent"]
    return (counts["received"] or 0) - (counts["repeated"] or 0) + _lost(counts)


def _count_findings(name: str, link: Table, counts: dict[str, int | None], clock: LogClock) -> Iterator[Finding]:
    lost, of = _lost(counts), _sent_count(counts)
    on_purpose = min(counts["impaired"] or 0, lost)
    if lost and of:
        ratio = (lost - on_purpose) / of
        severity = Severity.NOTICE
        if ratio > LOSS_WARNING:
            severity = Severity.CRITICAL if ratio > LOSS_CRITICAL else Severity.WARNING
        field, least = ("gaps", "at least ") if counts["lost"] is None else ("lost", "")
        # Episodes in which the count grew, each from the previous row.
        values = np.asarray(link.values(field, raw=True)).astype(np.int64)
        grown = np.diff(np.maximum.accumulate(np.maximum(values, 0)), prepend=0) > 0
        spans = spells(link.stamp_ns, grown | np.append(grown[1:], False))
        when = f", between {clock.text(spans[0][0])} and {clock.text(spans[-1][1])}" if spans else ""
        purpose = "" if not on_purpose else ", all on purpose" if on_purpose == lost else f", {on_purpose} on purpose"
        yield Finding(
            "links.loss",
            severity,
            f"{name}: {least}{lost} of {of} frames were lost ({100.0 * lost / of:.2f} %){purpose}{when}",
            tuple(Evidence("/links", field, a, b, str(lost)) for a, b in spans)
            or (Evidence("/links", field, value=str(lost)),),
            "The faults section says what was injected and when."
            if on_purpose == lost
            else "Look at the link's rate, cable or radio, and at what else ran on it then.",
        )
    for count, (what, step) in _TROUBLES.items():
        number_of = counts[count] or 0
        if number_of:
            share = number_of / max(of, 1)
            yield Finding(
                f"links.{count}",
                Severity.WARNING if share > LOSS_WARNING else Severity.NOTICE,
                f"{name}: {number_of} {what}",
                (Evidence("/links", count, value=str(number_of)),),
                step,
            )
    p99_s = _latest(link, "latency_p99_s")
    if p99_s is not None and p99_s > LATENCY_WARNING_S:
        yield Finding.warning(
            "links.latency",
            f"{name}: one message in a hundred took {1e3 * p99_s:.0f} ms or more",
            (Evidence("/links", "latency_p99_s", value=f"{1e3 * p99_s:.1f} ms"),),
            "Control lives with old samples: look at the load of the link and of both machines.",
        )


def _count_plots(links: dict[str, Selection]) -> tuple[Plot, ...]:
    losses: list[Trace] = []
    latencies: list[Trace] = []
    for name, link in links.items():
        lost = np.maximum(*(np.asarray(link.values(count, raw=True)).astype(np.float64) for count in ("lost", "gaps")))
        each = np.diff(np.maximum.accumulate(np.maximum(lost, 0.0)), prepend=0.0)
        losses.append(Trace(name, link.stamp_ns, each, "steps"))
        for field, what in zip(LATENCIES, ("half", "99 %", "longest"), strict=True):
            if field in link.columns:
                values: Floats = np.asarray(link.values(field), dtype=np.float64) * 1e3
                known = np.isfinite(values)
                if known.any():
                    latencies.append(Trace(f"{name}, {what}", link.stamp_ns[known], values[known]))
    plots = [Plot("losses", "Frames lost between two counts", "frames", tuple(losses))]
    if latencies:
        plots.append(Plot("latencies", "How long messages took, so far", "ms", tuple(latencies)))
    return tuple(plots)


DROP_WARNING = 0.05
LEAST_PACKETS = 50  # with fewer, a link is not judged
MARGIN_LOW = 10.0  # RSSI minus noise of a SiK radio, in its own steps of about half a dB
TRIP_WARNING_MS = 500.0
LONGEST_TRIP_MS = 1e6  # ArduPilot's negative differences wrap to near 2^64
ROUND = 1 << 16  # packet counts have 16 bits


def autopilot_section(log: Log, clock: LogClock) -> Section | None:
    parts = [part for of in (_channels, _radio, _serial, _trips) if (part := of(log, clock)) is not None]
    return Section.joined("links", "Links", parts) if parts else None


def _grown(table: Table, column: str) -> Stamps:
    """(N,) growth of a 16-bit count at each row."""
    values = np.asarray(table.values(column, raw=True)).astype(np.int64)
    grown: Stamps = np.diff(values, prepend=values[:1]) % ROUND
    return np.where(grown < ROUND // 2, grown, 0)


def _channels(log: Log, clock: LogClock) -> Section | None:
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
            spans = spells(mine.stamp_ns, _grown(mine, "rxdp") > 0)
            findings.append(
                Finding(
                    "links.dropped",
                    Severity.WARNING if dropped / of > DROP_WARNING else Severity.NOTICE,
                    f"The autopilot missed {dropped} of {of} packets sent to it on channel {channel} "
                    f"({100.0 * dropped / of:.1f} %), from {clock.text(begin)} to {clock.text(end)}",
                    tuple(Evidence("MAV", "rxdp", a, b, str(dropped)) for a, b in spans),
                    "Look at the radio, its antenna and the baud rate of that port; several senders with one system "
                    "number look the same.",
                )
            )
    heard = sum(int(_grown(mine, "rxp").sum()) for mine in channels.values())
    if heard >= LEAST_PACKETS and not findings:
        said = f"None of {heard} MAVLink packets sent to the autopilot was missed"
        findings.append(Finding.ok("links.received_whole", said))
    columns = ("channel", "packets sent", "received", "missed", "stream slowed by, most (ms)")
    facts = (Fact("channels", "MAVLink channels", len(channels)),)
    return Section("links", "", facts, tuple(findings), (Grid.limited("channels", "MAVLink channels", columns, rows),))


def _radio(log: Log, clock: LogClock) -> Section | None:
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
        facts.append(Fact(f"{strength.lower()}_margin", f"Signal over noise {where}, least", rounded(margin.min(), 0)))
        traces += [Trace(strength, table.stamp_ns, level), Trace(noise, table.stamp_ns, floor)]
        if len(low):
            spans = spells(table.stamp_ns, margin < MARGIN_LOW)
            findings.append(
                Finding.warning(
                    "links.radio_margin",
                    f"The radio's signal {where} was within {MARGIN_LOW:.0f} steps of the noise in {len(low)} of "
                    f"{len(table)} reports, first at {clock.text(spans[0][0])}",
                    tuple(Evidence("RAD", strength, a, b, f"{margin.min():.0f}") for a, b in spans),
                    "Look at antennas and their place, at the distance then, and at what else transmits nearby.",
                )
            )
    for name, label in (("RxErrors", "Radio: receive errors"), ("Fixed", "Radio: errors corrected")):
        if name in table.columns:
            facts.append(Fact(f"radio_{name.lower()}", label, int(_grown(table, name).sum())))
    plots = (Plot("radio", "Telemetry radio", "steps of about 0.5 dB", tuple(traces)),)
    return Section("links", "", tuple(facts), tuple(findings), plots=plots)


def _serial(log: Log, clock: LogClock) -> Section | None:
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
        rows.append(
            (port, *(rounded(value, 0) for value in (sent.mean(), sent.max(), received.mean(), received.max())))
        )
        at = np.flatnonzero(lost > 0.0)
        if len(at):
            spans = spells(mine.stamp_ns, lost > 0.0)
            findings.append(
                Finding.warning(
                    "links.serial_overflow",
                    f"Serial port {port} lost bytes it had received, up to {lost.max():.0f} a second, first at "
                    f"{clock.text(spans[0][0])}",
                    tuple(Evidence("UART", "RxDp", a, b, f"{lost.max():.0f} B/s") for a, b in spans),
                    "They came faster than they were read: look at the long loops then, or use DMA on that port.",
                )
            )
    columns = ("port", "sent, mean (B/s)", "most (B/s)", "received, mean (B/s)", "most (B/s) ")
    grids: tuple[Grid, ...] = (Grid.limited("serial_ports", "Serial ports", columns, rows),)
    return Section("links", "", (), tuple(findings), grids)


def _trips(log: Log, clock: LogClock) -> Section | None:
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
            Finding.warning(
                "links.round_trip",
                f"One round trip in a hundred took {p99:.0f} ms or more, the longest {trip_ms[worst]:.0f} ms at "
                f"{clock.text(at_ns)}",
                (Evidence("TSYN", column, at_ns, value=f"{trip_ms[worst]:.0f} ms"),),
                "A companion that controls over this link sees it late: look at its load and the link's rate.",
            )
        )
    facts = (
        Fact("round_trip_p50_ms", "Round trip, median", rounded(p50, 2), "ms"),
        Fact("round_trip_p99_ms", "Round trip, 99 %", rounded(p99, 2), "ms"),
        Fact("round_trips_impossible", "Round trips that cannot be", int(np.sum(~good))),
    )
    plot = Plot("round_trip", "Round trip", "ms", (Trace("TSYN.RTT", table.stamp_ns[good], trip_ms[good], "points"),))
    return Section("links", "", facts, tuple(findings), plots=(plot,))


def analyse(log: Log) -> Section | None:
    """Section on links; None if the log has none."""
    clock = LogClock(log)
    if log.format == "dataflash":
        parts = [autopilot_section(log, clock)]
    else:
        happened = [one for one in moments(log) if one.kind in ("fault", "takeover", "mode", "arming")]
        parts = [count_section(log, clock), sequence_section(log, happened, clock)]
    if any(part is not None for part in parts):
        return Section.joined("links", "Links", parts)
    if log.format != "dataflash":
        return None
    return Section("links", "Links", lacks=("The log has no MAV, RAD, UART or TSYN, so links cannot be judged.",))
