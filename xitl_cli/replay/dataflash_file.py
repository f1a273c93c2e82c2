"""Pulse widths from a DataFlash log: RCOU, when it was armed (ARM), and what the outputs were used for (PARM)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from xitl_cli.errors import UserError
from xitl_cli.logs.errors import LogError
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.log import Log
from xitl_cli.replay.pulses import PulseLog, is_pulse

_FUNCTION = re.compile(r"SERVO([0-9]{1,2})_FUNCTION")
_CHANNEL = re.compile(r"C([0-9]{1,2})")


def read_dataflash(path: Path) -> PulseLog:
    """Read RCOU (channels 1 to 14) from the .bin log of any ArduPilot vehicle or of the embedded autopilot.

    A record that jumps back in time is dropped. Raises UserError when the file is no log or holds no outputs.
    """
    try:
        opened = DataFlashLog(path)
    except LogError as error:
        raise UserError(str(error)) from error
    with opened as log:
        outputs = log.tables.get("RCOU")
        if outputs is None or "TimeUS" not in outputs.columns:
            raise UserError(f"{path}: holds no motor outputs (RCOU); log with bit RC OUT of LOG_BITMASK set")
        at_us = outputs.stamp_ns // 1000
        rising = np.flatnonzero(np.diff(np.maximum.accumulate(at_us), prepend=-1) > 0)
        channels = {int(match[1]): name for name in outputs.columns if (match := _CHANNEL.fullmatch(name))}
        pulses = {
            channel: tuple(
                pulse if is_pulse(pulse) else 0.0
                for pulse in outputs.values(name, rising, raw=True).astype(np.float64).tolist()
            )
            for channel, name in channels.items()
            if outputs.columns[name].kind == "number" and not outputs.columns[name].shape
        }
        at_s = tuple((at_us[rising] * 1e-6).tolist())
        return PulseLog(str(path), at_s, pulses, _armed_s(log), _functions(log))


def _armed_s(log: Log) -> float | None:
    """When it was armed first."""
    table = log.tables.get("ARM")
    if table is None or not {"TimeUS", "ArmState"} <= table.columns.keys():
        return None
    armed = np.flatnonzero(table.values("ArmState", raw=True) == 1)
    return int(table.stamp_ns[armed[0]]) // 1000 * 1e-6 if len(armed) else None


def _functions(log: Log) -> dict[int, int]:
    table = log.tables.get("PARM")
    if table is None or not {"Name", "Value"} <= table.columns.keys() or table.columns["Value"].kind != "number":
        return {}
    found = {}
    for name, value in zip(table.values("Name").tolist(), table.values("Value", raw=True).tolist(), strict=True):
        if (match := _FUNCTION.fullmatch(str(name))) and np.isfinite(value):
            found[int(match[1])] = int(value)
    return found
