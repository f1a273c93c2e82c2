"""Noise of sensors at rest: scatter from sample to sample, Allan deviation and what is read off it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.allan import AllanCurve, ReadOff, bias_instability, overlapping, random_walk, white_noise_density
from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.gaps import LONG_GAP_PERIODS, regularity
from xitl_cli.logs.sections import Evidence, Finding, Grid, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.sensing.columns import told
from xitl_cli.logs.sensing.inertial import Inertial
from xitl_cli.logs.sensing.plain import Plain
from xitl_cli.logs.sensing.rest import Rest

SHORTEST_S = 60.0
SHORTEST_SCATTER_S = 5.0
_SLOWEST_HZ = 10.0
_DECIMATED = 1.2
_MOST_UNITS = 6


def noise(
    inertial: Sequence[Inertial],
    plain: Sequence[Plain],
    still: Rest,
    parameters: Mapping[str, float],
    simulated: bool,
    instants: Instants,
) -> Section:
    scatter = _scatter(inertial, plain, still)
    grids = [scatter] if scatter.rows else []
    if not inertial:
        return Section("sensors", "Sensors", grids=tuple(grids))
    if still.longest_s < SHORTEST_S:
        longest = f"the longest stretch at rest is {still.longest_s:.0f} s" if still.stretches else "it never lay still"
        return Section(
            "sensors",
            "Sensors",
            grids=tuple(grids),
            lacks=(
                f"No Allan deviation: it takes {SHORTEST_S:.0f} s without motion, and {longest}; "
                "log while disarmed and ashore (LOG_DISARMED 1), an hour for the bias instability.",
            ),
        )
    rows: list[tuple[Value, ...]] = []
    curves: dict[str, list[Trace]] = {"rad/s": [], "m/s²": []}
    lacks: list[str] = []
    findings: list[Finding] = []
    for unit in list(inertial)[:_MOST_UNITS]:
        piece = _piece(unit, *still.stretches[0])
        if isinstance(piece, str):
            lacks.append(piece)
            continue
        rows_of, period_s = piece
        for values, measure, what in ((unit.gyro_radps, "rad/s", "gyro"), (unit.accel_mps2, "m/s²", "accel")):
            if values is None or not np.isfinite(values[rows_of]).all():
                continue
            for axis, letter in enumerate("xyz"):
                if np.ptp(values[rows_of, axis]) == 0.0:
                    continue
                curve = overlapping(values[rows_of, axis], period_s)
                if len(curve.tau_s):
                    rows.append((unit.name, f"{what} {letter}", measure, *_read(curve)))
                    curves[measure].append(Trace(f"{unit.name} {what} {letter}", curve.tau_s, curve.deviation))
        lacks += _decimation(unit, period_s, parameters)
    if rows:
        findings.append(_done(inertial, still, simulated, instants))
        grids.append(Grid("allan", f"Allan deviation at rest, {still.longest_s:.0f} s", _COLUMNS, tuple(rows)))
    plots = tuple(
        Plot(f"allan_{key}", f"Allan deviation of the {what} at rest", unit, tuple(traces), "loglog", "τ (s)")
        for unit, key, what in (("rad/s", "gyro", "gyroscopes"), ("m/s²", "accel", "accelerometers"))
        if (traces := curves[unit])
    )
    return Section(
        "sensors",
        "Sensors",
        findings=tuple(findings),
        grids=tuple(grids),
        plots=plots,
        lacks=tuple(dict.fromkeys(lacks)),
    )


_COLUMNS = (
    "unit", "axis", "in", "noise density /√Hz", "± %", "bias instability", "± %", "at τ s", "random walk √Hz", "± %",
)  # fmt: skip


def _read(curve: AllanCurve) -> tuple[Value, ...]:
    white, flat, walk = white_noise_density(curve), bias_instability(curve), random_walk(curve)
    bias: Value = None if flat is None else (f"≤ {flat.value:.3g}" if flat.bound else told(flat.value, 3))
    return (
        *_figure(white),
        bias,
        _percent(flat),
        None if flat is None else told(flat.from_tau_s, 3),
        *_figure(walk),
    )


def _figure(found: ReadOff | None) -> tuple[Value, Value]:
    return (None, None) if found is None else (told(found.value, 3), _percent(found))


def _percent(found: ReadOff | None) -> Value:
    return None if found is None else told(100.0 * found.relative_error, 2)


def _done(inertial: Sequence[Inertial], still: Rest, simulated: bool, instants: Instants) -> Finding:
    from_ns, until_ns = still.stretches[0]
    speed = "" if still.by_speed else "; no speed is logged, so that slow drifting would not have shown"
    model = "; the sensors are simulated: this is their model's noise" if simulated else ""
    return Finding(
        "sensors.at_rest",
        Severity.OK,
        f"At rest from {instants.text(from_ns)} for {still.longest_s:.0f} s: Allan deviations up to "
        f"τ = {still.longest_s / 9.0:.0f} s{speed}{model}",
        (Evidence(inertial[0].table.name, None, from_ns, until_ns),),
    )


def _piece(unit: Inertial, from_ns: int, until_ns: int) -> tuple[NDArray[np.intp], float] | str:
    """Rows of the longest part of the stretch without a long gap, and their period; or why there is none."""
    inside = np.flatnonzero((unit.stamp_ns >= from_ns) & (unit.stamp_ns < until_ns))
    samples = unit.sample_ns[inside]
    found = regularity(samples)
    if found is None:
        return f"{unit.name} has no samples in the longest stretch at rest."
    if found.rate_hz < _SLOWEST_HZ:
        return (
            f"No Allan deviation of {unit.name}: {found.rate_hz:.3g} Hz tell nothing of its noise; "
            f"take a log with {_SLOWEST_HZ:.0f} Hz or more."
        )
    steps = np.diff(samples)
    breaks = np.flatnonzero((steps > LONG_GAP_PERIODS * found.period_s * 1e9) | (steps <= 0))
    edges = np.concatenate(([0], breaks + 1, [len(inside)]))
    longest = int(np.argmax(np.diff(edges)))
    rows = inside[edges[longest] : edges[longest + 1]]
    span_s = float(unit.sample_ns[rows[-1]] - unit.sample_ns[rows[0]]) * 1e-9
    if span_s < SHORTEST_S:
        return f"No Allan deviation of {unit.name}: gaps leave {span_s:.0f} s of the longest stretch at rest."
    return rows, span_s / (len(rows) - 1)


def _decimation(unit: Inertial, period_s: float, parameters: Mapping[str, float]) -> list[str]:
    sampled_hz = max(unit.gyro_rate_hz or 0.0, unit.accel_rate_hz or 0.0)
    if sampled_hz <= _DECIMATED / period_s:
        return []
    filters = [
        f"{name} {parameters[name]:.0f} Hz" for name in ("INS_GYRO_FILTER", "INS_ACCEL_FILTER") if name in parameters
    ]
    filtered = f" after its filters ({', '.join(filters)})" if filters else ""
    return [
        f"{unit.name} is logged at {1.0 / period_s:.0f} Hz of the {sampled_hz:.0f} Hz it samples{filtered}: noise "
        "above half the logged rate is folded in or filtered out, so that the noise density is not that of the sensor; "
        "log every sample (INS_RAW_LOG_OPT) for that."
    ]


def _scatter(inertial: Sequence[Inertial], plain: Sequence[Plain], still: Rest) -> Grid:
    """Deviation of the differences of neighbours over √2: noise without drift, of each sensor in its own unit."""
    rows: list[tuple[Value, ...]] = []
    if sum(until - begin for begin, until in still.stretches) >= SHORTEST_SCATTER_S * 1e9:
        for unit in inertial:
            for values, measure, what in ((unit.gyro_radps, "rad/s", "gyro"), (unit.accel_mps2, "m/s²", "accel")):
                if values is not None:
                    rows.append((f"{unit.name} {what}", _neighbours(values, unit.stamp_ns, still), measure))
        rows += [
            (each.name, _neighbours(each.values, each.stamp_ns, still), each.unit)
            for each in plain
            if each.sort in ("magnetometer", "barometer")
        ]
    return Grid("scatter", "Noise at rest from sample to sample, one sigma", ("sensor", "noise", "unit"), tuple(rows))


def _neighbours(values: NDArray[np.float64], stamp_ns: NDArray[np.int64], still: Rest) -> float | None:
    inside = still.rows(stamp_ns)
    both = inside[1:] & inside[:-1]
    steps = np.diff(values, axis=0)[both]
    steps = steps[np.isfinite(steps).all(axis=1)]
    if len(steps) < 10:
        return None
    return told(float(np.sqrt(np.mean(steps**2) / 2.0)), 3)
