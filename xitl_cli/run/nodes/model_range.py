"""Shows where a run left the valid range of the vessel and wave models: how far, and for how much of its time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from sim_core.environment.spec import GRAVITY_MPS2
from sim_core.simulation import Simulation, SimulationState
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.core.node import RunContext, RunNode, RunStep

RATE_HZ = 20.0
SOURCE = "physics"


class RangeLook(NamedTuple):
    """A vessel at one instant."""

    simulation: Simulation
    state: SimulationState
    length_m: float
    """Overall length of its hulls."""


@dataclass(frozen=True, slots=True)
class RangeLimit:
    """A limit of a figure within which the model is valid. docs/seas.md explains each limit."""

    key: str
    most: float
    """Largest valid value of the figure."""
    figure: Callable[[RangeLook], float]
    text: str
    """Sentence of the summary, with the largest value and the share of the time above the limit."""


def froude_number(look: RangeLook) -> float:
    """Return the speed through the water over the root of g times the length."""
    through = look.state.vessel.motion.vel_ned_mps[0] - look.state.current_ned_mps[0]
    return math.hypot(*through[:2]) / math.sqrt(GRAVITY_MPS2 * look.length_m)


def deck_under_water(look: RangeLook) -> float:
    """Return the share of the hulls' strips with their deck under water."""
    motion = look.state.vessel.motion
    buoyancy = look.simulation.vessel.buoyancy
    _, under = buoyancy.immersion(motion.pos_ned_m, motion.rot_ned_frd[:, 2], look.state.surface)
    return float(under[0])


def surface_slope(look: RangeLook) -> float:
    """Return the slope of the water at the hulls: k a of a regular wave."""
    return math.hypot(*look.state.surface.gradient_ned[0, :2])


def motion_per_step(look: RangeLook) -> float:
    """Return the larger of turn in rad and change of speed in m/s within one step; 0 during contact."""
    if len(look.state.contacts):
        return 0.0
    motion = look.state.vessel.motion
    most = max(np.abs(motion.gyro_frd_radps[0]).max(), np.abs(motion.acc_ned_mps2[0]).max())
    return float(most) * look.simulation.dt_s


LIMITS = (
    RangeLimit(
        "froude_number", 1.0, froude_number,
        "Froude number up to {most:.2f}, above 1 for {share:.1%} of the time: hulls plane there, these have no lift",
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


class ModelRange(RunNode):
    """Checks a vessel that is not held at RATE_HZ. Warns once for each figure that leaves its range."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._length_m = simulation.vessel.model.length_m  # the property computes it each time
        self.record_every = max(round(1.0 / (RATE_HZ * simulation.dt_s)), 1)
        self._looks = 0
        self._most = [0.0] * len(LIMITS)
        self._outside = [0] * len(LIMITS)

    def begin(self, context: RunContext) -> None:
        self._recorder: Recorder = context.recorder

    def record(self, step: RunStep) -> None:
        if step.held:
            return
        self._looks += 1
        look = RangeLook(self._simulation, step.state, self._length_m)
        for number, limit in enumerate(LIMITS):
            figure = limit.figure(look)
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
