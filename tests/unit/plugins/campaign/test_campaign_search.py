"""Searches of a plan through the engine: what they find, that they resume, and that workers change nothing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imagined_runs import imagined

from xitl_cli.plugins.campaign.bisection import BoundaryFinding, Outcome
from xitl_cli.plugins.campaign.exploration import ExplorationFinding
from xitl_cli.plugins.campaign.plan import CampaignPlan, PlanError, read_plan
from xitl_cli.plugins.campaign.report import campaign_sections
from xitl_cli.plugins.campaign.results import LINES, ResultTable
from xitl_cli.plugins.campaign.search_spec import AxisRange, SearchSpec, SensitivitySpec

WIND, CURRENT = "environment.wind.mean_mps", "environment.current.speed_mps"
TRACK = "mission.cross_track_max_m"
BISECTION = f"""
base: mitl
axes:
  {WIND}: {{from: 0, to: 20}}
  {CURRENT}: [0.0, 0.5]
keep: [{TRACK}]
verdicts: [{TRACK} < 2]
seeds: 100-101
search: {{width: 2, runs_per_point: 8}}
"""


def planned(tmp_path: Path, text: str) -> CampaignPlan:
    path = tmp_path / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return read_plan(path)


def track(values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
    """2 m in the median at a wind of 9 m/s, less by 4 m/s in a current of 0.5 m/s; every seed its own."""
    own = np.random.default_rng(seed).normal(0.0, 0.15)
    return {TRACK: 2.0 * values[WIND] / (9.0 - 8.0 * values[CURRENT]) + own}


@pytest.mark.medium
def test_one_axis_is_bisected_for_each_value_of_the_others(tmp_path: Path) -> None:
    table, told = imagined(planned(tmp_path, BISECTION), tmp_path / "out", track)
    assert [one.group for one in told] == [{CURRENT: 0.0}, {CURRENT: 0.5}]
    for one, boundary in zip(told, (9.0, 5.0), strict=True):
        assert isinstance(one.found, BoundaryFinding)
        assert one.found.outcome == Outcome.FOUND
        assert one.found.estimate is not None
        assert boundary in one.found.estimate.interval
        assert one.found.estimate.interval.width <= 2.0
    assert [row["number"] for row in table.rows] == list(range(1, len(table) + 1))
    first = [row["seed"] for row in table.rows if row[CURRENT] == 0.0]
    assert first == list(range(100, 100 + len(first)))  # each run a seed of its own, groups the same ones
    (said,) = [section for section in campaign_sections(table) if section.key == "boundary"]
    assert "Half of the runs fail at environment.wind.mean_mps = " in said.findings[0].sentence
    assert "they pass below and fail above" in said.findings[0].sentence
    assert len(said.findings) == 2


@pytest.mark.medium
def test_neither_workers_nor_a_break_change_the_table(tmp_path: Path) -> None:
    plan = planned(tmp_path, BISECTION)
    whole, told = imagined(plan, tmp_path / "whole", track, capacity=1)
    many, _ = imagined(plan, tmp_path / "many", track, capacity=40)
    lines = (tmp_path / "many" / LINES).read_text().splitlines(keepends=True)
    (tmp_path / "many" / LINES).write_text("".join(lines[: len(lines) // 2]))
    unfinished = ResultTable.read(tmp_path / "many")
    (said,) = [section for section in campaign_sections(unfinished) if section.key == "boundary"]
    assert "is not complete" in said.findings[0].sentence
    resumed, again = imagined(plan, tmp_path / "many", track, capacity=5, resume=True)
    assert repr(again) == repr(told)
    for other in (many, resumed):
        assert [row["key"] for row in other.rows] == [row["key"] for row in whole.rows]
        assert other.column(TRACK) == whole.column(TRACK)


@pytest.mark.medium
def test_broken_runs_say_nothing_of_the_vessel(tmp_path: Path) -> None:
    def some_break(values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
        return {"status": "failed"} if seed % 4 == 0 else track(values, seed)

    _, told = imagined(planned(tmp_path, BISECTION), tmp_path / "out", some_break)
    assert isinstance(told[0].found, BoundaryFinding)
    assert told[0].found.silent >= 10
    assert told[0].found.estimate is not None
    assert 9.0 in told[0].found.estimate.interval


EXPLORATION = f"""
base: mitl
axes:
  {WIND}: {{from: 0, to: 20}}
  {CURRENT}: {{from: 0, to: 1}}
keep: [{TRACK}]
verdicts: [{TRACK} < 2]
search: {{points: 40, runs_per_point: 2, nominal: {{{WIND}: 0, {CURRENT}: 0}}}}
"""


@pytest.mark.medium
def test_several_axes_are_explored(tmp_path: Path) -> None:
    """Fails beyond wind / 20 + current = 0.9: 0.636 of the ranges away, at 9 m/s and 0.45 m/s."""

    def plane(values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
        return {TRACK: 2.0 * (values[WIND] / 20 + values[CURRENT]) / 0.9}

    table, told = imagined(planned(tmp_path, EXPLORATION), tmp_path / "out", plane)
    again, _ = imagined(planned(tmp_path, EXPLORATION), tmp_path / "again", plane, capacity=17)
    assert [row["key"] for row in table.rows] == [row["key"] for row in again.rows]
    found = told[0].found
    assert isinstance(found, ExplorationFinding)
    assert found.outcome == Outcome.FOUND
    assert found.nearest is not None
    assert sum(found.nearest) == pytest.approx(0.9, abs=0.05)
    assert np.hypot(*found.nearest) == pytest.approx(0.636, rel=0.1)
    (said,) = [section for section in campaign_sections(table) if section.key == "boundary"]
    home = f"{WIND} = 0 m/s, {CURRENT} = 0 m/s"
    assert said.findings[0].sentence.startswith(
        f"The boundary of failure nearest to the nominal point ({home}) is at {WIND} = "
    )


@pytest.mark.parametrize(
    ("nominal", "said"),
    [
        (f"{WIND}: -3, {CURRENT}: 0", f"search.nominal has {WIND} = -3, outside the axis from 4 to 20"),
        (f"{CURRENT}: 0", f"search.nominal has {WIND} = 0 from the base, outside the axis from 4 to 20"),
        (f"{WIND}: 20.1, {CURRENT}: 0", f"search.nominal has {WIND} = 20.1, outside the axis from 4 to 20"),
        (f"{WIND}: 4, {CURRENT}: true", "search.nominal"),
    ],
)
def test_a_nominal_point_beyond_its_axes_is_refused(tmp_path: Path, nominal: str, said: str) -> None:
    plan = EXPLORATION.replace("from: 0, to: 20", "from: 4, to: 20").replace(f"{WIND}: 0, {CURRENT}: 0", nominal)
    with pytest.raises(PlanError) as told:
        planned(tmp_path, plan.replace("base: mitl", f"base: mitl\nset: {{{WIND}: 0}}"))
    assert said in str(told.value)


@pytest.mark.parametrize(
    ("was", "instead", "said"),
    [
        ("{from: 0, to: 20}", "[0, 20]", "search has no axis to search along; add one as {from: …, to: …}"),
        ("runs_per_point: 8", "runs_per_point: 0", "search.runs_per_point = 0 is too small"),
        ("runs_per_point: 8", "run_per_point: 8", "did you mean 'runs_per_point'"),
        ("runs_per_point: 8", "nominal: {wind: 3}", "search.nominal.wind is not a searched axis"),
        ("seeds: 100-101", "combine: one_at_a_time", "one_at_a_time has no effect, because search chooses the points"),
        ("seeds: 100-101", f"constraints: [{WIND} < 3]", "constraints do not apply to search"),
        ("seeds: 100-101", "sensitivity: {}", "search and sensitivity need separate plans"),
        ("to: 20}", "to: -20}", "must be the larger one"),
        ("{from: 0, to: 20}", "{from: -4, to: 20}", "is too small; use a value of at least 0"),
    ],
)  # fmt: skip
def test_a_search_that_cannot_be_is_refused_with_its_line(tmp_path: Path, was: str, instead: str, said: str) -> None:
    assert was in BISECTION
    with pytest.raises(PlanError) as told:
        planned(tmp_path, BISECTION.replace(was, instead))
    assert said in str(told.value)
    assert "plan.yaml:" in str(told.value)


@pytest.mark.medium
def test_the_largest_number_of_runs_of_a_search(tmp_path: Path) -> None:
    """400 for each boundary along one axis, 1000 along several, or as the plan says."""
    assert planned(tmp_path, BISECTION).most_runs() == 2 * 400
    assert planned(tmp_path, EXPLORATION).most_runs() == 1000
    assert planned(tmp_path, BISECTION.replace("width: 2", "width: 2, most_runs: 30")).most_runs() == 2 * 30


@pytest.mark.parametrize(
    ("axis", "values"),
    [
        (AxisRange(WIND, 4.0, 20.0), {0.0: 4.0, 0.25: 8.0, 0.5: 12.0, 1.0: 20.0}),
        (AxisRange(WIND, -3.0, 1.0), {0.25: -2.0, 0.75: 0.0}),
        (AxisRange(WIND, 0.5, 32.0, log=True), {0.0: 0.5, 1 / 6: 1.0, 0.5: 4.0, 5 / 6: 16.0, 1.0: 32.0}),
    ],
)
def test_a_share_of_an_axis_has_a_value(axis: AxisRange, values: dict[float, float]) -> None:
    for share, value in values.items():
        assert axis.value(share) == pytest.approx(value)
        assert axis.share(value) == pytest.approx(share)
    assert (axis.value(-0.1), axis.value(1.1)) == (axis.low, axis.high)


def test_values_of_an_axis_are_short_and_its_ends_exact() -> None:
    assert AxisRange(WIND, 0.0, 1.0).value(1.0 / 3.0) == 0.333333333333
    assert AxisRange(WIND, 0.0, 2.0 / 3.0).value(1.0) == 2.0 / 3.0


@pytest.mark.parametrize(
    ("key", "least", "largest"),
    [("runs_per_point", 1, 10_000), ("points", 2, 10_000), ("most_runs", 1, 10**6), ("batch", 1, 10**6)],
)
def test_numbers_of_runs_and_points_have_limits(key: str, least: int, largest: int) -> None:
    for value in (least, largest):
        assert getattr(SearchSpec(**{key: value}), key) == value  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=f"at least {least}"):
        SearchSpec(**{key: least - 1})  # type: ignore[arg-type]


@pytest.mark.parametrize("key", ["pass_rate", "confidence"])
def test_a_share_is_between_0_and_1(key: str) -> None:
    for share in (0.001, 0.999):
        assert getattr(SearchSpec(**{key: share}), key) == share  # type: ignore[arg-type]
    for share in (0.0, 1.0):
        with pytest.raises(ValueError, match="use a value"):
            SearchSpec(**{key: share})  # type: ignore[arg-type]


def test_the_runs_of_a_sensitivity_are_its_samples_by_the_axes() -> None:
    """Morris 1991: a step along each axis; Saltelli 2010: two samples, and one more for each axis."""
    assert SensitivitySpec(samples=10).places(3) == 40
    assert SensitivitySpec(method="sobol", samples=8).places(3) == 40
    assert SensitivitySpec(method="sobol", samples=2).places(1) == 6
    for samples, near in ((12, "use 8 or 16"), (3, "use 2 or 4"), (17, "use 16 or 32")):
        with pytest.raises(ValueError, match=near):
            SensitivitySpec(method="sobol", samples=samples)
    with pytest.raises(ValueError, match="at least 2"):
        SensitivitySpec(samples=1)
