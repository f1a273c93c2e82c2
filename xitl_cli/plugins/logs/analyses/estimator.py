"""The estimator: filter in use, origin, position, biases, refusals, resets, and its error against the truth."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

import xitl_cli.logs.signals as signals
from sim_core.dataclass import dataclass
from sim_core.geodesy import LocalFrame
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import EKF_MAG_FUSION, EKF_SOURCE_SETS
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.model.text import length_text
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.spans import inside
from xitl_cli.logs.signals.states import firmware_text
from xitl_cli.plugins.logs.analyses import estimator_cores as cores

_POSITION_M = (1.0, 3.0)
_YAW_DEG = (5.0, 10.0)
"""Root mean square error from which a notice, and a warning, is given."""
_FARTHEST_M = 1e5
_AROUND = 2


@dataclass(frozen=True, slots=True)
class EstimateError:
    """Estimate minus truth at the estimate's instants."""

    stamp_ns: Stamps
    values: Floats
    """(N,) or (N, k)."""
    source: str
    truth: str

    def while_in(self, spans: list[tuple[int, int]]) -> EstimateError:
        """The errors in these spans; all errors if there are no spans."""
        if not spans:
            return self
        rows = inside(self.stamp_ns, spans)
        return EstimateError(self.stamp_ns[rows], self.values[rows], self.source, self.truth)


def position_error(log: Log) -> EstimateError | None:
    """(N, 3) north, east, down in m."""
    local, true = signals.position_ned(log), signals.position_ned(log, "truth")
    if local is not None and true is not None and local.origin == true.origin and log.of_topics:
        return _difference(local.path, true.path, local.path.values - true.path.interpolated(local.path.stamp_ns))
    estimate, truth = signals.position_geodetic(log), signals.position_geodetic(log, "truth")
    if estimate is None or truth is None:
        return None
    frame = LocalFrame(*map(float, truth.values[0]))
    there = truth.interpolated(estimate.stamp_ns)
    known = np.isfinite(there).all(axis=1)
    values = np.full((len(there), 3), np.nan)
    values[known] = frame.ned(*estimate.values[known].T) - frame.ned(*there[known].T)
    return _difference(estimate, truth, values)


def yaw_error(log: Log) -> EstimateError | None:
    """(N,) deg, between -180 and 180."""
    estimate, truth = signals.yaw(log), signals.yaw(log, "truth")
    if estimate is None or truth is None:
        return None
    values = np.mod(estimate.values - truth.interpolated(estimate.stamp_ns) + 180.0, 360.0) - 180.0
    return _difference(estimate, truth, values)


def truth_facts(position: EstimateError | None, yaw: EstimateError | None) -> Iterator[Fact]:
    if position is not None and len(position.values):
        level_m = _lasting(np.hypot(position.values[:, 0], position.values[:, 1]))
        height_m = _lasting(np.abs(position.values[:, 2]))
        yield Fact("position_error_rms_m", "Position against truth, RMS", rounded(_rms(level_m)), "m")
        yield Fact("position_error_max_m", "Position against truth, largest", rounded(level_m.max()), "m")
        yield Fact("height_error_rms_m", "Height against truth, RMS", rounded(_rms(height_m)), "m")
    if yaw is not None and len(yaw.values):
        yaw_deg = _lasting(np.abs(yaw.values))
        yield Fact("yaw_error_rms_deg", "Yaw against truth, RMS", rounded(_rms(yaw_deg)), "deg")
        yield Fact("yaw_error_max_deg", "Yaw against truth, largest", rounded(yaw_deg.max()), "deg")


def truth_findings(position: EstimateError | None, yaw: EstimateError | None, clock: LogClock) -> Iterator[Finding]:
    if position is not None and len(position.values):
        horizontal = np.hypot(position.values[:, 0], position.values[:, 1])
        step = "See in the plot when it began: a jump is a reset or a refused fix, a slope a bias."
        yield from _error_finding("position", "m", horizontal, _POSITION_M, position, step, clock)
    if yaw is not None and len(yaw.values):
        step = "Compare compass and gyroscope: an offset is declination or calibration, a slope a bias."
        yield from _error_finding("yaw", "deg", np.abs(yaw.values), _YAW_DEG, yaw, step, clock)


def truth_plots(position: EstimateError | None, yaw: EstimateError | None) -> Iterator[Plot]:
    if position is not None and len(position.values):
        names = ("north", "east", "down")
        traces = tuple(Trace(name, position.stamp_ns, position.values[:, axis]) for axis, name in enumerate(names))
        yield Plot("position_error", "Position, estimate less truth", "error (m)", traces)
    if yaw is not None and len(yaw.values):
        trace = Trace("yaw", yaw.stamp_ns, yaw.values)
        yield Plot("yaw_error", "Yaw, estimate less truth", "error (deg)", (trace,))


def _difference(estimate: signals.Series, truth: signals.Series, values: Floats) -> EstimateError:
    good = np.isfinite(values).reshape(len(values), -1).all(axis=1)
    good &= (np.abs(values) < _FARTHEST_M).reshape(len(values), -1).all(axis=1)
    return EstimateError(estimate.stamp_ns[good], values[good], estimate.source, truth.source)


def _error_finding(
    quantity: str,
    unit: str,
    size: Floats,
    limits: tuple[float, float],
    error: EstimateError,
    step: str,
    clock: LogClock,
) -> Iterator[Finding]:
    size = _lasting(size)
    rms = _rms(size)
    if rms < limits[0]:
        return
    worst = int(np.argmax(size))
    at_ns = int(error.stamp_ns[worst])
    message, _, field = error.source.partition(".")
    yield Finding(
        f"estimator.{quantity}_error",
        Severity.WARNING if rms >= limits[1] else Severity.NOTICE,
        f"The estimated {quantity} was off the truth by {rms:.2f} {unit} RMS and up to {size[worst]:.2f} {unit}, at "
        f"{clock.text(at_ns)}",
        (Evidence(message, field or None, at_ns, value=f"{size[worst]:.2f} {unit}"), Evidence(error.truth)),
        step,
    )


def _lasting(size: Floats) -> Floats:
    """(N,) median of each value with its neighbours, to remove one or two damaged rows."""
    width = 2 * _AROUND + 1
    if len(size) < width:
        return size
    around = np.lib.stride_tricks.sliding_window_view(np.pad(size, _AROUND, mode="edge"), width)
    medians: Floats = np.median(around, axis=1)
    return medians


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


_HEIGHTS_APART_M = 10.0
_HEIGHT_MOVED_M = 1.0
_MOST_REFUSED = 100  # of each measurement and core, in the table


def analyse(log: Log) -> Section | None:
    every = cores.estimator_cores(log)
    tested = cores.test_ratios(log, every)
    position, yaw = position_error(log), yaw_error(log)
    if not every and not tested and position is None and yaw is None:
        if log.of_topics:
            return None
        lack = "The log has no messages of an estimator (XKF, NKF, EKF_STATUS_REPORT); EK3_LOG_LEVEL 0 logs them."
        return Section("estimator", "Estimator", lacks=(lack,))
    clock = LogClock(log)
    stray_m = signals.stray_truth_m(log)
    primary = cores.primary_core(every)
    core = cores.core_in_use(log, every, primary)
    tested_in_use = cores.test_ratios(log, [core] if core is not None else [])
    origin, used = cores.estimator_origin(log, every, clock), cores.filter_uses(log)
    jumps = cores.estimate_jumps(log, core)
    if position is not None:
        position = position.while_in(clock.armed)
    if yaw is not None:
        yaw = yaw.while_in(clock.armed)
    embedded = (firmware_text(log) or "").startswith("xitl ")
    name = every[0].filter if every else None
    facts = [
        Fact("filter", "Filter", "embedded, messages as EKF3" if embedded and every else name),
        Fact("cores", "Cores", len(every) or None),
        Fact("primary_core", "Core in use", primary if every else None),
        *_origin_facts(origin, every, clock),
        *_selection(log),
        Fact("lane_switches", "Core switches", len(cores.lane_switches(log, every)) if every else None),
        *cores.ratio_facts(tested_in_use, clock),
        *cores.agreement_facts(every, clock),
        *cores.step_facts(log),
        *cores.bias_facts(log, core),
        *truth_facts(position, yaw),
    ]
    findings = [
        *_filters(used, clock),
        *cores.never_positioned(every, clock),
        *_height(log, origin, clock),
        *cores.refusal_findings(tested_in_use, clock),
        *cores.reset_findings(log, every, core, jumps, clock),
        *cores.unused_core_findings(log, every, clock),
        *cores.bias_findings(log, core, clock),
        *cores.agreement_findings(every, stray_m is not None, clock),
        *truth_findings(position, yaw, clock),
    ]
    if stray_m is not None:
        sentence = (
            f"SIM is not the truth here: its vehicle moved unlike the receiver and was {stray_m:.0f} m away from it, "
            "so the sensors were fed from outside"
        )
        step = "Compare the estimate with the recording of the simulator that fed the sensors (run.mcap)."
        evidence = (Evidence("SIM"), Evidence("GPS"))
        findings.append(Finding.notice("estimator.truth_of_another", sentence, evidence, step))
    armed = tuple(Mark(begin, "armed", end, Severity.OK) for begin, end in clock.armed[:50])
    marks = (*armed, *cores.reset_marks(log, every, jumps))
    ratios = cores.ratio_plot(tested, marks)
    plots = [*([] if ratios is None else [ratios]), *_innovations(core, marks), *truth_plots(position, yaw)]
    grids = [grid for grid in (_uses(used, clock), _refusals(tested, clock)) if grid is not None]
    lacks = []
    if core is not None and core.innovations is None and not embedded:
        lacks.append("Innovations are not in the log (XKF3); EK3_LOG_LEVEL 0 logs them.")
    if every and core is not None and core.health is None:
        lacks.append("Test ratios are not in the log (XKF4).")
    if not every and log.format == "tlog":
        lacks.append("Telemetry has test ratios only a few times a second, and of the core in use.")
    known = tuple(fact for fact in facts if fact.value is not None)
    return Section("estimator", "Estimator", known, tuple(findings), tuple(grids), tuple(plots), tuple(lacks))


def _origin_facts(
    origin: cores.EstimatorOrigin | None, every: list[cores.EstimatorCore], clock: LogClock
) -> Iterator[Fact]:
    if origin is not None:
        when = "before the log began" if origin.set_ns is None else clock.second(origin.set_ns)
        yield Fact("origin_set", "Origin set", when, "" if origin.set_ns is None else "s")
        yield Fact("origin_latitude_deg", "Origin latitude", rounded(origin.latitude_deg, 7), "deg")
        yield Fact("origin_longitude_deg", "Origin longitude", rounded(origin.longitude_deg, 7), "deg")
        yield Fact("origin_altitude_m", "Origin altitude (ORGN)", rounded(origin.altitude_m, 2), "m")
        yield Fact("origin_height_m", "Height of the origin (OH)", rounded(origin.height_m, 2), "m")
    if (first_ns := cores.first_position_ns(every)) is not None:
        early = first_ns <= clock.start_ns + 10**9
        value = "before the log began" if early else clock.second(first_ns)
        yield Fact("first_position", "First absolute position", value, "" if early else "s")


def _selection(log: Log) -> Iterator[Fact]:
    """XKFS: the sources of the filter's measurements, at the end."""
    table = log.tables.get("XKFS")
    if table is None or not len(table):
        return
    last = slice(len(table) - 1, len(table))
    if "SS" in table.columns:
        number_of_set = int(table.values("SS", last, raw=True)[0])
        yield Fact("source_set", "Source set", EKF_SOURCE_SETS.get(number_of_set, str(number_of_set)))
    if "MAG_FUSION" in table.columns:
        fusion = int(table.values("MAG_FUSION", last, raw=True)[0])
        yield Fact("mag_fusion", "Compass fused as", EKF_MAG_FUSION.get(fusion, str(fusion)))


def _filters(used: list[cores.FilterUse], clock: LogClock) -> Iterator[Finding]:
    """Fallback of the attitude from a filter to DCM while armed."""
    fallbacks = [
        (before, use) for before, use in itertools.pairwise(used) if use.name == "DCM" and clock.was_armed(use.from_ns)
    ]
    if not fallbacks:
        return
    before, use = fallbacks[0]
    lasted = length_text(sum(dcm.until_ns - dcm.from_ns for _, dcm in fallbacks) * 1e-9)
    yield Finding.critical(
        "estimator.dcm_fallback",
        f"{before.name} gave up and DCM took over while armed for {lasted}, first at {clock.text(use.from_ns)}",
        tuple(Evidence("ATT", "AEKF", dcm.from_ns, dcm.until_ns, "0") for _, dcm in fallbacks[:20]),
        "Look at test ratios and faults just before. DCM gives no position that is good enough to steer by.",
    )


def _height(log: Log, origin: cores.EstimatorOrigin | None, clock: LogClock) -> Iterator[Finding]:
    if origin is None or origin.height_m is None:
        return
    heights = [height for _, height in origin.heights]
    moved_m = max(heights) - min(heights)
    if moved_m >= _HEIGHT_MOVED_M:
        at_ns = origin.heights[1][0]
        yield Finding.notice(
            "estimator.height_origin_moved",
            f"The height of the estimator's origin moved by {moved_m:.1f} m in {len(heights) - 1} steps, first at "
            f"{clock.text(at_ns)}",
            tuple(Evidence("XKF1", "OH", when, value=f"{height:.2f} m") for when, height in origin.heights[:20]),
            "Altitudes before and after do not have the same datum; EK3_OGN_HGT_MASK enables this.",
        )
    # Altitude of the receiver when the origin was set.
    set_ns = origin.heights[0][0]
    table = log.tables.get("GPS")
    if table is None or not {"Alt", "Status"} <= set(table.columns):
        return
    fixed = np.flatnonzero(cores.flag_column(table, "Status") >= 3)
    if not len(fixed):
        return
    nearest = fixed[np.argmin(np.abs(table.stamp_ns[fixed] - set_ns))]
    gps_m = rounded(float(table.values("Alt", np.array([nearest]))[0]))
    if gps_m is not None and abs(gps_m - origin.height_m) >= _HEIGHTS_APART_M:
        yield Finding.notice(
            "estimator.height_origin_off",
            f"The estimator's origin is at {origin.height_m:.1f} m, but GPS was at {gps_m:.1f} m when it was set",
            (Evidence("XKF1", "OH", set_ns, value=f"{origin.height_m:.1f} m"), Evidence("GPS", "Alt")),
            "Take heights from one of the two, and do not mix them.",
        )


def _innovations(core: cores.EstimatorCore | None, marks: tuple[Mark, ...]) -> Iterator[Plot]:
    table = None if core is None else core.innovations
    if table is None:
        return
    rows = (
        ("velocity", "m/s", ("IVN", "IVE", "IVD")),
        ("position", "m", ("IPN", "IPE", "IPD")),
        ("yaw", "deg", ("IYAW",)),
    )
    for quantity, unit, columns in rows:
        traces = [
            Trace(column, table.stamp_ns, np.asarray(table.values(column), dtype=np.float64))
            for column in columns
            if column in table.columns
        ]
        if traces:
            title = f"Innovations, {quantity}"
            yield Plot(f"innovations_{quantity}", title, f"innovation ({unit})", tuple(traces), marks=marks)


def _uses(used: list[cores.FilterUse], clock: LogClock) -> Grid | None:
    if not used:
        return None
    rows = [
        (clock.second(use.from_ns), clock.second(use.until_ns), rounded((use.until_ns - use.from_ns) * 1e-9), use.name)
        for use in used
    ]
    return Grid.limited("filters", "Filter in use", ("from (s)", "until (s)", "duration (s)", "filter"), rows)


def _refusals(tested: list[cores.TestRatios], clock: LogClock) -> Grid | None:
    rows = []
    for ratios in tested:
        for begin, end in ratios.refused[:_MOST_REFUSED]:
            inner = inside(ratios.stamp_ns, [(begin, end)])
            on = "armed" if clock.was_armed(begin, end) else "not armed"
            worst = rounded(ratios.values[inner].max(), 2)
            rows.append((ratios.core, ratios.of, clock.second(begin), rounded((end - begin) * 1e-9), worst, on))
    if not rows:
        return None
    rows.sort(key=lambda row: row[2])
    columns = ("core", "measurement", "from (s)", "for (s)", "largest ratio", "while")
    return Grid.limited("refused", "Measurements refused", columns, rows)
