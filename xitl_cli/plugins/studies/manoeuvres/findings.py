"""A suspicious value of a vessel, and the key that gives a quantity."""

from __future__ import annotations

from sim_core.dataclass import dataclass
from sim_core.vessel.derivatives import COMPONENTS, VELOCITIES, parse_derivative
from sim_core.vessel.spec import VesselSpec
from xitl_cli.logs.model.sections import Severity

AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")


@dataclass(frozen=True, slots=True)
class VesselFinding:
    """A suspicious value."""

    rule: str
    """Stable name for programs."""
    key: str
    """Key of the profile."""
    severity: Severity
    sentence: str
    next_step: str


def wrong(rule: str, key: str, sentence: str, next_step: str) -> VesselFinding:
    """Return a warning."""
    return VesselFinding(rule, key, Severity.WARNING, sentence, next_step)


def odd(rule: str, key: str, sentence: str, next_step: str) -> VesselFinding:
    """Return a notice."""
    return VesselFinding(rule, key, Severity.NOTICE, sentence, next_step)


def hull_key(model: VesselSpec) -> str:
    """Return the key of the first hull."""
    return "vehicle.hull" if model.hull is not None else "vehicle.hulls.0"


def added_mass_key(model: VesselSpec, axis: int) -> str:
    """Return the key of an axis' added mass."""
    name = f"{COMPONENTS[axis]}_{VELOCITIES[axis]}dot"
    if axis in (0, 1, 5) and model.mmg is not None:
        return f"vehicle.mmg.{ {0: 'm_x', 1: 'm_y', 5: 'j_z'}[axis] }"
    if axis in (0, 1, 5) and model.abkowitz is not None:
        return f"vehicle.abkowitz.derivatives.{name}"
    if model.added_mass_matrix is not None:
        return "vehicle.added_mass_matrix"
    if name in model.derivatives:
        return f"vehicle.derivatives.{name}"
    return f"vehicle.added_mass.{AXES[axis]}_{'kg' if axis < 3 else 'kgm2'}"


def force_key(model: VesselSpec, axis: int, velocity: int, speed_mps: float = 1.0) -> str:
    """Return the key of the largest term of an axis that is linear in a velocity, at a speed ahead.

    Terms with u count with that speed. Without any, return the key of the axis' damping.
    """
    wanted = VELOCITIES[velocity]
    if axis in (0, 1, 5) and model.table_key is not None:
        return f"vehicle.{model.table_key}.derivatives.{COMPONENTS[axis]}_{wanted}"
    sizes = {}
    for name, value in model.derivatives.items():
        derivative = parse_derivative(name)
        velocities = [index for index, _ in derivative.factors]
        ahead = velocities.count(0) if velocity != 0 else len(velocities) - 1
        own = [index for index in velocities if index == velocity]
        if derivative.component == axis and own and ahead + len(own) == len(velocities):
            sizes[name] = abs(value) * speed_mps ** (len(velocities) - 1)
    if sizes:
        return f"vehicle.derivatives.{max(sizes, key=lambda name: sizes[name])}"
    if model.damping_linear_matrix is not None:
        return "vehicle.damping_linear_matrix"
    quadratic, linear = (getattr(group, AXES[axis]) for group in (model.damping_quadratic, model.damping_linear))
    return f"vehicle.damping_{'quadratic' if quadratic * speed_mps > linear else 'linear'}.{AXES[axis]}"
