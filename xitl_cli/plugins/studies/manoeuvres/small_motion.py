"""Small motions about rest or about steady way: stiffness, natural periods, damping ratios, course stability.

The acceleration of the simulated vessel is differentiated numerically, by central differences. All forces of the vessel
are therefore included. State: depth z, roll, pitch, then the six velocities in body axes.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.waves import StillHull
from sim_core.frames import Array, euler_to_quat, matrix_to_euler, quat_to_matrix
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation
from sim_core.vessel.step_length import slopes
from sim_core.vessel.vessel import Surroundings, VesselState, accelerate

Plane = Literal["across", "upright"]


@dataclass(frozen=True, slots=True)
class NaturalMode:
    """An oscillation about rest."""

    name: str
    period_s: float
    """Natural period without damping."""
    damping_ratio: float
    """Share of critical damping."""


@dataclass(frozen=True, slots=True, eq=False)
class SmallMotion:
    """x' = matrix x about one motion."""

    matrix: Array
    """State matrix, (9, 9)."""
    mass: Array
    """Mass with added mass, (6, 6)."""

    @property
    def stiffness(self) -> Array:
        """Force down and moments of roll and pitch against depth, roll and pitch, (3, 3)."""
        restoring: Array = -(self.mass @ self.matrix[3:, :3])[2:5]
        return restoring

    @property
    def damping(self) -> Array:
        """Force against velocity, (6, 6)."""
        drag: Array = -self.mass @ self.matrix[3:, 3:]
        return drag

    def modes(self) -> tuple[NaturalMode, ...]:
        """Return heave, roll and pitch: the undamped modes, each with the damping of its mode shape.

        This also applies to an overdamped mode. Raises ValueError if the vessel does not right itself.
        """
        restoring = np.zeros((6, 6))
        restoring[:, 2:5] = -self.matrix[3:, :3]
        squares, shapes = np.linalg.eig(restoring)
        left = np.linalg.inv(shapes)
        modes = []
        largest = np.argsort(-squares.real)[:3]
        for mode in largest:
            square = squares[mode].real
            if square <= 0:
                raise ValueError("does not right itself: its metacentric height is below 0")
            omega = float(np.sqrt(square))
            damped = (left[mode] @ -self.matrix[3:, 3:] @ shapes[:, mode]).real
            share = np.abs(left[mode] * shapes[:, mode])[2:5]
            modes.append((share, 2.0 * np.pi / omega, float(damped) / (2.0 * omega)))
        names: dict[int, str] = {}
        order = sorted(((share[axis], mode, axis) for mode, (share, _, _) in enumerate(modes) for axis in range(3)))
        for _, mode, axis in reversed(order):
            if mode not in names and (name := ("heave", "roll", "pitch")[axis]) not in names.values():
                names[mode] = name
        named = [NaturalMode(names[mode], period, ratio) for mode, (_, period, ratio) in enumerate(modes)]
        return tuple(sorted(named, key=lambda mode: ("heave", "roll", "pitch").index(mode.name)))

    def growth(self, plane: Plane) -> float:
        """Return the largest growth rate (1/s) across the hull (sway, roll, yaw) or in its upright plane; below 0:
        none.
        """
        rows = np.array([1, 4, 6, 8] if plane == "across" else [0, 2, 3, 5, 7])
        return float(np.linalg.eigvals(self.matrix[np.ix_(rows, rows)]).real.max())

    @property
    def fastest_radps(self) -> float:
        """Return the fastest rate of all motions, which limits the steps of a simulation."""
        return float(np.abs(np.linalg.eigvals(self.matrix)).max())


def small_motion(simulation: Simulation, state: VesselState, vessel: int = 0) -> SmallMotion:
    """Linearise about the motion of one vessel of a state, in still water, with its propellers held."""
    matrix = slopes(_Base(simulation, state, vessel).rates)
    hydrodynamics = simulation.vessel.hydrodynamics
    mass: Array = hydrodynamics.rigid_mass + hydrodynamics.added_mass
    return SmallMotion(matrix, mass)


def moved(simulation: Simulation, state: VesselState, offsets: Array) -> Kinematics:
    """Return the first vessel of a state, offset by (N, 9) in depth, roll, pitch and the six velocities."""
    return _Base(simulation, state, 0).motions(offsets)


class _Base:
    """One motion and small deviations from it."""

    def __init__(self, simulation: Simulation, state: VesselState, vessel: int) -> None:
        motion = state.motion
        self._vessel = simulation.vessel
        self._points = len(np.atleast_2d(simulation.vessel.buoyancy.points_frd_m))
        self._rotor = state.rotor_speed[vessel]
        self._pos = motion.pos_ned_m[vessel]
        rotation = motion.rot_ned_frd[vessel]
        self._euler = matrix_to_euler(rotation)
        self._velocity = np.concatenate([motion.vel_ned_mps[vessel] @ rotation, motion.gyro_frd_radps[vessel]])

    def motions(self, offsets: Array) -> Kinematics:
        """Return the motions for (N, 9) offsets."""
        count = len(offsets)
        pos = np.tile(self._pos, (count, 1))
        pos[:, 2] += offsets[:, 0]
        euler = np.tile(self._euler, (count, 1))
        euler[:, :2] += offsets[:, 1:3]
        quat = euler_to_quat(euler)
        rotation = quat_to_matrix(quat)
        velocity = self._velocity + offsets[:, 3:]
        zero = np.zeros((count, 3))
        return Kinematics(
            pos, np.vecdot(rotation, velocity[:, None, :3]), zero, quat, rotation, velocity[:, 3:].copy(), zero
        )

    def rates(self, offsets: Array) -> Array:
        """Return (N, 9) derivatives of depth, roll, pitch and velocity."""
        count, motion = len(offsets), self.motions(offsets)
        surface = StillHull(self._points).sample(0.0, motion.pos_ned_m, motion.rot_ned_frd)
        still = np.zeros((count, 3))
        around = Surroundings(still, still, surface, still[:, :2])
        acceleration = accelerate(self._vessel, motion, np.tile(self._rotor, (count, 1)), around)
        velocity = self._velocity + offsets[:, 3:]
        rate, euler = velocity[:, 3:], matrix_to_euler(motion.rot_ned_frd)
        roll, pitch = euler[:, 0], euler[:, 1]
        across = np.sin(roll) * rate[:, 1] + np.cos(roll) * rate[:, 2]
        turning = np.column_stack(
            [rate[:, 0] + np.tan(pitch) * across, np.cos(roll) * rate[:, 1] - np.sin(roll) * rate[:, 2]]
        )
        acceleration[:, :3] -= np.cross(rate, velocity[:, :3])
        return np.column_stack([motion.vel_ned_mps[:, 2], turning, acceleration])
