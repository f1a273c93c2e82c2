"""The embedded autopilot as a node: LS, LC and LA, its ground stations, its storage and its log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Callable

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.mavlink.hub import Outbox
from agent.fcu.vehicle.autopilot import LOOP_HZ
from agent.fcu.vehicle_state import Actuators
from agent.roles.ground_stations import GroundStations
from agent.roles.role import Role, Traffic
from agent.roles.storage import Storage
from agent.timing.clock import Clock, MonotonicClock
from agent.timing.tasks import Executor, TaskMiss, TaskStats
from agent.wire import dialect
from agent.wire.actuators import actuators_message
from agent.wire.codec import Message

if TYPE_CHECKING:
    from agent.fcu.dataflash.flight_log import FlightLog
    from agent.fcu.dataflash.stored_logs import StoredLogs


class AutopilotRole(Role):
    """Sensors in, actuators out at LOOP_HZ.

    make_channel: builds a new autopilot for every run.

    send: sends messages to the host.
    ground: serves ground stations, between runs too, when parameters and plans can be set without motion.
    storage: keeps their settings over a restart.
    make_log: takes this node's clock and returns a flight log, which starts a new file with each run. This role closes
      none of these three.
    stored_logs: logs that stations may read.
    """

    title = "embedded autopilot"
    nodes = "LS,LC,LA"
    telemetry_hz = LOOP_HZ

    def __init__(
        self,
        make_channel: Callable[[], MavlinkChannel],
        send: Callable[[Message], bool],
        ground: GroundStations | None = None,
        storage: Storage | None = None,
        make_log: Callable[[Callable[[], int]], FlightLog] | None = None,
        stored_logs: StoredLogs | None = None,
    ) -> None:
        self._make_channel = make_channel
        self._send = send
        self._ground = ground
        self._storage = storage
        self._stored_logs = stored_logs
        self._clock: Clock = MonotonicClock()
        self._log = None if make_log is None else make_log(lambda: self._clock.now_ns())

    @property
    def channel(self) -> MavlinkChannel:
        """Channel that serves the host, with the autopilot of the run."""
        return self._channel

    # -- start and end of a run

    def reset(self, clock: Clock, lockstep: bool) -> None:
        self._clock = clock
        self._lockstep = lockstep
        self._channel = self._make_channel()
        self._hub = self._channel.hub
        if self._stored_logs is not None:
            self._hub.logs = self._stored_logs
        self._hub.unix_s = None if lockstep else time.time
        self._autopilot = self._channel.autopilot
        self._control_and_allocate = self._autopilot.control
        self._log_outbox: Outbox | None = None
        self._imu_stamp_us = self._imu_received_us = 0
        self._actuators = Actuators()
        self._count = 0
        self._controlled_ns = 0
        self._missed_before = self._stations_missed()
        if self._storage is not None:
            self._hub.storage = self._storage
            self._storage.apply(self._autopilot)
        if self._log is not None:
            self._hub.log = self._log
            self._log_outbox = self._hub.open_outbox()
        if self._ground is not None:
            self._ground.attach(self._hub)

    def start_run(self, executor: Executor, silent_s: Callable[[], float]) -> None:
        if self._log is not None:
            self._log.start(self._clock.now_ns(), self._lockstep)
        executor.add("control", LOOP_HZ, self._control, urgent=True)
        if self._log is not None:
            executor.add("log", LOOP_HZ, self._write_log)

    def end_run(self, now_ns: int) -> Sequence[Message]:
        """End the run: disarm, because the host no longer simulates."""
        self._autopilot.disarm()
        self._actuators = self._hub.actuators = Actuators()
        if self._log is not None:
            self._log.log_disarmed(now_ns)
            self._log_events(self._log, now_ns)
            self._log.close()
        return (self._actuators_message(now_ns),)

    # -- the host's messages

    def handle(self, message: Message, now_ns: int) -> Sequence[Message]:
        if isinstance(message, dialect.MAVLink_xitl_imu_message):
            self._imu_stamp_us, self._imu_received_us = message.time_usec, now_ns // 1000
        return self._channel.handle(message, now_ns)

    def end_tick(self, tick: int, now_ns: int) -> Sequence[Message]:
        self._count = tick
        return (self._actuators_message(now_ns),)

    # -- tasks

    def _control(self, now_ns: int) -> None:
        self._actuators = self._hub.actuators = self._control_and_allocate(now_ns)
        if not self._lockstep:
            self._count += 1
            self._send(self._actuators_message(self._clock.now_ns()))
        self._controlled_ns = now_ns

    def _write_log(self, now_ns: int) -> None:
        assert self._log is not None
        self._log.log_cycle(self._controlled_ns, self._autopilot, self._actuators)
        self._log_events(self._log, now_ns)

    def telemetry(self, now_ns: int) -> Sequence[Message]:
        return self._channel.poll(now_ns)

    def _serve_ground(self, now_ns: int) -> None:
        if self._storage is not None:
            self._storage.report(self._autopilot)
        if self._ground is not None:
            self._ground.telemetry(now_ns)

    def _actuators_message(self, now_ns: int) -> Message:
        command, armed, failsafe = self._actuators
        stamp_us, received_us = self._imu_stamp_us, self._imu_received_us
        return actuators_message(command, armed, stamp_us, received_us, now_ns, self._count, failsafe)

    # -- records

    def add_event(self, severity: int, text: str) -> None:
        self._autopilot.events.add(severity, text)

    def _log_events(self, log: FlightLog, now_ns: int) -> None:
        outbox = self._log_outbox
        if outbox is not None:
            self._hub.distribute(now_ns)
            while outbox.events:
                event = outbox.events.popleft()
                log.log_event(now_ns, event.severity, event.text)

    def log_task_stats(self, now_ns: int, stats: Sequence[TaskStats]) -> None:
        self._hub.task_stats = stats
        if self._log is not None:
            self._log.log_task_stats(now_ns, stats)

    def log_missed_deadlines(self, now_ns: int, misses: Sequence[TaskMiss]) -> None:
        if self._log is not None:
            self._log.log_missed_deadlines(now_ns, misses)

    @property
    def traffic(self) -> Traffic:
        autopilot = self._autopilot
        return Traffic(
            autopilot.estimates_used,
            autopilot.allocator.efforts,
            self._channel.refused,
            0 if self._log is None else self._log.dropped,
            self._stations_missed() - self._missed_before,
            autopilot.events.lost + self._hub.traffic.dropped,
            autopilot.controller.failures,
        )

    def _stations_missed(self) -> int:
        return 0 if self._ground is None else self._ground.counters.missed

    # -- ground stations

    def add_peer_tasks(self, executor: Executor) -> None:
        if self._ground is not None:
            executor.add("ground", LOOP_HZ, self._serve_ground)

    @property
    def addresses(self) -> tuple[str, ...]:
        return () if self._ground is None else self._ground.addresses

    def descriptors(self) -> Sequence[int]:
        return () if self._ground is None else self._ground.descriptors()

    def serve_peers(self, now: Callable[[], int]) -> None:
        if self._ground is not None:
            self._ground.receive(now)
            self._ground.keep_alive(now())
        if self._hub.reboot_asked:
            self._hub.reboot()
