"""What went to the motors and what came from the sticks."""

from __future__ import annotations

import re

import numpy as np

from xitl_cli.logs.log import Log
from xitl_cli.logs.signals.series import Series, series, whole

_CHANNEL = re.compile(r"C([0-9]{1,2})|servo([0-9]{1,2})_raw|chan([0-9]{1,2})_raw")


def outputs(log: Log) -> dict[int, Series]:
    """By channel from 1: pulse widths (us), or commands from -1 to 1 (unit "") where a recording of ours has those."""
    commands = log.tables.get("/actuators")
    if commands is not None and "command" in commands.columns:
        values = np.asarray(commands.values("command"), dtype=np.float64)
        if values.ndim == 2:
            found = {
                index + 1: series(commands.stamp_ns, values[:, index], "", f"/actuators.command[{index}]")
                for index in range(values.shape[1])
            }
            return {channel: each for channel, each in found.items() if each is not None}
    return pulses(log)


def pulses(log: Log) -> dict[int, Series]:
    """Outputs by channel from 1, pulse widths (us) alone."""
    return _pulses(log, ("RCOU", "RCO2", "RCO3"), "SERVO_OUTPUT_RAW")


def rc_inputs(log: Log) -> dict[int, Series]:
    """By channel from 1: pulse widths (us)."""
    return _pulses(log, ("RCIN", "RCI2"), "RC_CHANNELS")


def _pulses(log: Log, logged: tuple[str, ...], message: str) -> dict[int, Series]:
    found: dict[int, Series] = {}
    for name in (*logged, message, f"/link/agent/rx:{message}"):
        table = whole(log, name)
        if table is None:
            continue
        for column in table.columns:
            match = _CHANNEL.fullmatch(column)
            if match is None:
                continue
            channel = int(match[1] or match[2] or match[3])
            if channel in found:
                continue
            each = series(table.stamp_ns, table.values(column, raw=True), "us", f"{name}.{column}")
            if each is not None and (each.values != 0.0).any():
                found[channel] = each
    return dict(sorted(found.items()))
