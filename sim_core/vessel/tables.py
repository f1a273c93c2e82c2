"""Forces of hulls by published tables without dimensions: the MMG standard method, and Abkowitz's form.

MMG (Yasukawa and Yoshimura 2015, J. Mar. Sci. Technol. 20:37-52), about midship, U^2 = u^2 + v^2:

    X_H = rho/2 L d U^2 (-R'0 + X'vv v'^2 + ...)    Y_H = rho/2 L d U^2 (Y'v v' + Y'r r' + ...)
    N_H = rho/2 L^2 d U^2 (N'v v' + N'r r' + ...)    v' = v / U    r' = r L / U

Its propeller and rudder, with w_P0 and t_P of the vessel's propeller and f_alpha by the rudder's aspect ratio:

    beta = atan(-v / u)    beta_P = beta - x'_P r'    beta_R = beta - l'_R r'
    1 - w_P = (1 - w_P0) (1 + (1 - exp(-C1 |beta_P|)) (C2 - 1))    X_P = (1 - t_P) T(J), J = u (1 - w_P) / (n D)
    u_R = epsilon u (1 - w_P) sqrt(eta (1 + kappa (sqrt(1 + 8 K_T / (pi J^2)) - 1))^2 + 1 - eta)
    v_R = U gamma_R beta_R    F_N = rho/2 A_R f_alpha U_R^2 sin(delta - atan(v_R / u_R))
    X_R = -(1 - t_R) F_N sin(delta)    Y_R = -(1 + a_H) F_N cos(delta)    N_R = -(x_R + a_H x_H) F_N cos(delta)

The table contains the Munk moment, but not the other Coriolis terms of the added mass. Two rules extend it to slow and
astern motion, where it is not defined. Neither changes a motion of the method's range:

- U is at least L |r| / 3, so that r' stays below 3.
- Astern, the hull is the same with bow and stern exchanged. Between |beta| of 70 and 110 degrees, the signs change
  smoothly.

Abkowitz (1964), with the prime system of Chislett and Strom-Tejsen (1965): a polynomial in (u - U0) / U, v / U, r L / U
and the rudder angle, times rho/2 L^2 U^2 or L^3. Below a share of U0, u and U keep the value of that share, and the
terms of u alone, which are thrust less resistance, are changed so that the resistance falls with u |u|.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Self

import numpy as np
from numpy import intp
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.vessel.rudders import PLATE_NORMAL_FORCE, STALL_WIDTH_RAD
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.tables_spec import PLANAR, AbkowitzSpec, MmgSpec, TableTerm

LARGEST_RATE = 3.0
"""r' of the MMG table at most."""
BEAM_ON = 0.34
"""|u| / U below which the signs of ahead change into those of astern: the cosine of 70 degrees."""


@dataclass(frozen=True, slots=True, eq=False)
class Products:
    """Products of columns, one for each term."""

    factors: tuple[NDArray[intp], ...]
    """Column of each factor, (K,) for each of them; the last column is 1."""

    @classmethod
    def from_terms(cls, terms: Iterable[str], columns: str) -> Self:
        """Return the products. terms: the letters of their factors. columns: letters of the columns before the 1."""
        letters = [[columns.index(letter) for letter in term] for term in terms]
        most = max(map(len, letters), default=1) or 1
        padded = np.array([[*own, *[len(columns)] * (most - len(own))] for own in letters], dtype=intp)
        return cls(tuple(padded.reshape(-1, most).T))

    def of(self, columns: Array) -> Array:
        """Return (N, K) for (N, C) columns without the 1."""
        values = np.concatenate((columns, np.ones((len(columns), 1))), axis=1)
        first, *others = self.factors
        product: Array = values[:, first]
        for other in others:
            product = product * values[:, other]
        return product


@dataclass(frozen=True, slots=True, eq=False)
class MmgFlow:
    """Velocities without dimensions."""

    at_place: Array
    """(6, 6) for row vectors: velocity at the place where the forces act."""
    length_m: float

    def speeds(self, nu_r: Array) -> tuple[Array, Array, Array, Array]:
        """Return (N, 1) u, v, r L and the speed U of the divisors."""
        nu = nu_r.dot(self.at_place)
        u, v, turn = nu[:, :1], nu[:, 1:2], self.length_m * nu[:, 5:]
        speed = np.maximum(np.maximum(np.hypot(u, v), np.abs(turn) * (1.0 / LARGEST_RATE)), 1e-9)
        return u, v, turn, speed


@dataclass(frozen=True, slots=True, eq=False)
class MmgHull:
    """X_H, Y_H and N_H of the MMG standard method."""

    flow: MmgFlow
    products: Products
    wrench: Array  # (K, 6)

    @classmethod
    def from_spec(cls, spec: MmgSpec, density_kgpm3: float, at_place: Array) -> MmgHull:
        """Return the hull. at_place: (6, 6) of `moved_to` for the place of its forces."""
        values = {TableTerm("X", ""): -spec.r_0, **spec.terms}
        pressure = 0.5 * density_kgpm3 * spec.length_m * spec.draft_m
        wrench = np.zeros((len(values), 6))
        factors = []
        for row, (term, value) in enumerate(values.items()):
            wrench[row, PLANAR[term.component]] = value * pressure * (spec.length_m if term.component == "N" else 1.0)
            turned = (term.factors.count("r") + (term.component != "Y")) % 2  # changes its sign astern
            factors.append(term.factors + "s" * turned)
        return cls(MmgFlow(at_place.T, spec.length_m), Products.from_terms(factors, "vrs"), wrench @ at_place)

    def terms(self, nu_r: Array) -> tuple[Array]:
        """Return (N, K)."""
        u, v, turn, speed = self.flow.speeds(nu_r)
        astern = np.minimum(np.maximum(u / (BEAM_ON * speed), -1.0), 1.0)
        values = self.products.of(np.concatenate((v / speed, turn / speed, astern), axis=1))
        return (values * (speed * speed),)


@dataclass(frozen=True, slots=True, eq=False)
class MmgSteering:
    """Inflow of P propellers and forces of R rudders by the MMG standard method."""

    spec: MmgSpec
    flow: MmgFlow
    wake: Array  # (P,) 1 - w_P0
    propeller: NDArray[intp]  # (R,) before each rudder
    speed2_per_newton: Array  # (R,) 8 / (pi rho D^2) of that propeller
    pressure: Array  # (R,) half the density times the area
    slope: Array  # (R,) f_alpha
    sine_at_stall: Array  # (R,)
    per_sine: Array  # (R,) share of separated flow per sine beyond stall
    wrench: Array  # (2 R, 6) per newton of F_N sin(delta), then of F_N cos(delta)

    @classmethod
    def from_spec(cls, model: VesselSpec, spec: MmgSpec, density_kgpm3: float, at_place: Array) -> MmgSteering:
        """Compute the constants. at_place: (6, 6) of `moved_to` for the place of the hull's forces."""
        rudders = model.rudders
        before = np.array([rudder.propeller or 0 for rudder in rudders], dtype=intp)
        diameters_m = np.array([model.propellers[number].disc_diameter_m or np.nan for number in before])
        stall = np.radians([rudder.stall_deg for rudder in rudders])
        slope = np.array([rudder.normal_force_slope for rudder in rudders])
        along = [-(1.0 - spec.t_r) * _wrench(rudder.position_frd_m, 0) for rudder in rudders]
        added = spec.a_h * (_wrench((spec.x_h * spec.length_m, 0.0, 0.0), 1) @ at_place)
        across = [-_wrench(rudder.position_frd_m, 1) - added for rudder in rudders]
        return cls(
            spec=spec,
            flow=MmgFlow(at_place.T, spec.length_m),
            wake=np.array([1.0 - propeller.wake_fraction for propeller in model.propellers]),
            propeller=before,
            speed2_per_newton=8.0 / (np.pi * density_kgpm3 * diameters_m**2),
            pressure=0.5 * density_kgpm3 * np.array([rudder.area_m2 for rudder in rudders]),
            slope=slope,
            sine_at_stall=np.sin(stall),
            per_sine=1.0 / (np.sin(np.minimum(stall + STALL_WIDTH_RAD, 0.5 * np.pi)) - np.sin(stall)),
            wrench=np.array([*along, *across]),
        )

    def advance_mps(self, nu_r: Array) -> Array:
        """Return the (N, P) speeds of advance, less the wake of this motion."""
        spec, (u, v, turn, speed) = self.spec, self.flow.speeds(nu_r)
        inflow = np.arctan2(-v, np.abs(u)) - spec.x_p * turn / speed
        most = np.where(inflow > 0.0, spec.c_2_positive, spec.c_2_negative)
        change = 1.0 + (1.0 - np.exp(-spec.c_1 * np.abs(inflow))) * (most - 1.0)
        advance: Array = u * change * self.wake
        return advance

    def forces_n(self, nu_r: Array, advance_mps: Array, thrust_n: Array, angle_rad: Array) -> tuple[Array, Array]:
        """Return (N, R) F_N sin(delta) and F_N cos(delta), for (N, P) advance and thrust and (N, R) angles."""
        spec, (u, v, turn, speed) = self.spec, self.flow.speeds(nu_r)
        # Flow at the rudder, along and across the hull
        before = advance_mps[:, self.propeller]
        ahead = np.maximum(before, 0.0)
        race = np.sqrt(ahead * ahead + self.speed2_per_newton * np.maximum(thrust_n[:, self.propeller], 0.0))
        raced = before + spec.kappa * (race - ahead)
        square = spec.eta * raced * raced + (1.0 - spec.eta) * before * before
        along = spec.epsilon * np.where(raced < 0.0, -1.0, 1.0) * np.sqrt(square)
        inflow = speed * np.arctan2(-v, np.abs(u)) - spec.l_r * turn
        across = inflow * np.where(inflow > 0.0, spec.gamma_r_positive, spec.gamma_r_negative)
        # Normal force, stalled like `Rudders`
        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        flow = np.maximum(np.hypot(along, across), 1e-9)
        attack = (along * sine - across * cosine) / flow
        left = np.minimum(np.maximum((np.abs(attack) - self.sine_at_stall) * self.per_sine, 0.0), 1.0)
        coefficient = (1.0 - left) * self.slope * attack + left * PLATE_NORMAL_FORCE * np.sign(attack)
        normal_n = self.pressure * flow * flow * coefficient
        return normal_n * sine, normal_n * cosine


def _wrench(place_frd_m: tuple[float, float, float], axis: int) -> Array:
    """Return (6,): force and moment of a newton along an axis."""
    direction = np.eye(3)[axis]
    return np.concatenate([direction, np.cross(place_frd_m, direction)])


@dataclass(frozen=True, slots=True, eq=False)
class AbkowitzTerms:
    """The terms of an Abkowitz table with the rudder angle as a factor, or those without it."""

    at_place: Array
    """(6, 6) for row vectors: velocity at the place where the forces act."""
    length_m: float
    nominal_mps: float
    least_mps: float
    products: Products
    straight: Array  # (K,) 1 for the terms of surge that depend on u alone
    wrench: Array  # (K, 6)

    @classmethod
    def from_spec(cls, spec: AbkowitzSpec, density_kgpm3: float, at_place: Array, rudder: bool) -> AbkowitzTerms:
        """Return the terms. at_place: (6, 6) of `moved_to` for the place of the forces."""
        values = {term: value for term, value in spec.terms.items() if ("d" in term.factors) == rudder}
        pressure = 0.5 * density_kgpm3 * spec.length_m**2
        wrench = np.zeros((len(values), 6))
        for row, (term, value) in enumerate(values.items()):
            wrench[row, PLANAR[term.component]] = value * pressure * (spec.length_m if term.component == "N" else 1.0)
        return cls(
            at_place=at_place.T,
            length_m=spec.length_m,
            nominal_mps=spec.nominal_speed_mps,
            least_mps=spec.least_speed_share * spec.nominal_speed_mps,
            products=Products.from_terms((term.factors for term in values), "uvrd" if rudder else "uvr"),
            straight=np.array([float(term.component == "X" and not term.factors.strip("u")) for term in values]),
            wrench=wrench @ at_place,
        )

    def slow(self, ahead_mps: Array) -> tuple[Array, Array]:
        """Return the speed ahead at which the table is read, and the share of its resistance, for any speed ahead."""
        share = ahead_mps * np.abs(ahead_mps) / self.least_mps**2
        return np.maximum(ahead_mps, self.least_mps), np.minimum(share, 1.0)

    def terms(self, nu_r: Array, *angle_rad: Array) -> tuple[Array]:
        """Return (N, K). angle_rad: (N, 1) of the rudder in the sign of the table, for the terms with it."""
        nu = nu_r.dot(self.at_place)
        u, v, turn = nu[:, :1], nu[:, 1:2], self.length_m * nu[:, 5:]
        ahead, resistance = self.slow(u)
        speed = np.hypot(ahead, v)
        columns = np.concatenate(((ahead - self.nominal_mps) / speed, v / speed, turn / speed, *angle_rad), axis=1)
        share = 1.0 - self.straight + self.straight * resistance
        return (self.products.of(columns) * (speed * speed) * share,)


def mmg_added_mass(spec: MmgSpec, density_kgpm3: float) -> Array:
    """Return (6, 6) at the place of the table."""
    pressure = 0.5 * density_kgpm3 * spec.length_m**2 * spec.draft_m
    return np.diag([spec.m_x, spec.m_y, 0.0, 0.0, 0.0, spec.j_z * spec.length_m**2]) * pressure


def abkowitz_added_mass(spec: AbkowitzSpec, density_kgpm3: float) -> Array:
    """Return (6, 6) at the place of the table."""
    matrix = np.zeros((6, 6))
    for (component, velocity), value in spec.added_mass.items():
        lengths = 3 + (component == "N") + (velocity == "r")
        matrix[PLANAR[component], PLANAR[velocity]] = 0.5 * density_kgpm3 * spec.length_m**lengths * value
    return matrix
