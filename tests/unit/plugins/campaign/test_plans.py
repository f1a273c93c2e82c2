"""Plans: what they make of a base, and what is said of those that cannot be carried out, before anything runs."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import xitl
from tests.recorded_run import recorded_run
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign.axes import RunPoint
from xitl_cli.plugins.campaign.engine import check_figures
from xitl_cli.plugins.campaign.plan import CampaignPlan, PlanError, base_heads, find_plan, read_plan, seeds_of
from xitl_cli.profile.load import load_with_origins

CAMPAIGNS = Path(__file__).parents[4] / "campaigns"
BASE = "base: mitl\n"


def plan(tmp_path: Path, text: str, name: str = "plan.yaml") -> CampaignPlan:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return read_plan(path)


@pytest.mark.parametrize(
    ("given", "seeds"),
    [("1-4", (1, 2, 3, 4)), (3, (1, 2, 3)), ("7", (7,)), ("1-2, 9", (1, 2, 9)), ((5, 3), (5, 3)), ([0], (0,))],
)
def test_seeds(given: object, seeds: tuple[int, ...]) -> None:
    assert seeds_of(given) == seeds


def test_points_are_every_combination_with_every_seed(tmp_path: Path) -> None:
    found = plan(tmp_path, BASE + "axes:\n  environment.wind.mean_mps: [0, 4]\n  seeds: 1-2\n")
    assert list(found.points()) == [
        RunPoint(1, {"environment.wind.mean_mps": 0}, 1),
        RunPoint(2, {"environment.wind.mean_mps": 0}, 2),
        RunPoint(3, {"environment.wind.mean_mps": 4}, 1),
        RunPoint(4, {"environment.wind.mean_mps": 4}, 2),
    ]
    assert found.most_runs() == 4
    assert [verdict.text for verdict in found.verdicts] == ["driver.completed"]
    keys = {point.key(found.base.digest) for point in found.points()}
    assert len(keys) == 4
    assert keys.isdisjoint(point.key("another base") for point in found.points())


def test_a_plan_without_axes_is_the_base_with_its_own_seed(tmp_path: Path) -> None:
    assert list(plan(tmp_path, BASE).points()) == [RunPoint(1, {}, 1)]


@pytest.mark.medium
def test_the_command_of_a_run_makes_the_same_profile_as_its_task(tmp_path: Path) -> None:
    """What a person types to repeat a run against what a worker is sent, by the profiles that both load to."""
    text = BASE + (
        "set: {environment: {wind.mean_mps: 3}, mission.speed_mps: 0.9}\n"
        "axes:\n"
        "  extends.environment: [environments/calm, [environments/current-waves, vehicles/otter]]\n"
        "  environment.current.speed_mps: [0.2]\n"
        "  driver.kind: [mission]\n"
    )
    found = plan(tmp_path, text)
    for point in found.points():
        words = shlex.split(found.base.command(point))
        assert words[:3] == ["xitl", "sim", "mitl"]
        options = {"--with": [], "--set": [], "--seed": []}
        for name, value in zip(words[3::2], words[4::2], strict=True):
            options[name].append(value)
        seed = [f"clock.seed={value}" for value in options["--seed"]]
        typed = load_with_origins("mitl", [*options["--set"], *seed], options["--with"]).profile
        made = found.base.overrides(point)
        sent = tmp_path / "sent.yaml"
        sent.write_text(found.base.text(made.parts), encoding="utf-8")
        sets = [word for word in made.arguments if word not in ("--set", "--seed", str(point.seed))]
        assert load_with_origins(str(sent), [*sets, *seed]).profile == typed
        assert typed.environment is not None
        assert typed.environment.wind.mean_mps == 3
        assert typed.environment.current.speed_mps == 0.2


@pytest.mark.medium
def test_a_fault_is_switched_by_name(tmp_path: Path) -> None:
    own = "faults.mine: [off, on]"
    (tmp_path / "mine.yaml").write_text("extends: sitl\nfaults: {mine: {from_s: 5, imu: {freeze: true}}}\n")
    found = plan(tmp_path, f"base: mine.yaml\naxes:\n  {own}\n  faults.gnss-dropout: [on]\n")
    off, on = (found.base.check(point, {}).profile.faults for point in found.points())
    assert set(off or ()) == {"gnss-dropout"}
    assert set(on or ()) == {"mine", "gnss-dropout"}


def test_files_are_meant_from_the_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text("")
    (tmp_path / "boat.yaml").write_text("extends: sitl\n")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    found = plan(tmp_path, "base: boat.yaml\naxes:\n  autopilot.controller: [mine.py:Mine]\n")
    (point,) = found.points()
    assert found.base.overrides(point).values == (("autopilot.controller", f"{tmp_path / 'mine.py'}:Mine"),)


@pytest.mark.medium
def test_an_edited_base_or_axis_is_another_plan_and_a_description_is_not(tmp_path: Path) -> None:
    (tmp_path / "boat.yaml").write_text("extends: mitl\n")
    axes = "axes: {environment.wind.mean_mps: [0, 4]}\n"
    first = plan(tmp_path, "base: boat.yaml\n" + axes)
    assert plan(tmp_path, "base: boat.yaml\ndescription: wind\nlimits: {time_s: 9}\n" + axes).digest() == first.digest()
    assert plan(tmp_path, "base: boat.yaml\nseeds: 3\n" + axes).digest() != first.digest()
    (tmp_path / "boat.yaml").write_text("extends: mitl\nmission: {speed_mps: 0.7}\n")
    assert plan(tmp_path, "base: boat.yaml\n" + axes).digest() != first.digest()


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("axes: {environment.wind.men_mps: [1]}", 2, "did you mean 'mean_mps'"),
        ("axes:\n  wind.mean_mps: [1]", 3, "is not a known key"),
        ("axes: {environment.wind.mean_mps: [-1]}", 2, "use a value of at least 0"),
        ("axes: {environment.wind.mean_mps: [strong]}", 2, "is not a number"),
        ("axes: {environment.wind.mean_mps: []}", 2, "has no value"),
        ("axes: {faults.gnss-drpout: [on]}", 2, "did you mean faults.gnss-dropout"),
        ("axes: {faults.gnss-dropout: [maybe]}", 2, "write on or off"),
        ("axes: {extends.environment: [environments/clam]}", 2, "there is no profile 'environments/clam'"),
        ("set: {environment.wind.mean: 1}", 2, "is not a known key"),
        ("axis: {}", 2, "did you mean 'axes'"),
        ("seeds: 5-1", 2, "write 1-20"),
        ("seeds: 0", 2, "write 1-20"),
        ("seeds: [1, 1]", 2, "contains a seed twice"),
        ("axes: {seeds: 2}\nseeds: 3", 2, "remove one of them"),
        ("combine: all", 2, "use grid, latin_hypercube or one_at_a_time"),
        ("combine: latin_hypercube", 2, "needs `samples:`"),
        ("samples: 3", 2, "combine: latin_hypercube"),
        ("axes: {environment.wind.mean_mps: {uniform: [0, 1]}}", 2, "add count"),
        ("verdicts: [mission.cross_track_rms_m <]", 2, "is not a valid expression"),
        ("verdicts: [__import__('os')]", 2, "calls __import__, which is not a function here" ),
        ("verdicts: [1 < 2]", 2, "is the same in every run"),
        ("verdicts: [misson.cross_track_rms_m < 2]", 2, "did you mean mission.cross_track_rms_m"),
        ("keep: [estimatoin.position_rms_m]", 2, "did you mean estimation.position_rms_m"),
        ("constraints: [environment.wind.mean_mps < 2]", 2, "is not an axis of this plan"),
        ("recordings: some", 2, "use none, failures or all"),
        ("limits: {time_s: 0}", 2, "use a value above 0"),
        ("limits: {memory_gb: 1}", 2, "did you mean 'memory_mb'"),
        ("seeds: [1.5]", 2, "write 1-20"),
        ("seeds: [-1]", 2, "write 1-20"),
        ("seeds: 0-100000000", 2, "write 1-20"),
        ("samples: 3\ncombine: latin_hypercube", 3, "latin_hypercube needs axes"),
        ("keep: ['a b']", 2, "is not a figure; write for example"),
        ("keep: [zzz.rms_m]", 2, "is not a figure of a summary; docs/recording.md lists them"),
        ("axes: {extends: [[environments/calm]], extends.wind: [environments/calm]}", 2, "cannot be mixed"),
        ("axes: {environment.wind.mean_mps: {uniform: [0, 1]}}\nsensitivity: {}", 2, "add a second one"),
        ("sensitivity: {method: sobol, samples: 12}", 2, "= 12 is not a power of two; use 8 or 16"),
        ("axes: {environment.wind.mean_mps: {uniform: [0, 1]}, mission.speed_mps: {uniform: [1, 2]}}\n"
         "sensitivity: {figures: [duration_s]}\nkeep: []", 3, "duration_s is not kept; add it to `keep:`"),
        ("constraints: [environment.wind.mean_mps < 2]\naxes: {environment.wind.mean_mps: {uniform: [0, 1]}, "
         "mission.speed_mps: {uniform: [1, 2]}}\nsensitivity: {}", 2, "constraints do not apply to sensitivity"),
    ],
)  # fmt: skip
def test_a_plan_that_is_wrong_says_where_and_how(text: str, line: int, said: str, tmp_path: Path) -> None:
    with pytest.raises(PlanError) as error:
        plan(tmp_path, BASE + text + "\n")
    assert f"plan.yaml:{line}: " in str(error.value)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("base: mitll\n", "did you mean"),
        ("base: environments/calm\n", "is a part of a profile"),
        ("base: gone.yaml\n", "does not exist"),
        ("seeds: 3\n", "needs 'base'"),
        ("- a\n", "is a list"),
        ("base: [mitl\n", "is not valid YAML"),
    ],
)
def test_a_base_that_does_not_run_is_refused(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=said):
        plan(tmp_path, text)


def test_a_plan_that_is_away(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="does not exist; check the path"):
        find_plan(str(tmp_path / "gone.yaml"))
    with pytest.raises(UserError, match=r"is a folder; check the path; shipped plans: .*environments"):
        find_plan(str(tmp_path))
    assert find_plan("environments").name == "environments.yaml"
    with pytest.raises(UserError, match="does not exist"):
        find_plan("environments.yaml")  # a path


def test_a_sensitivity_has_a_run_for_each_place_and_seed(tmp_path: Path) -> None:
    axes = "axes: {environment.wind.mean_mps: {uniform: [0, 1]}, mission.speed_mps: {uniform: [1, 2]}}\nseeds: 3\n"
    assert plan(tmp_path, BASE + axes + "sensitivity: {samples: 8}\n").most_runs() == 8 * (2 + 1) * 3
    assert plan(tmp_path, BASE + axes + "sensitivity: {samples: 8, method: sobol}\n").most_runs() == 8 * (2 + 2) * 3
    assert plan(tmp_path, BASE + axes + "combine: latin_hypercube\nsamples: 5\n").most_runs() == 15


SUMMARY = {
    "mission": {"cross_track_rms_m": 1.0, "closest_m": [1.0]},
    "links": [{"name": "sensors", "lost": 0}],
    "companion": None,
    "driver": {"completed": True},
}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("verdicts: [mission.cross_track_rm < 2]", "did you mean mission.cross_track_rms_m"),
        ("verdicts: [links.1.lost == 0]", "did you mean links.0.lost"),
        ("keep: [mission]", "is a group of figures"),
        ("keep: [driver.compelted]", "did you mean driver.completed"),
        ("verdicts: [companion.detours < 3]", "have no companion"),
    ],
)
def test_a_figure_that_no_summary_has(text: str, said: str, tmp_path: Path) -> None:
    found = plan(tmp_path, BASE + text + "\n")
    with pytest.raises(PlanError, match=r"plan\.yaml:2: ") as error:
        check_figures(found, SUMMARY)
    assert said in str(error.value)
    check_figures(plan(tmp_path, BASE + "verdicts: [links.0.lost == 0, driver.completed]"), SUMMARY)


@pytest.fixture(scope="module")
def summary_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], dict[str, Any]]:
    @cache
    def ran(base: str) -> dict[str, Any]:
        own = {"clock.mode": "lockstep", "clock.duration_s": 0.5}
        return xitl.simulate(base, overrides=own, out=tmp_path_factory.mktemp("runs") / base).summary

    return ran


@pytest.mark.medium
@pytest.mark.parametrize("name", sorted(path.stem for path in CAMPAIGNS.glob("*.yaml")))
def test_a_shipped_plan_asks_for_figures_that_there_are(name: str, summary_of: Callable[[str], dict[str, Any]]) -> None:
    shipped = read_plan(find_plan(name))
    # What differs with stock firmware is not kept by the plan that compares two.
    base = "sitl" if shipped.base.name == "sitl-ardupilot" else shipped.base.name
    check_figures(shipped, summary_of(base))


@pytest.mark.slow
def test_the_sections_that_a_plan_knows_are_those_of_a_summary() -> None:
    summary = json.loads((recorded_run() / "summary.json").read_text(encoding="utf-8"))
    assert set(base_heads()) - {"vessels", "encounters"} == set(summary)
