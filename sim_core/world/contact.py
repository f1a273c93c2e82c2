"""What hulls run into: log boom, walls, banks and bodies adrift.

A spring and a damper side by side press along the normal, F = k x + c x', never pulling; Coulomb friction acts across
it. What presses on the vessel presses back on the body. A step of the integration must be short against the contact:
the spring is never stiffer than what `SPRING_TURN` radians of its swing a step allow for the masses that meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.kinematics import Kinematics
from sim_core.vessel.model import VesselModel
from sim_core.world.capsules import Capsules, Numbers
from sim_core.world.river import Bed

Array = NDArray[float64]

STIFFNESS_NPM = 60e3  # a hull of glass fibre against a float that gives: 0.1 m at 3 m/s for 113 kg
DAMPING_RATIO = 0.25
FRICTION = 0.3
SLIDING_MPS = 0.05  # below this the friction falls off, so that what lies still stays
SPRING_TURN = 0.15
_FRICTION_SHARE = 0.2  # of the sliding speed that friction may take in one step


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """Two demi-hulls for contact: ends_frd_m (4, 3) of their axes, port stern, port bow, starboard stern and bow.

    reach_m: no part of them is farther from the origin in plan.
    """

    ends_frd_m: Array
    radius_m: float
    keel_frd_m: Array
    mass_kg: float
    reach_m: float

    @classmethod
    def of(cls, model: VesselModel) -> Outline:
        hull = model.hull
        along, axis_m = max(0.5 * hull.length_m - hull.radius_m, 0.0), hull.keel_below_cg_m - hull.radius_m
        sides = ((-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0))
        ends = np.array([(x * along, y * hull.centreline_m, axis_m) for x, y in sides])
        keel = ends + np.array([0.0, 0.0, hull.radius_m])
        reach = float(np.hypot(along, hull.centreline_m)) + hull.radius_m
        return cls(ends, hull.radius_m, keel, model.mass_kg, reach)

    def capsules(self, motion: Kinematics) -> Capsules:
        """Two for each of N vessels."""
        ends = (motion.rot_ned_frd @ self.ends_frd_m.T)[:, :2].transpose(0, 2, 1) + motion.pos_ned_m[:, None, :2]
        pairs = ends.reshape(-1, 2, 2)
        return Capsules(pairs[:, 0], pairs[:, 1], np.full(len(pairs), self.radius_m), ("hull",) * len(pairs))


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """K contacts of vessels in one step.

    vessel (K,): which; what: `log boom`, `bank`, `trunk 3` ...; place_ned_m, force_ned_n (K, 3): on the vessel;
    closing_mps (K,): how fast the two come together along the normal; impulse_ns (K,): force times the step.
    """

    vessel: Numbers
    what: tuple[str, ...]
    place_ned_m: Array
    force_ned_n: Array
    closing_mps: Array
    impulse_ns: Array

    def __len__(self) -> int:
        return len(self.what)


NO_CONTACTS = Contacts(np.empty(0, np.intp), (), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))


def pressed_n(normal: Array, depth_m: Array, velocity_mps: Array, mass_kg: Array, dt_s: float) -> Array:
    """(K, D) force on the first of two bodies, in 2 or 3 dimensions.

    normal (K, D): unit, away from the second; velocity_mps (K, D): of the first against the second at the place;
    mass_kg (K,): of both together, m1 m2 / (m1 + m2).
    """
    stiffness = np.minimum(STIFFNESS_NPM, mass_kg * (SPRING_TURN / dt_s) ** 2)
    leaving = np.vecdot(velocity_mps, normal)
    damping = 2.0 * DAMPING_RATIO * np.sqrt(stiffness * mass_kg)
    press = np.maximum(stiffness * depth_m - damping * leaving, 0.0)
    sliding = velocity_mps - leaving[:, None] * normal
    speed = np.sqrt(np.vecdot(sliding, sliding))
    held = np.minimum(FRICTION * press / (speed + SLIDING_MPS), _FRICTION_SHARE * mass_kg / dt_s)
    force: Array = press[:, None] * normal - held[:, None] * sliding
    return force


def bed_normal(bed: Bed, north_east_m: Array) -> Array:
    """(K, 3) unit vectors out of the ground at (K, 2) places."""
    slope = bed.gradient(north_east_m)
    out = np.column_stack([slope, np.full(len(slope), -1.0)])
    normal: Array = out / np.sqrt(np.vecdot(out, out))[:, None]
    return normal


def wrench_frd(motion: Kinematics, vessel: Numbers, place_ned_m: Array, force_ned_n: Array) -> Array:
    """(N, 6) force and moment in body axes of K forces at places on the vessels."""
    lever = place_ned_m - motion.pos_ned_m[vessel]
    total = np.zeros((len(motion.pos_ned_m), 6))
    np.add.at(total[:, :3], vessel, force_ned_n)
    np.add.at(total[:, 3:], vessel, np.cross(lever, force_ned_n))
    turned: Array = total.reshape(-1, 2, 3) @ motion.rot_ned_frd  # row vectors: v @ R is R^T v
    return turned.reshape(-1, 6)


def velocity_at(motion: Kinematics, vessel: Numbers, place_ned_m: Array) -> Array:
    """(K, 3) velocity of the vessels' matter at places, NED."""
    spin_ned = (motion.rot_ned_frd[vessel] @ motion.gyro_frd_radps[vessel][:, :, None])[:, :, 0]
    velocity: Array = motion.vel_ned_mps[vessel] + np.cross(spin_ned, place_ned_m - motion.pos_ned_m[vessel])
    return velocity
