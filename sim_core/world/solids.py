"""Solids in closed form, in NED: how far a ray goes before it meets one, and the normal there.

Each has `meet(origin_m, direction) -> (range_m (R,), normal (R, 3))` of rays (R, 3) with unit directions in double
precision: inf and 0 for none. A ray that starts inside meets the far side. Equations: Akenine-Moeller, Haines and
Hoffman, Real-Time Rendering, 4th edition, 22.6 to 22.8.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.world.materials import Material

Array = NDArray[float64]
Meeting: TypeAlias = tuple[Array, Array]
_TINY = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """All points x with normal . x = offset_m; normal a unit vector (3,). Met from either side."""

    normal: Array
    offset_m: float
    material: Material

    def meet(self, origin_m: Array, direction: Array) -> Meeting:
        """See the module."""
        toward = direction @ self.normal
        slanted = np.abs(toward) > _TINY
        range_m = (self.offset_m - origin_m @ self.normal) / np.where(slanted, toward, 1.0)
        return _of(np.where(slanted & (range_m >= 0.0), range_m, np.inf), np.broadcast_to(self.normal, direction.shape))


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """About centre_m (3,)."""

    centre_m: Array
    radius_m: float
    material: Material

    def meet(self, origin_m: Array, direction: Array) -> Meeting:
        """See the module."""
        relative = origin_m - self.centre_m
        half = np.einsum("ij,ij->i", relative, direction)
        inner = half**2 - np.einsum("ij,ij->i", relative, relative) + self.radius_m**2
        range_m = _first(-half, inner)
        return _of(range_m, (relative + _finite(range_m)[:, None] * direction) / self.radius_m)


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """Of size_m (3,) along its own axes, about centre_m (3,); rotation (3, 3): own axes to NED."""

    centre_m: Array
    size_m: Array
    rotation: Array
    material: Material

    def meet(self, origin_m: Array, direction: Array) -> Meeting:
        """Slabs."""
        relative, own = (origin_m - self.centre_m) @ self.rotation, direction @ self.rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = np.stack([(-self.size_m / 2 - relative) / own, (self.size_m / 2 - relative) / own])
        parallel = np.abs(own) <= _TINY
        outside = parallel & (np.abs(relative) > self.size_m / 2)
        entry = np.where(parallel, np.where(outside, np.inf, -np.inf), sides.min(axis=0))
        leave = np.where(parallel, np.where(outside, -np.inf, np.inf), sides.max(axis=0))
        enters, leaves = entry.max(axis=1), leave.min(axis=1)
        inside = enters < 0.0
        hit = (enters <= leaves) & (leaves >= 0.0)
        range_m = np.where(hit, np.where(inside, leaves, enters), np.inf)
        axis = np.where(inside, leave.argmin(axis=1), entry.argmax(axis=1))
        normal = np.zeros_like(own)
        rows = np.arange(len(own))
        normal[rows, axis] = -np.sign(own[rows, axis])
        return _of(range_m, normal @ self.rotation.T)


@dataclass(frozen=True, slots=True, eq=False)
class Cylinder:
    """With flat ends, about centre_m (3,), along the unit vector axis (3,)."""

    centre_m: Array
    axis: Array
    radius_m: float
    length_m: float
    material: Material

    def meet(self, origin_m: Array, direction: Array) -> Meeting:
        """The round side, and the two ends."""
        relative = origin_m - self.centre_m
        along, toward = relative @ self.axis, direction @ self.axis
        across, sideways = relative - along[:, None] * self.axis, direction - toward[:, None] * self.axis
        square = np.einsum("ij,ij->i", sideways, sideways)
        slanted = square > _TINY
        per_square = 1.0 / np.where(slanted, square, 1.0)
        half = np.einsum("ij,ij->i", across, sideways) * per_square
        rest = (np.einsum("ij,ij->i", across, across) - self.radius_m**2) * per_square
        root = np.sqrt(np.maximum(half**2 - rest, 0.0))
        range_m, normal = np.full(len(along), np.inf), np.zeros_like(direction)
        for candidate in (-half - root, -half + root):
            on = slanted & (half**2 >= rest) & (candidate >= 0.0)
            on &= np.abs(along + candidate * toward) <= self.length_m / 2
            nearer = on & (candidate < range_m)
            range_m = np.where(nearer, candidate, range_m)
            side = (across + candidate[:, None] * sideways) / self.radius_m
            normal = np.where(nearer[:, None], side, normal)
        lengthwise = np.abs(toward) > _TINY
        for end in (-1.0, 1.0):
            candidate = (end * self.length_m / 2 - along) / np.where(lengthwise, toward, 1.0)
            place = across + candidate[:, None] * sideways
            on = lengthwise & (candidate >= 0.0) & (np.einsum("ij,ij->i", place, place) <= self.radius_m**2)
            nearer = on & (candidate < range_m)
            range_m = np.where(nearer, candidate, range_m)
            normal = np.where(nearer[:, None], end * self.axis, normal)
        return _of(range_m, normal)


Solid: TypeAlias = Plane | Sphere | Box | Cylinder


def _first(middle: Array, inner: Array) -> Array:
    """The lesser of middle -+ sqrt(inner) that is not behind, inf for none."""
    root = np.sqrt(np.maximum(inner, 0.0))
    nearest = np.where(middle - root >= 0.0, middle - root, middle + root)
    first: Array = np.where((inner >= 0.0) & (nearest >= 0.0), nearest, np.inf)
    return first


def _finite(range_m: Array) -> Array:
    finite: Array = np.where(np.isfinite(range_m), range_m, 0.0)
    return finite


def _of(range_m: Array, normal: Array) -> Meeting:
    return range_m, np.where(np.isfinite(range_m)[:, None], normal, 0.0)
