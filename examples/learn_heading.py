"""Train a heading controller on a thousand boats at once, with numpy alone. It takes some minutes.

    python examples/learn_heading.py
    xitl sim sitl --set autopilot.controller=examples/learned_heading.py:LearnedHeading

The boats lie in current, waves and gusts. Each gets a heading, and another one later. A small network steers them from
heading error, turn rate, integral of the error and speed. An evolution strategy (Salimans et al. 2017) improves it.
Each generation tries the weights with random changes, and moves them along the changes that earned more.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

import xitl

Array = NDArray[np.float64]

PAIRS, BOATS_EACH = 64, 8  # pairs of opposite changes; boats that try each change
HIDDEN, FEATURES = 6, 5
EPISODE_S, RATE_HZ = 16.0, 50.0
SIGMA, STEP = 0.15, 0.15
INTEGRAL_LIMIT_RADS, INTEGRATED_BELOW_RAD = 0.5, 0.35  # as in learned_heading.py
SMOOTH = 0.1  # cost of a change of the commands, against radians


# The task: hold the goal (heading in rad, heading after the change, time of the change in s, speed in m/s)


def draw_goals(rng: Generator, count: int) -> Array:
    """Return goals, (K, 4). All networks get the same ones, so that their rewards can be compared."""
    first = rng.uniform(-np.pi, np.pi, BOATS_EACH)
    second = first + rng.choice([-1.0, 1.0], BOATS_EACH) * rng.uniform(0.05, 1.6, BOATS_EACH)
    change_s, speed_mps = rng.uniform(6.0, 10.0, BOATS_EACH), rng.uniform(1.0, 3.0, BOATS_EACH)
    return np.resize(np.stack([first, second, change_s, speed_mps], axis=1), (count, 4))


def draw_starts(rng: Generator, count: int) -> tuple[Array, Array]:
    """Return positions (K, 2) and headings (K,), the same ones for all networks."""
    return np.zeros((count, 2)), np.resize(rng.uniform(-np.pi, np.pi, BOATS_EACH), count)


def heading_error(vessels: xitl.Vessels) -> Array:
    """Return the way to the commanded heading, (N, 1) in rad."""
    first, second, change_s, _ = vessels.goal.T
    wanted = np.where(vessels.time_s < change_s, first, second)
    return np.asarray(np.remainder(wanted - vessels.euler_rad[:, 2] + np.pi, 2.0 * np.pi) - np.pi)[:, None]


def speeds(vessels: xitl.Vessels) -> Array:
    """Return the speed over ground and the commanded speed, (N, 2) in m/s."""
    return np.stack([np.hypot(*vessels.velocity_ned_mps[:, :2].T), vessels.goal[:, 3]], axis=1)


def turn_rate(vessels: xitl.Vessels) -> Array:
    """Return the turn rate, (N, 1) in rad/s."""
    return vessels.rates_frd_radps[:, 2:]


def reward(before: xitl.Vessels, action: Array, after: xitl.Vessels) -> Array:
    """Return minus the heading error, and a little less for restless propellers, (N,)."""
    error_rad = np.minimum(np.abs(heading_error(after)[:, 0]), 0.5)
    restless = ((action - before.actuators) ** 2).mean(axis=1)
    return -error_rad - SMOOTH * restless


# The policy


def steering(weights: Array, inputs: Array) -> Array:
    """Return the steering (P, B) of P networks (P, HIDDEN * (FEATURES + 1)) for inputs (P, B, 4)."""
    error, rate, integral, speed = np.moveaxis(inputs, -1, 0)
    features = np.stack([error, rate, integral, error * speed / 3.0, rate * speed / 3.0], axis=-1)
    hidden = weights[:, : HIDDEN * FEATURES].reshape(-1, HIDDEN, FEATURES)
    output = weights[:, HIDDEN * FEATURES :, None]
    values: Array = np.tanh(np.tanh(features @ hidden.transpose(0, 2, 1)) @ output)[..., 0]
    return values


def commands(thrust: Array, steer: Array) -> Array:
    """Return commands (N, 2) of the propellers, as the autopilot allocates them: steering first, then thrust."""
    astern, turn = 0.6, np.clip(steer, -0.8, 0.8)
    surge = np.clip(thrust, np.abs(turn) - astern, 1.0 - np.abs(turn))
    share = np.stack([surge + turn, surge - turn], axis=1)
    ahead = np.where(share >= 0.0, share, -share / astern)
    return np.sign(share) * np.sqrt(np.minimum(ahead, 1.0))  # thrust goes with the square of the speed


def earned(env: Any, weights: Array) -> Array:
    """Return the mean reward of P networks, each of which steers the same number of boats, (P,)."""
    observed, _ = env.reset()
    networks, boats = len(weights), len(observed)
    integral = np.zeros(boats)
    total = np.zeros(boats)
    for _ in range(round(EPISODE_S * RATE_HZ)):
        error, rate, speed, wanted_mps = observed.T.astype(np.float64)
        integral += np.where(np.abs(error) < INTEGRATED_BELOW_RAD, error / RATE_HZ, 0.0)
        np.clip(integral, -INTEGRAL_LIMIT_RADS, INTEGRAL_LIMIT_RADS, out=integral)
        inputs = np.stack([error, rate, integral, speed], axis=1).reshape(networks, -1, 4)
        thrust = 0.45 * (wanted_mps / 3.0) ** 2 + 0.6 * (wanted_mps - speed)  # as the built-in speed loop
        observed, rewards, _, _, _ = env.step(commands(thrust, steering(weights, inputs).ravel()))
        total += rewards
    means: Array = total.reshape(networks, -1).mean(axis=1) / (EPISODE_S * RATE_HZ)
    return means


# The evolution strategy


def train(env: Any, generations: int, rng: Generator) -> Array:
    """Return the weights, (HIDDEN * (FEATURES + 1),)."""
    size = HIDDEN * (FEATURES + 1)
    weights = 0.1 * rng.standard_normal(size)
    mean, second = np.zeros(size), np.zeros(size)
    for generation in range(1, generations + 1):
        began_s = time.perf_counter()
        changes = rng.standard_normal((PAIRS, size))
        tried = weights + SIGMA * np.concatenate([changes, -changes])
        gains = earned(env, tried)
        ranks = np.argsort(np.argsort(gains)) / (2 * PAIRS - 1) - 0.5
        slope = (ranks[:PAIRS] - ranks[PAIRS:]) @ changes / PAIRS
        # Adam (Kingma and Ba 2015)
        mean, second = 0.8 * mean + 0.2 * slope, 0.95 * second + 0.05 * slope**2
        direction = (mean / (1.0 - 0.8**generation)) / (np.sqrt(second / (1.0 - 0.95**generation)) + 1e-8)
        weights = weights + STEP * (1.0 - 0.8 * generation / generations) * direction
        took_s = time.perf_counter() - began_s
        print(f"generation {generation:3}: mean reward {gains.mean():8.4f}, best {gains.max():8.4f}, {took_s:.1f} s")
    return weights


def write(path: Path, weights: Array) -> None:
    """Write the weights for learned_heading.py."""
    hidden = weights[: HIDDEN * FEATURES].reshape(HIDDEN, FEATURES)
    network = {"hidden": hidden.tolist(), "output": weights[HIDDEN * FEATURES :].tolist()}
    path.write_text(json.dumps(network) + "\n", encoding="utf-8")


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--generations", type=int, default=40)
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--out", type=Path, default=Path(__file__).with_name("learned_heading.json"))
    given = arguments.parse_args()
    env = xitl.make_vec_env(
        "mitl",
        2 * PAIRS * BOATS_EACH,
        reward=reward,
        observe=[heading_error, turn_rate, speeds],
        goal=draw_goals,
        start=draw_starts,
        episode_s=EPISODE_S,
        control_rate_hz=RATE_HZ,
        overrides={"clock.physics_rate_hz": 100, "environment.wind.mean_mps": 6},
    )
    env.reset(seed=given.seed)
    weights = train(env, given.generations, default_rng(given.seed))
    write(given.out, weights)
    print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
