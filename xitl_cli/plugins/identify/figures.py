"""Figures that compare vessels: inertia and damping of the three motions in the plane, with their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.environment.spec import Water
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import Vessel
from xitl_cli.plugins.identify.fit import Fit
from xitl_cli.plugins.identify.free_keys import with_values
from xitl_cli.plugins.identify.recording import Floats, Recording

AXES = (("surge", 0, "kg", "N s/m"), ("sway", 1, "kg", "N s/m"), ("yaw", 5, "kg m²", "N m s"))
_STEP = 1e-3
_FAST = 80.0
_STEP_S = 0.0025


@dataclass(frozen=True, slots=True)
class Figure:
    """An inertia, or a damping force over its speed at a speed that the logs reach."""

    name: str
    value: float
    sigma: float
    unit: str


def reached_speeds(recordings: Sequence[Recording]) -> Floats:
    """Return the speeds ahead, to starboard and of the yaw that logs stay below for 80 % of the time, (3,)."""
    parts = []
    for recording in recordings:
        first_s, last_s = recording.span_s
        parts.append(np.abs(recording.motion_at(np.arange(first_s, last_s, 0.5))[:, 3:]))
    speeds: Floats = np.percentile(np.concatenate(parts), _FAST, axis=0)
    return np.maximum(speeds, 1e-3)


def plane_figures(vessel: VesselSpec, water: Water, speeds: Floats) -> Floats:
    """Return (6,): mass plus added mass of surge, sway and yaw, then the damping of each over its speed."""
    made = Vessel.from_spec(vessel, water, _STEP_S).hydrodynamics
    mass = made.rigid_mass + made.added_mass
    axes = [axis for _, axis, _, _ in AXES]
    nu = np.zeros((3, 6))
    nu[np.arange(3), axes] = speeds
    force = np.concatenate(made.terms(nu), axis=1) @ made.wrench
    return np.concatenate([np.diag(mass)[axes], -force[np.arange(3), axes] / speeds])


def figures(fit: Fit, start: VesselSpec, water: Water, speeds: Floats) -> tuple[Figure, ...]:
    """Return the figures of a fit with their standard errors. start: the vehicle before the fit."""
    count = len(fit.keys)
    values = plane_figures(fit.vessel, water, speeds)
    slopes = np.zeros((len(values), count))
    for column in range(count):
        x = fit.x[:count].copy()
        x[column] += _STEP
        slopes[:, column] = (plane_figures(with_values(start, fit.keys, x), water, speeds) - values) / _STEP
    sigma = np.sqrt(np.diag(slopes @ fit.covariance[:count, :count] @ slopes.T))
    inertia = [f"inertia in {name}" for name, *_ in AXES]
    of_speed = zip(AXES, speeds, ("m/s", "m/s", "rad/s"), strict=True)
    damping = [f"damping in {axis[0]} at {speed:.2g} {unit}" for axis, speed, unit in of_speed]
    units = [axis[2] for axis in AXES] + [axis[3] for axis in AXES]
    return tuple(
        Figure(name, float(value), float(error), unit)
        for name, value, error, unit in zip([*inertia, *damping], values, sigma, units, strict=True)
    )
