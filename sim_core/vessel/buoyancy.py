"""Buoyancy of any number of hulls, strip by strip, on the local surface of the water.

The lift of a strip is the weight of its displaced water, upward. The surface is sampled at each strip. Its slope across
the strip is the slope of the plane fitted to all strips.

Round hulls: pressure on a circular section points at its centre. The lift therefore acts on the hull's axis at any roll
angle, and its amount depends only on the depth of that axis. Along the hull it acts at the centre of buoyancy, taken at
the draft of rest.

Other sections are polygons. The part under the surface is integrated along their edges. d is the depth of a point and g
its gradient in the plane of the section. The divergence of g d / |g|^2 is 1 for d > 0. The area under water is
therefore a sum over edges of integrals of positive d, and its moments are similar sums. The waterline itself adds
nothing.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.environment.waves import FlatWater, HullSurface
from sim_core.frames import Array
from sim_core.keys import SpecificationError
from sim_core.mesh_file import MeshFileError
from sim_core.vessel.sections import HullStrips, cut_strips
from sim_core.vessel.spec import DemiHull, VesselSpec

_TINY = 1e-300
_DEPTHS = 40  # poses of one search, evaluated together


def segment_area_m2(submerged_m: Array, radius_m: Array | float) -> Array:
    """Return the area below the surface of a circle with its lowest point at `submerged_m`; 0 dry, pi r^2 under water.

    r^2 acos((r - h) / r) - (r - h) sqrt(2 r h - h^2)
    """
    cosine = np.clip((radius_m - submerged_m) / radius_m, -1.0, 1.0)
    area: Array = radius_m * radius_m * _unit_segment(cosine)
    return area


def _unit_segment(cosine: Array) -> Array:
    """Return the segment of the unit circle with this cosine of the half angle."""
    area: Array = np.arccos(cosine)
    area -= cosine * np.sqrt(1.0 - cosine * cosine)
    return area


def _lift_wrench() -> Array:
    """Return (4, 3, 6), the wrench of (lift, lift x position) times the direction of the lift."""
    wrench = np.zeros((4, 3, 6))
    wrench[0, (0, 1, 2), (0, 1, 2)] = 1.0
    for i, j, k, sign in ((0, 1, 2, 1), (1, 2, 0, 1), (2, 0, 1, 1), (0, 2, 1, -1), (2, 1, 0, -1), (1, 0, 2, -1)):
        wrench[1 + i, j, 3 + k] = sign  # position x force
    return wrench


@dataclass(frozen=True, slots=True, eq=False)
class RoundHulls:
    """Constants of round hulls in one water, S strips in all."""

    points_frd_m: Array
    """Sampling points of the surface, (S, 3): the middle of each strip's axis."""
    point_share: Array
    """Share of each strip in the displacement at rest, level, (S,)."""
    volume_m3: float
    """Volume of the hulls."""
    level_m: float
    minus_axes_in_radii: Array  # (3, S)
    per_radius: Array  # (S,)
    lift_n: Array  # (S, 4): lift per unit segment, and its moments about the axes
    wrench: Array  # (12, 6)

    @classmethod
    def from_spec(cls, model: VesselSpec, water: Water) -> RoundHulls:
        """Compute the constants from the vessel's hulls and the water."""
        axes, radii, lengths = (
            np.concatenate(column) for column in zip(*map(_round_strips, model.demi_hulls), strict=True)
        )
        newton_per_m3 = water.density_kgpm3 * GRAVITY_MPS2
        hulls = cls(
            points_frd_m=axes,
            point_share=lengths,
            volume_m3=math.pi * float(lengths @ radii**2),
            level_m=water.level_m,
            minus_axes_in_radii=-axes.T / radii,
            per_radius=1.0 / radii,
            lift_n=(newton_per_m3 * lengths * radii**2)[:, None] * np.column_stack([np.ones(len(axes)), axes]),
            wrench=_lift_wrench().reshape(12, 6),
        )
        check_reserve(model, water, hulls.volume_m3)
        submerged = np.clip(upright_depth_m(model, hulls) + axes[:, 2] + radii, 0.0, 2.0 * radii)
        # The segment's centroid is 2/3 (half width)^3 / area below the axis. This is the mean over the displaced
        # volume.
        half_width = np.sqrt(submerged * (2.0 * radii - submerged))
        displaced_m3 = lengths * segment_area_m2(submerged, radii)
        wrench = _lift_wrench()
        wrench[0, 0, 4] = (2.0 / 3.0) * (lengths @ half_width**3) / displaced_m3.sum()
        return replace(hulls, wrench=wrench.reshape(12, 6), point_share=displaced_m3 / displaced_m3.sum())

    def terms(self, pos_ned_m: Array, down_frd: Array, up_frd: Array, surface: HullSurface) -> tuple[Array]:
        """Return the (N, 12) linear terms of the force, for vessels at (N, 3).

        down_frd: (N, 3) vertical in body axes. up_frd: (N, 3) direction of the lift.
        """
        cosine = self._cosine(pos_ned_m, down_frd, surface)
        np.maximum(cosine, -1.0, out=cosine)
        np.minimum(cosine, 1.0, out=cosine)
        lift = _unit_segment(cosine) @ self.lift_n
        return ((lift[:, :, None] * up_frd[:, None, :]).reshape(-1, 12),)

    def immersion(self, pos_ned_m: Array, down_frd: Array, surface: HullSurface) -> tuple[Array, Array]:
        """Return (N,), (N,): the shares of dry strips and of strips with their deck under water."""
        cosine = self._cosine(pos_ned_m, down_frd, surface)
        return (cosine >= 1.0).mean(axis=1), (cosine <= -1.0).mean(axis=1)

    def centre_frd_m(self, pos_ned_m: Array, down_frd: Array, surface: HullSurface) -> Array:
        """Return the (N, 3) centre of buoyancy on level water of vessels that displace any water."""
        cosine = np.clip(self._cosine(pos_ned_m, down_frd, surface), -1.0, 1.0)
        lift_n = _unit_segment(cosine) * self.lift_n[:, 0]
        below = (2.0 / 3.0) * (1.0 - cosine**2) ** 1.5 / self.per_radius / np.maximum(_unit_segment(cosine), _TINY)
        across = down_frd * [0.0, 1.0, 1.0]
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        middles = self.points_frd_m + below[:, :, None] * across[:, None, :]
        centre: Array = np.einsum("ns,nsi->ni", lift_n, middles) / lift_n.sum(axis=1, keepdims=True)
        return centre

    def _cosine(self, pos_ned_m: Array, down_frd: Array, surface: HullSurface) -> Array:
        """Return the (N, S) height of each strip's axis above the surface in radii."""
        cosine: Array = down_frd @ self.minus_axes_in_radii
        cosine -= (surface.point_elevation_m + (pos_ned_m[:, 2:] + (self.level_m + surface.tide_m))) * self.per_radius
        return cosine


def _round_strips(hull: DemiHull) -> tuple[Array, Array, Array]:
    """Return (S, 3) middles of the strips' axes from stern to bow, (S,) their radii and (S,) their lengths."""
    assert hull.section is not None
    assert hull.section.radius_m is not None
    along = hull.length_m * ((np.arange(hull.strips) + 0.5) / hull.strips - 0.5)
    axes = np.column_stack([along, np.zeros(hull.strips), np.full(hull.strips, -hull.section.radius_m)])
    same = np.ones(hull.strips)
    return axes + hull.keel_frd_m, hull.section.radius_m * same, hull.length_m / hull.strips * same


@dataclass(frozen=True, slots=True, eq=False)
class SectionHulls:
    """Constants of hulls of any cross-sections in one water: S strips in all, each a polygon of C corners."""

    points_frd_m: Array
    """Sampling points of the surface, (2 S, 3), on the waterline of the level vessel at rest. They lie to port and
    starboard of each strip's middle, offset by the standard deviation of its breadth.
    """
    point_share: Array
    """Half of each strip's share in the displacement at rest, (2 S,)."""
    volume_m3: float
    """Volume of the hulls."""
    depth: Array  # (4, S (C + 1)): corners below the origin's level, from the vertical and the slope across
    per_edge: Array  # (3 S C, 10): see `from_spec`
    wrench: Array  # (12, 6)
    level_m: float

    @classmethod
    def from_spec(cls, model: VesselSpec, water: Water) -> SectionHulls:
        """Compute the constants from the vessel's hulls and the water."""
        # The strips of all hulls, with as many corners each: the last corner of a section is repeated
        parts = [_cut_hull(number, hull) for number, hull in enumerate(model.demi_hulls)]
        most = max(part.corners_m.shape[1] for part in parts)
        padding = [((0, 0), (0, most - part.corners_m.shape[1]), (0, 0)) for part in parts]
        corners = np.concatenate([np.pad(p.corners_m, pad, "edge") for p, pad in zip(parts, padding, strict=True)])
        along, length_m = (np.concatenate([getattr(part, name) for part in parts]) for name in ("along_m", "length_m"))
        area = np.concatenate([part.area_m2 for part in parts])
        y, z = corners[..., 0], corners[..., 1]
        # Sampling points to port and starboard of the strips' middles
        middle, aside = _breadth(corners, area)
        points = np.stack(
            [np.column_stack([along, middle + side * aside, 0.0 * along]) for side in (-1.0, 1.0)], axis=1
        )
        depth = np.stack([np.broadcast_to(along[:, None], y.shape), y, z, y - middle[:, None]])
        # Rows: integrals of d, of d times the share of the edge, and of d^2 / 2, over the part of each edge under
        # water. Columns: area, its moments about x, y, z, and the integral of d over it; first for the edge's extent
        # across, then down.
        across, down = np.diff(y, axis=1), np.diff(z, axis=1)
        same = np.ones_like(across)
        zero = np.zeros_like(across)
        rows = [
            np.stack([same, along[:, None] * same, y[:, :-1], z[:, :-1], zero], axis=-1) / 2.0,
            np.stack([zero, zero, across, down, zero], axis=-1) / 6.0,
            np.stack([zero, zero, zero, zero, same], axis=-1) / 6.0,
        ]
        weight = (water.density_kgpm3 * GRAVITY_MPS2 * length_m)[:, None, None]
        rows = [weight * np.concatenate([across[..., None] * row, down[..., None] * row], axis=-1) for row in rows]
        hulls = cls(
            points_frd_m=points.reshape(-1, 3),
            point_share=np.repeat(length_m, 2),
            volume_m3=float(length_m @ area),
            depth=depth.reshape(4, -1),
            per_edge=np.concatenate([row.reshape(-1, 10) for row in rows]),
            wrench=_lift_wrench().reshape(12, 6),
            level_m=water.level_m,
        )
        # The waterline of the level vessel at rest
        check_reserve(model, water, hulls.volume_m3)
        depth_m = upright_depth_m(model, hulls)
        wet, start, end = _wet_share(z + depth_m)
        displaced_m3 = length_m * (across * wet * (start + end)).sum(axis=1)
        return replace(
            hulls,
            points_frd_m=hulls.points_frd_m - [0.0, 0.0, depth_m],
            point_share=np.repeat(0.5 * displaced_m3 / displaced_m3.sum(), 2),
        )

    def terms(self, pos_ned_m: Array, down_frd: Array, up_frd: Array, surface: HullSurface) -> tuple[Array]:
        """See `RoundHulls.terms`."""
        lift = self._lift_n(pos_ned_m, down_frd, surface)
        return ((lift[:, :, None] * up_frd[:, None, :]).reshape(-1, 12),)

    def immersion(self, pos_ned_m: Array, down_frd: Array, surface: HullSurface) -> tuple[Array, Array]:
        """See `RoundHulls.immersion`."""
        depth = self._depth_m(pos_ned_m, down_frd, surface)
        return (depth <= 0.0).all(axis=2).mean(axis=1), (depth > 0.0).all(axis=2).mean(axis=1)

    def centre_frd_m(self, pos_ned_m: Array, down_frd: Array, surface: HullSurface) -> Array:
        """See `RoundHulls.centre_frd_m`."""
        lift = self._lift_n(pos_ned_m, down_frd, surface)
        return lift[:, 1:] / lift[:, :1]

    def _lift_n(self, pos_ned_m: Array, down_frd: Array, surface: HullSurface) -> Array:
        """Return the (N, 4) lift and its moments about x, y and z."""
        # Integrals of the depth along the part of each edge under water
        depth = self._depth_m(pos_ned_m, down_frd, surface)
        wet, start, end = _wet_share(depth)
        both = start + end
        edges = np.empty_like(both, shape=(len(depth), 3, *both.shape[1:]))
        np.multiply(wet, both, out=edges[:, 0])
        np.multiply(wet, wet * (start - end) + 3.0 * end, out=edges[:, 1])
        np.multiply(wet, both * both - start * end, out=edges[:, 2])
        sums = edges.reshape(len(depth), -1) @ self.per_edge
        # Area and moments, by the divergence theorem with the field g d / |g|^2
        across, down = down_frd[:, 1:2] + surface.slope_frd[:, 1:2], down_frd[:, 2:3]
        gradient = np.concatenate((across, down), axis=1)
        gradient /= across * across + down * down + _TINY
        moments = gradient[:, 1:] * sums[:, :5] - gradient[:, :1] * sums[:, 5:]
        lift = moments[:, :4]
        lift[:, 2:] -= gradient * moments[:, 4:]
        return lift

    def _depth_m(self, pos_ned_m: Array, down_frd: Array, surface: HullSurface) -> Array:
        """Return the (N, S, C + 1) depth of the corners below the surface."""
        depth = np.concatenate((down_frd, surface.slope_frd[:, 1:2]), axis=1) @ self.depth
        above = surface.point_elevation_m
        at_strip = 0.5 * (above[:, ::2] + above[:, 1::2]) + (pos_ned_m[:, 2:] + (self.level_m + surface.tide_m))
        corners: Array = depth.reshape(*at_strip.shape, -1) + at_strip[:, :, None]
        return corners


def _wet_share(depth_m: Array) -> tuple[Array, Array, Array]:
    """Return the share under water of edges from corner to corner (..., C + 1), and the depths of both ends, 0 above
    water.
    """
    under, size = np.maximum(depth_m, 0.0), np.abs(depth_m)
    start, end = under[..., :-1], under[..., 1:]
    return (start + end) / (size[..., :-1] + size[..., 1:] + _TINY), start, end


def _cut_hull(number: int, hull: DemiHull) -> HullStrips:
    try:
        return cut_strips(hull)
    except SpecificationError as error:
        raise SpecificationError(("hulls", number, *error.path), error.text) from None
    except MeshFileError as error:
        assert hull.mesh is not None
        raise SpecificationError(("hulls", number, "mesh", "file"), f"= {hull.mesh.file} {error}") from error


def _breadth(corners_m: Array, area_m2: Array) -> tuple[Array, Array]:
    """Return (S,), (S,): mean and standard deviation of y over each polygon's area."""
    y, z = corners_m[..., 0], corners_m[..., 1]
    a, b, down = y[:, :-1], y[:, 1:], np.diff(z, axis=1)
    safe = np.where(area_m2 > 0.0, area_m2, 1.0)
    first = -(down * (a * a + a * b + b * b)).sum(axis=1) / 6.0
    second = -(down * (a + b) * (a * a + b * b)).sum(axis=1) / 12.0
    mean = np.where(area_m2 > 0.0, first / safe, y.mean(axis=1))
    return mean, np.sqrt(np.maximum(np.where(area_m2 > 0.0, second / safe, 0.0) - mean * mean, 0.0))


Buoyancy = RoundHulls | SectionHulls


def make_buoyancy(model: VesselSpec, water: Water) -> Buoyancy:
    """Return the buoyancy model that fits the vessel's hulls.

    A single hull in the middle needs its breadth to feel the slope across it.

    Raises:
        SpecificationError: the hulls cannot carry the vessel, or a mesh is not available or differs from its keys.
    """
    hulls = model.demi_hulls
    plain = all(hull.section is not None and hull.section.radius_m is not None and hull.prismatic for hull in hulls)
    beside = len({hull.keel_frd_m[1] for hull in hulls}) > 1
    return (RoundHulls if plain and beside else SectionHulls).from_spec(model, water)


def wave_shares(model: VesselSpec, depth_m: float, wave_number_radpm: Array) -> tuple[Array, Array]:
    """Return (W,), (W,): the shares of waves in deep water that act on the bottoms, and in the displaced volume.

    The pressure of a wave decays with the depth as exp(-k d): the first is its mean over the waterplane, taken along
    the hulls below (Smith 1883), and the second its mean over the volume. depth_m: depth of the body's origin at rest.
    """
    parts = [_cut_hull(number, hull) for number, hull in enumerate(model.demi_hulls)]
    felt, waterplane_m2, volume_m3 = np.zeros(len(wave_number_radpm)), 0.0, 0.0
    k = np.maximum(wave_number_radpm, 1e-9)[:, None, None]
    for part in parts:
        depth = part.corners_m[..., 1] + depth_m
        wet, start, end = _wet_share(depth)
        across = np.diff(part.corners_m[..., 0], axis=1) * wet * part.length_m[:, None]
        # Integral of exp(-k d) along the wet part of each edge
        higher, span = np.minimum(start, end), np.maximum(k * np.abs(end - start), 1e-9)
        felt += (across * np.exp(-k * higher) * -np.expm1(-span) / span).sum(axis=(1, 2))
        waterplane_m2 += float(across.sum())
        volume_m3 += float((across * 0.5 * (start + end)).sum())
    vertical = felt / waterplane_m2
    return vertical, (waterplane_m2 - felt) / (k[:, 0, 0] * volume_m3)


def check_reserve(model: VesselSpec, water: Water, volume_m3: float) -> None:
    """Raises SpecificationError for a vessel that is heavier than the water its submerged hulls displace."""
    carried_kg = water.density_kgpm3 * volume_m3
    if model.mass_kg >= carried_kg:
        count = len(model.demi_hulls)
        carry = {1: "its hull carries", 2: "the two hulls carry"}.get(count, f"the {count} hulls carry")
        larger = "a larger vehicle.hull" if model.hulls_key == "hull" else "larger vehicle.hulls"
        raise SpecificationError(
            ("mass_kg",), f"= {model.mass_kg:g} sinks: {carry} {carried_kg:.4g} kg; use less mass or {larger}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class FlatPoses:
    """N vessels in still water."""

    hulls: Buoyancy
    depth_m: Array
    """Depth of the body's origin, (N,)."""
    down_frd: Array
    """Vertical in body axes, (N, 3)."""

    def wrench(self) -> Array:
        """Return the (N, 6) wrench of the buoyancy in body axes."""
        (terms,) = self.hulls.terms(self._pos_ned_m, self.down_frd, -self.down_frd, self._surface)
        wrench: Array = terms @ self.hulls.wrench
        return wrench

    def centre_frd_m(self) -> Array:
        """Return the (N, 3) centre of buoyancy."""
        return self.hulls.centre_frd_m(self._pos_ned_m, self.down_frd, self._surface)

    @property
    def _pos_ned_m(self) -> Array:
        return np.column_stack([np.zeros((len(self.depth_m), 2)), self.depth_m - self.hulls.level_m])

    @property
    def _surface(self) -> HullSurface:
        level = np.broadcast_to(np.eye(3), (len(self.depth_m), 3, 3))
        return FlatWater().at_hull(self.hulls.points_frd_m).sample(0.0, self._pos_ned_m, level)


def upright_depth_m(model: VesselSpec, hulls: Buoyancy) -> float:
    """Return the depth of the body's origin at which a level vessel displaces its mass."""
    low = -max(hull.keel_frd_m[2] for hull in model.demi_hulls)
    high = -min(hull.keel_frd_m[2] - 2.0 * hull.height_m for hull in model.demi_hulls)
    level = np.tile([0.0, 0.0, 1.0], (_DEPTHS, 1))
    for _ in range(10):  # converges to rounding
        depth_m = np.linspace(low, high, _DEPTHS)
        light = -FlatPoses(hulls, depth_m, level).wrench()[:, 2] < model.mass_kg * GRAVITY_MPS2
        place = int(np.clip(np.count_nonzero(light), 1, _DEPTHS - 1))
        low, high = depth_m[place - 1], depth_m[place]
    return float(0.5 * (low + high))
