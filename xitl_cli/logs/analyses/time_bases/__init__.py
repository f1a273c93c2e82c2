"""Time bases: each clock against the sample number, and clocks against each other."""

from __future__ import annotations

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.time_bases import clock_pairs, sample_clocks
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Section
from xitl_cli.logs.timeline.relations import relations

_LACKS = {
    "dataflash": "The log holds the autopilot's clock alone: a GPS fix (GPA) or UTC in PM.R would let it be judged.",
    "mcap": "The recording holds no second clock: no /clocks (runs in real time), telemetry, or stamps in headers.",
    "tlog": "No message tells the autopilot's own time (time_boot_ms), so the clocks cannot be compared.",
}


def analyse(log: Log) -> Section | None:
    instants = Instants(log)
    found = relations(log)
    pairs = clock_pairs.section(log, found, instants)
    samples = sample_clocks.section(log, found, instants)
    if not found and not samples.grids:
        return None
    findings = (*pairs.findings, *samples.findings)
    if not findings:
        findings = clock_pairs.even(found)
    return Section(
        "time_bases",
        "Time bases",
        (*pairs.facts, *samples.facts),
        findings,
        (*pairs.grids, *samples.grids),
        (*pairs.plots, *samples.plots),
        () if found else (_LACKS[log.format],),
    )
