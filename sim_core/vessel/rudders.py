"""Rudders behind a propeller or off its axis, ahead and astern.

(u, v) is the flow at the rudder: the velocity of the rudder itself less the wake. In the race of its propeller, the
flow is (u + w, v). delta is the angle. n = u sin delta + v cos delta is the speed across the plate, c the speed along
it and U the total speed. The angle of attack has the sine s = n / U and the cosine k = c / U:

    C_N = 6.13 Lambda / (Lambda + 2.25) s      normal force, Fujii & Tsuda 1961 (MMG standard method, Yasukawa 2015)
    C_L = C_N k                                across the flow
    C_D = C_L^2 / (0.9 pi Lambda)              along it: induced drag, Whicker & Fehlner 1958

Within ten degrees above the stalling angle, the flow separates from the plate. Then C_N = 1.2 s / |s| (Hoerner 1965,
ch. 3, plates of such aspect ratios), with C_D = C_N s, because the leading edge has no suction any more.

The race is that of an actuator disc. Far behind the disc, the water is faster by w = sqrt(V^2 + 2 |T| / (rho A)) - V.
At a distance x behind, it is faster by half of w times 1 + x / sqrt(x^2 + R^2). In front, a propeller going astern
draws the water in; the factor is 1 - x / sqrt(x^2 + R^2) (vortex cylinder; McCormick 1995, section 6). V is the speed
of advance in the direction of the thrust. An opposite speed of advance counts as zero.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import intp
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.frames import Array
from sim_core.vessel.spec import VesselSpec

PLATE_NORMAL_FORCE = 1.2
STALL_WIDTH_RAD = math.radians(10.0)
INDUCED_DRAG_EFFICIENCY = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Rudders:
    """Constants of R rudders."""

    inflow: Array  # (9, 2 R) ahead and to the right at each rudder, in the hull's wake, from `flow` of the propulsion
    pressure: Array  # (R,) half the density times the area
    slope: Array  # (R,) of C_N
    induced: Array  # (R,) C_D per C_L^2
    sine_at_stall: Array  # (R,)
    per_sine: Array  # (R,) share of separated flow per sine beyond stall
    wrench: Array  # (2 R, 6)
    raced: NDArray[intp]  # (Q,) indices of the rudders in a race
    propeller: NDArray[intp]  # (Q,) the propeller of that race
    shares: Array  # (2, R) of the area, outside the race and in it
    race_inflow: Array  # (9, Q) speed of advance of that propeller
    speed2_per_newton: Array  # (Q,) 2 / (rho A)
    reached_behind: Array  # (Q,) share of w that the race has at the rudder
    reached_before: Array  # (Q,) share of w that a propeller going astern draws past it

    @classmethod
    def from_spec(cls, model: VesselSpec, water: Water) -> Rudders:
        """Compute the constants from the vessel's rudders and the propellers in front of them."""
        rudders = model.rudders
        raced = [(index, rudder) for index, rudder in enumerate(rudders) if rudder.propeller is not None]
        propellers = [model.propellers[rudder.propeller or 0] for _, rudder in raced]
        radii_m = np.array([0.5 * (propeller.disc_diameter_m or math.nan) for propeller in propellers])
        behind_m = np.array(
            [p.position_frd_m[0] - r.position_frd_m[0] for p, (_, r) in zip(propellers, raced, strict=True)]
        )
        along = behind_m / np.hypot(behind_m, radii_m)
        in_race = [0.0 if rudder.propeller is None else rudder.race_share for rudder in rudders]
        aspect = np.array([rudder.aspect_ratio for rudder in rudders])
        stall = np.radians([rudder.stall_deg for rudder in rudders])
        ahead, right = np.eye(3)[:2]
        wake = [1.0 - rudder.wake_fraction for rudder in rudders]
        race_inflow = [(1.0 - one.wake_fraction) * _rows(one.position_frd_m, ahead) for one in propellers]
        return cls(
            inflow=np.array(
                [share * _rows(r.position_frd_m, ahead) for share, r in zip(wake, rudders, strict=True)]
                + [_rows(r.position_frd_m, right) for r in rudders]
            ).T,
            pressure=0.5 * water.density_kgpm3 * np.array([rudder.area_m2 for rudder in rudders]),
            slope=np.array([rudder.normal_force_slope for rudder in rudders]),
            induced=1.0 / (INDUCED_DRAG_EFFICIENCY * math.pi * aspect),
            sine_at_stall=np.sin(stall),
            per_sine=1.0 / (np.sin(np.minimum(stall + STALL_WIDTH_RAD, 0.5 * math.pi)) - np.sin(stall)),
            wrench=np.array([_rows(r.position_frd_m, way)[:6] for way in (ahead, right) for r in rudders]),
            raced=np.array([index for index, _ in raced], dtype=intp),
            propeller=np.array([rudder.propeller for _, rudder in raced], dtype=intp),
            shares=np.array([[1.0 - share for share in in_race], in_race]),
            race_inflow=np.array(race_inflow).reshape(-1, 9).T,
            speed2_per_newton=2.0 / (water.density_kgpm3 * math.pi * radii_m**2),
            reached_behind=0.5 * (1.0 + along),
            reached_before=0.5 * (1.0 - along),
        )

    def forces_n(self, angle_rad: Array, thrust_n: Array, flow: Array) -> tuple[Array, Array]:
        """Return (N, R) ahead and (N, R) to the right, for (N, R) angles, (N, P) thrusts in open water and (N, 9)
        `flow`.
        """
        local = flow @ self.inflow
        rudders = len(self.pressure)
        along, across = local[:, :rudders], local[:, rudders:]
        if not self.raced.size:
            return self._plate_n(angle_rad, along, across)
        both = np.stack((along, along), axis=1)  # outside the race and in it
        both[:, 1, self.raced] = self._in_race_mps(thrust_n[:, self.propeller], flow @ self.race_inflow)
        ahead_n, right_n = self._plate_n(angle_rad[:, None], both, across[:, None])
        return (self.shares * ahead_n).sum(axis=1), (self.shares * right_n).sum(axis=1)

    def _in_race_mps(self, thrust_n: Array, advance_mps: Array) -> Array:
        """Return the (N, Q) flow speed along the rudders, for their propellers' speeds of advance. Astern, the flow is
        forward.
        """
        sign = np.sign(thrust_n)
        with_thrust = np.maximum(sign * advance_mps, 0.0)
        added = np.sqrt(with_thrust * with_thrust + self.speed2_per_newton * np.abs(thrust_n)) - with_thrust
        race: Array = advance_mps + sign * added * np.where(thrust_n < 0.0, self.reached_before, self.reached_behind)
        return race

    def _plate_n(self, angle_rad: Array, along: Array, across: Array) -> tuple[Array, Array]:
        """Return the force ahead and to the right of the whole area in one flow; (N, R), or (N, 2, R) for two flows."""
        sine, cosine = np.sin(angle_rad), np.cos(angle_rad)
        speed = np.hypot(along, across)
        whole = np.maximum(speed, 1e-9)
        attack_sine = (along * sine + across * cosine) / whole
        attack_cosine = (along * cosine - across * sine) / whole
        left = np.minimum(np.maximum((np.abs(attack_sine) - self.sine_at_stall) * self.per_sine, 0.0), 1.0)
        plate = PLATE_NORMAL_FORCE * np.sign(attack_sine)
        lift = ((1.0 - left) * self.slope * attack_sine + left * plate) * attack_cosine
        drag = (1.0 - left) * self.induced * lift * lift + left * plate * attack_sine
        newtons = self.pressure * speed
        return newtons * (lift * across - drag * along), -newtons * (lift * along + drag * across)


def _rows(place_frd_m: tuple[float, float, float], direction: Array) -> Array:
    """Return (9,) coefficients for `flow`. The first six are also force and moment per newton."""
    return np.concatenate([direction, np.cross(place_frd_m, direction), np.zeros(3)])
