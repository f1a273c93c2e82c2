"""Errors of predictions over windows, next to those of a boat that keeps its velocity and of a linear model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from xitl_cli.plugins.identify.fit import OF_RECORDING, SHARED, Fit, fit
from xitl_cli.plugins.identify.recording import Floats, Recording
from xitl_cli.plugins.identify.windows import OUTPUT_S, Simulator, Windows, cut, relative_to_water

HORIZONS_S = (1.0, 5.0, 10.0, 30.0)
MODELS = ("identified", "start", "linear", "persistence")
SCORES = ("surge (m/s)", "sway (m/s)", "yaw rate (rad/s)", "position (m)", "heading (deg)")
_STEP_S = 0.2
_INTEGRAL_S = 1.0


@dataclass(frozen=True, slots=True)
class Score:
    """Root mean square errors of one model over windows of one length."""

    model: str
    horizon_s: float
    windows: int
    errors: tuple[float, ...]
    """As in SCORES: velocities over the window, position and heading at its end."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """One predicted window, for a plot."""

    source: str
    time_s: Floats
    measured: Floats
    """(K, 3) velocity ahead, to starboard and of the yaw."""
    predicted: Floats
    """(K, 3) by the identified vehicle."""
    before: Floats
    """(K, 3) by the vehicle before the fit."""


@dataclass(frozen=True, slots=True)
class LinearModel:
    """The rates of the velocities as a linear function of velocities and thrusts, by least squares."""

    matrix: Floats
    """(3 + C + 1, 3)."""

    @classmethod
    def from_recordings(cls, recordings: Sequence[Recording]) -> LinearModel:
        """Fit the changes over 1 s to the means over it."""
        terms, changes = [], []
        for recording in recordings:
            first_s, last_s = recording.span_s
            time_s = np.arange(first_s, last_s, _STEP_S)
            velocity = recording.motion_at(time_s)[:, 3:]
            thrust = _thrust(recording.mean_commands(time_s))
            rows = _terms(0.5 * (velocity[1:] + velocity[:-1]), thrust)
            width = round(_INTEGRAL_S / _STEP_S)
            total = np.cumsum(np.concatenate([np.zeros((1, rows.shape[1])), rows]), axis=0) * _STEP_S
            terms.append(total[width:] - total[:-width])
            changes.append(velocity[width:] - velocity[:-width])
        matrix = np.linalg.lstsq(np.concatenate(terms), np.concatenate(changes), rcond=None)[0]
        return cls(matrix)

    def velocities(self, start: Floats, commands: Floats) -> Floats:
        """Return (E + 1, W, 3) for (W, 3) velocities and (W, E, C) mean commands of steps of 0.2 s."""
        result = [start]
        for step in range(commands.shape[1]):
            rate = _terms(result[-1], _thrust(commands[:, step])) @ self.matrix
            middle = result[-1] + 0.5 * _STEP_S * rate
            result.append(result[-1] + _STEP_S * (_terms(middle, _thrust(commands[:, step])) @ self.matrix))
        return np.stack(result)


def _thrust(commands: Floats) -> Floats:
    return commands * np.abs(commands)


def _terms(velocity: Floats, thrust: Floats) -> Floats:
    return np.concatenate([velocity, thrust, np.ones((len(velocity), 1))], axis=1)


def _paths(velocity: Floats, start: Floats) -> Floats:
    """Return (E + 1, W, 6) of motion from (E + 1, W, 3) body velocities and (W, 6) starts."""
    result = np.zeros((*velocity.shape[:2], 6))
    result[:, :, 3:] = velocity
    turn = 0.5 * (velocity[1:, :, 2] + velocity[:-1, :, 2]) * _STEP_S
    result[:, :, 2] = start[:, 2] + np.concatenate([np.zeros((1, len(start))), np.cumsum(turn, axis=0)])
    ne = _turned(velocity[:, :, :2], result[:, :, 2])
    way = np.cumsum(0.5 * (ne[1:] + ne[:-1]) * _STEP_S, axis=0)
    result[0, :, :2] = start[:, :2]
    result[1:, :, :2] = start[:, :2] + way
    return result


class Predictor:
    """Predicts windows of recordings from the measured motion at their start."""

    def __init__(self, fitted: Fit, start: Fit, linear: LinearModel, water: Water) -> None:
        self._fits = {"identified": fitted, "start": start}
        self._linear, self._plant = linear, Simulator(water)

    def motions(self, windows: Windows) -> dict[str, Floats]:
        """Return (E + 1, W, 6) north, east, yaw and body velocities over ground, every 0.2 s, by each of MODELS."""
        start = windows.starts()
        edges = np.arange(round(windows.length_s / _STEP_S) + 1) * _STEP_S
        commands = np.concatenate(
            [
                own.mean_commands(windows.start_s[windows.of == number, None] + edges)
                for number, own in enumerate(windows.recordings)
            ]
        )
        result = {name: self._simulated(own, windows, start) for name, own in self._fits.items()}
        result["linear"] = _paths(self._linear.velocities(start[:, 3:], commands), start)
        result["persistence"] = _paths(np.tile(start[:, 3:], (len(edges), 1, 1)), start)
        return result

    def _simulated(self, fitted: Fit, windows: Windows, start: Floats) -> Floats:
        nuisance = np.stack([fitted.nuisance(number) for number in range(len(windows.recordings))])[windows.of]
        first = len(SHARED)
        delay_s, bias = float(nuisance[0, 0]), nuisance[:, first + 2]
        current = nuisance[:, first : first + 2]
        wind = windows.wind() + nuisance[:, None, first + 4 : first + 6]
        begin = relative_to_water(start, current, bias)
        motion = self._plant.motion(
            fitted.vessel, windows.before(current, bias), begin, windows.commands(delay_s), wind
        )
        motion = motion[:: round(_STEP_S / OUTPUT_S)][: round(windows.length_s / _STEP_S) + 1]
        time_s = np.arange(len(motion))[:, None, None] * _STEP_S
        yaw = motion[:, :, 2] + bias
        place = start[:, :2] + motion[:, :, :2] + current * time_s
        body = _turned(motion[:, :, 3:5] + current, -yaw)
        return np.concatenate([place, yaw[:, :, None], body, motion[:, :, 5:]], axis=2)


def _turned(vector: Floats, angle_rad: Floats) -> Floats:
    """Return (..., 2) vectors turned by angles (...), from north to east."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([cos * vector[..., 0] - sin * vector[..., 1], sin * vector[..., 0] + cos * vector[..., 1]], axis=-1)


def measured_motion(windows: Windows, steps: int) -> Floats:
    """Return (steps, W, 6) of the measured motion every 0.2 s."""
    time_s = windows.start_s[:, None] + np.arange(steps) * _STEP_S
    parts = [
        own.motion_at(time_s[windows.of == number].ravel()).reshape(-1, steps, 6)
        for number, own in enumerate(windows.recordings)
    ]
    return np.concatenate(parts).transpose(1, 0, 2)


def scores(predictor: Predictor, recordings: Sequence[Recording]) -> tuple[list[Score], list[Prediction]]:
    """Return the scores of all models over each length that fits into the recordings, and windows of 30 s for plots."""
    result, plots = [], []
    longest_s = max(last - first for first, last in (own.span_s for own in recordings))
    for horizon_s in (own for own in HORIZONS_S if own + 5.0 < longest_s):
        windows = cut(recordings, horizon_s, max(horizon_s, 2.0))
        predicted = predictor.motions(windows)
        measured = measured_motion(windows, len(predicted["identified"]))
        for model in MODELS:
            apart = predicted[model] - measured
            velocity = np.sqrt(np.mean(apart[1:, :, 3:] ** 2, axis=(0, 1)))
            position = np.sqrt(np.mean(np.sum(apart[-1, :, :2] ** 2, axis=1)))
            heading = np.degrees(np.sqrt(np.mean(apart[-1, :, 2] ** 2)))
            result.append(
                Score(model, horizon_s, len(windows), (*map(float, velocity), float(position), float(heading)))
            )
        if horizon_s >= HORIZONS_S[-2]:
            plots = [
                Prediction(
                    recordings[windows.of[number]].source,
                    windows.start_s[number] + np.arange(len(measured)) * _STEP_S,
                    measured[:, number, 3:],
                    predicted["identified"][:, number, 3:],
                    predicted["start"][:, number, 3:],
                )
                for number in range(len(windows))
            ]
    return result, plots


def without_surroundings(fitted: Fit, recordings: Sequence[Recording]) -> Fit:
    """Return the vehicle in still water and in the measured wind, with recordings without biases and delays."""
    return replace(fitted, keys=(), x=np.zeros(len(SHARED) + len(OF_RECORDING) * len(recordings)))


def surroundings_of(fitted: Fit, recordings: Sequence[Recording], water: Water, *, wind: bool) -> Fit:
    """Return the current, wind and biases of other recordings, with the vehicle held."""
    return fit(fitted.vessel, (), cut(recordings, fitted.windows.length_s), water, wind=wind)
