"""A lidar over turbid water: the rays of one frame, each from the sensor's position at its instant, and their returns.

The range equation uses the manufacturer's figures. The lidar sees a diffuse target of 10 % square to the beam up to
`range_at_10_percent_m`. It sees other targets if reflectivity times cosine of incidence over the square of the range is
as large. The attenuation of air on both ways reduces this signal (Beer-Lambert).
Water returns the light that its silt scatters back, twice through the surface (Fresnel). At grazing angles this is
almost nothing. The lidar sees nothing under the surface.

Two wedge prisms rotate in opposite directions at rates of no simple ratio. They draw a rosette that does not repeat, so
the covered share of the view grows with time (Livox Mid-40/Mid-70 point cloud characteristics). Small deflections of
prisms add as vectors (Risley prisms, Marshall 1999, "Risley prism scan patterns", eq 1).
"""

from __future__ import annotations

import math
from dataclasses import field, replace

import numpy as np
from numpy import float32, int64, uint8
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array, Array32, euler_to_quat, quat_to_matrix
from sim_core.keys import Share, check_values
from sim_core.sensors.optics import Atmosphere, WaterSeen, through_surface
from sim_core.sensors.spec import LidarSpec
from sim_core.world.geometry import MATERIALS
from sim_core.world.rays import NO_BODIES, Bodies, RayCaster

MID_70_TURNS_HZ = (121.567, -77.733)
MID_70_WEDGE_DEG = (17.6, 17.6)


@dataclass(frozen=True, slots=True)
class Rosette:
    """The pattern of a Mid-70 at `points_hz` points per second.

    Directions are in the sensor's axes: forward along the middle of the view, right, down.
    """

    points_hz: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.points_hz) and self.points_hz > 0.0):
            raise ValueError(f"lidar.points_hz = {self.points_hz} must be a positive number")

    @property
    def half_view_rad(self) -> float:
        """Angle from the axis to the rim of the view."""
        return math.radians(sum(MID_70_WEDGE_DEG))

    def directions(self, first: int, count: int) -> Array32:
        """Return (3, count) forward, right and down of unit vectors, for the points first, first + 1, ... since the
        start.

        The deflection to the right and down is d1 (cos a1, sin a1) + d2 (cos a2, sin a2), an angle from the axis.
        """
        # Remove whole turns in double precision: after an hour there are 4e5 of them.
        start_s = first / self.points_hz
        later_s = np.arange(count, dtype=float32) * float32(1.0 / self.points_hz)
        directions = np.zeros((3, count), dtype=float32)
        forward, right, down = directions
        for turns_hz, wedge_deg in zip(MID_70_TURNS_HZ, MID_70_WEDGE_DEG, strict=True):
            angle = later_s * float32(2.0 * math.pi * turns_hz)
            angle += float32(2.0 * math.pi * math.fmod(turns_hz * start_s, 1.0))
            wedge = float32(math.radians(wedge_deg))
            right += wedge * np.cos(angle)
            down += wedge * np.sin(angle)
        off = np.sqrt(right * right + down * down)
        np.maximum(off, float32(1e-9), out=off)
        np.cos(off, out=forward)
        directions[1:] *= np.sin(off) / off
        return directions


@dataclass(frozen=True, slots=True, eq=False)
class BodyTrack:
    """Pose of a body at K >= 2 instants of one frame, from its start to its end.

    Poses between two instants are interpolated linearly. For steps of milliseconds, an interpolated matrix is a
    rotation to 1e-6.
    """

    stamps_ns: NDArray[int64]
    """Instants, (K,)."""
    pos_ned_m: Array
    """Positions, (K, 3)."""
    rot_ned_frd: Array
    """Attitudes, (K, 3, 3)."""

    @property
    def duration_s(self) -> float:
        """Time from the first instant to the last."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9

    def poses(self, later_s: Array) -> tuple[Array, Array]:
        """Return positions (k, 3) and attitudes (k, 3, 3) at later_s (k,) after the start."""
        known_s = (self.stamps_ns - self.stamps_ns[0]) * 1e-9
        leg = np.clip(np.searchsorted(known_s, later_s, side="right") - 1, 0, len(known_s) - 2)
        share = ((later_s - known_s[leg]) / (known_s[leg + 1] - known_s[leg]))[:, None]
        place = (1.0 - share) * self.pos_ned_m[leg] + share * self.pos_ned_m[leg + 1]
        share = share[:, None]
        return place, (1.0 - share) * self.rot_ned_frd[leg] + share * self.rot_ned_frd[leg + 1]


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """n rays."""

    origin_ned_m: Array32
    """Origins, (n, 3)."""
    direction_ned: Array32
    """Unit directions, (n, 3)."""
    later_s: Array32
    """Times after the start of the frame, (n,)."""

    def select(self, rows: NDArray[np.intp]) -> Rays:
        """Return the rays of some rows."""
        return Rays(self.origin_ned_m.take(rows, 0), self.direction_ned.take(rows, 0), self.later_s[rows])


def make_rays(
    track: BodyTrack, position_frd_m: Array, rot_frd_sensor: Array, looking: Array32, first_s: float, interval_s: float
) -> Rays:
    """Return rays along looking (3, n), in the axes of a sensor at (3,), rotated by (3, 3), on the track.

    The first ray leaves first_s after the start of the track, and each other ray interval_s later. Blocks of rays span
    about one step of the track. In a block, the pose changes linearly between the ends, which needs two products of
    matrices.
    """
    count = looking.shape[1]
    size = min(max(round(track.duration_s / (len(track.stamps_ns) - 1) / interval_s), 1), max(count, 1))
    blocks = -(-count // size)
    place, turned = track.poses(first_s + np.arange(blocks + 1) * (size * interval_s))
    place = place + turned @ position_frd_m
    turned = turned @ rot_frd_sensor
    share = np.arange(size, dtype=float32) / float32(size)
    both = np.zeros((2, 3, blocks * size), float32)
    both[0, :, :count] = looking
    np.multiply(both[0].reshape(3, blocks, size), share, out=both[1].reshape(3, blocks, size))
    along = np.concatenate([turned[:-1], np.diff(turned, axis=0)], axis=2).astype(float32)
    direction = both.reshape(6, blocks, size).transpose(1, 2, 0) @ along.transpose(0, 2, 1)
    ends = np.stack([place[:-1], np.diff(place, axis=0)], axis=1).astype(float32)
    fractions: Array32 = np.column_stack([np.ones_like(share), share])
    origin = fractions @ ends
    later_s = np.arange(count, dtype=float32) * float32(interval_s) + float32(first_s)
    return Rays(origin.reshape(-1, 3)[:count], direction.reshape(-1, 3)[:count], later_s)


Mask = NDArray[np.bool_]

FULL_SCALE = 150.0  # intensity of a diffuse target of 100 % (Livox Mid-70 user manual, "Reflectivity")
_FLICKER = 0.1  # deviation of the logarithm of a target's return: 5 % in range
_GLITTER = 0.5  # the same for returns from water, due to ripples below the shortest wave component
_STEEPER = 0.15  # possible increase of the cosine of incidence by waves, for rays worth following
_SPRAY_M = 1.5  # mean range of droplets
_SPRAY_REFLECTIVITY = 0.05
_REFLECTIVITY = np.array([material.reflectivity for material in MATERIALS], float32)


@dataclass(frozen=True, slots=True)
class PointFates:
    """Numbers of points of a frame by outcome."""

    fired: int = 0
    """All fired points."""
    returned: int = 0
    """Returned points, including returns from fog, spray and water."""
    nothing: int = 0
    """Nothing in the way."""
    weak: int = 0
    """Too weak a return."""
    near: int = 0
    """In the blind zone."""
    water: int = 0
    """Lost in the water."""
    dropped: int = 0
    """Lost at random."""
    from_water: int = 0
    """Returned by water."""
    from_spray: int = 0
    """Returned by spray."""
    from_fog: int = 0
    """Returned by fog."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarScan:
    """The n returns of a frame."""

    stamp_ns: int
    points_frd_m: Array32
    """Positions in body axes, (n, 3), each at its own instant."""
    offset_s: Array32
    """Times after stamp_ns, (n,)."""
    intensity: NDArray[uint8]
    """Intensities, (n,): 150 for a diffuse target of 100 %."""
    fates: PointFates


@dataclass(frozen=True, slots=True)
class Lidar:
    """A lidar of a specification."""

    spec: LidarSpec
    water_reflectivity: Share = 0.05
    """Share of the light in the water that silt scatters back."""
    air: Atmosphere = field(default_factory=Atmosphere)
    _position: Array = field(init=False, repr=False, compare=False)
    _mount: Array = field(init=False, repr=False, compare=False)
    _rosette: Rosette = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_values(self)
        turned = np.radians([self.spec.roll_deg, self.spec.pitch_deg, self.spec.yaw_deg])
        object.__setattr__(self, "_position", np.array(self.spec.position_frd_m))
        object.__setattr__(self, "_mount", quat_to_matrix(euler_to_quat(turned)))
        object.__setattr__(self, "_rosette", Rosette(self.spec.points_hz))

    def scan(
        self,
        track: BodyTrack,
        caster: RayCaster,
        water: WaterSeen,
        rng: Generator,
        bodies: Bodies = NO_BODIES,
    ) -> LidarScan:
        """Scan all points from the first instant of the track up to its last. Water and bodies are at the first
        instant.
        """
        # Rays of the frame
        start_ns, end_ns = int(track.stamps_ns[0]), int(track.stamps_ns[-1])
        interval_s = 1.0 / self._rosette.points_hz
        first = math.ceil(start_ns * 1e-9 / interval_s - 1e-6)
        count = math.ceil(end_ns * 1e-9 / interval_s - 1e-6) - first
        first_s = max(first * interval_s - start_ns * 1e-9, 0.0)
        looking = self._rosette.directions(first, count)
        rays = make_rays(track, self._position, self._mount, looking, first_s, interval_s)
        # Their ends, in clear air and then in fog and spray
        ends = self._in_the_air(self._targets(rays, caster, bodies, water, rng), rng)

        # Returns within the limits of range and signal, and their noisy ranges
        near, far = ends.range_m < self.spec.min_range_m, ends.range_m > self.spec.max_range_m
        within = ends.seen & ~near & ~far
        dropped = np.zeros(count, np.bool_)
        if self.spec.drop_share:
            dropped = within & (rng.random(count, dtype=float32) < self.spec.drop_share)
        returned, measured_m, drowned = self._measured(rays, ends, np.flatnonzero(within & ~dropped), water, rng)
        nearer = measured_m < self.spec.min_range_m  # the device knows only the measured range
        if nearer.any():
            returned, measured_m = returned[~nearer], measured_m[~nearer]

        # Points in body axes, and their intensity
        points = self._mount.astype(float32) @ looking[:, returned]
        points *= measured_m
        points += self._position.astype(float32)[:, None]
        strength = ends.albedo[returned] * (FULL_SCALE * self.air.both_ways(measured_m)) * ends.flicker[returned]
        intensity = np.rint(np.minimum(strength, float32(255.0))).astype(uint8)

        # Outcomes of all points
        nothing = np.isinf(ends.range_m)
        swallowed = ends.wet & ~(within | near)
        fates = PointFates(
            fired=count,
            returned=len(returned),
            nothing=_count(nothing),
            near=_count(near) + _count(nearer),
            water=_count(swallowed) + drowned,
            weak=_count(~(within | near | swallowed | nothing)),
            dropped=_count(dropped),
            from_water=_count(ends.wet[returned]),
            from_fog=_count(ends.fog[returned]),
            from_spray=_count(ends.spray[returned]),
        )
        return LidarScan(start_ns, np.ascontiguousarray(points.T), rays.later_s[returned], intensity, fates)

    def _targets(self, rays: Rays, caster: RayCaster, bodies: Bodies, water: WaterSeen, rng: Generator) -> _Ends:
        """Return the target of each ray in clear air."""
        # The nearer of the first solid hit and the water
        origin, direction, later_s = rays.origin_ned_m, rays.direction_ned, rays.later_s
        still_m = water.distance_m(origin, direction, later_s)
        reach_m = np.minimum(water.certain_m(still_m, direction), float32(self.spec.max_range_m))
        hits = caster.cast(origin, direction, bodies, later_s if bodies.meshes else None, reach_m)
        water_m = water.hides(origin, direction, later_s, hits.range_m, still_m)
        wet = water_m < hits.range_m
        range_m = np.minimum(water_m, hits.range_m)
        # Albedo of the solid targets toward the sensor
        albedo = np.zeros(len(range_m), float32)
        solid = np.flatnonzero(~wet & (hits.material >= 0))
        cosine = np.einsum("ni,ni->n", direction.take(solid, 0), hits.normal_ned.take(solid, 0))
        albedo[solid] = _REFLECTIVITY[hits.material[solid]] * np.abs(cosine)
        # Scintillation
        flicker = rng.standard_normal(len(range_m), dtype=float32)
        flicker *= np.where(wet, float32(_GLITTER), float32(_FLICKER))
        np.exp(flicker, out=flicker)
        # Albedo of the water, and the range of its waves, only for rays whose return can be strong enough
        steepest = direction[:, 2] + float32(_STEEPER if water.crest_m else 0.0)
        bound = self._signal(steepest * float32(self.water_reflectivity), range_m) * flicker
        bright = np.flatnonzero(wet & (bound > 1.0) & (range_m > 0.0))
        some = rays.select(bright)
        met_m, cosine = water.met(some.origin_ned_m, some.direction_ned, some.later_s, range_m[bright])
        range_m[bright] = met_m
        albedo[bright] = float32(self.water_reflectivity) * cosine * through_surface(cosine) ** 2
        seen = self._signal(albedo, range_m) * flicker > 1.0
        none = np.zeros(len(range_m), np.bool_)
        return _Ends(range_m, albedo, flicker, still_m, wet, seen, none, none)

    def _signal(self, albedo: Array32, range_m: Array32) -> Array32:
        """Return the (n,) signal, relative to the weakest signal that the lidar detects."""
        farthest = albedo * float32(self.spec.range_at_10_percent_m**2 / 0.1)
        signal: Array32 = farthest / np.maximum(range_m * range_m, float32(1e-6)) * self.air.both_ways(range_m)
        return signal

    def _in_the_air(self, ends: _Ends, rng: Generator) -> _Ends:
        """Return the ends with the rays that fog or spray returns before their targets."""
        count = len(ends.range_m)
        clump_m = self.air.clumps_m(count, rng)
        if clump_m is not None:
            thick = np.full(count, self.air.reflectivity, float32)
            fog = (clump_m < ends.range_m) & (self._signal(thick, clump_m) > 1.0)
            ends = replace(ends.cut(fog, clump_m, self.air.reflectivity), fog=fog)
        if self.spec.spray_share:
            drop_m = rng.standard_exponential(count, dtype=float32) * float32(_SPRAY_M)
            spray = (rng.random(count, dtype=float32) < self.spec.spray_share) & (drop_m < ends.range_m)
            ends = replace(ends.cut(spray, drop_m, _SPRAY_REFLECTIVITY), fog=ends.fog & ~spray, spray=spray)
        return ends

    def _measured(
        self, rays: Rays, ends: _Ends, rows: NDArray[np.intp], water: WaterSeen, rng: Generator
    ) -> tuple[NDArray[np.intp], Array32, int]:
        """Return the rays of `rows` above the water, their noisy ranges, and the number of rays not above it.

        If noise puts a return under water, the noise is removed.
        """
        range_m = ends.range_m[rows]
        measured_m = range_m + rng.standard_normal(len(rows), dtype=float32) * float32(self.spec.range_noise_m)
        np.maximum(measured_m, float32(0.0), out=measured_m)
        if not water.crest_m:
            return rows, np.minimum(measured_m, ends.still_m[rows]), 0
        down_m = rays.origin_ned_m[:, 2][rows] + rays.direction_ned[:, 2][rows] * measured_m
        low = np.flatnonzero(down_m > water.level_down_m - water.crest_m)
        low = low[_under(water, rays.select(rows[low]), measured_m[low])]
        measured_m[low] = np.minimum(measured_m[low], range_m[low])
        drowned = low[_under(water, rays.select(rows[low]), measured_m[low])]
        return np.delete(rows, drowned), np.delete(measured_m, drowned), len(drowned)


@dataclass(frozen=True, slots=True, eq=False)
class _Ends:
    """Ends of n rays, (n,) each."""

    range_m: Array32
    """Range, inf for nothing."""
    albedo: Array32
    """Albedo toward the sensor."""
    flicker: Array32
    """Scintillation of the return."""
    still_m: Array32
    """Range of the still water."""
    wet: Mask
    """The end is water."""
    seen: Mask
    """The return is strong enough."""
    fog: Mask
    """The ray ends in fog."""
    spray: Mask
    """The ray ends in spray."""

    def cut(self, rows: Mask, range_m: Array32, albedo: float) -> _Ends:
        """Return the ends with some rays cut at range_m (n,) by something of one albedo, and seen."""
        return replace(
            self,
            range_m=np.where(rows, range_m, self.range_m),
            albedo=np.where(rows, float32(albedo), self.albedo),
            wet=self.wet & ~rows,
            seen=self.seen | rows,
        )


def _under(water: WaterSeen, rays: Rays, range_m: Array32) -> Mask:
    return water.under(rays.origin_ned_m, rays.direction_ned, rays.later_s, range_m)


def _count(mask: Mask) -> int:
    return int(np.count_nonzero(mask))
