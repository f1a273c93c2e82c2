"""Propellers in air and water, tunnel thrusters, steering gears and rudders.

A command in [-1, 1] sets a speed or an angle. The speed n of a propeller is a fraction of full speed. It follows its
command as a first-order lag with separate time constants for acceleration and deceleration, as in PX4's motor model.
Gears and rudders turn at their rate and stop at their limit. T_0 is the thrust at rest at full speed, ahead or astern.
V is the speed of advance: the velocity of the propeller along its axis, relative to air or water, less the wake.

    at rest        T = T_0 n |n|
    in air         T (V / 2 + sqrt(V^2 / 4 + T / (2 rho A))) = P(n), momentum theory at the power of rest
    in water       T = T_0 n |n| (1 - V / (V_0 n)), a linear K_T with no thrust at V_0, or
                   T = rho D^4 K_T(J) n |n| n_max^2 with J = V / (n n_max D), an open-water table
    in a tunnel    T = T_0 n |n| exp(-(u / u_0)^2), u the forward speed
    astern, also   Y = rho D^4 K_Y(J_s) n^2 n_max^2 to the side, J_s = u / (n n_max D), or a share of T_0 n^2

An angle delta of a gear turns the thrust to (cos delta, -sin delta). A positive rudder angle moves the trailing edge to
starboard. At the stern, a positive angle turns the bow to starboard. `make_propulsion` omits the parts that a vessel
does not have, and adds the actuators of packages.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy import intp
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.vessel.actuators import Actuator, ActuatorError
from sim_core.vessel.rudders import Rudders
from sim_core.vessel.spec import Propeller, VesselSpec
from sim_core.vessel.tables import AbkowitzTerms, MmgSteering
from sim_core.vessel.windage import AIR_DENSITY_KGPM3

Propellers = tuple[Propeller, ...]
FLOW = 9
"""Columns of `flow`: velocity relative to the water (3), angular velocity (3), velocity relative to the air (3)."""
_IN_WATER, _IN_AIR = (0, 1, 2, 3, 4, 5), (6, 7, 8, 3, 4, 5)


class ThrustLaw(Protocol):
    """Thrust of P propellers, linear in K terms.

    per_term: (K, P) newtons. per_mps: (P,) factor from the speed of advance to the law's dimensionless speed.
    """

    @property
    def per_term(self) -> Array: ...

    @property
    def per_mps(self) -> Array: ...

    def terms(self, speed: Array, advance: Array) -> tuple[Array, ...]:
        """Return K arrays (N, P), for (N, P) speeds n and dimensionless speeds of advance."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class StaticThrust:
    """The thrust at rest at any speed of advance: n |n|, and n^2, which distinguishes reverse from ahead."""

    per_term: Array
    per_mps: Array

    @classmethod
    def from_spec(cls, propellers: Propellers, water: Water) -> StaticThrust:
        """Compute the constants of the propellers."""
        return cls(_by_sign(*_thrust_at_rest_n(propellers, water)), np.zeros(len(propellers)))

    def terms(self, speed: Array, advance: Array) -> tuple[Array, Array]:
        """See ThrustLaw."""
        return speed * np.abs(speed), speed * speed


@dataclass(frozen=True, slots=True, eq=False)
class DiscThrust:
    """Actuator disc at the power of rest: t^3 + x t = 1 (Leishman 2006, section 2.4, solved for the thrust).

    t is the thrust relative to the thrust at rest. x is the speed of advance over v_0 |n|, with v_0 = sqrt(T_0 / (2 rho
    A)) the velocity induced at rest. Below x = -0.5, t is constant: in air from behind, the wake becomes a vortex ring
    and the theory ends. Rotors measured there (Leishman 2006, eq 2.89) give 0.92 to 1.07 of that t down to x = -1.5.

    Except for the factor n^2, the thrust at (n, V) depends only on the advance angle arctan2(V, n). A table over that
    angle holds all four quadrants.
    """

    per_term: Array
    per_mps: Array
    ratio: Array  # thrust relative to that at full speed ahead and n^2, at each of ADVANCE_ANGLES

    TAIL: ClassVar[float] = -0.5
    ADVANCE_ANGLES: ClassVar[Array] = np.linspace(-math.pi, math.pi, 1441)

    @classmethod
    def from_spec(cls, propellers: Propellers, water: Water) -> DiscThrust:
        """Compute the constants of the propellers, all with a diameter and equal `reverse_ratio`."""
        ahead_n, astern_n = _thrust_at_rest_n(propellers, water)
        diameters_m = np.array([propeller.diameter_m or math.nan for propeller in propellers])
        speed, advance = np.cos(cls.ADVANCE_ANGLES), np.sin(cls.ADVANCE_ANGLES)
        reverse = speed < 0.0
        share = np.where(reverse, astern_n[0] / ahead_n[0], 1.0)
        # Astern, the induced velocity goes with the root of the thrust there. A propeller without thrust has no disc.
        over_induced = advance / np.where(speed == 0.0, 1e-12, speed) / np.sqrt(np.maximum(share, 1e-12))
        return cls(
            per_term=ahead_n[None],
            per_mps=diameters_m * np.sqrt(0.5 * math.pi * AIR_DENSITY_KGPM3 / ahead_n),
            ratio=np.where(reverse, -share, share) * disc_thrust_ratio(np.maximum(over_induced, cls.TAIL)),
        )

    @staticmethod
    def reverse_ratio(propeller: Propeller) -> float:
        """Return the thrust astern over the thrust ahead, at rest: the parameter of the table."""
        return (propeller.max_reverse_thrust_n or 0.0) / (propeller.max_thrust_n or math.inf)

    def terms(self, speed: Array, advance: Array) -> tuple[Array]:
        """See ThrustLaw."""
        return (speed * speed * np.interp(np.arctan2(advance, speed), self.ADVANCE_ANGLES, self.ratio),)


def disc_thrust_ratio(advance: Array) -> Array:
    """Return the positive root t of t^3 + x t = 1 for x >= -1.8, by Cardano's formula; x: speed of advance over v_0."""
    third = advance / 3.0
    root = np.cbrt(0.5 + np.sqrt(0.25 + third**3))
    ratio: Array = np.where(third > 1e3, 1.0 / np.maximum(advance, 1.0), root - third / root)
    return ratio


@dataclass(frozen=True, slots=True, eq=False)
class LinearThrust:
    """K_T falls linearly with J to zero at a speed of advance V_0 at full speed. Beyond V_0 n, the propeller brakes.

    Against headway or sternway, K_T keeps its value at J = 0: see OpenWaterThrust.
    """

    per_term: Array
    per_mps: Array

    @classmethod
    def from_spec(cls, propellers: Propellers, water: Water) -> LinearThrust:
        """Compute the constants of the propellers, all with a speed of no thrust."""
        static = _by_sign(*_thrust_at_rest_n(propellers, water))
        per_mps = np.array([1.0 / (propeller.zero_thrust_speed_mps or math.nan) for propeller in propellers])
        return cls(np.concatenate([static, -static]), per_mps)

    def terms(self, speed: Array, advance: Array) -> tuple[Array, ...]:
        """See ThrustLaw."""
        magnitude = np.abs(speed)
        onward = np.maximum(np.sign(speed) * advance, 0.0)
        return speed * magnitude, speed * speed, speed * onward, magnitude * onward


@dataclass(frozen=True, slots=True, eq=False)
class TunnelThrust:
    """The jet of a tunnel thruster loses its effect on a hull that makes way: exp(-(u / u_0)^2)."""

    per_term: Array
    per_mps: Array

    @classmethod
    def from_spec(cls, propellers: Propellers, water: Water) -> TunnelThrust:
        """Compute the constants of the propellers, all in tunnels."""
        per_mps = np.array([1.0 / (propeller.tunnel_speed_mps or math.nan) for propeller in propellers])
        return cls(_by_sign(*_thrust_at_rest_n(propellers, water)), per_mps)

    def terms(self, speed: Array, advance: Array) -> tuple[Array, Array]:
        """See ThrustLaw."""
        left = speed * np.exp(-advance * advance)
        return left * np.abs(speed), left * speed


@dataclass(frozen=True, slots=True, eq=False)
class OpenWaterThrust:
    """K_T by a table over J, for one propeller.

    Beyond the end of the table, its last slope continues: the propeller brakes. Astern, the table is scaled by the
    reverse share. Below J = 0, K_T keeps its value at J = 0, because the table does not cover those quadrants: astern
    against headway as in a crash stop, or ahead against sternway. For a B4-70 screw of pitch ratio 1, measured in all
    four quadrants (Roddy, Hess & Faller 2006), this is within 20 % down to J = -0.6. Beyond, the screw brakes harder.

    A table astern, over the advance ratio without wake, replaces share and rule there.
    """

    per_term: Array
    per_mps: Array
    advance_ratio: Array
    thrust_coefficient: Array
    last_slope: float
    reverse_share: float
    astern: tuple[Array, Array] | None
    """Advance ratio in the wake, and K_T."""

    @classmethod
    def from_spec(cls, propellers: Propellers, water: Water) -> OpenWaterThrust:
        """Compute the constants of the one propeller."""
        (curve,) = (propeller.open_water for propeller in propellers)
        assert curve is not None
        ratios, coefficients = map(np.array, curve.curve)
        astern = None
        if curve.astern_advance_ratio is not None and curve.astern_thrust_coefficient is not None:
            wake = 1.0 - propellers[0].wake_fraction
            astern = wake * np.array(curve.astern_advance_ratio), np.array(curve.astern_thrust_coefficient)
        return cls(
            per_term=np.full((1, 1), water.density_kgpm3 * curve.diameter_m**4 * curve.max_speed_rps**2),
            per_mps=np.full(1, 1.0 / (curve.max_speed_rps * curve.diameter_m)),
            advance_ratio=ratios,
            thrust_coefficient=coefficients,
            last_slope=(coefficients[-1] - coefficients[-2]) / (ratios[-1] - ratios[-2]),
            reverse_share=curve.reverse_share,
            astern=astern,
        )

    def terms(self, speed: Array, advance: Array) -> tuple[Array]:
        """See ThrustLaw."""
        turning = np.where(np.abs(speed) < 1e-6, 1e-6, speed)
        ratio = advance / turning
        coefficient = np.interp(ratio, self.advance_ratio, self.thrust_coefficient)
        coefficient += self.last_slope * np.maximum(ratio - self.advance_ratio[-1], 0.0)
        if self.astern is None:
            coefficient = np.where(speed < 0.0, self.reverse_share, 1.0) * coefficient
        else:
            coefficient = np.where(speed < 0.0, np.interp(ratio, *self.astern), coefficient)
        return (coefficient * turning * np.abs(turning),)


@dataclass(frozen=True, slots=True, eq=False)
class MixedThrust:
    """Propellers under several laws. The single term is the thrust itself."""

    laws: tuple[tuple[ThrustLaw, NDArray[intp]], ...]  # each with its columns
    per_term: Array
    per_mps: Array

    def terms(self, speed: Array, advance: Array) -> tuple[Array]:
        """See ThrustLaw."""
        thrust_n = np.empty_like(speed)
        for law, columns in self.laws:
            thrust_n[:, columns] = _thrust_n(law, speed[:, columns], advance[:, columns])
        return (thrust_n,)


_Law = type[StaticThrust] | type[DiscThrust] | type[LinearThrust] | type[TunnelThrust] | type[OpenWaterThrust]


def make_thrust_law(propellers: Propellers, water: Water) -> ThrustLaw:
    """Return one law if it is the same for all propellers, otherwise a mixture."""
    groups: dict[tuple[_Law, float], list[int]] = {}
    for index, propeller in enumerate(propellers):
        kind, of_a_kind = _law(propeller), 0.0
        if kind is OpenWaterThrust:
            of_a_kind = index
        elif kind is DiscThrust:
            of_a_kind = DiscThrust.reverse_ratio(propeller)
        groups.setdefault((kind, of_a_kind), []).append(index)
    laws = [
        (kind.from_spec(tuple(propellers[i] for i in own), water), np.array(own)) for (kind, _), own in groups.items()
    ]
    if len(laws) == 1:
        return laws[0][0]
    per_mps = np.zeros(len(propellers))
    for law, own in laws:
        per_mps[own] = law.per_mps
    return MixedThrust(tuple(laws), np.ones((1, len(propellers))), per_mps)


def _law(propeller: Propeller) -> _Law:
    if propeller.open_water is not None:
        return OpenWaterThrust
    if propeller.tunnel_speed_mps is not None:
        return TunnelThrust
    if propeller.zero_thrust_speed_mps is not None:
        return LinearThrust
    return DiscThrust if propeller.medium == "air" and propeller.diameter_m is not None else StaticThrust


def _thrust_n(law: ThrustLaw, speed: Array, advance: Array) -> Array:
    """Return the (N, P) sum of all terms."""
    first, *others = law.terms(speed, advance)
    thrust: Array = first * law.per_term[0]
    for term, newtons in zip(others, law.per_term[1:], strict=True):
        thrust += term * newtons
    return thrust


def _thrust_at_rest_n(propellers: Propellers, water: Water) -> Array:
    """Return (2, P): ahead and astern, positive."""
    return np.array([propeller.static_thrust_n(water.density_kgpm3) for propeller in propellers]).T


def _by_sign(ahead: Array, astern: Array) -> Array:
    """Return (2, P) coefficients of n |n| and n^2 that give `ahead` at n = 1 and minus `astern` at n = -1."""
    return np.array([0.5 * (ahead + astern), 0.5 * (ahead - astern)])


@dataclass(frozen=True, slots=True, eq=False)
class Shafts:
    """Lag of P propellers. A gain is the share of the speed error that one step removes."""

    gain_down: Array  # (1, P)
    gain_extra: Array  # (1, P) added during acceleration
    full: Array  # (1, P) ones
    full_astern: Array

    @classmethod
    def from_spec(cls, propellers: Propellers, dt_s: float) -> Shafts:
        """Compute the constants for steps of dt_s."""
        up = 1.0 - np.exp([[-dt_s / propeller.spin_up_s for propeller in propellers]])
        down = 1.0 - np.exp([[-dt_s / propeller.spin_down_s for propeller in propellers]])
        return cls(down, up - down, np.ones_like(up), -np.ones_like(up))

    def spin(self, speed: Array, command: Array) -> Array:
        """Return the (N, P) speeds one step later, for (N, P) commands, clamped to [-1, 1]. Exact for held commands."""
        wanted = np.minimum(np.maximum(command, self.full_astern), self.full)
        faster = np.abs(wanted) > np.abs(speed)
        gain = self.gain_down + faster * self.gain_extra
        spun: Array = speed + (wanted - speed) * gain
        return spun


def _along(direction: Array, place_frd_m: tuple[float, float, float]) -> Array:
    """Return (6,): force and moment of a newton. Its product with (v, w) is the speed along the direction."""
    return np.concatenate([direction, np.cross(place_frd_m, direction)])


def _direction(angle_deg: float) -> Array:
    """Return (3,) horizontal, clockwise from ahead, without the rounding of 6e-17 of a cosine at right angles."""
    angle = math.radians(angle_deg)
    return np.array([math.cos(angle), math.sin(angle), 0.0]).round(15)


def _thrust_wrench(propellers: Propellers, turned_deg: float = 0.0) -> Array:
    """Return the (P, 6) force and moment on the vessel per newton of each propeller, less the thrust deduction."""
    return np.array(
        [
            (1.0 - p.thrust_deduction) * _along(_direction(p.angle_deg + turned_deg), p.position_frd_m)
            for p in propellers
        ]
    )


def _inflow(propellers: Propellers, per_mps: Array, turned_deg: float = 0.0) -> Array:
    """Return (FLOW, P): from `flow` to the law's dimensionless speed of advance."""
    matrix = np.zeros((FLOW, len(propellers)))
    for column, propeller in enumerate(propellers):
        tunnel = propeller.tunnel_speed_mps is not None  # the law of a tunnel needs the flow along the hull
        direction = _direction(0.0 if tunnel else propeller.angle_deg + turned_deg)
        rows = _IN_AIR if propeller.medium == "air" else _IN_WATER
        matrix[rows, column] = (1.0 - propeller.wake_fraction) * _along(direction, propeller.position_frd_m)
    return matrix * per_mps


@dataclass(frozen=True, slots=True, eq=False)
class Propulsion:
    """Constants of P fixed propellers."""

    shafts: Shafts
    law: ThrustLaw
    inflow: Array | None  # (FLOW, P); None if the thrust does not depend on it
    wrench: Array  # (K P, 6) force and moment per term

    @classmethod
    def from_spec(cls, model: VesselSpec, water: Water, dt_s: float) -> Propulsion:
        """Compute the constants from the vessel's propellers for steps of dt_s."""
        propellers = model.propellers
        law = make_thrust_law(propellers, water)
        return cls(
            shafts=Shafts.from_spec(propellers, dt_s),
            law=law,
            inflow=_inflow(propellers, law.per_mps) if law.per_mps.any() else None,
            wrench=(law.per_term[:, :, None] * _thrust_wrench(propellers)).reshape(-1, 6),
        )

    def spin(self, actuators: Array, command: Array) -> Array:
        """Return the (N, P) speeds one step later."""
        return self.shafts.spin(actuators, command)

    def terms(
        self, actuators: Array, nu_r: Array, air_frd_mps: Array, thrust_share: Array | None = None
    ) -> tuple[Array, ...]:
        """Return the linear terms of the force, for (N, P) speeds.

        nu_r: (N, 6) velocities of the body's origin relative to the water. air_frd_mps: (N, 3) relative to the air.
        thrust_share: (N, P) share of each thrust that a fault leaves.
        """
        advance = nu_r
        if self.inflow is not None:
            advance = np.concatenate((nu_r, air_frd_mps), axis=1) @ self.inflow
        terms = self.law.terms(actuators, advance)
        return terms if thrust_share is None else tuple(term * thrust_share for term in terms)


@dataclass(frozen=True, slots=True, eq=False)
class SteeredPropulsion:
    """Constants of P propellers, S gears and R rudders. The state is P speeds, then S + R shares of full angle."""

    shafts: Shafts
    law: ThrustLaw
    inflow: Array  # (FLOW, P) at angle zero
    inflow_to_port: Array  # (FLOW, P) after a quarter turn to port
    geared: NDArray[intp]  # (S,) indices of the propellers
    full_angle_rad: Array  # (1, S + R)
    most_per_step: Array  # (1, S + R) largest change per step, as a share of the full angle
    rudders: Rudders | None
    wrench: Array  # (2 P + 2 R, 6) per newton: at angle zero, then turned to port, then of the rudders ahead and right

    @classmethod
    def from_spec(cls, model: VesselSpec, water: Water, dt_s: float) -> SteeredPropulsion:
        """Compute the constants from the vessel's propellers and rudders for steps of dt_s."""
        propellers = model.propellers
        law = make_thrust_law(propellers, water)
        gears = [(index, gear) for index, one in enumerate(propellers) if (gear := one.steering) is not None]
        turning = [(gear.max_angle_deg, gear.rate_degps) for _, gear in gears]
        turning += [(rudder.max_angle_deg, rudder.rate_degps) for rudder in model.rudders]
        angle_deg, rate_degps = np.array(turning).T
        rudders = Rudders.from_spec(model, water) if model.rudders else None
        wrench = [_thrust_wrench(propellers), _thrust_wrench(propellers, -90.0)]
        return cls(
            shafts=Shafts.from_spec(propellers, dt_s),
            law=law,
            inflow=_inflow(propellers, law.per_mps),
            inflow_to_port=_inflow(propellers, law.per_mps, -90.0),
            geared=np.array([index for index, _ in gears], dtype=intp),
            full_angle_rad=np.radians(angle_deg)[None],
            most_per_step=(rate_degps * dt_s / angle_deg)[None],
            rudders=rudders,
            wrench=np.concatenate(wrench if rudders is None else [*wrench, rudders.wrench]),
        )

    def spin(self, actuators: Array, command: Array) -> Array:
        """Return (N, P + S + R) one step later, for as many commands, clamped to [-1, 1]."""
        propellers = self.law.per_mps.size
        speed = self.shafts.spin(actuators[:, :propellers], command[:, :propellers])
        share, wanted = actuators[:, propellers:], np.minimum(np.maximum(command[:, propellers:], -1.0), 1.0)
        turn = np.minimum(np.maximum(wanted - share, -self.most_per_step), self.most_per_step)
        return np.concatenate((speed, share + turn), axis=1)

    def terms(
        self, actuators: Array, nu_r: Array, air_frd_mps: Array, thrust_share: Array | None = None
    ) -> tuple[Array, ...]:
        """Return newtons along the rows of `wrench`: (N, P), (N, P), and for rudders (N, R), (N, R).

        thrust_share: (N, P) share of each thrust, and so of each propeller race, that a fault leaves.
        """
        flow = np.concatenate((nu_r, air_frd_mps), axis=1)
        propellers, gears = self.law.per_mps.size, self.geared.size
        speed, angle = actuators[:, :propellers], actuators[:, propellers:] * self.full_angle_rad
        turned = np.zeros_like(speed)
        turned[:, self.geared] = angle[:, :gears]
        cosine, sine = np.cos(turned), np.sin(turned)
        advance = cosine * (flow @ self.inflow) + sine * (flow @ self.inflow_to_port)
        thrust_n = _thrust_n(self.law, speed, advance)
        if thrust_share is not None:
            thrust_n *= thrust_share
        forces_n = (thrust_n * cosine, thrust_n * sine)
        if self.rudders is None:
            return forces_n
        return *forces_n, *self.rudders.forces_n(angle[:, gears:], thrust_n, flow)


@dataclass(frozen=True, slots=True, eq=False)
class MmgPropulsion:
    """Propellers and rudders by the MMG standard method: see `tables.py`. The state is that of `SteeredPropulsion`."""

    actuators: SteeredPropulsion
    steering: MmgSteering
    wrench: Array  # (P + 2 R, 6) per newton of thrust, of F_N sin(delta) and of F_N cos(delta)
    table_astern: NDArray[np.bool] | None  # (P,) whether the thrust astern is that of a table over the hull's speed

    @classmethod
    def from_spec(cls, model: VesselSpec, water: Water, dt_s: float, at_table: Array) -> MmgPropulsion:
        """Compute the constants. at_table: (6, 6) of `moved_to` for the place of the hull's forces."""
        assert model.mmg is not None
        steering = MmgSteering.from_spec(model, model.mmg, water.density_kgpm3, at_table)
        wrench = np.concatenate([_thrust_wrench(model.propellers), steering.wrench])
        curves = [propeller.open_water for propeller in model.propellers]
        of_table = np.array([curve is not None and curve.astern_advance_ratio is not None for curve in curves])
        steered = SteeredPropulsion.from_spec(model, water, dt_s)
        return cls(steered, steering, wrench, of_table if of_table.any() else None)

    def spin(self, actuators: Array, command: Array) -> Array:
        """Return (N, P + R) one step later."""
        return self.actuators.spin(actuators, command)

    def terms(
        self, actuators: Array, nu_r: Array, air_frd_mps: Array, thrust_share: Array | None = None
    ) -> tuple[Array, ...]:
        """Return newtons along the rows of `wrench`: (N, P), (N, R), (N, R)."""
        law = self.actuators.law
        propellers = law.per_mps.size
        angle = actuators[:, propellers:] * self.actuators.full_angle_rad
        speed, advance = actuators[:, :propellers], self.steering.advance_mps(nu_r)
        inflow = advance
        if self.table_astern is not None:
            straight = self.steering.flow.speeds(nu_r)[0] * self.steering.wake
            inflow = np.where(np.logical_and(speed < 0.0, self.table_astern), straight, advance)
        thrust_n = _thrust_n(law, speed, inflow * law.per_mps)
        if thrust_share is not None:
            thrust_n *= thrust_share
        return thrust_n, *self.steering.forces_n(nu_r, advance, thrust_n, angle)


@dataclass(frozen=True, slots=True, eq=False)
class AbkowitzPropulsion:
    """Propellers and a rudder of an Abkowitz table, which contains the thrust at its own throttle.

    Other throttles add the difference of thrust. The state is that of `SteeredPropulsion`.
    """

    actuators: SteeredPropulsion
    nominal_throttle: float
    rudder_sign: float
    rudder: AbkowitzTerms
    wrench: Array  # (P + K, 6) per newton of thrust, then the terms of the rudder

    @classmethod
    def from_spec(cls, model: VesselSpec, water: Water, dt_s: float, at_table: Array) -> AbkowitzPropulsion:
        """Compute the constants. at_table: (6, 6) of `moved_to` for the place of the table's forces."""
        spec = model.abkowitz
        assert spec is not None
        rudder = AbkowitzTerms.from_spec(spec, water.density_kgpm3, at_table, rudder=True)
        wrench = np.concatenate([_thrust_wrench(model.propellers), rudder.wrench])
        steered = SteeredPropulsion.from_spec(model, water, dt_s)
        return cls(steered, spec.nominal_throttle, spec.rudder_sign, rudder, wrench)

    def spin(self, actuators: Array, command: Array) -> Array:
        """Return (N, P + 1) one step later."""
        return self.actuators.spin(actuators, command)

    def terms(
        self, actuators: Array, nu_r: Array, air_frd_mps: Array, thrust_share: Array | None = None
    ) -> tuple[Array, ...]:
        """Return newtons of added thrust (N, P), and the terms of the rudder (N, K)."""
        law = self.actuators.law
        speed = actuators[:, : law.per_mps.size]
        advance = np.concatenate((nu_r, air_frd_mps), axis=1) @ self.actuators.inflow
        thrust_n = _thrust_n(law, speed, advance)
        if thrust_share is not None:
            thrust_n *= thrust_share
        ahead, resistance = self.rudder.slow(nu_r[:, :1])
        inside = advance + (ahead - nu_r[:, :1]) * self.actuators.inflow[0]
        added_n = thrust_n - resistance * _thrust_n(law, np.zeros_like(speed) + self.nominal_throttle, inside)
        angle = self.rudder_sign * actuators[:, law.per_mps.size :] * self.actuators.full_angle_rad
        return added_n, *self.rudder.terms(nu_r, angle)


_WithoutSideForce = Propulsion | SteeredPropulsion | MmgPropulsion | AbkowitzPropulsion


@dataclass(frozen=True, slots=True, eq=False)
class WithSideForce:
    """Propellers and rudders, and the side force of S propellers that turn astern: Y = K_Y(J_s) rho n^2 D^4.

    J_s = u / (n D), with the hull's speed u at the propeller, without wake.
    """

    own: _WithoutSideForce
    of_propeller: NDArray[intp]  # (S,)
    inflow: Array  # (FLOW, S) to u / (D n_max)
    newtons: Array  # (S,) per n^2 and per K_Y
    tables: tuple[tuple[Array, Array], ...]  # J_s and K_Y of each
    wrench: Array  # of `own`, then (S, 6) per newton to starboard

    @classmethod
    def from_spec(cls, own: _WithoutSideForce, model: VesselSpec, water: Water) -> Self:
        """Compute the constants from the propellers with a side force."""
        sides = [(number, one, side) for number, one in enumerate(model.propellers) if (side := one.side_force_astern)]
        density, newtons, per_mps, tables, wrench = water.density_kgpm3, [], [], [], []
        for _, one, side in sides:
            curve = one.open_water
            if side.share is not None or curve is None:
                newtons.append((side.share or 0.0) * one.static_thrust_n(density)[1])
                per_mps.append(0.0)
                tables.append((np.array([0.0, 1.0]), np.ones(2)))
            else:
                newtons.append(density * curve.diameter_m**4 * curve.max_speed_rps**2)
                per_mps.append(1.0 / (curve.max_speed_rps * curve.diameter_m))
                tables.append((np.array(side.advance_ratio), np.array(side.coefficient)))
            x_m, y_m, z_m = one.position_frd_m
            place = (x_m if side.position_x_m is None else side.position_x_m, y_m, z_m)
            wrench.append(_along(_direction(one.angle_deg + 90.0), place))
        without_wake = tuple(replace(one, wake_fraction=0.0) for _, one, _ in sides)
        return cls(
            own=own,
            of_propeller=np.array([number for number, _, _ in sides], dtype=intp),
            inflow=_inflow(without_wake, np.array(per_mps)),
            newtons=np.array(newtons),
            tables=tuple(tables),
            wrench=np.concatenate((own.wrench, np.array(wrench))),
        )

    def spin(self, actuators: Array, command: Array) -> Array:
        """See `own`."""
        return self.own.spin(actuators, command)

    def terms(
        self, actuators: Array, nu_r: Array, air_frd_mps: Array, thrust_share: Array | None = None
    ) -> tuple[Array, ...]:
        """Return the terms of `own`, then (N, S) newtons to starboard."""
        astern = np.minimum(actuators[:, self.of_propeller], 0.0)
        ratio = np.concatenate((nu_r, air_frd_mps), axis=1) @ self.inflow / np.minimum(astern, -1e-6)
        coefficients = [np.interp(ratio[:, column], *table) for column, table in enumerate(self.tables)]
        side_n = np.stack(coefficients, axis=1) * astern * astern * self.newtons
        if thrust_share is not None:
            side_n = side_n * thrust_share[:, self.of_propeller]
        return *self.own.terms(actuators, nu_r, air_frd_mps, thrust_share), side_n


OwnPropulsion = _WithoutSideForce | WithSideForce


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedPropulsion:
    """Propellers and rudders together with actuators of packages. The state of the actuators follows that of `own`."""

    own: OwnPropulsion
    added: tuple[tuple[str, str, Actuator, slice], ...]
    """Name, kind, actuator, and columns of state and commands."""
    own_commands: int
    wrench: Array
    """Of `own`, then (6, 6) unit force and moment for each added actuator."""

    @classmethod
    def from_spec(cls, own: OwnPropulsion, model: VesselSpec, water: Water, dt_s: float) -> Self:
        """Make the actuators of the vessel. Raises ActuatorError."""
        added, first = [], model.own_commands
        for name, spec in model.actuators.items():
            kind, last = spec.kind or name, first + len(spec.commands)
            try:
                actuator = spec.make(model, water, dt_s)
            except Exception as error:
                raise _failure(name, kind, error) from error
            added.append((name, kind, actuator, slice(first, last)))
            first = last
        units = [np.eye(6)] * len(added)
        return cls(own, tuple(added), model.own_commands, np.concatenate((own.wrench, *units)))

    def spin(self, actuators: Array, command: Array) -> Array:
        """Return the (N, C) states one step later. Raises ActuatorError."""
        columns = [self.own.spin(actuators[:, : self.own_commands], command[:, : self.own_commands])]
        for name, kind, actuator, own in self.added:
            state = actuators[:, own]
            try:
                spun = np.asarray(actuator.spin(state, np.clip(command[:, own], -1.0, 1.0)), dtype=np.float64)
            except Exception as error:
                raise _failure(name, kind, error) from error
            if spun.shape != state.shape:
                raise ActuatorError(name, kind, f"its spin returned {spun.shape} and must return {state.shape}")
            columns.append(spun)
        return np.concatenate(columns, axis=1)

    def terms(
        self, actuators: Array, nu_r: Array, air_frd_mps: Array, thrust_share: Array | None = None
    ) -> tuple[Array, ...]:
        """Return the terms of `own`, then (N, 6) force and moment of each actuator. Raises ActuatorError."""
        terms = [*self.own.terms(actuators[:, : self.own_commands], nu_r, air_frd_mps, thrust_share)]
        for name, kind, actuator, own in self.added:
            try:
                force = np.asarray(actuator.wrench_frd(actuators[:, own], nu_r, air_frd_mps), dtype=np.float64)
            except Exception as error:
                raise _failure(name, kind, error) from error
            if force.shape != nu_r.shape or not np.isfinite(force).all():
                problem = f"its wrench_frd returned {force.shape} and must return {nu_r.shape}, all finite"
                raise ActuatorError(name, kind, problem)
            terms.append(force)
        return tuple(terms)


def _failure(name: str, kind: str, error: Exception) -> ActuatorError:
    reason = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = "" if trace is None else f", {trace.tb_frame.f_code.co_filename.rpartition('/')[2]}:{trace.tb_lineno}"
    return ActuatorError(name, kind, f"it failed ({reason}{where})")


def make_propulsion(
    model: VesselSpec, water: Water, dt_s: float, at_table: Array | None = None
) -> OwnPropulsion | ExtendedPropulsion:
    """Return the propulsion model that fits the vessel's propellers, rudders, table and added actuators.

    at_table: (6, 6) of `moved_to` for the place of the table's forces, None for the origin.
    """
    own: OwnPropulsion
    place = np.eye(6) if at_table is None else at_table
    if model.mmg is not None:
        own = MmgPropulsion.from_spec(model, water, dt_s, place)
    elif model.abkowitz is not None:
        own = AbkowitzPropulsion.from_spec(model, water, dt_s, place)
    else:
        kind = Propulsion if model.own_commands == len(model.propellers) else SteeredPropulsion
        own = kind.from_spec(model, water, dt_s)
    if any(propeller.side_force_astern for propeller in model.propellers):
        own = WithSideForce.from_spec(own, model, water)
    return ExtendedPropulsion.from_spec(own, model, water, dt_s) if model.actuators else own
