"""Faults of propellers and rudders, by the answer of the vessel to its commands before and after.

The changes of yaw rate and surge speed over a second are fitted by least squares to the commands, to the motion and to
wind and current. For each span, the rows outside of it give the model. The rows inside are then explained by the model
alone, or with an actuator that lost thrust, turns against its command, or stays where it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from xitl_cli.logs.analyses.outputs import OutputChannel, driven_outputs
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Finding
from xitl_cli.logs.model.table import Flags, Floats, Stamps
from xitl_cli.logs.signals import yaw, yaw_rate
from xitl_cli.logs.signals.receivers import GnssReceiver, gnss_receivers, injected_receivers
from xitl_cli.logs.signals.sensors import injected_units
from xitl_cli.logs.signals.series import Series, make_series
from xitl_cli.logs.signals.states import parameter_values, vehicle_kind

RATE_HZ = 5.0
_STRIDE = 2  # samples from one row of the fit to the next
_REACH = 5  # samples over which a change is taken
_LAGS_S = (0.0, 0.2, 0.4, 0.8, 1.6)
_FEWEST_ROWS = 100
_LENGTHS_S = (10.0, 12.5, 15.0, 17.5, 20.0, 22.5, 25.0, 30.0, 35.0, 40.0, 50.0, 60.0)
_MOST_SPANS = 2000
_STUCK_AT = np.linspace(-1.0, 1.0, 21)
LEAST_GAIN, LEAST_STEERING_GAIN = 200.0, 100.0
"""Least improvement of the fit in units of its variance, of a propeller and of a rudder or gear.

Chosen by 21 runs without such a fault. One of them reached 209 for eight seconds, which the shortest span excludes; the
others reached 87. Ten further runs, of other seeds, gave at most 46.
"""
_SEARCHED_GAIN = 40.0
_SHORTEST_NS = 10_000_000_000
LEAST_LOSS = 0.25
"""Least share of lost thrust that is named: wind and waves take less."""
_EXPLAINED = 0.5
_MOST_FAULTS = 5
_AS_GOOD = 0.05
_AS_GOOD_REVERSED = 0.35  # it has no size that could be fitted
_AMBIGUOUS = 0.35
_PAUSE_NS = 10_000_000_000
_ORDER = ("reversed", "thrust_loss", "stuck")


@dataclass(frozen=True, slots=True)
class VesselMotion:
    """Samples at `RATE_HZ`, in which nothing is missing. commands: (M, A) from -1 to 1. steers: (A,) of the outputs.

    yaw_rate_radps, surge_mps, sway_mps, yaw_rad: (M,), body axes forward and starboard, speeds over ground.
    """

    stamp_ns: Stamps
    yaw_rate_radps: Floats
    surge_mps: Floats
    sway_mps: Floats
    yaw_rad: Floats
    commands: Floats
    steers: Flags


@dataclass(frozen=True, slots=True)
class ActuatorFault:
    """kind: thrust_loss, reversed or stuck. output: its place among the commands. size: share lost, or the command at
    which it stays. turns: sign of the yaw moment of a stuck one, positive to starboard. gain: of the fit."""

    kind: str
    output: int
    from_ns: int
    until_ns: int | None
    size: float
    turns: float
    gain: float
    other: ActuatorFault | None = None
    """Another kind of fault of this output that explains nearly as much: the commands do not tell them apart."""


def actuator_findings(log: Log, clock: LogClock) -> Iterator[Finding]:
    if vehicle_kind(log) != "rover":
        return
    driven = [each for each in driven_outputs(log, parameter_values(log)) if np.ptp(np.nan_to_num(each.command)) > 0.1]
    motion = vessel_motion(log, driven)
    if motion is None:
        return
    for fault in actuator_faults(motion):
        output = driven[fault.output]
        end_ns = fault.until_ns or int(motion.stamp_ns[-1])
        until = "the end of the log" if fault.until_ns is None else clock.text(fault.until_ns)
        yield Finding.warning(
            f"actuation.{fault.kind}",
            f"From {clock.text(fault.from_ns)} to {until} the vessel answers as if {output.name} "
            f"{_as_if(fault, output)}{_or_as_if(fault, output)}",
            (Evidence(*_message_and_field(output.series), fault.from_ns, end_ns, f"{fault.size:.2f}"),),
            "Look at this propeller or rudder, its gear, its motor and its wires; it did not do as commanded.",
        )


def _or_as_if(fault: ActuatorFault, output: OutputChannel) -> str:
    if fault.other is None:
        return ""
    return f", or {_as_if(fault.other, output)}: its commands varied too little to tell"


def _as_if(fault: ActuatorFault, output: OutputChannel) -> str:
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
    """The longest stretch in which the vehicle was armed; None where heading, speed or commands are not logged."""
    turning, heading = _turning(log), yaw(log)
    receiver = next(iter(gnss_receivers(log) or injected_receivers(log)), None)
    velocity = None if receiver is None else _velocity(receiver)
    if turning is None or heading is None or velocity is None or not any(each.drives for each in driven):
        return None
    commands = [make_series(each.series.stamp_ns, each.command, "", each.name) for each in driven]
    known = [each for each in (turning, heading, velocity, *commands) if each is not None]
    if len(known) != 3 + len(driven):
        return None
    begin = max(int(each.stamp_ns[0]) for each in known)
    end = min(int(each.stamp_ns[-1]) for each in known)
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
        np.stack([_averaged(each, at_ns) for each in commands if each is not None], axis=1),
        np.array([not each.drives for each in driven]),
    )


def _turning(log: Log) -> Series | None:
    """Turn rate in deg/s; of a recording of ours that of the gyroscope, which no filter delays."""
    for unit in injected_units(log):
        if unit.gyro_radps is not None:
            return make_series(unit.stamp_ns, np.degrees(unit.gyro_radps[:, 2]), "deg/s", unit.name)
    return yaw_rate(log)


def _velocity(receiver: GnssReceiver) -> Series | None:
    fixed = receiver.fix >= 3
    return make_series(receiver.stamp_ns[fixed], receiver.vel_ned_mps[fixed, :2], "m/s", receiver.message)


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
    """Rows of the fit. changes: (2, N) of yaw rate and surge. designs: (N, K) of each for the commands given."""

    motion: VesselMotion
    commands: Floats

    @cached_property
    def rows(self) -> Stamps:
        """(N,) first sample of each row; those that span a pause are left out."""
        first = np.arange(0, len(self.motion.stamp_ns) - _REACH, _STRIDE, dtype=np.int64)
        stamps = self.motion.stamp_ns
        whole = stamps[first + _REACH] - stamps[first] < 1.5e9 * _REACH / RATE_HZ
        return first[whole]

    @cached_property
    def sides(self) -> Floats:
        """(P,) of the propellers: sign of the yaw moment that each gives ahead."""
        motion = self.motion
        drives = self.commands[:, ~motion.steers]
        turning = motion.yaw_rate_radps
        design = self._means([np.ones(len(turning)), turning, *(drives * np.abs(drives)).T])
        sides: Floats = np.sign(np.linalg.lstsq(design, self.changes[0], rcond=None)[0][2:])
        return sides

    @cached_property
    def changes(self) -> tuple[Floats, Floats]:
        turning, surge = self.motion.yaw_rate_radps, self.motion.surge_mps
        return (turning[self.rows + _REACH] - turning[self.rows], surge[self.rows + _REACH] - surge[self.rows])

    def designs(self, commands: Floats) -> tuple[Floats, Floats]:
        """For yaw rate and for surge, means over the second of each row."""
        moving = self.motion
        turning, surge, sway = moving.yaw_rate_radps, moving.surge_mps, moving.sway_mps
        wind = [np.ones(len(turning)), np.cos(moving.yaw_rad), np.sin(moving.yaw_rad)]
        drives, steering = commands[:, ~moving.steers], commands[:, moving.steers]
        thrust = np.sum(drives * np.abs(drives), axis=1)
        yawing = [*wind, turning, turning * np.abs(turning), surge * turning, sway, surge * sway]
        along = [*wind, surge, surge * np.abs(surge), turning**2, turning * sway]
        # Propellers are taken to be alike, and to turn the vessel by the same arm to either side.
        for part in (np.maximum(drives, 0.0) ** 2, np.minimum(drives, 0.0) ** 2, drives):
            yawing += [part @ self.sides] if drives.shape[1] > 1 else []
            along += [part.sum(axis=1)]
        for angle in steering.T:
            yawing += [angle, angle * surge * np.abs(surge), angle * thrust]
            along += [angle**2 * thrust]
        return self._means(yawing), self._means(along)

    def _means(self, columns: Sequence[Floats]) -> Floats:
        summed = np.concatenate([np.zeros((1, len(columns))), np.cumsum(np.stack(columns, axis=1), axis=0)])
        means: Floats = (summed[self.rows + _REACH] - summed[self.rows]) / RATE_HZ
        return means

    def lagged(self, lag_s: float) -> _Fit:
        """With commands behind a lag of the first order."""
        if lag_s <= 0.0:
            return self
        share = 1.0 - np.exp(-1.0 / (RATE_HZ * lag_s))
        slow = np.empty_like(self.commands)
        state = self.commands[0]
        for place, command in enumerate(self.commands):
            state = state + share * (command - state)
            slow[place] = state
        return _Fit(self.motion, slow)


def actuator_faults(motion: VesselMotion) -> list[ActuatorFault]:
    """In the order of time; none where the motion is too short to be judged."""
    first = _Fit(motion, motion.commands)
    if len(first.rows) < _FEWEST_ROWS:
        return []
    fit = min((first.lagged(lag_s) for lag_s in _LAGS_S), key=_left)
    search = _Search(fit)
    found: list[ActuatorFault] = []
    free = np.ones(len(fit.rows), dtype=np.bool_)
    while len(found) < _MOST_FAULTS and (best := search.best(free)) is not None:
        begin, after, fault = best
        found.append(fault)
        free[begin:after] = False
    joined = _joined(sorted(found, key=lambda fault: fault.from_ns))
    return [fault for fault in joined if _certain(fault, motion)]


def _certain(fault: ActuatorFault, motion: VesselMotion) -> bool:
    """Whether the fault is long and large enough to be told from wind, waves and what the model lacks."""
    until_ns = int(motion.stamp_ns[-1]) if fault.until_ns is None else fault.until_ns
    least = LEAST_STEERING_GAIN if motion.steers[fault.output] else LEAST_GAIN
    enough = fault.kind != "thrust_loss" or fault.size >= LEAST_LOSS
    return enough and fault.gain >= least and until_ns - fault.from_ns >= _SHORTEST_NS


def _joined(faults: Sequence[ActuatorFault]) -> list[ActuatorFault]:
    """The same fault on both sides of a short pause, as while it did not show, is one."""
    joined: list[ActuatorFault] = []
    for fault in faults:
        last = joined[-1] if joined else None
        same = last is not None and (last.kind, last.output) == (fault.kind, fault.output)
        if last is not None and same and last.until_ns and fault.from_ns - last.until_ns < _PAUSE_NS:
            size = max((last, fault), key=lambda each: each.gain).size
            gain = last.gain + fault.gain
            joined[-1] = replace(last, until_ns=fault.until_ns, size=size, gain=gain)
        else:
            joined.append(fault)
    return joined


def _left(fit: _Fit) -> float:
    """Sum over both changes of the logarithm of what a fit leaves."""
    return sum(
        float(np.log(_squares(change - design @ np.linalg.lstsq(design, change, rcond=None)[0])))
        for design, change in zip(fit.designs(fit.commands), fit.changes, strict=True)
    )


def _squares(values: Floats) -> float:
    return float(values @ values)


@dataclass(frozen=True, slots=True)
class _Explained:
    kind: str
    output: int
    size: float
    turns: float
    squares: float


class _Search:
    """Spans against hypotheses, both changes in units of their noise."""

    def __init__(self, fit: _Fit) -> None:
        self._fit = fit
        designs = fit.designs(fit.commands)
        self._scales = [
            1.4826 * float(np.median(np.abs(change - design @ np.linalg.lstsq(design, change, rcond=None)[0]))) + 1e-9
            for design, change in zip(designs, fit.changes, strict=True)
        ]
        self._changes = [change / scale for change, scale in zip(fit.changes, self._scales, strict=True)]
        norms = [np.sqrt(np.mean(design**2, axis=0)) + 1e-9 for design in designs]
        self._norms = norms
        self._designs = [design / norm for design, norm in zip(designs, norms, strict=True)]
        self._other: Mapping[tuple[str, int, float], list[Floats]] = dict(self._others(fit))

    def _others(self, fit: _Fit) -> Iterator[tuple[tuple[str, int, float], list[Floats]]]:
        """By hypothesis: how its designs differ from those of the commands."""
        for output in range(fit.commands.shape[1]):
            propeller = not fit.motion.steers[output]
            cases = [("stuck", float(at)) for at in _STUCK_AT]
            cases += [("thrust_loss", 0.0), ("reversed", 0.0)] if propeller else []
            for kind, at in cases:
                commands = fit.commands.copy()
                commands[:, output] = -commands[:, output] if kind == "reversed" else at
                yield (
                    (kind, output, at),
                    [
                        design / norm - usual
                        for design, norm, usual in zip(fit.designs(commands), self._norms, self._designs, strict=True)
                    ],
                )

    def best(self, free: Flags) -> tuple[int, int, ActuatorFault] | None:
        """Rows from and after, and the fault that improves the fit most; only rows that are free."""
        many = len(free)
        whole = sum(
            _squares(change[free] - design[free] @ _solved(design[free], change[free]))
            for design, change in zip(self._designs, self._changes, strict=True)
        )
        spans = [span for span in self._spans(many) if free[span[0] : span[1]].all()]
        judged = [(self._judged(span, free), span) for span in spans]
        known = [(value.squares + outside, span, value.kind) for (value, outside), span in judged if value is not None]
        refined = []
        for kind in dict.fromkeys(kind for *_, kind in known):
            _, span = min((total, span) for total, span, other in known if other == kind)
            span = self._refined(span, free, kind)
            value, outside = self._judged(span, free, kind)
            if value is not None:
                refined.append((value.squares + outside, span, value, outside))
        least = min((total for total, *_ in refined), default=whole)
        if least >= whole:
            return None
        close = [
            each
            for each in refined
            if each[0] <= least + (_AS_GOOD_REVERSED if each[2].kind == "reversed" else _AS_GOOD) * (whole - least)
        ]
        _, span, value, outside = min(close, key=lambda each: (_ORDER.index(each[2].kind), each[0]))
        outside_rows = int(free.sum()) - (span[1] - span[0])
        usual = outside / max(2 * outside_rows, 1)  # variance of a row without the fault
        gain = (whole - value.squares - outside) / max(usual, 1e-9)
        if gain < _SEARCHED_GAIN:
            return None
        rivals = [
            self._fault(each[2], each[1], gain)
            for each in sorted(refined, key=lambda each: each[0])
            if each[2].kind != value.kind
            and each[2].output == value.output
            and each[0] <= least + _AMBIGUOUS * (whole - least)
        ]
        fault = self._fault(value, span, gain)
        return (*span, replace(fault, other=rivals[0] if rivals and value.kind != "reversed" else None))

    def _fault(self, value: _Explained, span: tuple[int, int], gain: float) -> ActuatorFault:
        stamps = self._fit.motion.stamp_ns[self._fit.rows]
        middle_ns = round(0.5e9 * _REACH / RATE_HZ)
        until_ns = None if span[1] >= len(stamps) - 2 else int(stamps[span[1]]) + middle_ns
        from_ns = int(stamps[span[0]]) + middle_ns
        return ActuatorFault(value.kind, value.output, from_ns, until_ns, value.size, value.turns, gain)

    def _spans(self, many: int) -> list[tuple[int, int]]:
        lengths = [round(length_s * RATE_HZ / _STRIDE) for length_s in _LENGTHS_S]
        stride = max(round(2.0 * RATE_HZ / _STRIDE), many * (len(lengths) + 1) // _MOST_SPANS)
        begins = range(0, many - lengths[0], stride)
        spans = [(begin, begin + length) for begin in begins for length in lengths if begin + length <= many]
        return spans + [(begin, many) for begin in begins if many - begin > lengths[-1]]

    def _refined(self, span: tuple[int, int], free: Flags, kind: str) -> tuple[int, int]:
        """Both ends moved by rows for as long as the fit becomes better."""
        reach, many = round(8.0 * RATE_HZ / _STRIDE), len(free)
        least = round(0.5 * _LENGTHS_S[0] * RATE_HZ / _STRIDE)
        for _ in range(2):
            for end in (0, 1):
                tried = []
                for moved in range(max(span[end] - reach, 0), min(span[end] + reach, many) + 1):
                    other = (moved, span[1]) if end == 0 else (span[0], moved)
                    if other[1] - other[0] < least or not free[other[0] : other[1]].all():
                        continue
                    value, outside = self._judged(other, free, kind)
                    if value is not None:
                        tried.append((value.squares + outside, other))
                span = min(tried)[1] if tried else span
        return span

    def _judged(self, span: tuple[int, int], free: Flags, kind: str = "") -> tuple[_Explained | None, float]:
        """The best hypothesis inside, and the sum of squares outside; None where no hypothesis is better than none.

        kind: of the hypotheses to choose from; "" for all.
        """
        inside = slice(*span)
        out = free.copy()
        out[inside] = False
        if out.sum() < _FEWEST_ROWS // 2:
            return None, 0.0
        models = [
            _solved(design[out], change[out]) for design, change in zip(self._designs, self._changes, strict=True)
        ]
        outside = sum(
            _squares(change[out] - design[out] @ model)
            for design, change, model in zip(self._designs, self._changes, models, strict=True)
        )
        rest = np.concatenate(
            [
                change[inside] - design[inside] @ model
                for design, change, model in zip(self._designs, self._changes, models, strict=True)
            ]
        )
        every = [self._with(case, inside, models, rest) for case in self._other if kind in ("", case[0])]
        known = [each for each in every if each is not None]
        if not known:
            return None, outside
        least = min(each.squares for each in known)
        if least > _EXPLAINED * _squares(rest):
            return None, outside
        # A propeller that turns against a steady command also looks stuck: the simpler explanation is named.
        close = [each for each in known if each.squares <= least + _AS_GOOD * (_squares(rest) - least)]
        return min(close, key=lambda each: (_ORDER.index(each.kind), each.squares)), outside

    def _with(
        self, case: tuple[str, int, float], inside: slice, models: Sequence[Floats], rest: Floats
    ) -> _Explained | None:
        kind, output, at = case
        parts = [other[inside] @ model for other, model in zip(self._other[case], models, strict=True)]
        effect = np.concatenate(parts)
        if kind == "thrust_loss":
            share = float(effect @ rest) / max(_squares(effect), 1e-12)
            if not 0.0 < share <= 1.1:
                return None
            return _Explained(kind, output, min(share, 1.0), 0.0, _squares(rest - share * effect))
        return _Explained(kind, output, at, float(np.sign(parts[0].mean())), _squares(rest - effect))


def _solved(design: Floats, change: Floats) -> Floats:
    """(K,) least squares with a slight preference for small coefficients of columns of unit size."""
    gram = design.T @ design + 1e-4 * len(design) * np.eye(design.shape[1])
    return np.asarray(np.linalg.solve(gram, design.T @ change), dtype=np.float64)
