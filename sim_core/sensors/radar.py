"""A marine radar: a fan beam that turns, spoke by spoke, and echoes in samples of the range.

    state, sector = radar.scan(state, track, first_s, surroundings, rng)

Echoes follow the radar equation (Skolnik 2001, 1.2), as a ratio to the receiver's noise:

    S / N = P G² lambda² sigma F⁴ / ((4 pi)³ R⁴ L k T0 B Fn),   B = 1 / pulse

A turn has cells of azimuth, as wide as a spoke, in north-east axes. Each cell has a complex amplitude for each sample
of the range: the square root of the mean power, times speckle. Speckle is complex Gaussian and lasts for one pass of
the beam. A spoke is the sum of the cells, weighted by the beam's pattern in its own direction. The sum over the pulse
length follows, then the receiver's noise in each pulse, and the mean power of the pulses. Reflectors add their
amplitude without speckle.

The beam is Gaussian, without side lobes. The vessel's position is that of the middle of a sector (1/24 turn), its
attitude that of each spoke. Not modelled: Doppler, interference, echoes of earlier pulses, the vessel's own hull.
"""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import TypeVar

import numpy as np
from numpy import complex64, float32, float64, uint8
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array, Array32
from sim_core.sensors.lidar import BodyTrack
from sim_core.sensors.radar_clutter import (
    rain_attenuation_dbpkm,
    rain_reflectivity_per_m,
    sea_reflectivity_db,
    spike_shape,
    wind_factor_db,
)
from sim_core.sensors.radar_targets import ScatterPoints
from sim_core.sensors.spec import LIGHT_MPS, SECTORS, MarineRadarSpec

Complex = TypeVar("Complex", NDArray[np.complex64], NDArray[np.complex128])
FIRST_ANGLE_RAD = math.pi
"""Angle from the bow of the first spoke of a turn. The image of a moving vessel has its seam there."""
_BOLTZMANN_JPK = 1.380649e-23
_T0_K = 290.0
_EARTH_M = 4.0 / 3.0 * 6.371e6  # with the refraction of a standard atmosphere
GAUSSIAN = 4.0 * math.log(2.0)  # exp(-GAUSSIAN) is one sixteenth; half power at half the width
TWO_WAY_SHARE = math.sqrt(math.pi / (2.0 * GAUSSIAN))
"""Integral of the two-way pattern over angle, in beam widths: 0.753."""
_MARGIN = 1.5  # beam widths; the two-way pattern is 54 dB down
_NEAR_RAD = math.radians(10.0)  # objects nearby are wider than a cell
_WIDEST = 20  # cells on each side that a point can hide


@dataclass(frozen=True, slots=True, eq=False)
class RadarSurroundings:
    """Everything that returns or weakens the radar's pulses, at one instant."""

    points: tuple[ScatterPoints, ...] = ()
    """Objects, in NED."""
    water_down_m: float = 0.0
    sea_state: float | None = None
    """Sea state of the clutter, None for none."""
    wind_from_rad: float = 0.0
    """Direction from which the wind blows, clockwise from north."""
    waves_from_rad: float = 0.0
    wave_height_m: float = 0.0
    """Significant height; it weakens the path over the water."""
    rain_mmph: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RadarState:
    """Random fields of the A cells that the beam reached last."""

    number: int
    """Number of the next sector, from 0."""
    first_cell: int
    """Number of the first cell, counted on over the turns."""
    speckle: NDArray[complex64]
    """Speckle, (A, bins), with mean power 1."""
    texture: Array32
    """Mean power of the sea's resolution cells, (A, bins), with mean 1."""


@dataclass(frozen=True, slots=True, eq=False)
class RadarSector:
    """K successive spokes. Angles are clockwise."""

    number: int
    """Sector of the turn, 0 to 23."""
    turn: int
    first_s: float
    """Time of the first spoke, after the start of the track."""
    heading_rad: float
    """Heading of the bow at the first spoke, clockwise from north, with its noise."""
    power: Array
    """Mean power relative to the receiver's noise, (K, bins); 0 nearer than the shortest range."""
    intensity: NDArray[uint8]
    """Intensity after STC, FTC and quantisation, (K, bins)."""


@dataclass(frozen=True, slots=True)
class MarineRadar:
    """The radar of a specification, with the figures that follow from it."""

    spec: MarineRadarSpec
    wavelength_m: float = field(init=False)
    bin_m: float = field(init=False)
    """Length of a sample of the range."""
    pulse_bins: int = field(init=False)
    """Samples within the length of a pulse, at least 1."""
    pulses: int = field(init=False)
    """Pulses in a spoke."""
    sector_spokes: int = field(init=False)
    spoke_s: float = field(init=False)
    step_rad: float = field(init=False)
    """Angle between spokes."""
    first_bin: int = field(init=False)
    """First sample beyond the shortest range."""
    signal_m2: float = field(init=False)
    """S / N of a cross section of 1 m² at 1 m, for one pulse."""

    def __post_init__(self) -> None:
        spec = self.spec
        wavelength_m = LIGHT_MPS / (spec.frequency_mhz * 1e6)
        gain = 26_000.0 / (spec.beam_deg * spec.beam_height_deg)  # Stutzman and Thiele 2012, 9.3
        if spec.gain_dbi is not None:
            gain = 10.0 ** (0.1 * spec.gain_dbi)
        noise_w = _BOLTZMANN_JPK * _T0_K / (spec.pulse_us * 1e-6) * 10.0 ** (0.1 * spec.noise_figure_db)
        received_w = spec.peak_power_w * gain**2 * wavelength_m**2 / (4.0 * math.pi) ** 3
        bin_m = spec.range_m / spec.bins
        values = {
            "wavelength_m": wavelength_m,
            "bin_m": bin_m,
            "pulse_bins": min(max(round(self.pulse_m / bin_m), 1), spec.bins),
            "pulses": max(int(spec.prf_hz * 60.0 / spec.rpm / spec.spokes), 1),
            "sector_spokes": spec.spokes // SECTORS,
            "spoke_s": 60.0 / spec.rpm / spec.spokes,
            "step_rad": math.tau / spec.spokes,
            "first_bin": min(math.ceil(spec.min_range_m / bin_m), spec.bins - 1),
            "signal_m2": received_w / noise_w * 10.0 ** (-0.1 * spec.losses_db),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def pulse_m(self) -> float:
        """Length of the pulse in range, c tau / 2."""
        return 0.5 * LIGHT_MPS * self.spec.pulse_us * 1e-6

    @property
    def sector_s(self) -> float:
        """Time of a sector."""
        return self.spoke_s * self.sector_spokes

    @property
    def middle_m(self) -> Array:
        """Ranges of the middles of the samples, (bins,)."""
        return np.linspace(0.5, self.spec.bins - 0.5, self.spec.bins) * self.bin_m

    def angle_rad(self, sector: int) -> float:
        """Return the angle of the first spoke of a sector of the turn, clockwise from the bow, 0 to 2 pi."""
        return (FIRST_ANGLE_RAD + sector * self.sector_spokes * self.step_rad) % math.tau

    def initial(self) -> RadarState:
        """Return the state before the first sector."""
        return RadarState(0, 0, np.empty((0, self.spec.bins), complex64), np.empty((0, self.spec.bins), float32))

    def scan(
        self, state: RadarState, track: BodyTrack, first_s: float, surroundings: RadarSurroundings, rng: Generator
    ) -> tuple[RadarState, RadarSector]:
        """Return the state after a sector, and the sector.

        Its first spoke is first_s after the start of the track. The first sector of a turn begins astern.
        """
        # Directions of the spokes, and the antenna in the middle of the sector
        spec, count = self.spec, self.sector_spokes
        number = state.number % SECTORS
        angle_rad = self.angle_rad(number) + np.arange(count) * self.step_rad
        place, turned = track.poses(first_s + np.arange(count, dtype=float64) * self.spoke_s)
        axis = turned[:, :, 0] * np.cos(angle_rad)[:, None] + turned[:, :, 1] * np.sin(angle_rad)[:, None]
        spoke = np.unwrap(np.arctan2(axis[:, 1], axis[:, 0])) / self.step_rad
        middle = count // 2
        origin = place[middle] + turned[middle] @ np.array(spec.position_frd_m)
        # Cells that the beam can reach, counted on from those of the last sector
        margin = _MARGIN * math.radians(spec.beam_deg) / self.step_rad
        expected = state.first_cell + count + margin
        spoke += spec.spokes * round((expected - spoke.min()) / spec.spokes)
        cells = np.arange(math.floor(spoke.min() - margin), math.ceil(spoke.max() + margin) + 1)
        state = self._drawn(state, cells, origin, surroundings, rng)
        # Amplitudes of the cells, and the sum over the beam and over the pulse
        view = _SectorView(self, origin, turned[middle][:, 2], cells, surroundings)
        power, steady = view.echoes(state.texture)
        amplitude = (np.sqrt(power) * state.speckle + steady).astype(complex64)
        off_widths = (spoke[:, None] - cells) * (self.step_rad / math.radians(spec.beam_deg))
        pattern = np.exp(-GAUSSIAN * off_widths**2).astype(float32)
        signal = _summed((pattern @ amplitude.view(float32)).view(complex64), self.pulse_bins)
        received = self._received(signal, rng)
        received[:, : self.first_bin] = 0.0
        # Heading with its noise
        bow = turned[0][:, 0]
        heading_rad = math.atan2(bow[1], bow[0]) + math.radians(spec.heading_noise_deg) * rng.standard_normal()
        turn = state.number // SECTORS
        sector = RadarSector(number, turn, first_s, heading_rad % math.tau, received, self.video(received))
        return replace(state, number=state.number + 1), sector

    def video(self, power: Array) -> NDArray[uint8]:
        """Return the intensities (K, bins) of powers (K, bins): STC, FTC on the logarithm, and eight bits."""
        spec = self.spec
        level_db = 10.0 * np.log10(np.maximum(power, 1e-6))
        if spec.stc_range_m:
            gain_db = 10.0 * spec.stc_exponent * np.log10(self.middle_m / spec.stc_range_m)
            level_db += np.minimum(gain_db, 0.0)
        if spec.ftc_m:
            length = max(round(spec.ftc_m / self.bin_m), 1)
            before = np.cumsum(np.pad(level_db, ((0, 0), (length + 1, 0)), mode="edge"), axis=1)
            level_db = level_db - (before[:, length:-1] - before[:, : -length - 1]) / length
        steps = np.rint((level_db - spec.floor_db) * (255.0 / spec.span_db))
        steps[:, : self.first_bin] = 0.0
        return np.clip(steps, 0.0, 255.0).astype(uint8)

    def signal_to_noise(self, section_m2: Array, range_m: Array, rain_mmph: float = 0.0) -> Array:
        """Return S / N (...,) of one pulse for cross sections in the middle of the beam: the radar equation."""
        attenuation_db = 2e-3 * rain_attenuation_dbpkm(rain_mmph, self.spec.frequency_mhz * 1e-3) * range_m
        ratio: Array = self.signal_m2 * section_m2 / range_m**4 * 10.0 ** (-0.1 * attenuation_db)
        return ratio

    def _received(self, signal: NDArray[complex64], rng: Generator) -> Array:
        """Return the mean power of the pulses. Noise is as long as a pulse in range, and new in each pulse."""
        power = np.zeros(signal.shape)
        for _ in range(self.pulses):
            noise = _summed(_speckle(signal.shape, rng), self.pulse_bins)
            noise *= float32(1.0 / math.sqrt(self.pulse_bins))
            received = signal + noise
            power += received.real**2 + received.imag**2
        return power / self.pulses

    def _drawn(
        self,
        state: RadarState,
        cells: NDArray[np.intp],
        origin: Array,
        surroundings: RadarSurroundings,
        rng: Generator,
    ) -> RadarState:
        """Return the state with these cells: kept ones, and others with new speckle and texture."""
        spec = self.spec
        known = np.flatnonzero((cells >= state.first_cell) & (cells < state.first_cell + len(state.speckle)))
        new = np.setdiff1d(np.arange(len(cells)), known, assume_unique=True)
        speckle, texture = np.empty((len(cells), spec.bins), complex64), np.ones((len(cells), spec.bins), float32)
        speckle[known] = state.speckle[cells[known] - state.first_cell]
        texture[known] = state.texture[cells[known] - state.first_cell]
        speckle[new] = _speckle((len(new), spec.bins), rng)
        if surroundings.sea_state is not None:
            # One gamma variable for each resolution cell: a beam width and a pulse length
            width = max(round(math.radians(spec.beam_deg) / self.step_rad), 1)
            grazing_deg = self._grazing_deg(surroundings.water_down_m - origin[2])[:: self.pulse_bins]
            range_m = self.middle_m[:: self.pulse_bins]
            cell_m2 = range_m * math.radians(spec.beam_deg) * TWO_WAY_SHARE * self.pulse_m
            blocks = cells // width
            for block in np.unique(blocks[new]).tolist():
                same = known[blocks[known] == block]
                if len(same):
                    drawn = texture[same[0]]
                else:
                    from_waves_rad = (block + 0.5) * width * self.step_rad - surroundings.waves_from_rad
                    shape = spike_shape(grazing_deg, cell_m2, np.full(len(range_m), from_waves_rad), spec.polarisation)
                    spikes = rng.standard_gamma(shape) / shape
                    drawn = np.repeat(spikes, self.pulse_bins)[: spec.bins].astype(float32)
                texture[new[blocks[new] == block]] = drawn
        return RadarState(state.number, int(cells[0]), speckle, texture)

    def _grazing_deg(self, height_m: float) -> Array:
        """Return the grazing angles (bins,) at the water; negative beyond the horizon and nearer than it can be."""
        sine = np.minimum(height_m / self.middle_m, 1.0) - self.middle_m / (2.0 * _EARTH_M)
        return np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class _SectorView:
    """A cells of azimuth as the radar sees them from one position."""

    radar: MarineRadar
    origin_ned_m: Array
    down_ned: Array
    """Down axis of the vessel, which the beam turns about."""
    cells: NDArray[np.intp]
    surroundings: RadarSurroundings

    def echoes(self, texture: Array32) -> tuple[Array, NDArray[np.complex128]]:
        """Return the mean powers (A, bins) of echoes with speckle, and the amplitudes (A, bins) of those without.

        Both are relative to the receiver's noise, in the middle of the beam, before the sum over the pulse.
        """
        radar, bins = self.radar, self.radar.spec.bins
        size = len(self.cells) * bins
        points, cell, number, slant_m, slope, toward = self._points()
        horizon = self._horizon(points, cell, number, slant_m, slope)
        before = np.full_like(horizon, -np.inf)
        before[:, 1:] = horizon[:, :-1]
        nearest = np.clip(np.rint(cell).astype(np.intp), 0, len(self.cells) - 1)
        seen = (slope >= before[nearest, number]) & (np.abs(cell - nearest) < 0.51)
        power = radar.signal_to_noise(points.cross_section_m2(toward), slant_m, self.surroundings.rain_mmph)
        power *= self._height_pattern(nearest, np.arctan(slope)) * self._multipath(points, slant_m)
        place = nearest * bins + number
        rough, steady = seen & (points.constant_m2 == 0.0), seen & (points.constant_m2 > 0.0)
        objects: Array = np.bincount(place[rough], power[rough], size).astype(float64).reshape(len(self.cells), bins)
        powers = objects + self._sea(texture, horizon) + self._rain()
        wave = np.sqrt(power[steady]) * np.exp(-4j * math.pi / radar.wavelength_m * slant_m[steady])
        amplitudes = np.zeros(size, np.complex128)
        np.add.at(amplitudes, place[steady], wave)
        return powers, amplitudes.reshape(powers.shape)

    def _points(self) -> tuple[ScatterPoints, Array, NDArray[np.intp], Array, Array, Array]:
        """Return the points in these cells and within the range, with cell, sample, slant range, slope upward and unit
        vector to the radar.
        """
        radar, origin = self.radar, self.origin_ned_m
        middle_rad = 0.5 * float(self.cells[0] + self.cells[-1]) * radar.step_rad
        half_rad = 0.5 * len(self.cells) * radar.step_rad + _NEAR_RAD
        chosen = []
        for part in self.surroundings.points:
            north_m, east_m, radius_m = part.circle_ne_m
            distance_m = math.hypot(north_m - origin[0], east_m - origin[1])
            if distance_m > radius_m:
                off_rad = math.remainder(math.atan2(east_m - origin[1], north_m - origin[0]) - middle_rad, math.tau)
                if abs(off_rad) > half_rad + math.asin(radius_m / distance_m):
                    continue
            if distance_m > radius_m + radar.spec.range_m:
                continue
            north, east = part.place_m[:, 0] - origin[0], part.place_m[:, 1] - origin[1]
            square = north * north + east * east
            along = north * math.cos(middle_rad) + east * math.sin(middle_rad)
            near = along > math.cos(half_rad) * np.sqrt(square)
            near &= (square < radar.spec.range_m**2) & (square > 1.0)
            near &= part.place_m[:, 2] < self.surroundings.water_down_m
            chosen.append(part.select(np.flatnonzero(near)))
        points = ScatterPoints.joined(chosen)
        relative = points.place_m - origin
        slant_m = np.linalg.norm(relative, axis=1)
        inside = np.flatnonzero(slant_m < radar.spec.range_m)
        points, relative, slant_m = points.select(inside), relative[inside], slant_m[inside]
        number = np.minimum((slant_m / radar.bin_m).astype(np.intp), radar.spec.bins - 1)
        range_m = np.hypot(relative[:, 0], relative[:, 1])
        azimuth_rad = np.arctan2(relative[:, 1], relative[:, 0]) - middle_rad
        cell = np.remainder(azimuth_rad + math.pi, math.tau) - math.pi
        cell = cell / radar.step_rad + 0.5 * (len(self.cells) - 1)
        slope = (-relative[:, 2] - range_m**2 / (2.0 * _EARTH_M)) / range_m
        return points, cell, number, slant_m, slope, -relative / slant_m[:, None]

    def _horizon(
        self, points: ScatterPoints, cell: Array, number: NDArray[np.intp], slant_m: Array, slope: Array
    ) -> Array:
        """Return the steepest slope up to each sample of the range (A, bins): everything below is hidden."""
        bins = self.radar.spec.bins
        reach = points.half_m / (slant_m * self.radar.step_rad)
        first = np.maximum(np.ceil(cell - np.minimum(reach, _WIDEST) - 0.5), 0).astype(np.intp)
        last = np.minimum(np.floor(cell + np.minimum(reach, _WIDEST) + 0.5), len(self.cells) - 1).astype(np.intp)
        count = np.where(points.half_m > 0.0, np.maximum(last - first + 1, 0), 0)
        row = np.repeat(np.arange(len(count)), count)
        across = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        steepest = np.full((len(self.cells), bins), -np.inf)
        np.maximum.at(steepest, (first[row] + across, number[row]), slope[row])
        # The water hides objects beyond its horizon
        height_m = max(self.surroundings.water_down_m - float(self.origin_ned_m[2]), 0.0)
        range_m = self.radar.middle_m
        water = -height_m / range_m - range_m / (2.0 * _EARTH_M)
        horizon_m = math.sqrt(2.0 * _EARTH_M * height_m)
        tangent = np.where(range_m > horizon_m, water.max(), water)
        return np.maximum(np.maximum.accumulate(steepest, axis=1), np.where(range_m > horizon_m, tangent, -np.inf))

    def _height_pattern(self, cell: NDArray[np.intp], elevation_rad: Array) -> Array:
        """Return the two-way pattern of the beam over its height, in the shape of cell and elevation_rad together."""
        azimuth_rad = self.cells[cell] * self.radar.step_rad
        north, east, down = self.down_ned
        tilt_rad = np.arctan((np.cos(azimuth_rad) * north + np.sin(azimuth_rad) * east) / max(float(down), 0.1))
        pattern: Array = np.exp(
            -2.0 * GAUSSIAN * ((elevation_rad - tilt_rad) / math.radians(self.radar.spec.beam_height_deg)) ** 2
        )
        return pattern

    def _multipath(self, points: ScatterPoints, slant_m: Array) -> Array:
        """Return F⁴ of objects afloat: a second path over the water, with the coefficient -rho of a rough surface.

        F² = 1 + rho² - 2 rho cos(4 pi h H / (lambda R)), rho = exp(-2 (2 pi s sin(grazing) / lambda)²) (Ament 1953).
        """
        if not self.radar.spec.multipath:
            return np.ones(len(points))
        water_down_m = self.surroundings.water_down_m
        antenna_m, height_m = water_down_m - float(self.origin_ned_m[2]), water_down_m - points.place_m[:, 2]
        sine = (antenna_m + height_m) / slant_m
        rough = 2.0 * math.pi * 0.25 * self.surroundings.wave_height_m * sine / self.radar.wavelength_m
        rho = np.exp(-2.0 * rough**2)
        phase = 4.0 * math.pi * antenna_m * height_m / (self.radar.wavelength_m * slant_m)
        square = 1.0 + rho**2 - 2.0 * rho * np.cos(phase)
        return np.where(points.in_water > 0.0, square**2, 1.0)

    def _sea(self, texture: Array32, horizon: Array) -> Array:
        """Return the mean powers (A, bins) of the sea's echoes, where nothing hides it."""
        radar, around = self.radar, self.surroundings
        height_m = around.water_down_m - float(self.origin_ned_m[2])
        if around.sea_state is None or height_m <= 0.0:
            return np.zeros(horizon.shape)
        spec, range_m = radar.spec, radar.middle_m
        grazing_deg = radar._grazing_deg(height_m)
        level_db = sea_reflectivity_db(grazing_deg, spec.frequency_mhz * 1e-3, around.sea_state, spec.polarisation)
        from_wind_rad = self.cells.astype(float64)[:, None] * radar.step_rad - around.wind_from_rad
        level_db = level_db + wind_factor_db(from_wind_rad, grazing_deg, radar.wavelength_m)
        cell_m2 = range_m * radar.step_rad * radar.pulse_m / radar.pulse_bins
        power = radar.signal_to_noise(cell_m2, range_m, around.rain_mmph) * 10.0 ** (0.1 * level_db)
        elevation_rad = -np.arcsin(np.minimum(height_m / range_m, 1.0))
        power *= self._height_pattern(np.arange(len(self.cells))[:, None], elevation_rad) * texture
        slope = -height_m / range_m - range_m / (2.0 * _EARTH_M)
        return np.where((slope >= horizon) & (grazing_deg > 0.0) & (range_m > height_m), power, 0.0)

    def _rain(self) -> Array:
        """Return the mean powers (bins,) of rain. It fills the upper half of the beam."""
        radar, rain_mmph = self.radar, self.surroundings.rain_mmph
        if not rain_mmph:
            return np.zeros(radar.spec.bins)
        range_m = radar.middle_m
        high_rad = 0.5 * TWO_WAY_SHARE * math.radians(radar.spec.beam_height_deg)
        volume_m3 = range_m**2 * radar.step_rad * high_rad * radar.pulse_m / radar.pulse_bins
        section_m2 = rain_reflectivity_per_m(rain_mmph, radar.wavelength_m) * volume_m3
        return radar.signal_to_noise(section_m2, range_m, rain_mmph)


def _speckle(shape: tuple[int, ...], rng: Generator) -> NDArray[complex64]:
    """Draw complex Gaussian numbers with mean power 1."""
    pairs = rng.standard_normal((*shape, 2), dtype=float32)
    pairs *= float32(math.sqrt(0.5))
    drawn: NDArray[complex64] = pairs.view(complex64)[..., 0]
    return drawn


def _summed(values: Complex, length: int) -> Complex:
    """Return the sums over `length` samples about each sample, along the last axis; outside is zero."""
    before = (length - 1) // 2
    rows, samples = values.shape
    running = np.zeros((rows, samples + length), values.dtype)
    np.cumsum(values, axis=1, out=running[:, before + 1 : before + 1 + samples])
    running[:, before + 1 + samples :] = running[:, before + samples, None]
    summed: Complex = running[:, length:] - running[:, :-length]
    return summed
