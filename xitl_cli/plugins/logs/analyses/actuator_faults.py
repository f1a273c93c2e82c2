"""Faults of propellers and rudders, from the vessel's response to commands.

The changes of yaw rate and surge speed over a second are fitted by least squares to the commands, to the motion and to
wind and current. For each span, the same model is fitted with the commands of a faulty actuator inside of the span: it
lost thrust, turns against its command, or is stuck. The fault is the one that improves the fit most.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Finding
from xitl_cli.logs.model.table import Flags, Floats, Stamps
from xitl_cli.logs.signals import yaw, yaw_rate
from xitl_cli.logs.signals.receivers import gnss_receivers, injected_receivers
from xitl_cli.logs.signals.sensors import injected_units
from xitl_cli.logs.signals.series import Series, make_series
from xitl_cli.logs.signals.spans import runs
from xitl_cli.logs.signals.states import parameter_values, vehicle_kind
from xitl_cli.plugins.logs.analyses.outputs import OutputChannel, driven_outputs

RATE_HZ = 5.0
_STRIDE = 2  # samples between rows of the fit
_REACH = 5  # samples over which a change is computed
_LAGS_S = (0.0, 0.2, 0.4, 0.8, 1.6)
_FEWEST_ROWS = 100
_LENGTHS_S = (10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0, 30.0, 35.0, 40.0, 50.0, 60.0)
_MOST_SPANS = 2000
_EVEN, _LINEAR, _ODD = range(3)
"""First columns of the commands: the part of the thrust that is equal ahead and astern, and the other parts."""
_ASTERN_LESS, _ASTERN_SPREAD = 0.2, 0.2
"""Part of the thrust of a command that does not change its sign with it, as share of the part that does. 0.2 is a
propeller that gives two thirds of its thrust astern."""
_SIZES: Mapping[str, Sequence[float]] = {
    "thrust_loss": tuple(np.linspace(0.2, 1.0, 5)),
    "reversed": (1.0,),
    "stuck": tuple(np.linspace(-1.0, 1.0, 21)),
}
"""Sizes of each kind in the search."""
_FEW_SIZES: Mapping[str, Sequence[float]] = {
    "thrust_loss": (0.5, 1.0),
    "reversed": (1.0,),
    "stuck": (-0.9, -0.6, -0.3, 0.2, 0.5, 0.7, 0.9),
}
"""Those for the choice of a lag."""
Spans = NDArray[np.intp]
LEAST_GAIN, LEAST_STEERING_GAIN = 120.0, 100.0
"""Least improvement of the fit in units of its variance, for a propeller and for a rudder or gear. In 18 runs without a
fault of an actuator, it was under 40, but for 65 in a collision and 84 with a weak battery."""
_DEFIED_GAIN, _DEFIED, _DEFIED_SHARE = 55.0, 0.5, 0.7
"""Least improvement for a rudder or gear whose commands were far from where it is stuck, and how far for which share of
the time."""
_LEAST_APART = 0.15
"""Least mean distance of the commands of a stuck actuator from where it is stuck. Nearer ones show errors of the model:
in wind and current, a straight leg at 80 % of the throttle looked like a propeller that is stuck at 93 %."""
_SEARCHED_GAIN = 40.0
_SHORTEST_NS = 10_000_000_000
_BRIEF_S, _BRIEF_GAIN = 5.0, 2.0
"""A shorter fault, of at least this length, needs this multiple of the improvement."""
_EARLY_NS = 5_000_000_000
"""Time from the first motion in which a fault needs the same: the start differs from all motion after it."""
_SURE, _SURE_SHARE, _SHOWN = 12.0, 0.02, 1.0
"""Effect that excludes an onset (in units of the variance of a row, and as share of the improvement by the fault), and
least effect of a row that counts."""
_LATE_ROWS, _SURE_ROWS = 12, 7
"""Rows (0.4 s) without effect after which a fault has an onset that does not show, and that make an onset uncertain."""
LEAST_LOSS = 0.25
"""Least share of lost thrust that is reported: wind and waves cause less."""
_MOST_FAULTS = 5
_AS_GOOD = 0.9
"""Share of the improvement of the best explanation that makes another one possible."""
_PAUSE_NS = 10_000_000_000
_HANDICAPS = {"reversed": (0.0, 0.0), "thrust_loss": (20.0, 0.01), "stuck": (40.0, 0.05)}
"""Improvement of the fit by which a kind must exceed one with less freedom: in units of its variance, and as share of
the whole improvement. An actuator that is stuck at the command of its onset has no free size, and no handicap."""
_SLOWS_S, _PUSHES, _WAY_MPS = 5.0, 0.05, 1.0
"""A propeller is not reversed if a vessel that it would push astern, by so much of one propeller's full thrust, goes
ahead at so many m/s over ground in the second half of the fault, which is at least so long."""
_SAME_COMMAND = 0.05
"""Accuracy of the command at which an actuator is stuck."""


_UNANSWERED_S, _UNANSWERED_MOMENT, _UNANSWERED_RADPS = 6.0, 0.3, 0.08
_LASTING = 0.7
"""Share of its turn rate that a vessel keeps if it does not follow a command against it."""


@dataclass(frozen=True, slots=True)
class VesselMotion:
    """Samples at `RATE_HZ`, without missing values. Body axes are forward and starboard; speeds are over ground."""

    stamp_ns: Stamps
    yaw_rate_radps: Floats
    """(M,)"""
    surge_mps: Floats
    """(M,)"""
    sway_mps: Floats
    """(M,)"""
    yaw_rad: Floats
    """(M,)"""
    commands: Floats
    """(M, A) from -1 to 1."""
    steers: Flags
    """(A,) whether each output steers."""


@dataclass(frozen=True, slots=True)
class DetectedFault:
    """A fault of one actuator."""

    kind: str
    """thrust_loss, reversed or stuck."""
    output: int
    """Index among the commands."""
    from_ns: int
    until_ns: int | None
    size: float
    """Lost share, or the command at which the actuator is stuck."""
    turns: float
    """Sign of the yaw moment of a stuck actuator, positive to starboard."""
    gain: float
    """Improvement of the fit, in units of its variance."""
    began_ns: tuple[int, int] | None = None
    """Earliest and latest onset if the commands do not determine it, as those of a stuck propeller at its speed."""
    other: DetectedFault | None = None
    """Another kind of fault of this output that explains nearly as much: the commands do not distinguish them."""


def actuator_findings(log: Log, clock: LogClock) -> Iterator[Finding]:
    if vehicle_kind(log) != "rover":
        return
    driven = [
        output for output in driven_outputs(log, parameter_values(log)) if np.ptp(np.nan_to_num(output.command)) > 0.1
    ]
    motion = vessel_motion(log, driven)
    if motion is None:
        return
    faults = actuator_faults(motion)
    for turn in unanswered_turns(motion):
        if not any(
            fault.from_ns < turn.until_ns and turn.from_ns < (fault.until_ns or turn.until_ns) for fault in faults
        ):
            turned, commanded = ("starboard", "port") if turn.yaw_rate_radps > 0.0 else ("port", "starboard")
            rate = f"{abs(np.degrees(turn.yaw_rate_radps)):.0f} deg/s"
            yield Finding.warning(
                "actuation.unanswered",
                f"From {clock.text(turn.from_ns)} to {clock.text(turn.until_ns)} the vessel did not answer its "
                f"commands: it turned to {turned} at {rate} while they were to {commanded}",
                (Evidence(*_message_and_field(driven[0].series), turn.from_ns, turn.until_ns, rate),),
                "Check the propellers, the rudders and their wires: is one reversed, without thrust or stuck?",
            )
    for fault in faults:
        output = driven[fault.output]
        end_ns = fault.until_ns or int(motion.stamp_ns[-1])
        until = "the end of the log" if fault.until_ns is None else clock.text(fault.until_ns)
        sentence = f"From {clock.text(fault.from_ns)} to {until} the vessel answers as if {output.name} "
        sentence += _as_if(fault, output)
        if fault.other is not None:
            sentence += f", or {_as_if(fault.other, output)}: its commands varied too little to tell"
        if fault.began_ns is not None:
            earliest, latest = (clock.text(at_ns) for at_ns in fault.began_ns)
            sentence += (
                f"; it began between {earliest} and {latest}, as its commands hardly differed from it in this time"
            )
        yield Finding.warning(
            f"actuation.{fault.kind}",
            sentence,
            (Evidence(*_message_and_field(output.series), fault.from_ns, end_ns, f"{fault.size:.2f}"),),
            "Check this propeller or rudder, its gear, its motor and its wires: it did not do what was commanded.",
        )


def _as_if(fault: DetectedFault, output: OutputChannel) -> str:
    if fault.kind == "thrust_loss":
        return f"lost {100.0 * fault.size:.0f} % of its thrust"
    if fault.kind == "reversed":
        return "turned against its command"
    side = "starboard" if fault.turns > 0.0 else "port"
    if output.drives:
        return f"stayed at {100.0 * fault.size:.0f} % of its range, whatever it was commanded to"
    return f"stayed at {100.0 * abs(fault.size):.0f} % of its range to {side}, whatever it was commanded to"


def _message_and_field(series: Series) -> tuple[str, str]:
    message, _, field = series.source.partition(".")
    return message, field


def vessel_motion(log: Log, driven: Sequence[OutputChannel]) -> VesselMotion | None:
    """Longest time in which the vehicle was armed; None if heading, speed or commands are not logged."""
    turning, heading = _turning(log), yaw(log)
    velocity = None
    if receivers := gnss_receivers(log) or injected_receivers(log):
        fixed = receivers[0].fix >= 3
        velocity = make_series(receivers[0].stamp_ns[fixed], receivers[0].vel_ned_mps[fixed, :2], "m/s", "velocity")
    if turning is None or heading is None or velocity is None or not any(output.drives for output in driven):
        return None
    commands = [
        series
        for output in driven
        if (series := make_series(output.series.stamp_ns, output.command, "", output.name)) is not None
    ]
    if len(commands) != len(driven):
        return None
    needed = (turning, heading, velocity, *commands)
    begin = max(int(series.stamp_ns[0]) for series in needed)
    end = min(int(series.stamp_ns[-1]) for series in needed)
    step_ns = round(1e9 / RATE_HZ)
    many = (end - begin) // step_ns
    if not _FEWEST_ROWS * _STRIDE < many < 200_000:
        return None
    at_ns = begin + step_ns * np.arange(many, dtype=np.int64)
    armed = make_series(driven[0].series.stamp_ns, driven[0].armed.astype(np.float64), "", "armed")
    on = np.ones(many, dtype=np.bool_) if armed is None else armed.interpolated(at_ns) > 0.99
    if not on.any():
        return None
    psi = np.radians(heading.interpolated(at_ns))
    north, east = velocity.interpolated(at_ns).T
    at_ns, psi, north, east = at_ns[on], psi[on], north[on], east[on]
    return VesselMotion(
        at_ns,
        np.radians(_averaged(turning, at_ns)),
        north * np.cos(psi) + east * np.sin(psi),
        east * np.cos(psi) - north * np.sin(psi),
        psi,
        np.stack([_averaged(series, at_ns) for series in commands], axis=1),
        np.array([not output.drives for output in driven]),
    )


def _turning(log: Log) -> Series | None:
    """Turn rate in deg/s. For an xitl recording, this is the gyroscope, which has no filter delay."""
    for unit in injected_units(log):
        if unit.gyro_radps is not None:
            return make_series(unit.stamp_ns, np.degrees(unit.gyro_radps[:, 2]), "deg/s", unit.name)
    return yaw_rate(log)


def _averaged(series: Series, at_ns: Stamps) -> Floats:
    """(M,) means around each instant, over the interval to its neighbours."""
    span_ns = np.diff(series.stamp_ns, prepend=series.stamp_ns[0]).astype(np.float64) * 1e-9
    way = make_series(series.stamp_ns, np.cumsum(series.values * span_ns), "", series.source)
    assert way is not None
    half_ns = round(0.5e9 / RATE_HZ)
    first, last = int(series.stamp_ns[0]), int(series.stamp_ns[-1])
    low, high = np.clip(at_ns - half_ns, first, last), np.clip(at_ns + half_ns, first, last)
    mean: Floats = (way.interpolated(high) - way.interpolated(low)) / np.maximum((high - low) * 1e-9, 1e-9)
    return mean


@dataclass(frozen=True)
class _Fit:
    """Rows of the fit."""

    motion: VesselMotion
    commands: Floats
    given_sides: Floats | None = None
    """(P,) sides of the propellers; None if the motion determines them."""

    @cached_property
    def rows(self) -> Stamps:
        """(N,) first sample of each row, without rows that span a pause."""
        first = np.arange(0, len(self.motion.stamp_ns) - _REACH, _STRIDE, dtype=np.int64)
        stamps = self.motion.stamp_ns
        whole = stamps[first + _REACH] - stamps[first] < 1.5e9 * _REACH / RATE_HZ
        return first[whole]

    @cached_property
    def sides(self) -> Floats:
        """(P,) of the propellers: sign of the yaw moment of each when it drives ahead.

        The moments of a symmetric vessel cancel. Their mean is therefore an error, such as that of a fault.
        """
        if self.given_sides is not None:
            return self.given_sides
        motion = self.motion
        drives = self.commands[:, ~motion.steers]
        turning = motion.yaw_rate_radps
        design = self._means([np.ones(len(turning)), turning, *(drives * np.abs(drives)).T])
        moments = np.linalg.lstsq(design, self.changes[0], rcond=None)[0][2:]
        sides: Floats = np.sign(moments - moments.mean())
        return sides

    @cached_property
    def turns(self) -> Floats:
        """(A,) sign of the yaw moment of a positive command of each output."""
        motion, turns = self.motion, np.zeros(self.commands.shape[1])
        turns[~motion.steers] = self.sides
        design = self._means([np.ones(len(self.commands)), motion.yaw_rate_radps, *self.commands[:, motion.steers].T])
        turns[motion.steers] = np.sign(np.linalg.lstsq(design, self.changes[0], rcond=None)[0][2:])
        return turns

    @cached_property
    def changes(self) -> tuple[Floats, Floats]:
        turning, surge = self.motion.yaw_rate_radps, self.motion.surge_mps
        return (turning[self.rows + _REACH] - turning[self.rows], surge[self.rows + _REACH] - surge[self.rows])

    @cached_property
    def motion_columns(self) -> tuple[Floats, Floats]:
        """Columns (N, F) of wind, current and drag for yaw rate and for surge, averaged over the second of each row."""
        moving = self.motion
        turning, surge, sway = moving.yaw_rate_radps, moving.surge_mps, moving.sway_mps
        wind = [np.ones(len(turning)), np.cos(moving.yaw_rad), np.sin(moving.yaw_rad)]
        yawing = [*wind, turning, turning * np.abs(turning), surge * turning, sway, surge * sway]
        along = [*wind, surge, surge * np.abs(surge), turning**2, turning * sway]
        return self._means(yawing), self._means(along)

    def command_columns(self, commands: Floats, shares: Floats | None = None) -> tuple[Floats, Floats]:
        """Columns (N, K) of thrust, then of rudders, averaged as `motion_columns`.

        shares: (A,) share of the usual thrust that each output gives; None for all of it.
        """
        steers, surge = self.motion.steers, self.motion.surge_mps
        drives, steering = commands[:, ~steers], commands[:, steers]
        share = np.ones(drives.shape[1]) if shares is None else shares[~steers]
        squared = drives * np.abs(drives)
        thrust = squared @ share
        # Assume equal propellers, with the same lever arm on both sides.
        parts = (drives**2, drives, squared + _ASTERN_LESS * drives**2)
        yawing = [part @ (share * self.sides) for part in parts]
        along = [part @ share for part in parts]
        for angle in steering.T:
            yawing += [angle, angle * surge * np.abs(surge), angle * thrust]
            along += [angle**2 * thrust]
        return self._means(yawing), self._means(along)

    def _means(self, columns: Sequence[Floats]) -> Floats:
        summed = np.concatenate([np.zeros((1, len(columns))), np.cumsum(np.stack(columns, axis=1), axis=0)])
        means: Floats = (summed[self.rows + _REACH] - summed[self.rows]) / RATE_HZ
        return means

    def lagged(self, lag_s: float) -> _Fit:
        """The fit with commands delayed by a first-order lag."""
        if lag_s <= 0.0:
            return self
        share = 1.0 - float(np.exp(-1.0 / (RATE_HZ * lag_s)))
        slow = np.empty_like(self.commands)
        for output, commands in enumerate(self.commands.T.tolist()):
            slow[:, output] = list(accumulate(commands, lambda state, command: state + share * (command - state)))
        return _Fit(self.motion, slow, self.sides)  # a wrong lag can turn the sides round


def actuator_faults(motion: VesselMotion) -> list[DetectedFault]:
    """Faults in order of time; none if the motion is too short to be judged."""
    first = _Fit(motion, motion.commands)
    if len(first.rows) < _FEWEST_ROWS:
        return []
    # Noise of both changes
    scales: list[float] = []
    columns = zip(first.command_columns(first.commands), first.motion_columns, strict=True)
    for design, change in zip(map(np.hstack, columns), first.changes, strict=True):
        residual = change - design @ np.linalg.lstsq(design, change, rcond=None)[0]
        scales.append(1.4826 * float(np.median(np.abs(residual))) + 1e-9)
    # Choose the lag by the best fit with a fault: a fault that the model lacks makes a wrong lag look good.
    searches = [_Search(first.lagged(lag_s), scales) for lag_s in _LAGS_S]
    search = min(searches, key=_Search.least_squares)
    faults: list[DetectedFault] = []
    while len(faults) < _MOST_FAULTS and (fault := search.next_fault()) is not None:
        faults.append(fault)
    joined = _joined(sorted(faults, key=lambda fault: fault.from_ns))
    return [fault for fault in joined if _certain(fault, motion)]


@dataclass(frozen=True, slots=True)
class UnansweredTurn:
    """A time in which a vessel turned against its commands without slowing down."""

    from_ns: int
    until_ns: int
    yaw_rate_radps: float
    """Mean, positive to starboard."""


def unanswered_turns(motion: VesselMotion) -> list[UnansweredTurn]:
    """Turns against the commands, which show a fault also where the response model does not hold."""
    fit = _Fit(motion, motion.commands)
    if len(fit.rows) < _FEWEST_ROWS:
        return []
    commands, drives = motion.commands, ~motion.steers
    moments = np.where(drives, commands * np.abs(commands), commands) * fit.turns
    counted = moments[:, motion.steers] if motion.steers.any() else moments
    moment, rate = counted.mean(axis=1), motion.yaw_rate_radps
    against = (moment * rate < 0.0) & (np.abs(moment) > _UNANSWERED_MOMENT) & (np.abs(rate) > _UNANSWERED_RADPS)
    if motion.steers.any():  # a rudder needs thrust or speed
        against &= motion.surge_mps > 0.5
    stamps = motion.stamp_ns
    turns = []
    for begin, after in runs(against):
        third = (after - begin) // 3
        whole = stamps[after - 1] - stamps[begin] < 1.5e9 * (after - begin) / RATE_HZ
        if not whole or after - begin < _UNANSWERED_S * RATE_HZ:
            continue
        if abs(rate[after - third : after].mean()) >= _LASTING * abs(rate[begin : begin + third].mean()):
            turns.append(UnansweredTurn(int(stamps[begin]), int(stamps[after - 1]), float(rate[begin:after].mean())))
    return turns


def _certain(fault: DetectedFault, motion: VesselMotion) -> bool:
    """Whether the fault is long and large enough to exclude wind, waves and model errors."""
    until_ns = int(motion.stamp_ns[-1]) if fault.until_ns is None else fault.until_ns
    least = LEAST_STEERING_GAIN if motion.steers[fault.output] else LEAST_GAIN
    if fault.kind == "stuck":
        during = (motion.stamp_ns >= fault.from_ns) & (motion.stamp_ns <= until_ns)
        apart = np.abs(motion.commands[during, fault.output] - fault.size)
        if float(np.mean(apart)) < _LEAST_APART:
            return False
        if motion.steers[fault.output] and float(np.mean(apart > _DEFIED)) >= _DEFIED_SHARE:
            least = _DEFIED_GAIN
    enough = fault.kind != "thrust_loss" or fault.size >= LEAST_LOSS
    length_ns = until_ns - (fault.from_ns if fault.began_ns is None else fault.began_ns[0])
    early = fault.from_ns - int(motion.stamp_ns[0]) < _EARLY_NS
    if length_ns < _SHORTEST_NS or early:
        return enough and fault.gain >= _BRIEF_GAIN * least and length_ns * 1e-9 >= _BRIEF_S
    return enough and fault.gain >= least


def _joined(faults: Sequence[DetectedFault]) -> list[DetectedFault]:
    """Join the same fault on both sides of a short pause, in which it was not visible."""
    joined: list[DetectedFault] = []
    for fault in faults:
        last = joined[-1] if joined else None
        same = last is not None and (last.kind, last.output) == (fault.kind, fault.output)
        if last is not None and same and last.until_ns and fault.from_ns - last.until_ns < _PAUSE_NS:
            size = last.size if last.gain >= fault.gain else fault.size
            gain = last.gain + fault.gain
            joined[-1] = replace(last, until_ns=fault.until_ns, size=size, gain=gain)
        else:
            joined.append(fault)
    return joined


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    """A fault of one output, of unknown time."""

    kind: str
    output: int
    size: float
    """As that of `ActuatorFault`."""


class _Change:
    """The fit of one change, in units of its noise.

    The columns of the motion are the same for every fault. They are eliminated once, so that each hypothesis and span
    solves for the few coefficients of the commands only.
    """

    def __init__(self, commands: Floats, motion: Floats, change: Floats, scale: float) -> None:
        """commands: (N, K). motion: (N, F). change: (N,)."""
        self._change = change / scale
        self._motion = motion / _norms(motion)
        self._norms = _norms(commands)
        self.commands = commands / self._norms
        """(N, K)"""
        # A vessel seldom drives astern. Without a limit, a reversed propeller could then give any thrust.
        self._ridge = 1e-4 * len(change)
        rest = np.hstack([self.commands[:, _ODD:], self._motion])
        odd = np.linalg.solve(rest.T @ rest + self._ridge * np.eye(rest.shape[1]), rest.T @ self._change)[0]
        self._prior = np.full(commands.shape[1], self._ridge)
        """(K,) weights of squared coefficients."""
        self._prior[_EVEN] += 1.0 / max(_ASTERN_SPREAD * abs(float(odd)), 1e-3) ** 2
        self.use_rows(np.ones(len(change), dtype=np.bool_))

    def use_rows(self, sound: Flags) -> None:
        """Fit these rows (N,), and eliminate the motion from them."""
        self._sound = sound
        motion, change = self._motion.T * sound, self._change * sound
        factor = np.linalg.cholesky(motion @ motion.T + self._ridge * np.eye(len(motion)))
        self._white = np.linalg.solve(factor, motion)  # (F, N)
        along = self._white @ change
        self._left = change - along @ self._white
        self.squares = float(change @ change - along @ along)
        """Squared residuals without the commands."""

    def scaled(self, commands: Floats) -> Floats:
        """Columns of other commands, in the units of `commands`."""
        return commands / self._norms

    def sums(self, commands: Floats) -> Floats:
        """(K, K + F + 1, N + 1) cumulative products of the columns, from the first row to each row."""
        columns = commands.T * self._sound
        others = np.concatenate([columns, self._white, self._left[None]])
        sums = np.zeros((len(columns), len(others), columns.shape[1] + 1))
        np.cumsum(columns[:, None] * others, axis=2, out=sums[:, :, 1:])
        return sums

    def equations(self, sums: Floats) -> tuple[Floats, Floats]:
        """Normal equations (K, K, S) and (K, S) of the commands, from the products (K, K + F + 1, S) of S spans."""
        many = len(sums)
        across = sums[:, many:-1]
        gram = sums[:, :many] - np.einsum("ifs,jfs->ijs", across, across)
        gram[np.arange(many), np.arange(many)] += self._prior[:, None]
        return gram, sums[:, -1]


@dataclass(frozen=True, slots=True)
class _Candidate:
    """Best span of a hypothesis, and the squared residuals of all rows with it."""

    squares: float
    span: tuple[int, int]
    hypothesis: _Hypothesis


def _squares_of(candidate: _Candidate) -> float:
    return candidate.squares


class _Search:
    """Search over spans and hypotheses, with both changes in units of their noise.

    One model is fitted to all rows. Inside of the span, its commands are those of the hypothesis. Rows in which a
    faulty vessel spins therefore also determine the model.
    """

    def __init__(self, fit: _Fit, scales: Sequence[float]) -> None:
        self._fit = fit
        columns = zip(fit.command_columns(fit.commands), fit.motion_columns, fit.changes, scales, strict=True)
        self._changes = [_Change(*parts) for parts in columns]
        self._free = np.ones(len(fit.rows), dtype=np.bool_)
        """(N,) rows without an earlier fault."""
        self._sound = np.ones(len(fit.rows), dtype=np.bool_)
        """(N,) rows that determine the model."""
        self._hypotheses = _hypotheses(fit.motion.steers, _SIZES)

    def least_squares(self) -> float:
        """Squared residuals with the best of a few faults."""
        usual, spans = self._usual_sums(), self._spans()
        few = _hypotheses(self._fit.motion.steers, _FEW_SIZES)
        if not len(spans):
            return float("inf")
        best = min(self._coarse(usual, spans, few), key=_squares_of)
        near = self._near(best.span)
        return min(best.squares, self._best_span(best.hypothesis, _outside(usual, near), near).squares)

    def _columns(self, hypothesis: _Hypothesis) -> list[Floats]:
        """Columns of the commands of a vessel that has the fault all the time."""
        commands, shares = self._fit.commands.copy(), np.ones(self._fit.commands.shape[1])
        output = hypothesis.output
        if hypothesis.kind == "thrust_loss":
            shares[output] = 1.0 - hypothesis.size
        else:
            commands[:, output] = -commands[:, output] if hypothesis.kind == "reversed" else hypothesis.size
        both = self._fit.command_columns(commands, shares)
        return [change.scaled(columns) for change, columns in zip(self._changes, both, strict=True)]

    def _usual_sums(self) -> list[Floats]:
        return [change.sums(change.commands) for change in self._changes]

    def _best_span(self, hypothesis: _Hypothesis, outside: Sequence[Floats], spans: Spans) -> _Candidate:
        """The span (of S, 2) with the least squared residuals of all rows. outside: as `_outside` returns it."""
        squares = np.full(len(spans), sum(change.squares for change in self._changes))
        for change, sound_part, columns in zip(self._changes, outside, self._columns(hypothesis), strict=True):
            squares -= _explained(*change.equations(sound_part + _between(change.sums(columns), spans)))
        best = int(np.argmin(squares))
        return _Candidate(float(squares[best]), (int(spans[best, 0]), int(spans[best, 1])), hypothesis)

    def next_fault(self) -> DetectedFault | None:
        """The fault that improves the fit most, in rows without an earlier fault.

        The model keeps the fault: later searches start from commands that contain it.
        """
        spans = self._spans()
        if not len(spans):
            return None
        usual = self._usual_sums()
        whole = 0.0  # squared residuals without a further fault
        for change, sums in zip(self._changes, usual, strict=True):
            whole += change.squares - float(_explained(*change.equations(sums[:, :, -1:].copy()))[0])
        refined = self._refined(usual, self._coarse(usual, spans, self._hypotheses))
        refined = [candidate for candidate in refined if not self._keeps_way(candidate)]
        least = min(candidate.squares for candidate in refined)
        variance = least / (2.0 * float(self._sound.sum()))  # of a row

        def handicapped(candidate: _Candidate) -> float:
            times, share = (0.0, 0.0) if self._froze(candidate) else _HANDICAPS[candidate.hypothesis.kind]
            return candidate.squares + times * variance + share * (whole - least)

        ranked = sorted(refined, key=handicapped)
        chosen = ranked[0]
        gain = (whole - chosen.squares) / max(variance, 1e-9)
        if gain < _SEARCHED_GAIN:
            return None
        chosen, within = self._onset(usual, chosen, variance, gain)
        self._keep(chosen)
        rivals = [
            self._fault(candidate, gain)
            for candidate in ranked[1:]
            if candidate.hypothesis.output == chosen.hypothesis.output
            and whole - candidate.squares >= _AS_GOOD * (whole - chosen.squares)
        ]
        fault = self._fault(chosen, gain)
        began = (self._at_ns(within[0]), self._at_ns(within[1]))
        if within[1] - within[0] > _SURE_ROWS:
            fault = replace(fault, began_ns=began)
        return replace(fault, other=rivals[0] if rivals else None)

    def _froze(self, candidate: _Candidate) -> bool:
        """Whether an actuator is stuck at a command of its onset, within the second of that row."""
        hypothesis, begin = candidate.hypothesis, int(self._fit.rows[candidate.span[0]])
        commands = self._fit.motion.commands[begin : begin + _REACH + 1, hypothesis.output]
        within = commands.min() - _SAME_COMMAND <= hypothesis.size <= commands.max() + _SAME_COMMAND
        return hypothesis.kind == "stuck" and bool(within)

    def _keeps_way(self, candidate: _Candidate) -> bool:
        """Whether the vessel keeps its speed although a reversed propeller would push it astern."""
        if candidate.hypothesis.kind != "reversed":
            return False
        rows, motion = self._fit.rows, self._fit.motion
        begin, end = (int(rows[min(row, len(rows) - 1)]) for row in candidate.span)
        middle = (begin + end) // 2
        if end - middle < _SLOWS_S * RATE_HZ:
            return False
        drives = motion.commands[middle:end] * ~motion.steers
        pushes = drives * np.abs(drives)
        reversed_pushes = pushes.sum(axis=1) - 2.0 * pushes[:, candidate.hypothesis.output]
        return float(np.mean(reversed_pushes)) < -_PUSHES and float(np.mean(motion.surge_mps[middle:end])) > _WAY_MPS

    def _onset(
        self, usual: Sequence[Floats], chosen: _Candidate, variance: float, gain: float
    ) -> tuple[_Candidate, tuple[int, int]]:
        """The candidate with the onset at which it shows, and the rows between which it began.

        An actuator that is stuck at its command, or lost thrust at rest, does not show until the command changes.
        """
        begin, after = chosen.span
        shown = np.zeros(len(self._free))
        span = np.array([chosen.span])
        outside = _outside(usual, span)
        for change, columns, sound_part in zip(self._changes, self._columns(chosen.hypothesis), outside, strict=True):
            gram, moment = change.equations(sound_part + _between(change.sums(columns), span))
            shown += ((columns - change.commands) @ np.linalg.solve(gram[:, :, 0], moment[:, 0])) ** 2
        shown /= max(variance, 1e-9)
        sure = max(_SURE, _SURE_SHARE * gain)
        so_far = np.cumsum(np.where(shown > _SHOWN, shown, 0.0))
        start = so_far[begin - 1] if begin else 0.0
        last = min(int(np.searchsorted(so_far, start + sure)), after - 1)
        first = int(np.searchsorted(so_far, start - sure)) if begin else 0
        taken = np.flatnonzero(~self._free[:begin])
        first = min(max(first, int(taken[-1]) + 1 if len(taken) else 0), begin)
        return (replace(chosen, span=(last, after)) if last - begin > _LATE_ROWS else chosen), (first, last)

    def _at_ns(self, row: int) -> int:
        """Middle of the interval of a row."""
        return int(self._fit.motion.stamp_ns[self._fit.rows][row]) + round(0.5e9 * _REACH / RATE_HZ)

    def _keep(self, chosen: _Candidate) -> None:
        begin, after = chosen.span
        for end in chosen.span:  # a row that spans an end has both commands
            self._sound[max(end - _REACH // _STRIDE, 0) : end + _REACH // _STRIDE] = False
        self._free[begin:after] = False
        for change, columns in zip(self._changes, self._columns(chosen.hypothesis), strict=True):
            change.commands[begin:after] = columns[begin:after]
            change.use_rows(self._sound)

    def _coarse(self, usual: Sequence[Floats], spans: Spans, hypotheses: Sequence[_Hypothesis]) -> list[_Candidate]:
        """The best span of each hypothesis."""
        outside = _outside(usual, spans)
        return [self._best_span(hypothesis, outside, spans) for hypothesis in hypotheses]

    def _refined(self, usual: Sequence[Floats], candidates: Sequence[_Candidate]) -> list[_Candidate]:
        """The best of each kind and output, with ends to a row and a finer size."""
        groups: dict[tuple[str, int], list[_Candidate]] = {}
        for candidate in candidates:
            groups.setdefault((candidate.hypothesis.kind, candidate.hypothesis.output), []).append(candidate)
        refined = []
        for (kind, _), group in groups.items():
            best = min(group, key=_squares_of)
            smallest = 0.0 if kind == "thrust_loss" else -1.0
            for step in (0.0, 0.05, 0.02):
                steps = (0.0,) if kind == "reversed" or not step else (-2 * step, -step, 0.0, step, 2 * step)
                sizes = [best.hypothesis.size + change for change in steps]
                near = self._near(best.span)
                outside = _outside(usual, near)
                for hypothesis in [replace(best.hypothesis, size=size) for size in sizes if smallest <= size <= 1.0]:
                    best = min(best, self._best_span(hypothesis, outside, near), key=_squares_of)
            refined.append(best)
        return refined

    def _near(self, span: tuple[int, int]) -> Spans:
        """Spans with ends near those of a span."""
        reach, many = round(6.0 * RATE_HZ / _STRIDE), len(self._free)
        begins = np.arange(max(span[0] - reach, 0), min(span[0] + reach, many) + 1)
        ends = np.arange(max(span[1] - reach, 0), min(span[1] + reach, many) + 1)
        if span[1] >= many - reach:
            ends = np.append(ends, many)
        spans = np.stack(np.meshgrid(begins, ends, indexing="ij"), axis=-1).reshape(-1, 2)
        return _possible(spans, self._free, round(0.5 * _LENGTHS_S[0] * RATE_HZ / _STRIDE))

    def _fault(self, chosen: _Candidate, gain: float) -> DetectedFault:
        begin, after = chosen.span
        until_ns = None if after >= len(self._free) - 2 else self._at_ns(after)
        of, from_ns = chosen.hypothesis, self._at_ns(begin)
        turns = float(self._fit.turns[of.output] * np.sign(of.size))
        return DetectedFault(of.kind, of.output, from_ns, until_ns, of.size, turns, gain)

    def _spans(self) -> Spans:
        many = len(self._free)
        lengths = [round(length_s * RATE_HZ / _STRIDE) for length_s in _LENGTHS_S]
        stride = max(round(2.0 * RATE_HZ / _STRIDE), many * (len(lengths) + 1) // _MOST_SPANS)
        begins = range(0, many - lengths[0], stride)
        spans = [(begin, begin + length) for begin in begins for length in lengths if begin + length <= many]
        spans += [(begin, many) for begin in begins if many - begin > lengths[-1]]
        return _possible(np.array(spans, dtype=np.intp).reshape(-1, 2), self._free, 1)


def _hypotheses(steers: Flags, sizes: Mapping[str, Sequence[float]]) -> list[_Hypothesis]:
    return [
        _Hypothesis(kind, output, float(size))
        for output, steering in enumerate(steers)
        for kind, known in sizes.items()
        if kind == "stuck" or not steering
        for size in known
    ]


def _possible(spans: Spans, free: Flags, fewest: int) -> Spans:
    """The spans (S, 2) of enough rows that are all free, with enough rows outside."""
    taken = np.concatenate([[0], np.cumsum(~free)])
    length = spans[:, 1] - spans[:, 0]
    whole = taken[np.maximum(spans[:, 1], spans[:, 0])] == taken[spans[:, 0]]
    possible: Spans = spans[(length >= fewest) & whole & (len(free) - length >= _FEWEST_ROWS // 2)]
    return possible


def _norms(columns: Floats) -> Floats:
    """Root mean square of each column."""
    norms: Floats = np.sqrt(np.mean(columns**2, axis=0)) + 1e-9
    return norms


def _between(sums: Floats, spans: Spans) -> Floats:
    """(K, M, S) sums of the rows of each span (S, 2), from cumulative sums (K, M, N + 1)."""
    within: Floats = sums.take(spans[:, 1], axis=2)
    within -= sums.take(spans[:, 0], axis=2)
    return within


def _outside(usual: Sequence[Floats], spans: Spans) -> list[Floats]:
    """(K, M, S) sums of the rows outside of each span for each change, which are the same for every hypothesis."""
    return [sums[:, :, -1:] - _between(sums, spans) for sums in usual]


def _explained(gram: Floats, moment: Floats) -> Floats:
    """(S,) squares that S fits explain, moment' gram⁻¹ moment, by elimination in all of them at once.

    gram: (K, K, S). moment: (K, S). Both are overwritten.
    """
    explained = np.zeros(moment.shape[1])
    for row in range(len(moment)):
        explained += moment[row] ** 2 / gram[row, row]
        factors = gram[row + 1 :, row] / gram[row, row]
        moment[row + 1 :] -= factors * moment[row]
        gram[row + 1 :, row + 1 :] -= factors[:, None] * gram[row, row + 1 :]
    return explained
