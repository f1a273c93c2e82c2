"""A vessel as data: mass, hulls, hydrodynamics, propellers, rudders and windage.

Positions are from the body's origin, axes FRD. The derivatives, matrices and dampings of a vessel hold for that origin;
its centre of gravity may lie elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, field, fields
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import (
    Bounds,
    Items,
    NonNegative,
    Place,
    Positive,
    RegisteredGroups,
    Required,
    Share,
    Specification,
    SpecificationError,
    Vector,
)
from sim_core.vessel.derivatives import COMPONENTS, VELOCITIES, Derivative, parse_derivative
from sim_core.vessel.tables_spec import AbkowitzSpec, MmgSpec

Row = tuple[float, float, float, float, float, float]
Matrix = tuple[Row, Row, Row, Row, Row, Row]
Table = Annotated[tuple[float, ...], Items(2, 200)]
Angle = Annotated[float, Bounds(at_least=-180, at_most=180)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Hull(Specification):
    """Two round demi-hulls: horizontal cylinders with axes half the width less a radius from the middle."""

    length_m: Annotated[Positive, "length of each hull"]
    width_m: Annotated[Positive, "overall width; at least four radii"]
    radius_m: Annotated[Positive, "radius of each hull"]
    strips: Annotated[int, Bounds(at_least=2, at_most=1000), "strips of each hull, for buoyancy and waves"] = 6
    keel_below_cg_m: Annotated[float, "height of the body's origin above the lowest line of the hulls"]

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


@dataclass(frozen=True, slots=True, kw_only=True)
class HullMesh(Specification):
    """A closed mesh from a file (STL, DAE, OBJ, PLY, glTF, GLB) as the shape of a hull.

    The middle of the mesh's lowest line is placed at the hull's keel; the mesh's origin has no effect.
    """

    file: Annotated[str, "path relative to the profile"]
    axes: Annotated[Literal["flu", "frd"], "axes of the mesh: x forward, y left, z up; or y right, z down"] = "flu"
    scale: Annotated[Positive, "metres per unit of the mesh"] = 1.0
    width_m: Annotated[Positive, "overall width"]
    depth_m: Annotated[Positive, "height from its lowest point to the deck"]
    corners: Annotated[
        int, Bounds(at_least=4, at_most=200), "corners of each cross-section cut from it, for buoyancy"
    ] = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualMesh(Specification):
    """A closed mesh from a file (STL, DAE, OBJ, PLY, glTF, GLB) that is drawn instead of the vessel's generated shape.

    It has no effect on forces. Views, pictures, Foxglove and cameras draw it, with the vessel's propellers.
    """

    file: Annotated[str, "path relative to the profile"]
    axes: Annotated[Literal["flu", "frd"], "axes of the mesh: x forward, y left, z up; or y right, z down"] = "flu"
    scale: Annotated[Positive, "metres per unit of the mesh"] = 1.0
    origin_frd_m: Annotated[Vector, "position of the mesh's origin from the body's origin"] = (0.0, 0.0, 0.0)


def _check_rising(path: tuple[str, ...], values: list[float], which: str) -> None:
    for before, after in pairwise(values):
        if after <= before:
            raise SpecificationError(path, f"goes from {before:g} to {after:g}; sort it {which}")


@dataclass(frozen=True, slots=True, kw_only=True)
class HullSection(Specification):
    """Cross-section of a hull: a circle, a box, or offsets such as a V. Give one of the three."""

    radius_m: Annotated[Positive | None, "radius of a circle"] = None
    width_m: Annotated[Positive | None, "width of a box"] = None
    depth_m: Annotated[Positive | None, "height of a box, from keel to deck"] = None
    offsets_m: Annotated[
        Annotated[tuple[Place, ...], Items(2, 50)] | None,
        "a list of [height above the keel, half width] from keel to deck; a V is [[0, 0], [0.3, 0.2]]",
    ] = None

    def check(self) -> None:
        box = self.width_m is not None or self.depth_m is not None
        if (self.radius_m is not None) + box + (self.offsets_m is not None) != 1:
            raise SpecificationError((), "needs one form; give radius_m, or width_m and depth_m, or offsets_m")
        if box and (self.width_m is None or self.depth_m is None):
            raise SpecificationError((), "is a box without its size; give width_m and depth_m")
        table = self.offsets_m
        if table is None:
            return
        heights_m, halves_m = [height_m for height_m, _ in table], [half_m for _, half_m in table]
        if heights_m[0] != 0:
            raise SpecificationError(("offsets_m",), f"begins {heights_m[0]:g} m above the keel; begin at height 0")
        _check_rising(("offsets_m",), heights_m, "from the keel to the deck")
        if min(halves_m) < 0 or not any(halves_m):
            wrong = "no half width above 0" if not any(halves_m) else f"a half width of {min(halves_m):g} m"
            raise SpecificationError(("offsets_m",), f"has {wrong}; give the distance from the middle to the side")

    @property
    def greatest_width_m(self) -> float:
        """Greatest width, from side to side."""
        if self.radius_m is not None:
            return 2.0 * self.radius_m
        return self.width_m or 2.0 * max((half_m for _, half_m in self.offsets_m or ()), default=0.0)

    @property
    def height_m(self) -> float:
        """Height from keel to deck."""
        if self.radius_m is not None:
            return 2.0 * self.radius_m
        return self.depth_m or max((height_m for height_m, _ in self.offsets_m or ()), default=0.0)


_UNTAPERED = ((-0.5, 1.0), (0.5, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class DemiHull(Specification):
    """One of any number of hulls: a section extruded along its length, or a mesh. Give `section` or `mesh`."""

    length_m: Annotated[Positive, "length from end to end of its sections; of a mesh, length of the waterline"]
    keel_frd_m: Annotated[Vector, "position of its lowest line at half the length, from the body's origin"]
    section: HullSection | None = None
    mesh: HullMesh | None = None
    taper: Annotated[
        tuple[Place, ...],
        Items(2, 50),
        "a list of [position from -0.5 at the stern to 0.5 at the bow, share of the section's width there]",
    ] = _UNTAPERED
    strips: Annotated[int, Bounds(at_least=2, at_most=1000), "strips for buoyancy and waves"] = 12

    def check(self) -> None:
        if (self.section is None) == (self.mesh is None):
            raise SpecificationError((), "needs a section or a mesh; give one of the two")
        places, shares = [place for place, _ in self.taper], [share for _, share in self.taper]
        if (places[0], places[-1]) != (-0.5, 0.5):
            raise SpecificationError(
                ("taper",),
                f"reaches from {places[0]:g} to {places[-1]:g} of the length; begin at -0.5, the stern, and end at 0.5",
            )
        _check_rising(("taper",), places, "from stern to bow")
        if min(shares) < 0 or not any(shares):
            wrong = "no share above 0" if not any(shares) else f"a share of {min(shares):g}"
            raise SpecificationError(("taper",), f"has {wrong}; give shares of the section's width")
        if self.mesh is not None and self.taper != _UNTAPERED:
            raise SpecificationError(
                ("taper",), "is only for a section, because a mesh has its own ends; leave out the taper"
            )

    @property
    def prismatic(self) -> bool:
        """Whether the section is the same along the whole length."""
        return self.section is not None and all(share == 1 for _, share in self.taper)

    @property
    def width_m(self) -> float:
        """Greatest width, from side to side."""
        if self.section is not None:
            return self.section.greatest_width_m * max(share for _, share in self.taper)
        assert self.mesh is not None
        return self.mesh.width_m

    @property
    def height_m(self) -> float:
        """Height from keel to deck."""
        shape = self.section.height_m if self.section is not None else self.mesh and self.mesh.depth_m
        assert shape
        return shape


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


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossFlowDrag(Specification):
    """Drag of the flow across the hull, summed over strips (Fossen 2021, section 6.4; Faltinsen 1990, ch. 6)."""

    length_m: Annotated[Positive, "length of the waterline"]
    draft_m: Annotated[Positive, "mean draft"]
    width_m: Annotated[
        Positive | None, "width of the waterline, for Hoerner's curve; required without a coefficient"
    ] = None
    coefficient: Annotated[
        Positive | None, "two-dimensional drag coefficient; null: Hoerner's curve by width over twice the draft"
    ] = None
    strips: Annotated[int, Bounds(at_least=2, at_most=200)] = 20

    def check(self) -> None:
        if self.width_m is None and self.coefficient is None:
            raise SpecificationError((), "needs a drag; give coefficient, or width_m for Hoerner's curve")


@dataclass(frozen=True, slots=True)
class SteeringGear(Specification):
    """A gear that turns a propeller about its mast, up to an angle to either side.

    Its command comes after all throttles.
    """

    max_angle_deg: Annotated[float, Bounds(above=0, at_most=180)]
    rate_degps: Positive


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenWater(Specification):
    """Open-water curve of a propeller: thrust = rho D⁴ K_T(J) n |n|, J = u_a / (n D). Give a table or a polynomial."""

    diameter_m: Positive
    max_speed_rps: Annotated[Positive, "speed of the shaft at full command"]
    advance_ratio: Annotated[Table | None, "values of J, rising from 0"] = None
    thrust_coefficient: Annotated[
        Table | None, "K_T at each J, falling; beyond the last value, its slope continues"
    ] = None
    thrust_polynomial: Annotated[Vector | None, "k0, k1, k2 of K_T = k0 + k1 J + k2 J², up to K_T = 0"] = None
    reverse_share: Annotated[Share, "share of K_T when the propeller turns astern"] = 1.0
    astern_advance_ratio: Annotated[
        Table | None,
        "turning astern: values of J_s = u / (n D), rising, of the hull's speed u without wake; negative with headway",
    ] = None
    astern_thrust_coefficient: Annotated[
        Table | None, "K_T astern at each J_s, positive, instead of reverse_share; beyond, the end values continue"
    ] = None

    @property
    def astern_at_rest(self) -> float:
        """K_T astern at J = 0, positive."""
        if self.astern_advance_ratio is None or self.astern_thrust_coefficient is None:
            return self.reverse_share * self.curve[1][0]
        return _interpolated(0.0, self.astern_advance_ratio, self.astern_thrust_coefficient)

    @property
    def curve(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """J and K_T at each point. A polynomial gives 201 points up to a little beyond its zero."""
        if self.thrust_polynomial is None:
            assert self.advance_ratio is not None
            assert self.thrust_coefficient is not None
            return self.advance_ratio, self.thrust_coefficient
        k0, k1, k2 = self.thrust_polynomial
        zero = -k0 / k1 if k2 == 0 else (-k1 - math.sqrt(k1 * k1 - 4 * k0 * k2)) / (2 * k2)
        ratios = tuple(1.05 * zero * point / 200 for point in range(201))
        return ratios, tuple(k0 + k1 * ratio + k2 * ratio * ratio for ratio in ratios)

    def check(self) -> None:
        self._check_astern()
        ratios, coefficients = self.advance_ratio, self.thrust_coefficient
        if self.thrust_polynomial is not None:
            if ratios is not None or coefficients is not None:
                raise SpecificationError(("thrust_polynomial",), "and a table exclude each other; give one of them")
            k0, k1, k2 = self.thrust_polynomial
            if k0 <= 0:
                raise SpecificationError(
                    ("thrust_polynomial", 0), f"= {k0:g} gives no thrust at rest; use a k0 above 0"
                )
            if k1 >= 0 or k1 * k1 < 4 * k0 * k2:
                raise SpecificationError(
                    ("thrust_polynomial",), "does not fall to K_T = 0 from J = 0 on; look for a wrong sign"
                )
            return
        if ratios is None or coefficients is None:
            raise SpecificationError((), "needs advance_ratio and thrust_coefficient, or thrust_polynomial")
        if len(ratios) != len(coefficients):
            raise SpecificationError(
                ("thrust_coefficient",),
                f"has {len(coefficients)} entries for {len(ratios)} of advance_ratio; give one K_T for each J",
            )
        if ratios[0] != 0 or any(after <= before for before, after in pairwise(ratios)):
            raise SpecificationError(("advance_ratio",), "has to begin at 0 and rise; sort the table by J")
        if coefficients[0] <= 0:
            raise SpecificationError(
                ("thrust_coefficient", 0), f"= {coefficients[0]:g} gives no thrust at rest; use the K_T at J = 0"
            )
        for index, (before, after) in enumerate(pairwise(coefficients), start=1):
            if after >= before:
                raise SpecificationError(
                    ("thrust_coefficient", index),
                    f"= {after:g} does not fall from the {before:g} before it; "
                    "give the K_T of ahead revolutions, which falls with J",
                )

    def _check_astern(self) -> None:
        ratios, coefficients = self.astern_advance_ratio, self.astern_thrust_coefficient
        if ratios is None and coefficients is None:
            return
        _check_pairs(("astern_advance_ratio", "astern_thrust_coefficient"), ratios, coefficients)
        if self.reverse_share != 1.0:
            raise SpecificationError(("reverse_share",), "and a table astern exclude each other; give one of them")
        if self.astern_at_rest <= 0:
            raise SpecificationError(
                ("astern_thrust_coefficient",), "gives no thrust at J_s = 0; write the thrust astern positive"
            )


def _check_pairs(names: tuple[str, str], x: Sequence[float] | None, y: Sequence[float] | None) -> None:
    """Refuse a table whose two columns do not fit together."""
    if x is None or y is None:
        given, missing = names if y is None else names[::-1]
        raise SpecificationError((given,), f"has no {missing}; give both")
    if len(x) != len(y):
        raise SpecificationError((names[1],), f"has {len(y)} entries for {len(x)} of {names[0]}; give one for each")
    _check_rising((names[0],), list(x), "from the smallest on")


def _interpolated(at: float, x: Sequence[float], y: Sequence[float]) -> float:
    """Return y at a point, between the pairs linear, beyond them the end values."""
    pairs = pairwise(zip(x, y, strict=True))
    for (before, low), (after, high) in pairs:
        if at <= after:
            return low + (high - low) * (max(at, before) - before) / (after - before)
    return y[-1]


@dataclass(frozen=True, slots=True, kw_only=True)
class SideForceAstern(Specification):
    """Side force of a propeller that turns astern (paddle-wheel effect), positive to starboard. Give share or table.

    A right-handed propeller pushes the stern to port: negative. See [vessel.md](vessel.md#paddle-wheel-effect).
    """

    share: Annotated[
        float | None,
        Bounds(at_least=-1, at_most=1),
        "share of the thrust at rest astern at the same speed of the shaft",
    ] = None
    advance_ratio: Annotated[
        Table | None, "with open_water: values of J_s, rising, as in open_water.astern_advance_ratio"
    ] = None
    coefficient: Annotated[Table | None, "side force over rho n² D⁴ at each J_s; beyond, the end values continue"] = (
        None
    )
    position_x_m: Annotated[
        float | None, "where it acts ahead of the body's origin; null: at the propeller. The wash also pushes the stern"
    ] = None

    def check(self) -> None:
        table = self.advance_ratio is not None or self.coefficient is not None
        if (self.share is not None) == table:
            raise SpecificationError((), "needs share, or advance_ratio and coefficient; give one of the two")
        if table:
            _check_pairs(("advance_ratio", "coefficient"), self.advance_ratio, self.coefficient)


@dataclass(frozen=True, slots=True)
class Propeller(Specification):
    """A propeller in air or water that pushes at its position along its line; a steering gear can turn this line.

    Its speed follows the command as a first-order lag. Give the thrust at rest, or `open_water`.
    """

    position_frd_m: Annotated[Vector, "position from the body's origin"]
    max_thrust_n: Annotated[Positive | None, "thrust at rest, at full speed ahead"] = None
    max_reverse_thrust_n: Annotated[NonNegative | None, "thrust at rest, at full speed astern"] = None
    spin_up_s: Annotated[Positive, Required, "time constant while it speeds up"] = 0.3
    spin_down_s: Annotated[Positive, Required, "time constant while it slows down"] = 0.3
    steering: SteeringGear | None = None
    medium: Literal["air", "water"] = "air"
    angle_deg: Annotated[Angle, "direction of its thrust: 0 ahead, 90 to starboard as for a bow thruster"] = 0.0
    diameter_m: Annotated[
        Positive | None,
        "in air: thrust falls with the apparent wind by momentum theory; null: it does not. In water: diameter of "
        "the race at a rudder",
    ] = None
    zero_thrust_speed_mps: Annotated[
        Positive | None,
        "in water: speed of advance at which full speed ahead gives no thrust; null: the thrust at rest at any speed",
    ] = None
    open_water: OpenWater | None = None
    wake_fraction: Annotated[float, Bounds(at_least=0, below=1), "share of the hull's speed that the inflow lacks"] = (
        0.0
    )
    thrust_deduction: Annotated[float, Bounds(at_least=0, below=1), "share of the thrust lost to the hull"] = 0.0
    tunnel_speed_mps: Annotated[
        Positive | None,
        "in a tunnel through the hull: forward speed at which 1/e of the thrust remains, exp(-(u / this)²); null: "
        "no tunnel",
    ] = None
    side_force_astern: SideForceAstern | None = None

    def check(self) -> None:
        if (self.open_water is None) == (self.max_thrust_n is None):
            raise SpecificationError((), "needs max_thrust_n or open_water; give one of the two")
        if (self.max_thrust_n is None) != (self.max_reverse_thrust_n is None):
            raise SpecificationError((), "needs max_thrust_n and max_reverse_thrust_n together; give both")
        self._check_medium()

    def _check_medium(self) -> None:
        wet = (self.open_water, self.zero_thrust_speed_mps, self.tunnel_speed_mps, self.wake_fraction or None)
        names = ("open_water", "zero_thrust_speed_mps", "tunnel_speed_mps", "wake_fraction")
        given = [name for name, value in zip(names, wet, strict=True) if value is not None]
        if self.medium == "air" and given:
            raise SpecificationError(
                (given[0],), "is of a propeller in water, and this one is in air; use medium: water"
            )
        if len(laws := [name for name in given if name != "wake_fraction"]) > 1:
            raise SpecificationError((laws[1],), f"and {laws[0]} exclude each other; give one of them")
        if self.tunnel_speed_mps is not None and self.steering is not None:
            raise SpecificationError(
                ("steering",), "turns no thruster in a tunnel; leave out steering or tunnel_speed_mps"
            )
        if self.open_water is not None and self.diameter_m is not None:
            raise SpecificationError(("diameter_m",), "is given by open_water.diameter_m; leave it out")
        self._check_side_force()

    def _check_side_force(self) -> None:
        if (side := self.side_force_astern) is None:
            return
        path = ("side_force_astern",)
        if self.medium == "air" or self.tunnel_speed_mps is not None or self.steering is not None:
            raise SpecificationError(path, "is of a fixed propeller in water behind a hull; leave it out")
        if side.coefficient is not None and self.open_water is None:
            raise SpecificationError((*path, "coefficient"), "needs open_water for n and D; give it, or use share")

    @property
    def disc_diameter_m(self) -> float | None:
        """Diameter of the disc that the propeller sweeps, None if unknown."""
        return self.open_water.diameter_m if self.open_water is not None else self.diameter_m

    def static_thrust_n(self, water_density_kgpm3: float) -> tuple[float, float]:
        """Thrust at rest at full speed, ahead and astern, both positive."""
        if (curve := self.open_water) is None:
            assert self.max_thrust_n is not None
            assert self.max_reverse_thrust_n is not None
            return self.max_thrust_n, self.max_reverse_thrust_n
        per_coefficient = water_density_kgpm3 * curve.diameter_m**4 * curve.max_speed_rps**2
        return per_coefficient * curve.curve[1][0], per_coefficient * curve.astern_at_rest


@dataclass(frozen=True, slots=True, kw_only=True)
class Rudder(Specification):
    """A rudder behind or next to a propeller. Its command comes after all gears, positive for the bow to starboard."""

    position_frd_m: Annotated[Vector, "position of its stock at half its height, from the body's origin"]
    area_m2: Positive
    aspect_ratio: Annotated[Positive, "height over chord, which sets the slope of its normal force"]
    max_angle_deg: Annotated[float, Bounds(above=0, at_most=90)] = 35.0
    rate_degps: Positive = 30.0
    propeller: Annotated[
        Annotated[int, Bounds(at_least=0, at_most=15)] | None,
        "number of the propeller with the race that reaches it, from 0",
    ] = None
    race_share: Annotated[Share, "share of its area in the race"] = 1.0
    wake_fraction: Annotated[
        float, Bounds(at_least=0, below=1), "share of the hull's speed that the inflow outside the race lacks"
    ] = 0.0
    stall_deg: Annotated[
        float, Bounds(at_least=5, at_most=60), "angle of attack at which it stalls; smaller in a free stream"
    ] = 35.0

    @property
    def normal_force_slope(self) -> float:
        """C_N over the sine of the angle of attack (Fujii & Tsuda 1961; MMG standard method, Yasukawa 2015)."""
        return 6.13 * self.aspect_ratio / (self.aspect_ratio + 2.25)


@dataclass(frozen=True, slots=True)
class Windage(Specification):
    """Projected areas above the water and the wind coefficients of Fossen 2021, eq 10.16-10.18."""

    frontal_area_m2: Annotated[NonNegative, Required] = 0.0
    lateral_area_m2: Annotated[NonNegative, Required] = 0.0
    length_m: Annotated[NonNegative, Required, "overall length; the lever of the yaw moment"] = 0.0
    surge_coefficient: Annotated[NonNegative, Required] = 0.0
    sway_coefficient: Annotated[NonNegative, Required] = 0.0
    yaw_coefficient: Annotated[float, Required] = 0.0
    height_m: Annotated[
        Positive | None, "height of the areas' centre above the water at rest; null: half of lateral area over length"
    ] = None

    @property
    def centre_height_m(self) -> float:
        """Height of the centre of the areas above the water at rest."""
        if self.height_m is not None:
            return self.height_m
        return 0.5 * self.lateral_area_m2 / self.length_m if self.length_m else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BatterySpec(Specification):
    """The battery that feeds all propellers: [vessel.md](vessel.md#battery)."""

    cells: Annotated[int, Bounds(at_least=1, at_most=1000), "number of cells in series"]
    full_voltage_v: Annotated[Positive, "voltage at the terminals, without current"]
    empty_voltage_v: Annotated[Positive, "the same at no charge; between the two, it falls with the charge"]
    capacity_ah: Positive
    resistance_ohm: Annotated[NonNegative, "resistance of cells and wires"]
    full_current_a: Annotated[Positive, "current of all propellers at full speed"]
    idle_current_a: Annotated[NonNegative, "current of all other devices on board"] = 0.0
    initial_charge: Annotated[Share, "share of the capacity"] = 1.0

    def check(self) -> None:
        if self.empty_voltage_v > self.full_voltage_v:
            raise SpecificationError(
                ("empty_voltage_v",),
                f"= {self.empty_voltage_v:g} is above full_voltage_v ({self.full_voltage_v:g}); lower it",
            )
        if self.resistance_ohm * (self.full_current_a + self.idle_current_a) >= 0.5 * self.empty_voltage_v:
            raise SpecificationError(
                ("resistance_ohm",),
                f"= {self.resistance_ohm:g} takes half of empty_voltage_v or more at full_current_a; lower one of them",
            )


_PIVOT_ROUNDING = 1e-9


def lacking_diagonal(matrix: Sequence[Sequence[float]]) -> tuple[int, float] | None:
    """Return the first row with a diagonal entry too small for a definite symmetric part, and the required minimum.

    Return None if the symmetric part is positive semi-definite. The method is elimination. If the rows above are
    positive definite, the part remains so if and only if the remaining pivot is not negative.
    """
    size = len(matrix)
    rest = [[0.5 * (matrix[i][j] + matrix[j][i]) for j in range(size)] for i in range(size)]
    scale = [max(abs(entry) for entry in row) for row in rest]
    for k in range(size):
        pivot, below = rest[k][k], range(k + 1, size)
        tied = any(abs(rest[j][k]) > _PIVOT_ROUNDING * (scale[j] + scale[k]) for j in below)
        if pivot < -_PIVOT_ROUNDING * scale[k] or (pivot <= _PIVOT_ROUNDING * scale[k] and tied):
            return k, matrix[k][k] - pivot
        if tied:
            for i in below:
                share = rest[i][k] / pivot
                for j in below:
                    rest[i][j] -= share * rest[k][j]
    return None


def _refuse_indefinite(
    key: str, matrix: Sequence[Sequence[float]], definite: str, diagonal: Sequence[str] | None = None
) -> None:
    """Raises SpecificationError for a matrix whose symmetric part has a negative eigenvalue; diagonal: its names."""
    lacking = lacking_diagonal(matrix)
    if lacking is None:
        return
    row, least = lacking
    entry = diagonal[row] if diagonal else f"row {row + 1}, column {row + 1}"
    raise SpecificationError(
        (key,),
        f"is not {definite}: {entry} = {matrix[row][row]:g} must be at least {least:g} for the entries off the "
        "diagonal; raise it, reduce those entries, or look for a wrong sign",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class VesselSpec(Specification):
    """The vessel: mass, hulls, hydrodynamics, propellers, rudders and windage.

    Commands are the throttles of the propellers in their order, then the steering of those that have a gear, then the
    rudders, then the commands of `actuators`; steering is positive for the bow to starboard with the propeller or
    rudder at the stern.
    """

    name: str
    cruise_speed_mps: Annotated[Positive | None, "speed over ground for a mission that gives none"] = None
    mass_kg: Positive
    inertia_kgm2: Annotated[
        tuple[Positive, Positive, Positive], "moments about x, y and z through the centre of gravity"
    ]
    inertia_products_kgm2: Annotated[
        Vector, "products Ixy, Ixz and Iyz at the centre of gravity: the negative of the matrix's entries"
    ] = (
        0.0,
        0.0,
        0.0,
    )
    centre_of_gravity_frd_m: Annotated[Vector, "position from the body's origin"] = (0.0, 0.0, 0.0)
    hull: Annotated[Hull | None, "a catamaran with two round hulls; null: `hulls` is used"] = None
    hulls: Annotated[tuple[DemiHull, ...], Items(0, 100), "any other hulls, instead of `hull`"] = ()
    visual: Annotated[VisualMesh | None, "null: a shape that follows from the other keys is drawn"] = None
    hydrodynamics_file: Annotated[
        str | None,
        "wave forces and mean drift of a panel code, written by `xitl vehicle hydrodynamics`: path relative to the "
        "profile; null: strip theory",
    ] = None
    added_mass: AddedMass = AddedMass()
    added_mass_matrix: Annotated[Matrix | None, "instead of `added_mass`: six rows of six, positive definite"] = None
    damping_linear: Damping = Damping()
    damping_linear_matrix: Annotated[Matrix | None, "instead of `damping_linear`: six rows of six"] = None
    damping_quadratic: Damping = Damping()
    derivatives: Annotated[
        dict[str, float],
        "values by SNAME name with their signs, such as Y_rv or X_uuu: [vessel.md](vessel.md#derivatives)",
    ] = field(default_factory=dict)
    derivatives_contain: Annotated[
        Literal["damping", "munk_moment", "added_mass_coriolis", "coriolis"] | None,
        "terms of surge, sway and yaw in `derivatives` or `abkowitz`; xitl adds the other Coriolis terms: "
        "[vessel.md](vessel.md#coriolis-terms-in-a-table); null: damping, required for `abkowitz`",
    ] = None
    mmg: Annotated[MmgSpec | None, "surge, sway and yaw by the MMG standard method: [vessel.md](vessel.md#mmg)"] = None
    abkowitz: Annotated[
        AbkowitzSpec | None, "surge, sway and yaw by Abkowitz's form: [vessel.md](vessel.md#abkowitz)"
    ] = None
    cross_flow_drag: CrossFlowDrag | None = None
    centre_of_lateral_resistance_frd_m: Annotated[
        Vector | None,
        "point of action of added_mass and the per-axis dampings; null: amidships at half the draft. Matrices and "
        "derivatives act at the body's origin",
    ] = None
    stern_force: Annotated[
        Literal["on", "off"] | None,
        "side force of the flow that a blunt stern sheds: [vessel.md](vessel.md#stern-force); null: on, but off "
        "if matrices or derivatives are given",
    ] = None
    confined_water: Annotated[
        bool,
        "effects of a bottom near the keel, from the depth below it: "
        "[vessel.md](vessel.md#shallow-water); false: deep water",
    ] = True
    propellers: Annotated[tuple[Propeller, ...], Items(1, 16), "port first, then starboard"]
    rudders: Annotated[tuple[Rudder, ...], Items(0, 8)] = ()
    actuators: Annotated[
        dict[str, Any],
        RegisteredGroups("xitl.actuators"),
        "actuators of packages, by name: [plugins.md](plugins.md#an-actuator); the package has their keys",
    ] = field(default_factory=dict)
    wind: Annotated[Windage, Required] = Windage()
    battery: Annotated[BatterySpec | None, "null: no battery model"] = None

    def check(self) -> None:
        ixx, iyy, izz = self.inertia_kgm2
        largest, total = max(ixx, iyy, izz), ixx + iyy + izz
        if 2 * largest > total * (1 + 1e-9):
            raise SpecificationError(
                ("inertia_kgm2",),
                f"= [{ixx:g}, {iyy:g}, {izz:g}] belongs to no body: one moment exceeds the sum of the other two; "
                f"lower it to {total - largest:g} or less",
            )
        if self.hull is not None and self.hulls:
            raise SpecificationError(
                ("hulls",), "and `hull` exclude each other; keep one, `hull: null` drops an inherited one"
            )
        if self.hull is None and not self.hulls:
            raise SpecificationError(("hull",), "is missing; give it or `hulls`")

        self._check_inertia()
        parsed = {}
        for name in self.derivatives:
            try:
                parsed[name] = parse_derivative(name)
            except ValueError as error:
                raise SpecificationError(("derivatives", name), str(error)) from None
        if self.table_key is not None:
            self._check_table(self.table_key, parsed)
        elif self.derivatives_contain not in (None, "damping") and not self.derivatives:
            raise SpecificationError(
                ("derivatives_contain",), "is of `derivatives` or `abkowitz`, and this vessel has neither; leave it out"
            )
        self._check_given_once(parsed)
        self._check_signs(parsed)
        self._check_definite(parsed)
        for number, rudder in enumerate(self.rudders):
            if rudder.propeller is not None:
                self._check_race(("rudders", number), rudder, rudder.propeller)

        self._check_actuators()

    @property
    def table_key(self) -> Literal["mmg", "abkowitz"] | None:
        """Key of the table that gives the forces in surge, sway and yaw; None for the other forms."""
        return "mmg" if self.mmg is not None else "abkowitz" if self.abkowitz is not None else None

    @property
    def table_contains(self) -> Literal["damping", "munk_moment", "added_mass_coriolis", "coriolis"]:
        """What the table of surge, sway and yaw contains of the Coriolis terms."""
        return "munk_moment" if self.mmg is not None else self.derivatives_contain or "damping"

    def _check_table(self, key: str, parsed: dict[str, Derivative]) -> None:
        """Check that nothing else gives forces in surge, sway and yaw, and that the actuators fit the table."""
        if self.mmg is not None and self.abkowitz is not None:
            raise SpecificationError(("abkowitz",), "and `mmg` exclude each other; keep one")
        if self.mmg is not None and self.derivatives_contain is not None:
            text = "is fixed for `mmg`: its table contains the Munk moment; leave it out"
            raise SpecificationError(("derivatives_contain",), text)
        if self.abkowitz is not None and self.derivatives_contain is None:
            text = "is missing; write `coriolis` if Y_r contains -m u, or else `added_mass_coriolis` if N_v contains "
            raise SpecificationError(("derivatives_contain",), text + "the Munk moment, or `damping`")
        for other in ("added_mass_matrix", "damping_linear_matrix", "cross_flow_drag"):
            if getattr(self, other) is not None:
                raise SpecificationError(
                    (other,), f"and `{key}` both give forces in sway and yaw; leave one of them out"
                )
        if self.stern_force == "on":
            raise SpecificationError(("stern_force",), f"is part of the table `{key}`; use off, or leave it out")
        for group in ("added_mass", "damping_linear", "damping_quadratic"):
            for each in fields(given := getattr(self, group)):
                if each.name.startswith(("surge", "sway", "yaw")) and getattr(given, each.name):
                    text = f"and `{key}` both give it; leave it out, or set it to 0"
                    raise SpecificationError((group, each.name), text)
        for name, derivative in parsed.items():
            involved = {derivative.component, derivative.acceleration, *(index for index, _ in derivative.factors)}
            if involved <= {None, 0, 1, 5}:
                raise SpecificationError(("derivatives", name), f"and `{key}` both give it; leave one of them out")
        self._check_table_actuators(key)

    def _check_table_actuators(self, key: str) -> None:
        if not self.rudders:
            raise SpecificationError(("rudders",), f"are missing; `{key}` describes a vessel with a rudder")
        for number, propeller in enumerate(self.propellers):
            if propeller.medium != "water" or propeller.steering is not None or propeller.angle_deg:
                text = f"does not push straight ahead in water, as `{key}` assumes; use `derivatives` for this vessel"
                raise SpecificationError(("propellers", number), text)
        if self.mmg is not None:
            for number, rudder in enumerate(self.rudders):
                if rudder.propeller is None:
                    raise SpecificationError(
                        ("rudders", number, "propeller"), "is missing; give the number of the propeller before it"
                    )
        elif len(self.rudders) > 1:
            raise SpecificationError(("rudders",), "are more than one; the table has one rudder angle")

    def _check_actuators(self) -> None:
        """Check the names of the added commands, which come from the code of packages."""
        for name, one in self.actuators.items():
            try:
                commands = tuple(f"{name} {command}".rstrip() for command in one.commands)
            except Exception as error:
                reason = " ".join(f"{type(error).__name__}: {error}".split())
                why = f"has no commands ({reason}); correct its package"
                raise SpecificationError(("actuators", name), why) from error
            if twice := next((each for each in commands if self.command_names.count(each) > 1), None):
                why = f"has a command {twice!r}, which is there twice; rename it"
                raise SpecificationError(("actuators", name), why)

    def _check_inertia(self) -> None:
        """Check that a body with this inertia exists.

        The sum of m r r^T over the body, half the trace less the tensor, is positive semi-definite for any body.
        """
        half = 0.5 * sum(self.inertia_kgm2)
        xy, xz, yz = self.inertia_products_kgm2
        spread = [[half, xy, xz], [xy, half, yz], [xz, yz, half]]
        for axis, moment in enumerate(self.inertia_kgm2):
            spread[axis][axis] -= moment
        if lacking_diagonal(spread) is not None:
            raise SpecificationError(
                ("inertia_products_kgm2",),
                f"= [{xy:g}, {xz:g}, {yz:g}] belong to no body: they are too large for the moments of inertia_kgm2; "
                "reduce them",
            )

    def _check_given_once(self, parsed: dict[str, Derivative]) -> None:
        """Check that each term is given once: by its matrix, by its axis or by its name."""
        masses, linear = astuple(self.added_mass), astuple(self.damping_linear)
        for matrix, per_axis, values in (
            ("added_mass_matrix", "added_mass", masses),
            ("damping_linear_matrix", "damping_linear", linear),
        ):
            given = [field.name for field, value in zip(fields(getattr(self, per_axis)), values, strict=True) if value]
            if getattr(self, matrix) is not None and given:
                text = f"and {per_axis}.{given[0]} both give it; leave out the matrix, or set {per_axis} to 0"
                raise SpecificationError((matrix,), text)
        quadratic = astuple(self.damping_quadratic)
        first: dict[object, str] = {}
        for name, derivative in parsed.items():
            component, acceleration, factors = derivative.term
            other = first.setdefault(derivative.term, name)
            if other != name:
                raise SpecificationError(("derivatives", name), f"and {other} are the same term; leave one of them out")
            also = None
            if acceleration is not None and self.added_mass_matrix is not None:
                also = "added_mass_matrix"
            elif acceleration == component and masses[component]:
                also = f"added_mass.{fields(AddedMass)[component].name}"
            elif derivative.linear is not None and self.damping_linear_matrix is not None:
                also = "damping_linear_matrix"
            elif derivative.linear == component and linear[component]:
                also = f"damping_linear.{fields(Damping)[component].name}"
            elif factors == ((component, False), (component, True)) and quadratic[component]:
                also = f"damping_quadratic.{fields(Damping)[component].name}"
            if also is not None:
                raise SpecificationError(
                    ("derivatives", name), f"and {also} both give it; leave one of them out, or set {also} to 0"
                )

    def _check_signs(self, parsed: dict[str, Derivative]) -> None:
        """Check the signs of the linear and the highest damping term and of the added mass of each axis."""
        highest: dict[int, tuple[int, str]] = {}
        for name, derivative in parsed.items():
            order = derivative.own_order
            if order > highest.get(derivative.component, (0, ""))[0]:
                highest[derivative.component] = order, name
        for name, value in self.derivatives.items():
            own = name in [most for _, most in highest.values()] or parsed[name].own_order == 1
            if value > 0 and (own or parsed[name].acceleration == parsed[name].component):
                effect = "drives the hull" if parsed[name].acceleration is None else "is a negative mass"
                raise SpecificationError(
                    ("derivatives", name),
                    f"= {value:g} {effect}: SNAME's derivatives carry the sign of the force; write {-value:g}",
                )

    def _check_definite(self, parsed: dict[str, Derivative]) -> None:
        """Check that added mass and linear damping never drive: the first in all forms, the second as a matrix.

        Published tables have pairs of linear derivatives, fitted at speed, that are indefinite at rest.
        """
        if self.damping_linear_matrix is not None:
            _refuse_indefinite("damping_linear_matrix", self.damping_linear_matrix, "positive semi-definite")
        if self.added_mass_matrix is not None:
            _refuse_indefinite("added_mass_matrix", self.added_mass_matrix, "positive definite")
            return
        masses = [[mass if i == j else 0.0 for j in range(6)] for i, mass in enumerate(astuple(self.added_mass))]
        for name, derivative in parsed.items():
            if derivative.acceleration is not None:
                masses[derivative.component][derivative.acceleration] -= self.derivatives[name]
        names = [f"-{component}_{velocity}dot" for component, velocity in zip(COMPONENTS, VELOCITIES, strict=True)]
        _refuse_indefinite("derivatives", masses, "positive definite", names)

    def _check_race(self, path: tuple[str | int, ...], rudder: Rudder, number: int) -> None:
        path = (*path, "propeller")
        if number >= len(self.propellers):
            last = len(self.propellers) - 1
            raise SpecificationError(
                path, f"= {number} is no propeller; use 0{f' to {last}' if last else ''}, or leave it out"
            )
        one = self.propellers[number]
        if one.medium != "water":
            problem = "is in air; use the number of one in water"
        elif one.disc_diameter_m is None:
            problem = f"has no diameter for its race; give propellers.{number}.diameter_m"
        elif one.steering is not None or one.tunnel_speed_mps is not None or one.angle_deg != 0:
            problem = "does not push straight ahead, so that its race misses the rudder; leave the key out"
        elif one.position_frd_m[0] < rudder.position_frd_m[0]:
            problem = (
                f"= {number} stands {rudder.position_frd_m[0] - one.position_frd_m[0]:g} m behind the rudder; "
                "place it ahead of the rudder, or leave the key out"
            )
            raise SpecificationError(path, problem)
        else:
            return
        raise SpecificationError(path, f"= {number} {problem}")

    @property
    def demi_hulls(self) -> tuple[DemiHull, ...]:
        """All hulls. `hull` gives two hulls with a round section, port first."""
        return self.hulls if self.hull is None else _round_demi_hulls(self.hull)

    @property
    def hulls_key(self) -> str:
        """Key that gives the hulls."""
        return "hulls" if self.hull is None else "hull"

    @property
    def length_m(self) -> float:
        """Overall length of all hulls."""
        ends = [(hull.keel_frd_m[0], 0.5 * hull.length_m) for hull in self.demi_hulls]
        return max(middle + half for middle, half in ends) - min(middle - half for middle, half in ends)

    @property
    def midship_frd_x_m(self) -> float:
        """Position halfway along all hulls, forward of the body's origin."""
        ahead = max(hull.keel_frd_m[0] + 0.5 * hull.length_m for hull in self.demi_hulls)
        return ahead - 0.5 * self.length_m

    @property
    def width_m(self) -> float:
        """Overall width of all hulls."""
        sides = [(hull.keel_frd_m[1], 0.5 * hull.width_m) for hull in self.demi_hulls]
        return max(middle + half for middle, half in sides) - min(middle - half for middle, half in sides)

    @property
    def keel_m(self) -> float:
        """Depth of the lowest line of all hulls below the body's origin."""
        return max(hull.keel_frd_m[2] for hull in self.demi_hulls)

    @property
    def commands(self) -> int:
        """How many: a throttle for each propeller, a steering for each gear, one for each rudder, and those added."""
        return len(self.command_names)

    @property
    def own_commands(self) -> int:
        """How many without those of `actuators`."""
        return len(self._own_command_names)

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names of the commands in their order: `propeller 0`, `steering 0` for the gear of propeller 0, `rudder 0`.

        The commands of `actuators` follow: `NAME`, or `NAME COMMAND`.
        """
        if not self.actuators:
            return self._own_command_names
        added = (f"{name} {command}".rstrip() for name, one in self.actuators.items() for command in one.commands)
        return *self._own_command_names, *added

    @property
    def _own_command_names(self) -> tuple[str, ...]:
        return (
            *(f"propeller {number}" for number in range(len(self.propellers))),
            *(f"steering {number}" for number, one in enumerate(self.propellers) if one.steering is not None),
            *(f"rudder {number}" for number in range(len(self.rudders))),
        )

    @property
    def steering_names(self) -> tuple[str, ...]:
        """The rudders among the commands, then the gears that turn a propeller."""
        names = self._own_command_names[len(self.propellers) :]
        return tuple(sorted(names, key=lambda name: not name.startswith("rudder")))

    def full_angle_deg(self, name: str) -> float:
        """To either side, of one of `steering_names`."""
        kind, number = name.split()
        if kind == "rudder":
            return self.rudders[int(number)].max_angle_deg
        gear = self.propellers[int(number)].steering
        assert gear is not None
        return gear.max_angle_deg

    def actuator_named(self, name: str) -> str | None:
        """The command of this name; `port` and `starboard` are the one propeller on that side. None: there is none."""
        if name in self.command_names:
            return name
        if name not in ("port", "starboard"):
            return None
        side = -1.0 if name == "port" else 1.0
        found = [number for number, each in enumerate(self.propellers) if side * each.position_frd_m[1] > 0.0]
        return f"propeller {found[0]}" if len(found) == 1 else None

    @property
    def moves_by_sticks(self) -> bool:
        """Whether steering and throttle say all: of two propellers without more, or one with its gear or rudders."""
        propellers, steering = len(self.propellers), self.own_commands - len(self.propellers)
        if self.commands > self.own_commands:
            return False
        return (propellers, steering) == (2, 0) or (propellers == 1 and steering > 0)

    @property
    def command_kinds(self) -> str:
        """Numbers of commands by kind, for error messages: `2 propellers, 1 steering, 2 rudders`."""
        gears = self.own_commands - len(self.propellers) - len(self.rudders)
        counts = (
            ("propeller", len(self.propellers)),
            ("steering", gears),
            ("rudder", len(self.rudders)),
            ("added command", self.commands - self.own_commands),
        )
        plural = {"propeller": "s", "steering": "", "rudder": "s", "added command": "s"}
        return ", ".join(f"{count} {kind}{plural[kind] if count > 1 else ''}" for kind, count in counts if count)


@lru_cache(maxsize=16)  # a vessel asks for them a dozen times while it is checked and made
def _round_demi_hulls(hull: Hull) -> tuple[DemiHull, ...]:
    return tuple(
        DemiHull(
            length_m=hull.length_m,
            keel_frd_m=(0.0, side * hull.centreline_m, hull.keel_below_cg_m),
            section=HullSection(radius_m=hull.radius_m),
            strips=hull.strips,
        )
        for side in (-1.0, 1.0)
    )
