"""Forces on a vessel in moving water: inertia, added mass, Coriolis terms, damping, cross-flow drag, weight offset.

Fossen's vectorial form (Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, ch. 6) about the
body's origin, with nu_r the velocity relative to the water, solved for the inertial acceleration. With M = M_RB + M_A,
v_r and w the linear and angular parts of nu_r, and a_f the acceleration of the water:

    M x = tau - D(nu_r) nu_r - C(nu_r) nu_r + M [w x v_r; 0] + M_A [a_f; 0]

x holds the acceleration against NED, expressed in body axes, and the angular acceleration. In a steady uniform current
this is his M nu_r' + C(nu_r) nu_r + D(nu_r) nu_r = tau (eq 6.119), since nu_r' = x - [w x v_r; 0].

A table's M_A need not be symmetric. M uses it unchanged. C(nu_r) uses its symmetric part, because only this part has a
kinetic energy.

Values per axis (added mass, dampings) act at the centre of lateral resistance, matrices and derivatives at the origin.
docs/vessel.md has all terms, and the force at a blunt stern.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import astuple, replace

import numpy as np
from numpy import intp
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.vessel.confined_water import ConfinedWater, Squat
from sim_core.vessel.derivatives import Derivative, parse_derivative
from sim_core.vessel.spec import CrossFlowDrag, Matrix, VesselSpec
from sim_core.vessel.tables import AbkowitzTerms, MmgHull, abkowitz_added_mass, mmg_added_mass

# Hoerner, Fluid-Dynamic Drag, 1965: drag of a section in cross-flow over half its width by its draft, with the values
# of Fossen's Marine Systems Simulator.
_DRAG_OF_SECTIONS = (
    (0.0109, 1.9661), (0.1766, 1.9657), (0.3530, 1.8976), (0.4519, 1.7872), (0.4728, 1.5837), (0.4929, 1.2786),
    (0.4933, 1.2108), (0.5585, 1.0836), (0.6464, 0.9986), (0.8336, 0.8796), (0.9880, 0.8284), (1.3081, 0.7599),
    (1.6392, 0.6914), (1.8600, 0.6571), (2.3129, 0.6307), (2.6000, 0.5962), (3.0088, 0.5868), (3.4508, 0.5859),
    (3.7379, 0.5599), (4.0031, 0.5593),
)  # fmt: skip


def hoerner_coefficient(width_m: float, draft_m: float) -> float:
    """Return the two-dimensional cross-flow drag of a section, constant beyond the ends of the curve."""
    ratio, coefficient = np.array(_DRAG_OF_SECTIONS).T
    return float(np.interp(0.5 * width_m / draft_m, ratio, coefficient))


@dataclass(frozen=True, slots=True, eq=False)
class Hydrodynamics:
    """Constants of one vessel: its (6, 6) mass matrices and the contribution of each of the `terms` to the force.

    A term that the vessel does not have is omitted.
    """

    rigid_mass: Array
    added_mass: Array
    inverse_mass: Array  # for row vectors
    parts: tuple[HullPart, ...]
    wrench: Array  # (terms, 6)
    weight_per_n: Array  # (3, 6) force and moment of a weight of 1 N along the body's axes

    @classmethod
    def from_spec(
        cls, model: VesselSpec, water_density_kgpm3: float, draft_m: float, confined: ConfinedWater | None = None
    ) -> Hydrodynamics:
        """Compute the constants from the vessel's data. draft_m: draft of the keel at rest. confined: None for deep
        water.
        """
        centre = centre_of_lateral_resistance(model, draft_m)
        named = [(parse_derivative(name), value) for name, value in model.derivatives.items()]
        # M, and M [w x v; 0] - C(nu) nu
        rigid_mass, added_mass = rigid_body_mass(model), added_mass_matrix(model, named, centre)
        table_mass, table = _table(model, water_density_kgpm3, centre, confined)
        added_mass = added_mass + table_mass
        quadratic = np.array(astuple(model.damping_quadratic))
        linear = -linear_damping(model, named, centre)
        across = 1.0
        if confined is not None and model.abkowitz is None:
            added_mass = confined.congruent[:, None] * added_mass * confined.congruent
            linear = linear * confined.damping
            across = float(confined.damping[1, 1])
            quadratic = quadratic * [confined.resistance, across, 1.0, 1.0, 1.0, across]
            named = [(derivative, value * _share(derivative, confined.damping)) for derivative, value in named]
        mass: Array = rigid_mass + added_mass
        products = transport_products(mass) - added_coriolis_products(rigid_mass, added_mass, model.table_contains)
        # -D(nu) nu: linear, per axis and at the stern, across the hull, and by name
        parts: list[HullPart] = list(table)
        shed = has_stern_force(model)
        if shed or quadratic.any():
            stern_products, stern_lift = stern_forces(added_mass, model.length_m)
            parts.append(AxisDrag.at_centre_of(centre, quadratic, stern_lift if shed else None))
            if shed:
                products += moved_products(stern_products, centre)
        if model.cross_flow_drag is not None:
            parts.append(CrossFlow.from_spec(model.cross_flow_drag, across * water_density_kgpm3, centre))
        further = []
        for derivative, value in named:
            plain = [index for index, magnitude in derivative.factors if not magnitude]
            if len(plain) == len(derivative.factors) == 2:
                products[6 * plain[0] + plain[1], derivative.component] += value
            elif derivative.acceleration is None and derivative.linear is None:
                further.append((derivative, value))
        if further:
            parts.append(Polynomial.from_derivatives(further))
        if confined is not None and confined.sinks:
            drag = -quadratic[0] * moved_to(centre)[0] + _drag(model, further, water_density_kgpm3, confined, centre)
            parts.append(Squat.from_parts(confined, linear[:, 0], drag))
        return cls(
            rigid_mass=rigid_mass,
            added_mass=added_mass,
            inverse_mass=np.linalg.inv(mass.T).astype(np.float64),
            parts=tuple(parts),
            wrench=np.concatenate([products, linear.T, *(part.wrench for part in parts)]),
            weight_per_n=moved_to(np.array(model.centre_of_gravity_frd_m))[:3],
        )

    @property
    def linear_damping(self) -> Array:
        """Linear damping, (6, 6), positive, for column vectors."""
        return -self.wrench[36:42].T

    def terms(self, nu_r: Array) -> list[Array]:
        """Return the linear terms of the forces for (N, 6) relative velocities: (N, 36), (N, 6) and the terms of the
        parts.
        """
        terms = [(nu_r[:, :, None] * nu_r[:, None, :]).reshape(-1, 36), nu_r]
        for part in self.parts:
            terms += part.terms(nu_r)
        return terms


@dataclass(frozen=True, slots=True, eq=False)
class AxisDrag:
    """Terms with nu |nu| per axis, and with |u| nu for a stern that sheds, at the centre of lateral resistance."""

    at_centre: Array  # (6, 6) for row vectors: velocity at the centre
    shed: bool
    wrench: Array  # (6 or 12, 6)

    @classmethod
    def at_centre_of(cls, centre: Array, quadratic: Array, stern_lift: Array | None) -> AxisDrag:
        """Return the drag. quadratic: damping per axis, (6,). stern_lift: from `stern_forces`, None for none."""
        wrench = -np.diag(quadratic)
        if stern_lift is not None:
            wrench = np.concatenate([wrench, stern_lift])
        move = moved_to(centre)
        return cls(move.T, stern_lift is not None, wrench @ move)

    def terms(self, nu_r: Array) -> tuple[Array, ...]:
        """Return one or two arrays (N, 6)."""
        nu = nu_r.dot(self.at_centre)
        magnitude = np.abs(nu)
        return (nu * magnitude, nu * magnitude[:, :1]) if self.shed else (nu * magnitude,)


@dataclass(frozen=True, slots=True, eq=False)
class CrossFlow:
    """Drag of S strips in the flow across the hull, v + x r - z p: -1/2 rho C_D T dx |v| v at (x, y, z) of each."""

    across: Array
    """(6, S), speed across at each strip."""
    wrench: Array
    """(S, 6)."""

    @classmethod
    def from_spec(cls, spec: CrossFlowDrag, water_density_kgpm3: float, centre: Array) -> CrossFlow:
        """Return strips along the waterline. Their middle is above the centre of lateral resistance."""
        coefficient = spec.coefficient
        if coefficient is None:
            assert spec.width_m is not None
            coefficient = hoerner_coefficient(spec.width_m, spec.draft_m)
        along_m = spec.length_m * ((np.arange(spec.strips) + 0.5) / spec.strips - 0.5)
        across = np.array([moved_to(centre + np.array([x, 0.0, 0.0]))[1] for x in along_m])
        strip = 0.5 * water_density_kgpm3 * coefficient * spec.draft_m * spec.length_m / spec.strips
        return cls(across.T, -strip * across)

    def terms(self, nu_r: Array) -> tuple[Array]:
        """Return (N, S)."""
        speed = nu_r.dot(self.across)
        return (speed * np.abs(speed),)


@dataclass(frozen=True, slots=True, eq=False)
class Polynomial:
    """Products of up to three velocities or their magnitudes, by name."""

    factors: tuple[NDArray[intp], NDArray[intp], NDArray[intp]]  # each (K,): velocities, magnitudes, 1
    wrench: Array  # (K, 6)

    @classmethod
    def from_derivatives(cls, named: list[tuple[Derivative, float]]) -> Polynomial:
        """Return one term for each derivative."""
        wrench = np.zeros((len(named), 6))
        factors = np.full((3, len(named)), 12)
        for number, (derivative, value) in enumerate(named):
            wrench[number, derivative.component] = value
            for place, (index, magnitude) in enumerate(derivative.factors):
                factors[place, number] = index + 6 * magnitude
        return cls((factors[0], factors[1], factors[2]), wrench)

    def terms(self, nu_r: Array) -> tuple[Array]:
        """Return (N, K)."""
        values = np.concatenate((nu_r, np.abs(nu_r), np.ones((len(nu_r), 1))), axis=1)
        first, second, third = self.factors
        return (values[:, first] * values[:, second] * values[:, third],)


HullPart = AxisDrag | CrossFlow | Polynomial | MmgHull | AbkowitzTerms | Squat


def _share(derivative: Derivative, factors: Array) -> float:
    """Return the factor of a named term in confined water.

    Terms of one speed across or turn times u have the factor of the linear derivative, and squares that of cross-flow.
    """
    if derivative.acceleration is not None or derivative.linear is not None:
        return 1.0  # part of the matrices
    component, speeds = derivative.component, {index for index, _ in derivative.factors}
    of_side = [index for index, _ in derivative.factors if index in (1, 5)]
    if component in (1, 5) and of_side and speeds <= {0, 1, 5}:
        return float(factors[component, of_side[0]] if len(of_side) == 1 else factors[1, 1])
    return float(factors[0, 0]) if component == 0 and speeds == {0} else 1.0


def _drag(
    model: VesselSpec,
    named: list[tuple[Derivative, float]],
    density_kgpm3: float,
    confined: ConfinedWater,
    centre: Array,
) -> Array:
    """Return the (6,) force and moment per u |u| of named resistance and of a table's."""
    drag = np.zeros(6)
    drag[0] = sum(value for derivative, value in named if derivative.term[::2] == (0, ((0, False), (0, True))))
    if model.mmg is not None:
        area_m2 = confined.resistance * model.mmg.r_0 * model.mmg.length_m * model.mmg.draft_m
        drag -= 0.5 * density_kgpm3 * area_m2 * at_table(centre)[0]
    return drag


def _table(
    model: VesselSpec, density_kgpm3: float, centre: Array, confined: ConfinedWater | None
) -> tuple[Array, tuple[HullPart, ...]]:
    """Return added mass (6, 6) about the origin and the forces of a published table in surge, sway and yaw."""
    place = at_table(centre)
    if model.mmg is not None:
        mass, table = mmg_added_mass(model.mmg, density_kgpm3), model.mmg
        if confined is not None:
            linear = {"Y_v": (1, 1), "Y_r": (1, 5), "N_v": (5, 1), "N_r": (5, 5)}
            factors = {name: float(confined.damping[at]) for name, at in linear.items()}
            factors |= dict.fromkeys(("N_vvr", "N_vrr"), confined.turn_in_drift)
            derivatives = {name: value * factors.get(name, 1.0) for name, value in table.derivatives.items()}
            table = replace(table, r_0=table.r_0 * confined.resistance, derivatives=derivatives)
        return place.T @ mass @ place, (MmgHull.from_spec(table, density_kgpm3, place),)
    if model.abkowitz is not None:
        mass = abkowitz_added_mass(model.abkowitz, density_kgpm3)
        hull = AbkowitzTerms.from_spec(model.abkowitz, density_kgpm3, place, rudder=False)
        return place.T @ mass @ place, (hull,)
    return np.zeros((6, 6)), ()


def at_table(centre: Array) -> Array:
    """Return `moved_to` for the place of a table's forces: at the origin, at the height of lateral resistance."""
    return moved_to(np.array([0.0, 0.0, centre[2]]))


def moved_to(place_frd_m: Array) -> Array:
    """Return the (6, 6) H. H nu is the velocity at a place, and H^T tau moves a force and moment there to the origin.

    Fossen 2021, eq C.5: v + w x r.
    """
    x, y, z = place_frd_m
    move = np.eye(6)
    move[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return move


def centre_of_lateral_resistance(model: VesselSpec, draft_m: float) -> Array:
    """Return the (3,) place at which per-axis values act."""
    centre = model.centre_of_lateral_resistance_frd_m
    return np.array(centre or (model.midship_frd_x_m, 0.0, model.keel_m - 0.5 * draft_m))


def rigid_body_mass(model: VesselSpec) -> Array:
    """Return (6, 6) about the origin, from the inertia about the centre of gravity (Fossen 2021, eq 3.51)."""
    xy, xz, yz = model.inertia_products_kgm2
    at_gravity = np.diag([model.mass_kg] * 3 + list(model.inertia_kgm2))
    at_gravity[3:, 3:] -= [[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]]
    move = moved_to(np.array(model.centre_of_gravity_frd_m))
    mass: Array = move.T @ at_gravity @ move
    return mass


def added_mass_matrix(model: VesselSpec, named: list[tuple[Derivative, float]], centre: Array) -> Array:
    """Return (6, 6) about the origin, from the matrix or per axis, and by name."""
    of_axes = (derivative.acceleration for derivative, _ in named)
    return _about_origin(astuple(model.added_mass), model.added_mass_matrix, named, of_axes, centre)


def linear_damping(model: VesselSpec, named: list[tuple[Derivative, float]], centre: Array) -> Array:
    """Return the (6, 6) D about the origin, positive, from the matrix or per axis, and by name."""
    of_axes = (derivative.linear for derivative, _ in named)
    return _about_origin(astuple(model.damping_linear), model.damping_linear_matrix, named, of_axes, centre)


def _about_origin(
    per_axis: Sequence[float],
    matrix: Matrix | None,
    named: list[tuple[Derivative, float]],
    of_axes: Iterable[int | None],
    centre: Array,
) -> Array:
    """Return (6, 6): the per-axis values at the centre, or the matrix, less the derivatives of a single axis."""
    move = moved_to(centre)
    total: Array = move.T @ np.diag(per_axis) @ move if matrix is None else np.array(matrix)
    for (derivative, value), axis in zip(named, of_axes, strict=True):
        if axis is not None:
            total[derivative.component, axis] -= value
    return total


def has_stern_force(model: VesselSpec) -> bool:
    """Return the value of the key. For null, return False if matrices or derivatives are given, because they include
    it.
    """
    if model.stern_force is not None:
        return model.stern_force == "on"
    if model.table_key is not None:
        return False
    return model.added_mass_matrix is None and model.damping_linear_matrix is None and not model.derivatives


def moved_products(products: Array, place_frd_m: Array) -> Array:
    """Move to the origin a (36, 6) constant that acts on velocities at a place and gives force and moment there."""
    move = moved_to(place_frd_m)
    there = products.reshape(6, 6, 6)
    here: Array = np.einsum("abk,ai,bj,kc->ijc", there, move, move, move)
    return here.reshape(36, 6)


def _skew() -> Array:
    """Return (3, 3, 3) epsilon: (a x b)_i = epsilon_ijk a_j b_k."""
    epsilon = np.zeros((3, 3, 3))
    epsilon[(0, 1, 2), (1, 2, 0), (2, 0, 1)] = 1.0
    epsilon[(0, 2, 1), (2, 1, 0), (1, 0, 2)] = -1.0
    return epsilon


def coriolis_products(mass: Array) -> Array:
    """Return the (36, 6) constant with C(nu) nu = vec(nu nu^T) @ constant, for a symmetric (6, 6) mass matrix.

    C(nu) nu = [w x (M11 v + M12 w); v x (M11 v + M12 w) + w x (M21 v + M22 w)], Fossen 2021, theorem 3.2.
    """
    skew = _skew()
    constant = np.zeros((6, 6, 6))
    # Axes: left factor (angular velocity), right factor (velocity of the momentum), component of the result.
    constant[3:, :, :3] = np.einsum("ijk,kb->jbi", skew, mass[:3])
    constant[:3, :, 3:] = np.einsum("ijk,kb->jbi", skew, mass[:3])
    constant[3:, :, 3:] = np.einsum("ijk,kb->jbi", skew, mass[3:])
    return constant.reshape(36, 6)


def added_coriolis_products(rigid_mass: Array, added_mass: Array, table_contains: str) -> Array:
    """Return the (36, 6) of C(nu) nu less what a table of surge, sway and yaw contains already.

    table_contains: `damping`: nothing; `munk_moment`: the yaw moment of the added mass; `added_mass_coriolis`: its
    forces too; `coriolis`: those of the rigid body too. Only products of u, v and r are left out.
    """
    if table_contains == "damping":
        mass: Array = rigid_mass + added_mass
        return coriolis_products(0.5 * (mass + mass.T))
    rigid, added = (coriolis_products(0.5 * (mass + mass.T)).reshape(6, 6, 6) for mass in (rigid_mass, added_mass))
    horizontal = (0, 1, 5)
    added[np.ix_(horizontal, horizontal, (5,) if table_contains == "munk_moment" else horizontal)] = 0.0
    if table_contains == "coriolis":
        rigid[np.ix_(horizontal, horizontal, horizontal)] = 0.0
    return (rigid + added).reshape(36, 6)


def transport_products(mass: Array) -> Array:
    """Return the (36, 6) constant with M [w x v; 0] = vec(nu nu^T) @ constant."""
    constant = np.zeros((6, 6, 6))
    constant[3:, :3, :] = np.einsum("ijk,ci->jkc", _skew(), mass[:, :3])
    return constant.reshape(36, 6)


def stern_forces(added_mass: Array, length_m: float) -> tuple[Array, Array]:
    """Return the (36, 6) and (6, 6) constants of the force at the trailing end, on vec(nu nu^T) and |u| nu.

    Per length the added mass is a = A / L. Its momentum, a (v + x r) across and a (w - x q) down, is shed at x =
    -sign(u) L / 2 with speed |u|. The force is -|u| a (v + x r) and the moment x times that; likewise in heave.
    """
    half_m = 0.5 * length_m
    across, down = added_mass[1, 1] / length_m, added_mass[2, 2] / length_m
    products = np.zeros((6, 6, 6))
    products[0, 5, 1] = across * half_m
    products[0, 1, 5] = across * half_m
    products[0, 4, 2] = -down * half_m
    products[0, 2, 4] = -down * half_m
    lift = -np.diag([0.0, across, down, 0.0, down * half_m**2, across * half_m**2])
    return products.reshape(36, 6), lift
