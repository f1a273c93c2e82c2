"""Cost of one step of a fleet beside one of a single vessel, in waves of 32 components, current and gusts.

Vessels lie in a grid, 10 m apart; with contact there is a boom too, and in `touching` each lies against the next one.
CPU time, least of several rounds in which all take turns: they share what else the machine does.

Run by hand: `OPENBLAS_NUM_THREADS=1 python -m tests.bench.bench_fleet_step`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim_core import fleet as fleets
from sim_core import simulation as simulations
from sim_core.environment.current import UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, GustSpec, Water, WaveSpec, WindSpec
from sim_core.environment.waves import realise_waves
from sim_core.environment.wind import Wind
from sim_core.fleet import Fleet
from sim_core.simulation import Simulation
from sim_core.world.plan import Capsules
from sim_core.world.waterway import OPEN_WATER, Waterway
from tests.bench.bench_vessel_step import ASV, MONOHULL
from tests.bench.figure import Figure, scaled

DT_S, ROUNDS, STEPS = 0.0025, 12, 160  # a whole number of long steps
BOOM = Waterway(Capsules(np.array([[0.0, -9.0]]), np.array([[200.0, -9.0]]), np.array([0.4]), ("log boom",)))


def environment() -> Environment:
    water = Water(level_m=-0.01)
    return Environment(
        water=water,
        current=UniformCurrent(CurrentSpec(0.5, 90.0, deviation_mps=0.05, correlation_s=60.0)),
        waves=realise_waves(
            WaveSpec("jonswap", 0.2, 2.5, 90.0, spreading=10.0, components=32), water, np.random.default_rng(1)
        ),
        wind=Wind(WindSpec(5.0, 270.0, 10.0, 120.0, GustSpec("ornstein-uhlenbeck", 1.5, 8.0))),
    )


def one_alone(waterway: Waterway = OPEN_WATER) -> Callable[[], None]:
    """Steps a single vessel STEPS times."""
    rng = np.random.default_rng(1)
    simulation = Simulation.from_spec(ASV, environment(), DT_S, waterway)
    start = simulations.initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
    command = np.array([[0.6, 0.5]])

    def go() -> None:
        state = start
        for _ in range(STEPS):
            state = simulations.step(simulation, state, command, rng)

    return go


def many(count: int, waterway: Waterway = OPEN_WATER, apart_m: float = 10.0, models: int = 1) -> Callable[[], None]:
    """Steps a fleet STEPS times, again and again from the same start."""
    rng = np.random.default_rng(1)
    kinds = [ASV, replace(ASV, name="other", mass_kg=120.0), MONOHULL][:models]
    fleet = Fleet.from_spec([kinds[number % models] for number in range(count)], environment(), DT_S, waterway)
    side = math.ceil(math.sqrt(count))
    places = apart_m * np.array([[number // side, number % side] for number in range(count)], dtype=float)
    start = fleets.initial(fleet, places, np.zeros(count), rng)
    commands = fleet.by_model([[0.6, 0.5]] * count)

    def go() -> None:
        state = start
        for _ in range(STEPS):
            state = fleets.step(fleet, state, commands, rng)

    return go


def least_step_s(cases: dict[str, Callable[[], None]]) -> dict[str, float]:
    """Of each, least of all rounds."""
    best = dict.fromkeys(cases, math.inf)
    for _ in range(scaled(ROUNDS, 1)):
        for name, go in cases.items():
            began_s = time.process_time()
            go()
            best[name] = min(best[name], (time.process_time() - began_s) / STEPS)
    return best


def ratios(waterway: Waterway = OPEN_WATER) -> list[float]:
    """Step of 64 vessels over that of one, a few times."""
    found = []
    for _ in range(scaled(3, 1)):
        best = least_step_s({"one": one_alone(), "many": many(64, waterway)})
        found.append(best["many"] / best["one"])
    return found


FIGURES = [
    Figure("a step of a fleet of 64 over one vessel's", "<= 3", "x", ratios),
    Figure("a step of a fleet of 64 over one vessel's, with contact", "<= 3", "x", lambda: ratios(BOOM)),
]


def main() -> None:
    cases = {
        "1 vessel": one_alone(),
        "1 vessel, contact": one_alone(BOOM),
        **{f"{count} vessels": many(count) for count in (8, 32, 64, 256)},
        "64 vessels, contact": many(64, BOOM),
        "64 vessels, touching": many(64, apart_m=1.55),
        "64 vessels of 3 models": many(64, models=3),
    }
    best = least_step_s(cases)
    for name, step_s in best.items():
        each_us = step_s * 1e6 / int(name.split()[0])
        print(f"{name:24} {step_s * 1e6:8.1f} us, {step_s / best['1 vessel']:5.2f} x one, {each_us:7.2f} us a vessel")


if __name__ == "__main__":
    main()
