"""Which messages an autopilot is asked to send, and how often."""

from __future__ import annotations

from collections import deque

from agent.wire import dialect as mav
from agent.wire.codec import Message

A_CYCLE = 4
ASK_AGAIN_NS = 3_000_000_000
SELDOM_NS = 20_000_000_000
ASKS = 4
ANSWER_NS = 2_000_000_000

RATES_HZ = {
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 10.0,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mav.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 2.0,
    mav.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 2.0,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
}
OUTPUTS_HZ = (50.0, 40.0, 20.0, 10.0)
"""Of SERVO_OUTPUT_RAW, the first that comes: ArduPilot refuses more than 0.8 of its loop rate and sends 1 Hz then."""
SPARE_OUTPUTS_HZ = (2.0,)
"""Of SERVO_OUTPUT_RAW, where the outputs come another way."""

_INTERVAL, _ONCE = mav.MAV_CMD_SET_MESSAGE_INTERVAL, mav.MAV_CMD_REQUEST_MESSAGE
_VERSION = mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION


class _Wanted:
    """One kind of message: asked for until it comes, and again when it stays away; seldom after some tries.

    rates_hz: what is asked for, and what next when it comes less than a quarter as often.
    """

    def __init__(self, rates_hz: tuple[float, ...]) -> None:
        self.rates_hz = rates_hz
        self.asked_ns: int | None = None
        self.asks = 0
        self.seen_ns: int | None = None
        self.seen = 0

    def is_due(self, now_ns: int) -> bool:
        if self.asked_ns is None:
            return True
        waited_ns = now_ns - self.asked_ns
        if self.seen_ns is not None and (not self.rates_hz[0] or now_ns - self.seen_ns < ASK_AGAIN_NS):
            if len(self.rates_hz) == 1 or waited_ns < ASK_AGAIN_NS or self.is_often_enough(now_ns):
                return False
            self.rates_hz = self.rates_hz[1:]
            return True
        return waited_ns >= (ASK_AGAIN_NS if self.asks < ASKS else SELDOM_NS)

    def is_often_enough(self, now_ns: int) -> bool:
        """Since the last look."""
        assert self.asked_ns is not None
        enough = self.seen >= 0.25 * self.rates_hz[0] * (now_ns - self.asked_ns) * 1e-9
        self.asked_ns, self.seen = now_ns, 0
        return enough


class Streams:
    """Asks by MAV_CMD_SET_MESSAGE_INTERVAL, a few kinds at a time, and for AUTOPILOT_VERSION once it has none."""

    def __init__(self, outputs_wanted: bool) -> None:
        self._rates_hz = {
            **{number: (rate_hz,) for number, rate_hz in RATES_HZ.items()},
            mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: OUTPUTS_HZ if outputs_wanted else SPARE_OUTPUTS_HZ,
            _VERSION: (0.0,),
        }
        self._unanswered: dict[int, deque[int]] = {_INTERVAL: deque(), _ONCE: deque()}
        self.reset()

    def reset(self) -> None:
        """Ask for everything again."""
        self._wanted = {number: _Wanted(rates_hz) for number, rates_hz in self._rates_hz.items()}
        for times in self._unanswered.values():
            times.clear()

    def note(self, number: int, now_ns: int) -> None:
        """A message of this number has come."""
        wanted = self._wanted.get(number)
        if wanted is not None:
            wanted.seen_ns = now_ns
            wanted.seen += 1

    def due(self, now_ns: int) -> list[Message]:
        """Requests to be sent now."""
        requests: list[Message] = []
        for number, wanted in self._wanted.items():
            if len(requests) == A_CYCLE:
                break
            if not wanted.is_due(now_ns):
                continue
            wanted.asked_ns, wanted.asks, wanted.seen_ns, wanted.seen = now_ns, wanted.asks + 1, None, 0
            rate_hz = wanted.rates_hz[0]
            command = _INTERVAL if rate_hz else _ONCE
            interval_us = round(1e6 / rate_hz) if rate_hz else 0
            self._unanswered[command].append(now_ns)
            requests.append(mav.MAVLink_command_long_message(1, 1, command, 0, number, interval_us, 0, 0, 0, 0, 0))
        return requests

    def owns(self, message: Message, now_ns: int) -> bool:
        """Whether it acknowledges a request of ours: then it is not for the host."""
        if not isinstance(message, mav.MAVLink_command_ack_message):
            return False
        times = self._unanswered.get(message.command)
        while times and now_ns - times[0] > ANSWER_NS:
            times.popleft()
        if not times:
            return False
        times.popleft()
        return True
