"""Agreement of sensors of one kind, and their noise at rest.

Agreement is judged by the limits of ArduPilot's checks before arming, noise by the Allan deviation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence, Finding, Grid, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.model.table import Floats, Stamps
from xitl_cli.logs.signals.allan import (
    AllanCurve,
    ReadOff,
    bias_instability,
    overlapping,
    random_walk,
    white_noise_density,
)
from xitl_cli.logs.signals.gaps import LONG_GAP_PERIODS, regularity
from xitl_cli.logs.signals.sensors import InertialUnit, RestPeriods, SensorSeries
from xitl_cli.logs.signals.series import significant

# AP_Arming: accelerometers 0.75 m/s^2 with half weight on the vertical, gyroscopes 5 deg/s, over ten seconds;
# AP_Compass: 60 deg and 200 mGauss in the plane of the vessel.
ACCEL_MPS2 = 0.75
GYRO_RADPS = np.radians(5.0)
MAG_ANGLE_DEG = 60.0
MAG_LENGTH_MGAUSS = 200.0
# ArduPilot's page on diagnosing with logs: a change of the field's length below 30 % is good, over 60 % is bad.
MAG_CHANGE_NOTICE, MAG_CHANGE_WARNING = 0.3, 0.6
BARO_APART_PA = 60.0  # 5 m
WINDOW_NS = 10_000_000_000
_MOST_WINDOWS = 100_000


def agreement_section(
    inertial: Sequence[InertialUnit], plain: Sequence[SensorSeries], two_worlds: bool, clock: LogClock
) -> Section:
    findings: list[Finding] = []
    rows: list[tuple[Value, ...]] = []
    for one, other in combinations(inertial, 2):
        if one.table.name != other.table.name and not _same_family(one.table.name, other.table.name):
            continue
        for what, a, b, fields, limit, unit, weights in (
            ("gyroscopes", one.gyro_radps, other.gyro_radps, one.gyro_fields, GYRO_RADPS, "rad/s", (1.0, 1.0, 1.0)),
            ("accelerometers", one.accel_mps2, other.accel_mps2, one.accel_fields, ACCEL_MPS2, "m/s²", (1.0, 1.0, 0.5)),
        ):
            if a is None or b is None:
                continue
            apart = _apart(one.stamp_ns, a, other.stamp_ns, b)
            if apart is None:
                continue
            at_ns, difference = apart
            length = np.linalg.norm(difference * np.array(weights), axis=1)
            rows.append(
                (
                    f"{one.name}, {other.name}",
                    what,
                    significant(float(np.median(length))),
                    significant(float(length.max())),
                    unit,
                )
            )
            if length.max() > limit:
                worst = int(np.argmax(length))
                findings.append(
                    Finding.warning(
                        "sensors.disagree",
                        f"The {what} of {one.name} and {other.name} differ by {length[worst]:.3g} {unit} over ten "
                        f"seconds from {clock.text(int(at_ns[worst]))}; ArduPilot allows {limit:.3g} {unit} "
                        "before arming",
                        (Evidence(one.table.name, fields[0], int(at_ns[worst]), int(at_ns[worst]) + WINDOW_NS),),
                        "Find the wrong one (with gravity, or at rest), and calibrate or disable it.",
                    )
                )
    compasses = [each for each in plain if each.sort == "magnetometer" and each.calibrated]
    for one_mag, other_mag in combinations(compasses, 2):
        findings += _compasses(one_mag, other_mag, rows, clock)
    lengths = [finding for each in compasses for finding in _field_length(each)]
    barometers = [each for each in plain if each.sort == "barometer"]
    for one_baro, other_baro in combinations(barometers, 2):
        findings += _barometers(one_baro, other_baro, rows, clock)
    columns = ("sensors", "of", "median difference", "largest in 10 s", "unit")
    grids = (Grid("sensor_agreement", "Agreement between instances, means of ten seconds", columns, tuple(rows)),)
    return Section(
        "sensors",
        "Sensors",
        findings=(*(_of_two_worlds(findings) if two_worlds else _merged(findings)), *lengths),
        grids=grids if rows else (),
    )


def _of_two_worlds(findings: list[Finding]) -> tuple[Finding, ...]:
    """One notice that replaces findings on disagreement: external sensors and those of ArduPilot's own simulation
    differ."""
    if not findings:
        return ()
    evidence = tuple(each for finding in findings for each in finding.evidence)
    return (
        Finding.notice(
            "sensors.two_worlds",
            "Instances of sensors differ by more than ArduPilot allows before arming: some are fed from outside, the "
            "others belong to its own simulated vehicle",
            evidence,
            "Switch the others off (INS_ENABLE_MASK, COMPASS_USE2 …), so that the estimator cannot use them.",
        ),
    )


def _merged(findings: list[Finding]) -> tuple[Finding, ...]:
    """One finding per kind, about the first pair: one bad unit among three differs from both others."""
    groups: dict[tuple[str, str | None], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.key, finding.evidence[0].field), []).append(finding)
    merged = []
    for first, *others in groups.values():
        evidence = tuple(each for finding in (first, *others) for each in finding.evidence)
        more = f" ({len(others)} more {'pair does' if len(others) == 1 else 'pairs do'} so, too)" if others else ""
        worst = max(finding.severity for finding in (first, *others))
        merged.append(replace(first, sentence=first.sentence + more, evidence=evidence, severity=worst))
    return tuple(merged)


def _same_family(one: str, other: str) -> bool:
    """Whether two names are of one autopilot on one link: RAW_IMU with SCALED_IMU2, IMU with IMU2."""
    link, _, kind = one.rpartition(":")
    other_link, _, other_kind = other.rpartition(":")
    telemetry = all(name.startswith(("RAW_IMU", "SCALED_IMU")) for name in (kind, other_kind))
    return link == other_link and (telemetry or kind.rstrip("0123456789") == other_kind.rstrip("0123456789"))


def _apart(one_ns: Stamps, one: Floats, other_ns: Stamps, other: Floats) -> tuple[Stamps, Floats] | None:
    """Beginning of each common window of ten seconds, and the difference of the means there (W, k); None without
    one."""
    first = _means(one_ns, one)
    second = _means(other_ns, other)
    if first is None or second is None:
        return None
    common, at, beside = np.intersect1d(first[0], second[0], return_indices=True)
    if not len(common):
        return None
    return common * WINDOW_NS, first[1][at] - second[1][beside]


def _means(stamp_ns: Stamps, values: Floats) -> tuple[Stamps, Floats] | None:
    """Numbers of the windows with ten samples or more, and their means."""
    good = np.isfinite(values).all(axis=1) & (np.abs(values) < 1e9).all(axis=1)
    if np.count_nonzero(good) < 10:
        return None
    number = stamp_ns[good] // WINDOW_NS
    windows, place, count = np.unique(number, return_inverse=True, return_counts=True)
    if len(windows) > _MOST_WINDOWS:
        return None
    sums = np.stack([np.bincount(place, column, len(windows)) for column in values[good].T], axis=1)
    enough = count >= 10
    return windows[enough], sums[enough] / count[enough, None]


def _compasses(
    one: SensorSeries, other: SensorSeries, rows: list[tuple[Value, ...]], clock: LogClock
) -> Iterator[Finding]:
    if one.unit != other.unit:
        return
    apart, mean = _apart(one.stamp_ns, one.values, other.stamp_ns, other.values), _means(one.stamp_ns, one.values)
    beside = _means(other.stamp_ns, other.values)
    if apart is None or mean is None or beside is None:
        return
    at_ns, difference = apart
    length = np.hypot(difference[:, 0], difference[:, 1])
    numbers = at_ns // WINDOW_NS
    a, b = mean[1][np.searchsorted(mean[0], numbers)], beside[1][np.searchsorted(beside[0], numbers)]
    turned = np.degrees(
        np.abs(np.mod((np.arctan2(a[:, 1], a[:, 0]) - np.arctan2(b[:, 1], b[:, 0])) + np.pi, 2.0 * np.pi) - np.pi)
    )
    rows.append(
        (
            f"{one.name}, {other.name}",
            "compasses",
            significant(float(np.median(length))),
            significant(float(length.max())),
            one.unit,
        )
    )
    rows.append(
        (
            f"{one.name}, {other.name}",
            "compasses",
            significant(float(np.median(turned))),
            significant(float(turned.max())),
            "deg",
        )
    )
    # The mean over a full turn is near zero and has no direction; the length of the difference remains valid.
    weak = np.minimum(np.hypot(a[:, 0], a[:, 1]), np.hypot(b[:, 0], b[:, 1])) < 0.2 * np.median(
        np.linalg.norm(a, axis=1)
    )
    bad = (length > MAG_LENGTH_MGAUSS) | ((turned > MAG_ANGLE_DEG) & ~weak)
    if not bad.any():
        return
    worst = int(np.argmax(np.where(bad, length, -1.0)))
    yield Finding.warning(
        "sensors.compasses_disagree",
        f"{one.name} and {other.name} differ by {length[worst]:.0f} {one.unit} and {turned[worst]:.0f}° in "
        f"the plane of the vessel from {clock.text(int(at_ns[worst]))}; ArduPilot allows "
        f"{MAG_LENGTH_MGAUSS:.0f} mGauss and {MAG_ANGLE_DEG:.0f}°",
        (Evidence(one.message, one.fields[0], int(at_ns[worst]), int(at_ns[worst]) + WINDOW_NS),),
        "Check the orientation parameters of both and calibrate them; move one away from currents and iron.",
    )


def _field_length(each: SensorSeries) -> Iterator[Finding]:
    """Change of the length of the measured field: iron and currents change it, turning does not."""
    length = np.linalg.norm(each.values, axis=1)
    length = length[np.isfinite(length)]
    if len(length) < 20:
        return
    low, middle, high = (float(part) for part in np.percentile(length, (2.0, 50.0, 98.0)))
    if middle <= 0.0 or (high - low) / middle < MAG_CHANGE_NOTICE:
        return
    change = (high - low) / middle
    yield Finding(
        "sensors.field_changes",
        Severity.WARNING if change > MAG_CHANGE_WARNING else Severity.NOTICE,
        f"The length of the field at {each.name} changes by {100.0 * change:.0f} %, "
        f"from {low:.3g} to {high:.3g} {each.unit}",
        (Evidence(each.message, each.fields[0], int(each.stamp_ns[0]), int(each.stamp_ns[-1])),),
        "Check whether it follows the throttle (currents) or the heading (offsets). Calibrate or move the compass.",
    )


def _barometers(
    one: SensorSeries, other: SensorSeries, rows: list[tuple[Value, ...]], clock: LogClock
) -> Iterator[Finding]:
    if one.unit != other.unit or one.unit != "Pa":
        return
    apart = _apart(one.stamp_ns, one.values, other.stamp_ns, other.values)
    if apart is None:
        return
    at_ns, difference = apart
    offset = float(np.median(difference))
    strayed = np.abs(difference[:, 0] - offset)
    largest = float(np.abs(difference).max())
    rows.append((f"{one.name}, {other.name}", "barometers", significant(abs(offset)), significant(largest), "Pa"))
    if strayed.max() <= BARO_APART_PA:
        return
    worst = int(np.argmax(strayed))
    yield Finding.notice(
        "sensors.barometers_drift",
        f"{one.name} and {other.name} move apart by {strayed[worst]:.0f} Pa, as much as "
        f"{strayed[worst] / 12.0:.1f} m of height, at {clock.text(int(at_ns[worst]))}",
        (Evidence(one.message, one.fields[0], int(at_ns[worst]), int(at_ns[worst]) + WINDOW_NS),),
        "Look for wind on an open case, and for sun or heat on one of them.",
    )


SHORTEST_S = 60.0
SHORTEST_SCATTER_S = 5.0
_SLOWEST_HZ = 10.0
_DECIMATED = 1.2
_MOST_UNITS = 6


def noise_section(
    inertial: Sequence[InertialUnit],
    plain: Sequence[SensorSeries],
    still: RestPeriods,
    parameters: Mapping[str, float],
    simulated: bool,
    clock: LogClock,
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
        findings.append(_done(inertial, still, simulated, clock))
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
    bias: Value = None if flat is None else (f"≤ {flat.value:.3g}" if flat.bound else significant(flat.value, 3))
    return (
        *_figure(white),
        bias,
        _percent(flat),
        None if flat is None else significant(flat.from_tau_s, 3),
        *_figure(walk),
    )


def _figure(found: ReadOff | None) -> tuple[Value, Value]:
    return (None, None) if found is None else (significant(found.value, 3), _percent(found))


def _percent(found: ReadOff | None) -> Value:
    return None if found is None else significant(100.0 * found.relative_error, 2)


def _done(inertial: Sequence[InertialUnit], still: RestPeriods, simulated: bool, clock: LogClock) -> Finding:
    from_ns, until_ns = still.stretches[0]
    speed = "" if still.by_speed else "; no speed is logged, so slow drifting would not be visible"
    model = "; the sensors are simulated: this is their model's noise" if simulated else ""
    return Finding.ok(
        "sensors.at_rest",
        f"At rest from {clock.text(from_ns)} for {still.longest_s:.0f} s: Allan deviations up to "
        f"τ = {still.longest_s / 9.0:.0f} s{speed}{model}",
        (Evidence(inertial[0].table.name, None, from_ns, until_ns),),
    )


def _piece(unit: InertialUnit, from_ns: int, until_ns: int) -> tuple[NDArray[np.intp], float] | str:
    """Rows of the longest part of the period without a long gap, and their time step; or the reason why there is
    none."""
    inside = np.flatnonzero((unit.stamp_ns >= from_ns) & (unit.stamp_ns < until_ns))
    samples = unit.sample_ns[inside]
    found = regularity(samples)
    if found is None:
        return f"{unit.name} has no samples in the longest stretch at rest."
    if found.rate_hz < _SLOWEST_HZ:
        return (
            f"No Allan deviation of {unit.name}: {found.rate_hz:.3g} Hz do not show its noise; "
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


def _decimation(unit: InertialUnit, period_s: float, parameters: Mapping[str, float]) -> Iterator[str]:
    sampled_hz = max(unit.gyro_rate_hz or 0.0, unit.accel_rate_hz or 0.0)
    if sampled_hz <= _DECIMATED / period_s:
        return
    filters = [
        f"{name} {parameters[name]:.0f} Hz" for name in ("INS_GYRO_FILTER", "INS_ACCEL_FILTER") if name in parameters
    ]
    filtered = f" after its filters ({', '.join(filters)})" if filters else ""
    yield (
        f"{unit.name} is logged at {1.0 / period_s:.0f} Hz of the {sampled_hz:.0f} Hz it samples{filtered}: noise "
        "above half the logged rate is folded in or filtered out, so the noise density is not that of the sensor; "
        "log every sample (INS_RAW_LOG_OPT) for that."
    )


def _scatter(inertial: Sequence[InertialUnit], plain: Sequence[SensorSeries], still: RestPeriods) -> Grid:
    """Standard deviation of the differences of neighbours over √2: noise without drift, for each sensor in its own
    unit."""
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


def _neighbours(values: Floats, stamp_ns: Stamps, still: RestPeriods) -> float | None:
    inside = still.rows(stamp_ns)
    both = inside[1:] & inside[:-1]
    steps = np.diff(values, axis=0)[both]
    steps = steps[np.isfinite(steps).all(axis=1)]
    if len(steps) < 10:
        return None
    return significant(float(np.sqrt(np.mean(steps**2) / 2.0)), 3)
