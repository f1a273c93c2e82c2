"""Links: losses, latency and silence, as counted by both ends (/links) and as logged by an autopilot (MAV, RAD, UART,
TSYN).

MAVLink as recorded: losses by the sequence numbers of each sender, and intervals without a frame.

A sequence number wraps after 256, and a recording does not have the totals of its senders. If a sender was not heard
for the usual time of half a wrap, the loss is reported as the least possible number. The number of wraps is not
estimated from the rate, because a sender may have been silent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Floats, Selection, Stamps, Table, by_instance, first_of
from xitl_cli.logs.signals.moments import Moment, moments, moments_near
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.spans import spells

SEQUENCE_LOSS_WARNING, SEQUENCE_LOSS_CRITICAL = 0.02, 0.2
LEAST_FRAMES = 50
QUIET_S, QUIET_PERIODS = 3.0, 20.0
QUIET_IN_RUN_S = 0.4
MOST_QUIET = 50
JOINED_NS = 50_000_000
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
WINDOW_NS = 1_000_000_000
SEQUENCE_ROUND = 256
IN_A_ROW = 32


@dataclass(frozen=True, slots=True)
class Sender:
    """One sender."""

    system: int
    component: int
    stamp_ns: Stamps
    """(N,) in the order of the file."""
    lost: Stamps
    """(N,) frames missing before each."""
    at_least: bool
    """There may be more losses."""
    late: int
    """Numbers that went back."""
    repeated: int
    """Numbers that occurred twice."""

    @property
    def name(self) -> str:
        return f"system {self.system}, component {self.component}"

    @property
    def ratio(self) -> float:
        lost = int(self.lost.sum())
        return lost / max(lost + len(self.stamp_ns), 1)


@dataclass(frozen=True, slots=True)
class Quiet:
    """Spans without a frame of one link or sender."""

    name: str
    source: str
    """Its name in the log."""
    last_ns: int
    """Time of its last frame."""
    spans: list[tuple[int, int]]


def sequence_section(log: Log, happened: Sequence[Moment], clock: LogClock) -> Section | None:
    if log.format == "tlog":
        found = senders(log)
        unknown = sum(count for count, _ in log.health.undecoded.values())
        quiet = [
            Quiet(each.name, "MAVLink", int(each.stamp_ns.max()), _quiet_spans(each.stamp_ns, QUIET_S))
            for each in found
            if each.component == AUTOPILOT
        ]
        losses = [finding for each in found for finding in _losses(each, unknown, clock)]
    else:
        found, losses = [], []
        span_ns = log.span_ns
        until_ns = None if span_ns is None else span_ns[1]  # a station may record after the vehicle is off
        quiet = [
            Quiet(
                name.removeprefix("/link/"),
                name,
                int(table.stamp_ns.max()),
                _quiet_spans(table.stamp_ns, QUIET_IN_RUN_S, until_ns),
            )
            for name, table in log.tables.items()
            if name.startswith("/link/") and "frame" in table.columns and len(table) > LEAST_FRAMES
        ]
        if not quiet:
            return None
    silences = [finding for each in quiet if each.spans for finding in _silences(each, happened, clock, log.of_topics)]
    whole = [each.name for each in found if each.component == AUTOPILOT and len(each.stamp_ns) >= LEAST_FRAMES]
    if whole and not (losses or silences):
        said = f"No frame of {' and '.join(whole)} is missing by its sequence"
        losses.append(Finding.ok("links.sequence_whole", said))
    rows: list[tuple[Value, ...]] = [
        (
            each.system,
            each.component,
            len(each.stamp_ns),
            int(each.lost.sum()),
            rounded(100.0 * each.ratio, 3),
            each.late,
            each.repeated,
            rounded(float(np.max(np.diff(each.stamp_ns), initial=0)) * 1e-9),
        )
        for each in found
    ]
    columns = ("system", "component", "frames", "lost", "lost (%)", "out of order", "repeated", "longest pause (s)")
    facts = [Fact("senders", "MAVLink senders", len(found))] if found else []
    for each in found:
        if each.component == AUTOPILOT:
            label = f"Lost of system {each.system}"
            facts.append(Fact(f"system_{each.system}_lost_percent", label, rounded(100.0 * each.ratio, 3), "%"))
    grids = [Grid.limited("senders", "MAVLink by sender", columns, rows)] if rows else []
    pauses: list[tuple[Value, ...]] = [
        (each.name, clock.second(begin), clock.second(end), rounded((end - begin) * 1e-9))
        for each in quiet
        for begin, end in each.spans
    ]
    if pauses:
        grids.append(
            Grid.limited("silences", "Intervals without a frame", ("link", "from (s)", "until (s)", "for (s)"), pauses)
        )
    if not found and not pauses:
        return None
    return Section("links", "Links", tuple(facts), (*losses, *silences), tuple(grids), _plots(found, quiet))


def senders(log: Log) -> list[Sender]:
    """Senders of a telemetry log, the one with most frames first."""
    parts: dict[tuple[int, int], list[tuple[Stamps, Stamps, Stamps]]] = {}
    for table in log.tables.values():
        if not {"_sysid", "_compid", "_seq"} <= set(table.columns):
            continue
        system, component = (table.values(name, raw=True).astype(np.int64) for name in ("_sysid", "_compid"))
        sequence = table.values("_seq", raw=True).astype(np.int64)
        for who in np.unique(system * 256 + component).tolist():
            mine = system * 256 + component == who
            key = (who // 256, who % 256)
            parts.setdefault(key, []).append((table.file_offset[mine], table.stamp_ns[mine], sequence[mine]))
    found = []
    for (system_id, component_id), tables in parts.items():
        place, stamps, sequence = (np.concatenate(each) for each in zip(*tables, strict=True))
        order = np.argsort(place, kind="stable")
        stamp_ns = stamps[order]
        due = frames_due(stamp_ns)
        lost, late, repeated = missing_frames(sequence[order], due)
        at_least = float(due.max()) >= SEQUENCE_ROUND / 2
        found.append(Sender(system_id, component_id, stamp_ns, lost, at_least, late, repeated))
    return sorted(found, key=lambda each: -len(each.stamp_ns))


def frames_due(stamp_ns: Stamps) -> Floats:
    """(N,) number of frames that the sender usually sends in the time before each, by the median time of `IN_A_ROW`."""
    run = min(IN_A_ROW, len(stamp_ns) - 1)
    if run < 1:
        return np.zeros(len(stamp_ns))
    usual_ns = float(np.median(stamp_ns[run:] - stamp_ns[:-run])) / run
    return np.diff(stamp_ns, prepend=stamp_ns[:1]) / max(usual_ns, 1.0)


def missing_frames(sequence: Stamps, due: Floats) -> tuple[Stamps, int, int]:
    """(N,) number of frames missing before each frame; number of late frames, and of frames that are repeated directly.

    A number that went back by half a wrap or less is a late frame; if it was missing, it is not missing any more. If a
    quarter of a wrap or more was `due` (N,) before it (see `frames_due`), it belongs to the next wrap.
    """
    paused = due >= SEQUENCE_ROUND / 4
    lost = np.zeros(len(sequence), dtype=np.int64)
    ahead = np.diff(sequence, prepend=sequence[:1]) % SEQUENCE_ROUND
    half = SEQUENCE_ROUND // 2
    if ((ahead[1:] > 0) & (ahead[1:] < half)).all():
        lost[1:] = ahead[1:] - 1
        return lost, 0, 0
    late = repeated = 0
    newest = int(sequence[0])  # counted beyond a wrap
    missing: dict[int, int] = {}  # missing numbers of the last half wrap, and the row before which they are counted
    for row, (number, pause) in enumerate(zip(sequence[1:].tolist(), paused[1:].tolist(), strict=True), start=1):
        step = (number - newest) % SEQUENCE_ROUND
        if pause or 0 < step < half:
            before, newest = newest, newest + (step or SEQUENCE_ROUND)
            if newest > before + 1:
                lost[row] = newest - before - 1
                missing = {each: of for each, of in missing.items() if each > newest - half}
                missing.update(dict.fromkeys(range(max(before, newest - half) + 1, newest), row))
        elif step == 0:
            repeated += 1
        else:
            late += 1
            gap = missing.pop(newest + step - SEQUENCE_ROUND, None)
            if gap is not None:
                lost[gap] -= 1
    return lost, late, repeated


def _losses(sender: Sender, unknown: int, clock: LogClock) -> Iterator[Finding]:
    lost, frames = int(sender.lost.sum()), len(sender.stamp_ns)
    if not lost or frames < LEAST_FRAMES:
        return
    beyond = max(lost - unknown, 0)  # frames with unknown messages are in the file, not lost
    ratio = beyond / (frames + lost)
    severity = Severity.NOTICE
    # A station selects which of its own frames it records.
    if ratio > SEQUENCE_LOSS_WARNING and sender.component == AUTOPILOT:
        severity = Severity.CRITICAL if ratio > SEQUENCE_LOSS_CRITICAL else Severity.WARNING
    rows = np.flatnonzero(sender.lost)
    first_ns, last_ns = int(sender.stamp_ns[rows[0]]), int(sender.stamp_ns[rows[-1]])
    least = "at least " if sender.at_least else ""
    note = f"; up to {min(unknown, lost)} of them are messages of no known dialect" if unknown else ""
    yield Finding(
        "links.sequence_loss",
        severity,
        f"{sender.name}: {least}{lost} of {frames + lost} frames are missing by their sequence "
        f"({100.0 * sender.ratio:.2f} %), from {clock.text(first_ns)} to {clock.text(last_ns)}{note}",
        tuple(Evidence("MAVLink", "_seq", a, b, str(lost)) for a, b in spells(sender.stamp_ns, sender.lost > 0)),
        "Look at the radio or network; a log that was filtered or taken from one of several links shows the same.",
    )


def _quiet_spans(stamp_ns: Stamps, least_s: float, until_ns: int | None = None) -> list[tuple[int, int]]:
    """Pauses much longer than usual, including the pause before `until_ns`. A frame or two between pauses do not end
    them."""
    stamps = np.sort(stamp_ns if until_ns is None else np.append(stamp_ns, until_ns))
    between = np.diff(stamps)
    if not len(between):
        return []
    usual = float(np.median(between))
    spans: list[tuple[int, int]] = []
    for row in np.flatnonzero(between > max(least_s * 1e9, QUIET_PERIODS * usual)).tolist():
        begin, end = int(stamps[row]), int(stamps[row + 1])
        if spans and begin - spans[-1][1] <= JOINED_NS:
            spans[-1] = (spans[-1][0], end)
        elif len(spans) < MOST_QUIET:
            spans.append((begin, end))
    return spans


def _silences(quiet: Quiet, happened: Sequence[Moment], clock: LogClock, in_run: bool) -> Iterator[Finding]:
    spans = quiet.spans
    total_s = sum((end - begin) * 1e-9 for begin, end in spans)
    begin, end = max(spans, key=lambda span: span[1] - span[0])
    beside = [one.text for one in moments_near(happened, begin, end, WINDOW_NS) if one.kind in ("fault", "takeover")]
    again = "once" if len(spans) == 1 else f"{len(spans)} times, {total_s:.1f} s in all"
    with_ = f", with: {'; '.join(dict.fromkeys(beside))}" if beside else ""
    since = f"from {clock.text(begin)}{' to the end of the log' if end > quiet.last_ns else ''}"
    yield Finding(
        "links.silence",
        Severity.NOTICE if beside else Severity.WARNING,
        f"{quiet.name}: no frame for {(end - begin) * 1e-9:.1f} s {since} ({again}){with_}",
        tuple(Evidence(quiet.source, None, from_ns, until_ns) for from_ns, until_ns in spans[:10]),
        "It was injected if the fault is of this link. See the reaction of the autopilot (modes, events)."
        if beside
        else "Look at the link and both of its ends: power, cable, antenna, restarts, a sleeping machine."
        if in_run
        else "Look at range and antennas then; the autopilot's failsafe may have acted (modes, events).",
    )


def _plots(found: list[Sender], quiet: list[Quiet]) -> tuple[Plot, ...]:
    traces = []
    for sender in found[:6]:
        if len(sender.stamp_ns) < LEAST_FRAMES:
            continue
        begin = int(sender.stamp_ns.min())
        window = ((sender.stamp_ns - begin) // WINDOW_NS).astype(np.int64)
        size = int(min(window.max() + 1, 200_000))
        kept = window < size
        counted = np.bincount(window[kept], weights=sender.lost[kept], minlength=size).astype(np.float64)
        instants_ns: Stamps = begin + WINDOW_NS * np.arange(size, dtype=np.int64)
        traces.append(Trace(sender.name, instants_ns, counted, "steps"))
    marks = tuple(Mark(begin, f"{sender.name}: nothing", end) for sender in quiet for begin, end in sender.spans)
    if not traces:
        return ()
    return (Plot("sequence_losses", "Frames missing each second", "frames", tuple(traces), marks=marks),)


LOSS_WARNING, LOSS_CRITICAL = 0.01, 0.2
_BASIC = {"name", "sent", "received", "lost", "gaps", "repeated", "impaired"}
"""Columns that the analysis needs. It shows all other counts that the recording has."""
LATENCIES = ("latency_p50_s", "latency_p99_s", "latency_max_s")
LATENCY_WARNING_S = 0.1
_TROUBLES = {
    "dropped": (
        "frames were damaged, unknown or from another sender",
        "Look at the quality of the line, and for other senders.",
    ),
    "unsent": ("frames were refused by the transport", "The link is too slow for its messages: lower their rates."),
    "refused": ("frames had a wrong signature, or none", "Use the same signing key at both ends."),
    "repeated": ("frames arrived more than once", "Look for two paths or two senders of the same frames."),
    "late": (
        "frames arrived after later ones",
        "Look for several paths to the receiver, such as a radio with retries or two networks.",
    ),
}
"""By count of /links: the fate of these frames, and the recommended action."""


def count_section(log: Log, clock: LogClock) -> Section | None:
    table = log.tables.get("/links")
    if table is None or not set(table.columns) >= _BASIC:
        return None
    counts = [name for name in table.columns if name not in ("stamp_ns", "name", *LATENCIES)]
    names = np.asarray(table.values("name"))
    links = {str(name): Selection(table, names == name) for name in dict.fromkeys(names.tolist())}
    last = {name: _last_counts(link, counts) for name, link in links.items()}
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
        (name, *(last[name][count] for count in counts), *(_ms(times[name][field]) for field in LATENCIES))
        for name in links
    ]
    columns = ("link", *counts, "half take (ms)", "99 % take (ms)", "longest (ms)")
    return Section(
        "links",
        "Links",
        tuple(fact for fact in facts if fact.value is not None),
        tuple(findings),
        (Grid.limited("links", "Frames on each link, as both ends counted them", columns, rows),),
        _count_plots(links),
    )


def _last_counts(link: Table, names: Sequence[str]) -> dict[str, int | None]:
    """Last known value of each count. `lost` is None if the two ends did not agree in the end."""
    counts: dict[str, int | None] = {}
    for count in names:
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


def _growth(link: Table, count: str) -> list[tuple[int, int]]:
    """Spells in which a count grew, each from the previous row."""
    values = np.asarray(link.values(count, raw=True)).astype(np.int64)
    grown = np.diff(np.maximum.accumulate(np.maximum(values, 0)), prepend=0) > 0
    return spells(link.stamp_ns, grown | np.append(grown[1:], False))


def _count_findings(name: str, link: Table, counts: dict[str, int | None], clock: LogClock) -> Iterator[Finding]:
    lost, of = _lost(counts), _sent_count(counts)
    on_purpose = min(counts["impaired"] or 0, lost)
    if lost and of:
        ratio = (lost - on_purpose) / of
        severity = Severity.NOTICE
        if ratio > LOSS_WARNING:
            severity = Severity.CRITICAL if ratio > LOSS_CRITICAL else Severity.WARNING
        field, least = ("gaps", "at least ") if counts["lost"] is None else ("lost", "")
        spans = _growth(link, field)
        when = f", between {clock.text(spans[0][0])} and {clock.text(spans[-1][1])}" if spans else ""
        purpose = "" if not on_purpose else ", all on purpose" if on_purpose == lost else f", {on_purpose} on purpose"
        yield Finding(
            "links.loss",
            severity,
            f"{name}: {least}{lost} of {of} frames were lost ({100.0 * lost / of:.2f} %){purpose}{when}",
            tuple(Evidence("/links", field, a, b, str(lost)) for a, b in spans)
            or (Evidence("/links", field, value=str(lost)),),
            "The faults section shows which faults were injected and when."
            if on_purpose == lost
            else "Look at the link's rate, cable or radio, and at its other load then.",
        )
    for count, (what, step) in _TROUBLES.items():
        number_of = counts.get(count) or 0
        if number_of:
            share = number_of / max(of, 1)
            spans = _growth(link, count)
            when = f", between {clock.text(spans[0][0])} and {clock.text(spans[-1][1])}" if spans else ""
            yield Finding(
                f"links.{count}",
                Severity.WARNING if share > LOSS_WARNING else Severity.NOTICE,
                f"{name}: {number_of} {what}{when}",
                tuple(Evidence("/links", count, a, b, str(number_of)) for a, b in spans)
                or (Evidence("/links", count, value=str(number_of)),),
                step,
            )
    p99_s = _latest(link, "latency_p99_s")
    if p99_s is not None and p99_s > LATENCY_WARNING_S:
        yield Finding.warning(
            "links.latency",
            f"{name}: one message in a hundred took {1e3 * p99_s:.0f} ms or more",
            (Evidence("/links", "latency_p99_s", value=f"{1e3 * p99_s:.1f} ms"),),
            "The control uses old samples: look at the load of the link and of both machines.",
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
        plots.append(Plot("latencies", "Latency of the messages so far", "ms", tuple(latencies)))
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
                    "Look at the radio, its antenna and the baud rate of that port; several senders with the same "
                    "system number have the same effect.",
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
                    "Look at antennas and their place, at the distance then, and for other transmitters nearby.",
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
                    "They arrived faster than they were read. Look at the long loops then, or use DMA on that port.",
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
                "A companion that controls over this link gets late data. Look at its load and the link's rate.",
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
