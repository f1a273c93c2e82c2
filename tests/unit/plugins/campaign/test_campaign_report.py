"""What a campaign says of itself, and its page."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from imagined_runs import imagined
from test_campaign_search import BISECTION, CURRENT, TRACK, WIND, planned, track

from tests.golden import Golden
from tools.write_figures import figures_table, with_table
from xitl_cli.plugins.campaign.report import campaign_sections, limits, write_report

pytest.importorskip("scipy")

ENVIRONMENTS = """
base: sitl
axes:
  extends.environment: [environments/calm, environments/current-waves]
seeds: 1-21
keep: [mission.cross_track_rms_m, mission.cross_track_max_m, estimation.position_rms_m, estimation.heading_rms_deg]
verdicts: [driver.completed, mission.cross_track_max_m < 5]
recordings: none
"""


def test_limits_are_those_of_verdicts_with_one_figure_and_one_number() -> None:
    (track, clear) = limits(["a.b < 2", "a.b < c.d", "driver.completed", "obstacles.min_clearance_m >= 0.5"])
    assert (track.figure, track.value, track.upper) == ("a.b", 2.0, True)
    assert (clear.figure, clear.value, clear.upper) == ("obstacles.min_clearance_m", 0.5, False)


@pytest.mark.medium
def test_the_page_has_its_plots_and_the_commands_that_repeat_runs(tmp_path: Path) -> None:
    table, _ = imagined(planned(tmp_path, BISECTION), tmp_path / "out", track)
    page = write_report(table).read_text(encoding="utf-8")
    assert (tmp_path / "out/report.html").is_file()
    titles = re.findall(r"<figcaption><h3>(.*?)</h3>", page)
    for begin in (
        "Pass rate along",
        "Boundary along",
        "Pass and fail over",
        f"{TRACK} by {CURRENT}",
        f"{TRACK}, all runs",
    ):
        assert any(title.lower().startswith(begin.lower()) for title in titles), begin
    figures = [json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page)]
    boundary = next(one["figure"] for one in figures if one.get("figure", {}).get("data", [{}])[0].get("name"))
    band = next(shape for shape in boundary["layout"]["shapes"] if shape["type"] == "rect")
    assert 0 < band["x1"] - band["x0"] <= 2.0
    assert f"xitl sim mitl --set {CURRENT}=0.5 --set {WIND}=20.0 --seed " in page
    worst = next(section for section in campaign_sections(table) if section.key == "worst").grids[0]
    values = [row[1] for row in worst.rows]
    assert values[0] == max(values)


def test_pictures_show_the_runs_that_count(tmp_path: Path) -> None:
    """Of seeds 1 to 21 the last one ends halfway, with a figure that is not to be seen."""

    def figures(values: object, seed: int) -> dict[str, object]:
        told = dict.fromkeys(re.findall(r"[\w.]+_(?:m|deg)\b", ENVIRONMENTS.split("keep:")[1]), 0.1 * seed)
        return {**told, "driver.completed": seed < 21, "status": "incomplete" if seed == 21 else "completed"}

    table, _ = imagined(planned(tmp_path, ENVIRONMENTS), tmp_path / "out", figures)
    (section,) = [section for section in campaign_sections(table) if section.key == "figures"]
    assert {grid.rows[0][4] for grid in section.grids} == {2}  # the worst
    drawn = [data.get("x") or data["y"] for plot in section.plots for data in plot.figure["data"]]  # type: ignore[index]
    assert len(drawn) > len(section.grids)
    assert {max(values) for values in drawn} == {2.0}


def test_the_table_of_the_readme(tmp_path: Path, golden: Golden) -> None:
    """21 runs whose figures are 0, 0.1 to 2.0: median 1.0, 95th percentile 1.9; one does not complete."""

    def figures(values: object, seed: int) -> dict[str, object]:
        told = dict.fromkeys(re.findall(r"[\w.]+_(?:m|deg)\b", ENVIRONMENTS.split("keep:")[1]), 0.1 * (seed - 1))
        return {**told, "driver.completed": True}

    table, _ = imagined(planned(tmp_path, ENVIRONMENTS), tmp_path / "out", figures)
    told = figures_table(table).splitlines()
    golden("table", told[:4])
    # The parts of profiles are not in a run's arguments, so that both environments are alike here.
    assert told[2].count("1.00 m, 1.90 m") == 3
    assert told[3].startswith("| current-waves | 21 of 21 |")
    page = "before\n<!-- figures -->\nold\n<!-- end of figures -->\nafter\n"
    assert with_table(page, "new") == "before\n<!-- figures -->\n\nnew\n\n<!-- end of figures -->\nafter\n"
    with pytest.raises(ValueError, match="has no place for figures"):
        with_table("nothing", "new")


ONE_AT_A_TIME = f"""
base: sitl
axes:
  {WIND}: [4.9, 5.1]
  {CURRENT}: [0.45, 0.55]
  autopilot.controller: ["examples/sliding_mode_heading.py:SlidingModeHeading"]
combine: one_at_a_time
seeds: 1-3
keep: [{TRACK}]
verdicts: [{TRACK} < 99]
"""


@pytest.mark.medium
def test_a_one_at_a_time_plan_tells_elasticities_about_its_base(tmp_path: Path, golden: Golden) -> None:
    """wind² / current about 5 m/s and 0.5 m/s: 2 and -1; a controller has none, and that is said."""
    (tmp_path / "examples").symlink_to(Path(__file__).parents[4] / "examples")

    def power_law(values: dict[str, float], seed: int) -> dict[str, float]:
        return {TRACK: seed * values.get(WIND, 5.0) ** 2 / values.get(CURRENT, 0.5)}

    table, _ = imagined(planned(tmp_path, ONE_AT_A_TIME), tmp_path / "out", power_law)
    told = next(section for section in campaign_sections(table) if section.key == "elasticity")
    (grid,) = told.grids
    found = {row[0]: row[1] for row in grid.rows}
    assert found == {WIND: pytest.approx(2.0, abs=0.01), CURRENT: pytest.approx(-1.0, abs=0.02)}
    golden("text", told.lacks)


SENSITIVITY = f"""
base: mitl
axes:
  {WIND}: {{uniform: [0, 10]}}
  {CURRENT}: {{from: 0, to: 1}}
seeds: 1-2
keep: [{TRACK}, duration_s]
sensitivity: {{method: morris, samples: 8}}
"""


@pytest.mark.medium
def test_a_sensitivity_plan_ranks_its_axes(tmp_path: Path) -> None:
    """2 m over the whole range of the wind, 0.5 m over that of the current; a figure that never varies says nothing."""
    table, _ = imagined(
        planned(tmp_path, SENSITIVITY),
        tmp_path / "out",
        lambda values, seed: {TRACK: 0.2 * values[WIND] - 0.5 * values[CURRENT] + seed, "duration_s": 60.0},
    )
    assert len(table) < 8 * 3 * 2  # Morris comes by some places repeatedly
    assert len({(row[WIND], row[CURRENT], row["seed"]) for row in table.rows}) == len(table)
    told = next(section for section in campaign_sections(table) if section.key == "sensitivity")
    assert [row[:2] for row in told.grids[0].rows] == [
        (WIND, pytest.approx(2.0, rel=1e-3)),
        (CURRENT, pytest.approx(0.5, rel=1e-3)),
    ]
    assert told.grids[0].title == f"{TRACK} (8 groups of runs)"
    assert told.findings[0].sentence.startswith(f"{TRACK}: {WIND} has the largest effect (mu* = 2")


@pytest.mark.medium
@pytest.mark.parametrize(("current_m", "alike"), [(2.0, True), (0.2, False)])
def test_axes_whose_intervals_overlap_are_not_told_apart(tmp_path: Path, current_m: float, alike: bool) -> None:
    """Of 2 m + 0.3 m by the wind and `current_m` + 0.3 m by the current, where the other axis scales the 0.3 m."""

    def figures(values: Any, seed: int) -> dict[str, object]:
        wind, current = 0.1 * values[WIND], values[CURRENT]
        return {TRACK: 2.0 * wind + current_m * current + 0.3 * wind * current, "duration_s": 60.0}

    table, _ = imagined(planned(tmp_path, SENSITIVITY), tmp_path / "out", figures)
    told = next(section for section in campaign_sections(table) if section.key == "sensitivity")
    assert ("not distinguishable from it" in told.findings[0].sentence) is alike
