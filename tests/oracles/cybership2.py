"""CyberShip II, the 1:70 model of a supply ship in NTNU's tank, in three degrees of freedom.

Skjetne, Smogeli & Fossen, A nonlinear ship manoeuvering model, Modeling, Identification and Control 25(1), 2004: hull,
propellers and rudders as identified there (tables 1, 2 and 4); the water's speed at the rudders after Lindegaard &
Fossen (IEEE Transactions on Control Systems Technology 11(6), 2003). About the middle of the waterline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.oracles.integration import Array, integrated

DENSITY = 1000.0
MASS_KG, INERTIA_KGM2, CG_M = 23.8, 1.760, 0.046
X_UDOT, Y_VDOT, Y_RDOT, N_VDOT, N_RDOT = -2.0, -10.0, 0.0, 0.0, -1.0
X_U, X_UU, X_UUU = -0.72253, -1.32742, -5.86643
Y_V, Y_VV, N_V, N_VV = -0.88965, -36.47287, 0.03130, 3.95645
Y_RV, Y_R, Y_VR, Y_RR = -0.805, -7.250, -0.845, -3.450  # Y_RV goes with |r| v, Y_VR with |v| r
N_RV, N_R, N_VR, N_RR = 0.130, -1.900, 0.080, -0.750
PROPELLER_X_M, PROPELLER_Y_M, RUDDER_X_M = -0.499, 0.078, -0.549
PROPELLER_M, INDUCED = 0.060, 0.5  # diameter; share of the slipstream's speed at the rudders
T_NN, T_NU, T_NN_ASTERN, T_NU_ASTERN = 3.65034e-3, 1.52468e-4, 5.10256e-3, 4.55822e-2  # with shafts in 1/s
L_D, L_DD, L_D_ASTERN, L_DD_ASTERN = 6.43306, 5.83594, 3.19573, 2.34356  # with angles in rad


def thrust_n(shaft_hz: float, surge_mps: float) -> float:
    """Of one propeller; none between the speeds at which it idles."""
    if shaft_hz >= max(0.0, T_NU / T_NN * surge_mps):
        return T_NN * abs(shaft_hz) * shaft_hz - T_NU * abs(shaft_hz) * surge_mps
    if shaft_hz <= min(0.0, T_NU_ASTERN / T_NN_ASTERN * surge_mps):
        return T_NN_ASTERN * abs(shaft_hz) * shaft_hz - T_NU_ASTERN * abs(shaft_hz) * surge_mps
    return 0.0


def rudder_n(angle_rad: float, surge_mps: float, propeller_n: float) -> float:
    """Lift of one rudder to port's side for a positive angle, which turns the bow to port: Y = L, N = -0.549 L."""
    speed = surge_mps
    if surge_mps >= 0:
        jet = 8.0 * propeller_n / (np.pi * DENSITY * PROPELLER_M**2) + surge_mps**2
        speed += INDUCED * (np.sqrt(max(jet, 0.0)) - surge_mps)
    linear, square = (L_D, L_DD) if speed >= 0 else (L_D_ASTERN, L_DD_ASTERN)
    return float((linear - square * abs(angle_rad)) * angle_rad * abs(speed) * speed)


@dataclass(frozen=True)
class CyberShip2:
    """Shafts (port, starboard) in 1/s, both rudders at one angle, a force to the side at the origin."""

    shafts_hz: tuple[float, float] = (0.0, 0.0)
    rudder_rad: float = 0.0
    ahead_n: float = 0.0
    sideways_n: float = 0.0
    turning_nm: float = 0.0

    def run(self, seconds: float, start: tuple[float, ...] = (0.0,) * 6, dt_s: float = 0.01) -> Array:
        """(steps + 1, 6): surge, sway, yaw rate, north, east, heading."""
        mass = np.array(
            [
                [MASS_KG - X_UDOT, 0.0, 0.0],
                [0.0, MASS_KG - Y_VDOT, MASS_KG * CG_M - Y_RDOT],
                [0.0, MASS_KG * CG_M - N_VDOT, INERTIA_KGM2 - N_RDOT],
            ]
        )
        inverse = np.linalg.inv(mass)

        def derivative(x: Array) -> Array:
            u, v, r, _, _, psi = x
            thrusts = [thrust_n(shaft, u) for shaft in self.shafts_hz]
            lift = sum(rudder_n(self.rudder_rad, u, newton) for newton in thrusts)
            force = np.array(
                [
                    X_U * u + X_UU * abs(u) * u + X_UUU * u**3 + sum(thrusts) + self.ahead_n,
                    Y_V * v + Y_VV * abs(v) * v + Y_RV * abs(r) * v + Y_R * r + Y_VR * abs(v) * r + Y_RR * abs(r) * r,
                    N_V * v + N_VV * abs(v) * v + N_RV * abs(r) * v + N_R * r + N_VR * abs(v) * r + N_RR * abs(r) * r,
                ]
            )
            force[1] += lift + self.sideways_n
            force[2] += RUDDER_X_M * lift + PROPELLER_Y_M * (thrusts[0] - thrusts[1]) + self.turning_nm
            # C(nu) nu of the table's mass matrix (their eq 5 and 6)
            across = mass[1, 1] * v + 0.5 * (mass[1, 2] + mass[2, 1]) * r
            force -= np.array([-across * r, mass[0, 0] * u * r, across * u - mass[0, 0] * u * v])
            north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
            return np.concatenate([inverse @ force, [north, east, r]])

        return integrated(derivative, np.array(start, dtype=float), seconds, dt_s)
