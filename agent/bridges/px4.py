"""PX4's simulator messages: HIL_SENSOR and HIL_GPS out, HIL_ACTUATOR_CONTROLS in.

A PX4 program (SITL) uses a separate line: we listen, by convention at TCP 4560, and PX4 connects once in its lifetime.
A board in HITL mode (SYS_HITL 1) uses its MAVLink, in real time. SITL is tested with PX4 1.16. Boards are not tested;
the code follows PX4's source (mavlink_receiver, pwm_out_sim).

Lockstep is one-sided. The stamps of HIL_SENSOR are the clock of a SITL build, so it does not run without us. But
nothing prevents us from running ahead of it, because HIL_ACTUATOR_CONTROLS does not answer a HIL_SENSOR. PX4 sends it
when the control loops have new outputs, at their rate. It sends none while it starts and, for a rover, while it is
disarmed.

So there are two ways to pace the run. While outputs arrive, we wait for each one when the period of the last outputs
shows that it is due. While none arrive, we run a little slower than real time and never catch up, so that PX4 has
enough time. When every HIL_SENSOR is answered, at the 100 Hz of a rover's outputs, PX4's estimator misses no sample.
"""

from __future__ import annotations

import time
from collections import deque
from itertools import islice
from operator import sub
from time import monotonic
from typing import Callable

from agent.bridges import hil_messages as hil
from agent.bridges.injector import Injector, InjectorCounters
from agent.bridges.readings import InertialSample, ReceiverFix, SensorReadings
from agent.bridges.vehicle_link import VehicleLink
from agent.navigation.measurements import ImuMeasurement
from agent.timing.clock import Clock, MonotonicClock
from agent.wire import dialect as mav
from agent.wire.codec import Message
from agent.wire.link import Link
from agent.wire.transport import open_transport

SYSTEM_ID, COMPONENT_ID = 254, 51  # different from the autopilot and from ground stations
FIRST_US = 1_000_000  # PX4's clock at the first sample: never 0, which PX4 treats as no time
APART_US = 1_000_000  # between two runs with the same PX4
PACE = 0.9  # of real time, while no outputs arrive
RHYTHM = 4  # number of outputs that define the period
LONGEST_PERIOD_US = 50_000
EARLY_US = 500
PATIENCE_S = 0.3  # of real time, for an output that is due
LAST_PATIENCE_S = 0.05  # after the run, when PX4 disarms and its outputs end
_LOCKSTEP = 1  # HIL_ACTUATOR_CONTROLS.flags


class Px4Line:
    """Line that listens at `url` and serves the PX4 that connects.

    junk: number of bytes and frames that are not MAVLink 2.
    restarts: number of times PX4 disconnected in this run.

    Raises TransportError at construction.
    """

    def __init__(self, url: str) -> None:
        self._transport = open_transport(url, listen=True)
        self._link = Link(self._transport, SYSTEM_ID, COMPONENT_ID, foreign=True)
        self._base_us = FIRST_US
        self._newest_us = 0  # on PX4's clock
        self.begin()

    def begin(self) -> None:
        """Start a run at stamp 0.

        Its samples continue after those of the last run, because PX4's clock must not step back.
        """
        if self._newest_us:
            self._base_us = self._newest_us + APART_US
        self._peer = self._transport.peer
        self.restarts = 0
        self._heard: list[Message] = []
        self._link.reset_counters()
        self._forget()
        self._warning = ""
        self._warned = False

    def _forget(self) -> None:
        self._stamps: deque[int] = deque(maxlen=RHYTHM + 1)
        self._period_us = 0
        self._answers = False
        self._output_due_s: float | None = None
        self._anchor: tuple[float, int] | None = None
        self._keeps_step = True

    @property
    def connected(self) -> bool:
        """Whether PX4 is connected."""
        return bool(self._transport.peer)

    @property
    def answers(self) -> bool:
        """Whether outputs arrive."""
        return self._answers and self.connected

    @property
    def address(self) -> str:
        """Address that listens."""
        return self._transport.address

    @property
    def junk(self) -> int:
        """Number of received bytes and frames that are not MAVLink 2."""
        return self._link.counters.dropped

    def take_warning(self) -> str:
        """Return a warning for the user, once. Empty when there is none."""
        warning, self._warning = self._warning, ""
        return warning

    def is_old(self, message: Message) -> bool:
        """Whether the message is a HIL_SENSOR that is not newer than the last one. It would set PX4's clock back."""
        sensor = isinstance(message, mav.MAVLink_hil_sensor_message)
        return sensor and message.time_usec + self._base_us <= self._newest_us

    def send(self, message: Message, patience_s: float) -> bool:
        """Send a message. HIL_SENSOR gets PX4's stamp, and its output may take `patience_s` of real time.

        Return False when PX4 is absent or the line is full.
        """
        if not isinstance(message, mav.MAVLink_hil_sensor_message):
            return self._link.send(message)
        stamp_us = message.time_usec + self._base_us
        ours_us, message.time_usec = message.time_usec, stamp_us
        if not self._link.send(message):
            message.time_usec = ours_us
            return False
        self._newest_us = stamp_us
        self._output_due_s = monotonic() + patience_s
        return True

    def settle(self, until_s: float) -> bool:
        """Wait until PX4 may receive the next sample.

        Return False if it may not at `until_s` of the monotonic clock.
        """
        if self._output_due_s is None:
            self._listen(0.0)
        while self._output_due_s is not None and self.connected:
            now_s = monotonic()
            if not (self._answers and self._keeps_step):
                lead_s = self._lead_s(now_s)
                self._listen(min(lead_s, max(until_s - now_s, 0.0)))
                if lead_s <= 0.0 and now_s < until_s:
                    self._output_due_s = None
            elif not self._is_output_due():
                self._output_due_s = None
            elif now_s < self._output_due_s:
                self._listen(max(min(self._output_due_s, until_s) - now_s, 0.0))
            else:
                self._answers = False  # PX4 no longer sends outputs
                self._stamps.clear()
                self._anchor = None
            if now_s >= until_s:
                break
        return self._output_due_s is None and self.connected

    def _is_output_due(self) -> bool:
        """Whether an output for the newest sample is still due."""
        last_us = self._stamps[-1]
        return last_us < self._newest_us and self._newest_us + EARLY_US >= last_us + self._period_us

    def _lead_s(self, now_s: float) -> float:
        """Lead of the samples over their pace, in seconds. A lag is not made up: PX4 would miss samples of a burst."""
        lead_s = 0.0
        if self._anchor is not None:
            lead_s = (self._newest_us - self._anchor[1]) * 1e-6 / PACE - (now_s - self._anchor[0])
        if self._anchor is None or lead_s <= 0.0:
            self._anchor = (now_s, self._newest_us)
        return max(lead_s, 0.0)

    def receive(self, timeout_s: float) -> list[Message]:
        """Return the received messages. Wait at most `timeout_s`."""
        self._listen(timeout_s)
        return self.take_received()

    def take_received(self) -> list[Message]:
        """Return the messages that arrived during other waits."""
        heard, self._heard = self._heard, []
        return heard

    def _listen(self, timeout_s: float) -> None:
        messages = self._link.receive(timeout_s)
        peer = self._transport.peer
        if peer != self._peer:
            self.restarts += bool(self._peer)
            self._peer = peer
            self._forget()
        for message in messages:
            if isinstance(message, mav.MAVLink_hil_actuator_controls_message):
                self._note(message)
        self._heard += messages

    def _note(self, message: Message) -> None:
        self._keeps_step = bool(message.flags & _LOCKSTEP)
        if not self._keeps_step:
            if not self._warned:
                self._warned = True
                self._warning = "this PX4 uses its own clock (not a lockstep build); it runs in real time"
            return
        stamps = self._stamps
        if stamps and not 0 < message.time_usec - stamps[-1] <= LONGEST_PERIOD_US:
            stamps.clear()
        stamps.append(message.time_usec)
        self._answers = len(stamps) > 1
        self._period_us = max(map(sub, islice(stamps, 1, None), stamps), default=0)

    def descriptors(self) -> tuple[int, ...]:
        """Descriptors that become readable when PX4 connects or sends."""
        descriptor = self._transport.fileno()
        return () if descriptor is None else (descriptor,)

    def close(self) -> None:
        """Stop listening."""
        self._transport.close()


OUTPUTS = 16
HIL_ENABLED = 32  # MAV_MODE_FLAG_HIL_ENABLED
UNSIMULATED_NS = 5_000_000_000
BLOCK_S = 0.4  # longest wait of one `advance`
RUN_ON_WAIT_S = 0.002  # longest wait of one `run_on`
UNCALLED_S = 3.0
UNCALLED = "PX4 does not connect to {}: it connects only once, so restart it for each run, with this simulator port"
_ERROR, _WARNING, _NOTICE = mav.MAV_SEVERITY_ERROR, mav.MAV_SEVERITY_WARNING, mav.MAV_SEVERITY_NOTICE


class Px4Injector(Injector):
    """Injector for PX4. line: connection to a PX4 program, None for a board at the other end of `vehicle`."""

    title = "PX4 simulator messages"

    def __init__(self, vehicle: VehicleLink, line: Px4Line | None, unix_s: Callable[[], float] = time.time) -> None:
        self.counts = InjectorCounters()
        self._advanced_s = 0.0
        self._vehicle = vehicle
        self._line = line
        self._unix_s = unix_s
        vehicle.add_tap(self._on_vehicle)
        self.reset(MonotonicClock(), False, lambda severity, text: None)

    @classmethod
    def open(cls, url: str, vehicle: VehicleLink) -> Px4Injector:
        """Listen at `url` for a PX4 program. An empty `url` selects a board. Raises TransportError."""
        return cls(vehicle, Px4Line(url) if url else None)

    # -- called by the role

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        self.counts = InjectorCounters()
        self._clock = clock
        self._lockstep = lockstep
        self._say = say
        self._readings = SensorReadings(lockstep, self._unix_s, solves=False)
        self._updated = 0
        self._newest: InertialSample | None = None
        self._queue: deque[Message] = deque()
        self._outputs = (0.0,) * OUTPUTS
        self._waited_s = 0.0
        self._uncalled = False
        self._heard_ns: int | None = None
        self._unsimulated = False
        self._armed = False
        if self._line is not None:
            self._line.begin()
        elif lockstep:
            say(_ERROR, "PX4 on a board uses its own clock; use clock.mode=realtime, or a simulator link for its SITL")

    def handle(self, message: Message, now_ns: int) -> None:
        sample = self._readings.handle(message)
        if isinstance(sample, ImuMeasurement):
            updated, self._updated = self._updated | hil.ACCEL | hil.GYRO, 0
            self._newest = self._readings.inertial_sample(sample)
            self._send(hil.sensor_message(self._newest, updated))
        elif isinstance(sample, ReceiverFix):
            self._send(hil.gps_message(sample))
        else:
            self._updated |= hil.updated_fields(sample)
        self.counts.refused = self._readings.refused

    def serve(self, now_ns: int) -> None:
        line = self._line
        if line is not None:
            if monotonic() - self._advanced_s > BLOCK_S:  # between runs; in lockstep, `advance` receives during a run
                self._note(line.receive(0.0))
            self.counts.junk = line.junk
            self.counts.taken = line.connected
            return
        if self._unsimulated or self._heard_ns is None or now_ns - self._heard_ns < UNSIMULATED_NS:
            return
        if not self.counts.taken:
            self._unsimulated = True
            self._say(_WARNING, "PX4 does not simulate: it is not in HITL mode; set SYS_HITL 1 and restart it")

    def advance(self, now_ns: int) -> bool:
        """Forward the queued samples, one IMU sample after the other, each when PX4 is ready for it."""
        line = self._line
        if line is None:
            return True
        until_s = monotonic() + BLOCK_S
        if not self._wait_for_connection(line, until_s):
            return False
        queue = self._queue
        followed = line.settle(until_s)
        while followed and queue:
            if self._forward(line, queue[0]):
                queue.popleft()
                followed = line.settle(until_s)
            else:
                self._note(line.receive(0.01))
                followed = monotonic() <= until_s and line.connected
        self._note(line.take_received())
        self._advanced_s = monotonic()
        return followed

    def run_on(self, now_ns: int) -> bool:
        """Repeat the newest inertial sample until the outputs end, so that PX4 disarms before its log ends."""
        line, newest = self._line, self._newest
        if line is None or newest is None or not line.answers:
            return True
        settled = line.settle(monotonic() + RUN_ON_WAIT_S)
        self._note(line.take_received())
        if not settled:
            return False
        return self._forward(
            line, hil.sensor_message(newest._replace(stamp_ns=now_ns), hil.ACCEL | hil.GYRO), LAST_PATIENCE_S
        )

    def commands(self) -> tuple[float, ...]:
        return self._outputs

    def descriptors(self) -> tuple[int, ...]:
        return () if self._line is None else self._line.descriptors()

    @property
    def addresses(self) -> tuple[str, ...]:
        return () if self._line is None else (self._line.address,)

    def close(self) -> None:
        if self._line is not None:
            self._line.close()

    # -- out

    def _send(self, message: Message) -> None:
        line = self._line
        if line is not None and self._lockstep:
            self._queue.append(message)
        elif line is not None:
            self.counts.unsent += not self._forward(line, message)
        elif self._vehicle.send_sample(message):
            self._count(message)
        else:
            self.counts.unsent += 1

    def _forward(self, line: Px4Line, message: Message, patience_s: float | None = None) -> bool:
        """Forward a sample. Return False when the line cannot take it now.

        A sample not newer than the last one is dropped.
        """
        if line.is_old(message):
            self.counts.unsent += 1
        elif line.send(message, PATIENCE_S if patience_s is None else patience_s):
            self._count(message)
        else:
            return False
        return True

    def _count(self, message: Message) -> None:
        if isinstance(message, mav.MAVLink_hil_gps_message):
            self.counts.gnss_out += 1
        else:
            self.counts.imu_out += 1

    # -- in

    def _wait_for_connection(self, line: Px4Line, until_s: float) -> bool:
        """Whether PX4 is connected. Wait for the connection, and warn once when it does not arrive."""
        began_s = monotonic()
        while not line.connected and monotonic() < until_s:
            self._note(line.receive(until_s - monotonic()))
        self.counts.taken = line.connected
        if line.connected:
            self._waited_s = 0.0
            if self._uncalled:
                self._uncalled = False
                self._say(_NOTICE, f"PX4 has connected to {line.address}")
            return True
        self._waited_s += monotonic() - began_s
        if self._waited_s > UNCALLED_S and not self._uncalled:
            self._uncalled = True
            self._say(_WARNING, UNCALLED.format(line.address))
        return False

    def _on_vehicle(self, message: Message) -> None:
        """Handle a message from the autopilot's MAVLink, which carries the outputs of a board."""
        if self._line is None and isinstance(message, mav.MAVLink_hil_actuator_controls_message):
            self._note([message])
        if not isinstance(message, mav.MAVLink_heartbeat_message) or message.autopilot != mav.MAV_AUTOPILOT_PX4:
            return
        armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
        if self._armed and not armed:  # a disarmed PX4 sends no new outputs
            self._outputs = (0.0,) * OUTPUTS
            self.counts.outputs_in += 1
        self._armed = armed
        if self._line is None:
            self._heard_ns = self._clock.now_ns() if self._heard_ns is None else self._heard_ns
            self.counts.taken = bool(message.base_mode & HIL_ENABLED)

    def _note(self, messages: list[Message]) -> None:
        line = self._line
        for message in messages:
            if isinstance(message, mav.MAVLink_hil_actuator_controls_message):
                self.counts.outputs_in += 1
                armed = message.mode & mav.MAV_MODE_FLAG_SAFETY_ARMED
                self._outputs = tuple(message.controls) if armed else (0.0,) * OUTPUTS
        if line is None:
            return
        if line.restarts > self.counts.restarts:
            self.counts.restarts = line.restarts
            self._outputs = (0.0,) * OUTPUTS
            self.counts.outputs_in += 1
            self._say(_WARNING, f"PX4 has disconnected from {line.address}; its outputs count as 0 until it returns")
        warning = line.take_warning()
        if warning:
            self._say(_WARNING, warning)
