"""Channels: each has one kind of message to the agents, with its rate, latency, sensor and faults."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from numpy.random import Generator

from agent.wire import dialect
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.sensors.wind_vane import WindVane
from xitl_cli.run.sensors.sensor_faults import SensorFaults
from xitl_cli.run.sensors.sensor_messages import Message


class Channel(Protocol):
    """One kind of message."""

    every: int
    """Physics steps between messages."""
    latency_ns: int
    """Delay of the delivery."""

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message | None:
        """Return the measurement now; None without a message."""


class SensorChannel:
    """One sensor, its state and random generator, its faults, and the encoding of its sample.

    The sensor continues to measure during a fault, so that samples after the fault are the same as without it.
    """

    def __init__(
        self,
        sensor: Any,
        rng: Generator,
        physics_rate_hz: float,
        encode: Callable[[int, Any], Message],
        faults: SensorFaults | None = None,
    ) -> None:
        self.every = round(physics_rate_hz / sensor.spec.rate_hz)
        self.latency_ns = round(sensor.spec.latency_s * 1e9)
        self.faults = faults or None
        self._sensor = sensor
        self._rng = rng
        self._state = sensor.initial(1, rng)
        self._encode = encode

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message | None:
        self._state, sample = self._sensor.measure(self._state, motion, self._rng)
        if self.faults is not None:
            sample = self.faults.applied(stamp_ns, sample)
            if sample is None:
                return None
        return self._encode(stamp_ns // 1000, sample)


UNKNOWN_WIND_MPS = -1.0


class TruthChannel:
    """XITL_TRUTH every `every` physics steps, for the instant of the step and without delay."""

    latency_ns = 0

    def __init__(self, every: int, vane: VaneChannel | None = None) -> None:
        self.every = every
        self._vane = vane

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message:
        wind = (UNKNOWN_WIND_MPS, 0.0) if self._vane is None else self._vane.latest(stamp_ns)
        return dialect.MAVLink_xitl_truth_message(
            stamp_ns // 1000,
            motion.pos_ned_m[0].tolist(),
            motion.vel_ned_mps[0].tolist(),
            motion.quat_ned_frd[0].tolist(),
            motion.gyro_frd_radps[0].tolist(),
            *wind,
        )


class VaneChannel:
    """The wind vane. It has no separate message: the truth message carries its newest delivered sample."""

    latency_ns = 0

    def __init__(self, vane: WindVane, rng: Generator, physics_rate_hz: float) -> None:
        self.every = round(physics_rate_hz / vane.spec.rate_hz)
        self._vane = vane
        self._rng = rng
        self._state = vane.initial(1, rng)
        self._latency_ns = round(vane.spec.latency_s * 1e9)
        self._waiting: deque[tuple[int, float, float]] = deque()
        self._latest = (UNKNOWN_WIND_MPS, 0.0)

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> None:
        self._state, sample = self._vane.measure(self._state, motion, air_ned_mps, self._rng)
        delivered_ns = stamp_ns + self._latency_ns
        self._waiting.append((delivered_ns, float(sample.speed_mps[0]), float(sample.direction_rad[0])))

    def latest(self, now_ns: int) -> tuple[float, float]:
        """Return speed in m/s, below 0 before the first sample, and direction in rad from the bow."""
        while self._waiting and self._waiting[0][0] <= now_ns:
            self._latest = self._waiting.popleft()[1:]
        return self._latest
