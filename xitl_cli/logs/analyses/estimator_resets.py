"""Refused measurements, timeouts, resets and lane switches of the estimator.

XKF4.SV SP SH SM SVT, NKF4 and EKF_STATUS_REPORT hold the square root of the test ratio: from 1 on, the measurement was
refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from xitl_cli.logs.analyses.estimator_cores import FIRST_FILTER, EstimatorCore, flag_column
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Mark, Plot, Severity, Trace
from xitl_cli.logs.model.table import Floats, Selection, Stamps, Table
from xitl_cli.logs.model.text import length_text
from xitl_cli.logs.signals.spans import inside, length_s, spans_where
from xitl_cli.logs.signals.states import autopilot_messages, error_rows, event_rows
from xitl_cli.logs.tables import events as codes

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
    for one in every:
        rows = inside(one.stamp_ns, clock.armed) if clock.armed else np.ones(len(one.values), dtype=np.bool_)
        if rows.any():
            label = f"Largest test ratio, {one.of}"
            yield Fact(f"ratio_{one.of}_max", label, round(float(one.values[rows].max()), 3))


def refusal_findings(every: list[TestRatios], clock: LogClock) -> Iterator[Finding]:
    """Refusals of the core in use while armed. Before arming, filters settle, so refusals are normal."""
    for one in every:
        spans = [span for span in one.refused if clock.was_armed(*span)]
        if not spans:
            continue
        total_s = length_s(spans)
        rows = inside(one.stamp_ns, spans)
        worst = int(np.flatnonzero(rows)[np.argmax(one.values[rows])])
        message, _, field = one.source.partition(".")
        lasted = f"{length_text(total_s)} in all" if total_s > 0.0 else f"{len(spans)} single samples"
        yield Finding(
            f"estimator.refused.{one.of}",
            Severity.WARNING if total_s >= _LONG_S else Severity.NOTICE,
            f"The estimator refused {_SENSORS[one.of]} while armed, {lasted}; the test ratio reached "
            f"{one.values[worst]:.2f} at {clock.text(int(one.stamp_ns[worst]))}",
            tuple(Evidence(message, field, begin, end) for begin, end in spans[:_MOST_SPANS]),
            f"Compare {_SENSORS[one.of]} with the other sensors there; look for a jump, a bias or a lost fix.",
        )


def ratio_plot(every: list[TestRatios], marks: tuple[Mark, ...]) -> Plot | None:
    if not every:
        return None
    several = len({one.core for one in every}) > 1
    traces = [
        Trace(f"{one.of}, core {one.core}" if several else one.of, one.stamp_ns, one.values.astype(np.float64))
        for one in every
    ]
    begin, end = (pick(one.stamp_ns[at] for one in every) for pick, at in ((min, 0), (max, -1)))
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
            "Look at that sensor: no data, or all of it refused.",
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
        f"its bits are 0x{bits:x}, of which versions differ in the meaning"
        if core.filter == FIRST_FILTER
        else ", ".join(codes.bit_names(codes.EKF_FAULTS, bits))
    )
    yield Finding.critical(
        "estimator.faults",
        f"The filter itself was faulty for {length_text(length_s(spans))}, first at "
        f"{clock.text(int(stamps[rows[0]]))}: {fault_names}",
        tuple(Evidence(table.name, "FS", begin, end, f"0x{bits:x}") for begin, end in spans[:_MOST]),
        "Do not trust attitude or position there; look at IMU gaps and clipping, and at what it fused.",
    )


def unused_core_findings(log: Log, every: list[EstimatorCore], clock: LogClock) -> Iterator[Finding]:
    """Refusals and losses of the other cores while armed. They had no effect, but they show the state of their IMU."""
    for core in every:
        if len(every) < 2 or core.health is None or "PI" not in core.health.columns:
            continue
        idle = flag_column(core.health, "PI") != core.number
        told: list[str] = []
        evidence: list[Evidence] = []
        for ratio in _ratios_of(core.number, Selection(core.health, idle), _COLUMNS):
            spans = [span for span in ratio.refused if clock.was_armed(*span)]
            if length_s(spans) >= _LONG_S:
                told.append(f"it refused {_SENSORS[ratio.of]} for {length_text(length_s(spans))}")
                message, _, field = ratio.source.partition(".")
                evidence += [Evidence(message, field, *span) for span in spans[:4]]
        table = Selection(core.health, idle)
        flags = flag_column(table, "FS") & ~codes.EKF_NOT_INITIALISED if "FS" in table.columns else np.zeros(0)
        if len(flags) and (bad := (flags != 0) & inside(table.stamp_ns, clock.armed)).any():
            spans = spans_where(table.stamp_ns, bad, _JOIN_S)
            told.append(f"it was faulty for {_lasting(spans)}")
            evidence += [Evidence(table.name, "FS", *span) for span in spans[:4]]
        if told:
            yield Finding.notice(
                "estimator.unused_core",
                f"Core {core.number} of the estimator, not in use then: {', '.join(told)}",
                tuple(evidence),
                "Nothing steered by it; compare its IMU with the others before a switch brings it into use.",
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
            "Look at GNSS (fix, dropouts) and at what was refused just before.",
        )
    if column == "SS":
        # Status flags of the filter while armed, position available: GPS glitch, dead reckoning.
        if spans := spans_where(table.stamp_ns, on & ((flags & codes.EKF_GPS_GLITCHING) != 0), _JOIN_S):
            yield Finding(
                "estimator.gps_glitch",
                Severity.WARNING if length_s(spans) >= _LONG_S else Severity.NOTICE,
                f"The estimator took GPS for glitching for {_lasting(spans)} while armed, first at "
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
                "Look at GNSS there: a dropout, or all of it refused.",
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
    found = [EstimateJump(at_ns, names[number], None, "EV.Id") for at_ns, number in event_rows(log) if number in names]
    if core is not None:
        # XKF4.OFN and OFE hold the last reset of the position.
        table = core.health
        if table is None or not {"OFN", "OFE"} <= set(table.columns):
            offsets = []
        else:
            north, east = (np.asarray(table.values(name), dtype=np.float64) for name in ("OFN", "OFE"))
            rows = np.flatnonzero((north[1:] != north[:-1]) | (east[1:] != east[:-1])) + 1
            offsets = [
                EstimateJump(
                    int(table.stamp_ns[row]), "position reset", math.hypot(north[row], east[row]), f"{table.name}.OFN"
                )
                for row in rows.tolist()
                if math.isfinite(north[row]) and math.isfinite(east[row])
            ]
        found += offsets
        told = [(one.at_ns - _SAME_NS, one.at_ns + _SAME_NS) for one in found if abs(one.at_ns) < _LATEST_NS]
        steps = _steps(core)
        known = inside(np.array([one.at_ns for one in steps], dtype=np.int64), told)
        found += [one for one, twice in zip(steps, known.tolist(), strict=True) if not twice]
    return sorted(found, key=lambda jump: jump.at_ns)


def reset_findings(
    log: Log, every: list[EstimatorCore], core: EstimatorCore | None, clock: LogClock
) -> Iterator[Finding]:
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
    found = [*lanes, *_jumped(estimate_jumps(log, core), clock)]
    if core is not None:
        found += [*timeout_findings(core, clock), *fault_findings(core, clock)]
    yield from found
    yield from position_findings(log, core, clock)


def reset_marks(log: Log, every: list[EstimatorCore], core: EstimatorCore | None) -> tuple[Mark, ...]:
    found = [Mark(at_ns, f"lane {lane}", None, Severity.WARNING) for at_ns, lane in lane_switches(log, every)]
    found += [Mark(jump.at_ns, jump.what, None, Severity.NOTICE) for jump in estimate_jumps(log, core)]
    return tuple(sorted(found, key=lambda mark: mark.at_ns)[:200])


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
    return [
        EstimateJump(int(table.stamp_ns[row + 1]), "position step", float(size_m[row]), f"{table.name}.PN")
        for row in rows.tolist()
    ]


def _jumped(every: list[EstimateJump], clock: LogClock) -> Iterator[Finding]:
    for what in dict.fromkeys(jump.what for jump in every):
        these = [jump for jump in every if jump.what == what and clock.was_armed(jump.at_ns)]
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
            "Controllers saw a step there; look for what the estimator refused before it.",
        )
