"""What the autopilot was set to, and whether a simulator stood in for the world."""

from __future__ import annotations

import math

import numpy as np

from xitl_cli.logs.log import Log
from xitl_cli.logs.sensing.columns import numbers, tables_of

_SIMULATOR_TABLES = ("SIM", "SIM2", "SIMSTATE", "/truth/state")


def settings(log: Log) -> dict[str, float]:
    """Parameters by name, each as it was last logged (PARM) or told (PARAM_VALUE). Empty when the log has none."""
    found: dict[str, float] = {}
    for kind, name, value in (("PARAM_VALUE", "param_id", "param_value"), ("PARM", "Name", "Value")):
        for table in tables_of(log, (kind,)):
            figures = numbers(table, value)
            if figures is None or name not in table.columns or table.columns[name].kind != "text":
                continue
            names = table.values(name)
            found.update(
                (str(key), float(figure)) for key, figure in zip(names, figures, strict=True) if math.isfinite(figure)
            )
    return found


def simulated(log: Log) -> bool:
    """Whether the log itself shows that its sensors were simulated: ArduPilot's SIM records, or a run of ours."""
    return any(name in log.tables for name in _SIMULATOR_TABLES) or bool(tables_of(log, _SIMULATOR_TABLES))


def armed_rows(log: Log, stamp_ns: np.typing.NDArray[np.int64]) -> np.typing.NDArray[np.bool_] | None:
    """(N,) whether the motors were armed at each stamp; None where the log does not tell."""
    from xitl_cli.logs.signals import armed

    spans = armed(log)
    told = any(name in log.tables for name in ("ARM", "/actuators")) or bool(tables_of(log, ("HEARTBEAT",)))
    if not spans and not told:
        return None
    on = np.zeros(len(stamp_ns), dtype=np.bool_)
    for span in spans:
        on |= (stamp_ns >= span.from_ns) & (stamp_ns <= span.until_ns)
    return on
