"""Tide of a run: height of the still water above its mean level, and the stream that the tide drives.

    tide = make_tide(spec)
    tide.height_m(time_s), tide.stream_mps(time_s)

The nodal corrections f and u are those of the start of the run.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import Protocol

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.constituents import CONSTITUENTS, Arguments
from sim_core.environment.current import bank_share
from sim_core.environment.spec import CurrentSpec, EnvironmentSpec
from sim_core.environment.tide_spec import (
    ConstituentSpec,
    StreamConstituentSpec,
    TidalStreamSpec,
    TideSpec,
    instant_utc,
    table_time_s,
)
from sim_core.frames import Array


class Curve(Protocol):
    """A function of time, about its middle."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest value that it can have."""
        ...

    @property
    def fastest(self) -> float:
        """Largest rate that it can have, per s."""
        ...

    def value(self, time_s: float) -> float:
        """Return the value at a time since the start."""
        ...

    def rate(self, time_s: float) -> float:
        """Return the change per s."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Harmonics:
    """A sum of C constituents: a cos(omega t + phase)."""

    amplitude: Array
    """Amplitudes with the nodal factor, (C,)."""
    omega_radps: Array
    """Angular speeds, (C,)."""
    phase_rad: Array
    """V + u - g at the start, (C,)."""

    @classmethod
    def from_spec(
        cls, constituents: tuple[ConstituentSpec | StreamConstituentSpec, ...], start_utc: str | None
    ) -> Harmonics:
        """Return the sum of constituents. start_utc: None if all have their own speed."""
        arguments = None if start_utc is None else Arguments.at(instant_utc(start_utc))
        rows = []
        for spec in constituents:
            amplitude = spec.amplitude_m if isinstance(spec, ConstituentSpec) else spec.amplitude_mps
            speed_degph, phase_rad = spec.speed_degph, -math.radians(spec.phase_deg)
            if speed_degph is None:
                known = CONSTITUENTS[spec.name]
                assert arguments is not None
                speed_degph, amplitude = known.speed_degph, amplitude * arguments.factor(known)
                phase_rad += arguments.phase_rad(known)
            rows.append((amplitude, math.radians(speed_degph) / 3600.0, phase_rad))
        return cls(*np.array(rows).T)

    @property
    def bounds(self) -> tuple[float, float]:
        largest = float(self.amplitude.sum())
        return -largest, largest

    @property
    def fastest(self) -> float:
        return float(self.amplitude @ self.omega_radps)

    def value(self, time_s: float) -> float:
        return float(self.amplitude @ np.cos(self.omega_radps * time_s + self.phase_rad))

    def rate(self, time_s: float) -> float:
        return -float((self.amplitude * self.omega_radps) @ np.sin(self.omega_radps * time_s + self.phase_rad))


@dataclass(frozen=True, slots=True, eq=False)
class Interpolation:
    """Piecewise cubics through K points that keep the sense of each piece: Fritsch and Carlson 1980.

    The slope at a point is the harmonic mean of both sides, weighted as by Fritsch and Butland 1984, and 0 at a turn.
    Before the first and after the last point the value is constant.
    """

    time_s: tuple[float, ...]
    values: tuple[float, ...]
    slopes: tuple[float, ...]
    """Rates at the points."""

    @classmethod
    def through(cls, time_s: tuple[float, ...], values: tuple[float, ...]) -> Interpolation:
        """Return the curve through at least two points at increasing times."""
        step, secant = np.diff(time_s), np.diff(values) / np.diff(time_s)
        slopes = np.zeros(len(time_s))
        before, after = secant[:-1], secant[1:]
        left, right = 2.0 * step[1:] + step[:-1], step[1:] + 2.0 * step[:-1]
        same = before * after > 0.0
        slopes[1:-1][same] = ((left + right) / (left / np.where(same, before, 1) + right / np.where(same, after, 1)))[
            same
        ]
        if len(secant) == 1:
            slopes[:] = secant
        else:
            slopes[0] = _end_slope(step[0], step[1], secant[0], secant[1])
            slopes[-1] = _end_slope(step[-1], step[-2], secant[-1], secant[-2])
        return cls(tuple(time_s), tuple(values), tuple(slopes.tolist()))

    @property
    def bounds(self) -> tuple[float, float]:
        return min(self.values), max(self.values)

    @property
    def fastest(self) -> float:
        fastest = max(map(abs, self.slopes))
        for number in range(len(self.time_s) - 1):
            at_start, linear, square = self._rate_terms(number)
            turn = -0.5 * linear / square if square else 0.0  # at which the rate has its extremum
            if 0.0 < turn < 1.0:
                fastest = max(fastest, abs(at_start + turn * (linear + turn * square)))
        return fastest

    def value(self, time_s: float) -> float:
        number, part, step_s = self._piece(time_s)
        at_start, linear, square = self._rate_terms(number)
        return self.values[number] + step_s * part * (at_start + part * (linear / 2.0 + part * square / 3.0))

    def rate(self, time_s: float) -> float:
        if not self.time_s[0] <= time_s <= self.time_s[-1]:
            return 0.0
        number, part, _ = self._piece(time_s)
        at_start, linear, square = self._rate_terms(number)
        return at_start + part * (linear + part * square)

    def _piece(self, time_s: float) -> tuple[int, float, float]:
        """Return the number of the piece, the elapsed part of it, and its length in s."""
        number = min(max(bisect_right(self.time_s, time_s) - 1, 0), len(self.time_s) - 2)
        step_s = self.time_s[number + 1] - self.time_s[number]
        return number, min(max((time_s - self.time_s[number]) / step_s, 0.0), 1.0), step_s

    def _rate_terms(self, number: int) -> tuple[float, float, float]:
        """Return the terms of the rate, a polynomial of the elapsed part of a piece."""
        step_s = self.time_s[number + 1] - self.time_s[number]
        secant = (self.values[number + 1] - self.values[number]) / step_s
        first, last = self.slopes[number], self.slopes[number + 1]
        return first, 6.0 * secant - 4.0 * first - 2.0 * last, 3.0 * (first + last) - 6.0 * secant


def _end_slope(step: float, next_step: float, secant: float, next_secant: float) -> float:
    """Return the slope at an end, of the parabola through three points, limited to keep the sense of the piece."""
    slope = ((2.0 * step + next_step) * secant - step * next_secant) / (step + next_step)
    if slope * secant <= 0.0:
        return 0.0
    if secant * next_secant <= 0.0 and abs(slope) > 3.0 * abs(secant):
        return 3.0 * secant
    return slope


@dataclass(frozen=True, slots=True, eq=False)
class TidalStream:
    """A uniform current along the flood or the ebb, that slackens toward the banks of the current's channel."""

    flood_ned: Array
    """Unit vector of the flood, (3,)."""
    ebb_ned: Array
    """Unit vector of the ebb, (3,)."""
    follows: Curve
    by_rate: bool
    """The speed is the rate of the curve, otherwise its value above `middle`, times `gain`."""
    middle: float
    gain: float
    lag_s: float
    channel: CurrentSpec

    @classmethod
    def from_spec(
        cls, spec: TidalStreamSpec, level: Curve | None, channel: CurrentSpec, start_utc: str | None
    ) -> TidalStream:
        """Return the stream. level: curve of the height, None for a stream with its own constituents."""
        ebb_deg = spec.flood_deg + 180.0 if spec.ebb_deg is None else spec.ebb_deg
        by_rate, middle, gain = False, 0.0, 1.0
        if spec.peak_mps is None:
            curve: Curve = Harmonics.from_spec(spec.constituents, start_utc)
        else:
            assert level is not None
            curve, by_rate = level, spec.follows == "level_rate"
            low, high = curve.bounds
            middle = 0.5 * (low + high)
            largest = curve.fastest if by_rate else 0.5 * (high - low)
            gain = spec.peak_mps / largest if largest else 0.0
        return cls(_along(spec.flood_deg), _along(ebb_deg), curve, by_rate, middle, gain, 60.0 * spec.lag_min, channel)

    def speed_mps(self, time_s: float) -> float:
        """Return the speed, positive with the flood and negative with the ebb, 0 at slack water."""
        then_s = time_s - self.lag_s
        followed = self.follows.rate(then_s) if self.by_rate else self.follows.value(then_s) - self.middle
        return self.gain * followed

    def velocity_ned_mps(self, time_s: float, pos_ned_m: Array) -> Array:
        """Return the (N, 3) velocity at (N, 3) positions."""
        speed_mps = self.speed_mps(time_s)
        velocity = speed_mps * self.flood_ned if speed_mps > 0.0 else -speed_mps * self.ebb_ned
        if self.channel.channel_width_m is None:
            return np.broadcast_to(velocity, pos_ned_m.shape)
        return bank_share(self.channel, pos_ned_m)[:, None] * velocity


def _along(course_deg: float) -> Array:
    course = math.radians(course_deg)
    return np.array([math.cos(course), math.sin(course), 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class Tide:
    """Height and stream of a tide. Either may be absent."""

    level: Curve | None = None
    stream: TidalStream | None = None

    def height_m(self, time_s: float) -> float:
        """Return the height of the still water above its mean level."""
        return 0.0 if self.level is None else self.level.value(time_s)

    def rise_mps(self, time_s: float) -> float:
        """Return the rate of the height."""
        return 0.0 if self.level is None else self.level.rate(time_s)

    def stream_mps(self, time_s: float) -> float:
        """Return the speed of the stream away from banks, positive with the flood."""
        return 0.0 if self.stream is None else self.stream.speed_mps(time_s)

    @property
    def bounds_m(self) -> tuple[float, float]:
        """Lowest and highest height that the tide can reach."""
        return (0.0, 0.0) if self.level is None else self.level.bounds


NO_TIDE = Tide()


def make_tide(spec: EnvironmentSpec) -> Tide:
    """Return the tide of a specification, NO_TIDE if it has none."""
    if spec.water.tide is None and spec.current.tide is None:
        return NO_TIDE
    level = None if spec.water.tide is None else make_level(spec.water.tide, spec.start_utc)
    stream = spec.current.tide
    return Tide(level, None if stream is None else TidalStream.from_spec(stream, level, spec.current, spec.start_utc))


def make_level(spec: TideSpec, start_utc: str | None) -> Curve:
    """Return the height of a tide above the mean level, in m."""
    if spec.constituents:
        return Harmonics.from_spec(spec.constituents, start_utc)
    times = tuple(table_time_s(time, start_utc) for time, _ in spec.table)
    return Interpolation.through(times, tuple(height_m for _, height_m in spec.table))
