"""Clocks against each other: rate, how it varies, Allan deviation of the time error, gaps and steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xitl_cli.logs.analyses.instants import Instants, grid, number
from xitl_cli.logs.analyses.time_bases.clock_plots import plots
from xitl_cli.logs.analyses.time_bases.pair import key_of, rate_of, real_steps, title_of, variation_of
from xitl_cli.logs.log import Log
from xitl_cli.logs.running.loops import simulated
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Section, Severity, Value
from xitl_cli.logs.timeline.clock_fit import Relation
from xitl_cli.logs.timeline.steps import Step

CRYSTAL_PPM, WRONG_PPM = 100.0, 1000.0  # two crystals of 50 ppm, and what no crystal does
BEND_PPM = 10.0
LEAST_PIECE_S = 5.0  # on either side of a change of rate
ONE_TROUBLE_S = 5.0  # steps that follow each other so soon have one cause
STEP_WARNING_S = 0.1
SAME_STEP_S, SAME_SIZE = 2.0, 0.2
GAP_PERIODS, GAP_S = 10.0, 5.0
SCALED_PPM = 20_000.0  # no two clocks of the same time
SURE = 3.0  # standard errors
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
        plots(relations, instants),
    )


def _facts(relation: Relation) -> tuple[Fact, ...]:
    key, title = key_of(relation.readings), title_of(relation.readings)
    rate_ppm, error_ppm = rate_of(relation)
    steps = Fact(f"{key}_steps", f"Steps of {title}", len(real_steps(relation)))
    if error_ppm is None or SURE * error_ppm > WRONG_PPM:  # too short, or too uneven, to tell a rate
        return (steps,)
    return (
        Fact(f"{key}_ppm", f"Drift of {title}", number(rate_ppm, 2), "ppm"),
        Fact(f"{key}_error_ppm", f"Standard error of the drift of {title}", number(error_ppm, 2), "ppm"),
        steps,
    )


def _grid(relations: Sequence[Relation]) -> Grid:
    rows: list[tuple[Value, ...]] = []
    for relation in relations:
        readings = relation.readings
        rate_ppm, error_ppm = rate_of(relation)
        first_ns = readings.first_ns
        longest_ns = int(np.max(np.diff(first_ns)))
        rows.append(
            (
                title_of(readings),
                f"{readings.message}: {readings.fields}",
                len(readings),
                number(float(first_ns[-1] - first_ns[0]) * 1e-9, 1),
                number(rate_ppm, 2),
                number(error_ppm, 2),
                number(variation_of(relation), 2),
                number(relation.longest.residual_s * 1e3, 4),
                len(real_steps(relation)),
                number(longest_ns * 1e-9),
            )
        )
    columns = (
        "clocks", "from", "readings", "over (s)", "drift (ppm)", "standard error (ppm)", "windows vary by (ppm)",
        "readings scatter by (ms)", "steps", "longest gap (s)",
    )  # fmt: skip
    return grid("clock_pairs", "Clocks against each other", columns, rows)


def _steps(relations: Sequence[Relation], instants: Instants) -> list[Finding]:
    """One finding a step, with every pair that shows it; of steps close together one for all of them."""
    groups: list[list[tuple[Relation, Step]]] = []
    every = sorted(
        ((relation, step) for relation in relations for step in real_steps(relation)), key=lambda each: each[1].at_ns
    )
    for relation, step in every:
        for group in groups:
            _, known = group[0]
            near = abs(step.at_ns - known.at_ns) * 1e-9 < SAME_STEP_S + abs(known.size_s)
            alike = abs(abs(step.size_s) - abs(known.size_s)) < SAME_SIZE * abs(known.size_s)
            follows = relation is group[-1][0] and (step.at_ns - group[-1][1].at_ns) * 1e-9 < ONE_TROUBLE_S
            if (near and alike and relation not in [one for one, _ in group]) or follows:
                group.append((relation, step))
                break
        else:
            groups.append([(relation, step)])
    return [_step(group, instants) for group in groups]


def _step(group: list[tuple[Relation, Step]], instants: Instants) -> Finding:
    best = min((relation for relation, _ in group), key=lambda each: each.longest.residual_s)
    steps = [step for relation, step in group if relation is best]
    pair = f"{best.readings.second} stepped {{}} against {best.readings.first}"
    if len(steps) == 1:
        what = f"At {instants.text(steps[0].at_ns)} {pair.format(_way(steps[0].size_s))}"
    else:
        span = f"From {instants.text(steps[0].at_ns)} to {instants.text(steps[-1].at_ns)}"
        what = f"{span} {pair.format(f'{len(steps)} times, in all {_way(_whole_s(best, steps))}')}"
    largest_s = max(abs(step.size_s) for step in steps)
    return Finding(
        "time_bases.step",
        Severity.WARNING if largest_s >= STEP_WARNING_S else Severity.NOTICE,
        what,
        tuple(
            Evidence(each.readings.message, each.readings.fields, one.at_ns, value=f"{one.size_s:+.4f} s")
            for each, one in sorted(group, key=lambda each: each[0] is not best)[:MOST_NAMED]
        ),
        "Find what set or held up that clock then; intervals across this instant are not what they seem.",
    )


def _whole_s(relation: Relation, steps: Sequence[Step]) -> float:
    """From the line before the first of these steps to the line after the last."""
    before, after = (relation.pieces[relation.steps.index(one) + more] for one, more in ((steps[0], 0), (steps[-1], 1)))
    at_ns = np.array([steps[-1].first_ns], dtype=np.int64)
    return float(after.offset_at(at_ns)[0] - before.offset_at(at_ns)[0]) * 1e-9


def _way(size_s: float) -> str:
    size = f"{abs(size_s):.3f} s" if abs(size_s) >= 0.1 else f"{1e3 * abs(size_s):.1f} ms"
    return f"{size} {'ahead' if size_s > 0.0 else 'back'}"


def _rates(relation: Relation, made_up: bool) -> list[Finding]:
    readings = relation.readings
    if readings.key.startswith("samples.") and made_up:
        return []
    rate_ppm, error_ppm = rate_of(relation)
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
            f"{title_of(readings)} runs {abs(rate_ppm):.0f} ppm {'fast' if rate_ppm > 0.0 else 'slow'} "
            f"(± {error_ppm:.1f}), {per_hour_ms:.0f} ms an hour",
            (Evidence(readings.message, readings.fields, value=f"{rate_ppm:+.1f} ppm"),),
            "Crystals differ by tens of ppm at most: see whether one of the clocks is simulated, disciplined or held "
            "up; map stamps through this relation before comparing them.",
        )
    ]


def even(relations: Sequence[Relation]) -> tuple[Finding, ...]:
    """What may be said where nothing was found: of those pairs alone whose rate is known well enough to judge it."""
    judged = [relation for relation in relations if _known(relation)]
    if not judged:
        return ()
    pairs = title_of(judged[0].readings) if len(judged) == 1 else f"{len(judged)} pairs of clocks"
    said = f"No step and no drift of more than {CRYSTAL_PPM:.0f} ppm: {pairs}"
    return (Finding("time_bases.even", Severity.OK, said),)


def _known(relation: Relation) -> bool:
    """Whether the rate is known better than what it is held against."""
    error_ppm = relation.longest.slope_error_ppm
    return error_ppm is not None and SURE * error_ppm < CRYSTAL_PPM


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
            short_ns = min(before.until_ns - before.from_ns, after.until_ns - after.from_ns)
            if short_ns * 1e-9 < LEAST_PIECE_S or abs(change_ppm) < BEND_PPM:
                continue
            if before.slope_error_ppm is None or after.slope_error_ppm is None:
                continue
            error_ppm = float(np.hypot(before.slope_error_ppm, after.slope_error_ppm))
            if abs(change_ppm) < SURE * error_ppm:
                continue
            findings.append(
                Finding(
                    "time_bases.rate_change",
                    Severity.NOTICE,
                    f"About {instants.text(step.at_ns)} the rate of {title_of(relation.readings)} changed from "
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
