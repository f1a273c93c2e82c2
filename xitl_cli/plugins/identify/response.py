"""The response of a boat to its commands, compared with that of the vehicle to begin with, before a fit.

The vehicle is simulated from the measured motion at many instants, for a fifth of a window: with the logged commands,
with reversed commands, and without commands. Its response is the velocity with commands less that without. The response
of the boat is the measured velocity less that without commands. Velocities have the axes of the heading at the start,
so that a current cancels.

Both are compared by least squares, without the part that a linear function of the velocities at the start explains
(Frisch and Waugh 1933). Wrong damping of the vehicle then changes the result little. A comparison shows wrong signs,
axes, units and clocks.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.plugins.identify.recording import Floats, Recording
from xitl_cli.plugins.identify.windows import COMMAND_S, HISTORY_S, Simulator

_SHARE, _STEPS = 5, 4  # responses to a window, instants to a response
_LAGS = 20
_FEWEST = 20
_PUSHES, _TURNS = 1.0, 0.025
"""Least velocity by the commands over that of their turn at the radius of gyration, and the reverse, to compare it."""
_LATER, _REVERSED, _AGAINST, _AGREES, _UNRELATED = 0.5, 1.0, -0.6, 0.7, 0.3
_MEASURED = (("surge", "sway"), ("vel_north", "vel_east"), ("north", "east"))
_OFF_RAD = np.radians(50.0)
_FACTOR, _FACTOR_OF_TURNS = 2.5, 4.0


@dataclass(frozen=True, slots=True)
class ResponseRatio:
    """The response of the boat over that of the vehicle. Without an effect of the commands, agreements are 0."""

    push: complex
    """Factor of the velocity. Its angle is positive if the boat is pushed to starboard of the vehicle's direction."""
    push_agreement: float
    """Absolute value of the complex correlation of both."""
    turn: float
    """Factor of the yaw rate."""
    turn_agreement: float
    """Correlation of both, in [-1, 1]."""

    @property
    def ahead(self) -> float:
        """Correlation of the velocities in the vehicle's direction, in [-1, 1]."""
        return self.push_agreement * float(np.cos(np.angle(self.push)))

    @property
    def score(self) -> float:
        """Sum of both correlations, in [-2, 2]."""
        return self.ahead + self.turn_agreement


@dataclass(frozen=True, slots=True)
class Responses:
    """Ratios of the responses in a log."""

    logged: ResponseRatio
    reversed: ResponseRatio
    """With all commands reversed."""
    shifted: ResponseRatio
    """With the commands shifted in time by `shift_s`, so that the score is best."""
    shift_s: float
    """Positive if the motion is later than the commands."""
    response_s: float
    position: str
    """Quantities that the velocities were measured by."""


def compare(recording: Recording, vessel: VesselSpec, water: Water, window_s: float) -> Responses | None:
    """Compare the responses of a log; None for a log that is too short."""
    response_s = round(window_s / _SHARE / COMMAND_S / 2.0) * COMMAND_S * 2.0
    first_s, last_s = recording.span_s
    time_s = np.arange(first_s + HISTORY_S, last_s - response_s, response_s / _STEPS)
    if len(time_s) < _FEWEST:
        return None
    edges = time_s[:, None] + np.arange(round((HISTORY_S + response_s) / COMMAND_S) + 1) * COMMAND_S - HISTORY_S
    before, start, end = (recording.motion_at(own) for own in (edges[:, 0], time_s, edges[:, -1]))
    earlier, begin = (np.tile(np.column_stack([np.zeros(len(time_s)), own[:, 3:]]), (3, 1)) for own in (before, start))
    commands = recording.mean_commands(edges)
    commands = np.concatenate([commands, -commands, 0.0 * commands])
    motion = Simulator(water).motion(vessel, earlier, begin, commands, np.zeros((1, 1, 2)))[-1]
    ahead, back, still = motion[:, 3:].reshape(3, len(time_s), 3)
    turned = end[:, 2] - start[:, 2]
    boat = np.column_stack([_complex(end[:, 3:5]) * np.exp(1j * turned) - _complex(still), end[:, 5] - still[:, 2]])
    known = np.column_stack([start[:, 3:], np.ones(len(time_s))])
    good = np.isfinite(motion[:, 3:].reshape(3, -1, 3)).all(axis=(0, 2)) & ~recording.broken(
        time_s - HISTORY_S, HISTORY_S + response_s
    )
    gyration_m = float(np.sqrt(vessel.inertia_kgm2[2] / vessel.mass_kg))

    def compared(vehicle: Floats, lag: int = 0) -> ResponseRatio:
        """Compare the boat with the vehicle `lag` instants before."""
        later, earlier = (np.arange(len(good) - abs(lag)) + max(shift, 0) for shift in (lag, -lag))
        both = good[later] & good[earlier]
        later, earlier = later[both], earlier[both]
        return _compared(boat[later], vehicle[earlier] - still[earlier], known[later], gyration_m)

    lags = range(-min(_LAGS, len(good)), min(_LAGS, len(good)) + 1)
    by_lag = {lag: compared(ahead, lag) for lag in lags}
    best = max(lags, key=lambda lag: by_lag[lag].score)
    measured = next(pair for pair in _MEASURED if pair[0] in recording.channels)
    return Responses(
        by_lag[0], compared(back), by_lag[best], best * response_s / _STEPS, response_s, " and ".join(measured)
    )


def _complex(velocity: Floats) -> NDArray[np.complex128]:
    return velocity[:, 0] + 1j * velocity[:, 1]


def _compared(boat: NDArray[np.complex128], vehicle: Floats, known: Floats, gyration_m: float) -> ResponseRatio:
    """Compare velocity and yaw rate (K, 2) of the boat with the velocities (K, 3) of the vehicle."""
    if len(boat) < _FEWEST:
        return ResponseRatio(1.0, 0.0, 1.0, 0.0)
    of_vehicle = np.column_stack([_complex(vehicle), vehicle[:, 2]])
    pushed, swung = float(np.std(of_vehicle[:, 0])), gyration_m * float(np.std(of_vehicle[:, 1]))
    both = [own - known @ np.linalg.lstsq(known, own, rcond=None)[0] for own in (boat, of_vehicle)]
    product = np.sum(both[1].conj() * both[0], axis=0)
    of_boat, squares = (np.sum(np.abs(own) ** 2, axis=0) for own in both)
    factor = product / np.maximum(squares, 1e-12)
    agreement = product / np.sqrt(np.maximum(squares * of_boat, 1e-24))
    pushes, turns = pushed > _PUSHES * swung, swung > _TURNS * pushed
    return ResponseRatio(
        complex(factor[0]) if pushes else 1.0,
        float(abs(agreement[0])) if pushes else 0.0,
        float(factor[1].real) if turns else 1.0,
        float(agreement[1].real) if turns else 0.0,
    )


# What is wrong with a log, as a sentence; empty if it is right
def _late(found: Responses) -> str:
    others = max(found.logged.score, found.reversed.score) + _LATER
    if abs(found.shift_s) < 0.5 * found.response_s or found.shifted.score < max(others, _AGREES):
        return ""
    return (
        f"the motion is {abs(found.shift_s):.1f} s {'later' if found.shift_s > 0.0 else 'earlier'} than the commands "
        f"(sum of correlations {found.shifted.score:.2f} with this shift, and {found.logged.score:.2f} without); "
        "record commands and motion with one clock, or shift the times of one of them"
    )


def _reversed(found: Responses) -> str:
    if found.reversed.score < found.logged.score + _REVERSED or found.reversed.ahead < -_AGAINST:
        return ""
    return (
        f"the boat moves against its commands (sum of correlations {found.logged.score:.2f}, and "
        f"{found.reversed.score:.2f} with reversed commands); exchange full ahead and full astern of the commands"
    )


def _swapped(found: Responses) -> str:
    if found.logged.turn_agreement > _AGAINST:
        return ""
    return (
        f"the boat turns against its commands (correlation {found.logged.turn_agreement:.2f}); exchange the commands "
        "of port and starboard, or correct the sign of the rudder"
    )


def _turned(found: Responses) -> str:
    angle = float(np.angle(found.logged.push))
    if found.logged.push_agreement < _AGREES or abs(angle) < _OFF_RAD:
        return ""
    side, change = ("starboard", "add") if angle > 0.0 else ("port", "subtract")
    return (
        f"the commands push the boat {abs(np.degrees(angle)):.0f}° to {side} of the heading (correlation "
        f"{found.logged.push_agreement:.2f}); {change} about this angle, or correct the column of yaw, which is "
        "from north, clockwise"
    )


def _scaled(found: Responses) -> str:
    factor = abs(found.logged.push)
    if found.logged.push_agreement < _AGREES or 1.0 / _FACTOR < factor < _FACTOR:
        return ""
    return (
        f"{found.position} move {factor:.2g} times as far as thrust and mass of the vehicle move it (correlation "
        f"{found.logged.push_agreement:.2f}); correct their unit (about 0.001 for km, 3.3 for feet), or begin with the "
        "vehicle of this log"
    )


def _swings(found: Responses) -> str:
    factor = found.logged.turn
    if found.logged.turn_agreement < _AGREES or 1.0 / _FACTOR_OF_TURNS < factor < _FACTOR_OF_TURNS:
        return ""
    return (
        f"the boat turns {factor:.2g} times as far as thrust and inertia of the vehicle turn it (correlation "
        f"{found.logged.turn_agreement:.2f}); begin with the vehicle of this log, or correct its inertia_kgm2 and the "
        "positions of its propellers"
    )


def _unrelated(found: Responses) -> str:
    if max(found.logged.push_agreement, abs(found.logged.turn_agreement)) > _UNRELATED:
        return ""
    return (
        f"the boat does not respond to its commands (correlations {found.logged.push_agreement:.2f} of the velocity, "
        f"{found.logged.turn_agreement:.2f} of the yaw rate); use commands and motion of one run, with larger steps"
    )


RULES: tuple[Callable[[Responses], str], ...] = (_late, _reversed, _swapped, _turned, _scaled, _swings, _unrelated)
"""The first sentence applies."""


def check_response(recording: Recording, vessel: VesselSpec, water: Water, window_s: float) -> None:
    """Raise UserError if the boat does not respond to its commands as the vehicle does, roughly."""
    found = compare(recording, vessel, water, window_s)
    for sentence in () if found is None else filter(None, (rule(found) for rule in RULES)):
        raise UserError(f"{recording.source}: {sentence}")
