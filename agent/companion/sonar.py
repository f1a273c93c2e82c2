"""Echoes of a scanning sonar: the XITL_PING chunks on the wire, and the points detected in them.

A complete ping is returned at once. An incomplete ping is returned when a later one begins, with zeros for the missing
chunks.

Detection uses a constant false alarm rate, "greatest of". An echo must exceed the greater of the mean levels nearer and
farther than it. Neither noise nor the edge of a long echo, for example of the bed, triggers it (Hansen and Sawyers
1980). Levels are compared in the sonar's own steps, which are decibels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy import float32, float64, int64, uint8
from numpy.typing import NDArray

from agent.wire import dialect
from agent.wire.codec import Message

CHUNK = 200  # samples per message
MOST_SAMPLES = 1200
TURN_GRAD = 400
_ROUND = 1 << 16


class SonarPing(NamedTuple):
    """Echo of one ping."""

    number: int
    """Counts up and wraps after 65535."""
    stamp_ns: int
    """Sensor clock at transmission."""
    angle_grad: int
    """Direction of the beam clockwise from the bow, 400 per turn."""
    position_frd_m: tuple[float, float, float]
    """Position of the transducer."""
    sample_period_s: float
    sound_speed_mps: float
    intensity: NDArray[uint8]
    """(n,): sample k is the middle of its interval, at `ranges_m()[k]`."""
    chunks_lost: int = 0
    """Number of missing chunks, which are zeros."""

    @property
    def sample_m(self) -> float:
        """Range between two samples. Sound travels there and back."""
        return 0.5 * self.sound_speed_mps * self.sample_period_s

    def ranges_m(self) -> NDArray[float64]:
        """Range of each sample, (n,)."""
        return np.asarray((np.arange(len(self.intensity)) + 0.5) * self.sample_m)


def ping_messages(ping: SonarPing) -> list[Message]:
    """Return the XITL_PING messages of a ping, in order."""
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
    """Reassembles pings from chunks, and counts them."""

    def __init__(self) -> None:
        self.pings = 0
        """Returned pings."""
        self.chunks_lost = 0
        """Missing chunks."""
        self.late = 0
        """Chunks of a returned ping, or repeated ones."""
        self.refused = 0
        """Invalid chunks."""
        self._open: SonarPing | None = None
        self._missing: set[int] = set()
        self._newest: int | None = None

    def handle(self, message: Message) -> list[SonarPing]:
        """Handle a chunk. Return the pings that it completes or ends, oldest first: none, one or two."""
        if not _is_valid(message):
            self.refused += 1
            return []
        done: list[SonarPing] = []
        number = int(message.ping)
        if self._newest is None or 0 < (number - self._newest) % _ROUND < _ROUND // 2:
            if self._open is not None:
                lost = len(self._missing)
                self.chunks_lost += lost
                done.append(self._hand_on(self._open._replace(chunks_lost=lost)))
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

    def _hand_on(self, ping: SonarPing) -> SonarPing:
        self._open = None
        self._missing = set()
        self.pings += 1
        return ping


def _is_valid(message: Message) -> bool:
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

RISE = 39.0  # 13 dB: the speckle of the noise exceeds it once in 70 000 samples
FLANK = 30.0  # 10 dB: an echo begins at the first sample this close to its maximum
NEAREST_M = 0.75  # at closer range, the transducer itself still rings
GUARD_M = 0.5
TRAINING_M = 1.5
_LEAST_GUARD = 4
_LEAST_TRAINING = 12


def echo_points(
    ping: SonarPing, rise: float = RISE, nearest_m: float = NEAREST_M
) -> tuple[NDArray[float32], NDArray[uint8]]:
    """Echoes of a ping as points_frd_m (k, 3), in the plane of the beam's axis, and their intensity (k,).

    The beam is far taller than wide, so the height of an echo is unknown.
    """
    samples = echo_samples(ping, rise, nearest_m)
    angle_rad = ping.angle_grad * (2.0 * np.pi / 400.0)
    along = np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    points = np.array(ping.position_frd_m) + ping.ranges_m()[samples, None] * along
    return points.astype(float32), ping.intensity[samples]


def echo_samples(ping: SonarPing, rise: float, nearest_m: float) -> NDArray[int64]:
    """Indices (k,) of the samples at which detected echoes begin. An echo exceeds its surroundings by `rise`.

    A surface at a slant to the beam returns a long echo with speckle. Its nearest part returns first.
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
    rising = np.diff(level, prepend=-1.0) > 0.0  # the first of equal ones
    peaks = np.flatnonzero(rising & (level >= np.maximum(near, far) + rise) & (place >= start))
    padded = np.pad(level, guard, constant_values=-1.0)
    # numpy's sliding windows intern a string per call, and Python's table of interned strings grows with them.
    highest = padded[peaks[:, None] + np.arange(2 * guard + 1)].max(axis=1)
    peaks = peaks[level[peaks] >= highest]
    before = np.maximum(peaks[:, None] + np.arange(-guard, 1), start)
    first = np.argmax(level[before] >= level[peaks, None] - FLANK, axis=1)
    return np.unique(before[np.arange(len(peaks)), first])


def _mean(total: Array, first: NDArray[int64], end: NDArray[int64]) -> Array:
    """Means of [first, end) from running sums, 0 for empty ranges."""
    return np.asarray((total[end] - total[first]) / np.maximum(end - first, 1))
