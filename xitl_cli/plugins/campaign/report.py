"""Results of a campaign as sections: the same for the terminal, for --json and for its page."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.keys import unit_of
from xitl_cli.logs.model.sections import Fact, Finding, Grid, Plot, Section, Value
from xitl_cli.logs.model.text import plural
from xitl_cli.plugins.campaign import pictures
from xitl_cli.plugins.campaign.axes import short, value_text
from xitl_cli.plugins.campaign.bisection import BoundaryFinding, Outcome
from xitl_cli.plugins.campaign.compare import CampaignComparison, counted_statuses, seed_of
from xitl_cli.plugins.campaign.execution import RAN
from xitl_cli.plugins.campaign.exploration import ExplorationFinding
from xitl_cli.plugins.campaign.results import ResultTable, is_number
from xitl_cli.plugins.campaign.search import SearchFinding, evaluate, verdict
from xitl_cli.plugins.campaign.search_spec import Search, SensitivitySpec
from xitl_cli.plugins.campaign.sensitivity import Sensitivity, elasticities, sensitivities
from xitl_cli.plugins.campaign.statistics import (
    Interval,
    LogisticSurface,
    clustered_rate_interval,
    monotone_rates,
    spread,
    wilson_interval,
)

Row = Mapping[str, Any]
REPORT = "report.html"
_LIMIT = re.compile(r"\s*([\w-]+(?:\.[\w-]+)+)\s*(<=|>=|<|>)\s*(-?[\d.]+(?:[eE][-+]?\d+)?)\s*")
_MOST_GROUPS = 12
_MOST_PICTURED = 4
_WORST = 10
_INSPECT_A_PAIR = "Compare the two runs of one seed with `xitl logs compare`."
_LIMIT_REACHED = "The interval is wider than search.width, because the search reached its limit of runs"
_SEE_ERRORS = "See the errors of the runs in results.jsonl."
_BOTH_SIDES = "Inspect a run on each side of the boundary: results.jsonl has the command of every run."


@dataclass(frozen=True, slots=True)
class Limit:
    """Limit of a verdict such as `mission.cross_track_rms_m < 2`."""

    figure: str
    value: float
    upper: bool
    """True if the figure has to stay below the limit."""


def limits(verdicts: Iterable[str]) -> list[Limit]:
    """Return the limits of verdicts that compare one figure with one number."""
    matches = (_LIMIT.fullmatch(text) for text in verdicts)
    return [Limit(match[1], float(match[3]), match[2].startswith("<")) for match in matches if match is not None]


def campaign_sections(table: ResultTable) -> list[Section]:
    """Return all sections for the existing runs."""
    sections = [runs_section(table)]
    if (document := table.about.get("search")) is not None:
        search = Search.read(document)
        sections.append(boundary_section(search, evaluate(search, table.rows)))
    if (document := table.about.get("sensitivity")) is not None:
        sections.append(sensitivity_section(table, SensitivitySpec(**document["spec"]), document["places"]))
    elif table.about["plan"].get("combine") == "one_at_a_time":
        sections.append(elasticity_section(table))
    if len(_numeric_axes(table)) > 1:
        sections.append(map_section(table))
    sections += [figures_section(table), worst_section(table)]
    return [section for section in sections if section.facts or section.findings or section.grids or section.plots]


def summary_sections(table: ResultTable) -> list[Section]:
    """Return the sections for the terminal, without those printed elsewhere."""
    return [section for section in campaign_sections(table) if section.key not in ("runs", "map", "worst")]


def write_report(table: ResultTable) -> Path:
    """Write report.html in the campaign's folder: one page that needs no network. Raises LogError."""
    from xitl_cli.logs.report.html import write_sections

    path = table.folder / REPORT
    name = str(table.about.get("name", table.folder.name))
    write_sections(path, f"Campaign {name}", subtitle(table), campaign_sections(table))
    return path


def subtitle(table: ResultTable) -> str:
    """Return a description of the campaign in a line."""
    axes = f", {plural(len(table.axes), 'axis', 'axes')}: {', '.join(table.axes)}" if table.axes else ""
    return f"{plural(len(table), 'run')} of {table.about['base']}{axes}"


def runs_section(table: ResultTable) -> Section:
    """Return the number of passed runs, and the statuses of the others."""
    rows = table.rows
    facts = [Fact("runs", "runs", len(rows))]
    statuses = Counter(str(row.get("status")) for row in rows)
    facts += [Fact(f"status.{name}", name, count) for name, count in statuses.most_common()]
    judged = [row for row in rows if verdict(row) is not None]
    if judged:
        facts.append(Fact("passed", "passed", rate_text(judged, "passed")))
    grids = []
    if len(table.verdicts) > 1:
        counted = []
        for text in table.verdicts:
            known = [row for row in rows if row.get(text) is not None]
            counted.append((text, len(known), sum(bool(row[text]) for row in known), rate_text(known, text)))
        grids.append(Grid("verdicts", "Verdicts", ("verdict", "runs", "passed", "rate"), tuple(counted)))
    findings = []
    broken = {name: count for name, count in statuses.items() if name not in RAN}
    if broken:
        by_status = ", ".join(f"{count} {name}" for name, count in broken.items())
        findings.append(
            Finding.warning(
                "runs.broken",
                f"{sum(broken.values())} of {plural(len(rows), 'run')} did not run to their end ({by_status})",
                (),
                "See their errors in the table of the worst runs, and repeat one with its command.",
            )
        )
    return Section("runs", "Runs", tuple(facts), tuple(findings), tuple(grids))


def figures_section(table: ResultTable) -> Section:
    """Return median, 95th percentile and worst of each figure. If the combinations of axes are few, list them
    separately.
    """
    groups: dict[str, list[Row]] = {}
    for row in table.rows:
        groups.setdefault(_group_text({axis: row.get(axis) for axis in table.axes}), []).append(row)
    if len(groups) > _MOST_GROUPS:
        groups = {"": list(table.rows)}
    verdict_limits, statuses = limits(table.verdicts), counted_statuses(table.verdicts)
    by_figure: dict[str, list[tuple[Value, ...]]] = {}
    for figure in table.figures:
        upper = next((limit.upper for limit in verdict_limits if limit.figure == figure), True)
        for name, members in groups.items():
            known = [row for row in members if row.get("status") in statuses and is_number(row.get(figure))]
            if not known:
                continue
            of = spread(np.array([float(row[figure]) for row in known]))
            worst = (max if upper else min)(known, key=lambda row, figure=figure: row[figure])  # type: ignore[misc]
            cells = (of.median, of.p95 if upper else of.p5, worst[figure])
            line = (name if len(groups) > 1 else figure, of.runs, *map(short, cells), worst["seed"])
            by_figure.setdefault(figure, []).append(line)
    columns = ("runs", "median", "95 %", "worst", "worst seed")
    if len(groups) > 1:
        heads = ("", *columns)
        named = ((figure, pictures.titled(figure), tuple(rows)) for figure, rows in by_figure.items())
        grids = tuple(Grid(f"figures.{figure}", title, heads, rows) for figure, title, rows in named)
    else:
        whole = tuple(row for rows in by_figure.values() for row in rows)
        grids = (Grid("figures", "All runs", ("figure", *columns), whole),) if whole else ()
    title = "Figures (95 % and worst are on the bad side of each figure)"
    counted = [row for row in table.rows if row.get("status") in statuses]
    return Section("figures", title, (), (), grids, tuple(_figure_plots(table, counted, verdict_limits)))


def _figure_plots(table: ResultTable, counted: Sequence[Row], verdict_limits: Sequence[Limit]) -> Iterable[Plot]:
    varying = [figure for figure in table.figures if _spread_out([row.get(figure) for row in counted])]
    limited = [limit.figure for limit in verdict_limits if limit.figure in varying]
    for figure in list(dict.fromkeys([*limited, *varying]))[:_MOST_PICTURED]:
        at = [limit.value for limit in verdict_limits if limit.figure == figure]
        for axis in table.axes:
            by_value: dict[str, list[float]] = {}
            for row in counted:
                if is_number(row.get(figure)):
                    by_value.setdefault(value_text(row.get(axis)), []).append(float(row[figure]))
            if 2 <= len(by_value) <= _MOST_GROUPS:
                yield pictures.boxes(figure, axis, by_value, at)
        values = [float(row[figure]) for row in counted if is_number(row.get(figure))]
        yield pictures.histogram(figure, values, at)


def boundary_section(search: Search, findings: Sequence[SearchFinding]) -> Section:
    """Return the boundary of failure with its confidence, or the reason for an unknown boundary."""
    sentences, grids, plots = [], [], []
    for number, of_group in enumerate(findings):
        where = f" at {_group_text(of_group.group)}" if of_group.group else ""
        key, result = f"boundary.{number}", of_group.found
        if result is None:
            unfinished = f"The search{where} is not complete"
            sentences.append(Finding.notice(key, unfinished, (), "Continue with --resume and --report."))
        elif isinstance(result, BoundaryFinding):
            axis = search.ranges[0]
            sentences.append(boundary_sentence(search, result, axis.key, where, key))
            rows = []
            for at, runs, passed in _rows(result):
                interval = wilson_interval(passed, runs, search.spec.confidence)
                rows.append((short(at), runs, passed, round(passed / runs, 3), _interval_text(interval, "")))
            unit = unit_of(search.ranges[0].key)
            columns = (f"value ({unit})" if unit else "value", "runs", "passed", "rate", "interval (Wilson)")
            grids.append(Grid(key, f"Pass rate along {axis.key}{where}", columns, tuple(rows)))
            plots.append(pictures.boundary(key, search, result, monotone_rates(result.counts, result.rising), where))
        else:
            sentences.append(exploration_sentence(search, result, where, key))
            failing = [
                point for point in result.points if point.runs and point.passed / point.runs < search.spec.pass_rate
            ]
            home = result.points[0].place
            nearest = sorted(failing, key=lambda point: math.dist(point.place, home))[:_WORST]
            nearest_rows = tuple(
                (
                    *(short(axis.value(share)) for axis, share in zip(search.ranges, point.place, strict=True)),
                    round(math.dist(point.place, home), 3),
                    point.runs,
                    point.passed,
                )
                for point in nearest
            )
            heads = (*(axis.key for axis in search.ranges), "distance", "runs", "passed")
            grids.append(Grid(key, f"Failing points nearest to nominal{where}", heads, nearest_rows))
    if len(search.ranges) == 1 and len(findings) > 1:
        plots.insert(0, pictures.boundaries(search, findings, [_group_text(group.group) for group in findings]))
    return Section("boundary", "Boundary of failure", (), tuple(sentences), tuple(grids), tuple(plots))


def boundary_sentence(search: Search, found: BoundaryFinding, axis: str, where: str, key: str) -> Finding:
    """Return one sentence, with a severity above OK if there is no boundary."""
    unit = f" {unit_of(axis)}".rstrip()
    low, high = search.ranges[0].low, search.ranges[0].high
    confidence = f"{100 * search.spec.confidence:g} %"
    rate = f"{100 * search.spec.pass_rate:g} %"
    below, above = ("fail", "pass") if found.rising else ("pass", "fail")
    runs = plural(int(found.counts.runs.sum()), "run")
    silent = f"; {plural(found.silent, 'run')} had no verdict and do not count" if found.silent else ""
    rates = ", ".join(f"{p} of {n} at {short(x)}" for x, n, p in _rows(found))
    if found.outcome == Outcome.WITHOUT_VERDICT or found.estimate is None:
        return Finding.critical(
            key, f"No run along {axis}{where} has a verdict: the boundary is unknown", (), _SEE_ERRORS
        )
    if found.outcome == Outcome.NOT_MONOTONE:
        return Finding.warning(
            key,
            f"The pass rate is not monotone along {axis}{where} (p = {found.monotony_p_value:.2g}): {rates}{silent}",
            (),
            "The axis has several boundaries: run a grid over it (count or step), or search parts of it.",
        )
    if found.outcome in (Outcome.PASSES, Outcome.FAILS):
        word = "pass" if found.outcome == Outcome.PASSES else "fail"
        than = "more" if found.outcome == Outcome.PASSES else "less"
        return Finding.warning(
            key,
            f"Runs {word} along all of {axis} from {low:g} to {high:g}{unit}{where}: {than} than {rate} pass at every "
            f"point, with {confidence} confidence ({rates}){silent}",
            (),
            "Widen the range of the axis, or set another limit.",
        )
    within = _confidence_text(search, found.estimate.interval, unit)
    crosses = "Half of the runs fail" if search.spec.pass_rate == 0.5 else f"The pass rate crosses {rate}"
    place = f"{axis} = {short(found.estimate.value)}{unit}{where}"
    sentence = f"{crosses} at {place} ({within}, {runs}): they {below} below and {above} above"
    if found.outcome == Outcome.UNDECIDED:
        return Finding.notice(
            key,
            f"{sentence}{silent}. {_LIMIT_REACHED}",
            (),
            "Increase search.most_runs and search.runs_per_point, or increase search.width.",
        )
    return Finding.notice(key, sentence + silent, (), _BOTH_SIDES)


def exploration_sentence(search: Search, found: ExplorationFinding, where: str, key: str) -> Finding:
    """Return the nearest failing point to nominal, or the reason why there is none."""
    home = found.points[0]
    at_home = _place_text(search, home.place)
    runs = plural(sum(point.runs for point in found.points), "run")
    if found.outcome == Outcome.WITHOUT_VERDICT:
        return Finding.critical(key, f"No run at the nominal point{where} ({at_home}) has a verdict", (), _SEE_ERRORS)
    if found.outcome == Outcome.FAILS:
        return Finding.warning(
            key,
            f"The nominal point fails{where}: {home.passed} of {home.runs} pass at {at_home}",
            (),
            "Set search.nominal to a point that passes, or set another limit.",
        )
    if found.nearest is None or found.along is None or found.along.estimate is None:
        reason = "none failed" if found.outcome == Outcome.PASSES else "no failed point failed again when repeated"
        return Finding.warning(
            key,
            f"The search found no failing point{where} in {len(found.points)} points and {runs}: {reason}",
            (),
            "Widen the ranges, or increase search.points.",
        )
    place = _place_text(search, found.nearest)
    estimate = found.along.estimate
    sentence = (
        f"The boundary of failure nearest to the nominal point ({at_home}) is{where} at {place}, at a distance of "
        f"{short(estimate.value)} of the ranges ({_confidence_text(search, estimate.interval, '')}, {runs})"
    )
    if found.outcome == Outcome.UNDECIDED:
        return Finding.notice(key, f"{sentence}. {_LIMIT_REACHED}", (), "Increase search.most_runs.")
    return Finding.notice(key, sentence, (), _BOTH_SIDES)


def _confidence_text(search: Search, interval: Interval, unit: str) -> str:
    return f"{100 * search.spec.confidence:g} % interval {_interval_text(interval, unit)}"


def _place_text(search: Search, shares: Sequence[float]) -> str:
    axes = zip(search.ranges, shares, strict=True)
    return ", ".join(f"{axis.key} = {short(axis.value(share))} {unit_of(axis.key)}".rstrip() for axis, share in axes)


def sensitivity_section(table: ResultTable, spec: SensitivitySpec, places: Sequence[int]) -> Section:
    """Return the axes by importance, for each figure."""
    figures = spec.figures or tuple(figure for figure in table.figures if _spread_out(table.column(figure)))
    seed = int(table.about["plan"].get("seed", 1))
    of_figures = sensitivities(spec, table.axes, figures, table.rows, places, len(table.about["seeds"]), seed)
    known = [sensitivity for sensitivity in of_figures if sensitivity.effects]
    return Section(
        "sensitivity",
        "Sensitivity to the axes",
        findings=tuple(_strongest(sensitivity, spec) for sensitivity in known),
        grids=tuple(_effects_grid(sensitivity) for sensitivity in known),
        plots=tuple(pictures.effects(sensitivity) for sensitivity in known),
        lacks=tuple(f"{result.figure}: no sensitivity, because {result.why}." for result in of_figures if result.why),
    )


def _strongest(sensitivity: Sensitivity, spec: SensitivitySpec) -> Finding:
    figure, dropped, (first, *others) = sensitivity.figure, sensitivity.dropped, sensitivity.effects
    share = f"total index {short(first.total)}" if sensitivity.method == "sobol" else f"mu* = {short(first.total)}"
    interval = f"{100 * spec.confidence:g} % interval {_interval_text(first.total_interval, '')}"
    close = [effect.axis for effect in others if effect.total_interval.high >= first.total_interval.low]
    overlap = f"; not distinguishable from it: {', '.join(close)}" if close else ""
    left_out = f"; {plural(dropped, 'group')} of runs without the figure left out" if dropped else ""
    return Finding.notice(
        f"sensitivity.{figure}",
        f"{figure}: {first.axis} has the largest effect ({share}, {interval}){overlap}{left_out}",
        (),
        "Use more samples to distinguish axes with overlapping intervals." if close else "Search along it: `search:`.",
    )


def _effects_grid(sensitivity: Sensitivity) -> Grid:
    sobol = sensitivity.method == "sobol"
    names = ("total", "interval", "first order", "interval") if sobol else ("mu*", "interval", "mu", "sigma")
    rows = tuple(
        (
            effect.axis,
            short(effect.total),
            _interval_text(effect.total_interval, ""),
            short(effect.main),
            short(effect.interaction or 0.0)
            if effect.main_interval is None
            else _interval_text(effect.main_interval, ""),
        )
        for effect in sensitivity.effects
    )
    title = f"{sensitivity.figure} ({sensitivity.used} groups of runs)"
    return Grid(f"sensitivity.{sensitivity.figure}", title, ("axis", *names), rows)


def elasticity_section(table: ResultTable) -> Section:
    """Return, for a one-at-a-time plan, the change of a figure in per cent for one per cent of an axis."""
    base = table.about.get("base_values", {})
    nominal = {axis: float(base[axis]) for axis in table.axes if is_number(base.get(axis))}
    grids = []
    for figure in table.figures:
        rows: list[tuple[Value, ...]] = []
        for result in elasticities(nominal, _series(table, figure, nominal), 0.95):
            elasticity = "" if result.elasticity is None else short(result.elasticity)
            interval = _interval_text(result.interval, "") if result.interval else ""
            rows.append((result.axis, elasticity, short(result.slope), interval, result.seeds))
        if rows:
            columns = ("axis", "elasticity", "slope", "95 % interval", "seeds")
            grids.append(Grid(f"elasticity.{figure}", figure, columns, tuple(rows)))
    left_out = [axis for axis in table.axes if axis not in nominal]
    lacks = (f"{', '.join(left_out)}: no elasticity, because the base has no number there.",) if left_out else ()
    return Section("elasticity", "Elasticities at the base", (), (), tuple(grids), (), lacks)


def _series(
    table: ResultTable, figure: str, nominal: Mapping[str, float]
) -> dict[str, dict[int, list[tuple[float, float]]]]:
    """Return the values and the figure for each axis and seed. The run of the base belongs to every axis."""
    series: dict[str, dict[int, list[tuple[float, float]]]] = {axis: {} for axis in nominal}
    for row in table.rows:
        if row.get("status") not in RAN or not is_number(row.get(figure)):
            continue
        varied = [
            axis for axis in table.axes if row.get(axis) is not None and row[axis] != table.about["base_values"][axis]
        ]
        for axis in nominal if not varied else [axis for axis in varied if axis in nominal]:
            value = nominal[axis] if not varied else row[axis]
            if is_number(value):
                series[axis].setdefault(row["seed"], []).append((float(value), float(row[figure])))
    return series


def map_section(table: ResultTable) -> Section:
    """Return passed and failed runs over the first two numeric axes."""
    across, up = _numeric_axes(table)[:2]
    judged = [row for row in table.rows if verdict(row) is not None]
    judged = [row for row in judged if is_number(row.get(across)) and is_number(row.get(up))]
    if not judged:
        return Section("map", "Pass and fail")
    x, y = (np.array([float(row[axis]) for row in judged]) for axis in (across, up))
    passed = [bool(row["passed"]) for row in judged]
    surface = None
    if len({*passed}) == 2 and float(np.ptp(x)) > 0 and float(np.ptp(y)) > 0:
        shares = np.column_stack([(x - x.min()) / np.ptp(x), (y - y.min()) / np.ptp(y)])
        surface = LogisticSurface.fitted(shares, passed)
    others = [axis for axis in table.axes if axis not in (across, up)]
    others_text = f", for all values of {', '.join(others)}" if others else ""
    rate = float(table.about["search"]["spec"]["pass_rate"]) if table.about.get("search") else 0.5
    plot = pictures.pass_map(across, up, x, y, passed, surface, rate, others_text)
    return Section("map", "Pass and fail", plots=(plot,))


def worst_section(table: ResultTable) -> Section:
    """Return the runs to inspect first, each with the command that repeats it."""
    limit = next(iter(limits(table.verdicts)), None)
    worst = table.worst(_WORST)
    if limit is not None:
        figure, sign = limit.figure, 1.0 if limit.upper else -1.0
        passing = [row for row in table.rows if row not in worst and is_number(row.get(figure))]
        worst += sorted(passing, key=lambda row: sign * (limit.value - float(row[figure])))[: _WORST - len(worst)]
    else:
        figure = next((name for name in table.figures if _spread_out(table.column(name))), "")
    rows = tuple(
        (
            row["number"],
            short(row[figure]) if is_number(row.get(figure)) else "",
            str(row.get("status")) if not row.get("error") else f"{row['status']}: {row['error']}",
            {True: "yes", False: "no", None: ""}[row.get("passed")],
            row["seed"],
            ", ".join(f"{axis} = {value_text(row.get(axis))}" for axis in table.axes),
            str(row.get("command") or ""),
        )
        for row in worst
    )
    columns = ("run", figure or "figure", "status", "passed", "seed", "at", "repeat with")
    return Section("worst", "Worst runs", grids=(Grid("worst", "Worst runs first", columns, rows),))


def comparison_section(comparison: CampaignComparison, number: int = 1) -> Section:
    """Return the comparison of two sides, B against A. Numbers are B - A."""
    confidence = f"{100 * comparison.confidence:g} %"
    facts = [
        Fact("a", "A", comparison.a),
        Fact("b", "B", comparison.b),
        Fact("pairs", "pairs", comparison.pairs),
        Fact("seeds", "seeds (pairs of one seed depend on each other)", comparison.seeds),
        Fact("paired_by", "paired by", ", ".join((*comparison.paired_by, "seed"))),
        Fact("unpaired_a", "runs of A without a partner (not counted)", comparison.unpaired[0]),
        Fact("unpaired_b", "runs of B without a partner (not counted)", comparison.unpaired[1]),
        Fact("incomplete", "pairs without figures, because a run did not complete", comparison.incomplete),
    ]
    figures: list[tuple[Value, ...]] = []
    findings = []
    for compared in comparison.figures:
        of = compared.difference
        interval = "" if of.interval is None else _interval_text(of.interval, "")
        effect = None if of.effect is None else round(of.effect, 2)
        means, counts = (short(of.mean_a), short(of.mean_b), short(of.mean)), (of.pairs, of.clusters)
        figures.append(
            (
                compared.figure,
                *means,
                interval,
                _p_text(compared.adjusted),
                effect,
                _p_text(of.wilcoxon_p_value),
                *counts,
            )
        )
        if compared.adjusted is not None and compared.adjusted < 1 - comparison.confidence and of.interval is not None:
            direction = "lower" if of.mean < 0 else "higher"
            unit = f" {unit_of(compared.figure)}".rstrip()
            size = Interval(*sorted((abs(of.interval.low), abs(of.interval.high))))
            findings.append(
                Finding.notice(
                    f"compare.{compared.figure}",
                    f"{compared.figure} is {direction} in B by {short(abs(of.mean))}{unit} on average "
                    f"({confidence} interval {_interval_text(size, unit)}), p {_p_text(compared.adjusted)} over "
                    f"{_over_text(of.pairs, of.clusters)}",
                    (),
                    _INSPECT_A_PAIR,
                )
            )
    verdicts: list[tuple[Value, ...]] = []
    for judged in comparison.verdicts:
        rates = judged.rates
        verdicts.append(
            (
                " = ".join((judged.verdict, *judged.alike)),
                f"{rates.passed_a} of {rates.pairs}",
                f"{rates.passed_b} of {rates.pairs}",
                rates.only_a,
                rates.only_b,
                _interval_text(rates.interval, ""),
                _p_text(judged.adjusted).removeprefix("= "),
            )
        )
        if judged.adjusted < 1 - comparison.confidence:
            frequency = "more" if rates.difference > 0 else "less"
            findings.append(
                Finding.notice(
                    f"compare.{judged.verdict}",
                    f"B passes {judged.verdict!r} {frequency} often: {rates.passed_b} of {rates.pairs} against "
                    f"{rates.passed_a}, p {_p_text(judged.adjusted)} over {_over_text(rates.pairs, rates.clusters)}",
                    (),
                    _INSPECT_A_PAIR,
                )
            )
    if not findings:
        findings.append(
            Finding.ok(
                "compare.none",
                f"No difference between A and B is significant at {confidence} confidence over "
                f"{_over_text(comparison.pairs, comparison.seeds)}",
            )
        )
    if comparison.seeds == 1 < comparison.pairs:
        findings.append(
            Finding.notice(
                "compare.one_seed",
                f"All {comparison.pairs} pairs have the same seed, so a difference may be due to this seed alone",
                (),
                "Run both with more seeds: `seeds: 1-10` in the plan.",
            )
        )
    if any(comparison.unpaired):
        of_a, of_b = comparison.unpaired
        findings.append(
            Finding.notice(
                "compare.unpaired",
                f"{of_a} runs of A and {of_b} runs of B have no partner and do not count",
                (),
                "Run both with the same seeds and axes, or complete the interrupted campaign with --resume.",
            )
        )
    return Section(
        f"compare{number}",
        f"{comparison.b} against {comparison.a}",
        tuple(facts),
        tuple(findings),
        (
            Grid(
                "figures",
                "Figures: paired t test over seeds; p adjusted for all comparisons (Holm)",
                ("figure", "A", "B", "B - A", f"{confidence} interval", "p", "d_z", "Wilcoxon p", "pairs", "seeds"),
                tuple(figures),
            ),
            Grid(
                "verdicts",
                "Pass rates: exact test over seeds; p adjusted for all comparisons (Holm)",
                ("verdict", "A passed", "B passed", "only A", "only B", f"{confidence} interval of B - A", "p"),
                tuple(verdicts),
            ),
        ),
        tuple(pictures.differences(comparison)),
    )


def _over_text(pairs: int, seeds: int) -> str:
    """Return `20 pairs`, `40 pairs of 10 seeds`."""
    return plural(pairs, "pair") + ("" if pairs == seeds else f" of {plural(seeds, 'seed')}")


def rate_text(rows: Sequence[Row], verdict: str) -> str:
    """Return `18 of 20, 90 % (70 to 97 %)`; the interval counts the runs of one seed as a cluster."""
    if not rows:
        return "no runs"
    passed, interval = pass_rate(rows, verdict)
    runs = len(rows)
    return f"{passed} of {runs}, {100 * passed / runs:.3g} % ({100 * interval.low:.0f} to {100 * interval.high:.0f} %)"


def pass_rate(rows: Sequence[Row], verdict: str) -> tuple[int, Interval]:
    """Return the number of runs that satisfy a verdict, and the interval of the rate. An unknown verdict counts as
    failed.

    The runs of one seed are a cluster. If all have the same seed, the interval is valid for this seed alone.
    """
    passed, seeds = [row.get(verdict) is True for row in rows], [seed_of(row) for row in rows]
    if len(set(seeds)) == 1:
        return sum(passed), wilson_interval(sum(passed), len(passed))
    return sum(passed), clustered_rate_interval(passed, seeds)


def _group_text(group: Mapping[str, Any]) -> str:
    """Return `wind.mean_mps = 4`; for files and parts, only the differing text."""
    return ", ".join(
        value.rpartition("/")[2] if isinstance(value, str) else f"{'.'.join(key.split('.')[-2:])} = {value_text(value)}"
        for key, value in group.items()
    )


def _numeric_axes(table: ResultTable) -> list[str]:
    return [axis for axis in table.axes if _spread_out(table.column(axis))]


def _spread_out(values: Sequence[Any]) -> bool:
    """Return True for numbers with more than one distinct value."""
    return len({float(value) for value in values if is_number(value)}) > 1


def _rows(found: BoundaryFinding) -> list[tuple[float, int, int]]:
    counts = found.counts
    return [(float(a), int(n), int(p)) for a, n, p in zip(counts.at, counts.runs, counts.passed, strict=True)]


def _interval_text(interval: Interval, unit: str) -> str:
    if math.isinf(interval.low):
        return f"below {short(interval.high)}{unit}"
    if math.isinf(interval.high):
        return f"above {short(interval.low)}{unit}"
    return f"{short(interval.low)} to {short(interval.high)}{unit}"


def _p_text(value: float | None) -> str:
    if value is None:
        return ""
    return "< 0.0001" if value < 1e-4 else f"= {value:.2g}"
