"""What the agents are told of the world, one kind of message at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from numpy.random import Generator

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from xitl_cli.run.sensors.sensor_faults import SensorFaults
from xitl_cli.run.sensors.sensor_messages import Message


class Channel(Protocol):
    """One kind of message: every so many physics steps, delivered so much later."""

    every: int
    latency_ns: int

    def message(self, stamp_ns: int, motion: Kinematics, air_ned_mps: Array) -> Message | None:
        """What is measured now; None when there is nothing to send."""


class SensorChannel:
    """One sensor, its state and random generator, its faults, and how its sample becomes a message.

    The sensor measures on behind its faults, so that what comes after one is what would have come without it.
    """

    def __init__(
        self,
        sensor: Any,
        rng: Generator,
        physics_rate_hz: float,
        encode: Callable[[int, Any], Message],
        faults: SensorFaults | None = None,
    ) -> None:
        self.every = round(physics_rate_hz / sensor.rate_hz)
        self.latency_ns = round(sensor.latency_s * 1e9)
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
