"""Forces on a vessel in moving water and air: inertia, added mass, Coriolis terms, damping and windage.

Fossen's vectorial form (Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, ch. 6), with the
centre of gravity as origin and nu_r the velocity relative to the water, solved for the inertial acceleration. With
M = M_RB + M_A, v_r and w the linear and angular parts of nu_r, and a_f the acceleration of the water:

    M x = tau - D(nu_r) nu_r - C(nu_r) nu_r + M [w x v_r; 0] + M_A [a_f; 0]

where x holds the acceleration against NED, expressed in the body, and the angular acceleration. In a steady uniform
current this is his M nu_r' + C(nu_r) nu_r + D(nu_r) nu_r = tau (eq 6.119), since nu_r' = x - [w x v_r; 0].

The Munk moments within C_A belong to a flow that closes behind the stern. Blunt ends shed it, which leaves a side
force and a moment there (slender-body theory with a trailing edge, Newman, Marine Hydrodynamics, 1977, ch. 7). Without
them, and they are in no damping table, hulls like these would leave their course and bury their bows above 2 m/s.

Windage (Fossen 2021, eq 10.16-10.18), with the velocity (u, v) of the vessel relative to the air and speed V:

    X = -1/2 rho c_x A_front u V,   Y = -1/2 rho c_y A_lateral v V,   N = -rho c_n A_lateral L u v

that is C_X = -c_x cos(gamma), C_Y = c_y sin(gamma), C_N = c_n sin(2 gamma) without an angle being computed.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np

from sim_core.frames import Array
from sim_core.vessel.spec import VesselSpec


@dataclass(frozen=True, slots=True, eq=False)
class Hydrodynamics:
    """Constants of one vessel: its (6, 6) mass matrices and what each of the `terms` contributes to the force."""

    rigid_mass: Array
    added_mass: Array
    inverse_mass: Array
    wrench: Array  # (54, 6)
    water_wrench: Array  # (3, 6) force of the water's acceleration in body axes: M_A [a_f; 0]

    @classmethod
    def from_spec(cls, model: VesselSpec) -> Hydrodynamics:
        """Matrices from the vessel's data."""
        rigid_mass = np.diag([model.mass_kg] * 3 + list(model.inertia_kgm2))
        added_mass = np.diag(astuple(model.added_mass))
        mass = rigid_mass + added_mass
        stern_products, stern_lift = stern_forces(added_mass, model.length_m)
        products = transport_products(mass) - coriolis_products(mass) + stern_products
        linear = np.diag(astuple(model.damping_linear))
        quadratic = np.diag(astuple(model.damping_quadratic))
        return cls(
            rigid_mass=rigid_mass,
            added_mass=added_mass,
            inverse_mass=np.linalg.inv(mass),
            wrench=np.concatenate([products, -linear, -quadratic, stern_lift]),
            water_wrench=added_mass[:3],
        )

    def terms(self, nu_r: Array) -> tuple[Array, Array, Array, Array]:
        """(N, 36), (N, 6), (N, 6), (N, 6): what the forces are linear in, for (N, 6) relative velocities."""
        products = (nu_r[:, :, None] * nu_r[:, None, :]).reshape(-1, 36)
        magnitude = np.abs(nu_r)
        return products, nu_r, nu_r * magnitude, nu_r * magnitude[:, :1]


def _skew() -> Array:
    """(3, 3, 3) epsilon: (a x b)_i = epsilon_ijk a_j b_k."""
    epsilon = np.zeros((3, 3, 3))
    epsilon[(0, 1, 2), (1, 2, 0), (2, 0, 1)] = 1.0
    epsilon[(0, 2, 1), (2, 1, 0), (1, 0, 2)] = -1.0
    return epsilon


def coriolis_products(mass: Array) -> Array:
    """(36, 6) constant with C(nu) nu = vec(nu nu^T) @ constant, for a symmetric (6, 6) mass matrix.

    C(nu) nu = [w x (M11 v + M12 w); v x (M11 v + M12 w) + w x (M21 v + M22 w)], Fossen 2021, theorem 3.2.
    """
    skew = _skew()
    constant = np.zeros((6, 6, 6))
    # Axes: left factor (velocity that turns), right factor (velocity of the momentum), component of the result.
    constant[3:, :, :3] = np.einsum("ijk,kb->jbi", skew, mass[:3])
    constant[:3, :, 3:] = np.einsum("ijk,kb->jbi", skew, mass[:3])
    constant[3:, :, 3:] = np.einsum("ijk,kb->jbi", skew, mass[3:])
    return constant.reshape(36, 6)


def transport_products(mass: Array) -> Array:
    """(36, 6) constant with M [w x v; 0] = vec(nu nu^T) @ constant."""
    constant = np.zeros((6, 6, 6))
    constant[3:, :3, :] = np.einsum("ijk,ci->jkc", _skew(), mass[:, :3])
    return constant.reshape(36, 6)


def stern_forces(added_mass: Array, length_m: float) -> tuple[Array, Array]:
    """(36, 6) and (6, 6) constants of the force at the end that trails, on vec(nu nu^T) and |u| nu.

    Per length the added mass is a = A / L. Its momentum, a (v + x r) across and a (w - x q) down, is shed at
    x = -sign(u) L / 2 with speed |u|: force -|u| a (v + x r) and the moment x times that; likewise in heave.
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


AIR_DENSITY_KGPM3 = 1.2  # 20 degC at sea level


@dataclass(frozen=True, slots=True, eq=False)
class WindDrag:
    """Constants of one vessel."""

    wrench: Array  # (3, 6)

    @classmethod
    def from_spec(cls, model: VesselSpec) -> WindDrag:
        """Constants from the vessel's windage."""
        wind = model.wind
        wrench = np.zeros((3, 6))
        wrench[0, 0] = -0.5 * AIR_DENSITY_KGPM3 * wind.surge_coefficient * wind.frontal_area_m2
        wrench[1, 1] = -0.5 * AIR_DENSITY_KGPM3 * wind.sway_coefficient * wind.lateral_area_m2
        wrench[2, 5] = -AIR_DENSITY_KGPM3 * wind.yaw_coefficient * wind.lateral_area_m2 * wind.length_m
        return cls(wrench)

    def terms(self, relative_frd_mps: Array) -> tuple[Array, Array]:
        """(N, 2), (N, 1): u V and v V, and u v, for (N, 3) velocities of the vessel relative to the air."""
        along = relative_frd_mps[:, :2]
        speed = np.sqrt(np.vecdot(along, along))
        return along * speed[:, None], along[:, :1] * along[:, 1:]
