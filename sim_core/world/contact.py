"""Contact of hulls with fixed structures, drifting bodies and the ground.

A spring and a damper in parallel press along the normal, F = k x + c x', and never pull. Coulomb friction acts across
it. The reaction acts on the body. A step of the integration must be short relative to the contact. The stiffness is
limited: the colliding masses oscillate by at most `SPRING_TURN` radians per step.

Objects far from every vessel are skipped: `find_near` searches at intervals, and `compute_contacts` checks only the
objects near a vessel.
"""

from __future__ import annotations

import math

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.vessel.spec import VesselSpec
from sim_core.world.debris import DebrisState, Push, body_velocity, capsules_of, pushed_at
from sim_core.world.plan import Capsules, Numbers, touches
from sim_core.world.river import Bed

STIFFNESS_NPM = 60e3  # a hull of glass fibre against a yielding float: 0.1 m at 3 m/s for 113 kg
DAMPING_RATIO = 0.25
FRICTION = 0.3
SLIDING_MPS = 0.05  # below this the friction falls off, so that bodies at rest stay at rest
SPRING_TURN = 0.15
SWING_RADPS = 20.0
"""Minimum frequency of the contact spring for free, heavy bodies. With a softer spring, 3 t at 5 m/s would pass
through.
"""
_FRICTION_SHARE = 0.2  # of the sliding speed that friction may remove in one step


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """H hulls for contact, each a capsule of half its width with its keel as lowest line."""

    ends_frd_m: Array
    """Ends of the axes, stern and bow of each, (2 H, 3)."""
    radius_m: Array
    """Radii, (H,)."""
    mass_kg: float
    reach_m: float
    """Largest distance of the hulls from the origin in plan."""
    spheres_frd_m: Array
    """Centres of the spheres that fill the hulls, (S, 3)."""
    sphere_radius_m: Array
    """Radii of the spheres, (S,)."""

    @classmethod
    def from_spec(cls, model: VesselSpec) -> Outline:
        hulls = model.demi_hulls
        radii = np.array([0.5 * hull.width_m for hull in hulls])
        half = np.array([max(0.5 * hull.length_m - 0.5 * hull.width_m, 0.0) for hull in hulls])
        middles = np.array([hull.keel_frd_m for hull in hulls]) - radii[:, None] * [0.0, 0.0, 1.0]
        ends = middles[:, None] + half[:, None, None] * np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        spheres = [spheres_along(stern, bow, radius) for (stern, bow), radius in zip(ends, radii, strict=True)]
        return cls(
            ends_frd_m=ends.reshape(-1, 3),
            radius_m=radii,
            mass_kg=model.mass_kg,
            reach_m=float(np.max(np.hypot(ends[..., 0], ends[..., 1]) + radii[:, None])),
            spheres_frd_m=np.concatenate(spheres),
            sphere_radius_m=np.repeat(radii, [len(centres) for centres in spheres]),
        )

    @property
    def keel_frd_m(self) -> Array:
        """Points of the keel below the ends of the axes, (2 H, 3)."""
        keel: Array = self.ends_frd_m + np.repeat(self.radius_m, 2)[:, None] * [0.0, 0.0, 1.0]
        return keel

    def capsules(self, motion: Kinematics) -> Capsules:
        """Return H capsules for each of N vessels."""
        ends = (motion.rot_ned_frd @ self.ends_frd_m.T)[:, :2].transpose(0, 2, 1) + motion.pos_ned_m[:, None, :2]
        pairs = ends.reshape(-1, 2, 2)
        radii = np.tile(self.radius_m, len(motion.pos_ned_m))
        return Capsules(pairs[:, 0], pairs[:, 1], radii, ("hull",) * len(pairs))


def spheres_along(stern_frd_m: Array, bow_frd_m: Array, radius_m: float) -> Array:
    """Return the (S, 3) centres of spheres along the axis of a hull."""
    count = max(math.ceil(float(np.linalg.norm(bow_frd_m - stern_frd_m)) / (0.75 * radius_m)), 1) + 1
    spheres: Array = stern_frd_m + np.linspace(0.0, 1.0, count)[:, None] * (bow_frd_m - stern_frd_m)
    return spheres


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """K contacts of vessels in one step."""

    vessel: Numbers
    """Indices of the vessels, (K,)."""
    what: tuple[str, ...]
    """Names of the other objects: `log boom`, `bank`, `trunk 3` ..."""
    place_ned_m: Array
    """Positions, (K, 3)."""
    force_ned_n: Array
    """Forces on the vessels, (K, 3)."""
    closing_mps: Array
    """Closing speeds along the normal, (K,)."""
    impulse_ns: Array
    """Force times the step, (K,)."""

    def __len__(self) -> int:
        return len(self.what)

    def rows(self, chosen: Numbers, vessel: Numbers) -> Contacts:
        """Select the contacts with the indices chosen (R,) and give their vessels the indices `vessel` (R,)."""
        return Contacts(
            vessel,
            tuple(self.what[number] for number in chosen.tolist()),
            self.place_ned_m[chosen],
            self.force_ned_n[chosen],
            self.closing_mps[chosen],
            self.impulse_ns[chosen],
        )


NO_CONTACTS = Contacts(np.empty(0, np.intp), (), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))


def pressed_n(
    normal: Array,
    depth_m: Array,
    velocity_mps: Array,
    mass_kg: Array,
    dt_s: float,
    stiffness_npm: Array | float = STIFFNESS_NPM,
) -> Array:
    """Return the (K, D) force on the first of two bodies, in 2 or 3 dimensions.

    normal: (K, D) unit vector away from the second body. velocity_mps: (K, D) velocity of the first relative to the
    second at the contact. mass_kg: (K,) effective mass, m1 m2 / (m1 + m2).
    """
    stiffness = np.minimum(stiffness_npm, mass_kg * (SPRING_TURN / dt_s) ** 2)
    leaving = np.vecdot(velocity_mps, normal)
    damping = 2.0 * DAMPING_RATIO * np.sqrt(stiffness * mass_kg)
    press = np.maximum(stiffness * depth_m - damping * leaving, 0.0)
    sliding = velocity_mps - leaving[:, None] * normal
    speed = np.sqrt(np.vecdot(sliding, sliding))
    friction = np.minimum(FRICTION * press / (speed + SLIDING_MPS), _FRICTION_SHARE * mass_kg / dt_s)
    force: Array = press[:, None] * normal - friction[:, None] * sliding
    return force


def bed_normal(bed: Bed, north_east_m: Array) -> Array:
    """Return (K, 3) unit vectors out of the ground at (K, 2) places."""
    slope = bed.gradient(north_east_m)
    out = np.column_stack([slope, np.full(len(slope), -1.0)])
    normal: Array = out / np.sqrt(np.vecdot(out, out))[:, None]
    return normal


def wrench_frd(motion: Kinematics, vessel: Numbers, place_ned_m: Array, force_ned_n: Array) -> Array:
    """Return the (N, 6) force and moment in body axes of K forces at places on the vessels."""
    lever = place_ned_m - motion.pos_ned_m[vessel]
    total = np.zeros((len(motion.pos_ned_m), 6))
    np.add.at(total[:, :3], vessel, force_ned_n)
    np.add.at(total[:, 3:], vessel, np.cross(lever, force_ned_n))
    turned: Array = total.reshape(-1, 2, 3) @ motion.rot_ned_frd  # row vectors: v @ R is R^T v
    return turned.reshape(-1, 6)


def velocity_at(motion: Kinematics, vessel: Numbers, place_ned_m: Array) -> Array:
    """Return the (K, 3) velocity, NED, of points of the vessels at places."""
    spin_ned = (motion.rot_ned_frd[vessel] @ motion.gyro_frd_radps[vessel][:, :, None])[:, :, 0]
    velocity: Array = motion.vel_ned_mps[vessel] + np.cross(spin_ned, place_ned_m - motion.pos_ned_m[vessel])
    return velocity


NEAR_M = 0.5  # no two objects approach by more than this between two searches
AGROUND = "bank"
_NO_NUMBERS = np.empty(0, np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """Objects that vessels may touch before the next search."""

    standing: Numbers
    """Indices of fixed capsules."""
    bodies: Numbers
    """Indices of bodies."""
    ground: bool
    """True if the ground is near."""

    @property
    def nothing(self) -> bool:
        """True in open water."""
        return not (len(self.standing) or len(self.bodies) or self.ground)


NOTHING_NEAR = Near(_NO_NUMBERS, _NO_NUMBERS, False)


def find_near(standing: Capsules, bed: Bed | None, outline: Outline, motion: Kinematics, debris: DebrisState) -> Near:
    """Return the objects that any vessel may touch before the next search."""
    place = motion.pos_ned_m[:, :2]
    reach_m = outline.reach_m + NEAR_M
    close = _NO_NUMBERS
    if len(standing):
        close = np.flatnonzero((standing.distance_m(place) < reach_m).any(axis=0))
    bodies = _NO_NUMBERS
    if debris.bodies:
        between = place[:, None] - debris.pos_ned_m[None, :, :2]
        figures = debris.figures
        bound = reach_m + figures.half_axis_m + figures.radius_m
        bodies = np.flatnonzero((np.vecdot(between, between) < bound**2).any(axis=0))
    ground = False
    if bed is not None:
        corners, keel_m = _keel(outline, motion)
        ground = bool(np.any(bed.bed_down_m(corners) < keel_m + NEAR_M))
    return Near(close, bodies, ground)


def _keel(outline: Outline, motion: Kinematics) -> tuple[Array, Array]:
    """Return (2 H N, 2) positions of the ends of the keels and (2 H N,) their down coordinates."""
    keel = (motion.rot_ned_frd @ outline.keel_frd_m.T).transpose(0, 2, 1) + motion.pos_ned_m[:, None]
    places = keel.reshape(-1, 3)
    return places[:, :2], places[:, 2]


def compute_contacts(
    standing: Capsules,
    bed: Bed | None,
    outline: Outline,
    motion: Kinematics,
    debris: DebrisState,
    near: Near,
    dt_s: float,
) -> tuple[Contacts, Array | None, Push | None]:
    """Return the contacts of the vessels, their wrench, and the push on the bodies."""
    hulls = outline.capsules(motion)
    push = None
    parts = []
    if len(near.standing):
        parts.append(_against_standing(standing, hulls, near.standing, outline, motion, dt_s))
    if len(near.bodies):
        part, push = _against_bodies(debris, hulls, near.bodies, outline, motion, dt_s)
        parts.append(part)
    if near.ground and bed is not None:
        parts.append(_against_ground(bed, outline, motion, dt_s))
    parts = [part for part in parts if len(part)]
    if not parts:
        return NO_CONTACTS, None, push
    contacts = joined_contacts(parts)
    wrench = wrench_frd(motion, contacts.vessel, contacts.place_ned_m, contacts.force_ned_n)
    return contacts, wrench, push


def _against_standing(
    standing: Capsules, hulls: Capsules, near: Numbers, outline: Outline, motion: Kinematics, dt_s: float
) -> Contacts:
    hull, other = _pairs(len(hulls), near)
    touch = touches(hulls, standing, hull, other)
    if not len(touch.first):
        return NO_CONTACTS
    vessel = touch.first // len(outline.radius_m)
    place = _at_axis(touch.place_ne_m, motion, outline, touch.first)
    velocity = velocity_at(motion, vessel, place)[:, :2]
    mass = np.full(len(vessel), outline.mass_kg)
    force = pressed_n(touch.normal_ne, touch.depth_m, velocity, mass, dt_s)
    names = tuple(standing.names[number] for number in touch.second.tolist())
    return _contacts(vessel, names, place, force, velocity, touch.normal_ne, dt_s)


def _against_bodies(
    debris: DebrisState, hulls: Capsules, near: Numbers, outline: Outline, motion: Kinematics, dt_s: float
) -> tuple[Contacts, Push | None]:
    hull, other = _pairs(len(hulls), near)
    touch = touches(hulls, capsules_of(debris), hull, other)
    if not len(touch.first):
        return NO_CONTACTS, None
    vessel, body = touch.first // len(outline.radius_m), touch.second
    place = _at_axis(touch.place_ne_m, motion, outline, touch.first)
    velocity = velocity_at(motion, vessel, place)[:, :2] - body_velocity(debris, body, touch.place_ne_m)
    body_kg = np.array([debris.bodies[number].mass_kg for number in body.tolist()])
    mass = outline.mass_kg * body_kg / (outline.mass_kg + body_kg)
    force = pressed_n(touch.normal_ne, touch.depth_m, velocity, mass, dt_s)
    names = tuple(f"{debris.bodies[number].kind.name.lower()} {number}" for number in body.tolist())
    contacts = _contacts(vessel, names, place, force, velocity, touch.normal_ne, dt_s)
    return contacts, pushed_at(debris, body, touch.place_ne_m, -force)


def _against_ground(bed: Bed, outline: Outline, motion: Kinematics, dt_s: float) -> Contacts:
    places, keel_m = _keel(outline, motion)
    over = keel_m - bed.bed_down_m(places)
    aground = np.flatnonzero(over > 0.0)
    if not len(aground):
        return NO_CONTACTS
    normal = bed_normal(bed, places[aground])
    vessel = aground // len(outline.ends_frd_m)
    place = np.column_stack([places[aground], keel_m[aground]])
    velocity = velocity_at(motion, vessel, place)
    mass = np.full(len(vessel), outline.mass_kg)
    force = pressed_n(normal, over[aground] * -normal[:, 2], velocity, mass, dt_s)
    closing = -np.vecdot(velocity, normal)
    return Contacts(vessel, (AGROUND,) * len(vessel), place, force, closing, np.sqrt(np.vecdot(force, force)) * dt_s)


def _pairs(hulls: int, others: Numbers) -> tuple[Numbers, Numbers]:
    return np.repeat(np.arange(hulls), len(others)), np.tile(others, hulls)


def _at_axis(place_ne_m: Array, motion: Kinematics, outline: Outline, hull: Numbers) -> Array:
    """Add the down coordinate of the hulls' axes: (K, 3). Hulls are numbered through all vessels."""
    vessel, own = np.divmod(hull, len(outline.radius_m))
    return np.column_stack([place_ne_m, motion.pos_ned_m[vessel, 2] + outline.ends_frd_m[2 * own, 2]])


def _contacts(
    vessel: Numbers, what: tuple[str, ...], place: Array, force_ne: Array, velocity: Array, normal: Array, dt_s: float
) -> Contacts:
    force = np.column_stack([force_ne, np.zeros(len(force_ne))])
    impulse = np.sqrt(np.vecdot(force_ne, force_ne)) * dt_s
    return Contacts(vessel, what, place, force, -np.vecdot(velocity, normal), impulse)


def joined_contacts(parts: list[Contacts]) -> Contacts:
    """Join contacts of several parts."""
    if len(parts) == 1:
        return parts[0]
    return Contacts(
        np.concatenate([part.vessel for part in parts]),
        tuple(name for part in parts for name in part.what),
        np.concatenate([part.place_ned_m for part in parts]),
        np.concatenate([part.force_ned_n for part in parts]),
        np.concatenate([part.closing_mps for part in parts]),
        np.concatenate([part.impulse_ns for part in parts]),
    )
