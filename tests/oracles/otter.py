"""The Otter, a catamaran of Maritime Robotics, as Fossen's vessel models have it (PythonVehicleSimulator, otter.py).

The equations and numbers are the published ones. Where the program departs from the equation that it names, `as_run`
follows the program:

- its payload weighs along the trimmed hull, and its buoyancy, linear in heave and pitch, has no part there: 6 to 10 N
  that push ahead, 0.08 m/s at rest and 4 to 5 % more at speed. MATLAB's otter.m has a trimmed equilibrium instead, as
  here;
- its cross-flow integral is a sum of 21 strips of a 20th of the length each: that of a hull longer by 5 cm at either
  end, in water of 1026 kg/m3 where the rest has 1025.

Its moments of inertia about the centre of gravity hold terms about the origin, 7 % more about z (mended in MATLAB in
April 2026). They are data of the model here: everything derived from them was run so.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.oracles.integration import Array, coriolis, cross_matrix, euler_rates, integrated, moved_by, rotation

G, DENSITY = 9.81, 1025.0
LENGTH_M, BEAM_M = 2.0, 1.08
HULL_KG, PAYLOAD_KG = 55.0, 25.0
HULL_CG_M, PAYLOAD_AT_M = np.array([0.2, 0.0, -0.2]), np.array([0.05, 0.0, -0.35])
PONTOON_BEAM_M, PONTOON_AT_M, WATERPLANE, BLOCK = 0.25, 0.395, 0.75, 0.4
MOST_MPS = 6 * 0.5144
AHEAD, ASTERN = 0.02216 / 2, 0.01289 / 2  # N s2 a propeller
FASTEST_RADPS = np.sqrt(0.5 * 24.4 * G / AHEAD)
FASTEST_ASTERN_RADPS = np.sqrt(0.5 * 13.6 * G / ASTERN)
SHAFT_S = 0.1

MASS_KG = HULL_KG + PAYLOAD_KG
CG_M = (HULL_KG * HULL_CG_M + PAYLOAD_KG * PAYLOAD_AT_M) / MASS_KG
VOLUME_M3 = MASS_KG / DENSITY
DRAFT_M = VOLUME_M3 / (2 * BLOCK * PONTOON_BEAM_M * LENGTH_M)

# Hoerner's coefficient of two-dimensional cross-flow over beam / (2 draft), digitised by Fossen (2021, fig 6.13).
_HOERNER = np.array(
    [
        [0.0109, 1.9661], [0.1766, 1.9657], [0.3530, 1.8976], [0.4519, 1.7872], [0.4728, 1.5837], [0.4929, 1.2786],
        [0.4933, 1.2108], [0.5585, 1.0836], [0.6464, 0.9986], [0.8336, 0.8796], [0.9880, 0.8284], [1.3081, 0.7599],
        [1.6392, 0.6914], [1.8600, 0.6571], [2.3129, 0.6307], [2.6000, 0.5962], [3.0088, 0.5868], [3.4508, 0.5859],
        [3.7379, 0.5599], [4.0031, 0.5593],
    ]
)  # fmt: skip


def hoerner(beam_m: float, draft_m: float) -> float:
    return float(np.interp(beam_m / (2.0 * draft_m), _HOERNER[:, 0], _HOERNER[:, 1]))


@dataclass(frozen=True)
class Matrices:
    """About the origin: midships on the centreline, at the waterline."""

    rigid: Array
    added: Array
    damping: Array
    stiffness: Array


def matrices() -> Matrices:
    gyration = HULL_KG * np.diag([(0.4 * BEAM_M) ** 2, (0.25 * LENGTH_M) ** 2, (0.25 * LENGTH_M) ** 2])
    at_cg, payload = cross_matrix(CG_M), cross_matrix(PAYLOAD_AT_M)
    inertia = gyration - HULL_KG * at_cg @ at_cg - PAYLOAD_KG * payload @ payload
    shift = moved_by(CG_M)
    rigid = shift.T @ np.block([[MASS_KG * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), inertia]]) @ shift
    added = np.diag(
        [0.1 * HULL_KG, 1.5 * HULL_KG, HULL_KG, 0.2 * inertia[0, 0], 0.8 * inertia[1, 1], 1.7 * inertia[2, 2]]
    )
    mass = rigid + added

    pontoon_m2 = WATERPLANE * LENGTH_M * PONTOON_BEAM_M
    slender = 6 * WATERPLANE**3 / ((1 + WATERPLANE) * (1 + 2 * WATERPLANE))
    across = 2 / 12 * LENGTH_M * PONTOON_BEAM_M**3 * slender + 2 * pontoon_m2 * PONTOON_AT_M**2
    along = 0.8 * 2 / 12 * PONTOON_BEAM_M * LENGTH_M**3
    buoyancy_m = (5 * DRAFT_M / 2 - 0.5 * VOLUME_M3 / (LENGTH_M * PONTOON_BEAM_M)) / 3  # above the keel
    gravity_m = DRAFT_M - CG_M[2]
    weight = DENSITY * G * VOLUME_M3
    at_flotation = np.diag(
        [
            0.0,
            0.0,
            DENSITY * G * 2 * pontoon_m2,
            weight * (buoyancy_m + across / VOLUME_M3 - gravity_m),
            weight * (buoyancy_m + along / VOLUME_M3 - gravity_m),
            0.0,
        ]
    )
    flotation = moved_by(np.array([-0.2, 0.0, 0.0]))
    natural = np.sqrt(np.diag(at_flotation)[2:5] / np.diag(mass)[2:5])
    damping = np.diag(
        [
            24.4 * G / MOST_MPS,
            mass[1, 1] / 1.0,  # a time constant of 1 s in sway and in yaw
            2 * 0.3 * natural[0] * mass[2, 2],
            2 * 0.2 * natural[1] * mass[3, 3],
            2 * 0.4 * natural[2] * mass[4, 4],
            mass[5, 5] / 1.0,
        ]
    )
    return Matrices(rigid, added, damping, flotation.T @ at_flotation @ flotation)


def cross_flow(sway_mps: float, yaw_radps: float, as_run: bool) -> tuple[float, float]:
    """Force along y and moment about z of the strips along one pontoon's length."""
    density = 1026.0 if as_run else DENSITY
    drag = 0.5 * density * DRAFT_M * hoerner(PONTOON_BEAM_M, DRAFT_M)
    if as_run:
        places, width = np.linspace(-LENGTH_M / 2, LENGTH_M / 2, 21), LENGTH_M / 20
    else:
        width = LENGTH_M / 400
        places = np.arange(-LENGTH_M / 2 + width / 2, LENGTH_M / 2, width)
    across = sway_mps + places * yaw_radps
    force = -drag * np.abs(across) * across * width
    return float(force.sum()), float(places @ force)


@dataclass(frozen=True)
class Otter:
    """Shaft speeds commanded (port, starboard) in rad/s; current along NED; every force of the published model."""

    shafts_radps: tuple[float, float]
    current_ned_mps: tuple[float, float] = (0.0, 0.0)
    sideways_n: float = 0.0  # at the origin
    as_run: bool = False

    def run(self, seconds: float, dt_s: float = 0.01) -> Array:
        """(steps + 1, 14): velocities in body axes (6), position and zyx angles (6), shaft speeds (2)."""
        parts = matrices()
        inverse = np.linalg.inv(parts.rigid + parts.added)
        start = np.zeros(14)
        load = np.array([0.0, 0.0, PAYLOAD_KG * G])
        held = np.concatenate([load, np.cross(PAYLOAD_AT_M, load)])
        afloat = np.zeros(6)
        afloat[2:5] = np.linalg.solve(parts.stiffness[2:5, 2:5], held[2:5])
        start[6:12] = afloat

        def derivative(x: Array) -> Array:
            nu, eta, shafts = x[:6], x[6:12], x[12:]
            turn = rotation(eta[3:])
            yaw = np.array([np.cos(eta[5]), np.sin(eta[5])])
            north, east = self.current_ned_mps
            water = np.array([north * yaw[0] + east * yaw[1], east * yaw[0] - north * yaw[1]])
            relative = nu.copy()
            relative[:2] -= water
            thrust = np.where(shafts > 0, AHEAD, ASTERN) * np.abs(shafts) * shafts
            side, moment = cross_flow(relative[1], relative[5], self.as_run)
            force = -parts.damping @ relative
            force[5] -= 10 * parts.damping[5, 5] * abs(relative[5]) * relative[5]
            force += [thrust.sum(), side + self.sideways_n, 0, 0, 0, moment + PONTOON_AT_M * (thrust[0] - thrust[1])]
            if self.as_run:
                payload = turn.T @ load
                force += np.concatenate([payload, np.cross(PAYLOAD_AT_M, payload)]) - parts.stiffness @ eta
            else:
                force -= parts.stiffness @ (eta - afloat)
            force -= coriolis(parts.rigid + parts.added, relative) @ relative
            faster = inverse @ force
            faster[:2] += [nu[5] * water[1], -nu[5] * water[0]]
            command = np.clip(self.shafts_radps, -FASTEST_ASTERN_RADPS, FASTEST_RADPS)
            rates = np.concatenate([turn @ nu[:3], euler_rates(eta[3:], nu[3:])])
            return np.concatenate([faster, rates, (command - shafts) / SHAFT_S])

        return integrated(derivative, start, seconds, dt_s)
