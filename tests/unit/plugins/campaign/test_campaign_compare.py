"""Two campaigns, or one split by an axis: pairs, counts, tests."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imagined_runs import imagined
from test_campaign_search import planned

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.compare import compare_by, compare_tables
from xitl_cli.plugins.campaign.report import comparison_section
from xitl_cli.plugins.campaign.results import ResultTable
from xitl_cli.plugins.campaign.statistics import holm

scipy = pytest.importorskip("scipy")

WIND, SPEED = "environment.wind.mean_mps", "mission.speed_mps"
TRACK, DURATION = "mission.cross_track_rms_m", "duration_s"
PLAN = f"""
base: mitl
axes:
  {SPEED}: [2, 3]
  {WIND}: [0, 5]
seeds: 1-10
keep: [{TRACK}, {DURATION}]
verdicts: [driver.completed, {TRACK} < 1.0]
"""


def figures(values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
    rng = np.random.default_rng([seed, round(values[SPEED]), round(values[WIND])])
    common = np.random.default_rng(seed).normal(0.8, 0.3)
    track = common + 0.1 * (values[SPEED] - 2.0) + rng.normal(0.0, 0.02)
    return {TRACK: track, DURATION: 150.0 + rng.normal(), "driver.completed": True}


def calm(values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
    return figures({**values, WIND: 0.0}, seed)


def table(tmp_path: Path, name: str, figures: Any = figures, plan: str = PLAN) -> ResultTable:
    (tmp_path / name).mkdir()
    return imagined(planned(tmp_path / name, plan), tmp_path / name / "out", figures)[0]


def test_one_campaign_split_by_an_axis_is_paired_by_the_others_and_the_seed(tmp_path: Path) -> None:
    runs = table(tmp_path, "one")
    (told,) = compare_by(runs, SPEED)
    assert (told.a, told.b, told.pairs, told.unpaired) == ("speed_mps = 2", "speed_mps = 3", 20, (0, 0))
    assert told.paired_by == (WIND,)
    slow, fast = (
        [row[TRACK] for row in sorted(runs.rows, key=lambda row: (row[WIND], row["seed"])) if row[SPEED] == speed]
        for speed in (2, 3)
    )
    of_seeds = (np.array(fast) - np.array(slow)).reshape(2, 10).mean(axis=0)
    theirs = scipy.stats.ttest_1samp(of_seeds, 0.0)
    track = next(one for one in told.figures if one.figure == TRACK)
    assert (track.difference.pairs, track.difference.clusters, told.seeds) == (20, 10, 10)
    assert track.difference.mean == pytest.approx(0.1, abs=0.02)
    assert track.difference.p_value == pytest.approx(theirs.pvalue)
    bounds = theirs.confidence_interval(0.95)
    assert track.difference.interval is not None
    assert (track.difference.interval.low, track.difference.interval.high) == pytest.approx((bounds.low, bounds.high))
    assert track.difference.wilcoxon_p_value == pytest.approx(scipy.stats.wilcoxon(of_seeds).pvalue)
    assert track.adjusted is not None
    assert track.adjusted >= theirs.pvalue
    unpaired = scipy.stats.ttest_ind(fast, slow).pvalue
    assert track.adjusted < 1e-5 < 0.05 < unpaired  # which pairs tell and groups do not


@pytest.mark.medium
def test_pass_rates_are_tested_over_seeds(tmp_path: Path) -> None:
    runs = table(tmp_path, "one")
    (told,) = compare_by(runs, SPEED)
    judged = next(one for one in told.verdicts if one.verdict == f"{TRACK} < 1.0")
    by_key = {(row[SPEED], row[WIND], row["seed"]): row[judged.verdict] for row in runs.rows}
    seeds = range(1, 11)
    only = [
        sum(by_key[a, wind, seed] and not by_key[b, wind, seed] for wind in (0, 5) for seed in seeds)
        for a, b in ((2, 3), (3, 2))
    ]
    assert [judged.rates.only_a, judged.rates.only_b] == only
    assert sum(only) > 1
    of_seeds = [sum(by_key[3, wind, seed] - by_key[2, wind, seed] for wind in (0, 5)) for seed in seeds]
    changes = np.array(list(itertools.product((-1, 1), repeat=10))) @ of_seeds  # all 1024 of them
    assert judged.rates.p_value == pytest.approx(np.mean(np.abs(changes) >= abs(sum(of_seeds))))
    assert judged.rates.p_value > scipy.stats.binomtest(only[1], sum(only)).pvalue  # which counts each pair
    assert f"{sum(only)} pairs" not in str(comparison_section(told).findings)


@pytest.mark.medium
def test_a_verdict_that_alone_fails_is_one_test_with_passed(tmp_path: Path) -> None:
    (told,) = compare_by(table(tmp_path, "one"), SPEED)  # all runs complete
    assert [(one.verdict, one.alike) for one in told.verdicts] == [
        ("driver.completed", ()),
        (f"{TRACK} < 1.0", ("passed",)),
    ]
    raw = [one.difference.p_value for one in told.figures] + [one.rates.p_value for one in told.verdicts]
    adjusted = [one.adjusted for one in (*told.figures, *told.verdicts)]
    assert adjusted == holm([value for value in raw if value is not None])
    assert len(adjusted) == 4
    rows = next(grid for grid in comparison_section(told).grids if grid.key == "verdicts").rows
    assert [row[0] for row in rows] == ["driver.completed", f"{TRACK} < 1.0 = passed"]


def test_pairs_of_one_seed_alone_give_neither_interval_nor_test(tmp_path: Path, golden: Golden) -> None:
    (told,) = compare_by(table(tmp_path, "one", plan=PLAN.replace("1-10", "[4]")), SPEED)
    assert (told.pairs, told.seeds) == (2, 1)
    assert {(one.difference.interval, one.difference.p_value) for one in told.figures} == {(None, None)}
    said = [finding.sentence for finding in comparison_section(told).findings]
    golden("message", said)


@pytest.mark.medium
def test_two_folders_and_runs_without_a_partner(tmp_path: Path) -> None:
    a = table(tmp_path, "a")
    b = table(tmp_path, "b", plan=PLAN.replace("1-10", "3-12"))
    told = compare_tables(a, b)
    assert (told.a, told.b) == ("a/out", "b/out")
    assert (told.pairs, told.unpaired) == (32, (8, 8))
    assert all(one.difference.mean == 0.0 for one in told.figures)
    said = [finding.sentence for finding in comparison_section(told).findings]
    assert said[0].startswith("No difference between A and B is significant")
    assert said[1].startswith("8 runs of A and 8 runs of B have no partner")


@pytest.mark.medium
def test_an_axis_that_differs_throughout_is_what_is_compared(tmp_path: Path) -> None:
    a = table(tmp_path, "a", plan=PLAN.replace("[2, 3]", "[2]"))
    b = table(tmp_path, "b", plan=PLAN.replace("[2, 3]", "[3]"))
    told = compare_tables(a, b)
    assert (told.pairs, told.paired_by) == (20, (WIND,))


@pytest.mark.medium
def test_figures_of_runs_that_did_not_complete_are_left_out_and_counted(tmp_path: Path) -> None:
    def halted(values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
        if seed <= 8:
            return {TRACK: 0.01, DURATION: 2.0, "driver.completed": False, "status": "incomplete"}
        return figures(values, seed)

    told = compare_tables(table(tmp_path, "a"), table(tmp_path, "b", halted))
    assert (told.pairs, told.incomplete) == (40, 32)
    assert {one.difference.pairs for one in told.figures} == {8}
    completed = next(one for one in told.verdicts if one.verdict == "driver.completed")
    assert (completed.rates.pairs, completed.rates.only_a, completed.rates.only_b) == (40, 32, 0)
    assert completed.adjusted < 0.05
    assert any("B passes 'driver.completed' less often" in one.sentence for one in comparison_section(told).findings)


@pytest.mark.medium
def test_what_cannot_be_compared_is_said(tmp_path: Path) -> None:
    a = table(tmp_path, "a")
    with pytest.raises(UserError, match=r"--by mission\.speed: is not an axis of .*; its axes:"):
        compare_by(a, "mission.speed")
    with pytest.raises(UserError, match="use the same seeds for both campaigns"):
        compare_tables(a, table(tmp_path, "b", plan=PLAN.replace("1-10", "21-30")))
    with pytest.raises(UserError, match=f"{WIND} varies only in .*"):
        compare_tables(a, table(tmp_path, "c", calm, PLAN.replace(f"  {WIND}: [0, 5]\n", "")))
