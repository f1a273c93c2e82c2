"""Cost of one vessel step with waves of 32 components, current and gusts.

Run by hand: `OPENBLAS_NUM_THREADS=1 python tests/bench/bench_vessel_step.py`. On a busy machine the threads of the
linear algebra library wait for each other far longer than these small products take.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from sim_core.environment.current import UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, DiscreteGust, GustSpec, Water, WaveSpec, WindSpec
from sim_core.environment.waves import realise_waves
from sim_core.environment.wind import Wind
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.spec import AddedMass, Damping, DemiHull, Hull, HullSection, Propeller, VesselSpec, Windage

ASV = VesselSpec(
    name="asv-full",
    mass_kg=113.0,
    inertia_kgm2=(23.0, 35.0, 56.0),
    hull=Hull(length_m=2.3, width_m=1.6, radius_m=0.2, keel_below_cg_m=0.25, strips=6),
    added_mass=AddedMass(5.1, 72.0, 216.0, 78.0, 95.0, 34.0),
    damping_linear=Damping(15.0, 250.0, 500.0, 230.0, 270.0, 150.0),
    damping_quadratic=Damping(surge=20.0, sway=150.0, yaw=200.0),
    propellers=tuple(Propeller((-0.7, y, -0.55), 250.0, 150.0, 0.25, 0.4) for y in (-0.5, 0.5)),
    wind=Windage(0.9, 1.3, 2.3, 0.7, 0.9, 0.1),
)


MONOHULL = replace(
    ASV,
    hull=None,
    hulls=(
        DemiHull(
            length_m=2.3,
            keel_frd_m=(0.0, 0.0, 0.25),
            section=HullSection(offsets_m=((0.0, 0.0), (0.15, 0.5), (0.45, 0.6))),
            taper=((-0.5, 0.9), (0.1, 1.0), (0.5, 0.1)),
        ),
    ),
)


def median_step_us(vessels: int, steps: int, model: VesselSpec = ASV) -> float:
    rng = np.random.default_rng(1)
    water = Water(level_m=-0.01)
    environment = Environment(
        water=water,
        current=UniformCurrent(CurrentSpec(0.5, 90.0, deviation_mps=0.05, correlation_s=60.0)),
        waves=realise_waves(WaveSpec("jonswap", 0.2, 2.5, 90.0, spreading=10.0, components=32), water, rng),
        wind=Wind(
            WindSpec(5.0, 270.0, 10.0, 120.0, GustSpec("ornstein-uhlenbeck", 1.5, 8.0), (DiscreteGust(5, 2, 3, 2, 4),))
        ),
    )
    simulation = Simulation.from_spec(model, environment, dt_s=0.0025)
    state = initial(simulation, np.zeros((vessels, 2)), np.linspace(0.0, 6.0, vessels), rng)
    command = np.tile([0.6, 0.5], (vessels, 1))
    took_s = []
    for _ in range(steps):
        start_s = time.perf_counter()
        state = step(simulation, state, command, rng)
        took_s.append(time.perf_counter() - start_s)
    return float(np.median(took_s[steps // 10 :])) * 1e6


def main() -> None:
    one_us = median_step_us(1, 20_000)
    many_us = median_step_us(1024, 2_000)
    monohull_us = median_step_us(1, 10_000, MONOHULL)
    print(f"N = 1     {one_us:8.1f} us a step; {monohull_us:.1f} us of a monohull with chines, of 12 strips")
    print(
        f"N = 1024  {many_us:8.1f} us a step, {many_us / 1024:.3f} us a vessel, {one_us * 1024 / many_us:.0f}x cheaper"
    )


if __name__ == "__main__":
    main()
