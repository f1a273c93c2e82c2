"""MAVLink as recorded: losses by the sequence numbers of each sender, and intervals without a frame.

A sequence number wraps after 256, and a recording does not have the totals of its senders. If a sender was not heard
for the usual time of half a wrap, the loss is reported as the least possible number. The number of wraps is not
estimated from the rate, because a sender may have been silent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals.moments import Moment, moments_near
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.spans import spells

LOSS_WARNING, LOSS_CRITICAL = 0.02, 0.2
LEAST_FRAMES = 50
QUIET_S, QUIET_PERIODS = 3.0, 20.0
QUIET_IN_RUN_S = 0.4
MOST_QUIET = 50
JOINED_NS = 50_000_000
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
WINDOW_NS = 1_000_000_000
ROUND = 256
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
        at_least = float(due.max()) >= ROUND / 2
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
    paused = due >= ROUND / 4
    lost = np.zeros(len(sequence), dtype=np.int64)
    ahead = np.diff(sequence, prepend=sequence[:1]) % ROUND
    half = ROUND // 2
    if ((ahead[1:] > 0) & (ahead[1:] < half)).all():
        lost[1:] = ahead[1:] - 1
        return lost, 0, 0
    late = repeated = 0
    newest = int(sequence[0])  # counted beyond a wrap
    missing: dict[int, int] = {}  # missing numbers of the last half wrap, and the row before which they are counted
    for row, (number, pause) in enumerate(zip(sequence[1:].tolist(), paused[1:].tolist(), strict=True), start=1):
        step = (number - newest) % ROUND
        if pause or 0 < step < half:
            before, newest = newest, newest + (step or ROUND)
            if newest > before + 1:
                lost[row] = newest - before - 1
                missing = {each: of for each, of in missing.items() if each > newest - half}
                missing.update(dict.fromkeys(range(max(before, newest - half) + 1, newest), row))
        elif step == 0:
            repeated += 1
        else:
            late += 1
            gap = missing.pop(newest + step - ROUND, None)
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
    if ratio > LOSS_WARNING and sender.component == AUTOPILOT:  # a station selects which of its own frames it records
        severity = Severity.CRITICAL if ratio > LOSS_CRITICAL else Severity.WARNING
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
        "It was on purpose if the fault is of this link; see what the autopilot did meanwhile (modes, events)."
        if beside
        else "Look at the link and at both of its ends then: power, cable, antenna, restarts, a machine asleep."
        if in_run
        else "Look at range and antennas then; the autopilot's failsafe may have acted (modes, events).",
    )


def _plots(found: list[Sender], quiet: list[Quiet]) -> tuple[Plot, ...]:
    traces = []
    for each in found[:6]:
        if len(each.stamp_ns) < LEAST_FRAMES:
            continue
        begin = int(each.stamp_ns.min())
        window = ((each.stamp_ns - begin) // WINDOW_NS).astype(np.int64)
        size = int(min(window.max() + 1, 200_000))
        kept = window < size
        counted = np.bincount(window[kept], weights=each.lost[kept], minlength=size).astype(np.float64)
        instants_ns: Stamps = begin + WINDOW_NS * np.arange(size, dtype=np.int64)
        traces.append(Trace(each.name, instants_ns, counted, "steps"))
    marks = tuple(Mark(begin, f"{each.name}: nothing", end) for each in quiet for begin, end in each.spans)
    if not traces:
        return ()
    return (Plot("sequence_losses", "Frames missing each second", "frames", tuple(traces), marks=marks),)
