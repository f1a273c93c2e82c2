"""A simulated navigation unit on a line of its own: our sensors as the frames that an external-AHRS driver reads.

Stock firmware takes them for a unit on one of its serial ports (SERIALn_PROTOCOL 36) and runs its own EKF on them.
Two makes of unit are behind this: `vectornav` and `microstrain`. Every inertial sample of ours goes out at once, with
the newest magnetic field and pressure beside it; every fix when it comes, so that its latency is the one of our
receiver; and the solution of our own estimator, at 50 Hz, once a place is known: before that, software-in-the-loop
builds of ArduPilot end with a panic over a place of zeros.

In lockstep the driver's thread still sleeps a millisecond of real time between two looks at its port. Much faster than
real time there would be turns of the main loop without an inertial sample, which the EKF makes up for twice: at 13
times attitude and heading were seen to go wrong by degrees. So a run with such a unit is held to `LOCKSTEP_FACTOR`.

Start-up: an ArduPilot without another barometer wants pressure within 0.5 s of its calibration, else it stays in
"Config Error: Baro: unable to calibrate" for good. So the run has to be on, with sensors flowing, before it boots.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Callable

from agent.bridges.injector import Injection, Injector
from agent.bridges.pace import Pace, RateGauge, SpeedLimit
from agent.bridges.readings import Readings
from agent.bridges.samples import InertialSample, Navigation, ReceiverFix
from agent.bridges.sensor_line import SensorLine
from agent.fcu.samples import BarometerSample, ImuSample, MagnetometerSample
from agent.timing.clock import Clock, MonotonicClock
from agent.wire import dialect as mav
from agent.wire.codec import Message

SOLUTION_NS = 20_000_000
LOCKSTEP_FACTOR = 8.0
PATIENCE_NS = 5_000_000_000  # of a run, before it is said that nothing is heard at the line
_WARNING, _NOTICE = 4, 5  # MAV_SEVERITY
_KINDS = _INERTIAL, _SOLUTION, _FIX = "inertial", "solution", "fix"
_SLOW = 0.9  # below this part of the rate that was asked for, it is said

Say = Callable[[int, str], None]


class Ahrs(Injector):
    """What the two makes have in common; each says what its frames look like and when they may flow.

    `unix_s` gives the date of runs in real time; runs in lockstep have a fixed one.
    """

    title = "external AHRS"

    def __init__(self, line: SensorLine, unix_s: Callable[[], float] = time.time) -> None:
        self.counts = Injection()
        self._line = line
        self._unix_s = unix_s
        self.reset(MonotonicClock(), False, lambda severity, text: None)

    # -- what a make has to say

    def inertial(self, sample: InertialSample) -> bytes | None:
        """Its frame, None while there is to be none."""
        raise NotImplementedError

    def solution(self, navigation: Navigation) -> bytes | None:
        """Its frame, None while there is to be none."""
        raise NotImplementedError

    def fix(self, fix: ReceiverFix) -> bytes | None:
        """Its frame, None while there is to be none."""
        raise NotImplementedError

    def hear(self, chunk: bytes) -> bool:
        """Bytes from the autopilot; whether they made sense."""
        raise NotImplementedError

    def taken(self) -> bool:
        """Whether the autopilot takes the frames, as far as can be known."""
        raise NotImplementedError

    def asked_hz(self) -> float:
        """Rate of inertial frames that the autopilot asks for, 0 for any."""
        return 0.0

    def absent(self) -> str:
        """What to check when nothing is heard."""
        raise NotImplementedError

    # -- the role's side

    def reset(self, clock: Clock, lockstep: bool, say: Say) -> None:
        self.counts = Injection()
        self._say = say
        self._line.clear()
        self._began_ns = clock.now_ns()
        self._readings = Readings(lockstep, self._unix_s)
        self._solution_pace = Pace(SOLUTION_NS)
        self._inertial_pace, self._paced_hz = Pace(0), 0.0
        self._gauge = RateGauge()
        self._limit = SpeedLimit(LOCKSTEP_FACTOR)
        self._told_slow = self._told_absent = self._was_taken = False

    def take(self, message: Message, now_ns: int) -> None:
        if isinstance(message, mav.MAVLink_xitl_imu_message):
            self._on_imu(message)
        elif isinstance(message, mav.MAVLink_xitl_magnetometer_message):
            self._readings.take_field(message)
        elif isinstance(message, mav.MAVLink_xitl_barometer_message):
            self._readings.take_pressure(message)
        elif isinstance(message, mav.MAVLink_xitl_gnss_message):
            self._on_gnss(message)
        self._flush(now_ns)
        self.counts.refused = self._readings.refused

    def serve(self, now_ns: int) -> None:
        for index, chunk in enumerate(self._line.receive()):
            if self.hear(chunk):
                self._line.heard(index)
        self._flush(now_ns)
        taken = self.taken()
        if taken and not self._was_taken:
            self._told_absent = True  # from here on it can only leave
            self._say(_NOTICE, f"the autopilot takes our sensors as a {self.title} at {self._line.address}")
        elif self._was_taken and not taken:
            self._say(_WARNING, f"the autopilot takes no sensors at {self._line.address} any more; they are lost")
        elif not taken and not self._told_absent and now_ns - self._began_ns > PATIENCE_NS:
            self._told_absent = True
            self._say(_WARNING, f"nothing asks for a {self.title} at {self._line.address}; {self.absent()}")
        self._was_taken = self.counts.taken = taken

    def advance(self, now_ns: int) -> bool:
        self._flush(now_ns)
        self._limit.hold(now_ns)
        return True

    def _flush(self, now_ns: int) -> None:
        counts, line = self.counts, self._line
        line.flush(now_ns)
        counts.imu_out, counts.solution_out, counts.gnss_out = (line.sent[kind] for kind in _KINDS)
        counts.unsent = line.unsent

    def descriptors(self) -> Sequence[int]:
        return self._line.descriptors()

    @property
    def addresses(self) -> tuple[str, ...]:
        return (self._line.address,)

    def close(self) -> None:
        self._line.close()

    # -- samples

    def _on_imu(self, message: Message) -> None:
        readings = self._readings
        sample = readings.imu(message)
        if sample is None:
            return
        if readings.field is not None and readings.pressure is not None:
            self._send_inertial(sample, readings.field, readings.pressure)
        readings.solve(sample)
        if self._solution_pace.due(sample.stamp_ns):
            navigation = readings.newest()
            frame = None if navigation is None else self.solution(navigation)
            if frame is not None:
                self._line.send(frame, _SOLUTION)

    def _send_inertial(self, imu: ImuSample, field: MagnetometerSample, pressure: BarometerSample) -> None:
        asked_hz = self.asked_hz()
        if asked_hz != self._paced_hz:
            self._inertial_pace, self._paced_hz = Pace(round(1e9 / asked_hz) if asked_hz else 0), asked_hz
        rate_hz = self._gauge.add(imu.stamp_ns)
        if rate_hz is not None and rate_hz < _SLOW * asked_hz and not self._told_slow:
            self._told_slow = True
            text = f"inertial samples come at {rate_hz:.0f} Hz, the autopilot asks for {asked_hz:.0f}"
            self._say(_WARNING, f"{text}; set EAHRS_RATE to sensors.imu.rate_hz")
        if not self._inertial_pace.due(imu.stamp_ns):
            return
        frame = self.inertial(
            InertialSample(
                imu.stamp_ns,
                imu.gyro_frd_radps,
                imu.accel_frd_mps2,
                field.field_frd_gauss,
                pressure.pressure_pa,
                pressure.temperature_degc,
            )
        )
        if frame is not None:
            self._line.send(frame, _INERTIAL)

    def _on_gnss(self, message: Message) -> None:
        fix = self._readings.fix(message)
        if fix is None:
            return
        frame = self.fix(fix)
        if frame is not None:
            self._line.send(frame, _FIX)
        self._readings.solve(fix)
