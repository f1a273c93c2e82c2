"""A vessel as data: the numbers of a vehicle file, validated and nothing else.

    VesselModel(name, mass_kg, inertia_kgm2, hull=Hull(...), added_mass=AddedMass(...), damping_linear=Damping(...),
                damping_quadratic=Damping(...), propellers=(Propeller(...), ...), wind=Windage(...))

The body origin is the centre of gravity, axes FRD. Constructor names are the keys of the vehicle file.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass


def _require(condition: bool, problem: str) -> None:
    if not condition:
        raise ValueError(problem)


def _require_positive(owner: str, **values: float) -> None:
    for name, value in values.items():
        _require(math.isfinite(value) and value > 0.0, f"{owner}.{name} = {value} must be a positive number")


def _require_not_negative(owner: str, **values: float) -> None:
    for name, value in values.items():
        _require(math.isfinite(value) and value >= 0.0, f"{owner}.{name} = {value} must be zero or a positive number")


def _require_vector(owner: str, name: str, vector: tuple[float, ...]) -> None:
    fine = len(vector) == 3 and all(math.isfinite(value) for value in vector)
    _require(fine, f"{owner}.{name} = {list(vector)} must be three numbers")


@dataclass(frozen=True, slots=True)
class Hull:
    """Two round demi-hulls, horizontal cylinders `strips` strips long, centrelines at +-(width/2 - radius).

    keel_below_cg_m: height of the centre of gravity above the lowest line of the hulls.
    """

    length_m: float
    width_m: float
    radius_m: float
    keel_below_cg_m: float
    strips: int = 6

    def __post_init__(self) -> None:
        _require_positive("hull", length_m=self.length_m, width_m=self.width_m, radius_m=self.radius_m)
        _require(math.isfinite(self.keel_below_cg_m), f"hull.keel_below_cg_m = {self.keel_below_cg_m} must be a number")
        _require(self.strips >= 2, f"hull.strips = {self.strips} must be 2 or more, or the hull cannot pitch")
        _require(
            self.width_m >= 4.0 * self.radius_m,
            f"hull.width_m = {self.width_m} leaves no room for two hulls of radius_m = {self.radius_m}; "
            f"it is the overall width, {4.0 * self.radius_m:g} or more",
        )

    @property
    def centreline_m(self) -> float:
        """Distance of each demi-hull's axis from the plane of symmetry."""
        return 0.5 * self.width_m - self.radius_m


@dataclass(frozen=True, slots=True)
class AddedMass:
    """Diagonal of the added mass matrix, the negative of the hydrodynamic derivatives (X_udot, Y_vdot, ...)."""

    surge_kg: float = 0.0
    sway_kg: float = 0.0
    heave_kg: float = 0.0
    roll_kgm2: float = 0.0
    pitch_kgm2: float = 0.0
    yaw_kgm2: float = 0.0

    def __post_init__(self) -> None:
        _require_not_negative(
            "added_mass",
            surge_kg=self.surge_kg,
            sway_kg=self.sway_kg,
            heave_kg=self.heave_kg,
            roll_kgm2=self.roll_kgm2,
            pitch_kgm2=self.pitch_kgm2,
            yaw_kgm2=self.yaw_kgm2,
        )


@dataclass(frozen=True, slots=True)
class Damping:
    """One coefficient per axis: linear in N s/m and N m s/rad, quadratic in N s2/m2 and N m s2/rad2."""

    surge: float = 0.0
    sway: float = 0.0
    heave: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        axes = ("surge", "sway", "heave", "roll", "pitch", "yaw")
        _require_not_negative("damping", **dict(zip(axes, astuple(self), strict=True)))


@dataclass(frozen=True, slots=True)
class SteeringGear:
    """What turns a propeller about its mast: to either side up to an angle, at one rate."""

    max_angle_deg: float
    rate_degps: float

    def __post_init__(self) -> None:
        _require_positive("propeller.steering", max_angle_deg=self.max_angle_deg, rate_degps=self.rate_degps)
        _require(
            self.max_angle_deg <= 180.0,
            f"propeller.steering.max_angle_deg = {self.max_angle_deg} is more than about turn; use 180 or less",
        )


@dataclass(frozen=True, slots=True)
class Propeller:
    """An air propeller; its lag follows the sense in which its speed changes. Without a gear it pushes along x."""

    position_frd_m: tuple[float, float, float]
    max_thrust_n: float
    max_reverse_thrust_n: float
    spin_up_s: float
    spin_down_s: float
    steering: SteeringGear | None = None

    def __post_init__(self) -> None:
        _require_vector("propeller", "position_frd_m", self.position_frd_m)
        _require_positive("propeller", max_thrust_n=self.max_thrust_n)
        _require_positive("propeller", spin_up_s=self.spin_up_s, spin_down_s=self.spin_down_s)
        _require_not_negative("propeller", max_reverse_thrust_n=self.max_reverse_thrust_n)


@dataclass(frozen=True, slots=True)
class Windage:
    """Projected areas above the water and the coefficients of Fossen 2021, eq 10.16-10.18."""

    frontal_area_m2: float = 0.0
    lateral_area_m2: float = 0.0
    length_m: float = 0.0
    surge_coefficient: float = 0.0
    sway_coefficient: float = 0.0
    yaw_coefficient: float = 0.0

    def __post_init__(self) -> None:
        _require_not_negative(
            "wind",
            frontal_area_m2=self.frontal_area_m2,
            lateral_area_m2=self.lateral_area_m2,
            length_m=self.length_m,
            surge_coefficient=self.surge_coefficient,
            sway_coefficient=self.sway_coefficient,
        )
        _require(math.isfinite(self.yaw_coefficient), f"wind.yaw_coefficient = {self.yaw_coefficient} must be a number")


@dataclass(frozen=True, slots=True)
class VesselModel:
    """Everything that tells one vessel from another.

    Commands are the throttles of the propellers in their order (port, starboard), then the steering of those that have
    a gear, positive for the bow to starboard with the propeller at the stern.
    """

    name: str
    mass_kg: float
    inertia_kgm2: tuple[float, float, float]
    hull: Hull
    damping_linear: Damping
    damping_quadratic: Damping
    propellers: tuple[Propeller, ...]
    added_mass: AddedMass = AddedMass()
    wind: Windage = Windage()

    def __post_init__(self) -> None:
        _require_positive("vehicle", mass_kg=self.mass_kg)
        _require_vector("vehicle", "inertia_kgm2", self.inertia_kgm2)
        ixx, iyy, izz = self.inertia_kgm2
        _require_positive("vehicle", ixx=ixx, iyy=iyy, izz=izz)
        _require(
            2.0 * max(self.inertia_kgm2) <= sum(self.inertia_kgm2),
            f"vehicle.inertia_kgm2 = {list(self.inertia_kgm2)} belongs to no body: the largest of the three "
            "must not exceed the sum of the other two",
        )
        _require(len(self.propellers) > 0, "vehicle.propellers is empty; give at least one propeller")

    @property
    def commands(self) -> int:
        """How many: one for each propeller and one for each gear."""
        return len(self.propellers) + sum(propeller.steering is not None for propeller in self.propellers)
