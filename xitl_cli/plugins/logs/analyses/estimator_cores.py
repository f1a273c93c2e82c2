"""Cores of the estimator: origin, position, biases, and agreement of cores over time.

The messages are EKF3's XKF, EKF2's NKF, and EKF1 to EKF4 of the first filter, by number of the core, for all versions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import compress
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model import codes as codes
from xitl_cli.logs.model.codes import EKF_ABSOLUTE, EKF_ACTIVE, EKF_GPS_CHECKS
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Mark, Plot, Severity, Trace
from xitl_cli.logs.model.table import Floats, Selection, Stamps, Table, by_instance
from xitl_cli.logs.model.text import length_text
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.spans import inside, length_s, spans_where
from xitl_cli.logs.signals.states import autopilot_messages, error_rows, event_rows, lanes, rows_in_use

FIRST_FILTER = "EKF1"  # until Copter 3.4; its fault bits differ
_FAMILIES = (("EKF3", "XKF"), ("EKF2", "NKF"), (FIRST_FILTER, "EKF"))
_SECOND_CORE = 5  # before 4.1, a core had its own messages: XKF6 is XKF1 of the second


@dataclass(frozen=True, slots=True)
class EstimatorCore:
    """One core: solution (XKF1), innovations (XKF3), health (XKF4); None if not logged."""

    number: int
    filter: str
    solution: Table | None
    innovations: Table | None
    health: Table | None


def estimator_cores(log: Log) -> list[EstimatorCore]:
    """Cores by number, of EKF3 if it was logged, else of EKF2, else of the first filter."""
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
    """Rows of the core in use at each row, under the number of the core that was in use longest."""
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
    """Origin of the estimator."""

    set_ns: int | None
    """None if it was set before the log began."""
    latitude_deg: float | None
    longitude_deg: float | None
    altitude_m: float | None
    """From ORGN."""
    height_m: float | None
    """First XKF1.OH."""
    heights: tuple[tuple[int, float], ...]


@dataclass(frozen=True, slots=True)
class FilterUse:
    """A filter that provides attitude and position, and its span."""

    from_ns: int
    until_ns: int
    name: str


def estimator_origin(log: Log, every: list[EstimatorCore], clock: LogClock) -> EstimatorOrigin | None:
    """Origin of the estimator; None if it is not logged."""
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
    """First instant at which a core reported a good absolute position."""
    found = []
    for core in every:
        if core.health is not None and "SS" in core.health.columns:
            good = np.flatnonzero(flag_column(core.health, "SS") & EKF_ABSOLUTE)
            found += [int(core.health.stamp_ns[good[0]])] if len(good) else []
    return min(found, default=None)


def never_positioned(every: list[EstimatorCore], clock: LogClock) -> Iterator[Finding]:
    """Finding that no core ever had an absolute position, with its most frequent results of GPS checks."""
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
    """Filters by ATT.AEKF; empty if it is not logged."""
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
    """(stamp, m) of changes of the origin's height, from the first core that logs it; 0 means that there is none."""
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
"""Table, fields, name, unit, and the biases for a notice and a warning."""


def bias_facts(log: Log, core: EstimatorCore | None) -> Iterator[Fact]:
    for message, fields, what, unit, _ in _BIAS_STATES:
        if (last := _last_biases(log, core, message, fields)) is not None:
            size = rounded(float(np.max(np.abs(last[0]))))
            yield Fact(f"{what}_bias", f"Bias of the {what} by the filter, at the end", size, unit)


def bias_findings(log: Log, core: EstimatorCore | None, clock: LogClock) -> Iterator[Finding]:
    """Biases of the last seconds, because a filter that has just started does not know them yet."""
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
        # The estimate ends at its largest value, and has stayed there.
        size, largest = np.abs(values), abs(bias[axis])
        ends = np.abs(size[-_FEWEST_AT_LIMIT:] - largest) <= 1e-3 * largest
        at_limit = len(values) > _FEWEST_AT_LIMIT and ends.all() and not (size > 1.001 * largest).any()
        yield Finding(
            f"estimator.{what}_bias",
            Severity.WARNING if abs(bias[axis]) >= limits[1] else Severity.NOTICE,
            f"The filter estimates that the {what} is off by {bias[axis]:.2f} {unit} on {'xyz'[axis]}, since "
            f"{clock.text(from_ns)}" + (_AT_LIMIT if at_limit else ""),
            (Evidence(message, fields[axis], from_ns, int(stamps[-1]), f"{bias[axis]:.2f} {unit}"),),
            "Calibrate it at rest and warm, and let it settle before arming.",
        )


_AT_LIMIT = "; the estimate stays at its largest value, so the true error may be larger"
_FEWEST_AT_LIMIT = 20


def _last_biases(
    log: Log, core: EstimatorCore | None, message: str, fields: tuple[str, ...]
) -> tuple[Floats, Table] | None:
    """(3,) medians over the last seconds, and the rows of the core in use; None if it ran too short."""
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
    """Distance between the first two cores while armed."""
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
            + (": one IMU is fed from outside, the other is simulated" if two_worlds else ""),
            (Evidence(every[0].solution.name if every[0].solution else "XKF1", None, at_ns),),
            "Compare the IMUs they use: a bias or a gap of one of them pulls its core away.",
        )


def step_facts(log: Log) -> Iterator[Fact]:
    """XKT, NKT: steps of the IMU and of the filter, of all cores, without the windows at the start."""
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


# Refused measurements, timeouts, resets and lane switches of the estimator.
#
# XKF4.SV SP SH SM SVT, NKF4 and EKF_STATUS_REPORT hold the square root of the test ratio: from 1 on, the measurement
# was refused.

_COLUMNS: Mapping[str, str] = MappingProxyType(
    {"SV": "velocity", "SP": "position", "SH": "height", "SM": "compass", "SVT": "airspeed"}
)
_AXES = ("SMX", "SMY", "SMZ")  # of the compass, in the first filter
_REPORTED: Mapping[str, str] = MappingProxyType(
    {
        "velocity_variance": "velocity",
        "pos_horiz_variance": "position",
        "pos_vert_variance": "height",
        "compass_variance": "compass",
    }
)
_SENSORS: Mapping[str, str] = MappingProxyType(
    {
        "velocity": "GNSS velocity",
        "position": "GNSS position",
        "height": "barometer or GNSS height",
        "compass": "compass",
        "airspeed": "airspeed",
    }
)
_JOIN_S = 0.5
_LONG_S = 1.0
_MOST_SPANS = 50


@dataclass(frozen=True, slots=True)
class TestRatios:
    """Ratios of one innovation test."""

    core: int
    of: str
    """The tested measurement."""
    source: str
    """Message and field, such as XKF4.SV."""
    stamp_ns: Stamps
    values: Floats
    """(N,) at stamp_ns."""

    @property
    def refused(self) -> list[tuple[int, int]]:
        """Spans in which measurements were refused."""
        return spans_where(self.stamp_ns, self.values >= 1.0, _JOIN_S)


def test_ratios(log: Log, every: list[EstimatorCore]) -> list[TestRatios]:
    """Ratios of all cores. Ratios that stay 0, of sensors that were never fused, are omitted."""
    found: list[TestRatios] = []
    for core in every:
        if core.health is not None:
            found += _ratios_of(core.number, core.health, _COLUMNS)
    report = autopilot_messages(log, "EKF_STATUS_REPORT")
    if not found and report is not None:
        found = _ratios_of(0, report, _REPORTED)
    return found


def _ratios_of(core: int, table: Table, columns: Mapping[str, str]) -> list[TestRatios]:
    found = []
    for column, of in columns.items():
        if column not in table.columns:
            continue
        values = np.asarray(table.values(column), dtype=np.float64)
        good = np.isfinite(values)
        if good.any() and (values[good] > 0.0).any():
            name = table.name.rpartition(":")[2]
            found.append(TestRatios(core, of, f"{name}.{column}", table.stamp_ns[good], values[good]))
    axes = [np.asarray(table.values(axis), dtype=np.float64) for axis in _AXES if axis in table.columns]
    if axes and (largest := np.nan_to_num(np.max(axes, axis=0))).any():
        found.append(TestRatios(core, "compass", f"{table.name}.{_AXES[0]}", table.stamp_ns, largest))
    return found


def ratio_facts(every: list[TestRatios], clock: LogClock) -> Iterator[Fact]:
    """Largest ratio of each test of the core in use while armed, or overall if never armed."""
    for ratios in every:
        rows = inside(ratios.stamp_ns, clock.armed) if clock.armed else np.ones(len(ratios.values), dtype=np.bool_)
        if rows.any():
            label = f"Largest test ratio, {ratios.of}"
            yield Fact(f"ratio_{ratios.of}_max", label, round(float(ratios.values[rows].max()), 3))


def refusal_findings(every: list[TestRatios], clock: LogClock) -> Iterator[Finding]:
    """Refusals of the core in use while armed. Before arming, filters settle, so refusals are normal."""
    for ratios in every:
        spans = [span for span in ratios.refused if clock.was_armed(*span)]
        if not spans:
            continue
        total_s = length_s(spans)
        rows = inside(ratios.stamp_ns, spans)
        worst = int(np.flatnonzero(rows)[np.argmax(ratios.values[rows])])
        message, _, field = ratios.source.partition(".")
        lasted = f"{length_text(total_s)} in all" if total_s > 0.0 else f"{len(spans)} single samples"
        yield Finding(
            f"estimator.refused.{ratios.of}",
            Severity.WARNING if total_s >= _LONG_S else Severity.NOTICE,
            f"The estimator refused {_SENSORS[ratios.of]} while armed, {lasted}; the test ratio reached "
            f"{ratios.values[worst]:.2f} at {clock.text(int(ratios.stamp_ns[worst]))}",
            tuple(Evidence(message, field, begin, end) for begin, end in spans[:_MOST_SPANS]),
            f"Compare {_SENSORS[ratios.of]} with the other sensors there; look for a jump, a bias or a lost fix.",
        )


def ratio_plot(every: list[TestRatios], marks: tuple[Mark, ...]) -> Plot | None:
    if not every:
        return None
    several = len({ratios.core for ratios in every}) > 1
    traces = [
        Trace(
            f"{ratios.of}, core {ratios.core}" if several else ratios.of,
            ratios.stamp_ns,
            ratios.values.astype(np.float64),
        )
        for ratios in every
    ]
    begin, end = (pick(ratios.stamp_ns[at] for ratios in every) for pick, at in ((min, 0), (max, -1)))
    limit = Trace("refused from here", np.array([begin, end], dtype=np.int64), np.ones(2))
    return Plot("test_ratios", "Test ratios", "ratio", (*traces, limit), marks=marks)


_MOST = 20


def timeout_findings(core: EstimatorCore, clock: LogClock) -> Iterator[Finding]:
    table = core.health
    if table is None or "TS" not in table.columns:
        return
    flags = flag_column(table, "TS") & codes.EKF_TIMEOUTS_THAT_COUNT
    on = inside(table.stamp_ns, clock.armed)
    for bit, name in codes.EKF_TIMEOUTS.items():
        spans = spans_where(table.stamp_ns, ((flags >> bit & 1) == 1) & on, _JOIN_S)
        if length_s(spans) < _LONG_S:
            continue
        yield Finding.warning(
            f"estimator.timeout.{name}",
            f"The estimator went without {name} for {length_text(length_s(spans))} while armed, first at "
            f"{clock.text(spans[0][0])}",
            tuple(Evidence(table.name, "TS", begin, end, name) for begin, end in spans[:_MOST]),
            "Look at that sensor: it sent no data, or all of it was refused.",
        )


def fault_findings(core: EstimatorCore, clock: LogClock) -> Iterator[Finding]:
    table = core.health
    if table is None or "FS" not in table.columns:
        return
    flags = flag_column(table, "FS")
    begun = np.flatnonzero((flags & codes.EKF_NOT_INITIALISED) == 0)
    if not len(begun):
        return
    flags = flags[begun[0] :]
    rows = np.flatnonzero(flags)
    if not len(rows):
        return
    stamps = table.stamp_ns[begun[0] :]
    bits = int(np.bitwise_or.reduce(flags[rows]))
    spans = spans_where(stamps, flags != 0, _JOIN_S)
    fault_names = (
        f"its bits are 0x{bits:x}; their meaning depends on the version"
        if core.filter == FIRST_FILTER
        else ", ".join(codes.bit_names(codes.EKF_FAULTS, bits))
    )
    yield Finding.critical(
        "estimator.faults",
        f"The filter itself was faulty for {length_text(length_s(spans))}, first at "
        f"{clock.text(int(stamps[rows[0]]))}: {fault_names}",
        tuple(Evidence(table.name, "FS", begin, end, f"0x{bits:x}") for begin, end in spans[:_MOST]),
        "Do not trust attitude or position there; look at gaps and clipping of the IMU, and at the measurements "
        "that it used.",
    )


def unused_core_findings(log: Log, every: list[EstimatorCore], clock: LogClock) -> Iterator[Finding]:
    """Refusals and losses of the other cores while armed. They had no effect, but they show the state of their IMU."""
    for core in every:
        if len(every) < 2 or core.health is None or "PI" not in core.health.columns:
            continue
        idle = flag_column(core.health, "PI") != core.number
        troubles: list[str] = []
        evidence: list[Evidence] = []
        for ratio in _ratios_of(core.number, Selection(core.health, idle), _COLUMNS):
            spans = [span for span in ratio.refused if clock.was_armed(*span)]
            if length_s(spans) >= _LONG_S:
                troubles.append(f"it refused {_SENSORS[ratio.of]} for {length_text(length_s(spans))}")
                message, _, field = ratio.source.partition(".")
                evidence += [Evidence(message, field, *span) for span in spans[:4]]
        table = Selection(core.health, idle)
        flags = flag_column(table, "FS") & ~codes.EKF_NOT_INITIALISED if "FS" in table.columns else np.zeros(0)
        if len(flags) and (bad := (flags != 0) & inside(table.stamp_ns, clock.armed)).any():
            spans = spans_where(table.stamp_ns, bad, _JOIN_S)
            troubles.append(f"it was faulty for {_lasting(spans)}")
            evidence += [Evidence(table.name, "FS", *span) for span in spans[:4]]
        if troubles:
            yield Finding.notice(
                "estimator.unused_core",
                f"Core {core.number} of the estimator, not in use then: {', '.join(troubles)}",
                tuple(evidence),
                "Nothing used it. Compare its IMU with the others before a switch activates it.",
            )


def position_findings(log: Log, core: EstimatorCore | None, clock: LogClock) -> Iterator[Finding]:
    """Solution status of the core in use while armed: loss of position, GPS glitches."""
    table = None if core is None else core.health
    column = "SS"
    if table is None or column not in table.columns:
        table, column = autopilot_messages(log, "EKF_STATUS_REPORT"), "flags"
    if table is None or column not in table.columns:
        return
    flags, on = flag_column(table, column), inside(table.stamp_ns, clock.armed)
    had = np.maximum.accumulate((flags & codes.EKF_ABSOLUTE) != 0) if len(flags) else np.zeros(0, dtype=np.bool_)
    lost = had & on & (((flags & codes.EKF_ABSOLUTE) == 0) | ((flags & codes.EKF_CONSTANT_POSITION) != 0))
    if spans := spans_where(table.stamp_ns, lost, _JOIN_S):
        yield Finding(
            "estimator.position_lost",
            Severity.CRITICAL if length_s(spans) >= _LONG_S else Severity.WARNING,
            f"The estimator had no absolute position for {_lasting(spans)} while armed, first at "
            f"{clock.text(spans[0][0])}",
            _evidence(table.name, column, spans),
            "Look at GNSS (fix, dropouts) and at the refusals just before.",
        )
    if column == "SS":
        # Status flags of the filter while armed, position available: GPS glitch, dead reckoning.
        if spans := spans_where(table.stamp_ns, on & ((flags & codes.EKF_GPS_GLITCHING) != 0), _JOIN_S):
            yield Finding(
                "estimator.gps_glitch",
                Severity.WARNING if length_s(spans) >= _LONG_S else Severity.NOTICE,
                f"The estimator judged GPS to be glitching for {_lasting(spans)} while armed, first at "
                f"{clock.text(spans[0][0])}",
                _evidence(table.name, "SS", spans),
                "Compare GPS with the estimate there: a jump, or a drift of the estimate.",
            )
        spans = spans_where(table.stamp_ns, on & ((flags & codes.EKF_DEAD_RECKONING) != 0), _JOIN_S)
        if length_s(spans) >= _LONG_S:
            yield Finding.warning(
                "estimator.dead_reckoning",
                f"The estimator was dead reckoning for {_lasting(spans)} while armed, first at "
                f"{clock.text(spans[0][0])}",
                _evidence(table.name, "SS", spans),
                "Look at GNSS there: it dropped out, or all of it was refused.",
            )


def _lasting(spans: list[tuple[int, int]]) -> str:
    return length_text(length_s(spans)) if length_s(spans) > 0.0 else f"{len(spans)} samples"


def _evidence(message: str, field: str, spans: list[tuple[int, int]]) -> tuple[Evidence, ...]:
    return tuple(Evidence(message.rpartition(":")[2], field, begin, end) for begin, end in spans[:_MOST])


_JUMP_M = 1.0
_LONGEST_STEP_S = 1.0
_SAME_NS = 200_000_000
_LATEST_NS = 1 << 62


@dataclass(frozen=True, slots=True)
class EstimateJump:
    """A jump of the estimate."""

    at_ns: int
    what: str
    size_m: float | None
    """None if not logged."""
    source: str
    """Message and field that show it."""


def lane_switches(log: Log, every: list[EstimatorCore]) -> list[tuple[int, int]]:
    """(stamp, core now in use), after the first; by XKF4.PI, or by ERR 24 if that is not logged."""
    table = every[0].health if every else None
    if table is not None and "PI" in table.columns and len(table):
        lanes = flag_column(table, "PI")
        rows = np.flatnonzero(np.diff(lanes) != 0) + 1
        return list(zip(table.stamp_ns[rows].tolist(), lanes[rows].tolist(), strict=True))
    return [(at_ns, code) for at_ns, subsystem, code in error_rows(log) if subsystem == codes.ERR_EKF_PRIMARY]


def primary_core(every: list[EstimatorCore]) -> int:
    """The core that was in use longest; the first core if that is not logged."""
    table = every[0].health if every else None
    if table is None or "PI" not in table.columns or not len(table):
        return every[0].number if every else 0
    lanes = flag_column(table, "PI")
    known = lanes[np.isin(lanes, [core.number for core in every])]
    return int(np.bincount(known).argmax()) if len(known) else every[0].number


def estimate_jumps(log: Log, core: EstimatorCore | None) -> list[EstimateJump]:
    """Logged resets, and steps of the position that its velocity does not explain, in order of time."""
    names = {codes.EKF_ALT_RESET: "height reset", codes.EKF_YAW_RESET: "yaw reset"}
    jumps = [EstimateJump(at_ns, names[number], None, "EV.Id") for at_ns, number in event_rows(log) if number in names]
    if core is not None:
        # XKF4.OFN and OFE hold the last reset of the position.
        table = core.health
        if table is None or not {"OFN", "OFE"} <= set(table.columns):
            offsets = []
        else:
            north, east = (np.asarray(table.values(name), dtype=np.float64) for name in ("OFN", "OFE"))
            moved = (north[1:] != north[:-1]) | (east[1:] != east[:-1])
            rows = np.flatnonzero(moved & np.isfinite(north[1:]) & np.isfinite(east[1:])) + 1
            source = f"{table.name}.OFN"
            offsets = [
                EstimateJump(at_ns, "position reset", math.hypot(*offset), source)
                for at_ns, *offset in zip(
                    table.stamp_ns[rows].tolist(), north[rows].tolist(), east[rows].tolist(), strict=True
                )
            ]
        jumps += offsets
        event_spans = [(one.at_ns - _SAME_NS, one.at_ns + _SAME_NS) for one in jumps if abs(one.at_ns) < _LATEST_NS]
        steps = _steps(core)
        known = inside(_instants(steps), event_spans)
        jumps += [one for one, twice in zip(steps, known.tolist(), strict=True) if not twice]
    return sorted(jumps, key=lambda jump: jump.at_ns)


def _instants(jumps: Sequence[EstimateJump]) -> Stamps:
    return np.array([jump.at_ns for jump in jumps], dtype=np.int64)


def reset_findings(
    log: Log,
    every: list[EstimatorCore],
    core: EstimatorCore | None,
    jumps: Sequence[EstimateJump],
    clock: LogClock,
) -> Iterator[Finding]:
    """Findings on core switches, on `jumps` of the estimate (`estimate_jumps`), and on the position."""
    lanes: list[Finding] = []
    switches = lane_switches(log, every)
    while_armed = [switch for switch in switches if clock.was_armed(switch[0])]
    if while_armed:
        at_ns, lane = while_armed[0]
        times = "once" if len(while_armed) == 1 else f"{len(while_armed)} times"
        lanes.append(
            Finding.warning(
                "estimator.lane_switch",
                f"The estimator switched its core {times} while armed, first to core {lane} at {clock.text(at_ns)}",
                tuple(Evidence("XKF4", "PI", when, value=str(to)) for when, to in while_armed[:_MOST]),
                "Look at the test ratios of the core that was left, and at the IMU it used.",
            )
        )
    found = [*lanes, *_jumped(jumps, clock)]
    if core is not None:
        found += [*timeout_findings(core, clock), *fault_findings(core, clock)]
    yield from found
    yield from position_findings(log, core, clock)


_MOST_MARKS = 200


def reset_marks(log: Log, every: list[EstimatorCore], jumps: Sequence[EstimateJump]) -> tuple[Mark, ...]:
    """Marks of the first core switches and jumps (`estimate_jumps`, in order of time)."""
    found = [Mark(at_ns, f"lane {lane}", None, Severity.WARNING) for at_ns, lane in lane_switches(log, every)]
    found += [Mark(jump.at_ns, jump.what, None, Severity.NOTICE) for jump in jumps[:_MOST_MARKS]]
    return tuple(sorted(found, key=lambda mark: mark.at_ns)[:_MOST_MARKS])


def _steps(core: EstimatorCore) -> list[EstimateJump]:
    table = core.solution
    if table is None or not {"PN", "PE", "VN", "VE"} <= set(table.columns) or len(table) < 2:
        return []
    columns = [np.asarray(table.values(name), dtype=np.float64) for name in ("PN", "PE", "VN", "VE")]
    north, east, north_mps, east_mps = columns
    step_s = np.diff(table.stamp_ns) * 1e-9
    was = (north[:-1] != 0.0) | (east[:-1] != 0.0)
    with np.errstate(invalid="ignore", over="ignore"):
        fast_mps = np.hypot(
            np.maximum(np.abs(north_mps[1:]), np.abs(north_mps[:-1])),
            np.maximum(np.abs(east_mps[1:]), np.abs(east_mps[:-1])),
        )
        size_m = np.hypot(np.diff(north), np.diff(east)) - fast_mps * step_s
        rows = np.flatnonzero((size_m > _JUMP_M) & (step_s > 0.0) & (step_s < _LONGEST_STEP_S) & was)
    source = f"{table.name}.PN"
    return [
        EstimateJump(at_ns, "position step", step_m, source)
        for at_ns, step_m in zip(table.stamp_ns[rows + 1].tolist(), size_m[rows].tolist(), strict=True)
    ]


def _jumped(every: Sequence[EstimateJump], clock: LogClock) -> Iterator[Finding]:
    while_armed = list(compress(every, clock.armed_rows(_instants(every)).tolist()))
    for what in dict.fromkeys(jump.what for jump in every):
        these = [jump for jump in while_armed if jump.what == what]
        if not these:
            continue
        sizes = [jump.size_m for jump in these if jump.size_m is not None]
        first = clock.text(these[0].at_ns)
        if len(these) == 1:
            size = f" of {sizes[0]:.2f} m" if sizes else ""
            sentence = f"The estimator made a {what}{size} while armed, at {first}"
        else:
            size = f", by up to {max(sizes):.2f} m" if sizes else ""
            sentence = f"The estimator made a {what} {len(these)} times while armed{size}, first at {first}"
        yield Finding(
            f"estimator.{what.replace(' ', '_')}",
            Severity.WARNING if max(sizes, default=0.0) >= _JUMP_M else Severity.NOTICE,
            sentence,
            tuple(
                Evidence(
                    jump.source.partition(".")[0],
                    jump.source.partition(".")[2],
                    jump.at_ns,
                    value=None if jump.size_m is None else f"{jump.size_m:.2f} m",
                )
                for jump in these[:_MOST]
            ),
            "The controllers saw a step there. Look for measurements that the estimator refused before it.",
        )
