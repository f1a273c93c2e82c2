"""`xitl identify vessel`: from logs and a first vehicle to the identified vehicle with its scores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import Vessel
from xitl_cli.errors import UserError
from xitl_cli.plugins.identify.fit import OF_RECORDING, SHARED, Fit, fit
from xitl_cli.plugins.identify.free_keys import FreeKey, free_keys, with_values
from xitl_cli.plugins.identify.prediction import (
    SCORES,
    LinearModel,
    Prediction,
    Predictor,
    Score,
    scores,
    surroundings_of,
    without_surroundings,
)
from xitl_cli.plugins.identify.recording import Floats, Recording
from xitl_cli.plugins.identify.response import check_response
from xitl_cli.plugins.identify.windows import Windows, cut

UNDETERMINED = 0.3
"""Standard error of a key, as a share of its value, above which the logs do not determine it."""
CORRELATED = 0.9
_FEWEST_WINDOWS = 6
_TEST_SHARE = 0.3
_FAR_WORSE = 1.5
_RAN_AWAY = 2.5  # prior deviations: by the prior, one key in eighty is that far off

_MANOEUVRES = (
    (("reverse",), "hold half throttle astern for 10 s, from rest"),
    (("spin_up", "spin_down"), "change the throttle in steps of 50 % or more, and log the outputs at 50 Hz"),
    (("sway", "cross_flow", "Y_", "1.1"), "turn hard while coasting, so that the boat slides sideways"),
    (("yaw", "N_", "5.5", "inertia"), "turn on the spot in steps of both directions, and let the turn decay"),
    (("surge", "X_", "0.0"), "accelerate in steps to full speed, and let the boat coast to rest"),
    (("rudder", "steering"), "sail zig-zags of 10° and 20° at two speeds"),
)


@dataclass(frozen=True, slots=True)
class KeyEstimate:
    """A fitted key."""

    key: str
    start: float
    value: float
    sigma: float
    advice: str
    """Manoeuvre that would determine it; empty if these logs do."""


@dataclass(frozen=True, slots=True)
class Identification:
    """Result of the command."""

    start: VesselSpec
    vessel: VesselSpec
    keys: tuple[KeyEstimate, ...]
    figures: tuple[Figure, ...]
    correlated: tuple[tuple[str, str, float], ...]
    nuisance: tuple[tuple[str, str, float, float, str], ...]
    """Log, name, value, standard error and unit."""
    noise: dict[str, float]
    trained: tuple[str, ...]
    tested: tuple[str, ...]
    scores: tuple[Score, ...]
    predictions: tuple[Prediction, ...]
    windows: int
    evaluations: int

    def as_json(self) -> dict[str, Any]:
        """Return JSON types."""
        return {
            "vehicle": self.vessel.name,
            "keys": {
                own.key: {"start": own.start, "value": own.value, "sigma": own.sigma, "advice": own.advice}
                for own in self.keys
            },
            "figures": {own.name: {"value": own.value, "sigma": own.sigma, "unit": own.unit} for own in self.figures},
            "correlated": [list(pair) for pair in self.correlated],
            "nuisance": [list(own) for own in self.nuisance],
            "noise": self.noise,
            "trained": list(self.trained),
            "tested": list(self.tested),
            "scores": [
                {"model": own.model, "horizon_s": own.horizon_s, "windows": own.windows}
                | dict(zip(SCORES, own.errors, strict=True))
                for own in self.scores
            ],
            "windows": self.windows,
        }


@dataclass(frozen=True, slots=True)
class Settings:
    """What the command asks for."""

    free: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    window_s: float = 10.0
    wind: bool = True
    robust: bool = True
    surroundings: bool = True
    """Whether current, wind, biases and delays of the tested logs are fitted."""


def split(recordings: Sequence[Recording], tested: Sequence[str]) -> tuple[list[Recording], list[Recording]]:
    """Return recordings to fit and to test: the named ones, every third, or the last 30 % of a single one.

    Raises UserError when nothing remains to fit.
    """
    if tested:
        sources = [own.source for own in recordings]
        if unknown := [name for name in tested if name not in sources]:
            raise UserError(f"--test {unknown[0]} is none of the logs; name it among the LOGs too")
        training = [own for own in recordings if own.source not in tested]
        if not training:
            raise UserError("--test names all logs; leave at least one of them for the fit")
        return training, [own for own in recordings if own.source in tested]
    if len(recordings) > 2:
        marked = list(enumerate(recordings))
        return [own for number, own in marked if number % 3 != 2], [own for number, own in marked if number % 3 == 2]
    training, testing = [], []
    for own in recordings:
        first_s, last_s = own.span_s
        middle_s = last_s - _TEST_SHARE * (last_s - first_s)
        training.append(own.part(first_s, middle_s))
        testing.append(own.part(middle_s, last_s))
    return training, testing


def identify(
    recordings: Sequence[Recording],
    start: VesselSpec,
    water: Water,
    settings: Settings,
    tested: Sequence[str] = (),
    say: Callable[[str], None] = lambda text: None,
) -> Identification:
    """Fit the vehicle and test its predictions. Raises UserError, with what to record next."""
    keys = free_keys(start, settings.free, settings.fixed)
    for recording in recordings:
        check_response(recording, start, water, settings.window_s)
    training, testing = split(recordings, tested)
    windows = cut(training, settings.window_s)
    if len(windows) < _FEWEST_WINDOWS:
        raise UserError(
            f"the logs have {len(windows)} windows of {settings.window_s:g} s to fit; record "
            f"{_FEWEST_WINDOWS * settings.window_s:g} s or more of manoeuvres, or use a shorter --window"
        )
    fitted = fit(start, keys, windows, water, wind=settings.wind, robust=settings.robust, say=say)
    say("predicting the tested logs")
    around = without_surroundings(fitted, testing)
    if settings.surroundings:
        around = surroundings_of(fitted, testing, water, wind=settings.wind)
    before = replace(around, vessel=start)
    predictor = Predictor(around, before, LinearModel.from_recordings(training), water)
    own_scores, predictions = scores(predictor, testing)
    _check_follows(own_scores)
    sigma = fitted.sigma
    return Identification(
        start,
        fitted.vessel,
        tuple(
            _estimate(key, float(x), float(error), float(prior))
            for key, x, error, prior in zip(keys, fitted.x, sigma, fitted.prior, strict=False)
        ),
        figures(fitted, start, water, reached_speeds(training)),
        tuple(_correlated(fitted)),
        tuple(_nuisance(fitted, sigma, windows)),
        fitted.noise,
        tuple(own.source for own in training),
        tuple(own.source for own in testing),
        tuple(own_scores),
        tuple(predictions),
        len(windows),
        fitted.evaluations,
    )


def _check_follows(found: Sequence[Score]) -> None:
    """Raise UserError if a linear model predicts both surge and yaw rate far better."""
    by_model = {own.model: own for own in found if own.horizon_s == 5.0}
    if not by_model:
        return
    model, linear = by_model["identified"].errors, by_model["linear"].errors
    if all(model[axis] > _FAR_WORSE * linear[axis] for axis in (0, 2)):
        raise UserError(
            f"the model cannot follow these logs: over 5 s, its errors are {model[0]:.2f} m/s in surge and "
            f"{model[2]:.2f} rad/s in yaw rate, those of a linear model {linear[0]:.2f} and {linear[2]:.2f}; check "
            "sign and order of the outputs and the positions of the propellers, or record the manoeuvres of "
            "identify-excitation"
        )


def _estimate(key: FreeKey, x: float, sigma: float, prior: float) -> KeyEstimate:
    value, error = key.value(x), abs(key.slope(x)) * sigma
    advice = ""
    if error > UNDETERMINED * abs(value) or abs(x) > _RAN_AWAY * prior:
        fitting = (manoeuvre for parts, manoeuvre in _MANOEUVRES if any(part in key.key for part in parts))
        advice = next(fitting, "vary what this key acts on more, and fix it with --fix until then")
    return KeyEstimate(key.key, key.start, value, error, advice)


def _correlated(fitted: Fit) -> list[tuple[str, str, float]]:
    count, covariance = len(fitted.keys), fitted.sandwich.covariance()
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    return [
        (fitted.keys[i].key, fitted.keys[j].key, float(correlation[i, j]))
        for i in range(count)
        for j in range(i + 1, count)
        if abs(correlation[i, j]) > CORRELATED
    ]


def _nuisance(fitted: Fit, sigma: Floats, windows: Windows) -> list[tuple[str, str, float, float, str]]:
    count = len(fitted.keys)
    rows = [
        ("all", name, float(fitted.x[count + number]), float(sigma[count + number]), unit)
        for number, (name, unit, _) in enumerate(SHARED)
    ]
    for number, recording in enumerate(windows.recordings):
        first = count + len(SHARED) + number * len(OF_RECORDING)
        for offset, (name, unit, _) in enumerate(OF_RECORDING):
            at = first + offset
            rows.append((Path(recording.source).name, name, float(fitted.x[at]), float(sigma[at]), unit))
    return rows


AXES = (("surge", 0, "kg", "N s/m"), ("sway", 1, "kg", "N s/m"), ("yaw", 5, "kg m²", "N m s"))
_STEP = 1e-3
_FAST = 80.0
_STEP_S = 0.0025


@dataclass(frozen=True, slots=True)
class Figure:
    """An inertia, or a damping force over its speed at a speed that the logs reach."""

    name: str
    value: float
    sigma: float
    unit: str


def reached_speeds(recordings: Sequence[Recording]) -> Floats:
    """Return the speeds ahead, to starboard and of the yaw that logs stay below for 80 % of the time, (3,)."""
    parts = []
    for recording in recordings:
        first_s, last_s = recording.span_s
        parts.append(np.abs(recording.motion_at(np.arange(first_s, last_s, 0.5))[:, 3:]))
    speeds: Floats = np.percentile(np.concatenate(parts), _FAST, axis=0)
    return np.maximum(speeds, 1e-3)


def plane_figures(vessel: VesselSpec, water: Water, speeds: Floats) -> Floats:
    """Return (6,): mass plus added mass of surge, sway and yaw, then the damping of each over its speed."""
    made = Vessel.from_spec(vessel, water, _STEP_S).hydrodynamics
    mass = made.rigid_mass + made.added_mass
    axes = [axis for _, axis, _, _ in AXES]
    nu = np.zeros((3, 6))
    nu[np.arange(3), axes] = speeds
    force = np.concatenate(made.terms(nu), axis=1) @ made.wrench
    return np.concatenate([np.diag(mass)[axes], -force[np.arange(3), axes] / speeds])


def figures(fit: Fit, start: VesselSpec, water: Water, speeds: Floats) -> tuple[Figure, ...]:
    """Return the figures of a fit with their standard errors. start: the vehicle before the fit."""
    count = len(fit.keys)
    values = plane_figures(fit.vessel, water, speeds)
    slopes = np.zeros((len(values), len(fit.x)))
    for column in range(count):
        x = fit.x[:count].copy()
        x[column] += _STEP
        slopes[:, column] = (plane_figures(with_values(start, fit.keys, x), water, speeds) - values) / _STEP
    sigma = fit.sandwich.sigma(slopes)
    inertia = [f"inertia in {name}" for name, *_ in AXES]
    of_speed = zip(AXES, speeds, ("m/s", "m/s", "rad/s"), strict=True)
    damping = [f"damping in {axis[0]} at {speed:.2g} {unit}" for axis, speed, unit in of_speed]
    units = [axis[2] for axis in AXES] + [axis[3] for axis in AXES]
    return tuple(
        Figure(name, float(value), float(error), unit)
        for name, value, error, unit in zip([*inertia, *damping], values, sigma, units, strict=True)
    )
