"""The sea surface: wave spectra, FlatWater and WaveField, and the waves at a hull.

`direction_deg` is the direction that the waves travel to, clockwise from north. Linear (Airy) theory at the surface,
for component i:
theta_i = k_i . x - (omega_i + k_i . U) t + phase_i, with elevation `a cos theta`, up positive. omega_i is the frequency
in the moving water. It follows from k_i by the dispersion relation of still water. The mean current U carries the
pattern past a fixed position (Peregrine 1976; the Doppler term).
Spectra are one-sided densities S(omega) in m^2 s/rad of the angular frequency in rad/s; the integral over omega is Hs^2
/ 16.

A hull of S points and a sea of W components need N S W cosines a step. The code reduces the phase at each vessel's
origin to one turn. The phase difference of a hull point is a few radians. It is one product of the attitude with a
constant matrix. Points that lie one equal step from another point need no cosine: theorems of addition give theirs from
those of the other point and of the step. This takes a third of the time for hulls with equally long strips.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field, replace
from functools import lru_cache
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy import intp
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import GRAVITY_MPS2, Water, WaveSpec, WaveWall
from sim_core.frames import Array, ComplexArray
from sim_core.state_class import state_class

LOWEST_OF_PEAK = 0.5  # lower limit of the band, in units of the peak frequency; the energy outside moves into the band
HIGHEST_OF_PEAK = 3.0


@dataclass(frozen=True, slots=True)
class FlatWater:
    """No waves."""

    def elevation_m(self, time_s: float, pos_ne_m: Array) -> Array:
        """Return zeros (...,) at (..., 2) positions."""
        return np.zeros(np.shape(pos_ne_m)[:-1])

    def shear_drift_ne_mps(self, draft_m: float) -> Array:
        """Return zeros (2,)."""
        return np.zeros(2)

    def at_hull(self, points_frd_m: Array, share: Array | None = None, felt: FeltWaves | None = None) -> StillHull:
        """Return a sampler for a hull of (S, 3) points."""
        return StillHull(len(points_frd_m))


FLAT_WATER = FlatWater()


@dataclass(frozen=True, slots=True, eq=False)
class FeltWaves:
    """How a hull of S points feels the W components of a sea."""

    vertical: Array
    """Share of the elevation, and of the vertical motion, that acts on the bottoms of the hulls, (W,)."""
    horizontal: Array
    """Share of the slope, and of the horizontal motion, as a mean over the displaced volume, (W,)."""
    sources: ComplexArray | None = None
    """Force of a panel code less that of the strips, per metre of amplitude, (W, S + E, 6), complex, about the phase at
    each point and at E more points; None without a panel code.
    """
    more_points_frd_m: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(E, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class WaveField:
    """A realised sea of W components, the same for every vessel."""

    amplitude_m: Array
    """Amplitudes, (W,)."""
    omega_radps: Array
    """Angular frequencies in the moving water, (W,)."""
    wave_vector_radpm: Array
    """Wave vectors, (W, 2) north and east."""
    phase_rad: Array
    """Phases at the NED origin at time 0, (W,)."""
    current_ne_mps: Array = field(default_factory=lambda: np.zeros(2))
    """Current that carries the pattern: (2,), or (W, 2) with a row for each component."""
    mirror_ne: Array | None = None
    """Normal of the wall whose images the components are, (W, 2), 0 for other components; None for no wall."""

    @property
    def apparent_omega_radps(self) -> Array:
        """Return the (W,) frequency at a fixed position, omega + k . U. It is negative if the current carries crests
        back.
        """
        current = self.current_ne_mps
        carried = self.wave_vector_radpm @ current if current.ndim == 1 else np.vecdot(self.wave_vector_radpm, current)
        apparent: Array = self.omega_radps + carried
        return apparent

    def carried_on(self, current_ne_mps: Array, time_s: float) -> WaveField:
        """Return the same pattern at time_s, carried from then on by another current (2,)."""
        if self.mirror_ne is not None:
            current_ne_mps = _mirrored(current_ne_mps, self.mirror_ne)
        moved_m = (self.current_ne_mps - current_ne_mps) * time_s
        phase_rad = self.phase_rad - np.vecdot(self.wave_vector_radpm, moved_m)
        return replace(self, phase_rad=phase_rad, current_ne_mps=current_ne_mps)

    def phase_at(self, time_s: float, pos_ne_m: Array) -> Array:
        """Return theta, (..., W) in rad, at (..., 2) positions."""
        phase: Array = pos_ne_m @ self.wave_vector_radpm.T - self.apparent_omega_radps * time_s + self.phase_rad
        return phase

    def elevation_m(self, time_s: float, pos_ne_m: Array) -> Array:
        """Return the (...,) elevation of the surface above the still level, up positive, at (..., 2) positions."""
        elevation: Array = np.cos(self.phase_at(time_s, pos_ne_m)) @ self.amplitude_m
        return elevation

    def slope(self, time_s: float, pos_ne_m: Array) -> Array:
        """Return the (..., 2) derivative of the elevation to north and east."""
        slope: Array = np.sin(self.phase_at(time_s, pos_ne_m)) @ (-self.amplitude_m[:, None] * self.wave_vector_radpm)
        return slope

    def orbital_velocity_ned_mps(self, time_s: float, pos_ne_m: Array) -> Array:
        """Return the (..., 3) velocity of the water at the surface: a omega coth(k d) along the wave, and its rise."""
        phase = self.phase_at(time_s, pos_ne_m)
        horizontal = np.cos(phase) @ self.drift_mps
        rise = np.sin(phase) @ (self.amplitude_m * self.omega_radps)
        return np.concatenate([horizontal, -rise[..., None]], axis=-1)

    @property
    def drift_mps(self) -> Array:
        """Return the (W, 2) amplitude of the horizontal orbital velocity: a g k / omega = a omega coth(k d)."""
        drift: Array = (GRAVITY_MPS2 * self.amplitude_m / self.omega_radps)[:, None] * self.wave_vector_radpm
        return drift

    def at_hull(self, points_frd_m: Array, share: Array | None = None, felt: FeltWaves | None = None) -> HullWaves:
        """Return a sampler for a hull of (S, 3) points. share: (S,) weight of each point in means, None for equal
        weights. felt: None for the waves at the surface.
        """
        return HullWaves.bind(self, points_frd_m, share, felt)

    def shear_drift_ne_mps(self, draft_m: float) -> Array:
        """Return the (2,) part of the Stokes drift that the growth of the orbital velocity with height causes.

        It is the mean over a draft: half of omega k a^2 in deep water, times exp(2 k z) averaged over the draft. The
        other half of the Stokes drift results from the horizontal motion along the wave. A body that the water carries
        has that half automatically.
        """
        wave_number = np.hypot(*self.wave_vector_radpm.T)
        depth = np.maximum(2.0 * wave_number * draft_m, 1e-9)
        drift: Array = (
            0.5 * self.amplitude_m**2 * self.omega_radps * -np.expm1(-depth) / depth
        ) @ self.wave_vector_radpm
        return drift


def realise_waves(
    spec: WaveSpec, water: Water, rng: Generator, current_ne_mps: tuple[float, float] = (0.0, 0.0)
) -> WaveField | FlatWater:
    """Return the sea of a specification with random phases, carried by a current, or flat water without waves.

    A random sea has one component per band, at a random frequency in the band, with the energy of the band. Bands of
    equal ratio and off-centre frequencies leave no common period; the amplitudes sum to Hs exactly.
    """
    if spec.spectrum == "none" or not spec.significant_height_m:
        return FlatWater()
    sea = _open_sea(spec, water, rng, current_ne_mps)
    return sea if spec.wall is None else reflected(sea, spec.wall)


def reflected(sea: WaveField, wall: WaveWall) -> WaveField:
    """Return a sea with the images of its components in an upright wall.

    At x, the image of theta is theta at the mirror image of x. The water then does not move through a wall that
    reflects all. An image is carried by the image of the current, so it has the frequency of its component everywhere.
    Components that leave the wall have no image.
    """
    heading_rad = math.radians(wall.heading_deg)
    into_wall = np.array([-math.sin(heading_rad), math.cos(heading_rad)])
    approach = sea.wave_vector_radpm @ into_wall
    meets = approach > 0.0
    into = np.broadcast_to(into_wall, sea.wave_vector_radpm.shape)
    image = WaveField(
        wall.reflection * sea.amplitude_m,
        sea.omega_radps,
        _mirrored(sea.wave_vector_radpm, into),
        sea.phase_rad + 2.0 * float(np.dot(wall.through_ne_m, into_wall)) * approach,
    )
    mirror_ne = np.concatenate([np.zeros_like(into), into[meets]])
    return WaveField(
        np.concatenate([sea.amplitude_m, image.amplitude_m[meets]]),
        np.concatenate([sea.omega_radps, image.omega_radps[meets]]),
        np.concatenate([sea.wave_vector_radpm, image.wave_vector_radpm[meets]]),
        np.concatenate([sea.phase_rad, image.phase_rad[meets]]),
        _mirrored(sea.current_ne_mps, mirror_ne),
        mirror_ne,
    )


def _mirrored(vector_ne: Array, normal_ne: Array) -> Array:
    """Return the (W, 2) images of vectors, (W, 2) or (2,), in walls with these (W, 2) normals of length 1 or 0."""
    image: Array = vector_ne - 2.0 * (vector_ne * normal_ne).sum(axis=-1, keepdims=True) * normal_ne
    return image


def _open_sea(spec: WaveSpec, water: Water, rng: Generator, current_ne_mps: tuple[float, float]) -> WaveField:
    direction_rad = math.radians(spec.direction_deg)
    if spec.spectrum == "regular":
        omega = np.array([2.0 * np.pi / spec.peak_period_s])
        return _field(
            np.array([0.5 * spec.significant_height_m]), omega, np.array([direction_rad]), water, rng, current_ne_mps
        )
    density = wave_density(spec.spectrum, spec.significant_height_m, spec.peak_period_s, spec.gamma)
    peak_radps = 2.0 * np.pi / spec.peak_period_s
    edges = peak_radps * np.geomspace(LOWEST_OF_PEAK, HIGHEST_OF_PEAK, spec.components + 1)
    fine = np.geomspace(edges[:-1], edges[1:], 33, axis=1)
    variance = np.trapezoid(density(fine), fine, axis=1)
    variance = variance * (spec.significant_height_m**2 / 16.0 / variance.sum())
    omega = rng.uniform(edges[:-1], edges[1:])
    course = np.full(spec.components, direction_rad)
    if spec.spreading is not None:
        course = course + rng.permutation(spreading_quantiles(spec.spreading, spec.components))
    return _field(np.sqrt(2.0 * variance), omega, course, water, rng, current_ne_mps)


def _field(
    amplitude_m: Array,
    omega_radps: Array,
    course_rad: Array,
    water: Water,
    rng: Generator,
    current_ne_mps: tuple[float, float],
) -> WaveField:
    heading = np.stack([np.cos(course_rad), np.sin(course_rad)], axis=1)
    wave_vector = wave_number(omega_radps, water.depth_m)[:, None] * heading
    phase = rng.uniform(0.0, 2.0 * np.pi, len(omega_radps))
    return WaveField(amplitude_m, omega_radps, wave_vector, phase, np.array(current_ne_mps))


def pierson_moskowitz(omega_radps: Array, significant_height_m: float, peak_period_s: float) -> Array:
    """Pierson-Moskowitz density from significant height and peak: 5/16 Hs^2 wp^4 w^-5 exp(-1.25 (wp/w)^4)."""
    peak_radps = 2.0 * np.pi / peak_period_s
    density: Array = (
        (5.0 / 16.0)
        * significant_height_m**2
        * peak_radps**4
        / omega_radps**5
        * np.exp(-1.25 * (peak_radps / omega_radps) ** 4)
    )
    return density


def jonswap(omega_radps: Array, significant_height_m: float, peak_period_s: float, gamma: float = 3.3) -> Array:
    """JONSWAP density, numerically normalised to Hs. DNV-RP-C205 3.5.5 has an approximate factor instead."""

    def shape(omega: Array) -> Array:
        peak_radps = 2.0 * np.pi / peak_period_s
        width = np.where(omega <= peak_radps, 0.07, 0.09)
        peak = gamma ** np.exp(-0.5 * ((omega - peak_radps) / (width * peak_radps)) ** 2)
        peaked: Array = pierson_moskowitz(omega, significant_height_m, peak_period_s) * peak
        return peaked

    grid = (2.0 * np.pi / peak_period_s) * np.geomspace(0.2, 50.0, 8001)
    density: Array = shape(omega_radps) * (significant_height_m**2 / 16.0 / np.trapezoid(shape(grid), grid))
    return density


def wave_density(
    name: str, significant_height_m: float, peak_period_s: float, gamma: float
) -> Callable[[Array], Array]:
    """Return the density function S(omega) of a named spectrum."""
    if name == "pierson-moskowitz":
        return lambda omega: pierson_moskowitz(omega, significant_height_m, peak_period_s)
    if name == "jonswap":
        return lambda omega: jonswap(omega, significant_height_m, peak_period_s, gamma)
    raise ValueError(f"waves.spectrum = {name!r} is not known; use one of pierson-moskowitz, jonswap")


def wave_number(omega_radps: Array, depth_m: float) -> Array:
    """Return the root k of omega^2 = g k tanh(k d), in rad/m. Newton's method starts from Eckart (1952)."""
    alpha = omega_radps**2 * depth_m / GRAVITY_MPS2
    kd = alpha / np.sqrt(np.tanh(alpha))
    for _ in range(8):  # quadratic convergence from a start within 5 %: 4 steps reach rounding, 4 more are margin
        tanh = np.tanh(kd)
        kd = kd - (kd * tanh - alpha) / (tanh + kd * (1.0 - tanh * tanh))
    k: Array = kd / depth_m
    return k


def spreading_quantiles(spreading: float, count: int) -> Array:
    """Return `count` angles in rad, symmetric about 0, that divide cos^2s(angle / 2) on (-pi, pi) into equal parts."""
    angle = np.linspace(-np.pi, np.pi, 20001)
    density = np.cos(0.5 * angle) ** (2.0 * spreading)
    cumulative = np.concatenate(([0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))))
    return np.interp((np.arange(count) + 0.5) / count, cumulative / cumulative[-1], angle)


@state_class
class HullSurface:
    """The surface at N hulls of S points. Velocities of the water exclude its current."""

    point_elevation_m: Array
    """Elevation above the still level, (N, S), up positive, as the bottoms of the hulls feel it."""
    over_hull: Array
    """Means over the points of each hull, (N, 15), or (N, 21) with forces of a panel code. The properties below are its
    parts.
    """
    tide_m: float = 0.0
    """Height of the still level above its mean."""

    @property
    def orbital_ned_mps(self) -> Array:
        """Return the (N, 3) velocity of the water."""
        return self.over_hull[:, :3]

    @property
    def gradient_ned(self) -> Array:
        """Return the (N, 3) rise of the surface per metre to north and east; the third is 0."""
        return self.over_hull[:, 3:6]

    @property
    def turn_frd_radps(self) -> Array:
        """Return the (N, 3) roll and pitch rate of the plane fitted to the vertical velocities; the third is 0."""
        return self.over_hull[:, 6:9]

    @property
    def turn_radps2(self) -> Array:
        """Return the (N, 2) acceleration of that plane in roll and pitch."""
        return self.over_hull[:, 9:11]

    @property
    def rise_mps2(self) -> Array:
        """Return the (N, 1) vertical acceleration of the surface, up positive."""
        return self.over_hull[:, 11:12]

    @property
    def slope_frd(self) -> Array:
        """Return the (N, 3) rise per metre forward and right of the plane fitted to the elevations; the third is 0."""
        return self.over_hull[:, 12:15]

    @property
    def panel_wrench_frd(self) -> Array:
        """Return the (N, 6) force and moment of a panel code less those of the strips."""
        return self.over_hull[:, 15:]


@dataclass(frozen=True, slots=True)
class StillHull:
    """Sampler of flat water for hulls of `points` points."""

    points: int

    def sample(self, time_s: float, pos_ned_m: Array, rot_ned_frd: Array) -> HullSurface:
        """Return zeros."""
        return HullSurface(np.zeros((len(pos_ned_m), self.points)), np.zeros((len(pos_ned_m), 15)))


_BLOCK = 128  # vessels per block: the block's arrays stay in the processor's cache


class Rung(NamedTuple):
    """Points that follow from those of the rung before: each is one step from another point."""

    points: list[int]
    """Numbers of the points."""
    bases: list[int]
    """For each point, the index of the other point in the rung before."""
    steps: list[int]
    """For each point, the index of its step."""


_EQUAL_DECIMALS = 10  # of steps in metres


def ladder(places_m: Array) -> tuple[tuple[Rung, ...], Array]:
    """Return points (P, 3) in rungs, and the steps (T, 3) between them. The points of the first rung have no step.

    A step is worth its own cosines when it leads to two points or more.
    """
    return _ladder(tuple(map(tuple, places_m.tolist())))


@lru_cache(maxsize=8)  # the response of a hull needs that of its points for each frequency
def _ladder(places: tuple[tuple[float, ...], ...]) -> tuple[tuple[Rung, ...], Array]:
    places_m = np.array(places).reshape(-1, 3)
    differences = np.round(places_m[None] - places_m[:, None], _EQUAL_DECIMALS).tolist()  # [base][point]
    pairs: dict[tuple[float, ...], dict[int, int]] = {}  # for each difference, the point that it leads to, and from
    for base, point in permutations(range(len(places)), 2):
        difference = tuple(differences[base][point])
        if difference > (0.0, 0.0, 0.0):
            pairs.setdefault(difference, {})[point] = base
    bases: dict[int, int] = {}
    step_to: dict[int, int] = {}
    steps: list[Array] = []
    while pairs:
        led = max(pairs.values(), key=lambda led: len(led.keys() - bases.keys()))
        new = led.keys() - bases.keys()
        if len(new) < 2:
            break
        point, base = next(iter(led.items()))
        bases |= {point: led[point] for point in new}
        step_to |= dict.fromkeys(new, len(steps))
        steps.append(places_m[point] - places_m[base])
    rung = [point for point in range(len(places_m)) if point not in bases]
    rungs = [Rung(rung, [], [])]
    while rung := [point for point in bases if bases[point] in rungs[-1].points]:
        rungs.append(
            Rung(rung, [rungs[-1].points.index(bases[point]) for point in rung], [step_to[point] for point in rung])
        )
    return tuple(rungs), np.array(steps).reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class HullWaves:
    """Sampler of a wave field for hulls of S points. `bind` makes it and explains the arrays.

    Arrays of P places have the S points and more places of a panel code, in the order of the rungs.
    """

    turns_per_m: Array  # (2, W)
    turns_per_s: Array  # (W,)
    turns: Array  # (W,)
    rungs: tuple[Rung, ...]
    lever: Array  # (6, D W): of the first rung, then of the steps
    of_cosines: Array  # (W, 4): elevation, vertical acceleration, orbital north, orbital east
    of_sines: Array  # (W, 3): vertical velocity, slope to north, slope to east
    over_cosines: Array  # (4 P, 15)
    over_sines: Array  # (3 P, 15)
    elevations: NDArray[intp]  # (S,): of the points, in the sums with of_cosines
    panel_cosines: tuple[Array, ...] = ()  # for each rung of Q places, (Q W, 6)
    panel_sines: tuple[Array, ...] = ()  # the same

    @classmethod
    def bind(
        cls, waves: WaveField, points_frd_m: Array, share: Array | None = None, felt: FeltWaves | None = None
    ) -> HullWaves:
        """Compute the constants of `sample`; see `WaveField.at_hull`."""
        points = len(points_frd_m)
        mean = np.full(points, 1.0 / points) if share is None else share
        amplitude_m, omega = waves.amplitude_m, waves.omega_radps
        felt = felt or FeltWaves(np.ones(len(omega)), np.ones(len(omega)))
        vertical_m, horizontal = felt.vertical * amplitude_m, felt.horizontal[:, None]
        # Least-squares plane through the points: rows 1 and 2 of the pseudo-inverse are its slopes forward and right.
        # It pitches as it rises forward and rolls as it falls to the right.
        weight = np.sqrt(mean)
        plane = np.linalg.pinv(weight[:, None] * np.column_stack([np.ones(points), points_frd_m[:, :2]])) * weight
        roll_pitch = np.stack([-plane[2], plane[1]], axis=1)
        places_frd_m = np.concatenate([points_frd_m, felt.more_points_frd_m])
        rungs, steps_frd_m = ladder(places_frd_m)
        order = [place for rung in rungs for place in rung.points]
        direct_frd_m = np.concatenate([places_frd_m[rungs[0].points], steps_frd_m])
        panel: list[ComplexArray] = []
        if felt.sources is not None:  # a Re(c exp(i theta))
            sources = (amplitude_m[:, None, None] * felt.sources).swapaxes(0, 1)
            panel = [sources[rung.points].reshape(-1, 6) for rung in rungs]
        over_cosines, over_sines = np.zeros((len(places_frd_m), 4, 15)), np.zeros((len(places_frd_m), 3, 15))
        over_cosines[:points, 2, 0] = over_cosines[:points, 3, 1] = over_cosines[:points, 1, 11] = mean
        over_cosines[:points, 1, 9:11] = roll_pitch
        over_cosines[:points, 0, 12:14] = plane[1:].T
        over_sines[:points, 0, 2] = -mean
        over_sines[:points, 1, 3] = over_sines[:points, 2, 4] = mean
        over_sines[:points, 0, 6:8] = roll_pitch
        turn = 2.0 * math.pi
        return cls(
            turns_per_m=waves.wave_vector_radpm.T / turn,
            turns_per_s=waves.apparent_omega_radps / turn,
            turns=waves.phase_rad / turn,
            rungs=rungs,
            lever=np.einsum("wi,sj->ijsw", waves.wave_vector_radpm, direct_frd_m).reshape(6, -1),
            of_cosines=np.column_stack([vertical_m, -vertical_m * omega**2, horizontal * waves.drift_mps]),
            of_sines=np.column_stack(
                [vertical_m * omega, -horizontal * amplitude_m[:, None] * waves.wave_vector_radpm]
            ),
            over_cosines=over_cosines[order].reshape(-1, 15),
            over_sines=over_sines[order].reshape(-1, 15),
            elevations=4 * np.argsort(order)[:points],
            panel_cosines=tuple(part.real.copy() for part in panel),
            panel_sines=tuple(-part.imag for part in panel),
        )

    def sample(self, time_s: float, pos_ned_m: Array, rot_ned_frd: Array) -> HullSurface:
        """Return the surface at time_s under N vessels at (N, 3) positions with (N, 3, 3) attitudes."""
        vessels = len(pos_ned_m)
        if vessels <= _BLOCK:
            return HullSurface(*self._sample(time_s, pos_ned_m, rot_ned_frd))
        blocks = [slice(first, first + _BLOCK) for first in range(0, vessels, _BLOCK)]
        parts = [self._sample(time_s, pos_ned_m[block], rot_ned_frd[block]) for block in blocks]
        points, over_hull = zip(*parts, strict=True)
        return HullSurface(np.concatenate(points), np.concatenate(over_hull))

    def _sample(self, time_s: float, pos_ned_m: Array, rot_ned_frd: Array) -> tuple[Array, Array]:
        vessels, components = len(pos_ned_m), len(self.turns)
        # Phase at each vessel's origin, reduced to (-pi, pi]
        turns = pos_ned_m[:, :2] @ self.turns_per_m
        turns += self.turns - self.turns_per_s * time_s
        turns -= np.rint(turns)
        turns *= 2.0 * math.pi
        # Cosines and sines at the first places, and of the steps
        first = len(self.rungs[0].points)
        angles = (rot_ned_frd.reshape(vessels, 9)[:, :6] @ self.lever).reshape(vessels, -1, components)
        angles[:, :first] += turns[:, None, :]
        cosine, sine = np.cos(angles), np.sin(angles)
        waves = [(cosine[:, :first], sine[:, :first])]
        # At the places that are a step further
        for rung in self.rungs[1:]:
            cos_base, sin_base = (of_base[:, rung.bases] for of_base in waves[-1])
            steps = [first + step for step in rung.steps]
            cos_step, sin_step = cosine[:, steps], sine[:, steps]
            further = cos_base * cos_step - sin_base * sin_step, sin_base * cos_step + cos_base * sin_step
            waves.append(further)
        # Sums of the components: one product for all vessels takes half the time of a product per vessel
        cosines, sines = (
            np.concatenate([(part.reshape(-1, components) @ sums).reshape(vessels, -1) for part in parts], axis=1)
            for parts, sums in zip(zip(*waves, strict=True), (self.of_cosines, self.of_sines), strict=True)
        )
        over_hull = cosines @ self.over_cosines
        over_hull += sines @ self.over_sines
        if self.panel_cosines:
            wrench = np.zeros_like(over_hull, shape=(vessels, 6))
            for (cosine, sine), of_cosines, of_sines in zip(waves, self.panel_cosines, self.panel_sines, strict=True):
                wrench += cosine.reshape(vessels, -1) @ of_cosines
                wrench += sine.reshape(vessels, -1) @ of_sines
            over_hull = np.concatenate((over_hull, wrench), axis=1)
        return cosines[:, self.elevations], over_hull
