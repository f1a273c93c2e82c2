"""`vehicle`: the vessel's mass, hull, damping, propellers and windage. Body axes are FRD from the centre of gravity."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from xitl_cli.profile.schema.group import Group, NonNegative, Positive, Vector


class Hull(Group):
    """Two round demi-hulls; `width_m` is overall."""

    length_m: Positive
    width_m: Positive
    radius_m: Positive
    strips: Annotated[int, Field(ge=2, le=1000)] = 6
    keel_below_cg_m: float


class AddedMass(Group):
    """Diagonal added mass, positive numbers."""

    surge_kg: NonNegative = 0.0
    sway_kg: NonNegative = 0.0
    heave_kg: NonNegative = 0.0
    roll_kgm2: NonNegative = 0.0
    pitch_kgm2: NonNegative = 0.0
    yaw_kgm2: NonNegative = 0.0


class Damping(Group):
    """Diagonal damping, positive numbers: N/(m/s)^p and N m/(rad/s)^p, with p = 1 (linear) or 2 (quadratic)."""

    surge: NonNegative = 0.0
    sway: NonNegative = 0.0
    heave: NonNegative = 0.0
    roll: NonNegative = 0.0
    pitch: NonNegative = 0.0
    yaw: NonNegative = 0.0


class Steering(Group):
    """The gear that turns a propeller about its mast."""

    max_angle_deg: Annotated[float, Field(gt=0, le=180)]
    rate_degps: Positive


class Propeller(Group):
    """One air propeller. It pushes along the body's x axis, or where its `steering` turns it."""

    position_frd_m: Vector
    max_thrust_n: Positive
    max_reverse_thrust_n: NonNegative
    spin_up_s: Positive
    spin_down_s: Positive
    steering: Steering | None = None


class Windage(Group):
    """Projected areas above the water and the wind coefficients."""

    frontal_area_m2: NonNegative
    lateral_area_m2: NonNegative
    length_m: NonNegative
    surge_coefficient: NonNegative
    sway_coefficient: NonNegative
    yaw_coefficient: float


class Vehicle(Group):
    """The vessel. The first propeller is the port one, the second starboard; steering comes after all throttles."""

    name: str
    mass_kg: Positive
    inertia_kgm2: tuple[Positive, Positive, Positive]
    hull: Hull
    added_mass: AddedMass = AddedMass()
    damping_linear: Damping
    damping_quadratic: Damping
    propellers: Annotated[tuple[Propeller, ...], Field(min_length=1, max_length=16)]
    wind: Windage

    @property
    def commands(self) -> int:
        """How many: a throttle for each propeller, then a steering for each that has a gear."""
        return len(self.propellers) + sum(propeller.steering is not None for propeller in self.propellers)
