"""Shows where a run left the valid range of the vessel and wave models: how far, and for how much of its time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2
from sim_core.simulation import Simulation, SimulationState
from sim_core.vessel.confined_water import DEEP_OF_LENGTH, LARGEST_FROUDE_NUMBER
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.world.plant import PlantView

RATE_HZ = 20.0
SOURCE = "physics"


@dataclass(frozen=True, slots=True)
class RangeLimit:
    """A limit of a figure within which the model is valid. docs/seas.md explains each limit."""

    key: str
    most: float
    """Largest valid value of the figure."""
    figure: Callable[[Simulation, SimulationState], list[float]]
    """Figure of each of N vessels."""
    text: str
    """Sentence of the summary, with the largest value and the share of the time above the limit."""


def froude_number(simulation: Simulation, state: SimulationState) -> list[float]:
    """Return the speed through the water over the root of g times the length."""
    through_ne = (state.vessel.motion.vel_ned_mps - state.current_ned_mps)[:, :2].tolist()
    root = math.sqrt(GRAVITY_MPS2 * simulation.vessel.model.length_m)
    return [math.hypot(north, east) / root for north, east in through_ne]


def depth_froude_number(simulation: Simulation, state: SimulationState) -> list[float]:
    """Return the speed through the water over the root of g times the depth; 0 where the depth does not sink a hull."""
    model, figures = simulation.vessel.model, froude_number(simulation, state)
    return [
        figure / math.sqrt(depth_m / model.length_m)
        if model.confined_water and depth_m < DEEP_OF_LENGTH * model.length_m
        else 0.0
        for figure, depth_m in zip(figures, simulation.depths_m(len(figures)), strict=True)
    ]


def deck_under_water(simulation: Simulation, state: SimulationState) -> list[float]:
    """Return the share of the hulls' strips with their deck under water."""
    motion = state.vessel.motion
    buoyancy = simulation.vessel.buoyancy
    _, under = buoyancy.immersion(motion.pos_ned_m, motion.rot_ned_frd[:, 2], state.surface)
    shares: list[float] = under.tolist()
    return shares


def surface_slope(simulation: Simulation, state: SimulationState) -> list[float]:
    """Return the slope of the water at the hulls: k a of a regular wave."""
    return [math.hypot(north, east) for north, east in state.surface.gradient_ned[:, :2].tolist()]


def motion_per_step(simulation: Simulation, state: SimulationState) -> list[float]:
    """Return the larger of turn in rad and change of speed in m/s within one step; 0 during contact."""
    motion = state.vessel.motion
    most = np.abs(np.concatenate([motion.gyro_frd_radps, motion.acc_ned_mps2], axis=1)).max(axis=1) * simulation.dt_s
    if len(state.contacts):
        most[state.contacts.vessel] = 0.0
    figures: list[float] = most.tolist()
    return figures


LIMITS = (
    RangeLimit(
        "froude_number", 1.0, froude_number,
        "Froude number up to {most:.2f}, above 1 for {share:.1%} of the time: hulls plane there, these have no lift",
    ),
    RangeLimit(
        "depth_froude_number", LARGEST_FROUDE_NUMBER, depth_froude_number,
        "speed over the root of g h up to {most:.2f}, above 0.7 for {share:.1%} of the time: the formula of the "
        "sinkage ends there",
    ),
    RangeLimit(
        "deck_under_water", 0.0, deck_under_water,
        "up to {most:.0%} of the hulls under water with their deck, some of it for {share:.1%} of the time: what runs "
        "over a deck is not modelled",
    ),
    RangeLimit(
        "surface_slope", 0.2, surface_slope,
        "water at the hull sloping up to {most:.2f}, above 0.2 for {share:.1%} of the time: waves are linear",
    ),
    RangeLimit(
        "motion_per_step", 0.05, motion_per_step,
        "turns of up to {most:.2f} rad or m/s within a physics step, above 0.05 for {share:.1%} of the time: raise "
        "clock.physics_rate_hz",
    ),
)  # fmt: skip


def _figures(simulation: Simulation, state: SimulationState) -> list[tuple[float, ...]]:
    """Return the figures of each vessel, in the order of LIMITS."""
    return list(zip(*(limit.figure(simulation, state) for limit in LIMITS), strict=True))


class ModelRange(RunNode):
    """Checks a vessel that is not held at RATE_HZ. Warns once for each figure that leaves its range."""

    def __init__(self, plant: PlantView) -> None:
        self._plant = plant
        self.record_every = max(round(1.0 / (RATE_HZ * plant.simulation.dt_s)), 1)
        self._looks = 0
        self._most = [0.0] * len(LIMITS)
        self._outside = [0] * len(LIMITS)

    def begin(self, context: RunContext) -> None:
        self._recorder: Recorder = context.recorder

    def record(self, step: RunStep) -> None:
        if step.held:
            return
        self._looks += 1
        of_vessels, row = self._plant.derived(_figures)
        for number, (limit, figure) in enumerate(zip(LIMITS, of_vessels[row], strict=True)):
            self._most[number] = max(self._most[number], figure)
            if figure > limit.most:
                if not self._outside[number]:
                    text = f"{limit.key} = {figure:.2f} leaves the models' range: at most {limit.most:g}"
                    self._recorder.log(step.now_ns, WARNING, SOURCE, text)
                self._outside[number] += 1

    def report(self) -> dict[str, Any]:
        """Return `model_range`: limit, largest value and share of the time above, by figure; and `warnings`."""
        shares = [outside / self._looks if self._looks else 0.0 for outside in self._outside]
        seen = list(zip(LIMITS, self._most, shares, strict=True))
        return {
            "model_range": {
                limit.key: {"limit": limit.most, "max": most if self._looks else None, "share": share}
                for limit, most, share in seen
            },
            "warnings": [limit.text.format(most=most, share=share) for limit, most, share in seen if share],
        }
