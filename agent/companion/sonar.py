"""Echoes of a scanning sonar: the XITL_PING chunks they travel in, and the points that stand out in them.

A ping whose chunks have all come is handed on at once; one that lacks some when a later one begins is handed on with
zeros in their place.

Detection is by constant false alarm rate, "greatest of": an echo must rise above the greater of the mean levels nearer
and farther than it, which answers neither to noise nor to the edge of a long echo, such as that of the bed (Hansen and
Sawyers 1980). Levels are compared in the sonar's own steps, which are decibels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy import float32, float64, int64, uint8
from numpy.typing import NDArray

from agent.wire import dialect
from agent.wire.codec import Message

CHUNK = 200  # samples a message carries
MOST_SAMPLES = 1200
TURN_GRAD = 400
_ROUND = 1 << 16


class SonarPing(NamedTuple):
    """The echo of one ping. number: counts up, round after 65536. stamp_ns: sensor clock when it went out.

    angle_grad: direction of the beam clockwise from the bow, 400 to the turn. position_frd_m: of the transducer.
    intensity (n,): sample k is the middle of its interval, at `ranges_m()[k]`. chunks_lost: came not, and are zeros.
    """

    number: int
    stamp_ns: int
    angle_grad: int
    position_frd_m: tuple[float, float, float]
    sample_period_s: float
    sound_speed_mps: float
    intensity: NDArray[uint8]
    chunks_lost: int = 0

    @property
    def sample_m(self) -> float:
        """Range from one sample to the next: sound goes there and back."""
        return 0.5 * self.sound_speed_mps * self.sample_period_s

    def ranges_m(self) -> NDArray[float64]:
        """Range of each sample, (n,)."""
        return np.asarray((np.arange(len(self.intensity)) + 0.5) * self.sample_m)


def ping_messages(ping: SonarPing) -> list[Message]:
    """XITL_PING messages of a ping, in order."""
    data, samples = ping.intensity.tobytes(), len(ping.intensity)
    return [
        dialect.MAVLink_xitl_ping_message(
            ping.stamp_ns // 1000,
            ping.position_frd_m,
            ping.sample_period_s,
            ping.sound_speed_mps,
            ping.number % _ROUND,
            ping.angle_grad % TURN_GRAD,
            samples,
            first,
            min(CHUNK, samples - first),
            data[first : first + CHUNK].ljust(CHUNK, b"\0"),
        )
        for first in range(0, samples, CHUNK)
    ]


class PingReassembler:
    """Puts pings together again.

    pings: handed on. chunks_lost: never came. late: chunks of a ping that was handed on, or repeated. refused: chunks
    whose numbers cannot be.
    """

    def __init__(self) -> None:
        self.pings = 0
        self.chunks_lost = 0
        self.late = 0
        self.refused = 0
        self._open: SonarPing | None = None
        self._missing: set[int] = set()
        self._newest: int | None = None

    def handle(self, message: Message) -> list[SonarPing]:
        """The pings that are through with this chunk, oldest first: none, one, or the one before given up as well."""
        if not _can_be(message):
            self.refused += 1
            return []
        done: list[SonarPing] = []
        number = int(message.ping)
        if self._newest is None or 0 < (number - self._newest) % _ROUND < _ROUND // 2:
            done += self._given_up()
            self._begin(message)
        ping = self._open
        if ping is None or number != ping.number or message.first not in self._missing:
            self.late += 1
            return done
        if message.samples != len(ping.intensity):
            self.refused += 1
            return done
        first, count = int(message.first), int(message.count)
        ping.intensity[first : first + count] = np.frombuffer(bytes(message.intensity[:count]), uint8)
        self._missing.discard(first)
        if not self._missing:
            done.append(self._hand_on(ping))
        return done

    def _begin(self, message: Message) -> None:
        x_m, y_m, z_m = (float(value) for value in message.position)
        self._newest = int(message.ping)
        self._missing = set(range(0, message.samples, CHUNK))
        self._open = SonarPing(
            self._newest,
            int(message.time_usec) * 1000,
            int(message.angle),
            (x_m, y_m, z_m),
            float(message.sample_period),
            float(message.sound_speed),
            np.zeros(message.samples, uint8),
        )

    def _given_up(self) -> list[SonarPing]:
        if self._open is None:
            return []
        lost = len(self._missing)
        self.chunks_lost += lost
        return [self._hand_on(self._open._replace(chunks_lost=lost))]

    def _hand_on(self, ping: SonarPing) -> SonarPing:
        self._open = None
        self._missing = set()
        self.pings += 1
        return ping


def _can_be(message: Message) -> bool:
    samples, first = message.samples, message.first
    return (
        0 < samples <= MOST_SAMPLES
        and first < samples
        and first % CHUNK == 0
        and message.count == min(CHUNK, samples - first)
        and message.angle < TURN_GRAD
        and all(math.isfinite(value) for value in message.position)
        and 0.0 < message.sample_period < 1.0
        and 0.0 < message.sound_speed < 1e4
    )


Array = NDArray[float64]

RISE = 39.0  # 13 dB: a speckle of the noise gets there once in 70 000 samples
FLANK = 30.0  # 10 dB: an echo begins where it comes so near to its highest
NEAREST_M = 0.75  # nearer, the transducer itself still rings
GUARD_M = 0.5
TRAINING_M = 1.5
_LEAST_GUARD = 4
_LEAST_TRAINING = 12


def echo_points(
    ping: SonarPing, rise: float = RISE, nearest_m: float = NEAREST_M
) -> tuple[NDArray[float32], NDArray[uint8]]:
    """Echoes of a ping as points_frd_m (k, 3), in the plane of the beam's axis, and their intensity (k,).

    The beam is far taller than wide: how high or deep an echo comes from is not known.
    """
    samples = echo_samples(ping, rise, nearest_m)
    angle_rad = ping.angle_grad * (2.0 * np.pi / 400.0)
    along = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    points = np.array(ping.position_frd_m) + ping.ranges_m()[samples, None] * along
    return points.astype(float32), ping.intensity[samples]


def echo_samples(ping: SonarPing, rise: float, nearest_m: float) -> NDArray[int64]:
    """Numbers of the samples (k,) where echoes begin that stand out, the highest of their surroundings by `rise`.

    A surface that the beam meets at a slant answers for a while, in speckle, and what is nearest of it answers first.
    """
    level = ping.intensity.astype(float64)
    guard = max(round(GUARD_M / ping.sample_m), _LEAST_GUARD)
    training = max(round(TRAINING_M / ping.sample_m), _LEAST_TRAINING)
    count = len(level)
    start = int(np.ceil(nearest_m / ping.sample_m))
    if count - start < guard + training:
        return np.empty(0, int64)
    total = np.concatenate(([0.0], np.cumsum(level)))
    place = np.arange(count)
    near = _mean(total, np.maximum(place - guard - training, 0), np.maximum(place - guard, 0))
    far = _mean(total, np.minimum(place + guard + 1, count), np.minimum(place + guard + 1 + training, count))
    padded = np.pad(level, guard, constant_values=-1.0)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * guard + 1)
    highest = level >= around.max(axis=1)
    highest[1:] &= level[1:] > level[:-1]  # of equal ones, the first
    peaks = np.flatnonzero(highest & (level >= np.maximum(near, far) + rise) & (place >= start))
    before = np.maximum(peaks[:, None] + np.arange(-guard, 1), start)
    first = np.argmax(level[before] >= level[peaks, None] - FLANK, axis=1)
    return np.unique(before[np.arange(len(peaks)), first])


def _mean(total: Array, first: NDArray[int64], end: NDArray[int64]) -> Array:
    """Means of [first, end) from running sums; 0 where there is nothing."""
    return np.asarray((total[end] - total[first]) / np.maximum(end - first, 1))
