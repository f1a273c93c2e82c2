"""What the filter takes for the bias of its inertial unit (XKF1.GX…, XKF2.AX…): a sensor that is off shows here."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.estimator.cores import Core
from xitl_cli.logs.analyses.instants import Instants, number
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Severity
from xitl_cli.logs.table import Table, by_instance

_LAST_S = 20.0
_LEAST_S = 30.0
_STATES = (
    ("XKF1", ("GX", "GY", "GZ"), "gyroscope", "deg/s", (0.5, 2.0)),
    ("XKF2", ("AX", "AY", "AZ"), "accelerometer", "m/s²", (0.3, 0.8)),
)
"""Table, fields, what, unit, and from where a bias is worth a notice and a warning."""


def facts(log: Log, core: Core | None) -> list[Fact]:
    found = []
    for message, fields, what, unit, _ in _STATES:
        if (last := _last(log, core, message, fields)) is not None:
            size = number(float(np.max(np.abs(last[0]))))
            found.append(Fact(f"{what}_bias", f"Bias of the {what} by the filter, at the end", size, unit))
    return found


def findings(log: Log, core: Core | None, instants: Instants) -> list[Finding]:
    """Of the last seconds: a filter that has just begun does not know it yet."""
    found = []
    for message, fields, what, unit, limits in _STATES:
        if (last := _last(log, core, message, fields)) is None:
            continue
        bias, table = last
        axis = int(np.argmax(np.abs(bias)))
        if abs(bias[axis]) < limits[0]:
            continue
        values, stamps = _numbers(table, fields[axis]), table.stamp_ns
        within = np.abs(values - bias[axis]) < 0.5 * abs(bias[axis])
        since = int(np.flatnonzero(~within)[-1]) + 1 if not within.all() else 0
        from_ns = int(stamps[min(since, len(stamps) - 1)])
        found.append(
            Finding(
                f"estimator.{what}_bias",
                Severity.WARNING if abs(bias[axis]) >= limits[1] else Severity.NOTICE,
                f"The filter takes the {what} to be off by {bias[axis]:.2f} {unit} on {'xyz'[axis]}, since "
                f"{instants.text(from_ns)}",
                (Evidence(message, fields[axis], from_ns, int(stamps[-1]), f"{bias[axis]:.2f} {unit}"),),
                "Calibrate it at rest and warm, and see that it is left to settle before it is armed.",
            )
        )
    return found


def _last(
    log: Log, core: Core | None, message: str, fields: tuple[str, ...]
) -> tuple[NDArray[np.float64], Table] | None:
    """(3,) medians over the last seconds, and the rows of the core in use; None where it ran too short."""
    whole = log.tables.get(message)
    if whole is None or core is None or not set(fields) <= set(whole.columns):
        return None
    table = by_instance(whole).get(core.number)
    if table is None or not len(table):
        return None
    stamps = table.stamp_ns
    if stamps[-1] - stamps[0] < _LEAST_S * 1e9:
        return None
    late = stamps > stamps[-1] - round(_LAST_S * 1e9)
    values = np.array([_numbers(table, field)[late] for field in fields])
    good = np.isfinite(values).all(axis=0)
    return (np.median(values[:, good], axis=1), table) if good.sum() >= 3 else None


def _numbers(table: Table, field: str) -> NDArray[np.float64]:
    return np.asarray(table.values(field), dtype=np.float64)
