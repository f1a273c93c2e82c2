"""A vessel afloat at rest: its small motions, drag, helm and thrust, which all checks and trials begin with."""

from __future__ import annotations

import math

import numpy as np

from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.simulation import Simulation
from sim_core.vessel.spec import VesselSpec
from xitl_cli.plugins.studies.manoeuvres.helm import Helm
from xitl_cli.plugins.studies.manoeuvres.small_motion import SmallMotion, small_motion
from xitl_cli.plugins.studies.manoeuvres.track import start, still_water

_STEP_S = (0.01, 0.005, 0.0025, 0.001, 0.0005)
"""Possible steps. The check uses the longest step that follows the vessel's fastest motion: its runs are slow.
"""
_STEPS_PER_RADIAN = 8.0
LARGE_M = 5.0
"""Length from which a vessel counts as a ship or its tank model: thrust is a smaller share of its weight, and its
manoeuvres take longer."""


class AtRest:
    """A floating vessel and its small motions. Raises ValueError if it does not float upright."""

    def __init__(self, model: VesselSpec, water: Water) -> None:
        self.model, self.water = model, water
        self.environment = still_water(Environment(water=water))
        finest = Simulation.from_spec(model, self.environment, _STEP_S[-1])
        self.state = start(finest, 1).vessel
        self.about: SmallMotion = small_motion(finest, self.state)
        self.modes = {mode.name: mode for mode in self.about.modes()}
        self.floating = finest.vessel.rest
        self.added_mass = np.diag(finest.vessel.hydrodynamics.added_mass)
        self.helm = Helm.from_spec(model)
        thrusts = [propeller.static_thrust_n(water.density_kgpm3) for propeller in model.propellers]
        self.full_n: tuple[Array, Array] = tuple(np.array(thrusts).T)  # (P,) ahead and (P,) astern of each
        self.forward_n, self.reverse_n = (float(np.abs(self.helm.ahead) @ full) for full in self.full_n)

        def drag_n(velocity: Array) -> Array:
            """Return the (N, 6) force of the water against (N, 6) velocities, at the depth of rest."""
            hydrodynamics, propulsion = finest.vessel.hydrodynamics, finest.vessel.propulsion
            force: Array = np.concatenate(hydrodynamics.terms(velocity), axis=1) @ hydrodynamics.wrench
            if model.abkowitz is not None:  # its table contains a thrust, which stopped propellers take away
                stopped = np.zeros((len(velocity), model.commands))
                force += (
                    np.concatenate(propulsion.terms(stopped, velocity, velocity[:, :3]), axis=1) @ propulsion.wrench
                )
            return -force

        self.drag_n = drag_n

    @property
    def step_s(self) -> float:
        """Return the longest step that follows its fastest motion."""
        most = 1.0 / (_STEPS_PER_RADIAN * self.about.fastest_radps)
        return next((dt_s * self.slowness for dt_s in _STEP_S if dt_s * self.slowness <= most), _STEP_S[-1])

    @property
    def slowness(self) -> float:
        """Return the time scale of a large vessel by Froude's law, 1 for a boat.

        It is a whole number of tenths, so that steps are whole nanoseconds.
        """
        return round(math.sqrt(max(self.model.length_m / LARGE_M, 1.0)), 1)
