"""Cores of the estimator, and when each had what: origin, position, biases, agreement of cores.

EKF3's XKF messages, EKF2's NKF, EKF1 to EKF4 of the first filter, by number of the core, whatever the version calls
them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Severity
from xitl_cli.logs.model.table import Floats, Selection, Stamps, Table, by_instance
from xitl_cli.logs.signals.lanes import lanes, rows_in_use
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.spans import inside
from xitl_cli.logs.signals.states import autopilot_messages
from xitl_cli.logs.tables.events import EKF_ABSOLUTE, EKF_ACTIVE, EKF_GPS_CHECKS

FIRST_FILTER = "EKF1"  # until Copter 3.4; its bits of faults are its own
_FAMILIES = (("EKF3", "XKF"), ("EKF2", "NKF"), (FIRST_FILTER, "EKF"))
_SECOND_CORE = 5  # before 4.1 a core had messages of its own: XKF6 is XKF1 of the second


@dataclass(frozen=True, slots=True)
class EstimatorCore:
    """solution: XKF1, innovations: XKF3, health: XKF4 of one core, None where not logged."""

    number: int
    filter: str
    solution: Table | None
    innovations: Table | None
    health: Table | None


def estimator_cores(log: Log) -> list[EstimatorCore]:
    """Of EKF3 where it was logged, else of EKF2, else of the first filter, by number."""
    for name, prefix in _FAMILIES:
        parts = {kind: _by_core(log, prefix, kind) for kind in (1, 3, 4)}
        numbers = sorted(set().union(*parts.values()))
        if numbers:
            return [
                EstimatorCore(number, name, *(parts[kind].get(number) for kind in (1, 3, 4)))
                for number in numbers
                if number < 8
            ]
    return []


def core_in_use(log: Log, every: list[EstimatorCore], primary: int) -> EstimatorCore | None:
    """Rows of whichever core was in use when they were written, under the number of the one that was so longest."""
    core = next((one for one in every if one.number == primary), None)
    prefix = next((prefix for name, prefix in _FAMILIES if core is not None and name == core.filter), "")
    if core is None or lanes(log, prefix) is None or len(every) < 2:
        return core
    return EstimatorCore(primary, core.filter, *(rows_in_use(log, f"{prefix}{kind}") for kind in (1, 3, 4)))


def flag_column(table: Table, column: str) -> Stamps:
    """(N,) of a column of flags."""
    return np.asarray(table.values(column, raw=True)).astype(np.int64)


def _by_core(log: Log, prefix: str, kind: int) -> dict[int, Table]:
    table = log.tables.get(f"{prefix}{kind}")
    if table is None:
        return {}
    if "C" in table.columns:
        numbers = flag_column(table, "C")
        return {int(number): Selection(table, numbers == number) for number in np.unique(numbers)}
    second = log.tables.get(f"{prefix}{kind + _SECOND_CORE}")
    return {0: table} if second is None else {0: table, 1: second}


_AT_START_NS = 1_000_000_000
_DIFFERENT_M = 0.01


@dataclass(frozen=True, slots=True)
class EstimatorOrigin:
    """set_ns: None where it was set before the log began. altitude_m: of ORGN, height_m: XKF1.OH at first."""

    set_ns: int | None
    latitude_deg: float | None
    longitude_deg: float | None
    altitude_m: float | None
    height_m: float | None
    heights: tuple[tuple[int, float], ...]


@dataclass(frozen=True, slots=True)
class FilterUse:
    """A filter that steers attitude and position, from when until when."""

    from_ns: int
    until_ns: int
    name: str


def estimator_origin(log: Log, every: list[EstimatorCore], clock: LogClock) -> EstimatorOrigin | None:
    """The estimator's, None when the log shows none."""
    rows = _origin_rows(log)
    heights = _heights(every)
    said = [text.at_ns for text in signals.texts(log) if "origin set" in text.text.lower()]
    if not rows and not heights and not said:
        return None
    # A new log repeats the origin in its first rows.
    known = [*said, *(at_ns for at_ns, *_ in rows), *(at_ns for at_ns, _ in heights[:1])]
    first_ns = min(known)
    before = first_ns <= clock.start_ns + _AT_START_NS
    latitude, longitude, altitude = rows[0][1:] if rows else (None, None, None)
    return EstimatorOrigin(
        None if before else first_ns, latitude, longitude, altitude, heights[0][1] if heights else None, tuple(heights)
    )


def first_position_ns(every: list[EstimatorCore]) -> int | None:
    """When a core first said that its absolute position is good."""
    found = []
    for core in every:
        if core.health is not None and "SS" in core.health.columns:
            good = np.flatnonzero(flag_column(core.health, "SS") & EKF_ABSOLUTE)
            found += [int(core.health.stamp_ns[good[0]])] if len(good) else []
    return min(found, default=None)


def never_positioned(every: list[EstimatorCore], clock: LogClock) -> Iterator[Finding]:
    """No core ever had an absolute position, and what its checks of GPS said most often."""
    tables = [core.health for core in every if core.health is not None and "SS" in core.health.columns]
    if not tables or first_position_ns(every) is not None:
        return
    why = ""
    if "GPS" in tables[0].columns and (checks := flag_column(tables[0], "GPS")).any():
        failed = [(int(np.count_nonzero(checks >> bit & 1)), name) for bit, name in EKF_GPS_CHECKS.items()]
        names = [name for count, name in sorted(failed, reverse=True) if count][:3]
        why = f"; its checks of GPS failed for {', '.join(names)}"
    last_ns = int(tables[0].stamp_ns[-1])
    yield Finding(
        "estimator.never_positioned",
        Severity.WARNING if clock.armed else Severity.NOTICE,
        f"The estimator had no absolute position until {clock.text(last_ns)}, when the log ends{why}",
        (Evidence(tables[0].name, "SS", int(tables[0].stamp_ns[0]), last_ns),),
        "Look at the GNSS section, and wait for the position before arming in a mode that needs one.",
    )


def filter_uses(log: Log) -> list[FilterUse]:
    """By ATT.AEKF; empty where it is not logged."""
    table = log.tables.get("ATT")
    if table is None or "AEKF" not in table.columns or not len(table):
        return []
    numbers = flag_column(table, "AEKF")
    stamps = table.stamp_ns
    begins = np.flatnonzero(np.concatenate(([True], np.diff(numbers) != 0)))
    ends = np.concatenate((stamps[begins[1:]], stamps[-1:]))
    return [
        FilterUse(int(stamps[begin]), int(end), EKF_ACTIVE.get(int(numbers[begin]), f"filter {int(numbers[begin])}"))
        for begin, end in zip(begins, ends, strict=True)
    ]


def _origin_rows(log: Log) -> list[tuple[int, float, float, float]]:
    table = log.tables.get("ORGN")
    if table is not None and {"Type", "Lat", "Lng", "Alt"} <= set(table.columns):
        rows = np.flatnonzero(flag_column(table, "Type") == 0)
        columns = (np.asarray(table.values(name, rows), dtype=np.float64).tolist() for name in ("Lat", "Lng", "Alt"))
        return list(zip(table.stamp_ns[rows].tolist(), *columns, strict=True))
    table = autopilot_messages(log, "GPS_GLOBAL_ORIGIN")
    if table is not None and {"latitude", "longitude", "altitude"} <= set(table.columns):
        names = ("latitude", "longitude", "altitude")
        columns = (np.asarray(table.values(name), dtype=np.float64).tolist() for name in names)
        return list(zip(table.stamp_ns.tolist(), *columns, strict=True))
    return []


def _heights(every: list[EstimatorCore]) -> list[tuple[int, float]]:
    """(stamp, m) where the height of the origin changed, of the first core that logs it; 0 means that there is none."""
    for core in every:
        if core.solution is None or "OH" not in core.solution.columns:
            continue
        values = np.asarray(core.solution.values("OH"), dtype=np.float64)
        kept = np.flatnonzero(np.isfinite(values) & (values != 0.0))
        if not len(kept):
            continue
        new = np.concatenate(([True], np.abs(np.diff(values[kept])) >= _DIFFERENT_M))
        rows = kept[new]
        return list(zip(core.solution.stamp_ns[rows].tolist(), values[rows].tolist(), strict=True))
    return []


_LAST_S = 20.0
_LEAST_S = 30.0
_BIAS_STATES = (
    ("XKF1", ("GX", "GY", "GZ"), "gyroscope", "deg/s", (0.5, 2.0)),
    ("XKF2", ("AX", "AY", "AZ"), "accelerometer", "m/s²", (0.3, 0.8)),
)
"""Table, fields, what, unit, and from where a bias is worth a notice and a warning."""


def bias_facts(log: Log, core: EstimatorCore | None) -> Iterator[Fact]:
    for message, fields, what, unit, _ in _BIAS_STATES:
        if (last := _last_biases(log, core, message, fields)) is not None:
            size = rounded(float(np.max(np.abs(last[0]))))
            yield Fact(f"{what}_bias", f"Bias of the {what} by the filter, at the end", size, unit)


def bias_findings(log: Log, core: EstimatorCore | None, clock: LogClock) -> Iterator[Finding]:
    """Of the last seconds: a filter that has just begun does not know it yet."""
    for message, fields, what, unit, limits in _BIAS_STATES:
        if (last := _last_biases(log, core, message, fields)) is None:
            continue
        bias, table = last
        axis = int(np.argmax(np.abs(bias)))
        if abs(bias[axis]) < limits[0]:
            continue
        values, stamps = _numbers(table, fields[axis]), table.stamp_ns
        within = np.abs(values - bias[axis]) < 0.5 * abs(bias[axis])
        since = int(np.flatnonzero(~within)[-1]) + 1 if not within.all() else 0
        from_ns = int(stamps[min(since, len(stamps) - 1)])
        yield Finding(
            f"estimator.{what}_bias",
            Severity.WARNING if abs(bias[axis]) >= limits[1] else Severity.NOTICE,
            f"The filter takes the {what} to be off by {bias[axis]:.2f} {unit} on {'xyz'[axis]}, since "
            f"{clock.text(from_ns)}" + (_AT_LIMIT if _at_limit(values, bias[axis]) else ""),
            (Evidence(message, fields[axis], from_ns, int(stamps[-1]), f"{bias[axis]:.2f} {unit}"),),
            "Calibrate it at rest and warm, and see that it is left to settle before it is armed.",
        )


_AT_LIMIT = "; this is the limit of the filter, the true error may be larger"
_FEWEST_AT_LIMIT = 20


def _at_limit(values: Floats, bias: float) -> bool:
    """Whether the filter's estimate ends at its largest value, and stays at it."""
    held = np.abs(np.abs(values) - abs(bias)) <= 1e-3 * abs(bias)
    beyond = np.abs(values) > 1.001 * abs(bias)
    return bool(held[-_FEWEST_AT_LIMIT:].all() and not beyond.any() and len(values) > _FEWEST_AT_LIMIT)


def _last_biases(
    log: Log, core: EstimatorCore | None, message: str, fields: tuple[str, ...]
) -> tuple[Floats, Table] | None:
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


def _numbers(table: Table, field: str) -> Floats:
    return np.asarray(table.values(field), dtype=np.float64)


_APART_M = 5.0
_APART_DEG = 10.0
_STEPS = (
    ("IMUMin", "imu_step_min_ms", "IMU step, least", np.min),
    ("IMUMax", "imu_step_max_ms", "IMU step, longest", np.max),
    ("EKFMin", "ekf_step_min_ms", "Filter step, least", np.min),
    ("EKFMax", "ekf_step_max_ms", "Filter step, longest", np.max),
)


def agreement_facts(every: list[EstimatorCore], clock: LogClock) -> Iterator[Fact]:
    """How far the first two cores were apart while armed."""
    found = _apart(every, clock)
    if found is None:
        return
    _, metres, degrees = found
    yield Fact("cores_apart_max_m", "Cores apart in position, largest", rounded(metres.max()), "m")
    yield Fact("cores_apart_max_deg", "Cores apart in yaw, largest", rounded(degrees.max(), 2), "deg")


def agreement_findings(every: list[EstimatorCore], two_worlds: bool, clock: LogClock) -> Iterator[Finding]:
    found = _apart(every, clock)
    if found is None:
        return
    stamps, metres, degrees = found
    for size, limit, unit, what in ((metres, _APART_M, "m", "position"), (degrees, _APART_DEG, "deg", "yaw")):
        worst = int(np.argmax(size))
        if size[worst] < limit:
            continue
        at_ns = int(stamps[worst])
        yield Finding(
            f"estimator.cores_apart.{what}",
            Severity.NOTICE if two_worlds else Severity.WARNING,
            f"Cores {every[0].number} and {every[1].number} were up to {size[worst]:.1f} {unit} apart in {what} "
            f"while armed, at {clock.text(at_ns)}"
            + (": their IMUs are of two worlds, one fed from outside, one simulated" if two_worlds else ""),
            (Evidence(every[0].solution.name if every[0].solution else "XKF1", None, at_ns),),
            "Compare the IMUs they use: a bias or a gap of one of them pulls its core away.",
        )


def step_facts(log: Log) -> Iterator[Fact]:
    """XKT, NKT: steps of the IMU and of the filter; of all cores, with the windows of the start left out."""
    table = log.tables.get("XKT") or log.tables.get("NKT")
    if table is None:
        return
    counted = np.ones(len(table), dtype=np.bool_)
    if "Cnt" in table.columns:
        counts = np.asarray(table.values("Cnt", raw=True))
        counted = counts > 0.5 * np.median(counts)
    rows = np.flatnonzero(counted)
    for column, key, label, pick in _STEPS:
        if column in table.columns and len(rows):
            yield Fact(key, label, rounded(1e3 * float(pick(table.values(column, rows)))), "ms")


def _apart(every: list[EstimatorCore], clock: LogClock) -> tuple[Stamps, Floats, Floats] | None:
    """Stamps, metres and degrees of the rows that the first two cores share."""
    tables = [core.solution for core in every[:2] if core.solution is not None]
    if len(tables) < 2 or not clock.armed:
        return None
    first, second = tables
    names = ("PN", "PE", "Yaw")
    if not all(set(names) <= set(table.columns) for table in tables):
        return None
    stamps, one, other = np.intersect1d(first.stamp_ns, second.stamp_ns, return_indices=True)
    on = inside(stamps, clock.armed)
    if not on.any():
        return None
    left, right = _columns(first, one[on], names), _columns(second, other[on], names)
    difference = left - right
    good = np.isfinite(difference).all(axis=1)
    if not good.any():
        return None
    degrees = np.abs(np.mod(difference[good, 2] + 180.0, 360.0) - 180.0)
    return stamps[on][good], np.hypot(difference[good, 0], difference[good, 1]), degrees


def _columns(table: Table, rows: NDArray[np.intp], names: tuple[str, ...]) -> Floats:
    return np.stack([np.asarray(table.values(name, rows), dtype=np.float64) for name in names], axis=1)
