"""Contact of hulls with each other: vessels and scripted vessels.

Capsules in plan press on each other with spring, damper and friction as in `contact`. Both hulls feel opposite forces
at the same position, so momentum and angular momentum are conserved. A scripted vessel is infinitely heavy and keeps to
its track.

A search at intervals finds pairs with cells of the plan. The cost of a step depends on the number of near pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.world.contact import (
    NEAR_M,
    NO_CONTACTS,
    STIFFNESS_NPM,
    SWING_RADPS,
    Contacts,
    Outline,
    pressed_n,
    velocity_at,
)
from sim_core.world.plan import Capsules, Numbers, touches

_BEAM_SHARE = 0.5  # of the radius of the thinner hull
_NO_NUMBERS = np.empty(0, np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Hulls:
    """H hulls, and beams between them, of M vessels. The hulls of a vessel are adjacent."""

    names: tuple[str, ...]
    """Names of the M vessels."""
    vessel: Numbers
    """Vessel of each hull, (H,)."""
    ends_frd_m: Array
    """Ends of the axes, (H, 2, 3)."""
    radius_m: Array
    """Radii, (H,)."""
    first_hull: Numbers
    """Index of the first hull of each vessel, (M + 1,)."""
    mass_kg: Array
    """Mass of each vessel, (M,)."""
    reach_m: Array
    """Reach of each vessel, (M,)."""
    order: Numbers
    """Rank of each vessel by name, (M,). Contacts are processed in this order, so the order of the list of vessels has
    no effect.
    """

    @classmethod
    def from_outlines(cls, outlines: Sequence[Outline], names: Sequence[str]) -> Hulls:
        """Build the hulls from one outline per vessel. Names must be different."""
        parts = [_with_beams(outline) for outline in outlines]
        counts = [len(radius) for _, radius in parts]
        order = np.empty(len(names), np.intp)
        order[sorted(range(len(names)), key=names.__getitem__)] = np.arange(len(names))
        return cls(
            names=tuple(names),
            vessel=np.repeat(np.arange(len(outlines)), counts),
            ends_frd_m=np.concatenate([ends for ends, _ in parts]),
            radius_m=np.concatenate([radius for _, radius in parts]),
            first_hull=np.concatenate([[0], np.cumsum(counts)]),
            mass_kg=np.array([outline.mass_kg for outline in outlines]),
            reach_m=np.array([outline.reach_m for outline in outlines]),
            order=order,
        )


def _with_beams(outline: Outline) -> tuple[Array, Array]:
    """Return ends (B, 2, 3) and radii (B,) of a vessel's capsules, and of beams between neighbouring hulls.

    Debris can get between the hulls of a catamaran, under its deck; another hull cannot. The beams lie behind the tips,
    which touch first.
    """
    ends, radii = outline.ends_frd_m.reshape(-1, 2, 3), outline.radius_m
    if not np.isfinite(outline.mass_kg) or len(ends) < 2:
        return ends, radii
    across = np.argsort(ends[:, 0, 1], kind="stable")
    beams, thick = [], []
    for port, starboard in pairwise(across.tolist()):
        least = min(radii[port], radii[starboard])
        stern, bow = max(ends[port, 0, 0], ends[starboard, 0, 0]), min(ends[port, 1, 0], ends[starboard, 1, 0])
        for ahead_m in (stern + least, bow - least):
            pair = ends[[port, starboard], 0].copy()
            pair[:, 0] = ahead_m
            pair[:, 1] += [radii[port], -radii[starboard]]
            beams.append(pair)
            thick.append(_BEAM_SHARE * least)
    return np.concatenate([ends, beams]), np.concatenate([radii, thick])


@dataclass(frozen=True, slots=True, eq=False)
class CloseHulls:
    """Hulls that may touch before the next search."""

    hull: Numbers
    """Indices of the hulls, (U,)."""
    first: Numbers
    """First hull of each pair, (Q,), as an index into `hull`."""
    second: Numbers
    """Second hull of each pair, (Q,), as an index into `hull`."""

    def __len__(self) -> int:
        return len(self.first)


NOBODY_CLOSE = CloseHulls(_NO_NUMBERS, _NO_NUMBERS, _NO_NUMBERS)


def find_close_pairs(hulls: Hulls, north_east_m: Array) -> tuple[Numbers, Numbers]:
    """Return (P,), (P,) vessels of M at (M, 2) that may touch before the next search, in the order of their names.

    Pairs of two scripted vessels are omitted.
    """
    one, other = close_pairs(north_east_m, hulls.reach_m + 0.5 * NEAR_M)
    if len(one):
        free = np.isfinite(np.minimum(hulls.mass_kg[one], hulls.mass_kg[other]))
        one, other = one[free], other[free]
    if not len(one):
        return one, other
    turned = hulls.order[one] > hulls.order[other]
    one, other = np.where(turned, other, one), np.where(turned, one, other)
    sequence = np.lexsort((hulls.order[other], hulls.order[one]))
    return one[sequence], other[sequence]


def find_close_hulls(hulls: Hulls, pairs: tuple[Numbers, Numbers], motion: Kinematics) -> CloseHulls:
    """Return the capsules of vessel pairs that are near each other too; `motion` is of M vessels."""
    candidates = [
        (first, second)
        for a, b in zip(pairs[0].tolist(), pairs[1].tolist(), strict=True)
        for first in range(hulls.first_hull[a], hulls.first_hull[a + 1])
        for second in range(hulls.first_hull[b], hulls.first_hull[b + 1])
    ]
    if not candidates:
        return NOBODY_CLOSE
    close = _numbered(np.array(candidates))
    capsules, _ = _capsules(hulls, close, motion, 0.5 * NEAR_M)
    touch = touches(capsules, capsules, close.first, close.second)
    near = np.zeros((len(close.hull), len(close.hull)), bool)
    near[touch.first, touch.second] = True
    chosen = near[close.first, close.second]
    if not chosen.any():
        return NOBODY_CLOSE
    return close if chosen.all() else _numbered(np.array(candidates)[chosen])


def _numbered(pairs: Numbers) -> CloseHulls:
    involved, places = np.unique(pairs, return_inverse=True)
    first, second = places.reshape(-1, 2).T
    return CloseHulls(involved, first, second)


def _capsules(hulls: Hulls, close: CloseHulls, motion: Kinematics, wider_m: float = 0.0) -> tuple[Capsules, Array]:
    """Return the close capsules, and the (U,) down coordinates of their axes' sterns."""
    vessel = hulls.vessel[close.hull]
    ends = hulls.ends_frd_m[close.hull] @ motion.rot_ned_frd[vessel].transpose(0, 2, 1)
    ends += motion.pos_ned_m[vessel][:, None]
    radius = hulls.radius_m[close.hull] + wider_m
    return Capsules(ends[:, 0, :2], ends[:, 1, :2], radius, ("",) * len(vessel)), ends[:, 0, 2]


def close_pairs(north_east_m: Array, reach_m: Array) -> tuple[Numbers, Numbers]:
    """Return (P,), (P,) indices of overlapping discs among M at (M, 2) with radii (M,). A disc at NaN overlaps none."""
    count = len(reach_m)
    if count < 2:
        return _NO_NUMBERS, _NO_NUMBERS
    known = np.isfinite(north_east_m).all(axis=1)
    if not known.all():
        somewhere = np.flatnonzero(known)
        one, other = close_pairs(north_east_m[somewhere], reach_m[somewhere])
        return somewhere[one], somewhere[other]
    # Cells as wide as the largest distance of two overlapping discs, numbered along rows. Partners lie in a cell's row
    # or in the next.
    cell = ((north_east_m - north_east_m.min(axis=0)) / (2.0 * float(reach_m.max()))).astype(np.intp)
    per_row = int(cell[:, 1].max()) + 3
    number = cell[:, 0] * per_row + cell[:, 1]
    sequence = np.argsort(number, kind="stable")
    number = number[sequence]
    here = np.arange(count)
    earlier, later = [], []
    for low, high in (
        (here + 1, np.searchsorted(number, number + 1, "right")),
        (np.searchsorted(number, number + (per_row - 1)), np.searchsorted(number, number + (per_row + 1), "right")),
    ):
        partners = high - low
        ends = np.cumsum(partners)
        if ends[-1]:
            earlier.append(np.repeat(here, partners))
            later.append(np.arange(ends[-1]) + np.repeat(low - ends + partners, partners))
    if not earlier:
        return _NO_NUMBERS, _NO_NUMBERS
    first, second = sequence[np.concatenate(earlier)], sequence[np.concatenate(later)]
    between = north_east_m[first] - north_east_m[second]
    met = np.flatnonzero(np.vecdot(between, between) < (reach_m[first] + reach_m[second]) ** 2)
    return first[met], second[met]


def compute_hull_contacts(hulls: Hulls, close: CloseHulls, motion: Kinematics, dt_s: float) -> Contacts:
    """Return two contacts for each place at which two hulls touch, one for each vessel; `motion` has M vessels."""
    capsules, down_m = _capsules(hulls, close, motion)
    touch = touches(capsules, capsules, close.first, close.second)
    if not len(touch.first):
        return NO_CONTACTS
    vessel = hulls.vessel[close.hull]
    one, other = vessel[touch.first], vessel[touch.second]
    place = np.column_stack([touch.place_ne_m, 0.5 * (down_m[touch.first] + down_m[touch.second])])
    velocity = (velocity_at(motion, one, place) - velocity_at(motion, other, place))[:, :2]
    mass = 1.0 / (1.0 / hulls.mass_kg[one] + 1.0 / hulls.mass_kg[other])
    stiffness = np.maximum(STIFFNESS_NPM, mass * SWING_RADPS**2)
    force_ne = pressed_n(touch.normal_ne, touch.depth_m, velocity, mass, dt_s, stiffness)
    force = np.column_stack([force_ne, np.zeros(len(force_ne))])
    closing = -np.vecdot(velocity, touch.normal_ne)
    impulse = np.sqrt(np.vecdot(force_ne, force_ne)) * dt_s
    return Contacts(
        np.concatenate([one, other]),
        tuple(hulls.names[number] for number in np.concatenate([other, one]).tolist()),
        np.concatenate([place, place]),
        np.concatenate([force, -force]),
        np.concatenate([closing, closing]),
        np.concatenate([impulse, impulse]),
    )
