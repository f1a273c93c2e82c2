"""What the autopilot said over MAVLink: a telemetry log's tables, or the frames that came from it in a recording."""

from __future__ import annotations

import numpy as np

from xitl_cli.logs.log import Log
from xitl_cli.logs.table import Selection, Table

_PREFIXES = ("", "/link/agent/rx:")
_NO_AUTOPILOT = 8  # MAV_AUTOPILOT_INVALID: a ground station, a gimbal, a camera …


def autopilot_heartbeats(log: Log) -> Table | None:
    """HEARTBEAT of the autopilot heard first, and of no ground station or payload."""
    for prefix in _PREFIXES:
        table = log.tables.get(f"{prefix}HEARTBEAT")
        if table is None or not {"autopilot", "type", "custom_mode", "base_mode"} <= set(table.columns):
            continue
        pilots = np.asarray(table.values("autopilot", raw=True)) != _NO_AUTOPILOT
        if not pilots.any():
            continue
        if "_sysid" in table.columns:
            systems = np.asarray(table.values("_sysid", raw=True))
            pilots &= systems == systems[pilots][0]
        return Selection(table, pilots)
    return None


def heard(log: Log, message: str) -> Table | None:
    """Rows of this message from the system of the autopilot; None when there are none.

    Without a heartbeat to tell which system that is, all rows.
    """
    table = next((log.tables[f"{prefix}{message}"] for prefix in _PREFIXES if f"{prefix}{message}" in log.tables), None)
    if table is None or "_sysid" not in table.columns:
        return table
    beats = autopilot_heartbeats(log)
    if beats is None:
        return table
    own = np.asarray(table.values("_sysid", raw=True)) == beats.values("_sysid", raw=True)[0]
    return Selection(table, own) if own.any() else None
