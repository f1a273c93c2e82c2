"""Links: what was lost on them, how long it took, and when nothing came."""

from __future__ import annotations

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.analyses.links import counts as link_counts
from xitl_cli.logs.analyses.links import sequences as link_sequences
from xitl_cli.logs.analyses.links import telemetry_rows
from xitl_cli.logs.log import Log
from xitl_cli.logs.running.moments import moments
from xitl_cli.logs.sections import Section


def analyse(log: Log) -> Section | None:
    """None where the log tells of no link."""
    instants = Instants(log)
    if log.format == "dataflash":
        parts = [telemetry_rows.section(log, instants)]
    else:
        happened = [one for one in moments(log) if one.kind in ("fault", "takeover", "mode", "arming")]
        parts = [link_counts.section(log, instants), link_sequences.section(log, happened, instants)]
    found = [part for part in parts if part is not None]
    if not found:
        if log.format != "dataflash":
            return None
        return Section("links", "Links", lacks=("The log has no MAV, RAD, UART or TSYN, so links cannot be judged.",))
    return Section(
        "links",
        "Links",
        tuple(fact for part in found for fact in part.facts),
        tuple(finding for part in found for finding in part.findings),
        tuple(grid for part in found for grid in part.grids),
        tuple(plot for part in found for plot in part.plots),
        tuple(lack for part in found for lack in part.lacks),
    )
