"""The WAM-V 16 as the Virtual RobotX competition simulates it (osrf/vrx 2.4): its documented plugins, re-derived.

Rigid bodies joined to one (base, two engines, two propellers), drag of each axis by itself at the base's centre of
gravity, buoyancy at two points a hull, thrust at the propellers. Its axes (forward, left, up) are FRD here.

What VRX has and a vessel has not:

- the Coriolis matrix of the added mass is filled and never added. As surge, sway and yaw ship with an added mass of
  zero, nothing is lost but weak terms of heave, roll and pitch (0.1 kg and 0.1 kg m2 by default);
- drag is against the ground: the plugin knows no current. Comparisons are made in still water;
- wind forces take the boat's coefficients along the world's axes: a boat that heads east gets its lateral drag head
  on. Comparisons are made in still air;
- the lift of a point ends when its section is half under (0.213 m).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.oracles.integration import Array, coriolis, cross_matrix, euler_rates, integrated, moved_by, rotation

G = 9.80665
DENSITY = 997.7735
HULL_LENGTH_M, HULL_RADIUS_M = 4.9, 0.213
BUOYANCY_AT_M = np.array([[x, y, 0.0] for x in (0.6, -1.4) for y in (-1.03, 1.03)])
PROPELLERS_AT_M = np.array([[-2.373776 - 0.278156, y, -0.318237 + 0.509371] for y in (-1.027135, 1.027135)])
MOST_N = (51.3 + 72.4 * 7.71667) * 7.71667 / 2.0

# mass, place, inertia about its own centre: the base, then an engine and a propeller to either side
_BODIES = [(180.0, np.zeros(3), np.diag([120.0, 393.0, 446.0]))]
for _side in (-1.0, 1.0):
    _engine = np.array([-2.373776, 1.027135 * _side, -0.318237])
    _BODIES.append((15.0, _engine, np.diag([0.889245, 0.911125, 0.078125])))
    _BODIES.append((0.5, _engine + np.array([-0.278156, 0.0, 0.509371]), np.diag([0.008545, 0.008545, 0.0144])))

MASS_KG = sum(mass for mass, _, _ in _BODIES)
CG_M = sum(mass * place for mass, place, _ in _BODIES) / MASS_KG
INERTIA_KGM2 = sum(
    inertia - mass * cross_matrix(place - CG_M) @ cross_matrix(place - CG_M) for mass, place, inertia in _BODIES
)
"""About the centre of gravity of all of it."""

ADDED = np.diag([0.0, 0.0, 0.1, 0.1, 0.1, 0.0])
LINEAR = np.array([100.0, 100.0, 500.0, 300.0, 900.0, 800.0])
QUADRATIC = np.array([150.0, 100.0, 0.0, 600.0, 900.0, 800.0])


def rigid_mass() -> Array:
    """(6, 6) about the base."""
    shift = moved_by(CG_M)
    return shift.T @ np.block([[MASS_KG * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), INERTIA_KGM2]]) @ shift


def segment_m2(depth_m: Array) -> Array:
    """Of the hull's circle below the water."""
    h = np.clip(depth_m, 0.0, HULL_RADIUS_M)
    r = HULL_RADIUS_M
    return r * r * np.arccos((r - h) / r) - (r - h) * np.sqrt(2 * r * h - h * h)


@dataclass(frozen=True)
class WamV:
    """Thrust (port, starboard) in N at once, and a force to the side at the base, in still water and still air."""

    thrust_n: tuple[float, float]
    sideways_n: float = 0.0

    def run(self, seconds: float, dt_s: float = 0.01) -> Array:
        """(steps + 1, 12): velocities of the base in body axes (6), its position and zyx angles (6)."""
        rigid = rigid_mass()
        inverse = np.linalg.inv(rigid + ADDED)
        start = np.zeros(12)
        start[8:11] = self._afloat()
        thrust = np.zeros(6)
        for newton, place in zip(self.thrust_n, PROPELLERS_AT_M, strict=True):
            ahead = np.array([np.clip(newton, -MOST_N, MOST_N), 0.0, 0.0])
            thrust += np.concatenate([ahead, np.cross(place, ahead)])
        thrust[1] += self.sideways_n

        def derivative(x: Array) -> Array:
            nu, eta = x[:6], x[6:]
            turn = rotation(eta[3:])
            force = thrust - (LINEAR + QUADRATIC * np.abs(nu)) * nu
            force += self._floating(eta, turn) - coriolis(rigid, nu) @ nu
            rates = np.concatenate([turn @ nu[:3], euler_rates(eta[3:], nu[3:])])
            return np.concatenate([inverse @ force, rates])

        return integrated(derivative, start, seconds, dt_s)

    @staticmethod
    def _floating(eta: Array, turn: Array) -> Array:
        """Weight and buoyancy in body axes, about the base."""
        weight = turn.T @ [0.0, 0.0, MASS_KG * G]
        total = np.concatenate([weight, np.cross(CG_M, weight)])
        depth_m = eta[2] + (BUOYANCY_AT_M @ turn.T)[:, 2]
        for lift_n, place in zip(DENSITY * G * HULL_LENGTH_M / 2 * segment_m2(depth_m), BUOYANCY_AT_M, strict=True):
            lift = turn.T @ [0.0, 0.0, -lift_n]
            total += np.concatenate([lift, np.cross(place, lift)])
        return total

    def _afloat(self) -> Array:
        """Depth, heel and trim at rest, by Newton's method."""
        unknown = np.array([0.1, 0.0, 0.0])

        def rest(three: Array) -> Array:
            eta = np.concatenate([[0.0, 0.0], three, [0.0]])
            return self._floating(eta, rotation(eta[3:]))[2:5]

        for _ in range(20):
            slope = np.column_stack([(rest(unknown + step) - rest(unknown - step)) / 2e-6 for step in 1e-6 * np.eye(3)])
            unknown = unknown - np.linalg.solve(slope, rest(unknown))
        return unknown
