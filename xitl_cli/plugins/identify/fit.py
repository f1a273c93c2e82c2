"""Least squares over short windows: the vehicle's keys, and what else moved the boat.

Each window has its own initial state. These are eliminated in each step by variable projection (Golub and Pereyra 1973,
in Kaufman's form), so that scipy sees the vehicle's keys and the nuisance parameters alone: current, wind and biases of
each recording, the delay of the commands and of the position. Windows do not have to join: gusts and waves between
windows do not become errors of the model, as they would in one long simulation.

Between solutions, the noise of each quantity is estimated from its residuals, and large residuals get Huber's weights.
`sandwich.py` has the standard errors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares  # type: ignore[import-untyped]

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.plugins.identify.free_keys import FreeKey, priors, with_values
from xitl_cli.plugins.identify.recording import QUANTITIES, Floats
from xitl_cli.plugins.identify.sandwich import Sandwich
from xitl_cli.plugins.identify.windows import NAMES, OF_POSITION, OUTPUT_S, Simulator, Windows

SHARED = (("command delay", "s", 0.1), ("delay of position and velocity", "s", 0.1), ("delay of yaw rate", "s", 0.02))
OF_RECORDING = (
    ("current north", "m/s", 0.5),
    ("current east", "m/s", 0.5),
    ("yaw bias", "rad", 0.1),
    ("yaw rate bias", "rad/s", 0.01),
    ("wind north", "m/s", 3.0),
    ("wind east", "m/s", 3.0),
)
"""Nuisance parameters: name, unit, standard deviation before the fit. Wind is relative to the water.

Where wind was measured, it is the error of this measurement, with a standard deviation of MEASURED_WIND_MPS before.
"""
MEASURED_WIND_MPS = 0.5

_WIND = 4
_LOCAL = 6  # north, east, yaw, velocity ahead and to starboard, yaw rate
_STEPS = np.array([1e-4, 1e-3, 1e-3, 1e-3])  # rad, m/s, m/s, rad/s
_MOST_CHANGE = np.array([20.0, 20.0, 0.5, 1.0, 1.0, 0.5])
"""Largest correction of an initial state in a round."""
_FAR, _FARTHEST = 1e3, 4.0
_KEY_STEP, _DELAY_STEP_S, _WIND_STEP_MPS, _SMALL = 2e-3, 0.01, 0.05, 1e-5
_HUBER = 2.0
_DELAY_OF = np.array([{"yaw": 0, "yaw_rate": 2}.get(name, 1) for name in NAMES])
"""Number in SHARED of the delay of each quantity. Yaw gives the time: 0 stands for none."""
_LEAST_NOISE = 2e-4
_ROUNDS, _WEIGHING_ROUNDS, _STEPS_PER_ROUND, _SETTLED = 6, 3, 3, 0.3


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of a fit of P keys and Q nuisance parameters to W windows."""

    keys: tuple[FreeKey, ...]
    vessel: VesselSpec
    """The vehicle with the fitted values."""
    x: Floats
    """(P + Q,) keys as in FreeKey, then SHARED, then OF_RECORDING for each recording."""
    sandwich: Sandwich
    """Of the P + Q values of x."""
    prior: Floats
    """(P + Q,) standard deviations before the fit."""
    noise: dict[str, float]
    """Standard deviation of the residuals of each quantity, robust."""
    windows: Windows
    starts: Floats
    """(W, 6) fitted motion at the start of each window; velocities relative to the water."""
    rounds: int
    evaluations: int

    @property
    def sigma(self) -> Floats:
        """Standard errors of x."""
        return self.sandwich.sigma(np.eye(len(self.x)))

    def nuisance(self, number: int) -> Floats:
        """Return SHARED and OF_RECORDING of one recording."""
        first = len(self.keys) + len(SHARED)
        own = self.x[first + number * len(OF_RECORDING) :][: len(OF_RECORDING)]
        return np.concatenate([self.x[len(self.keys) : first], own])


@dataclass(slots=True)
class _Problem:
    """The residuals of the windows as a function of x, with the windows' initial states eliminated."""

    vessel: VesselSpec
    keys: tuple[FreeKey, ...]
    windows: Windows
    plant: Simulator
    prior: Floats
    starts: Floats
    weight: Floats
    """(M,) of each residual: root of Huber's weight over the noise."""
    wind: bool
    robust: bool
    evaluations: int = 0
    _rows: list[slice] = field(default_factory=list)
    _moved_at: bytes = b""
    _moved_kept: tuple[Floats, Floats, Floats] | None = None
    _slopes_at: bytes = b""
    _slopes_kept: Floats | None = None

    def __post_init__(self) -> None:
        ends = np.searchsorted(self.windows.window, np.arange(len(self.windows) + 1))
        self._rows = [slice(first, last) for first, last in pairwise(ends)]

    # Residuals
    def residuals(self, x: Floats) -> Floats:
        """Return weighted residuals without the part that other initial states explain, then those of the priors."""
        _, base, local = self._moved(x)
        residual = (base - self.windows.values) * self.weight
        return np.concatenate([self._projected(local, residual[:, None])[:, 0], x / self.prior])

    def jacobian(self, x: Floats) -> Floats:
        """Return the derivatives of `residuals`."""
        slopes = self._slopes(x) * self.weight[:, None]
        return np.concatenate([self._projected(self._moved(x)[2], slopes), np.diag(1.0 / self.prior)])

    def improve_starts(self, x: Floats) -> None:
        """Replace the initial states by those that fit best at x, by one linear step.

        A window whose motion would diverge keeps its initial state.
        """
        _, base, local = self._moved(x)
        before = self.starts.copy()
        residual, weight = (base - self.windows.values) * self.weight, self.weight[:, None]
        for window, rows in enumerate(self._rows):
            change = np.linalg.lstsq(local[rows] * weight[rows], residual[rows], rcond=1e-9)[0]
            self.starts[window] -= np.clip(change, -_MOST_CHANGE, _MOST_CHANGE)
        self._moved_at = self._slopes_at = b""
        follows = np.isfinite(self._moved(x)[0]).all(axis=(0, 2))
        if not follows.all():
            self.starts[~follows] = before[~follows]
            self._moved_at = self._slopes_at = b""

    def reweighted(self, x: Floats) -> dict[str, float]:
        """Weight the residuals at x anew, and return the noise of each quantity, robust."""
        residual = self.residuals(x)[: len(self.windows.window)] / self.weight
        noise, code = {}, self.windows.quantity
        if np.abs(residual).max() >= 0.5 * _FAR:
            raise UserError("the simulated motion is not finite; begin with other values in the vehicle's file")
        for number in np.unique(code):
            own = code == number
            sigma = max(1.4826 * float(np.median(np.abs(residual[own]))), _LEAST_NOISE)
            share = np.minimum(1.0, _HUBER * sigma / np.maximum(np.abs(residual[own]), 1e-12)) if self.robust else 1.0
            self.weight[own] = np.sqrt(share) / sigma
            noise[NAMES[number]] = sigma
        return noise

    def _projected(self, local: Floats, columns: Floats) -> Floats:
        """Return columns without the part in the space of the initial states of their window."""
        result = columns.copy()
        for rows in self._rows:
            # An orthonormal basis of the columns, with columns of 0 where they depend on each other
            left, values, _ = np.linalg.svd(local[rows] * self.weight[rows, None], full_matrices=False)
            basis = left * (values > 1e-9 * max(float(values[0]), 1e-300))
            result[rows] -= basis @ (basis.T @ columns[rows])
        return result

    # Simulated samples, without weights
    def _moved(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Return motion (K, W, 6), its samples (M,), and their derivatives by the initial states (M, 6)."""
        if self._moved_kept is not None and self._moved_at == x.tobytes():
            return self._moved_kept
        self.evaluations += 1
        count = len(self.windows)
        begin = np.tile(self.starts[:, 2:], (1 + len(_STEPS), 1))
        for number, step in enumerate(_STEPS, start=1):
            begin[number * count : (number + 1) * count, number - 1] += step
        try:
            motion = self._motion(x, begin)
        except UserError:
            if not x.any():
                raise
            motion = np.full((2, len(begin), 6), np.nan)  # a step to values that no vessel has is taken back
        parts = [motion[:, number * count : (number + 1) * count] for number in range(1 + len(_STEPS))]
        base = self._measured(parts[0], x)
        base = np.where(np.isfinite(base), base, _FAR)  # a step that makes the motion diverge is taken back
        local = np.zeros((len(base), _LOCAL))
        for column, code in enumerate(OF_POSITION):
            local[:, column] = self.windows.quantity == code
        for column, (part, step) in enumerate(zip(parts[1:], _STEPS, strict=True), start=2):
            local[:, column] = np.nan_to_num((self._measured(part, x) - base) / step, posinf=0.0, neginf=0.0)
        self._moved_at, self._moved_kept = x.tobytes(), (parts[0], base, local)
        return self._moved_kept

    def _slopes(self, x: Floats) -> Floats:
        """Return the derivatives of the samples by x, (M, P + Q)."""
        if self._slopes_kept is not None and self._slopes_at == x.tobytes():
            return self._slopes_kept
        base_motion, base, _ = self._moved(x)
        columns = np.zeros((len(base), len(x)))
        keys, first = len(self.keys), len(self.keys) + len(SHARED)
        winds = [axis for axis in range(len(OF_RECORDING)) if axis >= _WIND]
        for column in range(first + len(OF_RECORDING) * len(self.windows.recordings)):
            if column >= first and (column - first) % len(OF_RECORDING) in winds:
                continue
            step = _KEY_STEP if column < keys else _DELAY_STEP_S if column == keys else _SMALL
            other = x.copy()
            other[column] += step
            motion = self._motion(other, self.starts[:, 2:]) if column <= keys else base_motion
            columns[:, column] = self._slope(motion, other, base, step)
        of_sample = self.windows.of[self.windows.window]
        for axis in winds if self.wind else ():  # wind acts on the windows of its recording alone: all at once
            other = x.copy()
            other[first + axis :: len(OF_RECORDING)] += _WIND_STEP_MPS
            slope = self._slope(self._motion(other, self.starts[:, 2:]), other, base, _WIND_STEP_MPS)
            columns[np.arange(len(base)), first + axis + len(OF_RECORDING) * of_sample] = slope
        self._slopes_at, self._slopes_kept = x.tobytes(), columns
        return columns

    def _slope(self, motion: Floats, other: Floats, base: Floats, step: float) -> Floats:
        return np.nan_to_num((self._measured(motion, other) - base) / step, posinf=0.0, neginf=0.0)

    # Simulation and measurement
    def _motion(self, x: Floats, begin: Floats) -> Floats:
        """Return the motion of all windows."""
        vessel = with_values(self.vessel, self.keys, x[: len(self.keys)])
        repeats = len(begin) // len(self.windows)
        commands = np.tile(self.windows.commands(float(x[len(self.keys)])), (repeats, 1, 1))
        around = self._of_windows(x)
        before, wind = self.windows.before(around[:, :2], around[:, 2]), self.windows.wind() + around[:, None, _WIND:]
        return self.plant.motion(vessel, np.tile(before, (repeats, 1)), begin, commands, np.tile(wind, (repeats, 1, 1)))

    def _of_windows(self, x: Floats) -> Floats:
        """Return the nuisance parameters of the recording of each window, (W, 6)."""
        own = x[len(self.keys) + len(SHARED) :].reshape(-1, len(OF_RECORDING))
        return own[self.windows.of]

    def _measured(self, motion: Floats, x: Floats) -> Floats:
        """Return what the sensors show of a motion, (M,)."""
        shared = x[len(self.keys) : len(self.keys) + len(SHARED)]
        return measured(self.windows, motion, self.starts[:, :2], self._of_windows(x), shared)


def measured(windows: Windows, motion: Floats, place_m: Floats, nuisance: Floats, shared: Floats) -> Floats:
    """Return the samples that a motion would give, (M,).

    motion: (K, W, 6), see `Simulator.motion`. place_m: (W, 2) at the start. nuisance: (W, 6) of OF_RECORDING.
    shared: (3,) of SHARED.
    """
    window, code = windows.window, windows.quantity
    offset_s = windows.offset_s - np.array([0.0, shared[1], shared[2]])[_DELAY_OF[code]]
    at = offset_s / OUTPUT_S
    state = _between(motion, window, at)
    third = windows.width_s / OUTPUT_S / 3.0  # a mean of samples is compared with a mean
    rate = (_between(motion, window, at - third) + state + _between(motion, window, at + third))[:, 5] / 3.0
    current, (yaw_bias, rate_bias) = nuisance[window, :2], nuisance[window, 2:4].T
    place = place_m[window] + state[:, :2] + current * offset_s[:, None]
    north, east = (state[:, 3:5] + current).T
    shown_yaw = state[:, 2] + yaw_bias  # velocities of the body are those of the receiver, turned by the measured yaw
    cos, sin = np.cos(shown_yaw), np.sin(shown_yaw)
    of_quantity: dict[str, Callable[[], Floats]] = {
        "north": lambda: place[:, 0],
        "east": lambda: place[:, 1],
        "yaw": lambda: shown_yaw,
        "vel_north": lambda: north,
        "vel_east": lambda: east,
        "yaw_rate": lambda: rate + rate_bias,
        "surge": lambda: cos * north + sin * east,
        "sway": lambda: cos * east - sin * north,
    }
    result = np.empty(len(window))
    for number, name in enumerate(NAMES):
        own = code == number
        result[own] = of_quantity[name]()[own]
    return result


def _between(motion: Floats, window: NDArray[np.intp], at: Floats) -> Floats:
    """Return the motion of windows between its instants, (M, 6)."""
    before = np.clip(at.astype(np.int64), 0, len(motion) - 2)
    share = (at - before)[:, None]
    result: Floats = (1.0 - share) * motion[before, window] + share * motion[before + 1, window]
    return result


def fit(
    vessel: VesselSpec,
    keys: Sequence[FreeKey],
    windows: Windows,
    water: Water,
    *,
    wind: bool = True,
    robust: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> Fit:
    """Fit the keys to windows; without keys, the nuisance parameters alone. Raises UserError if the motion diverges.

    wind: fit a mean wind for each recording, if the vehicle has areas in the wind. robust: use Huber's weights.
    """
    if float(vessel.wind.lateral_area_m2) == 0.0:
        wind = False
    nuisance = [np.array([sigma for _, _, sigma in SHARED])]
    for recording in windows.recordings:
        own = np.array([sigma for _, _, sigma in OF_RECORDING])
        if recording.wind_ne_mps is not None:
            own[_WIND:] = MEASURED_WIND_MPS
        nuisance.append(own)
    prior = np.concatenate([priors(keys), *nuisance])
    noise = np.array([sigma for _, sigma in QUANTITIES.values()])
    weight = 1.0 / noise[windows.quantity]
    problem = _Problem(vessel, tuple(keys), windows, Simulator(water), prior, windows.starts(), weight, wind, robust)
    x, of_quantity = np.zeros(len(prior)), {}
    for number in range(1, _ROUNDS + 1):
        before = x
        solution = least_squares(
            problem.residuals,
            x,
            jac=problem.jacobian,
            bounds=(-_FARTHEST * prior, _FARTHEST * prior),
            x_scale=prior,
            max_nfev=_STEPS_PER_ROUND,
            xtol=1e-4,
            ftol=1e-5,
        )
        x = solution.x
        moved = np.abs(x - before) / np.sqrt(np.diag(np.linalg.inv(solution.jac.T @ solution.jac)))
        say(f"round {number}: largest change {moved.max():.2f} of its standard error")
        problem.improve_starts(x)
        if number <= _WEIGHING_ROUNDS:
            of_quantity = problem.reweighted(x)
        elif moved.max() < _SETTLED:
            break
    fitted = with_values(vessel, keys, x[: len(keys)])
    return Fit(
        tuple(keys),
        fitted,
        x,
        _sandwich(problem, x),
        prior,
        of_quantity,
        windows,
        problem.starts,
        number,
        problem.evaluations,
    )


def _sandwich(problem: _Problem, x: Floats) -> Sandwich:
    windows, count = problem.windows, len(problem.windows.window)
    residual, jacobian = problem.residuals(x)[:count], problem.jacobian(x)[:count]
    apart_s = np.abs(windows.start_s[:, None] - windows.start_s)
    adjacent = (windows.of[:, None] == windows.of) & (apart_s > 0.0) & (apart_s < 1.5 * windows.length_s)
    return Sandwich.from_windows(residual, jacobian, problem._rows, adjacent.astype(np.float64), problem.prior)
