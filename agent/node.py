"""The agent between runs and in them: messages in, the autopilot and its tasks, messages out."""

from __future__ import annotations

import os
import platform
import select
from dataclasses import dataclass
from typing import Callable

import agent
from agent.fcu.autopilot import LOOP_HZ
from agent.fcu.log.hooks import NullFlightLog
from agent.fcu.mavlink.services import Services
from agent.fcu.mavlink.vehicle import Mailbox
from agent.fcu.samples import Actuators
from agent.ground.stations import GroundStations
from agent.storage import Storage
from agent.timing.clock import MonotonicClock, TickClock
from agent.timing.tasks import Executor, TaskStats
from agent.wire import dialect
from agent.wire.codec import Message
from agent.wire.link import Link

PROTOCOL = 2
NODES = "LS,LC,LA"
STATUS_RATE_HZ = 1.0
IDLE_WAIT_S = 0.5
MOTORS_ON_WIRE = 8


@dataclass(frozen=True)
class _LatestImu:
    stamp_us: int = 0
    received_us: int = 0


class AgentNode:
    """Serves one host over one link.

    In real time the tasks run on this machine's monotonic clock. In lockstep they run on XITL_TICK alone, and each tick
    is answered by XITL_ACTUATORS, so that a run repeats bit for bit. `make_services` builds a fresh autopilot for every
    run.

    `ground` serves ground stations beside the host, between runs too: there is no motion then, but parameters and plans
    can be set. `storage` keeps over a restart what they set. `make_log` gets this node's clock and gives a flight log,
    a new one begun with each run. None of the three is this node's to close.
    """

    def __init__(
        self,
        link: Link,
        make_services: Callable[[], Services],
        machine: str = "",
        ground: GroundStations | None = None,
        storage: Storage | None = None,
        make_log: Callable[[Callable[[], int]], NullFlightLog] | None = None,
    ) -> None:
        self._link = link
        self._make_services = make_services
        self._ground = ground
        self._storage = storage
        self._log = None if make_log is None else make_log(lambda: self._clock.now_ns())
        self._machine = machine or machine_name()
        self._monotonic = MonotonicClock()
        self._handlers: dict[int, Callable[[Message], None]] = {
            dialect.MAVLINK_MSG_ID_XITL_RUN: self._on_run,
            dialect.MAVLINK_MSG_ID_XITL_TICK: self._on_tick,
            dialect.MAVLINK_MSG_ID_XITL_TIMESYNC: self._on_timesync,
            dialect.MAVLINK_MSG_ID_XITL_IMU: self._on_imu,
        }
        self._running = False
        self._reset(lockstep=False, start_ns=0)

    def serve(self, keep_on: Callable[[], bool]) -> None:
        """Poll until `keep_on` says no; asked at least every `IDLE_WAIT_S`."""
        while keep_on():
            executor = self._due_now()
            due_ns = None if executor is None else executor.next_due_ns
            wait_s = IDLE_WAIT_S
            if due_ns is not None:
                wait_s = min(max(due_ns - self._monotonic.now_ns(), 0) * 1e-9, IDLE_WAIT_S)
            self.poll(wait_s)

    def poll(self, timeout_s: float = 0.0) -> None:
        """Handle what has arrived, waiting at most `timeout_s` for it, then run the tasks that are due."""
        if self._ground is not None:
            timeout_s = self._wait(self._ground, timeout_s)
        for message in self._link.receive(timeout_s):
            handler = self._handlers.get(message.get_msgId(), self._on_service)
            handler(message)
        executor = self._due_now()
        if executor is not None:
            executor.run_due(self._now_ns())
        if self._ground is not None:
            self._ground.receive(self._now_ns)
            self._ground.keep_alive(self._now_ns())
        if self._services.vehicle.reboot_asked:
            self._services.vehicle.reboot()

    def _wait(self, ground: GroundStations, timeout_s: float) -> float:
        """Wait for the host and the ground stations at once; returns what is left to wait for the host alone."""
        host = self._link.transport.fileno()
        if host is None or timeout_s <= 0.0:
            return timeout_s
        select.select([host, *ground.descriptors()], (), (), timeout_s)
        return 0.0

    def _now_ns(self) -> int:
        """The vehicle's clock, which between runs is this machine's."""
        return self._clock.now_ns() if self._running else self._monotonic.now_ns()

    def _due_now(self) -> Executor | None:
        """Whose tasks this machine's clock makes due: in lockstep nobody's."""
        if not self._running:
            return self._idle
        return None if self._lockstep else self._executor

    def _reset(self, lockstep: bool, start_ns: int) -> None:
        self._lockstep = lockstep
        self._ticks = TickClock(start_ns)
        self._clock: MonotonicClock | TickClock = self._ticks if lockstep else self._monotonic
        self._services = self._make_services()
        self._log_mailbox: Mailbox | None = None
        self._imu = _LatestImu()
        self._actuators = Actuators()
        self._count = 0
        self._last_tick: int | None = None
        self._executor = Executor(self._clock)
        self._executor.add("control", LOOP_HZ, self._control)
        self._executor.add("telemetry", LOOP_HZ, self._telemetry)
        self._executor.add("status", STATUS_RATE_HZ, self._status)
        self._idle: Executor | None = None
        vehicle = self._services.vehicle
        if self._storage is not None:
            vehicle.keeper = self._storage
            self._storage.apply(vehicle.autopilot)
        if self._log is not None:
            vehicle.log = self._log
            self._log_mailbox = vehicle.mailbox()
        if self._ground is not None:
            self._ground.attach(vehicle)
            self._executor.add("ground", LOOP_HZ, self._serve_ground)
            self._be_idle(self._ground)

    def _be_idle(self, ground: GroundStations) -> None:
        """Between runs ground stations are all there is to serve."""
        self._idle = Executor(self._monotonic)
        self._idle.add("ground", LOOP_HZ, self._serve_ground)

    # Messages

    def _on_service(self, message: Message) -> None:
        replies = self._services.handle(message, self._clock.now_ns())
        if replies:
            self._link.send(*replies)

    def _on_imu(self, message: Message) -> None:
        self._imu = _LatestImu(message.time_usec, self._clock.now_ns() // 1000)
        self._on_service(message)

    def _on_timesync(self, message: Message) -> None:
        received_ns = self._clock.now_ns()
        answer = dialect.MAVLink_xitl_timesync_message(message.t1_ns, received_ns, 0, message.sequence)
        answer.t3_ns = self._clock.now_ns()
        self._link.send(answer)

    def _on_run(self, message: Message) -> None:
        if message.command == dialect.XITL_RUN_COMMAND_START:
            self._link.reset_counters()
            if self._running and self._log is not None:  # the host that started the last run is gone
                self._log.close()
            self._reset(message.clock_mode == dialect.XITL_CLOCK_MODE_LOCKSTEP, message.time_usec * 1000)
            self._running = True
            if self._log is not None:
                self._log.begin(self._clock.now_ns(), self._lockstep)
            if self._lockstep:
                self._executor.run_due(self._clock.now_ns())
        elif message.command == dialect.XITL_RUN_COMMAND_STOP and self._running:
            self._running = False
            self._actuators = Actuators()
            self._send_actuators(self._clock.now_ns())
            self._send_task_stats(self._clock.now_ns())
            self._end_run()
        self._send_node_info(self._clock.now_ns())
        self._send_node_status(self._clock.now_ns())

    def _end_run(self) -> None:
        """The host takes the world away: nothing is steered any more."""
        autopilot = self._services.autopilot
        autopilot.disarm()
        self._services.vehicle.actuators = Actuators()
        if self._log is not None:
            self._log.arm(self._clock.now_ns(), False)
            self._log_events(self._log, self._clock.now_ns())
            self._log.close()
        if self._ground is not None:
            self._be_idle(self._ground)

    def _on_tick(self, message: Message) -> None:
        if not (self._running and self._lockstep):
            return
        if message.tick != self._last_tick:
            self._last_tick = message.tick
            self._ticks.advance_to(message.time_usec * 1000)
            self._executor.run_due(self._clock.now_ns())
        self._count = message.tick
        self._send_actuators(self._clock.now_ns())

    # Tasks

    def _control(self, now_ns: int) -> None:
        autopilot = self._services.autopilot
        self._actuators = self._services.vehicle.actuators = autopilot.control(now_ns)
        if self._log is not None:
            self._log.cycle(now_ns, autopilot, self._actuators)
            self._log_events(self._log, now_ns)
        if not self._lockstep:
            self._count += 1
            self._send_actuators(self._clock.now_ns())

    def _telemetry(self, now_ns: int) -> None:
        messages = self._services.telemetry(now_ns)
        if messages:
            self._link.send(*messages)

    def _serve_ground(self, now_ns: int) -> None:
        if self._storage is not None:
            self._storage.report(self._services.autopilot)
        if self._ground is not None:
            self._ground.telemetry(now_ns)

    def _log_events(self, log: NullFlightLog, now_ns: int) -> None:
        mailbox = self._log_mailbox
        if mailbox is not None:
            self._services.vehicle.collect(now_ns)
            while mailbox.events:
                event = mailbox.events.popleft()
                log.event(now_ns, event.severity, event.text)

    def _status(self, now_ns: int) -> None:
        if self._log is not None:
            self._log.performance(now_ns, self._executor.stats)
        self._send_task_stats(now_ns)
        self._send_node_status(now_ns)

    # Messages out

    def _send_actuators(self, now_ns: int) -> None:
        actuators = self._actuators
        flags = dialect.XITL_ACTUATOR_FLAGS_ARMED if actuators.armed else 0
        flags |= dialect.XITL_ACTUATOR_FLAGS_FAILSAFE if actuators.failsafe else 0
        count = len(actuators.command)
        command = list(actuators.command) + [0.0] * (MOTORS_ON_WIRE - count)
        self._link.send(
            dialect.MAVLink_xitl_actuators_message(
                now_ns // 1000, self._imu.stamp_us, self._imu.received_us, self._count, command, count, flags
            )
        )

    def _send_task_stats(self, now_ns: int) -> None:
        self._link.send(*[_task_message(now_ns, stats) for stats in self._executor.stats])

    def _send_node_info(self, now_ns: int) -> None:
        self._link.send(
            dialect.MAVLink_xitl_node_info_message(
                now_ns // 1000,
                0,
                os.cpu_count() or 0,
                0,
                dialect.XITL_NODE_KIND_VIRTUAL,
                0,
                PROTOCOL,
                NODES.encode(),
                agent.__version__.encode()[:16],
                platform.python_version().encode()[:16],
                self._machine.encode()[:48],
                machine_name().encode()[:64],
            )
        )

    def _send_node_status(self, now_ns: int) -> None:
        counters = self._link.counters
        self._link.send(
            dialect.MAVLink_xitl_node_status_message(
                now_ns // 1000,
                counters.sent,
                counters.unsent,
                counters.received,
                counters.lost,
                counters.late,
                counters.repeated,
                counters.dropped,
                self._link.refused_signature,
                0,
                self._services.refused,
                0,
                0,
                0,
                0,
                0 if self._lockstep else resident_kib(),
                0.0,
                -1.0,
                32767,
                int(self._running),
                PROTOCOL,
            )
        )


def _task_message(now_ns: int, stats: TaskStats) -> Message:
    message: Message = dialect.MAVLink_xitl_task_stats_message(
        now_ns // 1000,
        stats.worst_ns // 1000,
        0,
        stats.rate_hz,
        stats.cycles,
        stats.missed,
        stats.skipped,
        min(stats.start_jitter_max_ns // 1000, 0xFFFFFFFF),
        stats.start_jitter_mean_ns * 1e-3,
        min(stats.run_max_ns // 1000, 0xFFFFFFFF),
        stats.run_mean_ns * 1e-3,
        [0] * 16,
        [0] * 16,
        stats.name.encode()[:16],
    )
    return message


def machine_name() -> str:
    """Processor and kernel, for instance `armv7l Linux 5.10.168-ti-rt`."""
    return f"{platform.machine()} {platform.system()} {platform.release()}"


def resident_kib() -> int:
    """Resident memory of this process, 0 where the system does not tell."""
    try:
        with open("/proc/self/statm") as statm:  # noqa: PTH123  pathlib costs a slow board more than it gives here
            return int(statm.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024
    except (OSError, ValueError, IndexError):
        return 0
