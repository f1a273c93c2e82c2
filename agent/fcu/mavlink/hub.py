"""Shared state of the MAVLink channels of an autopilot: newest samples, events for every station, stored settings."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Callable, Protocol

from agent.fcu.dataflash.stored_logs import StoredLogs
from agent.fcu.mavlink.traffic import TrafficTable
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle_state import ERROR, WARNING, Actuators, Event
from agent.navigation.gps_time import GpsTime
from agent.navigation.measurements import BarometerMeasurement, GnssMeasurement, ImuMeasurement, MagnetometerMeasurement
from agent.timing.tasks import TaskStats

_MOST_WAITING = 128
_SAME_AGAIN_NS = 1_000_000_000
_TEXTS_KEPT = 32
TEXTS_AT_ONCE, TEXTS_HZ = 30, 3.0
_DATED_FIX = 3  # three-dimensional


class SampleLog(Protocol):
    """Part of the flight log that takes samples."""

    def log_imu(self, sample: ImuMeasurement) -> None: ...

    def log_gnss(self, sample: GnssMeasurement, gps_time: GpsTime | None) -> None: ...

    def log_magnetometer(self, sample: MagnetometerMeasurement) -> None: ...

    def log_barometer(self, sample: BarometerMeasurement) -> None: ...


class SettingsStorage(Protocol):
    """Keeps the settings of ground stations over a restart."""

    def keep_parameter(self, name: str, value: float) -> None:
        """Store a changed parameter."""

    def keep_plan(self, autopilot: Autopilot) -> None:
        """Store the present mission and fence."""

    def keep_all_parameters(self, autopilot: Autopilot) -> None:
        """Store all present parameter values."""

    def forget_parameters(self, autopilot: Autopilot) -> None:
        """Reset the stored parameters to their defaults."""


class TextLimit:
    """Token bucket for texts: TEXTS_AT_ONCE at once, then TEXTS_HZ."""

    def __init__(self) -> None:
        self._tokens = float(TEXTS_AT_ONCE)
        self._filled_ns = 0

    def allows(self, now_ns: int) -> bool:
        """Return whether one more text may be sent, and count it."""
        passed_ns, self._filled_ns = max(now_ns - self._filled_ns, 0), now_ns
        self._tokens = min(self._tokens + passed_ns * 1e-9 * TEXTS_HZ, float(TEXTS_AT_ONCE))
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class Outbox:
    """Events that were not sent to one station yet. The oldest are lost when the station's channel is not polled."""

    def __init__(self) -> None:
        self.events: deque[Event] = deque(maxlen=_MOST_WAITING)
        self.reached: deque[int] = deque(maxlen=_MOST_WAITING)
        self.parameters: deque[str] = deque(maxlen=_MOST_WAITING)


class MavlinkHub:
    """One autopilot, its newest samples, and its events, which every station's outbox receives."""

    def __init__(self, autopilot: Autopilot) -> None:
        self.autopilot = autopilot
        self.storage: SettingsStorage | None = None
        self.log: SampleLog | None = None
        self.logs = StoredLogs()
        """Logs that stations may read."""
        self.task_stats: Sequence[TaskStats] = ()
        """Statistics of the agent's tasks, up to the last second."""
        self.unix_s: Callable[[], float] | None = None
        """Date for the first fix, None for the fixed date of repeatable runs."""
        self.actuators = Actuators()
        self.imu: ImuMeasurement | None = None
        self.gnss: GnssMeasurement | None = None
        self.magnetometer: MagnetometerMeasurement | None = None
        self.barometer: BarometerMeasurement | None = None
        self.traffic = TrafficTable()
        """Other vessels, from AIS."""
        self.reboot_asked = False
        """Whether a station requested a restart, see `reboot`."""
        self._outboxes: list[Outbox] = []
        self._warned_ns: dict[str, int] = {}
        self._limits = TextLimit(), TextLimit()  # for ordinary events, and for errors and worse
        self._left_out = self._left_out_said_ns = 0

    # -- samples

    def on_imu(self, sample: ImuMeasurement) -> bool:
        """Forward a sample. Return False when it was refused, as do the next three methods."""
        accepted = self.autopilot.estimator.on_imu(sample)
        if accepted:
            self.imu = sample
            if self.log is not None:
                self.log.log_imu(sample)
        return accepted

    def on_gnss(self, sample: GnssMeasurement) -> bool:
        accepted = self.autopilot.estimator.on_gnss(sample)
        if accepted:
            self.gnss = sample
            if self.autopilot.gps_time is None and sample.fix_type >= _DATED_FIX:
                self.autopilot.gps_time = (
                    GpsTime.fixed()
                    if self.unix_s is None
                    else GpsTime.from_unix_time(self.unix_s(), self.autopilot.estimator.stamp_ns)
                )
            if self.log is not None:
                self.log.log_gnss(sample, self.autopilot.gps_time)
        return accepted

    def on_magnetometer(self, sample: MagnetometerMeasurement) -> bool:
        accepted = self.autopilot.estimator.on_magnetometer(sample)
        if accepted:
            self.magnetometer = sample
            if self.log is not None:
                self.log.log_magnetometer(sample)
        return accepted

    def on_barometer(self, sample: BarometerMeasurement) -> bool:
        accepted = self.autopilot.estimator.on_barometer(sample)
        if accepted:
            self.barometer = sample
            if self.log is not None:
                self.log.log_barometer(sample)
        return accepted

    def reboot(self) -> None:
        """Restart with the present parameters and plans, as after a power cycle."""
        self.reboot_asked = False
        self.imu = self.gnss = self.magnetometer = self.barometer = None
        self.actuators = Actuators()
        self.traffic = TrafficTable()
        self.autopilot.reset()

    # -- events

    def open_outbox(self) -> Outbox:
        """Open an outbox for another station."""
        outbox = Outbox()
        self._outboxes.append(outbox)
        return outbox

    def close_outbox(self, outbox: Outbox) -> None:
        """Close the outbox of a station that has left."""
        if outbox in self._outboxes:
            self._outboxes.remove(outbox)

    def distribute(self, now_ns: int) -> None:
        """Add the autopilot's events since the last call to every outbox.

        The same warning is sent at most once a second.

        A faulty station may cause fifty different events a second. So the number of events is limited too, separately
        for urgent ones. Dropped events are counted as lost, and a text reports their number.
        """
        reached, events = self.autopilot.navigator.drain_reached(), self.autopilot.events.drain()
        if not reached and not events and not self._left_out:
            return
        events = [event for event in events if event.severity != WARNING or self._is_news(event.text, now_ns)]
        within = [event for event in events if self._limits[event.severity <= ERROR].allows(now_ns)]
        left_out = len(events) - len(within)
        self._left_out += left_out
        self.autopilot.events.lost += left_out
        events = within
        if self._left_out and not 0 <= now_ns - self._left_out_said_ns < _SAME_AGAIN_NS:
            events.append(Event(WARNING, f"{self._left_out} texts dropped, too many at once"))
            self._left_out, self._left_out_said_ns = 0, now_ns
        for outbox in self._outboxes:
            outbox.reached.extend(reached)
            outbox.events.extend(events)

    def _is_news(self, text: str, now_ns: int) -> bool:
        warned_ns = self._warned_ns.pop(text, None)
        is_news = warned_ns is None or not 0 <= now_ns - warned_ns < _SAME_AGAIN_NS
        if len(self._warned_ns) >= _TEXTS_KEPT:
            del self._warned_ns[next(iter(self._warned_ns))]
        self._warned_ns[text] = now_ns if is_news or warned_ns is None else warned_ns
        return is_news

    def warn(self, text: str) -> None:
        """Add a warning about a faulty message."""
        self.autopilot.events.add(WARNING, text)

    def parameter_changed(self, name: str, by: Outbox | None = None) -> None:
        """Report a change to all stations except `by`, which already has its reply."""
        for outbox in self._outboxes:
            if outbox is not by and name not in outbox.parameters:
                outbox.parameters.append(name)
