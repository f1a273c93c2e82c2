"""What of a sensor can be judged, whichever it is: its stamps, how regular they are, and whether it sticks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.gaps import Gaps, Regularity, gaps, regularity
from xitl_cli.logs.sensing.holding import Holding, holding
from xitl_cli.logs.sensing.inertial import Inertial
from xitl_cli.logs.sensing.pauses import covered
from xitl_cli.logs.sensing.plain import Plain


@dataclass(frozen=True, slots=True)
class Sensor:
    """What every kind of sensor is judged by. values: (N, k). gaps: those that are not pauses of the whole log."""

    name: str
    sort: str
    message: str
    field: str
    stamp_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    regularity: Regularity
    gaps: Gaps
    holding: Holding
    healthy: NDArray[np.bool_] | None
    temperature_degc: NDArray[np.float64] | None
    sensor_rate_hz: float | None


def sensor_of(each: Inertial | Plain, pause: NDArray[np.int64]) -> Sensor | None:
    found = regularity(each.sample_ns)
    if found is None:
        return None
    if isinstance(each, Inertial):
        parts = [part for part in (each.gyro_radps, each.accel_mps2) if part is not None]
        sort, message, field = "inertial unit", each.table.name, (each.gyro_fields or each.accel_fields)[0]
        values, rate_hz = np.concatenate(parts, axis=1), each.gyro_rate_hz or each.accel_rate_hz
    else:
        sort, message, field = each.sort, each.message, each.fields[0]
        values, rate_hz = each.values, None
    return Sensor(
        name=each.name,
        sort=sort,
        message=message,
        field=field,
        stamp_ns=each.stamp_ns,
        values=values,
        regularity=found,
        gaps=_own_gaps(each.stamp_ns, each.sample_ns, found, pause),
        holding=holding(values, found.period_s),
        healthy=each.healthy,
        temperature_degc=each.temperature_degc,
        sensor_rate_hz=rate_hz,
    )


def _own_gaps(
    stamp_ns: NDArray[np.int64], sample_ns: NDArray[np.int64], found: Regularity, pause: NDArray[np.int64]
) -> Gaps:
    """On the log's time, without those in which everything paused."""
    each = gaps(sample_ns, found.period_s)
    from_ns = stamp_ns[each.row]
    until_ns = from_ns + (each.until_ns - each.from_ns)
    own = covered(from_ns, until_ns, pause) < 0.5
    return Gaps(each.row[own], from_ns[own], until_ns[own], each.missing[own])
