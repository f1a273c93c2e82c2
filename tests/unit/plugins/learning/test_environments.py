"""`xitl.make_env` and `xitl.make_vec_env`: Gymnasium's rules, seeds, restarts and threads."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks import Array, anywhere, around, arrived, reward

import xitl

gymnasium = pytest.importorskip("gymnasium")

ALL_SENSORS = ["imu", "gnss", "magnetometer", "barometer"]
TRUTH = ["position", "to_goal", "velocity", "attitude", "rates", "actuators", "current", "wind"]
COARSE = {"clock.physics_rate_hz": 200}


def many(n: int, **changes: Any) -> Any:
    given = {"reward": reward, "goal": around, "start": anywhere, "episode_s": 0.2, "overrides": COARSE}
    return xitl.make_vec_env("sitl", n, **given | changes)


@pytest.mark.medium
@pytest.mark.parametrize("observe", [TRUTH, ALL_SENSORS], ids=["truth", "sensors"])
def test_gymnasium_accepts_it(observe: list[str]) -> None:
    from gymnasium.utils.env_checker import check_env

    name = f"xitl/Test{len(observe)}-v0"
    gymnasium.register(name, entry_point=xitl.make_env)
    try:
        env = gymnasium.make(
            name, profile="sitl", reward=reward, goal=around, observe=observe, overrides=COARSE, render_mode="rgb_array"
        )
        check_env(env.unwrapped)  # its warnings are errors here
    finally:
        del gymnasium.registry[name]


@pytest.mark.medium
def test_spaces_are_those_of_the_vessel(tmp_path: Path) -> None:
    env = xitl.make_env("sitl", reward=reward, observe=["velocity", "attitude"], overrides=COARSE)
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    assert env.observation_space.shape == (7,)
    own = tmp_path / "ship.yaml"
    own.write_text("extends: [mitl, vehicles/cybership2, environments/calm]\n")
    assert xitl.make_env(own, reward=reward).action_space.shape == (5,)  # three propellers and two rudders
    batch = many(5, observe=["velocity", "attitude"])
    assert (batch.observation_space.shape, batch.action_space.shape) == ((5, 7), (5, 2))
    assert batch.single_observation_space == env.observation_space


def trace(env: Any, seed: int, steps: int = 25) -> list[Array]:
    """Everything that an environment returns, with actions that depend on the step alone."""
    first, _ = env.reset(seed=seed)
    rows = [first]
    shape = env.action_space.shape
    for step in range(steps):
        action = np.sin(step + np.arange(np.prod(shape))).reshape(shape).astype(np.float32)
        rows += list(env.step(action)[:4])
    return [np.asarray(row) for row in rows]


@pytest.mark.medium
@pytest.mark.parametrize("autoreset", ["next_step", "same_step"])
def test_a_seed_repeats_everything_bit_for_bit(autoreset: str) -> None:
    observe = ["position", "velocity", "wind", *ALL_SENSORS]
    envs = [many(3, observe=observe, autoreset=autoreset) for _ in range(2)]
    first, second = trace(envs[0], 4), trace(envs[1], 4)
    again, other = trace(envs[0], 4), trace(envs[0], 5)
    for a, b, c in zip(first, second, again, strict=True):
        assert a.tobytes() == b.tobytes() == c.tobytes()
    assert not np.array_equal(first[-4], other[-4])


@pytest.mark.medium
def test_an_environment_without_a_seed_has_another_sea_each_time() -> None:
    env = xitl.make_env("sitl", reward=reward, goal=around, overrides=COARSE)
    action = np.zeros(2, dtype=np.float32)
    env.reset(seed=1)
    first = env.step(action)[0]
    env.reset()
    assert not np.array_equal(first, env.step(action)[0])


@pytest.mark.medium
def test_one_vessel_is_a_batch_of_one() -> None:
    alone = xitl.make_env("sitl", reward=reward, goal=around, start=anywhere, episode_s=2.0, overrides=COARSE)
    first = trace(alone, 6)
    together = trace(many(1, episode_s=2.0), 6)
    for one, batch in zip(first, together, strict=True):
        assert np.array_equal(one, batch[0])


@pytest.mark.medium
def test_vessels_differ_in_sea_wind_and_goal() -> None:
    env = many(4, start=None, observe=["wind", "goal"])
    observed, _ = env.reset(seed=2)
    assert len(np.unique(observed, axis=0)) == 4
    for _ in range(20):
        env.step(np.zeros((4, 2), dtype=np.float32))
    assert len(np.unique(env.vessels.euler_rad[:, 0])) == 4


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_threads() -> None:
    alone, shared = (many(700, threads=threads, episode_s=0.1) for threads in (1, 2))
    for a, b in zip(trace(alone, 3, steps=12), trace(shared, 3, steps=12), strict=True):
        assert a.tobytes() == b.tobytes()
    shared.close()


@pytest.mark.medium
def test_an_ended_episode_begins_again_in_the_next_step() -> None:
    env = many(2, episode_s=0.1, observe=["position", "velocity", "actuators"])  # 5 steps
    env.reset(seed=1)
    assert env.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    ahead = np.full((2, 2), 0.8, dtype=np.float32)
    ends = [env.step(ahead)[3].tolist() for _ in range(5)]
    assert ends == [[False, False]] * 4 + [[True, True]]
    observed, rewards, terminated, truncated, _ = env.step(ahead)
    assert not observed.any()  # at rest, at the start, without thrust
    assert not rewards.any()
    assert not (terminated | truncated).any()
    assert env.vessels.time_s.tolist() == [0.0, 0.0]
    assert env.step(ahead)[0][:, 6:].any()


@pytest.mark.medium
def test_single_vessels_begin_again_while_others_continue() -> None:
    def deep(vessels: xitl.Vessels) -> Any:
        return (vessels.time_s > 0.05) & (vessels.goal[:, 0] > 0.0)  # some rows after three steps

    env = many(6, terminated=deep, episode_s=60.0)
    env.reset(seed=3)
    ending = env.vessels.goal[:, 0] > 0.0
    assert 0 < ending.sum() < 6
    ahead = np.full((6, 2), 0.5, dtype=np.float32)
    for _ in range(3):
        terminated = env.step(ahead)[2]
    assert terminated.tolist() == ending.tolist()
    goals = env.vessels.goal.copy()
    _, rewards, terminated, _, _ = env.step(ahead)
    assert not terminated.any()
    assert (env.vessels.time_s == np.where(ending, 0.0, pytest.approx(0.08))).all()
    assert ((rewards == 0.0) == ending).all()
    assert ((env.vessels.goal == goals).all(axis=1) == ~ending).all()
    assert not env.vessels.velocity_ned_mps[ending].any()


@pytest.mark.medium
def test_the_same_step_returns_the_first_observation_and_keeps_the_last_one() -> None:
    env = many(2, episode_s=0.1, autoreset="same_step", observe=["position", "velocity"])
    env.reset(seed=1)
    ahead = np.full((2, 2), 0.8, dtype=np.float32)
    for _ in range(5):
        observed, rewards, _, truncated, information = env.step(ahead)
    assert truncated.all()
    assert rewards.any()
    assert not observed.any()
    assert information["_final_obs"].all()
    assert all(last.shape == (6,) and last.any() for last in information["final_obs"])


@pytest.mark.medium
def test_without_autoreset_a_mask_selects_the_vessels() -> None:
    env = many(2, episode_s=0.1, autoreset="disabled")
    env.reset(seed=1)
    still = np.zeros((2, 2), dtype=np.float32)
    for _ in range(5):
        env.step(still)
    with pytest.raises(ValueError, match=r"the episodes of 0, 1 have ended; call reset"):
        env.step(still)
    env.reset(options={"reset_mask": np.array([True, True])})
    assert not env.step(still)[3].any()
    env.reset(options={"reset_mask": np.array([False, True])})
    assert env.vessels.time_s.tolist() == [pytest.approx(0.02), 0.0]
    with pytest.raises(ValueError, match=r"an array of bool with the shape \(2,\)"):
        env.reset(options={"reset_mask": [True, False]})
    with pytest.raises(ValueError, match="give no seed"):
        env.reset(seed=1, options={"reset_mask": np.array([False, True])})


@pytest.mark.medium
def test_wrappers_of_gymnasium_count_episodes() -> None:
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(many(3, episode_s=0.1, terminated=arrived))
    env.reset(seed=1)
    for _ in range(5):
        information = env.step(np.zeros((3, 2), dtype=np.float32))[4]
    assert information["episode"]["l"].tolist() == [5, 5, 5]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"observe": ["velocity", "speed"]}, "observe: 'speed' is unknown; use position, to_goal"),
        ({"observe": "velocity"}, "give a list"),
        ({"observe": []}, "give a list"),
        ({"observe": ["to_goal"], "goal": None}, "'to_goal' needs a goal with north and east"),
        ({"observe": ["wind_vane"]}, r"sitl: has no sensors.wind_vane; add the group"),
        ({"control_rate_hz": 30.0}, r"control_rate_hz = 30 must divide clock.physics_rate_hz = 200"),
        ({"episode_s": 0.001}, r"episode_s = 0.001 must be at least one control step, 0.02 s"),
        ({"render_mode": "human"}, "render_mode = 'human' is unknown; use 'rgb_array' or None"),
        ({"autoreset": "later"}, "autoreset = 'later' is unknown; use next_step, same_step, disabled"),
        ({"n": 0}, "n = 0 must be at least 1"),
        ({"profile": "fleet-convoy"}, "has several vessels"),
        ({"profile": xitl.load_profile("mitl")}, "mitl is loaded already; give overrides to load_profile"),
        ({"overrides": {"faults.weed": {"propeller": {"thrust_loss": 0.4}}}}, "has no faults; remove"),
        ({"overrides": {"world.debris.control": "udp://127.0.0.1:14670"}}, "has no debris; remove world.debris"),
    ],
)
def test_a_task_that_is_impossible_is_refused(changes: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"profile": "sitl", "n": 2, "reward": reward, "goal": around, "overrides": COARSE}
    with pytest.raises(xitl.UserError, match=message):
        xitl.make_vec_env(**given | changes)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("changes", "action", "message"),
    [
        ({}, np.zeros((3, 2)), r"the action has the shape \(3, 2\); give \(2, 2\)"),
        ({}, np.array([[0.0, np.nan], [0.0, 0.0]]), "not finite"),
        ({"reward": lambda before, action, after: 0.0}, np.zeros((2, 2)), r"reward returned the shape \(\)"),
        (
            {"terminated": lambda vessels: np.zeros((2, 1), bool)},
            np.zeros((2, 2)),
            r"one value per vessel, \(2,",
        ),
    ],
)
def test_wrong_shapes_are_named(changes: dict[str, Any], action: Array, message: str) -> None:
    env = many(2, **changes)
    env.reset(seed=1)
    with pytest.raises(ValueError, match=message):
        env.step(action)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"goal": lambda rng, count: np.zeros(3)}, r"goal returned the shape \(3,\) for 2 episodes"),
        ({"start": lambda rng, count: (np.zeros((1, 2)), np.zeros(2))}, r"positions of the shape \(1, 2\)"),
        ({"start": lambda rng, count: (np.zeros((2, 2)), 0.0)}, r"headings of the shape \(\); return \(2,\)"),
        ({"observe": [lambda vessels: vessels.time_s]}, r"returned the shape \(2,\) for 2 vessels; return \(2, K\)"),
    ],
)
def test_wrong_shapes_are_named_at_once(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        many(2, **changes)


@pytest.mark.medium
def test_importing_xitl_does_not_load_gymnasium_and_its_absence_is_named() -> None:
    program = (
        "import sys, xitl, xitl_cli.main, xitl_cli.api\n"
        "assert 'gymnasium' not in sys.modules\n"
        "sys.modules['gymnasium'] = None\n"
        "try: xitl.make_env('sitl', reward=len)\n"
        "except xitl.UserError as error: print(error)"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "an environment needs gymnasium, which is not installed; pip install 'xitl[gym]'" in ran.stdout
