"""`xitl identify vessel`: parameters that a simulated boat was made with, and logs that cannot show them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from pool import CURRENT_NE_MPS, boat, pool_run

pytest.importorskip("scipy")

from sim_core.environment.spec import Water
from sim_core.motion import MotionStep
from xitl_cli.errors import UserError
from xitl_cli.plugins.identify.fit import SHARED, fit, measured
from xitl_cli.plugins.identify.free_keys import free_keys, with_values
from xitl_cli.plugins.identify.identification import Settings, identify, split
from xitl_cli.plugins.identify.recording import Floats, Quantity, Recording, Samples, channel, check_recording
from xitl_cli.plugins.identify.response import check_response
from xitl_cli.plugins.identify.windows import COMMAND_S, HISTORY_S, NAMES, OUTPUT_S, Simulator, cut
from xitl_cli.profile import load_profile

FREE = ("added_mass.sway_kg", "added_mass.yaw_kgm2", "damping_linear.surge", "damping_linear.yaw")


@pytest.mark.slow
def test_it_returns_the_values_that_the_boat_was_made_with() -> None:
    true = boat()
    keys = free_keys(true, FREE, ())
    start = with_values(true, keys, np.array([0.3, -0.3, 0.25, -0.2]))
    keys = free_keys(start, FREE, ())
    result = fit(start, keys, cut([pool_run(true)], 10.0), Water(), wind=False)
    for key, x, sigma in zip(keys, result.x, result.sigma, strict=False):
        wanted = free_keys(true, (key.key,), ())[0].start
        error = abs(key.slope(x)) * sigma
        assert key.value(x) == pytest.approx(wanted, rel=0.05), key.key
        assert abs(key.value(x) - wanted) < 3.5 * error, (key.key, key.value(x), error)
    first = len(keys) + len(SHARED)
    assert result.x[first : first + 2] == pytest.approx(CURRENT_NE_MPS, abs=0.01)


@pytest.mark.slow
def test_measured_gusts_explain_the_motion_that_a_mean_wind_does_not() -> None:
    true = boat()
    keys = free_keys(true, ("damping_linear.surge", "damping_linear.yaw"), ())
    run = pool_run(true, windy=True)
    noise = {}
    for source, own in (("measured", run), ("mean", replace(run, wind_ne_mps=None))):
        result = fit(true, keys, cut([own], 10.0), Water())
        noise[source] = result.noise["yaw"]
        if source == "measured":
            assert np.abs(result.x[: len(keys)]).max() < 0.05
            assert result.nuisance(0)[-2:] == pytest.approx([-own for own in CURRENT_NE_MPS], abs=0.15)
    assert noise["measured"] < 0.9 * noise["mean"]


@pytest.mark.medium
def test_long_windows_are_thinned() -> None:
    run = pool_run(boat(), 90.0)
    for length_s, wanted in ((10.0, 83), (60.0, 249)):  # of 8.3 samples a second: all of them, and every second
        windows = cut([run], length_s)
        counts = np.bincount(windows.window[windows.quantity == NAMES.index("north")])
        assert counts == pytest.approx(wanted, abs=1), length_s


@pytest.mark.nightly
@pytest.mark.slow
def test_standard_errors_cover_the_truth() -> None:
    true, inside, count = boat(), 0, 0
    for seed in range(20, 26):  # each has 17 windows: a jackknife over few windows is uncertain itself
        keys = free_keys(true, FREE, ())
        start = with_values(true, keys, np.random.default_rng(seed).uniform(-0.4, 0.4, len(keys)))
        keys = free_keys(start, FREE, ())
        result = fit(start, keys, cut([pool_run(true, 180.0, seed)], 10.0), Water(), wind=False)
        for key, x, sigma in zip(keys, result.x, result.sigma, strict=False):
            wanted = free_keys(true, (key.key,), ())[0].start
            inside += abs(key.value(x) - wanted) < 2.0 * abs(key.slope(x)) * sigma
            count += 1
    assert inside >= 0.8 * count, (inside, count)


@pytest.mark.medium
def test_a_wrong_velocity_to_the_side_does_not_end_the_fit() -> None:
    """The damping removes any speed to the side at once, so larger and larger initial speeds seem to fit better."""
    run = pool_run(boat(), 40.0)
    stiff = replace(boat(), damping_quadratic=replace(boat().damping_quadratic, sway=400.0))
    time_s = run.channels["yaw"].time_s
    beginning = np.mod(time_s - run.span_s[0] - HISTORY_S, 10.0) < 0.5
    wrong = {**run.channels, "sway": Samples(time_s, np.where(beginning, 0.0, 8.0))}
    windows = cut([replace(run, channels=wrong)], 10.0)
    result = fit(stiff, free_keys(stiff, FREE[2:3], ()), windows, Water(), wind=False)
    assert np.isfinite(result.sigma).all()


@pytest.mark.slow
def test_a_boat_that_never_turns_leaves_the_yaw_undetermined() -> None:
    run = pool_run(boat(), 70.0)
    straight = np.repeat(run.commands.mean(axis=1, keepdims=True), 2, axis=1)
    ahead = replace(run, commands=straight)
    still = {name: Samples(own.time_s, np.zeros_like(own.values)) for name, own in ahead.channels.items()}
    still["north"] = ahead.channels["north"]
    result = fit(boat(), free_keys(boat(), FREE, ()), cut([replace(ahead, channels=still)], 10.0), Water(), wind=False)
    yaw = FREE.index("added_mass.yaw_kgm2")
    assert result.sigma[yaw] > 0.3


@pytest.mark.medium
def test_four_strips_hold_a_boat_in_still_water_as_many_do() -> None:
    commands = np.full((1, 300, 2), 0.5)
    commands[:, 150:, 0] = -0.2
    start = np.array([[0.0, 1.0, 0.1, 0.1]])
    few = Simulator(Water()).motion(boat(), start, start, commands, np.zeros((1, 1, 2)))[-1, 0]
    hull = boat().hull
    assert hull is not None
    fewest = replace(boat(), hull=replace(hull, strips=4))
    motion = Simulator(Water()).motion(fewest, start, start, commands, np.zeros((1, 1, 2)))
    assert few == pytest.approx(motion[-1, 0], abs=1e-9)
    assert MotionStep is not None
    assert few[3:] == pytest.approx(full_motion(commands, start), abs=5e-3)


@pytest.mark.medium
def test_a_window_begins_with_heel_and_trim() -> None:
    run, plant = pool_run(boat(), 30.0), Simulator(Water())
    still, calm = np.zeros((1, 4)), np.zeros((1, 1, 2))

    def moved(from_s: float, until_s: float, before: Floats, start: Floats) -> Floats:
        edges = np.arange(round((until_s - from_s + HISTORY_S) / COMMAND_S) + 1) * COMMAND_S + from_s - HISTORY_S
        return plant.motion(boat(), before, start, run.mean_commands(edges[None]), calm)[:, 0]

    def planar(motion: Floats) -> Floats:
        yaw, north, east, rate = motion[[2, 3, 4, 5]]
        ahead, right = np.cos(yaw) * north + np.sin(yaw) * east, np.cos(yaw) * east - np.sin(yaw) * north
        return np.array([[yaw, ahead, right, rate]])

    whole = moved(0.0, 20.0, still, still)
    for begin_s in (6.0, 8.0, 10.0, 12.0):  # the commands change at 6 and 12 s
        first = round(begin_s / OUTPUT_S)
        before, start = planar(whole[first - round(HISTORY_S / OUTPUT_S)]), planar(whole[first])
        part = moved(begin_s, begin_s + 1.0, before, start)
        assert part[:, 3:] == pytest.approx(whole[first : first + len(part), 3:], abs=1.5e-3), begin_s


def full_motion(commands: np.ndarray, start: np.ndarray) -> np.ndarray:
    """The same motion with all strips and steps of 5 ms."""
    from sim_core.vessel.vessel import Vessel
    from xitl_cli.plugins.identify.windows import _simulated

    result = _simulated(Vessel.from_spec(boat(), Water(), 0.005), start, start, commands, np.zeros((1, 1, 2)))
    return np.asarray(result[-1, 0, 3:])


def test_keys() -> None:
    with pytest.raises(UserError, match=r"no number at 'damping_linear.yow'; did you mean 'damping_linear.yaw'\?"):
        free_keys(boat(), ("damping_linear.yow",), ())
    with pytest.raises(UserError, match=r"damping_quadratic.heave is 0 .* write a first guess"):
        free_keys(boat(), ("damping_quadratic.heave",), ())
    (both,) = free_keys(boat(), ("propellers.max_thrust_n",), ())
    changed = with_values(boat(), [both], np.array([np.log(2.0)]))
    assert [own.max_thrust_n for own in changed.propellers] == pytest.approx([18.52, 18.52])


def test_signs_of_derivatives() -> None:
    kvlcc2 = load_profile("vehicles/kvlcc2-l7").vehicle
    assert kvlcc2 is not None
    names = ("mmg.derivatives.N_vrr", "mmg.derivatives.Y_r", "mmg.derivatives.N_r", "mmg.r_0")
    keys = free_keys(kvlcc2, names, ())
    assert [key.signed for key in keys] == [True, True, False, False]
    assert [key.value(-3.0) < 0.0 for key in keys] == [True, True, True, False]
    for key in keys:
        assert key.slope(0.3) * 1e-6 == pytest.approx(key.value(0.3 + 1e-6) - key.value(0.3), rel=1e-4)
    assert {"mmg.m_y", "mmg.derivatives.N_v"} < {key.key for key in free_keys(kvlcc2, (), ())}
    cybership2 = load_profile("vehicles/cybership2").vehicle
    assert cybership2 is not None
    assert {"derivatives.X_u", "derivatives.N_rdot"} < {key.key for key in free_keys(cybership2, (), ())}


def test_values_that_no_vessel_has_are_one_sentence() -> None:
    kvlcc2 = load_profile("vehicles/kvlcc2-l7").vehicle
    assert kvlcc2 is not None
    keys = free_keys(kvlcc2, ("propellers.open_water.reverse_share",), ())
    with pytest.raises(
        UserError, match=r"cannot follow these logs: at .*reverse_share = 1.9, .* use a value of at most"
    ):
        with_values(kvlcc2, keys, np.array([1.0]))


def test_what_a_recording_lacks() -> None:
    run = pool_run(boat(), 30.0)
    with pytest.raises(UserError, match="has 2 commands, but the vehicle takes 3"):
        check_recording(run, 3)
    with pytest.raises(UserError, match=r"overlap for \d+\.\d s; record 20 s"):
        check_recording(run.part(0.0, 12.0), 2)
    with pytest.raises(UserError, match=r"commands change by 0\.000 of full; record steps"):
        check_recording(replace(run, commands=np.full_like(run.commands, 0.3)), 2)
    degrees = {
        **run.channels,
        "yaw_rate": Samples(run.channels["yaw_rate"].time_s, run.channels["yaw_rate"].values * 57.3),
    }
    with pytest.raises(UserError, match=r"yaw_rate is 5[78]\.?\d* times the rate of yaw .*correct the unit"):
        check_recording(replace(run, channels=degrees), 2)
    north = run.channels["north"]
    kept = (north.time_s < 4.0) | (north.time_s > 21.0)
    gap = {**run.channels, "north": Samples(north.time_s[kept], north.values[kept])}
    with pytest.raises(UserError, match=r"no part of 12 s is under way and without a gap .*the longest has 9 s"):
        cut([replace(run, channels=gap)], 10.0)


def test_a_boat_at_rest_is_refused() -> None:
    run = pool_run(boat(), 30.0)
    noise = np.random.default_rng(0)
    tied = {
        name: Samples(own.time_s, scale * noise.standard_normal(len(own.time_s)))
        for (name, own), scale in zip(run.channels.items(), (0.02, 0.02, 0.005, 0.005), strict=True)
    }
    with pytest.raises(
        UserError, match=r"stays at rest while the commands change by 1\.\d\d of full \(its speed varies"
    ):
        check_recording(replace(run, channels=tied), 2)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("factor", "words"), [(1.0, ""), (-1.0, r"turns -\d\.\d+ times"), (0.0175, r"turns 0\.01\d+ times")]
)
def test_a_heading_that_does_not_turn_as_the_course(factor: float, words: str) -> None:
    run = pool_run(boat(), 60.0)
    yaw = run.channels["yaw"]
    channels = {name: own for name, own in run.channels.items() if name != "yaw_rate"}
    wrong = replace(run, channels=channels | {"yaw": Samples(yaw.time_s, factor * yaw.values)})
    if not words:
        check_recording(wrong, 2)
        return
    with pytest.raises(UserError, match=f"the heading {words}.* correct the unit, the sign or the column of yaw"):
        check_recording(wrong, 2)


def of_channels(run: Recording, *names: Quantity, factor: float = 1.0, added: float = 0.0) -> Recording:
    changed = {name: Samples(run.channels[name].time_s, factor * run.channels[name].values + added) for name in names}
    return replace(run, channels={**run.channels, **changed})


WRONG: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "heading": (
        lambda run: of_channels(run, "yaw", added=np.pi / 2),
        r"the commands push the boat (8|9|10)\d° to port of the heading \(correlation 0.\d\d\); subtract",
    ),
    "kilometres": (
        lambda run: of_channels(run, "north", "east", factor=1e-3),
        r"north and east move 0\.00(08|09|1)\d* times as far .* correct their unit",
    ),
    "feet": (
        lambda run: of_channels(run, "north", "east", factor=3.281),
        r"north and east move (2\.[5-9]|3.*) times as far .* correct their unit",
    ),
    "swapped": (
        lambda run: replace(run, commands=run.commands[:, ::-1]),
        r"the boat turns against its commands \(correlation -\d\.\d\d\); exchange the commands of port and starboard",
    ),
    "reversed": (
        lambda run: replace(run, commands=-run.commands),
        r"the boat moves against its commands .* 1\.\d\d with reversed commands\); exchange full ahead and full astern",
    ),
    "unrelated": (
        lambda run: replace(run, commands=pool_run(boat(), 90.0, 7).commands),
        r"the boat does not respond to its commands \(correlations \d\.\d\d .* use commands and motion of one run",
    ),
    "late": (
        lambda run: replace(run, command_s=run.command_s + 5.0),
        r"the motion is 5\.0 s earlier than the commands .* with one clock",
    ),
    "early": (
        lambda run: replace(run, command_s=run.command_s - 5.0),
        r"the motion is 5\.0 s later than the commands",
    ),
}


@pytest.mark.medium
@pytest.mark.parametrize("kind", WRONG)
def test_a_boat_that_does_not_respond_to_its_commands_as_the_vehicle(kind: str) -> None:
    run, (wrong, words) = pool_run(boat(), 90.0), WRONG[kind]
    with pytest.raises(UserError, match=f"pool-1: {words}"):
        identify([wrong(run)], boat(), Water(), Settings())


@pytest.mark.medium
@pytest.mark.parametrize(
    ("vehicle", "words"),
    [("wamv16", r"move 0\.[23]\d* times as far as thrust and mass .* begin with the vehicle of this log")],
)
def test_the_log_of_another_vehicle(vehicle: str, words: str) -> None:
    other = load_profile(f"vehicles/{vehicle}").vehicle
    assert other is not None
    with pytest.raises(UserError, match=words):
        check_response(pool_run(boat(), 90.0), other, Water(), 10.0)


@pytest.mark.medium
def test_a_right_log_with_a_wrong_first_vehicle() -> None:
    keys = free_keys(boat(), (), ())
    for seed in (1, 2, 3):
        start = with_values(boat(), keys, np.random.default_rng(seed).uniform(-1.1, 1.1, len(keys)))  # a factor of 3
        check_response(pool_run(boat(), 90.0, seed, windy=True), start, Water(), 10.0)


@pytest.mark.medium
def test_a_position_that_jumps() -> None:
    run = pool_run(boat(), 40.0)
    time_s, values = run.channels["east"].time_s, run.channels["east"].values
    for jump_m, refused in ((50.0, True), (2.0, False)):  # an estimator corrects itself by a few metres
        jumping = {**run.channels, "east": Samples(time_s, values + jump_m * (time_s > 20.0))}
        if refused:
            with pytest.raises(UserError, match=r"east jumps by (49|50)\S* m at 20\.\d s .*; split the log there"):
                check_recording(replace(run, channels=jumping), 2)
        else:
            check_recording(replace(run, channels=jumping), 2)
    kept = (time_s < 15.0) | (time_s > 25.0)
    gap = {**run.channels, "east": Samples(time_s[kept], (values + 50.0 * (time_s > 20.0))[kept])}
    check_recording(replace(run, channels=gap), 2)


@pytest.mark.medium
def test_rounded_commands_and_means_of_a_fast_sensor() -> None:
    time_s = np.arange(0.0, 10.0, 0.02)
    mean = channel(time_s, np.sin(time_s), average=True)
    assert mean.width_s == pytest.approx(0.04)
    run = pool_run(boat(), 40.0)
    windows = cut([run], 10.0)
    nuisance, shared = np.zeros((len(windows), 6)), np.zeros(3)
    motion = np.zeros((260, len(windows), 6))
    motion[:, :, 5] = ((np.arange(260) * OUTPUT_S) ** 2)[:, None]
    rate = windows.quantity == NAMES.index("yaw_rate")
    point = measured(windows, motion, np.zeros((len(windows), 2)), nuisance, shared)[rate]
    wide = replace(windows, width_s=np.full(len(windows.width_s), 0.6))
    inside = rate & (wide.offset_s > 0.5) & (wide.offset_s < 9.0)
    means = measured(wide, motion, np.zeros((len(windows), 2)), nuisance, shared)
    assert means[inside] - point[inside[rate]] == pytest.approx(0.6**2 * 2.0 / 27.0, rel=0.1)


@pytest.mark.medium
def test_runs_are_split_whole() -> None:
    runs = [pool_run(boat(), 25.0, seed) for seed in (1, 2, 3)]
    training, testing = split(runs, ())
    assert [[own.source for own in part] for part in (training, testing)] == [["pool-1", "pool-2"], ["pool-3"]]
    training, testing = split(runs, ("pool-1",))
    assert [own.source for own in testing] == ["pool-1"]
    assert split(runs[:1], ())[1][0].span_s[0] == pytest.approx(0.7 * 25.0, abs=1.5)
    with pytest.raises(UserError, match="--test pool-9 is none of the logs"):
        split(runs, ("pool-9",))
    with pytest.raises(UserError, match="--test names all logs"):
        split(runs, ("pool-1", "pool-2", "pool-3"))


@pytest.mark.slow
def test_without_surroundings_a_current_is_an_error_of_the_prediction() -> None:
    run, free = pool_run(boat(), 130.0), ("damping_linear.yaw",)
    position_m = {}
    for known in (True, False):
        result = identify([run], boat(), Water(), Settings(free=free, wind=False, surroundings=known))
        position_m[known] = {own.model: own.errors[3] for own in result.scores if own.horizon_s == 10.0}
    assert position_m[True]["identified"] < 0.2
    assert position_m[False]["identified"] > 0.5
    assert position_m[False]["persistence"] == position_m[True]["persistence"]


@pytest.mark.slow
def test_too_few_windows_and_a_model_that_cannot_follow() -> None:
    settings = Settings(free=("damping_linear.surge",), wind=False)
    with pytest.raises(UserError, match=r"have 2 windows of 10 s to fit; record 60 s"):
        identify([pool_run(boat(), 36.0)], boat(), Water(), settings)
    run = pool_run(boat(), 100.0)
    thrust = ("propellers.max_thrust_n", "propellers.max_reverse_thrust_n")
    keys = free_keys(boat(), (*thrust, "damping_linear.yaw", "damping_quadratic.surge"), ())
    light = with_values(boat(), keys, np.array([0.15, 0.15, -1.4, -2.4]))
    with pytest.raises(UserError, match="the model cannot follow these logs"):
        identify([run], light, Water(), Settings(free=("added_mass.heave_kg",), wind=False))
