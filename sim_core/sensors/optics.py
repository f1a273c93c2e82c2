"""Light of a laser at 905 nm through air, fog and the water surface, and rays from above that reach the surface.

The sum of the waves is in single precision about one place and instant, because a frame has some ten thousand rays.
"""

from __future__ import annotations

import math

import numpy as np
from numpy import float32, float64
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.environment import Environment
from sim_core.environment.waves import WaveField
from sim_core.frames import Array32

WAVELENGTH_NM = 905.0
WATER_INDEX = 1.328  # of refraction at 905 nm (Hale and Querry 1973)
FOG_LIDAR_RATIO_SR = 18.0  # extinction over backscatter of water droplets (O'Connor, Illingworth and Hogan 2004)
PULSE_M = 0.75  # targets within one pulse of 5 ns return together
_CLUMPS = 0.1  # clumps per optical depth that are dense enough to look like a target (chosen)


def extinction_per_m(visibility_m: float) -> float:
    """Return the extinction at 905 nm for a visibility at 550 nm: Koschmieder's 3.912 / V, with the wavelength law of
    Kim 2001.
    """
    if math.isinf(visibility_m):
        return 0.0
    km = visibility_m * 1e-3
    exponents = ((50.0, 1.6), (6.0, 1.3), (1.0, 0.16 * km + 0.34), (0.5, km - 0.5), (0.0, 0.0))
    exponent = next(exponent for least_km, exponent in exponents if km > least_km)
    return 3.912 / visibility_m * math.pow(WAVELENGTH_NM / 550.0, -exponent)


def through_surface(cosine: Array32) -> Array32:
    """Return the (n,) share of unpolarised light that passes from air into water (Fresnel), from the cosine of
    incidence.
    """
    cosine = np.clip(cosine, float32(0.0), float32(1.0))
    refracted = np.sqrt(1.0 - (1.0 - cosine * cosine) * float32(WATER_INDEX**-2))
    index = float32(WATER_INDEX)
    across = (cosine - index * refracted) / (cosine + index * refracted)
    along = (index * cosine - refracted) / (index * cosine + refracted)
    passed: Array32 = 1.0 - 0.5 * (across * across + along * along)
    return passed


@dataclass(frozen=True, slots=True)
class Atmosphere:
    """Air of one visibility, inf for clear. It weakens light and, in clumps, returns light itself."""

    visibility_m: float = math.inf

    def __post_init__(self) -> None:
        if not self.visibility_m > 0.0:
            raise ValueError(
                f"environment.visibility_m = {self.visibility_m} must be above zero; leave it out for clear"
            )

    @property
    def extinction_per_m(self) -> float:
        """Extinction of the laser's light, 1/m."""
        return extinction_per_m(self.visibility_m)

    @property
    def reflectivity(self) -> float:
        """Reflectivity of a diffuse target with the same return as the fog within one pulse: pi beta dR."""
        return math.pi * self.extinction_per_m / FOG_LIDAR_RATIO_SR * PULSE_M

    def both_ways(self, range_m: Array32) -> Array32 | float32:
        """Return the (n,) share that remains after range_m and back (Beer-Lambert)."""
        extinction = self.extinction_per_m
        return np.exp(range_m * float32(-2.0 * extinction)) if extinction else float32(1.0)

    def clumps_m(self, count: int, rng: Generator) -> Array32 | None:
        """Return the (count,) distance to the first clump that looks like a target, None in clear air."""
        extinction = self.extinction_per_m
        if not extinction:
            return None
        return rng.standard_exponential(count, dtype=float32) * float32(1.0 / (_CLUMPS * extinction))


_SAMPLES = 8  # along the last metres of a ray that grazes the crests
_TURNS = 2  # steps of Newton's method, the first for a level surface; residuals of a hand's width are dropped later
_GRAZING = 0.02
_TINY = 1e-6
_PIECE = 16_384  # rays times components
_HAIR_M = 0.002


@dataclass(frozen=True, slots=True, eq=False)
class WaterSeen:
    """Down coordinate of the surface: the still level minus the waves of W components."""

    level_down_m: float
    """Down coordinate of the still level."""
    crest_m: float
    """Bound of the waves about the still level."""
    middle_ne_m: Array32
    """Reference position, metres north and east."""
    to_phase: Array32
    """Phases from metres north and east of middle_ne_m, seconds after the reference instant, and 1: (4, W)."""
    amplitude_m: Array32
    """Amplitudes of the cosines, (W,)."""
    to_slope: Array32
    """From the sines to the slope down to north and east, (W, 2)."""

    @classmethod
    def around(cls, environment: Environment, time_s: float, pos_ned_m: NDArray[float64]) -> WaterSeen:
        """Return the water about pos_ned_m (3,) at time_s."""
        level_down_m, waves, middle = -environment.level_m(time_s), environment.waves, pos_ned_m[:2]
        if not isinstance(waves, WaveField):
            none = np.zeros(0, float32)
            return cls(level_down_m, 0.0, middle.astype(float32), none, none, none)
        phase = np.remainder(waves.phase_at(time_s, middle), 2.0 * np.pi)
        to_phase = np.concatenate([waves.wave_vector_radpm.T, -waves.apparent_omega_radps[None], phase[None]])
        return cls(
            level_down_m=level_down_m,
            crest_m=float(np.abs(waves.amplitude_m).sum()),
            middle_ne_m=middle.astype(float32),
            to_phase=to_phase.astype(float32),
            amplitude_m=waves.amplitude_m.astype(float32),
            to_slope=(waves.amplitude_m[:, None] * waves.wave_vector_radpm).astype(float32),
        )

    def down_m(self, place_ned_m: Array32, later_s: Array32) -> Array32:
        """Return the (n,) down coordinate of the surface at (n, 3) places, later_s (n,) after the instant."""
        if not self.crest_m:
            return np.full(len(place_ned_m), self.level_down_m, float32)
        return self._surface(place_ned_m, later_s)[:, 0]

    def _surface(self, place_ned_m: Array32, later_s: Array32, slopes: bool = False) -> Array32:
        """Return the (n, 3) down coordinate of the surface and its slopes down to north and east. `slopes` requests the
        slopes.
        """
        rays, components = len(place_ned_m), self.to_phase.shape[1]
        from_there = np.empty((rays, 4), float32)
        for axis in range(2):  # by columns: numpy is ten times slower for rows of two
            np.subtract(place_ned_m[:, axis], self.middle_ne_m[axis], out=from_there[:, axis])
        from_there[:, 2] = later_s
        from_there[:, 3] = 1.0
        surface = np.empty((rays, 3), float32)
        # In pieces that the allocator keeps: larger ones return to the system and cost a page fault each 4 kB.
        piece = max(_PIECE // components, 1)
        phases, wave = np.empty((2, min(piece, rays), components), float32)
        for start in range(0, rays, piece):
            here = slice(start, min(start + piece, rays))
            phase, part = phases[: here.stop - start], wave[: here.stop - start]
            np.matmul(from_there[here], self.to_phase, out=phase)
            np.matmul(np.cos(phase, out=part), self.amplitude_m, out=surface[here, 0])
            if slopes:
                np.matmul(np.sin(phase, out=part), self.to_slope, out=surface[here, 1:])
        np.subtract(float32(self.level_down_m), surface[:, 0], out=surface[:, 0])
        return surface

    def distance_m(self, origin_ned_m: Array32, direction_ned: Array32, later_s: Array32) -> Array32:
        """Return the (n,) distance along the rays to the still level; inf for rays that do not descend, 0 from under
        water.
        """
        above = float32(self.level_down_m) - origin_ned_m[:, 2]
        down = direction_ned[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance: Array32 = np.where(down > 0.0, above / down, float32(np.inf))
        distance[above <= 0.0] = 0.0
        if self.crest_m and len(among := np.flatnonzero(above < self.crest_m)):
            origin = origin_ned_m[among]
            distance[among[origin[:, 2] > self.down_m(origin, later_s[among])]] = 0.0
        return distance

    def certain_m(self, level_m: Array32, direction_ned: Array32) -> Array32:
        """Return the (n,) distance at which rays are certainly in the water: below the troughs. level_m is their
        `distance_m`.
        """
        if not self.crest_m:
            return level_m
        steepness: Array32 = np.maximum(direction_ned[:, 2], float32(_TINY))
        certain: Array32 = level_m + float32(self.crest_m) / steepness
        return certain

    def hides(
        self, origin_ned_m: Array32, direction_ned: Array32, later_s: Array32, range_m: Array32, level_m: Array32
    ) -> Array32:
        """Return the (n,) distance at which water begins before the hit at range_m (inf for no hit); inf for no water.

        level_m: `distance_m` of these rays. The code follows only rays that end among the waves. For rays that end
        below the waves, it uses the still level.
        """
        hidden: Array32 = np.where(level_m < range_m, level_m, float32(np.inf))
        if not self.crest_m:
            return hidden
        down = direction_ned[:, 2]
        to_crest = self.crest_m / np.maximum(down, float32(_TINY))
        entry, leaving = np.maximum(level_m - to_crest, 0.0), level_m + to_crest
        among = np.flatnonzero((entry < range_m) & (range_m <= leaving))
        if len(among):
            start, end = entry[among], range_m[among]
            steps = np.linspace(0.0, 1.0, _SAMPLES + 1, dtype=float32)
            along = start[:, None] + (end - start)[:, None] * steps
            # Depth under the surface at these samples, negative above it
            places = origin_ned_m[among][:, None] + direction_ned[among][:, None] * along[..., None]
            surface = self.down_m(places.reshape(-1, 3), np.repeat(later_s[among], along.shape[1]))
            depth_m = places[..., 2] - surface.reshape(along.shape)
            # Distance at which the depth becomes positive, between the samples
            under, rows = depth_m > 0.0, np.arange(len(along))
            first = np.argmax(under, axis=1)
            before = np.maximum(first - 1, 0)
            deep, shallow = depth_m[rows, first], -depth_m[rows, before]
            share = np.where(first > 0, shallow / np.maximum(shallow + deep, float32(1e-9)), float32(0.0))
            crossing = along[rows, before] + share * (along[rows, first] - along[rows, before])
            hidden[among] = np.where(under.any(axis=1), crossing, float32(np.inf)).astype(float32)
        return hidden

    def under(
        self, origin_ned_m: Array32, direction_ned: Array32, later_s: Array32, range_m: Array32
    ) -> NDArray[np.bool_]:
        """Return (n,) True for rays that are under the surface at range_m."""
        places = origin_ned_m + direction_ned * range_m[:, None]
        under: NDArray[np.bool_] = places[:, 2] > self.down_m(places, later_s)
        return under

    def met(
        self, origin_ned_m: Array32, direction_ned: Array32, later_s: Array32, range_m: Array32
    ) -> tuple[Array32, Array32]:
        """Return the distance at which n rays into the water reach its surface, and the cosine of incidence there.

        The search starts at range_m. The result is at the surface or slightly above. A ray without a result keeps a
        range under water.
        """
        if not self.crest_m:
            return range_m, direction_ned[:, 2]
        surface_m = range_m.copy()
        sinking: Array32 = np.maximum(direction_ned[:, 2], float32(_GRAZING))
        for turn in range(_TURNS):
            places = origin_ned_m + direction_ned * surface_m[:, None]
            down_m, north, east = self._surface(places, later_s, slopes=turn > 0).T
            if turn:
                across = direction_ned[:, 0] * north + direction_ned[:, 1] * east
                sinking = np.maximum(direction_ned[:, 2] - across, float32(_GRAZING))
            surface_m -= (places[:, 2] - down_m) / sinking
        incidence = sinking / np.sqrt(1.0 + north**2 + east**2)
        return np.maximum(surface_m - float32(_HAIR_M), 0.0), incidence
