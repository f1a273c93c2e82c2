"""The motion of a vessel and its commands over time, from which its parameters are identified."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError

Floats = NDArray[np.float64]
Quantity = Literal["north", "east", "yaw", "vel_north", "vel_east", "yaw_rate", "surge", "sway"]

QUANTITIES: Mapping[Quantity, tuple[str, float]] = {
    "north": ("m", 0.3),
    "east": ("m", 0.3),
    "yaw": ("rad", 0.02),
    "vel_north": ("m/s", 0.08),
    "vel_east": ("m/s", 0.08),
    "yaw_rate": ("rad/s", 0.01),
    "surge": ("m/s", 0.08),
    "sway": ("m/s", 0.08),
}
"""Unit of each quantity, and a first guess of the standard deviation of its error. The fit estimates the latter."""

_OVER_GROUND: tuple[tuple[Quantity, Quantity], ...] = (("vel_north", "north"), ("vel_east", "east"))
_SAMPLES_HZ, _AVERAGED_HZ = 10.0, 20.0
_GAP_S = 1.0
_SMOOTH_S = 0.3
_DRIFTING, _NEUTRAL, _BEFORE_S = (0.15, 0.15, 0.05), 0.02, 2.0


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples of one quantity. Yaw is continuous, without jumps of a turn."""

    time_s: Floats
    """(M,) rising."""
    values: Floats
    """(M,)."""
    width_s: float = 0.0
    """Time of which each sample is the mean."""

    def at(self, time_s: Floats) -> Floats:
        """Linear interpolation at (K,) instants."""
        return np.interp(time_s, self.time_s, self.values)

    def smooth(self, time_s: Floats) -> Floats:
        """Mean of the interpolated channel over 0.3 s before and after (K,) instants."""
        offsets = np.linspace(-_SMOOTH_S, _SMOOTH_S, 7)
        around = self.at(time_s[:, None] + offsets)
        mean: Floats = around.mean(axis=1)
        return mean


def channel(time_s: Floats, values: Floats, *, average: bool = False) -> Samples:
    """Return a channel with at most 10 samples a second. average: of a fast sensor, take the means of 20 intervals."""
    if len(time_s) < 2:
        return Samples(time_s, values)
    rate_hz = _AVERAGED_HZ if average else _SAMPLES_HZ
    interval_s = float(np.median(np.diff(time_s)))
    every = max(round(1.0 / rate_hz / interval_s), 1)
    if every == 1:
        return Samples(time_s, values)
    if not average:
        return Samples(time_s[::every], values[::every])
    whole = len(time_s) // every * every
    means = [own[:whole].reshape(-1, every).mean(axis=1) for own in (time_s, values)]
    return Samples(means[0], means[1], every * interval_s)


@dataclass(frozen=True, slots=True)
class Recording:
    """One run of a vessel."""

    source: str
    """Its file, for messages."""
    channels: Mapping[Quantity, Samples]
    command_s: Floats
    """(K,) rising. Each command is held until the next."""
    commands: Floats
    """(K, C) in [-1, 1], in the order of the vessel."""
    wind_ne_mps: tuple[Samples, Samples] | None = None
    """Velocity of the air over ground, north and east, where it was measured."""

    @property
    def span_s(self) -> tuple[float, float]:
        """Time that all channels and the commands cover."""
        first = max(float(self.command_s[0]), *(float(own.time_s[0]) for own in self.channels.values()))
        last = min(float(self.command_s[-1]), *(float(own.time_s[-1]) for own in self.channels.values()))
        return first, last

    @property
    def longest_part_s(self) -> float:
        """Length of the longest part without a gap in a channel."""
        first_s, last_s = self.span_s
        edges = [np.array([first_s, last_s])]
        for own in self.channels.values():
            gaps = np.flatnonzero(np.diff(own.time_s) > _GAP_S)
            edges += [own.time_s[gaps], own.time_s[gaps + 1]]
        inside = np.unique(np.clip(np.concatenate(edges), first_s, last_s))
        whole = ~self.broken(0.5 * (inside[1:] + inside[:-1]), 0.0)
        return float(np.diff(inside)[whole].max(initial=0.0))

    def part(self, from_s: float, until_s: float) -> Recording:
        """Return the recording between two instants."""
        channels = {}
        for name, own in self.channels.items():
            rows = slice(*np.searchsorted(own.time_s, (from_s, until_s)))
            channels[name] = replace(own, time_s=own.time_s[rows], values=own.values[rows])
        first, last = np.searchsorted(self.command_s, (from_s, until_s))
        rows = slice(max(int(first) - 1, 0), int(last) + 1)
        return replace(self, channels=channels, command_s=self.command_s[rows], commands=self.commands[rows])

    def broken(self, start_s: Floats, length_s: float) -> NDArray[np.bool_]:
        """Return whether each window has a gap of more than 1 s in a channel, (W,)."""
        bad = np.zeros(len(start_s), dtype=np.bool_)
        for own in self.channels.values():
            gaps = np.flatnonzero(np.diff(own.time_s) > _GAP_S)
            for begin_s, end_s in zip(own.time_s[gaps], own.time_s[gaps + 1], strict=True):
                bad |= (start_s < end_s) & (start_s + length_s > begin_s)
        return bad

    def idle(self, start_s: Floats, length_s: float) -> NDArray[np.bool_]:
        """Return whether the boat drifts through each window, with its actuators at neutral all the time, (W,)."""
        motion = np.abs(self.motion_at(start_s)[:, 3:])
        still = (motion < _DRIFTING).all(axis=1)
        instants = start_s[:, None] + np.arange(-_BEFORE_S, length_s, 0.1)
        held = np.clip(np.searchsorted(self.command_s, instants, side="right") - 1, 0, None)
        neutral = (np.abs(self.commands[held]) < _NEUTRAL).all(axis=(1, 2))
        return np.asarray(still & neutral)

    def mean_commands(self, edges_s: Floats) -> Floats:
        """Return the mean commands between rising (..., E + 1) edges, (..., E, C)."""
        steps = np.diff(self.command_s)[:, None] * self.commands[:-1]
        total = np.concatenate([np.zeros((1, self.commands.shape[1])), np.cumsum(steps, axis=0)])
        inside = np.clip(edges_s, self.command_s[0], self.command_s[-1])
        integral = np.stack([np.interp(inside, self.command_s, column) for column in total.T], axis=-1)
        width = np.maximum(np.diff(inside, axis=-1), 1e-9)[..., None]
        return np.where(width > 1e-8, np.diff(integral, axis=-2) / width, self.commands[0])

    def wind_at(self, time_s: Floats) -> Floats:
        """Return (..., 2) velocity of the measured air at (...) instants, 0 without a measurement."""
        if self.wind_ne_mps is None:
            return np.zeros((*time_s.shape, 2))
        return np.stack([own.at(time_s) for own in self.wind_ne_mps], axis=-1)

    def motion_at(self, time_s: Floats) -> Floats:
        """Return (K, 6) north, east, yaw, and velocity ahead, to starboard and of the yaw, smoothed over 0.6 s."""
        has = self.channels
        yaw = has["yaw"].smooth(time_s)
        motion = np.zeros((len(time_s), 6))
        if "north" in has:
            motion[:, 0], motion[:, 1] = has["north"].smooth(time_s), has["east"].smooth(time_s)
        motion[:, 2] = yaw
        if "surge" in has:
            motion[:, 3], motion[:, 4] = has["surge"].smooth(time_s), has["sway"].smooth(time_s)
        else:
            north, east = (_rate(has, name, at, time_s) for name, at in _OVER_GROUND)
            motion[:, 3] = np.cos(yaw) * north + np.sin(yaw) * east
            motion[:, 4] = np.cos(yaw) * east - np.sin(yaw) * north
        motion[:, 5] = _rate(has, "yaw_rate", "yaw", time_s)
        return motion


def _rate(has: Mapping[Quantity, Samples], name: Quantity, integral: Quantity, time_s: Floats) -> Floats:
    """Return a velocity, or the slope of its integral where it is not measured."""
    if name in has:
        return has[name].smooth(time_s)
    half_s = 0.5
    return (has[integral].smooth(time_s + half_s) - has[integral].smooth(time_s - half_s)) / (2.0 * half_s)


_POSITIONS: tuple[Quantity, ...] = ("north", "east")
_JUMP_M, _JUMP = 5.0, 20.0
_LEAST_S = 20.0
_MOVING = 0.05
_FACTOR = 1.6  # between a right unit with noise, and knots
_CHECK_STEP_S, _CHECKED_OVER = 0.5, 9
_STILL_MPS, _STILL_RADPS = 0.02, 0.01
_UNDER_WAY_MPS, _FEWEST_TURNS, _FACTOR_OF_COURSE = 0.5, 20, 3.0


def check_recording(recording: Recording, commands: int) -> Recording:
    """Return the recording. Raises UserError if it cannot show how the vessel moves."""
    source = recording.source
    if recording.commands.shape[1] != commands:
        raise UserError(
            f"{source} has {recording.commands.shape[1]} commands, but the vehicle takes {commands}; "
            "select the outputs in driver.replay.outputs of the vehicle's file, or give the commands of --columns"
        )
    first_s, last_s = recording.span_s
    if last_s - first_s < _LEAST_S:
        raise UserError(
            f"{source}: motion and commands overlap for {max(last_s - first_s, 0.0):.1f} s; record {_LEAST_S:g} s "
            "or more with outputs, position and attitude together"
        )
    inside = (recording.command_s >= first_s) & (recording.command_s <= last_s)
    spread = np.ptp(recording.commands[inside], axis=0)
    if spread.max(initial=0.0) < _MOVING:
        raise UserError(
            f"{source}: the commands change by {spread.max(initial=0.0):.3f} of full; record steps of thrust and "
            "turns, as the profile identify-excitation has them"
        )
    for name in (name for name in _POSITIONS if name in recording.channels):
        _refuse_jump(source, name, recording.channels[name])
    time_s = np.arange(first_s + 1.0, last_s - 1.0, _CHECK_STEP_S)
    has, motion = recording.channels, recording.motion_at(time_s)
    ahead, turn = (float(np.std(_means(motion[:, axis]))) for axis in (3, 5))
    if ahead < _STILL_MPS and turn < _STILL_RADPS:
        raise UserError(
            f"{source}: the boat stays at rest while the commands change by {spread.max():.2f} of full (its speed "
            f"varies by {ahead:.3f} m/s and its yaw rate by {turn:.4f} rad/s); record it afloat and free, or correct "
            "the units of position and heading"
        )
    _compare_with_course(source, motion)
    # Compare each velocity with the slope of its integral, which shows another unit, axis or sign
    if "yaw_rate" in has:
        slope = _rate({"yaw": has["yaw"]}, "yaw_rate", "yaw", time_s)
        _compare(recording.source, "yaw_rate", "yaw", has["yaw_rate"].smooth(time_s), slope, 0.02)
    if "north" in has and ("surge" in has or "vel_north" in has):
        slopes = [_rate({at: has[at]}, name, at, time_s) for name, at in _OVER_GROUND]
        cos, sin = np.cos(motion[:, 2]), np.sin(motion[:, 2])
        along, across = cos * slopes[0] + sin * slopes[1], cos * slopes[1] - sin * slopes[0]
        of_body = "surge" in has
        other = "north, east and yaw" if of_body else "north and east"
        _compare(recording.source, "surge" if of_body else "vel_north, vel_east", other, motion[:, 3], along, 0.1)
        _compare(recording.source, "sway" if of_body else "vel_north, vel_east", other, motion[:, 4], across, 0.1)
    return recording


def _refuse_jump(source: str, name: str, own: Samples) -> None:
    """Raise UserError for a change from one sample to the next that is no motion. A gap may hide any change."""
    change = np.abs(np.diff(own.values)) * (np.diff(own.time_s) <= _GAP_S)
    usual, worst = float(np.percentile(change, 99.0)), int(change.argmax())
    if change[worst] > max(_JUMP_M, _JUMP * usual):
        raise UserError(
            f"{source}: {name} jumps by {change[worst]:.3g} m at {own.time_s[worst + 1]:.1f} s (99 % of changes: up to "
            f"{usual:.2g} m); split the log there, or leave out wrong positions"
        )


def _compare(source: str, name: str, other: str, values: Floats, slope: Floats, least: float) -> None:
    """Compare means over 4 s, in which noise of the integral is small. least: deviation that shows a difference."""
    values, slope = _means(values), _means(slope)
    if np.std(slope) < least and np.std(values) < least:
        return
    ratio, agreement = _ratio(values, slope)
    if not 1.0 / _FACTOR < ratio < _FACTOR or agreement < 0.7:
        raise UserError(
            f"{source}: {name} is {ratio:.3g} times the rate of {other} (correlation {agreement:.2f}); "
            "correct the unit, the sign or the column of one of them"
        )


def _compare_with_course(source: str, motion: Floats) -> None:
    """Compare the turns of heading and of course, which show a wrong unit or sign of yaw. They agree only roughly."""
    cos, sin = np.cos(motion[:, 2]), np.sin(motion[:, 2])
    north, east = cos * motion[:, 3] - sin * motion[:, 4], sin * motion[:, 3] + cos * motion[:, 4]
    under_way = np.hypot(north, east) > max(_UNDER_WAY_MPS, float(np.median(np.hypot(north, east))))
    steady = under_way[1:] & under_way[:-1]
    course = np.angle(np.exp(1j * np.diff(np.arctan2(east, north))))[steady] / _CHECK_STEP_S
    heading = (np.diff(motion[:, 2]) / _CHECK_STEP_S)[steady]
    if len(course) < _FEWEST_TURNS or np.std(course) < 0.02:
        return
    ratio, agreement = _ratio(heading, course)
    ratio /= max(abs(agreement), 1e-12)  # both have errors: compare their sizes
    if abs(agreement) > 0.5 and not 1.0 / _FACTOR_OF_COURSE < ratio < _FACTOR_OF_COURSE:
        raise UserError(
            f"{source}: the heading turns {ratio:.3g} times as far as the course (correlation {agreement:.2f}); "
            "correct the unit, the sign or the column of yaw"
        )


def _means(values: Floats) -> Floats:
    """Return the means over 4 s of values at every _CHECK_STEP_S."""
    return np.convolve(values, np.full(_CHECKED_OVER, 1.0 / _CHECKED_OVER), "valid")


def _ratio(values: Floats, others: Floats) -> tuple[float, float]:
    """Return by which factor values are larger than others, by least squares, and their correlation."""
    ratio = float(values @ others / max(float(others @ others), 1e-12))
    return ratio, float(values @ others / max(np.sqrt(float(values @ values) * float(others @ others)), 1e-12))
