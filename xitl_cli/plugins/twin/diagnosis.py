"""Names the difference between a boat and its model: a bank of Kalman filters with one change each.

All filters have the same states: motion, position, and the parameters in which a boat can differ. The nominal filter
lets the parameters wander slowly, which covers errors of the vehicle file and a slowly varying current. Each other
filter lets one kind of parameter change quickly for some seconds from an onset on. The filters linearise the model at
the nominal estimate, so they share one batch of the kernel.

The evidence for a kind is the log of the ratio between the likelihoods of its filters and of the nominal filter, with
all onsets equally likely (Willsky and Jones 1976, generalised likelihood ratio, with the mean in place of the maximum).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array, wrap_pi
from xitl_cli.plugins.twin.bank import MOTION, PREDICTED, LinearPrediction, ModelErrors
from xitl_cli.plugins.twin.boat import INTERVAL_S

LEARNING = 40
"""Intervals without alarms, in which the noise is learned."""
SETTLING = 10
"""Intervals until the first ones have set the motion."""
ONSETS, ONSET_EVERY = 20, 2
"""Number of onsets that are tried, and intervals between them."""
CHANGES_FOR_S = 6.0
"""Time over which a parameter may change after an onset."""
ALARM = 15.0
"""Evidence of an alarm. With 10, two clean runs of ten minutes had three false alarms; with 15, three had one."""
PERSISTENCE, CERTAIN, PATIENCE = 6, 0.95, 10
"""An alarm waits for this confidence in one kind, at most this number of intervals."""

REFINED = 0.5
"""Share of the change that the nominal filter may still correct after an alarm."""

_NOISE = np.array([0.08, 0.08, 0.012, 0.012, 0.15, 0.15])  # of a measured interval: m/s, rad, rad/s, m
_DRIVEN = np.array([0.03, 0.03, 0.006, 0.02, 0.02, 0.02])  # of the motion, by waves and gusts, per root of a second
_FORGET = 1.0 / 90.0
_CLIPPED = 6.0
_BURST, _MOST_BURST = 0.2, 9.0
"""Rate at which a burst of large innovations raises the noise, and its limit, as variances."""


@dataclass(frozen=True, slots=True)
class ChangeKind:
    """One kind of difference."""

    name: str
    """Name in records, such as `thrust of propeller 0`."""
    columns: tuple[int, ...]
    """Its parameters, counted from the first one."""
    change: float
    """Standard deviation of a change."""
    unit: str


@dataclass(frozen=True, slots=True)
class Alarm:
    """A difference that was found."""

    at_ns: int
    kind: str
    onset_ns: int
    confidence: float
    """Probability of this kind among all kinds."""
    size: float
    deviation: float
    unit: str
    runner_up: str


def kinds_of(propellers: Sequence[str]) -> tuple[ChangeKind, ...]:
    """Return the kinds for propellers with these names."""
    count = len(propellers)
    thrusts = [ChangeKind(f"thrust {name}", (number,), 0.3, "share") for number, name in enumerate(propellers)]
    return (
        *thrusts,
        ChangeKind("drag", (count,), 0.6, "share"),
        ChangeKind("current", (count + 1, count + 2), 0.3, "m/s"),
        ChangeKind("compass", (count + 3,), 0.2, "rad"),
        ChangeKind("gnss", (count + 4, count + 5), 4.0, "m"),
    )


@dataclass(slots=True)
class Diagnosis:
    """The filters.

    State: the motion at the end of an interval and its mean (12, see PREDICTED), then thrust shares (P), drag share,
    current (2), compass, GNSS (2), wind (2).

    The errors of compass and GNSS are added to the measured heading and position.
    """

    propellers: tuple[str, ...]
    alarm: float = field(default_factory=lambda: ALARM)
    kinds: tuple[ChangeKind, ...] = field(init=False)
    innovation: Array = field(init=False)
    """(6,) of the nominal filter, measured less predicted."""
    innovation_deviation: Array = field(init=False)
    count: int = 0
    _mean: Array = field(init=False)  # (B, n)
    _covariance: Array = field(init=False)  # (B, n, n)
    _evidence: Array = field(init=False)  # (B,)
    _began: Array = field(init=False)  # (B,) interval of the onset, -1 for an unused filter
    _noise_scale: Array = field(init=False)
    _wander: Array = field(init=False)
    _kind_of: Array = field(init=False)
    _crossed: int | None = None
    _burst: Array = field(init=False)

    def __post_init__(self) -> None:
        self.kinds = kinds_of(self.propellers)
        thrusters = len(self.propellers)
        filters, size = 1 + ONSETS * len(self.kinds), PREDICTED + thrusters + 8
        prior = np.concatenate(
            ([0.3, 0.3, 0.05, 0.05, 0.3, 0.3] * 2, [0.05] * thrusters, [0.1, 0.3, 0.3, 0.05, 1.0, 1.0, 3.0, 3.0])
        )
        self._wander = np.concatenate(([0.003] * thrusters, [0.004, 0.010, 0.010, 0.001, 0.08, 0.08, 0.3, 0.3]))
        self._mean = np.zeros((filters, size))
        self._mean[:, PREDICTED : PREDICTED + thrusters + 1] = 1.0
        self._covariance = np.tile(np.diag(prior**2), (filters, 1, 1))
        self._evidence = np.zeros(filters)
        self._began = np.full(filters, -1)
        self._noise_scale = np.ones(MOTION)
        self._burst = np.ones(MOTION)
        self.innovation, self.innovation_deviation = np.zeros(MOTION), np.ones(MOTION)
        self._kind_of = np.tile(np.arange(len(self.kinds)), ONSETS)

    def begin(self, motion: Array) -> None:
        """Start all filters at a measured motion (6,)."""
        self._mean[:, :PREDICTED] = np.tile(motion, 2)

    @property
    def motion(self) -> Array:
        """Estimated velocity north and east, heading and yaw rate, (4,)."""
        return self._mean[0, :4]

    @property
    def position_ne_m(self) -> Array:
        """Estimated position, (2,)."""
        return self._mean[0, 4:MOTION]

    @property
    def parameters(self) -> ModelErrors:
        """Nominal parameters of the model."""
        last = PREDICTED + len(self.propellers)
        mean = self._mean[0]
        return ModelErrors(
            np.maximum(mean[PREDICTED:last], 0.0), max(float(mean[last]), 0.0), mean[last + 1 : last + 3], mean[-2:]
        )

    @property
    def learned_noise(self) -> Array:
        """Standard deviation of a measured motion (6,) from the model, as learned."""
        noise: Array = _NOISE * np.sqrt(self._noise_scale)
        return noise

    def update(self, prediction: LinearPrediction, unknown: Array, measured: Array, end_ns: int) -> Alarm | None:
        """Advance all filters by one interval, with its measured motion (6,). Return an alarm, if one is due.

        unknown: deviation of the velocity ahead and of the yaw rate due to outputs between messages, (P, 2).
        """
        self.count += 1
        self._open_onset()
        self._predict(prediction, unknown)
        self._correct(measured)
        return self._decide(end_ns)

    def evidence(self) -> Array:
        """Return the log likelihood ratio of each kind, with all onsets equally likely."""
        values = np.where(self._began[1:] >= 0, self._evidence[1:] - self._evidence[0], -math.inf)
        by_onset = values.reshape(ONSETS, len(self.kinds))
        largest = np.maximum(by_onset.max(axis=0), -1e3)
        evidence: Array = largest + np.log(np.exp(by_onset - largest).sum(axis=0) / ONSETS + 1e-300)
        return evidence

    def probabilities(self) -> Array:
        """Return the probability of each kind, given that one of them holds."""
        evidence = self.evidence()
        weights = np.exp(evidence - evidence.max())
        share: Array = weights / weights.sum()
        return share

    def _open_onset(self) -> None:
        """Let the oldest filter of each kind begin anew at the nominal estimate."""
        if self.count < LEARNING or self.count % ONSET_EVERY or self._crossed is not None:
            return
        slot = self.count // ONSET_EVERY % ONSETS
        rows = slice(1 + slot * len(self.kinds), 1 + (slot + 1) * len(self.kinds))
        self._mean[rows], self._covariance[rows] = self._mean[0], self._covariance[0]
        self._evidence[rows] = self._evidence[0]
        self._began[rows] = self.count

    def _predict(self, prediction: LinearPrediction, unknown: Array) -> None:
        thrusters = len(self.propellers)
        size = self._mean.shape[1]
        # Transition at the nominal estimate; displacements add to the position
        step = np.eye(size)
        step[MOTION:PREDICTED] = 0.0
        step[MOTION + 4, 4] = step[MOTION + 5, 5] = 1.0
        first = PREDICTED + thrusters
        step[:PREDICTED, :4] = prediction.by_state
        step[:PREDICTED, PREDICTED:first] = prediction.by_thrust
        step[:PREDICTED, first] = prediction.by_drag
        step[:PREDICTED, first + 1 : first + 3] = prediction.by_current
        step[:PREDICTED, -2:] = prediction.by_wind
        nominal = self._mean[0].copy()
        moved = nominal.copy()
        moved[:PREDICTED] = prediction.motion
        turned = wrap_pi(prediction.motion[[2, MOTION + 2]] - nominal[2])
        moved[2], moved[MOTION + 2] = nominal[2] + turned
        moved[4:MOTION] += nominal[4:MOTION]
        moved[MOTION + 4 : PREDICTED] += nominal[4:MOTION]
        self._mean = moved + (self._mean - nominal) @ step.T
        # Noise: waves and gusts, outputs between messages, wandering parameters, the change of each filter's kind.
        # Outputs between messages: (6, 6), from unknown changes of velocity ahead and of yaw rate, (P, 2)
        cosine, sine = math.cos(self._mean[0, 2]), math.sin(self._mean[0, 2])
        ahead, turn = unknown.T
        half = 0.5 * INTERVAL_S
        columns = (cosine * ahead, sine * ahead, half * turn, turn, half * cosine * ahead, half * sine * ahead)
        effect = np.stack(columns)
        driven = np.diag(_DRIVEN**2) * INTERVAL_S + effect @ effect.T
        self._covariance = step @ self._covariance @ step.T
        self._covariance[:, :PREDICTED, :PREDICTED] += np.block([[driven, 0.5 * driven], [0.5 * driven, 0.4 * driven]])
        wander = np.tile(self._wander**2 * INTERVAL_S, (len(self._mean), 1))
        changing = (self._began[1:] >= 0) & (self.count - self._began[1:] < CHANGES_FOR_S / INTERVAL_S)
        for number, kind in enumerate(self.kinds):
            rows = 1 + np.flatnonzero(changing & (self._kind_of == number))
            for column in kind.columns:
                wander[rows, column] += kind.change**2 / CHANGES_FOR_S * INTERVAL_S
        diagonal = np.arange(PREDICTED, size)
        self._covariance[:, diagonal, diagonal] += wander

    def _correct(self, measured: Array) -> None:
        # What the boat measures of the state, (6, n)
        size = self._mean.shape[1]
        seen = np.zeros((MOTION, size))
        seen[:, MOTION:PREDICTED] = np.eye(MOTION)
        seen[2, size - 5] = seen[4, size - 4] = seen[5, size - 3] = 1.0
        expected = self._mean @ seen.T
        innovation = measured - expected
        innovation[:, 2] = wrap_pi(innovation[:, 2])
        spread = seen @ self._covariance @ seen.T + np.diag(_NOISE**2 * self._noise_scale * self._burst)
        self.innovation, self.innovation_deviation = innovation[0], np.sqrt(np.diagonal(spread[0]))
        gain = np.linalg.solve(spread, seen @ self._covariance).transpose(0, 2, 1)
        weighted = np.linalg.solve(spread, innovation[:, :, None])[:, :, 0]
        _, log_volume = np.linalg.slogdet(spread)
        likelihood = -0.5 * (np.vecdot(innovation, weighted) + log_volume)
        self._evidence += likelihood - likelihood[0]
        self._mean += (gain @ innovation[:, :, None])[:, :, 0]
        self._covariance -= gain @ seen @ self._covariance
        self._covariance = 0.5 * (self._covariance + self._covariance.transpose(0, 2, 1))
        # Follow the size of the innovations, so that waves of any height give the same rate of false alarms.
        if self.count <= SETTLING:
            return
        squared = np.minimum((self.innovation / self.innovation_deviation) ** 2, _CLIPPED)
        rate = max(1.0 / (self.count - SETTLING + 3), _FORGET)
        self._noise_scale *= 1.0 + rate * (squared - 1.0)
        self._burst *= 1.0 + _BURST * (squared - 1.0)
        self._burst = np.clip(self._burst, 1.0, _MOST_BURST)
        np.clip(self._noise_scale, 0.05, 400.0, out=self._noise_scale)

    def _decide(self, end_ns: int) -> Alarm | None:
        evidence = self.evidence()
        if evidence.max() < self.alarm:
            self._crossed = None
            return None
        if self._crossed is None:
            self._crossed = self.count
        share, waited = self.probabilities(), self.count - self._crossed
        if waited < PERSISTENCE or (share.max() < CERTAIN and waited < PATIENCE):
            return None
        # The alarm is of the likeliest kind, and the diagnosis goes on from its likeliest filter
        order = np.argsort(share)[::-1]
        number = int(order[0])
        rows = 1 + np.flatnonzero((self._kind_of == number) & (self._began[1:] >= 0))
        best = int(rows[np.argmax(self._evidence[rows])])
        kind = self.kinds[number]
        columns = [PREDICTED + column for column in kind.columns]
        value = self._mean[best, columns]
        size = float(value[0]) if len(value) == 1 else float(np.hypot(*value))
        deviation = float(np.sqrt(max(self._covariance[best, columns[0], columns[0]], 0.0)))
        onset_ns = end_ns - round((self.count - int(self._began[best]) + 1) * INTERVAL_S * 1e9)
        self._mean[:], self._covariance[:] = self._mean[best], self._covariance[best]
        self._covariance[:, columns, columns] += (REFINED * kind.change) ** 2
        self._evidence[:] = 0.0
        self._began[:] = -1
        self._crossed = None
        return Alarm(
            end_ns, kind.name, onset_ns, float(share[number]), size, deviation, kind.unit, self.kinds[order[1]].name
        )
