"""The line to PX4's simulator interface: who waits for whom, and by which clock.

Lockstep is one-sided there. The stamps of HIL_SENSOR are PX4's clock, so it does not run without us; but nothing keeps
us from running away from it, for HIL_ACTUATOR_CONTROLS is no answer to a HIL_SENSOR: it comes when the control loops
put out something new, at a rate of theirs, and not at all while PX4 starts or, with a rover, while it is disarmed. So
there are two ways of going on: while outputs come, each is waited for when the rhythm of the last ones says that it is
due; while none come, we keep to real time, which leaves PX4 the time that it would have had.
"""

from __future__ import annotations

from collections import deque
from time import monotonic

from agent.wire import dialect as mav
from agent.wire.codec import Message
from agent.wire.link import Link
from agent.wire.transport import open_transport

SYSTEM_ID, COMPONENT_ID = 254, 51  # neither the autopilot's nor a ground station's
FIRST_US = 1_000_000  # PX4's clock at the first sample: never 0, which is no time there
APART_US = 1_000_000  # between a run and the next with the same PX4
RHYTHM = 4  # outputs
LONGEST_PERIOD_US = 50_000
EARLY_US = 500
PATIENCE_S = 0.3  # of real time, for an output that is due
_LOCKSTEP = 1  # HIL_ACTUATOR_CONTROLS.flags


class Px4Line:
    """Listens at `url` and speaks with the one that calls.

    junk: bytes and frames that are none of MAVLink 2. restarts: how often the caller left in this run. Raises
    TransportError at construction.
    """

    def __init__(self, url: str) -> None:
        self._transport = open_transport(url, listen=True)
        self._link = Link(self._transport, SYSTEM_ID, COMPONENT_ID, foreign=True)
        self._base_us = FIRST_US
        self._newest_us = 0  # on PX4's clock
        self.begin()

    def begin(self) -> None:
        """A run starts at stamp 0. Its samples go on from the last run's, for PX4's clock must not step back."""
        if self._newest_us:
            self._base_us = self._newest_us + APART_US
        self._peer = self._transport.peer
        self.restarts = 0
        self._heard: list[Message] = []
        self._link.reset_counters()
        self._forget()
        self._word = ""
        self._told = False

    def _forget(self) -> None:
        self._stamps: deque[int] = deque(maxlen=RHYTHM + 1)
        self._answers = False
        self._owed_s: float | None = None
        self._anchor: tuple[float, int] | None = None
        self._keeps_step = True

    @property
    def connected(self) -> bool:
        """Whether PX4 is there."""
        return bool(self._transport.peer)

    @property
    def address(self) -> str:
        """Where it is listened."""
        return self._transport.address

    @property
    def junk(self) -> int:
        """What came and was no MAVLink 2."""
        return self._link.counters.dropped

    def word(self) -> str:
        """A sentence for people, once."""
        word, self._word = self._word, ""
        return word

    def is_old(self, message: Message) -> bool:
        """Whether it is a HIL_SENSOR that is not newer than the last: it would set PX4's clock back."""
        sensor = isinstance(message, mav.MAVLink_hil_sensor_message)
        return sensor and message.time_usec + self._base_us <= self._newest_us

    def send(self, message: Message) -> bool:
        """Send; HIL_SENSOR gets PX4's stamp. False when PX4 is not there or takes nothing more."""
        if not isinstance(message, mav.MAVLink_hil_sensor_message):
            return self._link.send(message)
        stamp_us = message.time_usec + self._base_us
        ours_us, message.time_usec = message.time_usec, stamp_us
        if not self._link.send(message):
            message.time_usec = ours_us
            return False
        self._newest_us = stamp_us
        self._owed_s = monotonic() + PATIENCE_S
        return True

    def settle(self, until_s: float) -> bool:
        """Wait until PX4 may get the next sample; False when it may not at `until_s` of the monotonic clock."""
        while self._owed_s is not None and self.connected:
            now_s = monotonic()
            if self._answers and self._keeps_step:
                if not self._due():
                    self._owed_s = None
                    break
                if now_s >= self._owed_s:
                    self._answers = False  # it has fallen silent
                    self._stamps.clear()
                    self._anchor = None
                    continue
                wait_s = min(self._owed_s, until_s) - now_s
            else:
                wait_s = min(self._lead_s(now_s), until_s - now_s)
                if wait_s <= 0.0:
                    self._owed_s = None if now_s < until_s else self._owed_s
                    break
            self._listen(max(wait_s, 0.0))
            if self._owed_s is not None and monotonic() >= until_s:
                break
        self._listen(0.0)
        return self._owed_s is None and self.connected

    def _due(self) -> bool:
        """Whether an output of the newest sample is still to come."""
        last_us = self._stamps[-1]
        if last_us >= self._newest_us:
            return False
        stamps = list(self._stamps)
        period_us = max(after - before for before, after in zip(stamps, stamps[1:]))
        return self._newest_us + EARLY_US >= last_us + period_us

    def _lead_s(self, now_s: float) -> float:
        """How much the samples are ahead of real time."""
        if self._anchor is None:
            self._anchor = (now_s, self._newest_us)
        lead_s = (self._newest_us - self._anchor[1]) * 1e-6 - (now_s - self._anchor[0])
        if lead_s < -PATIENCE_S:
            self._anchor = (now_s, self._newest_us)
        return max(lead_s, 0.0)

    def receive(self, timeout_s: float) -> list[Message]:
        """What has come, waiting for it at most so long."""
        self._listen(timeout_s)
        return self.taken()

    def taken(self) -> list[Message]:
        """What came while something else was waited for."""
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
            if not self._told:
                self._told = True
                self._word = "this PX4 keeps its own time (no lockstep build); it is run in real time"
            return
        stamps = self._stamps
        if stamps and not 0 < message.time_usec - stamps[-1] <= LONGEST_PERIOD_US:
            stamps.clear()
        stamps.append(message.time_usec)
        self._answers = len(stamps) > 1

    def descriptors(self) -> tuple[int, ...]:
        """What becomes readable when PX4 calls or says something."""
        descriptor = self._transport.fileno()
        return () if descriptor is None else (descriptor,)

    def close(self) -> None:
        """Stop listening."""
        self._transport.close()
