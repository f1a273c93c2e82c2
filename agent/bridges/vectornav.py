"""VectorNav VN-300, for ArduPilot with EAHRS_TYPE 1: boards with ChibiOS and software in the loop.

The driver sets the unit up first (see `vectornav_commands`); nothing flows before it has asked. It opens its port anew
before every read, which empties the buffer on ArduPilot's Linux builds: take the MicroStrain there.
"""

from __future__ import annotations

import time
from typing import Callable

from agent.bridges import vectornav_frames as frames
from agent.bridges.ahrs import Ahrs
from agent.bridges.samples import InertialSample, Navigation, ReceiverFix
from agent.bridges.sensor_line import SensorLine, open_line
from agent.bridges.vectornav_commands import INERTIAL, RATE_HZ, RECEIVER, SOLUTION, CommandPort
from agent.bridges.vehicle_link import VehicleLink
from agent.options import Options, OptionsError
from agent.timing.clock import Clock

_STALE_NS = 500_000_000


class VectorNav(Ahrs):
    """A unit that keeps its set-up from run to run, as one that stays under power."""

    title = "VectorNav"

    def __init__(self, line: SensorLine, unix_s: Callable[[], float] = time.time) -> None:
        self._port = CommandPort()
        super().__init__(line, unix_s)

    @classmethod
    def make(cls, options: Options, vehicle: VehicleLink) -> VectorNav:
        """Opens the line. Raises OptionsError and TransportError."""
        if not options.sensor_link:
            raise OptionsError("sensor-link: vectornav needs the port of the autopilot, as tcp://127.0.0.1:5765")
        return cls(open_line(options.sensor_link))

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        super().reset(clock, lockstep, say)
        self._restarts_before = self._port.restarts
        self._commands_before = self._port.commands
        self._junk_before = self._port.junk

    def hear(self, chunk: bytes) -> bool:
        port = self._port
        refused_before = port.refused
        answers = port.feed(chunk)
        for answer in answers:
            self._line.send(answer)
        counts = self.counts
        counts.commands_in = port.commands - self._commands_before
        counts.restarts = port.restarts - self._restarts_before
        counts.junk = port.junk - self._junk_before
        return len(answers) > port.refused - refused_before

    def taken(self) -> bool:
        return self._port.set_up and self._line.connected

    def asked_hz(self) -> float:
        divisor = self._port.divisors.get(INERTIAL)
        return 0.0 if divisor is None else RATE_HZ / divisor

    def absent(self) -> str:
        return "check EAHRS_TYPE 1, SERIALn_PROTOCOL 36, and that this is port n"

    def inertial(self, sample: InertialSample) -> bytes | None:
        return frames.inertial_frame(sample) if self._flows(INERTIAL) else None

    def solution(self, navigation: Navigation) -> bytes | None:
        if not self._flows(SOLUTION):
            return None
        field, pressure = self._readings.field, self._readings.pressure
        faults = 0
        if (
            field is None
            or pressure is None
            or navigation.stamp_ns - min(field.stamp_ns, pressure.stamp_ns) > _STALE_NS
        ):
            faults = frames.FIELD_FAULT
        return frames.solution_frame(navigation, faults)

    def fix(self, fix: ReceiverFix) -> bytes | None:
        return frames.receiver_frame(fix) if self._flows(RECEIVER) else None

    def _flows(self, output: int) -> bool:
        return self._port.on and output in self._port.divisors
