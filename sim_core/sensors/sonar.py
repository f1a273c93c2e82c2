"""A scanning sonar: a narrow, tall beam that a motor turns, ping by ping.

    echo = sonar.echo(settings, pos_ned_m, rot_ned_frd, below, rng)

Rays fill the beam out to its first nulls. The surface that a ray reaches scatters power back to the transducer
(Lambert's law), delayed by the range. Anything behind it is in the shadow, because no ray reaches it. Levels are
relative to a rigid wall that fills the beam at 1 m:

    wall that fills the beam      10 log s - 20 log r - 2 a r       (its lit area grows with the square of the range)
    small object                  TS - 40 log r - 2 a r             (fewer rays reach it: 20 log r more)

with backscatter s and absorption a. Speckle makes the amplitude of every sample a Rayleigh variable (Urick 1983, ch.
8). Not modelled: paths reflected by surface or bed, side lobes, motion of the vessel while one ping travels.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy import float64, uint8
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.sensors.spec import SonarSpec
from sim_core.world.geometry import MATERIALS
from sim_core.world.rays import NO_BODIES, Bodies, RayCaster


def absorption_dbpm(frequency_khz: float, temperature_c: float) -> float:
    """Return the one-way absorption, dB/m, near the surface of fresh water.

    Francois and Garrison 1982, part II. Only the viscosity term of their equation applies, because fresh water has
    neither boric acid nor magnesium sulphate.
    """
    coefficients = (
        (4.937e-4, -2.59e-5, 9.11e-7, -1.50e-8) if temperature_c <= 20.0 else (3.964e-4, -1.146e-5, 1.45e-7, -6.5e-10)
    )
    per_km = np.polynomial.polynomial.polyval(temperature_c, coefficients) * frequency_khz**2
    return float(per_km) * 1e-3


def sound_speed_mps(temperature_c: float) -> float:
    """Return the speed of sound in pure water at atmospheric pressure, 0 to 95 degrees: Marczak 1997."""
    coefficients = (1402.385, 5.038813, -5.799136e-2, 3.287156e-4, -1.398845e-6, 2.787860e-9)
    return float(np.polynomial.polynomial.polyval(temperature_c, coefficients))


TURN_GRAD = 400
DEGREES_A_GRAD = 360.0 / TURN_GRAD
_GRAD_RAD = 2.0 * math.pi / TURN_GRAD
BEAM_DEG = (2.0, 25.0)  # across and up and down, between the half-power points
_HALF_POWER = 0.443  # sinc(0.443)^2 = 0.5
_NULLS_RAD = tuple(math.asin(math.sin(math.radians(0.5 * width)) / _HALF_POWER) for width in BEAM_DEG)
_RAYS = (5, 96)  # across, up and down
_CELL_RAD = 2.0 * _NULLS_RAD[1] / _RAYS[1]
_PARTS = 6  # parts of a ray's echo, along its range
LONGEST_M = 2.0  # longest extent of a cell's echo along the range; a slanted surface ends there

FLOOR_DB = -92.0  # intensity 0
SPAN_DB = 85.0  # dB from intensity 0 to intensity 255
GAIN_DB = (-6.0, 0.0, 6.0)
NOISE_DB = -88.0
CENTRE_KHZ = 750.0
BAND_KHZ = 100.0  # at this offset from the centre, the transducer is 6 dB weaker, out and back
WATER_DB = -45.0  # scattered back by a metre of turbid water that fills the beam
SURFACE_BACKSCATTER = 0.02  # a rough surface seen from below
RING_DB = 10.0  # the transducer's ringing, at once
RING_DBPS = 105_000.0  # decay of the ringing

# By the number of a material. The last entry is for no hit, which is -1.
_BACKSCATTER = np.array([*(material.backscatter for material in MATERIALS), 0.0])


@dataclass(frozen=True, slots=True)
class PingSettings:
    """Settings of a ping."""

    angle_grad: int
    """Angle of the head, clockwise from its zero, 400 to the turn."""
    sample_period_s: float
    samples: int
    """Number of samples of the echo."""
    pulse_s: float
    frequency_khz: float = CENTRE_KHZ
    gain: int = 1
    """0, 1 or 2."""

    @property
    def listen_s(self) -> float:
        """Time from the ping to the last sample."""
        return self.sample_period_s * self.samples

    def at(self, angle_grad: int) -> PingSettings:
        """Return the same settings in another direction."""
        return replace(self, angle_grad=angle_grad)


@dataclass(frozen=True, slots=True, eq=False)
class Below:
    """Everything that sound can reach: the same objects as for light, and the water surface. Nothing above it is
    audible.
    """

    caster: RayCaster
    surface_down_m: float
    bodies: Bodies = NO_BODIES


@dataclass(frozen=True, slots=True)
class ScanningSonar:
    """The transducer of a specification."""

    spec: SonarSpec

    @property
    def heading_grad(self) -> int:
        """Heading of its zero angle, clockwise from the bow, rounded to whole gradians like the head's steps."""
        return round(self.spec.heading_deg / DEGREES_A_GRAD)

    def echo(
        self, settings: PingSettings, pos_ned_m: Array, rot_ned_frd: Array, below: Below, rng: Generator
    ) -> NDArray[uint8]:
        """Return the echo intensity (samples,) of a ping from a vessel at pos_ned_m (3,), rotated by rot_ned_frd (3,
        3).
        """
        return received(self.scattered(settings, pos_ned_m, rot_ned_frd, below, rng), settings, rng)

    def scattered(
        self, settings: PingSettings, pos_ned_m: Array, rot_ned_frd: Array, below: Below, rng: Generator
    ) -> Array:
        """Return the mean power (samples,) of the echo without a receiver, relative to a rigid wall at 1 m.

        `rng` draws the position of each ray in its cell of the beam.
        """
        # The first hit of each ray
        power = np.zeros(settings.samples)
        origin = pos_ned_m + rot_ned_frd @ np.array(self.spec.position_frd_m)
        depth_m = float(origin[2]) - below.surface_down_m
        if depth_m <= 0.0:
            return power  # out of the water
        beam = _beam((self.heading_grad + settings.angle_grad) * _GRAD_RAD, rng)
        rays = beam.direction @ rot_ned_frd.T
        range_m, backscatter, normal = _first_hits(origin, rays, depth_m, below)
        cosine = np.maximum(np.abs((normal * rays).sum(axis=1)), 1e-3)
        # A ray represents a cell of the beam. Over the cell's height, a slanted surface extends this far along the ray.
        slant = (normal * (beam.upward @ rot_ned_frd.T)).sum(axis=1) / cosine
        with np.errstate(invalid="ignore"):
            length_m = np.minimum(np.abs(slant) * range_m * _CELL_RAD, LONGEST_M)
        # The echo of each part of a cell: Lambert's law, spreading and absorption
        parts_m = range_m + length_m * ((np.arange(_PARTS)[:, None] + rng.random((_PARTS, 1))) / _PARTS - 0.5)
        parts_m = np.maximum(np.nan_to_num(parts_m, nan=np.inf), 1e-2)
        loss_db = 2.0 * absorption_dbpm(settings.frequency_khz, self.spec.water_temperature_c)
        off_db = 6.0 * ((settings.frequency_khz - CENTRE_KHZ) / BAND_KHZ) ** 2
        back = beam.weight * backscatter * cosine / _PARTS
        back = back * 10.0 ** (-0.1 * (loss_db * parts_m + off_db)) / parts_m**2
        # Sums by sample, and the haze of turbid water
        sample_m = 0.5 * sound_speed_mps(self.spec.water_temperature_c) * settings.sample_period_s
        number = np.minimum(parts_m / sample_m, settings.samples).astype(np.intp)
        power += np.bincount(number.ravel(), back.ravel(), settings.samples + 1)[:-1]
        middle_m = (np.arange(settings.samples) + 0.5) * sample_m
        haze_db = WATER_DB - loss_db * middle_m - off_db
        return np.asarray(power + sample_m * 10.0 ** (0.1 * haze_db) / middle_m**2)


def _first_hits(origin: Array, rays: Array, depth_m: float, below: Below) -> tuple[Array, Array, Array]:
    """Return the first hit of each ray: range (R,), inf for nothing, backscatter (R,) and normal (R, 3)."""
    direction = rays.astype(np.float32)
    origins = np.repeat(origin.astype(np.float32)[None, :], len(rays), axis=0)
    hits = below.caster.cast(origins, direction, below.bodies)
    range_m, normal = hits.range_m.astype(float64), hits.normal_ned.astype(float64)
    backscatter = _BACKSCATTER[hits.material]
    down = rays[:, 2]
    rising = down < 0.0
    surface_m = np.where(rising, depth_m / np.where(rising, -down, 1.0), np.inf)
    nearer = surface_m < range_m
    normal[nearer] = (0.0, 0.0, 1.0)
    return np.minimum(range_m, surface_m), np.where(nearer, SURFACE_BACKSCATTER, backscatter), normal


class _Beam(NamedTuple):
    """Rays in body axes."""

    direction: Array
    """Unit vectors, (R, 3)."""
    upward: Array
    """Unit vectors at right angles to `direction`, (R, 3)."""
    weight: Array
    """Weights, (R,), with sum 1."""


def _beam(heading_rad: float, rng: Generator) -> _Beam:
    """Draw one ray in each cell of the beam.

    Sound goes out and back, so the pattern of a line (sinc squared in power) counts twice, across and up and down.
    """
    count_across, count_up = _RAYS
    across = (np.arange(count_across)[:, None] + rng.random(_RAYS)) / count_across
    up = (np.arange(count_up)[None, :] + rng.random(_RAYS)) / count_up
    side, height = (null_rad * (2.0 * place - 1.0) for null_rad, place in zip(_NULLS_RAD, (across, up), strict=True))
    weight = np.cos(height)
    for angle, width_deg in zip((side, height), BEAM_DEG, strict=True):
        weight = weight * np.sinc(_HALF_POWER * np.sin(angle) / math.sin(math.radians(0.5 * width_deg))) ** 4
    sine, cosine = np.sin(height), np.cos(height)
    north, east = np.cos(heading_rad + side), np.sin(heading_rad + side)
    direction = np.stack([cosine * north, cosine * east, -sine], axis=2)
    upward = np.stack([-sine * north, -sine * east, -cosine], axis=2)
    return _Beam(direction.reshape(-1, 3), upward.reshape(-1, 3), (weight / weight.sum()).ravel())


def received(power: Array, settings: PingSettings, rng: Generator) -> NDArray[uint8]:
    """Return the receiver's intensity for the mean power (samples,) of the echo, in decibels scaled to 0 to 255.

    The scatterers of each sample have random phases and add up to a Rayleigh amplitude, smoothed over the pulse length.
    The transducer's ringing, the receiver's noise and its gain follow. There is no time-varying gain.
    """
    # Speckle
    noise = rng.standard_normal((4, settings.samples))
    amplitude = np.sqrt(0.5 * power) * (noise[0] + 1j * noise[1])
    # Spread of the power over samples by the length of the pulse, about its middle
    length = min(max(settings.pulse_s / settings.sample_period_s, 1.0), float(settings.samples // 2))
    half = math.ceil(0.5 * (length - 1.0))
    pulse = np.clip(0.5 * length - np.abs(np.arange(-half, half + 1)) + 0.5, 0.0, 1.0)
    amplitude = np.convolve(amplitude, np.sqrt(pulse), mode="same")
    # Noise, ringing and gain
    amplitude += math.sqrt(0.5 * 10.0 ** (0.1 * NOISE_DB)) * (noise[2] + 1j * noise[3])
    since_ping_s = (np.arange(settings.samples) + 0.5) * settings.sample_period_s
    ringing_db = RING_DB - RING_DBPS * np.maximum(since_ping_s - settings.pulse_s, 0.0)
    level = np.abs(amplitude) ** 2 + 10.0 ** (0.1 * ringing_db)
    level_db = 10.0 * np.log10(np.maximum(level, 1e-30)) + GAIN_DB[settings.gain]
    steps = np.rint((level_db - FLOOR_DB) * (255.0 / SPAN_DB))
    return np.asarray(np.clip(steps, 0.0, 255.0), dtype=uint8)


@dataclass(frozen=True, slots=True)
class Sector:
    """Directions that a head sweeps back and forth. A full circle continues in one direction."""

    start_grad: int
    """First direction of the head."""
    span_grad: int
    """Angle clockwise from start_grad, 400 for the full circle."""
    step_grad: int

    @classmethod
    def from_spec(cls, spec: SonarSpec) -> Sector:
        """Return the sector in the directions of the head."""
        first_deg, last_deg = spec.sector_deg
        first_grad = round(first_deg / DEGREES_A_GRAD)
        return cls(first_grad % TURN_GRAD, round(last_deg / DEGREES_A_GRAD) - first_grad, spec.step_grad)

    def angle_grad(self, offset_grad: int) -> int:
        """Return the direction at an offset into the sector."""
        return (self.start_grad + offset_grad) % TURN_GRAD

    def after(self, offset_grad: int, forward: bool) -> tuple[int, bool]:
        """Return the next offset, and True if the head moved clockwise."""
        if self.span_grad + self.step_grad >= TURN_GRAD:
            return (offset_grad + self.step_grad) % TURN_GRAD, True
        if not 0 <= offset_grad + (self.step_grad if forward else -self.step_grad) <= self.span_grad:
            forward = not forward
        following = offset_grad + (self.step_grad if forward else -self.step_grad)
        return (following, forward) if 0 <= following <= self.span_grad else (offset_grad, forward)


OVERHEAD_S = 0.016  # of a ping, in addition to turning and listening
TURN_S = 0.004
"""Time of the head for one gradian. With OVERHEAD_S, a circle of 400 takes 9 s at 2 m and 35 s at 50 m, as specified by
the manufacturer.
"""


def turning_s(from_grad: int, to_grad: int) -> float:
    """Return the time that the head takes between two directions, the short way."""
    apart = (to_grad - from_grad) % TURN_GRAD
    return TURN_S * min(apart, TURN_GRAD - apart)
