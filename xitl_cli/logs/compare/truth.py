"""Whether what a log calls the truth is that of the vessel."""

from __future__ import annotations

from xitl_cli.logs import signals
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Severity


def stray_truth(name: str, log: Log) -> Finding | None:
    """With sensors from elsewhere, ArduPilot's own simulated vehicle (SIM) is another one, and no truth."""
    apart_m = signals.stray_truth_m(log)
    if apart_m is None:
        return None
    return Finding(
        "trajectory.stray_truth",
        Severity.WARNING,
        f"SIM of {name} is not about this vessel: it came to be {apart_m:.0f} m from the receiver",
        (Evidence("SIM", "Lat, Lng"),),
        "Take the truth from the recording of whoever simulated the vessel (/truth of an MCAP file).",
    )
