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
