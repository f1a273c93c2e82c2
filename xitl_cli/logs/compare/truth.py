"""Whether what a log calls the truth is that of the vessel."""

from __future__ import annotations

import numpy as np

from sim_core.geodesy import LocalFrame
from xitl_cli.logs import signals
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Severity
from xitl_cli.logs.signals.flat_earth import is_of_its_world

_MOVED_M = 20.0


def foreign_truth(name: str, log: Log) -> Finding | None:
    """With sensors from elsewhere, ArduPilot's own simulated vehicle (SIM) is another one."""
    true, told = signals.position_geodetic(log, "truth"), signals.position_geodetic(log)
    if true is None or told is None or true.source != "SIM" or is_of_its_world(told, true):
        return None
    latitude, longitude = map(float, told.values[0, :2])
    way = LocalFrame(latitude, longitude, 0.0).ned(told.values[:, 0], told.values[:, 1], np.zeros(len(told.values)))
    if float(np.hypot(*np.ptp(way[:, :2], axis=0))) < _MOVED_M:
        return None
    return Finding(
        "trajectory.foreign_truth",
        Severity.WARNING,
        f"SIM of {name} is not about this vessel: it did not go where the estimate went.",
        (Evidence("SIM", "Lat, Lng"),),
        "Take the truth from the recording of whoever simulated the vessel (/truth of an MCAP file).",
    )
