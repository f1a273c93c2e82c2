"""The parts of an observation, with their numbers and limits.

A part is a name from `PARTS`, or a function of `Vessels` that returns (N, K) numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy import float32

from sim_core.dataclass import dataclass
from sim_core.frames import Array, Array32
from xitl_cli.errors import UserError
from xitl_cli.plugins.learning.vessels import Vessels

Feature = Callable[[Vessels], Array]
"""Returns (N, K) numbers."""
FAR_M, FAST_MPS, TURNING_RADPS, WINDY_MPS = 1e5, 100.0, 100.0, 150.0


@dataclass(frozen=True, slots=True)
class ObservationPart:
    """A part of an observation."""

    numbers: str
    """Its numbers with their units, for the documentation."""
    limit: float
    """Largest absolute value. Larger values are cut off."""
    read: Feature
    """Returns its (N, K) numbers."""


def _sensor(name: str) -> Feature:
    return lambda vessels: vessels.sensors[name]


def _gnss(vessels: Vessels) -> Array:
    fix = vessels.sensors["gnss"].copy()
    fix[:, :3] -= vessels.start_ned_m
    return fix


def _attitude(vessels: Vessels) -> Array:
    roll, pitch, yaw = vessels.euler_rad.T
    return np.stack([roll, pitch, np.sin(yaw), np.cos(yaw)], axis=1)


def _to_goal(vessels: Vessels) -> Array:
    return vessels.ahead_right(vessels.goal[:, :2] - vessels.position_ned_m[:, :2])


PARTS: dict[str, ObservationPart] = {
    "position": ObservationPart(
        "north, east, down in m, from the start of the episode",
        FAR_M,
        lambda vessels: vessels.position_ned_m - vessels.start_ned_m,
    ),
    "to_goal": ObservationPart("way to the goal's north and east, ahead and right of the bow in m", FAR_M, _to_goal),
    "goal": ObservationPart("the numbers of the goal", np.inf, lambda vessels: vessels.goal),
    "velocity": ObservationPart(
        "forward, right, down in m/s, over ground", FAST_MPS, lambda vessels: vessels.velocity_frd_mps
    ),
    "attitude": ObservationPart("roll and pitch in rad, sine and cosine of the heading", np.pi, _attitude),
    "rates": ObservationPart(
        "turn rates about the axes forward, right, down in rad/s",
        TURNING_RADPS,
        lambda vessels: vessels.rates_frd_radps,
    ),
    "actuators": ObservationPart(
        "share of full speed or angle of each actuator", 1.0, lambda vessels: vessels.actuators
    ),
    "current": ObservationPart(
        "velocity of the water, ahead and right of the bow in m/s",
        FAST_MPS,
        lambda vessels: vessels.ahead_right(vessels.current_ned_mps),
    ),
    "wind": ObservationPart(
        "velocity of the air, ahead and right of the bow in m/s",
        WINDY_MPS,
        lambda vessels: vessels.ahead_right(vessels.wind_ned_mps),
    ),
    "imu": ObservationPart(
        "sensor: turn rates in rad/s, then specific forces in m/s², forward, right, down", 1e3, _sensor("imu")
    ),
    "gnss": ObservationPart(
        "sensor: north, east, down in m from the start, then north, east, down in m/s", FAR_M, _gnss
    ),
    "magnetometer": ObservationPart(
        "sensor: magnetic field forward, right, down in gauss", 10.0, _sensor("magnetometer")
    ),
    "barometer": ObservationPart("sensor: pressure in hPa", 2e3, _sensor("barometer")),
    "wind_vane": ObservationPart(
        "sensor: apparent wind speed in m/s, direction from the bow in rad", WINDY_MPS, _sensor("wind_vane")
    ),
}
"""All parts by name."""
SENSORS = ("imu", "gnss", "magnetometer", "barometer", "wind_vane")
"""Parts that are sensors of the profile."""


class Observation:
    """The observation of N vessels: its parts side by side, (N, K) in float32.

    names: sensors among the parts. low, high: limits, (K,).
    """

    def __init__(self, parts: Sequence[str | Feature]) -> None:
        """Raises UserError for no parts, and for an unknown name."""
        if isinstance(parts, str) or not parts:
            raise UserError(f"observe = {parts!r} is not valid; give a list with names from {', '.join(PARTS)}")
        unknown = [part for part in parts if isinstance(part, str) and part not in PARTS]
        if unknown:
            raise UserError(f"observe: {unknown[0]!r} is unknown; use {', '.join(PARTS)} or a function")
        self.sensors = tuple(name for name in SENSORS if name in parts)
        self.low = self.high = np.zeros(0, dtype=float32)
        self._parts = tuple(
            PARTS[part] if isinstance(part, str) else ObservationPart("", np.inf, part) for part in parts
        )

    def measure(self, vessels: Vessels) -> None:
        """Set the limits from an example. Raises ValueError for a function with another shape than (N, K)."""
        limits = [np.full(_numbers(part, vessels).shape[1], part.limit) for part in self._parts]
        self.high = np.concatenate(limits).astype(float32)
        self.low = -self.high

    def read(self, vessels: Vessels) -> Array32:
        """Return a new array (N, K), within the limits."""
        numbers = np.concatenate([part.read(vessels) for part in self._parts], axis=1).astype(float32)
        return np.clip(numbers, self.low, self.high, out=numbers)


def _numbers(part: ObservationPart, vessels: Vessels) -> Array:
    if part is PARTS["to_goal"] and vessels.goal.shape[1] < 2:
        raise UserError("observe: 'to_goal' needs a goal with north and east in m; give goal=")
    numbers = np.asarray(part.read(vessels))
    if numbers.ndim != 2 or len(numbers) != len(vessels):
        name = getattr(part.read, "__name__", "a function")
        raise ValueError(
            f"observe: {name} returned the shape {numbers.shape} for {len(vessels)} vessels; return ({len(vessels)}, K)"
        )
    return numbers
