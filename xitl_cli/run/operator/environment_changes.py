"""Smooth changes of wind, current and waves during a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import default_rng

from sim_core.environment.current import make_current
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, EnvironmentSpec, WaveSpec
from sim_core.environment.transition import Transition
from sim_core.environment.waves import FlatWater, WaveField, realise_waves
from sim_core.environment.wind import make_wind
from sim_core.frames import Array
from sim_core.keys import Specification
from xitl_cli.run.operator.actions import ActionError, read_action
from xitl_cli.run.world.plant import Plant
from xitl_cli.seeds import Seeds


class EnvironmentChanges:
    """The environment of a plant that began with `spec`. `seeds`: the seeds of its waves.

    asked: the requested environment. The environment changes from the current one by sim_core's `Transition`. A request
    during a transition follows after it.
    """

    def __init__(self, plant: Plant, spec: EnvironmentSpec, seeds: Seeds) -> None:
        self.asked = spec
        self._reached = spec
        self._plant = plant
        self._seeds = seeds
        self._first_current = spec.current.mean_ne_mps
        self._currents: list[tuple[Array, float]] = []
        self._transition: Transition | None = None

    @property
    def waves(self) -> WaveField | FlatWater:
        """The current waves; a new object after each change."""
        return self._plant.simulation.environment.waves

    @property
    def is_settled(self) -> bool:
        """Whether no transition is active."""
        return self._transition is None

    def read(self, name: str, action: Mapping[str, Any]) -> Specification:
        """Return the group that an action requests. Raises ActionError."""
        group = read_action(action, getattr(self.asked, name))
        if isinstance(group, WaveSpec) and group.spectrum == "none" and group.significant_height_m:
            raise ActionError(
                f"waves: significant_height_m = {group.significant_height_m:g} has no effect with spectrum: none; "
                "add spectrum: jonswap"
            )
        if isinstance(group, CurrentSpec) and group.tide != self.asked.current.tide:
            raise ActionError("current: tide cannot change during a run; remove the key")
        return group

    def ask(self, name: str, group: Specification) -> None:
        """Request another `wind`, `current` or `waves`."""
        changed: dict[str, Any] = {name: group}
        self.asked = replace(self.asked, **changed)

    def update(self, now_ns: int) -> None:
        """Continue the transition. Call it at every exchange."""
        time_s = now_ns * 1e-9
        if self._transition is None:
            if self.asked == self._reached:
                return
            transition = self._transition = Transition(*self._before_and_after(time_s), time_s)
            self._reached = self.asked
            self._plant.change_environment(transition.environment(time_s), transition.begun)
            return
        transition = self._transition
        if transition.is_over(time_s):
            self._transition = None
            self._plant.change_environment(transition.after, lambda state, vessels, rng: transition.ended(state))
        else:
            self._plant.change_environment(transition.environment(time_s), lambda state, vessels, rng: state)

    def _before_and_after(self, time_s: float) -> tuple[Environment, Environment]:
        """Return the current and the requested environment. Unchanged parts are the same objects in both.

        Another current carries the same waves on from their places. Other waves are drawn as at the start and carried
        as far: a sea of another height is the same sea.
        """
        asked, reached, now = self.asked, self._reached, self._plant.simulation.environment
        current, wind, waves = now.current, now.wind, now.waves
        if asked.current != reached.current:
            current = make_current(asked.current)
            self._currents.append((np.array(asked.current.mean_ne_mps), time_s))
            waves = _carried_on(waves, self._currents[-1:])
        if asked.wind != reached.wind:
            wind = make_wind(asked.wind)
        before = replace(now, waves=waves)
        if asked.waves != reached.waves:
            drawn = default_rng(self._seeds.sequence("waves"))
            waves = _carried_on(realise_waves(asked.waves, asked.water, drawn, self._first_current), self._currents)
        return before, Environment(now.water, current, waves, wind, now.tide)


def _carried_on(waves: WaveField | FlatWater, currents: Sequence[tuple[Array, float]]) -> WaveField | FlatWater:
    """Carry the waves with each of the currents (2,) from its instant on."""
    if isinstance(waves, WaveField):
        for current, since_s in currents:
            waves = waves.carried_on(current, since_s)
    return waves
