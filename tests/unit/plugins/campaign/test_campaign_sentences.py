"""Sentences, tables and pictures of made findings of a campaign."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("scipy")

from xitl_cli.logs.model.sections import Finding, Severity
from xitl_cli.plugins.campaign import pictures
from xitl_cli.plugins.campaign.bisection import BoundaryFinding, Outcome
from xitl_cli.plugins.campaign.exploration import ExplorationFinding, PointCount
from xitl_cli.plugins.campaign.report import (
    boundary_section,
    boundary_sentence,
    comparison_section,
    exploration_sentence,
    figures_section,
    map_section,
    pass_rate,
    rate_text,
    runs_section,
    worst_section,
)
from xitl_cli.plugins.campaign.search import SearchFinding
from xitl_cli.plugins.campaign.search_spec import AxisRange, Search, SearchSpec
from xitl_cli.plugins.campaign.sensitivity import AxisEffect, Sensitivity
from xitl_cli.plugins.campaign.statistics import (
    BoundaryEstimate,
    Interval,
    LogisticSurface,
    PairedDifference,
    PairedRates,
    PassCounts,
    clustered_rate_interval,
    wilson_interval,
)

WIND, CURRENT, TRACK = "environment.wind.mean_mps", "environment.current.speed_mps", "mission.cross_track_max_m"
COUNTS = PassCounts(np.array([0.0, 10.0, 20.0]), np.array([8, 8, 2]), np.array([8, 4, 0]))
ESTIMATE = BoundaryEstimate(9.876543, Interval(8.5, 11.25))
RATES = "8 of 8 at 0, 4 of 8 at 10, 0 of 2 at 20"


def search(*ranges: AxisRange, groups: tuple[dict[str, Any], ...] = ({},), **spec: Any) -> Search:
    axes = ranges or (AxisRange(WIND, 0.0, 20.0),)
    return Search(SearchSpec(**spec), axes, groups, (0.25,) * len(axes), 1, 1)


def boundary(
    outcome: Outcome, estimate: BoundaryEstimate | None = ESTIMATE, *, rising: bool = False, silent: int = 0
) -> BoundaryFinding:
    return BoundaryFinding(outcome, rising, estimate, COUNTS, silent, 0.0042)


def sentence(found: BoundaryFinding, **spec: Any) -> Finding:
    return boundary_sentence(search(**spec), found, WIND, " at a = 1", "boundary.0")


def test_a_boundary_that_is_found() -> None:
    found = sentence(boundary(Outcome.FOUND))
    assert found.severity == Severity.NOTICE
    assert found.sentence == (
        f"Half of the runs fail at {WIND} = 9.877 m/s at a = 1 (95 % interval 8.5 to 11.25 m/s, 18 runs): they pass "
        "below and fail above"
    )
    assert found.next_step.startswith("Inspect a run on each side")
    rising = sentence(boundary(Outcome.FOUND, rising=True, silent=1), pass_rate=0.9, confidence=0.8).sentence
    assert rising == (
        f"The pass rate crosses 90 % at {WIND} = 9.877 m/s at a = 1 (80 % interval 8.5 to 11.25 m/s, 18 runs): they "
        "fail below and pass above; 1 run had no verdict and do not count"
    )


@pytest.mark.parametrize(
    ("interval", "text"),
    [(Interval(-math.inf, 3.0), "below 3 m/s"), (Interval(3.0, math.inf), "above 3 m/s")],
)
def test_an_interval_without_an_end(interval: Interval, text: str) -> None:
    assert f"interval {text}, 18 runs" in sentence(boundary(Outcome.FOUND, BoundaryEstimate(2.0, interval))).sentence


def test_a_search_that_reached_its_limit() -> None:
    found = sentence(boundary(Outcome.UNDECIDED, silent=2))
    assert found.severity == Severity.NOTICE
    assert found.sentence.endswith(
        "fail above; 2 runs had no verdict and do not count. The interval is wider than search.width, because the "
        "search reached its limit of runs"
    )
    assert found.next_step.startswith("Increase search.most_runs")


@pytest.mark.parametrize(
    ("outcome", "word", "than"), [(Outcome.PASSES, "pass", "more"), (Outcome.FAILS, "fail", "less")]
)
def test_no_boundary_on_the_axis(outcome: Outcome, word: str, than: str) -> None:
    found = sentence(boundary(outcome), pass_rate=0.75)
    assert found.severity == Severity.WARNING
    assert found.sentence == (
        f"Runs {word} along all of {WIND} from 0 to 20 m/s at a = 1: {than} than 75 % pass at every point, with 95 % "
        f"confidence ({RATES})"
    )


def test_a_rate_that_rises_and_falls_and_runs_without_verdicts() -> None:
    found = sentence(boundary(Outcome.NOT_MONOTONE))
    assert found.severity == Severity.WARNING
    assert found.sentence == f"The pass rate is not monotone along {WIND} at a = 1 (p = 0.0042): {RATES}"
    for unknown in (boundary(Outcome.WITHOUT_VERDICT), boundary(Outcome.FOUND, None)):
        found = sentence(unknown)
        assert found.severity == Severity.CRITICAL
        assert found.sentence == f"No run along {WIND} at a = 1 has a verdict: the boundary is unknown"


PLANE = (AxisRange(WIND, 0.0, 20.0), AxisRange(CURRENT, 0.0, 1.0))
POINTS = (
    PointCount((0.25, 0.25), 10, 9),
    PointCount((0.75, 0.25), 2, 0),
    PointCount((0.25, 0.5), 4, 1),
    PointCount((0.5, 0.5), 2, 1),
)


def exploration(outcome: Outcome, nearest: tuple[float, float] | None = (0.25, 0.45)) -> ExplorationFinding:
    along = boundary(Outcome.FOUND, BoundaryEstimate(0.2, Interval(0.15, 0.25)))
    return ExplorationFinding(outcome, POINTS, nearest, along, 0)


def explored(found: ExplorationFinding) -> Finding:
    return exploration_sentence(search(*PLANE), found, "", "boundary.0")


def test_the_nearest_failing_point() -> None:
    home = f"{WIND} = 5 m/s, {CURRENT} = 0.25 m/s"
    text = (
        f"The boundary of failure nearest to the nominal point ({home}) is at {WIND} = 5 m/s, {CURRENT} = 0.45 m/s, at "
        "a distance of 0.2 of the ranges (95 % interval 0.15 to 0.25, 18 runs)"
    )
    assert (explored(exploration(Outcome.FOUND)).sentence, explored(exploration(Outcome.FOUND)).severity) == (
        text,
        Severity.NOTICE,
    )
    assert explored(exploration(Outcome.UNDECIDED)).sentence.startswith(f"{text}. The interval is wider")
    fails = explored(exploration(Outcome.FAILS))
    assert (fails.sentence, fails.severity) == (f"The nominal point fails: 9 of 10 pass at {home}", Severity.WARNING)
    silent = explored(exploration(Outcome.WITHOUT_VERDICT))
    assert (silent.sentence, silent.severity) == (
        f"No run at the nominal point ({home}) has a verdict",
        Severity.CRITICAL,
    )
    for outcome, reason in (
        (Outcome.PASSES, "none failed"),
        (Outcome.UNDECIDED, "no failed point failed again when repeated"),
    ):
        assert explored(exploration(outcome, None)).sentence == (
            f"The search found no failing point in 4 points and 18 runs: {reason}"
        )


def test_failing_points_are_listed_by_their_distance() -> None:
    section = boundary_section(search(*PLANE), [SearchFinding({}, exploration(Outcome.FOUND))])
    (grid,) = section.grids
    assert grid.columns == (WIND, CURRENT, "distance", "runs", "passed")
    assert grid.rows == ((5, 0.5, 0.25, 4, 1), (15, 0.25, 0.5, 2, 0))  # a rate of 0.5 passes
    assert section.plots == ()


def test_a_boundary_has_a_table_and_pictures_of_each_group() -> None:
    of = search(groups=({CURRENT: 0.0}, {CURRENT: 0.5}), width=2.0)
    found = [
        SearchFinding({CURRENT: 0.0}, boundary(Outcome.FOUND)),
        SearchFinding({CURRENT: 0.5}, boundary(Outcome.FOUND, BoundaryEstimate(19.0, Interval(18.0, math.inf)))),
        SearchFinding({CURRENT: 0.7}, None),
    ]
    section = boundary_section(of, found)
    assert section.findings[2].sentence == "The search at current.speed_mps = 0.7 is not complete"
    first, second = section.grids
    interval = wilson_interval(4, 8)
    assert first.rows[1] == (10, 8, 4, 0.5, f"{interval.low:.4g} to {interval.high:.4g}")
    assert first.columns[0] == "value (m/s)"
    assert second.title == f"Pass rate along {WIND} at current.speed_mps = 0.5"
    together, *each = section.plots
    assert together.figure is not None
    (data,) = together.figure["data"]
    assert data["x"] == ["current.speed_mps = 0", "current.speed_mps = 0.5"]
    assert data["y"] == [9.876543, 19.0]
    assert data["error_y"]["array"] == pytest.approx([11.25 - 9.876543, 20.0 - 19.0])  # up to the end of the axis
    assert data["error_y"]["arrayminus"] == pytest.approx([9.876543 - 8.5, 1.0])
    assert together.figure["layout"]["yaxis"]["range"] == [0.0, 20.0]
    assert len(each) == 2
    assert each[0].figure is not None
    fit, runs = each[0].figure["data"]
    assert fit["y"] == pytest.approx([1.0, 0.5, 0.0])
    assert (runs["x"], runs["y"]) == ([0.0, 10.0, 20.0], [1.0, 0.5, 0.0])
    assert runs["text"] == ["8 of 8", "4 of 8", "0 of 2"]
    assert runs["marker"]["size"] == pytest.approx([10.0, 10.0, 8.0])  # 6 + 2 by the root of the runs over the fewest
    intervals = [wilson_interval(passed, of_all) for passed, of_all in ((8, 8), (4, 8), (0, 2))]
    assert runs["error_y"]["array"] == pytest.approx(
        [intervals[0].high - 1.0, intervals[1].high - 0.5, intervals[2].high]
    )
    assert runs["error_y"]["arrayminus"] == pytest.approx(
        [1.0 - intervals[0].low, 0.5 - intervals[1].low, -intervals[2].low]
    )
    level, band, line = each[0].figure["layout"]["shapes"]
    assert (level["y0"], level["y1"], level["xref"]) == (0.5, 0.5, "paper")
    assert (band["x0"], band["x1"], band["yref"]) == (8.5, 11.25, "paper")
    assert (line["x0"], line["x1"], line["yref"]) == (9.876543, 9.876543, "paper")
    assert "type" not in each[0].figure["layout"]["xaxis"]
    logarithmic = boundary_section(search(AxisRange(WIND, 1.0, 20.0, log=True)), found[:1]).plots[0]
    assert logarithmic.figure is not None
    assert logarithmic.figure["layout"]["xaxis"]["type"] == "log"


# Tables of rows
def table(
    rows: list[dict[str, Any]],
    axes: tuple[str, ...] = (WIND, CURRENT),
    verdicts: tuple[str, ...] = (),
    figures: tuple[str, ...] = (TRACK,),
    **about: Any,
) -> Any:
    filled = [
        {"number": n, "status": "completed", "error": None, "seed": n, "command": f"xitl {n}", **row}
        for n, row in enumerate(rows, 1)
    ]
    return SimpleNamespace(
        rows=filled,
        axes=axes,
        verdicts=verdicts,
        figures=figures,
        about={"plan": {}, **about},
        column=lambda name: [row.get(name) for row in filled],
        worst=lambda count: [row for row in filled if not row.get("passed")][:count],
    )


def test_statuses_and_verdicts_are_counted() -> None:
    rows: list[dict[str, Any]] = [
        {"passed": True, "a": True, "b": True},
        {"passed": False, "a": True, "b": False},
        {"passed": False, "a": False, "b": None, "status": "incomplete"},
        {"passed": False, "a": None, "b": None, "status": "killed"},
        {"passed": False, "a": None, "b": None, "status": "timeout"},
        {"passed": False, "a": None, "b": None, "status": "timeout"},
    ]
    section = runs_section(table(rows, verdicts=("a", "b")))
    facts = {fact.key: fact.value for fact in section.facts}
    assert {key: facts[key] for key in ("runs", "status.completed", "status.timeout", "status.killed")} == {
        "runs": 6,
        "status.completed": 2,
        "status.timeout": 2,
        "status.killed": 1,
    }
    (grid,) = section.grids
    assert [row[:3] for row in grid.rows] == [("a", 3, 2), ("b", 2, 1)]
    (broken,) = section.findings
    assert broken.sentence == "3 of 6 runs did not run to their end (1 killed, 2 timeout)"
    assert runs_section(table(rows[:2], verdicts=("a",))).grids == ()
    assert runs_section(table(rows[:3], verdicts=("a", "b"))).findings == ()


def test_the_interval_of_a_rate_counts_the_runs_of_a_seed_together() -> None:
    rows = [{"seed": seed, "v": passed} for seed, passed in ((1, True), (1, True), (2, False), (2, None), (3, True))]
    passed, interval = pass_rate(rows, "v")
    assert passed == 3
    assert interval == clustered_rate_interval([True, True, False, False, True], [1, 1, 2, 2, 3])
    assert rate_text(rows, "v") == f"3 of 5, 60 % ({100 * interval.low:.0f} to {100 * interval.high:.0f} %)"
    one = [{**row, "seed": 7} for row in rows]
    assert pass_rate(one, "v") == (3, wilson_interval(3, 5))
    assert rate_text([], "v") == "no runs"


def test_the_map_has_a_mark_for_each_place() -> None:
    rows = [
        {
            WIND: float(wind),
            CURRENT: current,
            "a": wind + 10 * current < 12,
            "passed": wind + 10 * current < 12 or (seed == 1 and (wind, current) == (10.0, 0.5)),
            "seed": seed,
        }
        for wind in (0.0, 5.0, 10.0)
        for current in (0.0, 0.5, 1.0)
        for seed in (1, 2)
    ]
    section = map_section(table(rows, verdicts=("a",)))
    assert section.plots[0].figure is not None
    *contours, marks = section.plots[0].figure["data"]
    assert (marks["x"], marks["y"]) == ([0.0] * 3 + [5.0] * 3 + [10.0] * 3, [0.0, 0.5, 1.0] * 3)
    assert marks["text"][7] == "1 of 2 passed"
    assert marks["marker"]["color"] == [1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.5, 0.0]
    assert marks["marker"]["symbol"] == ["circle"] * 5 + ["x", "circle", "circle", "x"]
    assert marks["marker"]["size"] == 12
    assert contours
    for contour in contours:
        assert (contour["x"][0], contour["x"][-1]) == (0.0, 10.0)
        assert (contour["y"][0], contour["y"][-1]) == (0.0, 1.0)
        assert np.shape(contour["z"]) == (60, 60)
        assert contour["contours"]["start"] == contour["contours"]["end"] == 0.5
    surface = contours[0]["z"]
    assert surface[0][0] > 0.5 > surface[-1][-1]
    assert surface[0][-1] > surface[-1][-1]  # rows are values of y
    assert map_section(table([{**row, "status": "failed"} for row in rows], verdicts=("a",))).plots == ()


def test_the_rate_of_the_map_is_that_of_the_search() -> None:
    shown = pictures.pass_map(
        "a", "b", np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]), [True, False, True], None, 0.6, ", x"
    )
    assert shown.figure is not None
    (marks,) = shown.figure["data"]
    assert marks["marker"]["symbol"] == ["x", "circle"]
    assert shown.title == "Pass and fail over a and b, x"
    surface = LogisticSurface(2, np.zeros(6), np.zeros((6, 6)))
    assert (
        "line: pass rate 60 % of a logistic surface"
        in pictures.pass_map(
            "a", "b", np.array([0.0, 1.0]), np.array([0.0, 1.0]), [True, False], surface, 0.6, ""
        ).title
    )


@pytest.mark.parametrize(("verdict", "order"), [(f"{TRACK} < 2", [3, 4, 1, 2]), (f"{TRACK} > 2", [3, 4, 2, 1])])
def test_the_worst_runs_come_first_and_then_the_nearest_to_the_limit(verdict: str, order: list[int]) -> None:
    rows: list[dict[str, Any]] = [
        {TRACK: 1.9, "passed": True, WIND: 4.0},
        {TRACK: 0.5, "passed": True, WIND: 0.0},
        {TRACK: 2.5, "passed": False, WIND: 8.0},
        {"passed": None, "status": "failed", "error": "no room", WIND: 8.0},
    ]
    if ">" in verdict:
        rows[0][TRACK], rows[1][TRACK] = 9.0, 2.1
    (grid,) = worst_section(table(rows, axes=(WIND,), verdicts=(verdict,))).grids
    assert [row[0] for row in grid.rows] == order
    assert grid.columns[1] == TRACK
    assert grid.rows[0][1:] == (2.5, "completed", "no", 3, f"{WIND} = 8", "xitl 3")
    assert grid.rows[1][1:4] == ("", "failed: no room", "")
    assert grid.rows[2][3] == "yes"


@pytest.mark.parametrize("places", [1, 12, 13])
def test_up_to_twelve_combinations_of_axes_are_listed_separately(places: int) -> None:
    rows = [{TRACK: float(at + step), "duration_s": 60.0, WIND: at} for at in range(places) for step in range(3)]
    grids = figures_section(table(rows, axes=(WIND,), figures=(TRACK, "duration_s"))).grids
    if places == 12:
        assert [grid.key for grid in grids] == [f"figures.{TRACK}", "figures.duration_s"]
        assert [row[0] for row in grids[0].rows] == [f"wind.mean_mps = {at}" for at in range(12)]
        assert [row[1:] for row in grids[0].rows[:2]] == [(3, 1, 1.9, 2, 3), (3, 2, 2.9, 3, 6)]
    else:
        assert [grid.key for grid in grids] == ["figures"]
        assert [row[:2] for row in grids[0].rows] == [(TRACK, 3 * places), ("duration_s", 3 * places)]
        assert grids[0].rows[0][4:] == (places + 1, 3 * places)


# Comparison of two sides
def compared(**more: Any) -> Any:
    difference = PairedDifference(
        pairs=20,
        mean_a=2.0,
        mean_b=1.5,
        mean=-0.5,
        interval=Interval(-0.8, -0.2),
        p_value=0.001,
        effect=-1.25,
        wilcoxon_p_value=0.00001,
        clusters=10,
    )
    alike = PairedDifference(
        pairs=20,
        mean_a=60.0,
        mean_b=60.1,
        mean=0.1,
        interval=Interval(-0.1, 0.3),
        p_value=0.3,
        effect=0.2,
        wilcoxon_p_value=0.4,
        clusters=10,
    )
    rates = PairedRates(
        pairs=20, passed_a=10, passed_b=16, only_a=1, only_b=7, interval=Interval(0.05, 0.5), p_value=0.02, clusters=10
    )
    made: dict[str, Any] = {
        "a": "old",
        "b": "new",
        "pairs": 20,
        "seeds": 10,
        "paired_by": (WIND,),
        "unpaired": (0, 0),
        "incomplete": 0,
        "confidence": 0.95,
        "figures": (
            SimpleNamespace(figure=TRACK, difference=difference, adjusted=0.004),
            SimpleNamespace(figure="duration_s", difference=alike, adjusted=0.3),
        ),
        "verdicts": (SimpleNamespace(verdict="driver.completed", alike=("passed",), rates=rates, adjusted=0.04),),
    }
    return SimpleNamespace(**(made | more))


def test_differences_that_are_significant_are_said() -> None:
    section = comparison_section(compared(), 3)
    assert (section.key, section.title) == ("compare3", "new against old")
    track, completed = section.findings
    assert track.sentence == (
        f"{TRACK} is lower in B by 0.5 m on average (95 % interval 0.2 to 0.8 m), p = 0.004 over 20 pairs of 10 seeds"
    )
    assert completed.sentence == (
        "B passes 'driver.completed' more often: 16 of 20 against 10, p = 0.04 over 20 pairs of 10 seeds"
    )
    facts = {fact.key: fact.value for fact in section.facts}
    assert (facts["pairs"], facts["seeds"], facts["paired_by"]) == (20, 10, f"{WIND}, seed")
    figures, verdicts = section.grids
    assert figures.rows[0] == (TRACK, 2, 1.5, -0.5, "-0.8 to -0.2", "= 0.004", -1.25, "< 0.0001", 20, 10)
    assert verdicts.rows == (("driver.completed = passed", "10 of 20", "16 of 20", 1, 7, "0.05 to 0.5", "0.04"),)
    (plot,) = section.plots
    assert plot.figure is not None
    (data,) = plot.figure["data"]
    assert (data["y"], data["x"]) == (["duration_s", TRACK], [0.2, -1.25])  # the first on top
    # Half of the interval in standard deviations: 0.3 m of 0.5 m / 1.25, and 0.2 s of 0.1 s / 0.2
    assert data["error_x"]["array"] == pytest.approx([0.2 / 0.5, 0.3 / 0.4])


def test_notes_of_a_comparison() -> None:
    made = compared(seeds=1, unpaired=(2, 3), figures=compared().figures[1:], verdicts=())
    nothing, seed, unpaired = comparison_section(made).findings
    assert nothing.sentence == (
        "No difference between A and B is significant at 95 % confidence over 20 pairs of 1 seed"
    )
    assert seed.sentence.startswith("All 20 pairs have the same seed")
    assert unpaired.sentence == "2 runs of A and 3 runs of B have no partner and do not count"
    at_limit = compared(confidence=0.9961, verdicts=())
    assert comparison_section(at_limit).findings[0].key == "compare.none"  # p = 0.004 is not below 0.0039


def test_effects_are_bars_with_the_strongest_on_top() -> None:
    effects = (
        AxisEffect("a", 0.7, Interval(0.6, 0.9), 0.5, Interval(0.4, 0.6)),
        AxisEffect("b", 0.2, Interval(0.1, 0.25), 0.1, Interval(0.0, 0.2)),
    )
    for method, label in (("sobol", "total index"), ("morris", "mu* (m)")):
        plot = pictures.effects(Sensitivity(TRACK, method, effects, 8, 0))
        assert plot.figure is not None
        (data,) = plot.figure["data"]
        assert (data["y"], data["x"]) == (["b", "a"], [0.2, 0.7])
        assert data["error_x"]["array"] == pytest.approx([0.05, 0.2])
        assert plot.figure["layout"]["xaxis"]["title"]["text"] == label


def test_boxes_and_histogram() -> None:
    boxes = pictures.boxes(TRACK, WIND, {"0": [1.0, 2.0], "4": [3.0]}, [2.5])
    assert boxes.figure is not None
    assert [(one["name"], one["y"]) for one in boxes.figure["data"]] == [("0", [1.0, 2.0]), ("4", [3.0])]
    (limit,) = boxes.figure["layout"]["shapes"]
    assert (limit["y0"], limit["y1"], limit["x0"], limit["x1"]) == (2.5, 2.5, 0, 1)
    assert boxes.figure["layout"]["yaxis"]["title"]["text"] == f"{TRACK} (m)"
    histogram = pictures.histogram(TRACK, [1.0, 2.0], [2.5])
    assert histogram.figure is not None
    assert histogram.figure["data"][0]["x"] == [1.0, 2.0]
    (limit,) = histogram.figure["layout"]["shapes"]
    assert (limit["x0"], limit["x1"], limit["y0"], limit["y1"]) == (2.5, 2.5, 0, 1)
    assert histogram.title == f"{TRACK}, all runs; dashed: the limit 2.5"
    assert pictures.histogram("driver.completed", [], []).title == "driver.completed, all runs"
