"""Results of a campaign as sections: the same for the terminal, for --json and for its page."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

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
from xitl_cli.plugins.campaign.search import SearchFinding, told_again, verdict
from xitl_cli.plugins.campaign.search_spec import Search, SensitivitySpec
from xitl_cli.plugins.campaign.sensitivity import Elasticity, Sensitivity, elasticities, sensitivities
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
_LOOK_AT_A_PAIR = "Look at the runs of one seed side by side with `xitl logs compare`."
_BOTH_SIDES = "See why by a run on each side of it: results.jsonl has the command of every one."


@dataclass(frozen=True, slots=True)
class Limit:
    """Limit of a verdict such as `mission.cross_track_rms_m < 2`."""

    figure: str
    value: float
    upper: bool
    """True if the figure has to stay below the limit."""


def limits(verdicts: Iterable[str]) -> list[Limit]:
    """Return the limits of verdicts that compare one figure with one number."""
    found = (_LIMIT.fullmatch(text) for text in verdicts)
    return [Limit(one[1], float(one[3]), one[2].startswith("<")) for one in found if one is not None]


def campaign_sections(table: ResultTable) -> list[Section]:
    """Return all sections for the existing runs."""
    sections = [runs_section(table)]
    if (document := table.about.get("search")) is not None:
        search = Search.read(document)
        sections.append(boundary_section(search, told_again(search, table.rows)))
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
        told = [(text, [row for row in rows if row.get(text) is not None]) for text in table.verdicts]
        counted = tuple(
            (text, len(known), sum(bool(row[text]) for row in known), rate_text(known, text)) for text, known in told
        )
        grids.append(Grid("verdicts", "Verdicts", ("verdict", "runs", "passed", "rate"), counted))
    findings = []
    broken = {name: count for name, count in statuses.items() if name not in RAN}
    if broken:
        said = ", ".join(f"{count} {name}" for name, count in broken.items())
        findings.append(
            Finding.warning(
                "runs.broken",
                f"{sum(broken.values())} of {plural(len(rows), 'run')} came to no end of their own ({said})",
                (),
                "Repeat one with its command from the table of the worst runs; its error stands there.",
            )
        )
    return Section("runs", "Runs", tuple(facts), tuple(findings), tuple(grids))


def figures_section(table: ResultTable) -> Section:
    """Return median, 95th percentile and worst of each figure. If the combinations of axes are few, list them
    separately.
    """
    groups = _groups(table)
    told, statuses = limits(table.verdicts), counted_statuses(table.verdicts)
    by_figure: dict[str, list[tuple[Value, ...]]] = {}
    for figure in table.figures:
        upper = next((limit.upper for limit in told if limit.figure == figure), True)
        for name, members in groups.items():
            known = [row for row in members if row.get("status") in statuses and is_number(row.get(figure))]
            if not known:
                continue
            of = spread(np.array([float(row[figure]) for row in known]))
            worst = (max if upper else min)(known, key=lambda row, figure=figure: row[figure])  # type: ignore[misc]
            cells = (of.median, of.p95 if upper else of.p5, worst[figure])
            row = (name if len(groups) > 1 else figure, of.runs, *map(short, cells), worst["seed"])
            by_figure.setdefault(figure, []).append(row)
    columns = ("runs", "median", "95 %", "worst", "of seed")
    if len(groups) > 1:
        heads = ("", *columns)
        named = ((figure, pictures.titled(figure), tuple(rows)) for figure, rows in by_figure.items())
        grids = tuple(Grid(f"figures.{figure}", title, heads, rows) for figure, title, rows in named)
    else:
        whole = tuple(row for rows in by_figure.values() for row in rows)
        grids = (Grid("figures", "All runs", ("figure", *columns), whole),) if whole else ()
    title = "Figures (95 % and worst toward their bad side)"
    counted = [row for row in table.rows if row.get("status") in statuses]
    return Section("figures", title, (), (), grids, tuple(_figure_plots(table, counted, told)))


def _figure_plots(table: ResultTable, counted: Sequence[Row], told: Sequence[Limit]) -> Iterable[Plot]:
    limited = [limit.figure for limit in told]
    varying = [figure for figure in table.figures if _spread_out([row.get(figure) for row in counted])]
    chosen = list(dict.fromkeys([*(one for one in limited if one in varying), *varying]))[:_MOST_PICTURED]
    for figure in chosen:
        at = [limit.value for limit in told if limit.figure == figure]
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
    said, grids, plots = [], [], []
    for number, one in enumerate(findings):
        where = f" at {_group_text(one.group)}" if one.group else ""
        key = f"boundary.{number}"
        if one.found is None:
            said.append(
                Finding.notice(key, f"The search{where} is not at its end", (), "Go on with --resume and --report.")
            )
        elif isinstance(one.found, BoundaryFinding):
            axis = search.ranges[0]
            said.append(boundary_sentence(search, one.found, axis.key, where, key))
            grids.append(_points_grid(key, f"Pass rate along {axis.key}{where}", search, one.found))
            fit = monotone_rates(one.found.counts, one.found.rising)
            plots.append(pictures.boundary(key, search, one.found, fit, where))
        else:
            said.append(exploration_sentence(search, one.found, where, key))
            grids.append(_exploration_grid(key, search, one.found, where))
    if len(search.ranges) == 1 and len(findings) > 1:
        plots.insert(0, pictures.boundaries(search, findings, [_group_text(one.group) for one in findings]))
    return Section("boundary", "Where it begins to fail", (), tuple(said), tuple(grids), tuple(plots))


def boundary_sentence(search: Search, found: BoundaryFinding, axis: str, where: str, key: str) -> Finding:
    """Return one sentence, with a severity above OK if there is no boundary."""
    unit = f" {unit_of(axis)}".rstrip()
    low, high = search.ranges[0].low, search.ranges[0].high
    sure = f"{100 * search.spec.confidence:g} %"
    rate = f"{100 * search.spec.pass_rate:g} %"
    ways = ("pass" if not found.rising else "fail", "fail" if not found.rising else "pass")
    runs = plural(int(found.counts.runs.sum()), "run")
    silent = f"; {plural(found.silent, 'run')} had no verdict and count neither way" if found.silent else ""
    rates = ", ".join(f"{p} of {n} at {short(x)}" for x, n, p in _rows(found))
    if found.outcome == Outcome.WITHOUT_VERDICT or found.estimate is None:
        return Finding.critical(
            key, f"Runs along {axis}{where} have no verdict: nothing can be said", (), "See what became of the runs."
        )
    if found.outcome == Outcome.NOT_MONOTONE:
        return Finding.warning(
            key,
            f"The pass rate is not monotone along {axis}{where} (p = {found.monotony_p_value:.2g}): {rates}{silent}",
            (),
            "There is more than one boundary: lay a grid over the axis (count or step), or search parts of it.",
        )
    if found.outcome in (Outcome.PASSES, Outcome.FAILS):
        word = "pass" if found.outcome == Outcome.PASSES else "fail"
        than = "more" if found.outcome == Outcome.PASSES else "less"
        return Finding.warning(
            key,
            f"Runs {word} all along {axis} from {low:g} to {high:g}{unit}{where}: {than} than {rate} pass at every "
            f"point, with {sure} confidence ({rates}){silent}",
            (),
            "Widen the range of the axis, or set another limit.",
        )
    within = _sure_text(search, found.estimate.interval, unit)
    crosses = "Half of the runs fail" if search.spec.pass_rate == 0.5 else f"The pass rate crosses {rate}"
    place = f"{axis} = {short(found.estimate.value)}{unit}{where}"
    sentence = f"{crosses} at {place} ({within}, {runs}): they {ways[0]} below and {ways[1]} above"
    if found.outcome == Outcome.UNDECIDED:
        return Finding.notice(
            key,
            f"{sentence}{silent}. The interval is wider than asked for, as the runs of the search were spent",
            (),
            "Allow more with search.most_runs and a higher search.runs_per_point, or ask for less width.",
        )
    return Finding.notice(key, sentence + silent, (), _BOTH_SIDES)


def exploration_sentence(search: Search, found: ExplorationFinding, where: str, key: str) -> Finding:
    """Return the nearest failing point to nominal, or the reason why there is none."""
    home = found.points[0]
    at_home = _place_text(search, home.place)
    runs = plural(sum(point.runs for point in found.points), "run")
    if found.outcome == Outcome.WITHOUT_VERDICT:
        return Finding.critical(
            key, f"Runs at nominal{where} ({at_home}) have no verdict", (), "See what became of the runs."
        )
    if found.outcome == Outcome.FAILS:
        return Finding.warning(
            key,
            f"The nominal point itself fails{where}: {home.passed} of {home.runs} pass at {at_home}",
            (),
            "Name a point that passes in search.nominal, or set another limit.",
        )
    if found.nearest is None or found.along is None or found.along.estimate is None:
        tried = f"{len(found.points)} points and {runs}"
        repeated = "none that failed did so again when it was repeated"
        why = "none failed" if found.outcome == Outcome.PASSES else repeated
        return Finding.warning(
            key,
            f"No failing point was found{where} among {tried}: {why}",
            (),
            "Widen the ranges, or allow more points.",
        )
    place = _place_text(search, found.nearest)
    estimate = found.along.estimate
    sentence = (
        f"Nearest to nominal ({at_home}) it begins to fail{where} at {place}: {short(estimate.value)} of the ranges "
        f"away ({_sure_text(search, estimate.interval, '')}, {runs})"
    )
    if found.outcome == Outcome.UNDECIDED:
        return Finding.notice(key, f"{sentence}. The runs were spent before it was sure", (), "Allow more most_runs.")
    return Finding.notice(key, sentence, (), _BOTH_SIDES)


def _sure_text(search: Search, interval: Interval, unit: str) -> str:
    return f"{100 * search.spec.confidence:g} % interval {_interval_text(interval, unit)}"


def _place_text(search: Search, shares: Sequence[float]) -> str:
    named = ((one.key, one.value(share), unit_of(one.key)) for one, share in zip(search.ranges, shares, strict=True))
    return ", ".join(f"{key} = {short(value)} {unit}".rstrip() for key, value, unit in named)


def _points_grid(key: str, title: str, search: Search, found: BoundaryFinding) -> Grid:
    rows = []
    for at, runs, passed in _rows(found):
        interval = wilson_interval(passed, runs, search.spec.confidence)
        rows.append((short(at), runs, passed, round(passed / runs, 3), _interval_text(interval, "")))
    unit = unit_of(search.ranges[0].key)
    columns = (f"value ({unit})" if unit else "value", "runs", "passed", "rate", "interval (Wilson)")
    return Grid(key, title, columns, tuple(rows))


def _exploration_grid(key: str, search: Search, found: ExplorationFinding, where: str) -> Grid:
    """Return the places nearest to nominal with a pass rate below the required one."""
    failing = [point for point in found.points if point.runs and point.passed / point.runs < search.spec.pass_rate]
    home = found.points[0].place
    nearest = sorted(failing, key=lambda point: math.dist(point.place, home))[:_WORST]
    rows = tuple(
        (
            *(short(one.value(share)) for one, share in zip(search.ranges, point.place, strict=True)),
            round(math.dist(point.place, home), 3),
            point.runs,
            point.passed,
        )
        for point in nearest
    )
    columns = (*(one.key for one in search.ranges), "distance", "runs", "passed")
    return Grid(key, f"Failing points nearest to nominal{where}", columns, rows)


def sensitivity_section(table: ResultTable, spec: SensitivitySpec, places: Sequence[int]) -> Section:
    """Return the axes by importance, for each figure."""
    figures = spec.figures or tuple(figure for figure in table.figures if _spread_out(table.column(figure)))
    seed = int(table.about["plan"].get("seed", 1))
    told = sensitivities(spec, table.axes, figures, table.rows, places, len(table.about["seeds"]), seed)
    grids = tuple(_effects_grid(one) for one in told if one.effects)
    lacks = tuple(f"{one.figure}: no sensitivity, as {one.why}." for one in told if one.why)
    findings = tuple(_strongest(one, spec) for one in told if one.effects)
    plots = tuple(pictures.effects(one) for one in told if one.effects)
    return Section("sensitivity", "Which axes matter", (), findings, grids, plots, lacks)


def _strongest(told: Sensitivity, spec: SensitivitySpec) -> Finding:
    first = told.effects[0]
    share = f"total index {short(first.total)}" if told.method == "sobol" else f"mu* = {short(first.total)}"
    left_out = f"; {plural(told.dropped, 'group')} of runs without the figure left out" if told.dropped else ""
    sure = f"{100 * spec.confidence:g} % interval {_interval_text(first.total_interval, '')}"
    close = [one.axis for one in told.effects[1:] if one.total_interval.high >= first.total_interval.low]
    beside = f"; not to be told from it: {', '.join(close)}" if close else ""
    return Finding.notice(
        f"sensitivity.{told.figure}",
        f"{told.figure}: {first.axis} matters most ({share}, {sure}){beside}{left_out}",
        (),
        "Take more samples to tell axes apart whose intervals overlap." if close else "Search along it: `search:`.",
    )


def _effects_grid(told: Sensitivity) -> Grid:
    names = ("first order", "total") if told.method == "sobol" else ("mu", "mu*")
    columns = ("axis", names[1], "interval", names[0], "interval" if told.method == "sobol" else "sigma")
    rows = tuple(
        (
            one.axis,
            short(one.total),
            _interval_text(one.total_interval, ""),
            short(one.main),
            short(one.interaction or 0.0) if one.main_interval is None else _interval_text(one.main_interval, ""),
        )
        for one in told.effects
    )
    return Grid(f"sensitivity.{told.figure}", f"{told.figure} ({told.used} groups of runs)", columns, rows)


def elasticity_section(table: ResultTable) -> Section:
    """Return, for a one-at-a-time plan, the change of a figure in per cent for one per cent of an axis."""
    base = table.about.get("base_values", {})
    nominal = {axis: float(base[axis]) for axis in table.axes if is_number(base.get(axis))}
    grids = []
    for figure in table.figures:
        told = elasticities(nominal, _series(table, figure, nominal), 0.95)
        if told:
            rows = tuple(_elasticity_row(one) for one in told)
            columns = ("axis", "elasticity", "slope", "95 % interval", "seeds")
            grids.append(Grid(f"elasticity.{figure}", figure, columns, rows))
    left_out = [axis for axis in table.axes if axis not in nominal]
    lacks = (f"{', '.join(left_out)}: no elasticity, as the base has no number there.",) if left_out else ()
    return Section("elasticity", "Elasticities about the base", (), (), tuple(grids), (), lacks)


def _elasticity_row(one: Elasticity) -> tuple[Value, ...]:
    shown = "" if one.elasticity is None else short(one.elasticity)
    return one.axis, shown, short(one.slope), _interval_text(one.interval, "") if one.interval else "", one.seeds


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
    beside = f", over all of {', '.join(others)}" if others else ""
    rate = float(table.about["search"]["spec"]["pass_rate"]) if table.about.get("search") else 0.5
    plot = pictures.pass_map(across, up, x, y, passed, surface, rate, beside)
    return Section("map", "Pass and fail", plots=(plot,))


def worst_section(table: ResultTable) -> Section:
    """Return the runs to inspect first, each with the command that repeats it."""
    told = limits(table.verdicts)
    worst = table.worst(_WORST)
    passing = [row for row in table.rows if row not in worst and told and is_number(row.get(told[0].figure))]
    worst += sorted(passing, key=lambda row: _margin(row, told[0]))[: _WORST - len(worst)]
    figure = told[0].figure if told else next((one for one in table.figures if _spread_out(table.column(one))), "")
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


def _margin(row: Row, limit: Limit) -> float:
    """Return the margin, which is lowest for the run nearest to failure."""
    away = limit.value - float(row[limit.figure])
    return away if limit.upper else -away


def comparison_section(told: CampaignComparison, number: int = 1) -> Section:
    """Return the comparison of two sides, B against A. Numbers are B - A."""
    sure = f"{100 * told.confidence:g} %"
    facts = [
        Fact("a", "A", told.a),
        Fact("b", "B", told.b),
        Fact("pairs", "pairs", told.pairs),
        Fact("seeds", "seeds; pairs of one seed depend on each other", told.seeds),
        Fact("paired_by", "paired by", ", ".join((*told.paired_by, "seed"))),
        Fact("unpaired_a", "of A without a partner, not counted", told.unpaired[0]),
        Fact("unpaired_b", "of B without a partner, not counted", told.unpaired[1]),
        Fact("incomplete", "pairs whose figures are left out: a run did not complete", told.incomplete),
    ]
    figures: list[tuple[Value, ...]] = []
    findings = []
    for one in told.figures:
        of = one.difference
        interval = "" if of.interval is None else _interval_text(of.interval, "")
        effect = None if of.effect is None else round(of.effect, 2)
        means, counts = (short(of.mean_a), short(of.mean_b), short(of.mean)), (of.pairs, of.clusters)
        figures.append(
            (one.figure, *means, interval, _p_text(one.adjusted), effect, _p_text(of.wilcoxon_p_value), *counts)
        )
        if one.adjusted is not None and one.adjusted < 1 - told.confidence and of.interval is not None:
            way = "lower" if of.mean < 0 else "higher"
            unit = f" {unit_of(one.figure)}".rstrip()
            size = Interval(*sorted((abs(of.interval.low), abs(of.interval.high))))
            findings.append(
                Finding.notice(
                    f"compare.{one.figure}",
                    f"{one.figure} is {way} in B by {short(abs(of.mean))}{unit} in the mean ({sure} interval "
                    f"{_interval_text(size, unit)}), p {_p_text(one.adjusted)} over "
                    f"{_over_text(of.pairs, of.clusters)}",
                    (),
                    _LOOK_AT_A_PAIR,
                )
            )
    verdicts: list[tuple[Value, ...]] = []
    for judged in told.verdicts:
        rates = judged.rates
        verdicts.append(
            (
                " = ".join((judged.verdict, *judged.alike)),
                f"{rates.passed_a} of {rates.pairs}",
                f"{rates.passed_b} of {rates.pairs}",
                rates.only_a,
                rates.only_b,
                _interval_text(rates.interval, ""),
                _p_cell(judged.adjusted),
            )
        )
        if judged.adjusted < 1 - told.confidence:
            way = "more" if rates.difference > 0 else "less"
            findings.append(
                Finding.notice(
                    f"compare.{judged.verdict}",
                    f"B passes {judged.verdict!r} {way} often: {rates.passed_b} of {rates.pairs} against "
                    f"{rates.passed_a}, p {_p_text(judged.adjusted)} over {_over_text(rates.pairs, rates.clusters)}",
                    (),
                    _LOOK_AT_A_PAIR,
                )
            )
    if not findings:
        findings.append(
            Finding.ok(
                "compare.none",
                f"No difference between A and B can be told from chance at {sure} confidence over "
                f"{_over_text(told.pairs, told.seeds)}",
            )
        )
    if told.seeds == 1 < told.pairs:
        findings.append(
            Finding.notice(
                "compare.one_seed",
                f"All {told.pairs} pairs have one seed, so nothing tells a difference from this seed's chance",
                (),
                "Run both with more seeds: `seeds: 1-10` in the plan.",
            )
        )
    if any(told.unpaired):
        findings.append(
            Finding.notice(
                "compare.unpaired",
                f"{told.unpaired[0]} runs of A and {told.unpaired[1]} of B have no partner and are not counted",
                (),
                "Run both with the same seeds and axes, or finish the one that stopped with --resume.",
            )
        )
    return Section(
        f"compare{number}",
        f"{told.b} against {told.a}",
        tuple(facts),
        tuple(findings),
        (
            Grid(
                "figures",
                "Figures: paired t test over seeds, p for all comparisons together (Holm)",
                ("figure", "A", "B", "B - A", f"{sure} interval", "p", "d_z", "Wilcoxon p", "pairs", "seeds"),
                tuple(figures),
            ),
            Grid(
                "verdicts",
                "Pass rates: exact test over seeds, p for all comparisons together (Holm)",
                ("verdict", "A passed", "B passed", "only A", "only B", f"{sure} interval of B - A", "p"),
                tuple(verdicts),
            ),
        ),
        tuple(pictures.differences(told)),
    )


def _over_text(pairs: int, seeds: int) -> str:
    """Return `20 pairs`, `40 pairs of 10 seeds`."""
    return plural(pairs, "pair") + ("" if pairs == seeds else f" of {plural(seeds, 'seed')}")


def rate_text(rows: Sequence[Row], verdict: str) -> str:
    """Return `18 of 20, 90 % (70 to 97 %)`; the interval counts the runs of one seed as a cluster."""
    if not rows:
        return "of no run"
    passed, interval = pass_rate(rows, verdict)
    runs = len(rows)
    return f"{passed} of {runs}, {100 * passed / runs:.3g} % ({100 * interval.low:.0f} to {100 * interval.high:.0f} %)"


def pass_rate(rows: Sequence[Row], verdict: str) -> tuple[int, Interval]:
    """Return the number of runs that satisfy a verdict, and the interval of the rate. An unknown verdict counts as
    failed.

    The runs of one seed are a cluster. If all have the same seed, the interval is valid for this seed alone.
    """
    held, seeds = [row.get(verdict) is True for row in rows], [seed_of(row) for row in rows]
    if len(set(seeds)) == 1:
        return sum(held), wilson_interval(sum(held), len(held))
    return sum(held), clustered_rate_interval(held, seeds)


def _groups(table: ResultTable) -> dict[str, list[Row]]:
    """Group runs by the values of the axes; return one group if there would be too many."""
    found: dict[str, list[Row]] = {}
    for row in table.rows:
        found.setdefault(_group_text({axis: row.get(axis) for axis in table.axes}), []).append(row)
    return found if len(found) <= _MOST_GROUPS else {"": list(table.rows)}


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


def _p_cell(value: float | None) -> str:
    return _p_text(value).removeprefix("= ")


def _p_text(value: float | None) -> str:
    if value is None:
        return ""
    return "< 0.0001" if value < 1e-4 else f"= {value:.2g}"
