"""Clocks against each other: rate, how it varies, Allan deviation of the time error, gaps and steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs import allan
from xitl_cli.logs.analyses.instants import Instants, grid, number
from xitl_cli.logs.log import Log
from xitl_cli.logs.running.loops import simulated
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace, Value
from xitl_cli.logs.timeline.clock_fit import Relation
from xitl_cli.logs.timeline.readings import Readings
from xitl_cli.logs.timeline.steps import Step

CRYSTAL_PPM, WRONG_PPM = 100.0, 1000.0  # two crystals of 50 ppm, and what no crystal does
BEND_PPM = 10.0
STEP_WARNING_S = 0.1
SAME_STEP_S, SAME_SIZE = 2.0, 0.2
GAP_PERIODS, GAP_S = 10.0, 5.0
SCALED_PPM = 20_000.0  # no two clocks of the same time
SURE = 3.0  # standard errors
MOST_POINTS = 4000
MOST_NAMED = 5


def section(log: Log, relations: Sequence[Relation], instants: Instants) -> Section:
    made_up = bool(simulated(log))
    findings = [
        *_steps(relations, instants),
        *(finding for relation in relations for finding in _rates(relation, made_up)),
        *_bends(relations, instants),
        *(finding for relation in relations for finding in _gaps(relation, instants)),
    ]
    facts = tuple(fact for relation in relations for fact in _facts(relation))
    return Section(
        "time_bases",
        "Clocks against each other",
        facts,
        tuple(findings),
        (_grid(relations),) if relations else (),
        _plots(relations, instants),
    )


def _title(readings: Readings) -> str:
    return f"{readings.second} against {readings.first}"


def _key(readings: Readings) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in readings.key).strip("_").lower()


def _rate_ppm(relation: Relation) -> tuple[float, float | None]:
    """Over all pieces, each weighed by its length; the standard error of the longest."""
    spans = np.array([max(piece.until_ns - piece.from_ns, 1) for piece in relation.pieces], dtype=np.float64)
    rates = np.array([piece.slope_ppm for piece in relation.pieces])
    return float(np.sum(rates * spans) / np.sum(spans)), relation.longest.slope_error_ppm


def _variation_ppm(relation: Relation) -> float | None:
    return float(np.std(relation.window_ppm, ddof=1)) if len(relation.window_ppm) > 1 else None


def _real_steps(relation: Relation) -> list[Step]:
    return [step for step in relation.steps if step.size_s != 0.0]


def _facts(relation: Relation) -> tuple[Fact, ...]:
    key, title = _key(relation.readings), _title(relation.readings)
    rate_ppm, error_ppm = _rate_ppm(relation)
    facts = [
        Fact(f"{key}_ppm", f"Drift of {title}", number(rate_ppm, 2), "ppm"),
        Fact(f"{key}_error_ppm", "standard error", None if error_ppm is None else number(error_ppm, 2), "ppm"),
        Fact(f"{key}_steps", "steps", len(_real_steps(relation))),
    ]
    return tuple(fact for fact in facts if fact.value is not None)


def _grid(relations: Sequence[Relation]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for relation in relations:
        readings = relation.readings
        rate_ppm, error_ppm = _rate_ppm(relation)
        first_ns = readings.first_ns
        longest_ns = int(np.max(np.diff(first_ns)))
        rows.append(
            (
                _title(readings),
                f"{readings.message}: {readings.fields}",
                len(readings),
                number(float(first_ns[-1] - first_ns[0]) * 1e-9, 1),
                number(rate_ppm, 2),
                number(error_ppm, 2),
                number(_variation_ppm(relation), 2),
                number(relation.longest.residual_s * 1e3, 4),
                len(_real_steps(relation)),
                number(longest_ns * 1e-9),
            )
        )
    columns = (
        "clocks", "from", "readings", "over (s)", "drift (ppm)", "standard error (ppm)", "windows vary by (ppm)",
        "readings scatter by (ms)", "steps", "longest gap (s)",
    )  # fmt: skip
    return grid("clock_pairs", "Clocks against each other", columns, rows)


def _steps(relations: Sequence[Relation], instants: Instants) -> list[Finding]:
    """One finding a step, with every pair that shows it."""
    groups: list[list[tuple[Relation, Step]]] = []
    every = sorted(
        ((relation, step) for relation in relations for step in _real_steps(relation)), key=lambda each: each[1].at_ns
    )
    for relation, step in every:
        for group in groups:
            _, known = group[0]
            near = abs(step.at_ns - known.at_ns) * 1e-9 < SAME_STEP_S + abs(known.size_s)
            alike = abs(abs(step.size_s) - abs(known.size_s)) < SAME_SIZE * abs(known.size_s)
            if near and alike:
                group.append((relation, step))
                break
        else:
            groups.append([(relation, step)])
    return [_step(group, instants) for group in groups]


def _step(group: list[tuple[Relation, Step]], instants: Instants) -> Finding:
    group = sorted(group, key=lambda each: each[0].longest.residual_s)
    relation, step = group[0]
    size = f"{abs(step.size_s):.3f} s" if abs(step.size_s) >= 0.1 else f"{1e3 * abs(step.size_s):.1f} ms"
    way = "ahead" if step.size_s > 0.0 else "back"
    severity = Severity.WARNING if abs(step.size_s) >= STEP_WARNING_S else Severity.NOTICE
    return Finding(
        "time_bases.step",
        severity,
        f"At {instants.text(step.at_ns)} {relation.readings.second} stepped {size} {way} against "
        f"{relation.readings.first}",
        tuple(
            Evidence(each.readings.message, each.readings.fields, one.at_ns, value=f"{one.size_s:+.4f} s")
            for each, one in group[:MOST_NAMED]
        ),
        "Find what set or held up that clock then; intervals across this instant are not what they seem.",
    )


def _rates(relation: Relation, made_up: bool) -> list[Finding]:
    readings = relation.readings
    if readings.key.startswith("samples.") and made_up:
        return []
    rate_ppm, error_ppm = _rate_ppm(relation)
    sure = error_ppm is not None and abs(rate_ppm) - CRYSTAL_PPM > SURE * error_ppm
    if not sure or abs(rate_ppm) <= CRYSTAL_PPM:
        return []
    if abs(rate_ppm) > SCALED_PPM:
        return [_scaled(relation)]
    severity = Severity.NOTICE if made_up or abs(rate_ppm) < WRONG_PPM else Severity.WARNING
    per_hour_ms = abs(rate_ppm) * 3.6
    return [
        Finding(
            "time_bases.drift",
            severity,
            f"{_title(readings)} runs {abs(rate_ppm):.0f} ppm {'fast' if rate_ppm > 0.0 else 'slow'} "
            f"(± {error_ppm:.1f}), {per_hour_ms:.0f} ms an hour",
            (Evidence(readings.message, readings.fields, value=f"{rate_ppm:+.1f} ppm"),),
            "Crystals differ by tens of ppm at most: see whether one of the clocks is simulated, disciplined or held "
            "up; map stamps through this relation before comparing them.",
        )
    ]


def _scaled(relation: Relation) -> Finding:
    readings = relation.readings
    times = 1.0 + relation.longest.slope_ppm * 1e-6
    fast, slow, ratio = (
        (readings.second, readings.first, times) if times >= 1.0 else (readings.first, readings.second, 1.0 / times)
    )
    return Finding(
        "time_bases.scaled",
        Severity.NOTICE,
        f"{fast} went {ratio:.2f} times as fast as {slow}: one of them is a simulation's",
        (Evidence(readings.message, readings.fields, value=f"{ratio:.2f}"),),
        "Rates and delays in this log are in two kinds of seconds: compare along one clock.",
    )


def _bends(relations: Sequence[Relation], instants: Instants) -> list[Finding]:
    findings = []
    for relation in relations:
        for index, step in enumerate(relation.steps):
            before, after = relation.pieces[index], relation.pieces[index + 1]
            change_ppm = after.slope_ppm - before.slope_ppm
            if before.slope_error_ppm is None or after.slope_error_ppm is None or abs(change_ppm) < BEND_PPM:
                continue
            error_ppm = float(np.hypot(before.slope_error_ppm, after.slope_error_ppm))
            if abs(change_ppm) < SURE * error_ppm:
                continue
            findings.append(
                Finding(
                    "time_bases.rate_change",
                    Severity.NOTICE,
                    f"About {instants.text(step.at_ns)} the rate of {_title(relation.readings)} changed from "
                    f"{before.slope_ppm:+.1f} to {after.slope_ppm:+.1f} ppm (± {error_ppm:.1f})",
                    (Evidence(relation.readings.message, relation.readings.fields, step.at_ns),),
                    "Temperature changes a crystal by single ppm only: look for what disciplines that clock.",
                )
            )
    return findings


def _gaps(relation: Relation, instants: Instants) -> list[Finding]:
    """Only of clocks that are read for the sake of it: other readings come as their messages do."""
    readings = relation.readings
    if not readings.key.startswith(("clocks.", "timesync.")):
        return []
    between_s = np.diff(readings.first_ns).astype(np.float64) * 1e-9
    usual_s = float(np.median(between_s))
    long = np.flatnonzero(between_s > max(GAP_PERIODS * usual_s, GAP_S if usual_s > 0.5 else 1.0))
    if not len(long):
        return []
    worst = int(long[np.argmax(between_s[long])])
    at_ns = int(readings.at_ns[worst])
    return [
        Finding(
            "time_bases.gap",
            Severity.NOTICE,
            f"{readings.second} was not read for {between_s[worst]:.1f} s after {instants.text(at_ns)}, else every "
            f"{usual_s:.2f} s; {len(long)} such gaps",
            (Evidence(readings.message, readings.fields, at_ns, int(readings.at_ns[worst + 1])),),
            "Look at the links at that time: no exchange came through.",
        )
    ]


def _plots(relations: Sequence[Relation], instants: Instants) -> tuple[Plot, ...]:
    plots: list[Plot] = []
    curves: list[Trace] = []
    for relation in relations:
        readings = relation.readings
        if not relation.residual_s.any():
            continue
        thin = slice(None, None, max(len(readings) // MOST_POINTS, 1))
        marks = tuple(
            Mark(step.at_ns, f"step {step.size_s:+.3f} s" if step.size_s else "rate changes") for step in relation.steps
        )
        plots.append(
            Plot(
                f"residual_{_key(readings)}",
                f"{_title(readings)}: what is left of the offset",
                "ms",
                (Trace("residual", readings.at_ns[thin], relation.residual_s[thin] * 1e3, "points"),),
                marks=marks,
            )
        )
        if len(relation.window_ppm) > 1:
            rows = np.clip(np.searchsorted(readings.first_ns, relation.window_ns), 0, len(readings) - 1)
            plots.append(
                Plot(
                    f"rate_{_key(readings)}",
                    f"{_title(readings)}: drift in windows of {relation.window_s:.0f} s",
                    "ppm",
                    (Trace("drift", readings.at_ns[rows], relation.window_ppm, "points"),),
                    marks=marks,
                )
            )
        curve = allan_of(relation)
        if curve is not None:
            curves.append(Trace(_title(readings), curve.tau_s, curve.deviation))
    if curves:
        plots.append(
            Plot(
                "clock_allan",
                "Allan deviation of the clocks",
                "ADEV (1)",
                tuple(curves),
                "loglog",
                "averaging time (s)",
            )
        )
    return tuple(plots)


def allan_of(relation: Relation) -> allan.AllanCurve | None:
    """Of the time error, its drift taken out, by the longest piece; None where that is too short or too uneven.

    A deviation of the mean rate over tau: that of the differences of the time error, each over one period.
    """
    piece = relation.longest
    readings = relation.readings
    inside = (readings.first_ns >= piece.from_ns) & (readings.first_ns <= piece.until_ns)
    time_s = (readings.first_ns[inside] - piece.from_ns).astype(np.float64) * 1e-9
    error_s = relation.residual_s[inside]
    if len(time_s) < 40 or not error_s.any():
        return None
    period_s = float(np.median(np.diff(time_s)))
    if not period_s > 0.0:
        return None
    even_s: NDArray[np.float64] = np.arange(0.0, time_s[-1], max(period_s, time_s[-1] / 200_000))
    if len(even_s) > 2 * len(time_s):
        return None
    even = np.interp(even_s, time_s, error_s)
    step_s = float(even_s[1] - even_s[0])
    curve = allan.overlapping(np.diff(even) / step_s, step_s)
    known = curve.deviation > 0.0
    if not known.any():
        return None
    return allan.AllanCurve(curve.tau_s[known], curve.deviation[known], curve.relative_error[known])
