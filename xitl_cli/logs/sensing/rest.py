"""When the vehicle did not move: what an inertial sensor shows then is the sensor itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.sensing.inertial import Inertial

WINDOW_NS = 1_000_000_000
GYRO_DEVIATION_RADPS = 0.01
ACCEL_DEVIATION_MPS2 = 0.3
GYRO_SHIFT_RADPS = 0.003
ACCEL_SHIFT_MPS2 = 0.1
SPEED_MPS = 0.1
_MOST_WINDOWS = 1_000_000  # eleven days; more are stamps gone wild


@dataclass(frozen=True, slots=True)
class Rest:
    """Stretches from, until (ns on the log's time), the longest first. source: the unit that showed it.

    by_speed: whether a speed over ground had a say as well.
    """

    stretches: tuple[tuple[int, int], ...]
    source: str | None
    by_speed: bool

    @property
    def longest_s(self) -> float:
        return (self.stretches[0][1] - self.stretches[0][0]) * 1e-9 if self.stretches else 0.0

    def rows(self, stamp_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        """(N,) which of these stamps lie in a stretch."""
        inside = np.zeros(len(stamp_ns), dtype=np.bool_)
        for from_ns, until_ns in self.stretches:
            inside |= (stamp_ns >= from_ns) & (stamp_ns < until_ns)
        return inside


def rest(log: Log, found: list[Inertial]) -> Rest:
    """Whole seconds in which the gyroscope hardly scatters (under 0.01 rad/s), the specific force neither (under 0.3
    m/s^2), their means stay where they are over the stretch (0.003 rad/s, 0.1 m/s^2), and the speed is under 0.1 m/s
    where one is known. Waves of half a degree are no rest.
    """
    whole = [unit for unit in found if unit.gyro_radps is not None and unit.accel_mps2 is not None]
    if not whole:
        return Rest((), None, False)
    unit = max(whole, key=lambda each: len(each.stamp_ns))
    windows = _windows(unit)
    if windows is None:
        return Rest((), unit.name, False)
    from_ns, means, calm = windows
    from xitl_cli.logs.signals import ground_speed

    speed = ground_speed(log)
    if speed is not None:
        # The fastest of the window's beginning, middle and end; no speed there: the inertial unit alone decides.
        at = np.stack([speed.at(from_ns + part) for part in (0, WINDOW_NS // 2, WINDOW_NS)])
        calm[np.nan_to_num(np.abs(at)).max(axis=0) > SPEED_MPS] = False
    stretches = []
    for first, last in _runs(calm):
        away = np.abs(means[first : last + 1] - np.median(means[first : last + 1], axis=0))
        settled = np.asarray(
            (away[:, :3] < GYRO_SHIFT_RADPS).all(axis=1) & (away[:, 3:] < ACCEL_SHIFT_MPS2).all(axis=1)
        )
        for begin, end in _runs(settled):
            stretches.append((int(from_ns[first + begin]), int(from_ns[first + end]) + WINDOW_NS))
    stretches.sort(key=lambda stretch: stretch[0] - stretch[1])
    return Rest(tuple(stretches), unit.name, speed is not None)


def _windows(unit: Inertial) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]] | None:
    """Of each second that has samples: when it begins, means of the six axes (W, 6), whether it is calm."""
    assert unit.gyro_radps is not None
    assert unit.accel_mps2 is not None
    signals = np.concatenate([unit.gyro_radps, unit.accel_mps2], axis=1)
    good = np.isfinite(signals).all(axis=1) & (np.abs(signals) < 1e6).all(axis=1)
    stamps, signals = unit.stamp_ns[good], signals[good]
    if len(stamps) < 3:
        return None
    # From the median on, so that one wild stamp does not stretch the record; what lies too far off is left out.
    begin = int(np.median(stamps))
    number = (stamps - begin) // WINDOW_NS
    near = np.abs(number) < _MOST_WINDOWS
    if not near.any():
        return None
    number, signals = number[near], signals[near]
    base = int(number.min())
    place = number - base
    count = np.bincount(place)
    enough = count >= 3
    divisor = np.maximum(count, 1)
    centre = signals.mean(axis=0)
    sums = np.stack([np.bincount(place, signals[:, axis] - centre[axis]) for axis in range(6)], axis=1)
    squares = np.stack([np.bincount(place, (signals[:, axis] - centre[axis]) ** 2) for axis in range(6)], axis=1)
    means = sums / divisor[:, None]
    deviation = np.sqrt(np.maximum(squares / divisor[:, None] - means**2, 0.0))
    calm: NDArray[np.bool_] = enough & (deviation[:, :3] < GYRO_DEVIATION_RADPS).all(axis=1)
    calm &= (deviation[:, 3:] < ACCEL_DEVIATION_MPS2).all(axis=1)
    from_ns = begin + (np.arange(len(count), dtype=np.int64) + base) * WINDOW_NS
    return from_ns, means + centre, calm


def _runs(calm: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of each run of calm windows."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], calm, [False])).astype(np.int8)))
    return [(int(begin), int(end) - 1) for begin, end in zip(edges[0::2], edges[1::2], strict=True)]
