"""What both ends of the links of a run counted (/links), and how long messages took."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants, grid, number
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.table import Selection, Table

LOSS_WARNING, LOSS_CRITICAL = 0.01, 0.2
COUNTS = ("sent", "received", "lost", "gaps", "late", "repeated", "dropped", "unsent", "refused", "impaired")
LATENCIES = ("latency_p50_s", "latency_p99_s", "latency_max_s")
LATENCY_WARNING_S = 0.1


def section(log: Log, instants: Instants) -> Section | None:
    table = log.tables.get("/links")
    if table is None or not {"name", *COUNTS} <= set(table.columns):
        return None
    names = np.asarray(table.values("name"))
    links = {str(name): Selection(table, names == name) for name in dict.fromkeys(names.tolist())}
    last = {name: {count: _last(link, count) for count in COUNTS} for name, link in links.items()}
    times = {name: {field: _latest(link, field) for field in LATENCIES} for name, link in links.items()}
    findings = [finding for name, link in links.items() for finding in _findings(name, link, last[name], instants)]
    known = {name: of for name in links if (of := _of(last[name]))}
    if known and not findings:
        counted = " and ".join(f"{of} frames on {name}" for name, of in known.items())
        findings.append(Finding("links.whole", Severity.OK, f"None of {counted} was lost"))
    facts = []
    for name in links:
        key = name.replace(" ", "_")
        lost, of = _lost(last[name]), _of(last[name])
        facts += [
            Fact(f"{key}_frames", f"{name}: frames", of or None),
            Fact(f"{key}_lost_percent", f"{name}: lost", number(100.0 * lost / of, 3) if of else None, "%"),
            Fact(f"{key}_latency_p99_ms", f"{name}: 99 % take at most", _ms(times[name]["latency_p99_s"]), "ms"),
        ]
    rows: list[tuple[Value, ...]] = [
        (
            name,
            *(last[name][count] for count in COUNTS),
            *(_ms(times[name][field]) for field in LATENCIES),
        )
        for name in links
    ]
    columns = ("link", *COUNTS, "half take (ms)", "99 % take (ms)", "longest (ms)")
    return Section(
        "links",
        "Links",
        tuple(fact for fact in facts if fact.value is not None),
        tuple(findings),
        (grid("links", "Frames on each link, as both ends counted them", columns, rows),),
        _plots(links),
    )


def _last(link: Table, count: str) -> int | None:
    """The newest count that is known."""
    values = np.asarray(link.values(count, raw=True))
    known = np.flatnonzero(values >= 0)
    return int(values[known[-1]]) if len(known) else None


def _latest(link: Table, field: str) -> float | None:
    if field not in link.columns:
        return None
    values = np.asarray(link.values(field), dtype=np.float64)
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else None


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else number(1e3 * seconds)


def _lost(counts: dict[str, int | None]) -> int:
    """By the counts of both ends, else by the gaps in the sequence."""
    lost = counts["lost"]
    return max(lost or 0, counts["gaps"] or 0)


def _of(counts: dict[str, int | None]) -> int:
    """What was sent, as far as it is known."""
    if counts["sent"] is not None:
        return counts["sent"]
    return (counts["received"] or 0) - (counts["repeated"] or 0) + _lost(counts)


def _findings(name: str, link: Table, counts: dict[str, int | None], instants: Instants) -> list[Finding]:
    findings = []
    lost, of = _lost(counts), _of(counts)
    on_purpose = min(counts["impaired"] or 0, lost)
    if lost and of:
        ratio = (lost - on_purpose) / of
        severity = Severity.NOTICE
        if ratio > LOSS_WARNING:
            severity = Severity.CRITICAL if ratio > LOSS_CRITICAL else Severity.WARNING
        field = "lost" if (counts["lost"] or 0) >= (counts["gaps"] or 0) else "gaps"
        from_ns, until_ns = _grew(link, field)
        if from_ns is not None and until_ns is not None:
            when = f", between {instants.text(from_ns)} and {instants.text(until_ns)}"
        else:
            when = ""
        purpose = "" if not on_purpose else ", all on purpose" if on_purpose == lost else f", {on_purpose} on purpose"
        findings.append(
            Finding(
                "links.loss",
                severity,
                f"{name}: {lost} of {of} frames were lost ({100.0 * lost / of:.2f} %){purpose}{when}",
                (Evidence("/links", field, from_ns, until_ns, str(lost)),),
                "The faults section says what was injected and when."
                if on_purpose == lost
                else "Look at the link's rate, cable or radio, and at what else ran on it then.",
            )
        )
    for count, what, step in (
        (
            "dropped",
            "frames came damaged, unknown or from elsewhere",
            "Look at the line's quality and at who else sends.",
        ),
        (
            "unsent",
            "frames were not taken by the transport",
            "The link is slower than what it has to carry: lower rates.",
        ),
        ("refused", "frames were refused for their signature", "Give both ends the same key."),
    ):
        number_of = counts[count] or 0
        if number_of:
            share = number_of / max(of, 1)
            findings.append(
                Finding(
                    f"links.{count}",
                    Severity.WARNING if share > LOSS_WARNING else Severity.NOTICE,
                    f"{name}: {number_of} {what}",
                    (Evidence("/links", count, value=str(number_of)),),
                    step,
                )
            )
    p99_s = _latest(link, "latency_p99_s")
    if p99_s is not None and p99_s > LATENCY_WARNING_S:
        findings.append(
            Finding(
                "links.latency",
                Severity.WARNING,
                f"{name}: one message in a hundred took {1e3 * p99_s:.0f} ms or more",
                (Evidence("/links", "latency_p99_s", value=f"{1e3 * p99_s:.1f} ms"),),
                "Control lives with old samples: look at the load of the link and of both machines.",
            )
        )
    return findings


def _grew(link: Table, count: str) -> tuple[int | None, int | None]:
    """From when to when it counted up."""
    values = np.asarray(link.values(count, raw=True)).astype(np.int64)
    values = np.maximum.accumulate(np.maximum(values, 0))
    grown = np.flatnonzero(np.diff(values, prepend=0) > 0)
    if not len(grown):
        return None, None
    stamps = link.stamp_ns
    return int(stamps[max(int(grown[0]) - 1, 0)]), int(stamps[grown[-1]])


def _plots(links: dict[str, Selection]) -> tuple[Plot, ...]:
    losses: list[Trace] = []
    latencies: list[Trace] = []
    for name, link in links.items():
        lost = np.maximum(*(np.asarray(link.values(count, raw=True)).astype(np.float64) for count in ("lost", "gaps")))
        each = np.diff(np.maximum.accumulate(np.maximum(lost, 0.0)), prepend=0.0)
        losses.append(Trace(name, link.stamp_ns, each, "steps"))
        for field, what in zip(LATENCIES, ("half", "99 %", "longest"), strict=True):
            if field in link.columns:
                values: NDArray[np.float64] = np.asarray(link.values(field), dtype=np.float64) * 1e3
                known = np.isfinite(values)
                if known.any():
                    latencies.append(Trace(f"{name}, {what}", link.stamp_ns[known], values[known]))
    plots = [Plot("losses", "Frames lost between two counts", "frames", tuple(losses))]
    if latencies:
        plots.append(Plot("latencies", "How long messages took, so far", "ms", tuple(latencies)))
    return tuple(plots)
