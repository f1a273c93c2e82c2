"""A vessel as data: mass, hull, damping, propellers and windage.

The body origin is the centre of gravity, axes FRD.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sim_core.keys import Bounds, Items, NonNegative, Positive, Required, Specification, SpecificationError, Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Hull(Specification):
    """Two round demi-hulls: horizontal cylinders, axes half the width less a radius off the middle."""

    length_m: Annotated[Positive, "of each"]
    width_m: Annotated[Positive, "overall; at least four radii"]
    radius_m: Annotated[Positive, "of each"]
    strips: Annotated[int, Bounds(at_least=2, at_most=1000), "of each, for buoyancy and waves"] = 6
    keel_below_cg_m: Annotated[float, "height of the centre of gravity above the lowest line of the hulls"]

    def check(self) -> None:
        if self.width_m < 4 * self.radius_m:
            raise SpecificationError(
                ("width_m",),
                f"= {self.width_m:g} is too narrow for two hulls of radius {self.radius_m:g} m; "
                f"use at least {4 * self.radius_m:g}",
            )

    @property
    def centreline_m(self) -> float:
        """Distance of each demi-hull's axis from the plane of symmetry."""
        return 0.5 * self.width_m - self.radius_m


@dataclass(frozen=True, slots=True)
class AddedMass(Specification):
    """Diagonal of the added mass matrix, positive: the negative of the derivatives X_udot, Y_vdot, ..."""

    surge_kg: NonNegative = 0.0
    sway_kg: NonNegative = 0.0
    heave_kg: NonNegative = 0.0
    roll_kgm2: NonNegative = 0.0
    pitch_kgm2: NonNegative = 0.0
    yaw_kgm2: NonNegative = 0.0


@dataclass(frozen=True, slots=True)
class Damping(Specification):
    """One coefficient per axis, positive: linear in N s/m and N m s/rad, quadratic in N s²/m² and N m s²/rad²."""

    surge: NonNegative = 0.0
    sway: NonNegative = 0.0
    heave: NonNegative = 0.0
    roll: NonNegative = 0.0
    pitch: NonNegative = 0.0
    yaw: NonNegative = 0.0


@dataclass(frozen=True, slots=True)
class SteeringGear(Specification):
    """What turns a propeller about its mast, to either side up to an angle. Its command comes after all throttles."""

    max_angle_deg: Annotated[float, Bounds(above=0, at_most=180)]
    rate_degps: Positive


@dataclass(frozen=True, slots=True)
class Propeller(Specification):
    """An air propeller that pushes along the body's x axis, or where its gear turns it.

    Its speed follows the command as a first-order lag.
    """

    position_frd_m: Annotated[Vector, "from the centre of gravity"]
    max_thrust_n: Annotated[Positive, "at full speed ahead"]
    max_reverse_thrust_n: Annotated[NonNegative, "at full speed astern"]
    spin_up_s: Annotated[Positive, "time constant while it speeds up"]
    spin_down_s: Annotated[Positive, "time constant while it slows down"]
    steering: SteeringGear | None = None


@dataclass(frozen=True, slots=True)
class Windage(Specification):
    """Projected areas above the water and the wind coefficients of Fossen 2021, eq 10.16-10.18."""

    frontal_area_m2: Annotated[NonNegative, Required] = 0.0
    lateral_area_m2: Annotated[NonNegative, Required] = 0.0
    length_m: Annotated[NonNegative, Required, "overall; the lever of the yaw moment"] = 0.0
    surge_coefficient: Annotated[NonNegative, Required] = 0.0
    sway_coefficient: Annotated[NonNegative, Required] = 0.0
    yaw_coefficient: Annotated[float, Required] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class VesselSpec(Specification):
    """The vessel: mass, hull, added mass, damping, propellers and windage.

    Commands are the throttles of the propellers in their order, then the steering of those that have a gear, positive
    for the bow to starboard with the propeller at the stern.
    """

    name: str
    mass_kg: Positive
    inertia_kgm2: Annotated[tuple[Positive, Positive, Positive], "about x, y and z"]
    hull: Hull
    added_mass: AddedMass = AddedMass()
    damping_linear: Damping
    damping_quadratic: Damping
    propellers: Annotated[tuple[Propeller, ...], Items(1, 16), "port first, then starboard"]
    wind: Annotated[Windage, Required] = Windage()

    def check(self) -> None:
        ixx, iyy, izz = self.inertia_kgm2
        largest, total = max(ixx, iyy, izz), ixx + iyy + izz
        if 2 * largest > total * (1 + 1e-9):
            raise SpecificationError(
                ("inertia_kgm2",),
                f"= [{ixx:g}, {iyy:g}, {izz:g}] belongs to no body: one moment exceeds the sum of the other two; "
                f"lower it to {total - largest:g} or less",
            )

    @property
    def commands(self) -> int:
        """How many: a throttle for each propeller and a steering for each gear."""
        return len(self.propellers) + sum(propeller.steering is not None for propeller in self.propellers)
