"""One identification of a simulated boat, whose values are known: what it returns and what is shown of it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pool import COLUMNS, boat, pool_run, write_table

pytest.importorskip("scipy")

from sim_core.environment.spec import Water
from xitl_cli.errors import UserError
from xitl_cli.main import main
from xitl_cli.plugins.identify import identification
from xitl_cli.plugins.identify.free_keys import FreeKey
from xitl_cli.plugins.identify.identification import (
    Identification,
    KeyEstimate,
    Settings,
    _check_follows,
    _correlated,
    _estimate,
    identify,
    plane_figures,
    reached_speeds,
    split,
)
from xitl_cli.plugins.identify.identification_page import findings, sections, vehicle_text
from xitl_cli.plugins.identify.prediction import MODELS, LinearModel, Score
from xitl_cli.plugins.identify.recording import Floats, Recording, Samples
from xitl_cli.profile import load_profile

YAW, HEAVE = "damping_linear.yaw", "added_mass.heave_kg"
RUN_S, WINDOW_S = 60.0, 5.0


@cache
def run() -> Recording:
    return pool_run(boat(), RUN_S)


@cache
def identified() -> Identification:
    """Begins with two thirds of the yaw damping. No motion in the plane shows the added mass in heave."""
    true = boat().damping_linear
    start = replace(boat(), damping_linear=replace(true, yaw=0.67 * true.yaw))
    settings = Settings(free=(YAW, HEAVE), wind=False, window_s=WINDOW_S)
    return identify([run()], start, Water(), settings)


def scores() -> dict[tuple[str, float], Score]:
    return {(own.model, own.horizon_s): own for own in identified().scores}


@pytest.mark.medium
def test_a_key_that_the_log_shows_is_found_and_another_is_said_to_be_unknown() -> None:
    yaw, heave = identified().keys
    true = boat().damping_linear.yaw
    assert (yaw.key, heave.key) == (YAW, HEAVE)
    assert yaw.start == pytest.approx(0.67 * true)
    assert yaw.value == pytest.approx(true, rel=0.05)
    assert abs(yaw.value - true) < 4.0 * yaw.sigma
    assert yaw.advice == ""
    assert heave.sigma > 0.9 * heave.value  # as before the fit: a factor of e
    assert heave.advice == "vary what this key acts on more, and fix it with --fix until then"
    assert identified().vessel.damping_linear.yaw == yaw.value
    assert identified().start.damping_linear.yaw == yaw.start


@pytest.mark.medium
def test_the_current_of_the_pool_is_found() -> None:
    found = {name: (value, sigma, unit) for _, name, value, sigma, unit in identified().nuisance}
    assert found["current north"][0] == pytest.approx(0.2, abs=0.02)
    assert found["current east"][0] == pytest.approx(-0.15, abs=0.02)
    assert found["current north"][2] == "m/s"
    assert 0.0 < found["current north"][1] < 0.02
    assert abs(found["command delay"][0]) < 0.05
    assert [row[0] for row in identified().nuisance] == ["all"] * 3 + ["pool-1"] * 6
    assert identified().noise["yaw"] == pytest.approx(math.radians(0.3), rel=0.3)
    assert identified().noise["north"] == pytest.approx(0.02, rel=0.3)


@pytest.mark.medium
def test_the_last_third_of_the_run_is_predicted() -> None:
    assert identified().trained == identified().tested == ("pool-1",)
    # 0.7 of the run but for the 2 s before the first window
    assert identified().windows == 7
    assert [own.horizon_s for own in identified().scores] == [1.0] * 4 + [5.0] * 4 + [10.0] * 4  # 30 s do not fit
    assert [own.model for own in identified().scores] == list(MODELS) * 3
    for horizon_s in (1.0, 5.0, 10.0):
        own, start, kept = (scores()[model, horizon_s].errors for model in ("identified", "start", "persistence"))
        assert own[2] < start[2] < kept[2]  # rate of turn
        assert own[4] < start[4] < kept[4]  # heading
    assert scores()["identified", 10.0].errors[3] < 0.3  # m


def kept_path(start: Floats, time_s: Floats) -> Floats:
    """Path and yaw of a boat that keeps the velocity ahead, to starboard and of the yaw, in closed form."""
    north, east, yaw, ahead, right, rate = start
    turn = yaw + rate * time_s
    return np.column_stack(
        [
            north + (ahead * (np.sin(turn) - np.sin(yaw)) + right * (np.cos(turn) - np.cos(yaw))) / rate,
            east + (-ahead * (np.cos(turn) - np.cos(yaw)) + right * (np.sin(turn) - np.sin(yaw))) / rate,
            turn,
        ]
    )


@pytest.mark.medium
@pytest.mark.parametrize(("horizon_s", "every_s"), [(1.0, 2.0), (5.0, 5.0)])
def test_the_errors_of_persistence_by_hand(horizon_s: float, every_s: float) -> None:
    first_s, last_s = run().span_s
    tested = run().part(last_s - 0.3 * (last_s - first_s), last_s)
    begins = np.arange(tested.span_s[0] + 2.0, tested.span_s[1] - horizon_s, every_s)
    time_s = np.arange(1, round(horizon_s / 0.2) + 1) * 0.2
    velocity, place, heading = [], [], []
    for begin_s in begins:
        (start,) = tested.motion_at(np.array([begin_s]))
        measured = tested.motion_at(begin_s + time_s)
        path = kept_path(start, time_s)
        velocity.append((start[3:] - measured[:, 3:]) ** 2)
        place.append(np.sum((path[-1, :2] - measured[-1, :2]) ** 2))
        heading.append((path[-1, 2] - measured[-1, 2]) ** 2)
    of = scores()["persistence", horizon_s]
    assert of.windows == len(begins)
    assert of.errors[:3] == pytest.approx(np.sqrt(np.mean(velocity, axis=(0, 1))), rel=1e-6)
    assert of.errors[3] == pytest.approx(math.sqrt(np.mean(place)), rel=0.02)  # chords of 0.2 s
    assert of.errors[4] == pytest.approx(math.degrees(math.sqrt(np.mean(heading))), rel=1e-6)


@pytest.mark.medium
def test_predictions_are_shown_next_to_what_was_measured() -> None:
    shown = identified().predictions
    first_s, last_s = run().span_s
    tested = run().part(last_s - 0.3 * (last_s - first_s), last_s)
    assert [own.source for own in shown] == ["pool-1"] * scores()["identified", 10.0].windows
    for own in shown:
        assert own.time_s == pytest.approx(own.time_s[0] + 0.2 * np.arange(51))
        assert own.measured == pytest.approx(tested.motion_at(own.time_s)[:, 3:])
        of_run, of_start = (np.sqrt(np.mean((one - own.measured) ** 2, axis=0)) for one in (own.predicted, own.before))
        assert np.all(of_run < [0.1, 0.05, 0.05])
        assert of_start[2] > 2.0 * of_run[2]


@pytest.mark.medium
def test_inertia_and_damping_are_those_of_the_vessel_at_the_speeds_that_it_reached() -> None:
    first_s, last_s = run().span_s
    trained = run().part(first_s, last_s - 0.3 * (last_s - first_s))
    speeds = reached_speeds([trained])
    time_s = np.arange(*trained.span_s, 0.5)
    assert np.mean(np.abs(trained.motion_at(time_s)[:, 3]) <= speeds[0]) == pytest.approx(0.8, abs=0.02)
    vessel, yaw = identified().vessel, identified().keys[0]
    found = {own.name: own for own in identified().figures}
    names = [f"inertia in {axis}" for axis in ("surge", "sway", "yaw")]
    names += [f"damping in surge at {speeds[0]:.2g} m/s", f"damping in sway at {speeds[1]:.2g} m/s"]
    names += [f"damping in yaw at {speeds[2]:.2g} rad/s"]
    assert list(found) == names
    assert [own.unit for own in found.values()] == ["kg", "kg", "kg m²", "N s/m", "N s/m", "N m s"]
    surge = found[names[0]]
    assert surge.value == pytest.approx(vessel.mass_kg + vessel.added_mass.surge_kg)
    assert surge.sigma == pytest.approx(0.0, abs=1e-9)  # no free key acts on it
    linear, quadratic = vessel.damping_linear, vessel.damping_quadratic
    assert found[names[3]].value == pytest.approx(linear.surge + quadratic.surge * speeds[0])
    turning = found[names[5]]
    others = plane_figures(replace(vessel, damping_linear=replace(linear, yaw=0.0)), Water(), speeds)[5]
    assert turning.value == pytest.approx(yaw.value + others)
    assert turning.sigma == pytest.approx(yaw.sigma, rel=0.01)


@pytest.mark.medium
def test_the_document_has_all_of_it() -> None:
    told = json.loads(json.dumps(identified().as_json(), allow_nan=False))
    yaw, heave = identified().keys
    assert told["vehicle"] == "asv-third"
    assert told["keys"][YAW] == {"start": yaw.start, "value": yaw.value, "sigma": yaw.sigma, "advice": ""}
    assert told["keys"][HEAVE]["advice"] == heave.advice
    assert told["figures"]["inertia in surge"]["unit"] == "kg"
    assert (told["trained"], told["tested"], told["windows"]) == (["pool-1"], ["pool-1"], 7)
    (score,) = [own for own in told["scores"] if own["model"] == "linear" and own["horizon_s"] == 5.0]
    assert score["position (m)"] == scores()["linear", 5.0].errors[3]
    assert score["windows"] == scores()["linear", 5.0].windows
    assert told["nuisance"][3][:2] == ["pool-1", "current north"]


@pytest.mark.medium
def test_the_page_shows_tables_and_plots() -> None:
    vehicle, predictions, surroundings = sections(identified())
    (undetermined,) = vehicle.findings
    assert undetermined.sentence.startswith(f"{HEAVE} is not determined: ")
    assert undetermined.next_step.startswith("Vary what this key acts on more")
    figures, keys = vehicle.grids
    yaw = identified().keys[0]
    assert keys.rows[0][0] == YAW
    assert keys.rows[0][1:4] == pytest.approx((yaw.start, yaw.value, yaw.sigma), rel=0.05)
    assert figures.rows[0][0] == "inertia in surge"
    (grid,) = predictions.grids
    assert grid.rows[0][:2] == (1.0, "identified")
    assert len(grid.rows) == 12
    plots = predictions.plots
    assert len(plots) == 3 * len(identified().predictions)
    shown = identified().predictions[0]
    for axis, (plot, label) in enumerate(zip(plots, ("surge (m/s)", "sway (m/s)", "yaw rate (rad/s)"), strict=False)):
        assert plot.title == f"pool-1 from {shown.time_s[0]:.0f} s: {label.partition(' (')[0]}"
        assert plot.y_label == label
        drawn = [trace.y for trace in plot.traces]
        assert np.array_equal(drawn, [own[:, axis] for own in (shown.measured, shown.predicted, shown.before)])
    nuisance, noise = surroundings.grids
    assert nuisance.rows[3][:2] == ("pool-1", "current north")
    assert {row[0] for row in noise.rows} == {"north", "east", "yaw", "yaw_rate"}


def result_of(scores: tuple[Score, ...] = (), **parts: Any) -> Any:
    return SimpleNamespace(**{"keys": (), "correlated": (), "scores": scores} | parts)


def score(model: str, *errors: float, horizon_s: float = 5.0) -> Score:
    return Score(model, horizon_s, 9, (*errors, 1.0, 1.0))


def test_correlated_keys_are_named() -> None:
    (found,) = findings(result_of(correlated=(("a", "b", -0.953),)))
    assert found.sentence == "a and b are correlated (-0.95): their errors compensate"


@pytest.mark.parametrize(("linear", "named"), [(0.081, []), (0.079, ["sway (m/s)"])])
def test_a_linear_model_that_predicts_clearly_better_is_named(linear: float, named: list[str]) -> None:
    """Clearly: below 0.8 of the vehicle's error."""
    own = (score("identified", 0.1, 0.1, 0.1), score("persistence", 1.0, 1.0, 1.0))
    found = findings(result_of((*own, score("linear", 0.2, linear, 0.2))))
    assert [one.key for one in found] == ["identify.linear"] * len(named)
    for one, motion in zip(found, named, strict=True):
        assert f"a linear model predicts the {motion} better: {linear:g} after 5 s, and 0.1 by" in one.sentence


def test_the_file_of_the_vehicle_names_logs_values_and_what_is_unknown() -> None:
    profile = load_profile("vehicles/asv-third")
    keys = (KeyEstimate(YAW, 0.8, 1.0691, 0.0123, ""), KeyEstimate(HEAVE, 4.0, 5.0, 4.9, "vary it"))
    found: Any = SimpleNamespace(keys=keys, trained=("logs/a.bin", "b.bin"), vessel=profile.vehicle)
    text = vehicle_text(found, profile, "vehicles/asv-third", "xitl identify vessel")
    lines = text.splitlines()
    assert lines[:5] == [
        "# Identified by `xitl identify vessel`",
        "# from a.bin, b.bin.",
        "#",
        f"# {YAW}: 1.069 ± 0.012 (before 0.8)",
        f"# {HEAVE}: 5 ± 4.9 (before 4); not determined: vary it",
    ]
    assert lines[5:7] == ["extends: vehicles/asv-third", "vehicle:"]
    assert all(line.startswith((" ", "-")) for line in lines[7:])


def test_a_linear_model_of_linear_motion() -> None:
    """u' = 0.8 n|n| - 0.5 u + 0.1, and the rate of turn by the difference of both: solved exactly from step to step."""
    draw = np.random.default_rng(3)
    command_s = np.arange(0.0, 121.0, 3.0)
    commands = draw.uniform(-1.0, 1.0, (len(command_s), 2))
    time_s = np.arange(0.0, 120.0, 0.02)
    u, r = np.zeros(len(time_s)), np.zeros(len(time_s))
    for step in range(1, len(time_s)):
        port, starboard = commands[np.searchsorted(command_s, time_s[step - 1], side="right") - 1]
        thrust = 0.8 * (port * abs(port) + starboard * abs(starboard)) + 0.1
        moment = 0.6 * (port * abs(port) - starboard * abs(starboard))
        u[step] = thrust / 0.5 + (u[step - 1] - thrust / 0.5) * math.exp(-0.5 * 0.02)
        r[step] = moment / 1.5 + (r[step - 1] - moment / 1.5) * math.exp(-1.5 * 0.02)
    channels = {
        "surge": Samples(time_s, u),
        "sway": Samples(time_s, 0.0 * u),
        "yaw": Samples(time_s, np.cumsum(r) * 0.02),
        "yaw_rate": Samples(time_s, r),
    }
    linear = LinearModel.from_recordings([Recording("made", channels, command_s, commands)])  # type: ignore[arg-type]
    by_hand = np.zeros((6, 3))
    by_hand[0, 0], by_hand[3:5, 0], by_hand[5, 0] = -0.5, 0.8, 0.1
    by_hand[2, 2], by_hand[3:5, 2] = -1.5, (0.6, -0.6)
    assert linear.matrix == pytest.approx(by_hand, abs=0.08)  # the motion is smoothed over 0.6 s
    exact = LinearModel(by_hand)
    found = exact.velocities(np.array([[1.0, 0.0, 0.2]]), np.full((1, 10, 2), [0.5, -0.5]))
    assert found.shape == (11, 1, 3)
    at_s = 0.2 * np.arange(11)
    assert found[:, 0, 0] == pytest.approx(0.2 + 0.8 * np.exp(-0.5 * at_s), abs=1e-3)  # 0.1 / 0.5 is left
    assert found[:, 0, 2] == pytest.approx(0.2, abs=1e-12)  # 0.6 (0.25 + 0.25) / 1.5


@pytest.mark.medium
def test_the_command_shows_tables_and_writes_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[Any, ...]] = []

    def known(*arguments: Any) -> Identification:
        asked.append(arguments)
        return identified()

    monkeypatch.setattr(identification, "identify", known)
    monkeypatch.setenv("COLUMNS", "200")
    columns, table = tmp_path / "columns.yaml", write_table(run(), tmp_path / "run.csv")
    columns.write_text(COLUMNS, encoding="utf-8")
    out, page = tmp_path / "mine.yaml", tmp_path / "page.html"
    words = ["vessel", table, "--columns", columns, "--vehicle", "vehicles/asv-third", "--window", "5", "--no-wind"]
    words += ["--free", YAW, "--free", HEAVE, "--fix", "damping_linear.surge", "--squares", "--no-surroundings"]
    monkeypatch.setattr("sys.argv", ["xitl", "identify", *map(str, words), "--out", str(out), "--report", str(page)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    ((recordings, vessel, _, settings, tested, _),) = asked
    assert [own.source for own in recordings] == [str(table)]
    assert vessel == boat()
    assert settings == Settings((YAW, HEAVE), ("damping_linear.surge",), 5.0, False, False, False)
    assert tested == []
    told = capsys.readouterr().out
    assert "asv-third: 7 windows of 1 logs fitted; tested on their last 30 %" in told
    rows = [line.split() for line in told.splitlines()]
    (shown,) = [row for row in rows if row[:1] == [YAW]]
    yaw = identified().keys[0]
    assert [float(cell) for cell in shown[1:4]] == pytest.approx([yaw.start, yaw.value, yaw.sigma], rel=0.05)
    (linear,) = [row for row in rows if row[:2] == ["10", "linear"]]
    assert float(linear[6]) == pytest.approx(scores()["linear", 10.0].errors[3], rel=0.01)
    assert f"{HEAVE} is not determined" in " ".join(told.split())
    assert f"written: {out}" in told
    assert f"written: {page}" in told
    assert load_profile(str(out)).vehicle == identified().vessel
    assert "Identification of asv-third" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--motion", "gps"), "--motion gps: use estimate or receiver"),
        (("--vehicle", "calm"), "has no vehicle; use a file with one group `vehicle`"),
    ],
)
def test_what_the_command_refuses(
    words: tuple[str, ...], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["vessel", "run.bin", *(() if "--vehicle" in words else ("--vehicle", "vehicles/asv-third")), *words]
    monkeypatch.setattr("sys.argv", ["xitl", "identify", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.medium
def test_too_few_windows() -> None:
    with pytest.raises(UserError, match=r"have 2 windows of 10 s to fit; record 60 s"):
        identify([pool_run(boat(), 36.0)], boat(), Water(), Settings(free=(YAW,), wind=False))


def straight(source: str, length_s: float = 100.0) -> Recording:
    time_s = np.arange(0.0, length_s + 0.1, 0.1)
    channels: Any = dict.fromkeys(("north", "east", "yaw"), Samples(time_s, 0.0 * time_s))
    return Recording(source, channels, np.array([0.0, length_s]), np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("names", "named", "trained", "tested"),
    [
        ("abc", "b", "ac", "b"),
        ("abc", "ca", "b", "ac"),
        ("ab", "a", "b", "a"),
        ("abc", "", "ab", "c"),
        ("abcdefg", "", "abdeg", "cf"),
    ],
)
def test_named_logs_are_tested_or_every_third(names: str, named: str, trained: str, tested: str) -> None:
    fitted, predicted = split([straight(name) for name in names], list(named))
    assert "".join(own.source for own in fitted) == trained
    assert "".join(own.source for own in predicted) == tested


@pytest.mark.parametrize("names", ["a", "ab"])
def test_of_one_or_two_logs_the_last_30_percent_are_tested(names: str) -> None:
    for part, begin_s, end_s in zip(
        split([straight(name) for name in names], ()), (0.0, 70.0), (70.0, 100.0), strict=True
    ):
        assert [own.source for own in part] == list(names)
        for own in part:
            time_s = own.channels["yaw"].time_s
            assert (time_s[0], time_s[-1]) == pytest.approx((begin_s, end_s), abs=0.11)


def test_logs_to_test_that_cannot_be() -> None:
    with pytest.raises(UserError, match="--test c is none of the logs"):
        split([straight("a"), straight("b")], ["c"])
    with pytest.raises(UserError, match="--test names all logs"):
        split([straight("a"), straight("b")], ["b", "a"])


@pytest.mark.parametrize(
    ("surge", "rate", "horizon_s", "refused"),
    [
        (0.16, 0.032, 5.0, True),
        (0.16, 0.028, 5.0, False),  # the other is well predicted
        (0.14, 0.032, 5.0, False),
        (0.16, 0.032, 10.0, False),
    ],
)
def test_a_model_half_as_bad_again_as_a_linear_one_cannot_follow(
    surge: float, rate: float, horizon_s: float, refused: bool
) -> None:
    found = (
        score("identified", surge, 0.0, rate, horizon_s=horizon_s),
        score("linear", 0.1, 0.1, 0.02, horizon_s=horizon_s),
    )
    if not refused:
        _check_follows(found)
        return
    with pytest.raises(
        UserError, match=r"0.16 m/s in surge and 0.03 rad/s in yaw rate, those of a linear model 0.10 and"
    ):
        _check_follows(found)


@pytest.mark.parametrize(
    ("x", "sigma", "determined"),
    [
        (0.0, 0.29, True),
        (0.0, 0.31, False),
        (1.24, 0.01, True),  # 2.5 prior deviations of 0.5
        (1.26, 0.01, False),
        (-1.26, 0.01, False),
    ],
)
def test_a_key_is_determined_by_a_small_error_near_the_start(x: float, sigma: float, determined: bool) -> None:
    found = _estimate(FreeKey(YAW, (), 2.0), x, sigma, 0.5)
    assert (found.value, found.sigma) == pytest.approx((2.0 * math.exp(x), 2.0 * math.exp(x) * sigma))
    assert (found.advice == "") is determined
    if not determined:
        assert found.advice.startswith("turn on the spot")


@pytest.mark.parametrize(
    ("key", "advice"),
    [
        ("actuation.reverse_share", "hold half throttle astern"),
        ("actuation.spin_up_s", "change the throttle in steps"),
        ("damping_linear.sway", "turn hard while coasting"),
        ("inertia_kgm2.2", "turn on the spot"),
        ("damping_linear.surge", "accelerate in steps"),
        ("rudders.0.lift", "sail zig-zags"),
        (HEAVE, "vary what this key acts on more"),
    ],
)
def test_a_manoeuvre_is_proposed_for_a_key_that_is_not_determined(key: str, advice: str) -> None:
    assert _estimate(FreeKey(key, (), 1.0), 0.0, 1.0, 0.5).advice.startswith(advice)


def test_keys_are_correlated_above_nine_tenths() -> None:
    sigma, correlation = (
        np.array([0.1, 2.0, 30.0]),
        np.array([[1.0, 0.89, -0.91], [0.89, 1.0, 0.95], [-0.91, 0.95, 1.0]]),
    )
    covariance = correlation * np.outer(sigma, sigma)
    fitted: Any = SimpleNamespace(
        keys=[SimpleNamespace(key=key) for key in "abc"], sandwich=SimpleNamespace(covariance=lambda: covariance)
    )
    assert _correlated(fitted) == [("a", "c", pytest.approx(-0.91)), ("b", "c", pytest.approx(0.95))]
