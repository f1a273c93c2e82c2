"""Hulls against what stands in the water, what drifts in it, and the ground.

What is far from every vessel is left out: `near_of` looks now and then, `meet` at each step and at what is near alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.kinematics import Kinematics
from sim_core.world.capsules import Capsules, Numbers, touches
from sim_core.world.contact import (
    NO_CONTACTS,
    Contacts,
    Outline,
    bed_normal,
    pressed_n,
    velocity_at,
    wrench_frd,
)
from sim_core.world.drifting import DebrisState, Push, pushed_at
from sim_core.world.held import body_velocity, capsules_of
from sim_core.world.river import Bed

Array = NDArray[float64]

NEAR_M = 0.5  # farther than two things come together between two looks
AGROUND = "bank"
_NO_NUMBERS = np.empty(0, np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """What vessels may touch before the next look: numbers of what stands and of bodies; whether the ground."""

    standing: Numbers
    bodies: Numbers
    ground: bool

    @property
    def nothing(self) -> bool:
        """Open water."""
        return not (len(self.standing) or len(self.bodies) or self.ground)


NOTHING_NEAR = Near(_NO_NUMBERS, _NO_NUMBERS, False)


def near_of(standing: Capsules, bed: Bed | None, outline: Outline, motion: Kinematics, debris: DebrisState) -> Near:
    """What any vessel may touch before the next look."""
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
    """(4 N, 2) places of the ends of the keels and (4 N,) how deep they are."""
    keel = (motion.rot_ned_frd @ outline.keel_frd_m.T).transpose(0, 2, 1) + motion.pos_ned_m[:, None]
    places = keel.reshape(-1, 3)
    return places[:, :2], places[:, 2]


def meet(
    standing: Capsules,
    bed: Bed | None,
    outline: Outline,
    motion: Kinematics,
    debris: DebrisState,
    near: Near,
    dt_s: float,
) -> tuple[Contacts, Array | None, Push | None]:
    """Contacts of the vessels, their wrench, and what presses on the bodies."""
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
    contacts = parts[0] if len(parts) == 1 else _joined(parts)
    wrench = wrench_frd(motion, contacts.vessel, contacts.place_ned_m, contacts.force_ned_n)
    return contacts, wrench, push


def _against_standing(
    standing: Capsules, hulls: Capsules, near: Numbers, outline: Outline, motion: Kinematics, dt_s: float
) -> Contacts:
    hull, other = _pairs(len(hulls), near)
    touch = touches(hulls, standing, hull, other)
    if not len(touch.first):
        return NO_CONTACTS
    vessel = touch.first // 2
    place = _at_axis(touch.place_ne_m, motion, outline, vessel)
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
    vessel, body = touch.first // 2, touch.second
    place = _at_axis(touch.place_ne_m, motion, outline, vessel)
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
    vessel = aground // 4
    place = np.column_stack([places[aground], keel_m[aground]])
    velocity = velocity_at(motion, vessel, place)
    mass = np.full(len(vessel), outline.mass_kg)
    force = pressed_n(normal, over[aground] * -normal[:, 2], velocity, mass, dt_s)
    closing = -np.vecdot(velocity, normal)
    return Contacts(vessel, (AGROUND,) * len(vessel), place, force, closing, np.sqrt(np.vecdot(force, force)) * dt_s)


def _pairs(hulls: int, others: Numbers) -> tuple[Numbers, Numbers]:
    return np.repeat(np.arange(hulls), len(others)), np.tile(others, hulls)


def _at_axis(place_ne_m: Array, motion: Kinematics, outline: Outline, vessel: Numbers) -> Array:
    """(K, 3) at the height of the hulls' axes."""
    return np.column_stack([place_ne_m, motion.pos_ned_m[vessel, 2] + outline.ends_frd_m[0, 2]])


def _contacts(
    vessel: Numbers, what: tuple[str, ...], place: Array, force_ne: Array, velocity: Array, normal: Array, dt_s: float
) -> Contacts:
    force = np.column_stack([force_ne, np.zeros(len(force_ne))])
    impulse = np.sqrt(np.vecdot(force_ne, force_ne)) * dt_s
    return Contacts(vessel, what, place, force, -np.vecdot(velocity, normal), impulse)


def _joined(parts: list[Contacts]) -> Contacts:
    return Contacts(
        np.concatenate([part.vessel for part in parts]),
        tuple(name for part in parts for name in part.what),
        np.concatenate([part.place_ned_m for part in parts]),
        np.concatenate([part.force_ned_n for part in parts]),
        np.concatenate([part.closing_mps for part in parts]),
        np.concatenate([part.impulse_ns for part in parts]),
    )
