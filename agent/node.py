"""Agent between and during runs: handles the host's messages, runs the tasks of its role and sends reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Callable

from agent.faults import AgentFaults
from agent.machine import HealthMonitor, read_machine
from agent.reports import PROTOCOL, UNKNOWN, Identity, node_info, node_status, task_miss, task_stats
from agent.roles.role import Role
from agent.timing.clock import Clock, MonotonicClock, SteppedClock, TickClock, wait_readable
from agent.timing.deadline import DeadlineWait
from agent.timing.tasks import Executor
from agent.wire import dialect
from agent.wire.codec import Message, Prepared, prepare
from agent.wire.link import Link

__all__ = ["PROTOCOL", "AgentNode"]

STATUS_RATE_HZ = 1.0
IDLE_WAIT_S = 0.5
IDLE_WAIT_NS = round(IDLE_WAIT_S * 1e9)
SILENCE_S = 60.0
MISSES_A_CYCLE = 10
STRANGERS_EVERY_NS = 10_000_000_000
LATEST_NS = 1 << 62  # limit of a host's time: 146 years, half of the range of the wire's signed fields
_WARNING = dialect.MAV_SEVERITY_WARNING


class AgentNode:
    """Serves one host over one link, in a role.

    In real time, the tasks run on this machine's monotonic clock. In lockstep, they run on XITL_TICK alone, and each
    tick ends with the role's answer, so that a run repeats bit for bit. Values that vary with the machine are then
    reported as unknown. Only the urgent tasks run before the answer. The others run while the host continues, and their
    messages are sent before the next answer.

    A role may leave a tick open because the autopilot behind it has not followed yet. Each `poll` then asks the role
    again, because the host sends a tick only once over a lossless link.

    executor: runs the tasks of the run.
    faults: faults of `link`'s transport.
    silence_s: a host that is silent for this time in real time is gone, and its run ends; 0 waits forever.
    clock: clock of this machine.
    say: reports to the user of this machine.

    A run belongs to its host: the link refuses others, and the role reports them.
    """

    def __init__(
        self,
        link: Link,
        role: Role,
        identity: Identity | None = None,
        faults: AgentFaults | None = None,
        silence_s: float = SILENCE_S,
        clock: Clock | None = None,
        say: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._link = link
        self.role = role
        self.identity = Identity(role.nodes, read_machine()) if identity is None else identity
        self._monotonic: Clock = MonotonicClock() if clock is None else clock
        self._faults = AgentFaults(self._monotonic) if faults is None else faults
        self._health = HealthMonitor()
        self._silence_ns = round(silence_s * 1e9)
        self._handlers: dict[type, Callable[[Message], None]] = {
            dialect.MAVLink_xitl_run_message: self._on_run,
            dialect.MAVLink_xitl_tick_message: self._on_tick,
            dialect.MAVLink_xitl_timesync_message: self._on_timesync,
            dialect.MAVLink_xitl_faults_message: self._on_faults,
        }
        self._say = say
        self._running = False
        self._token = 0
        self._strangers = 0
        self._report_strangers_ns = 0
        self._heard_ns = 0
        self._ahead = 0  # received messages of the present batch that were not handled yet
        self._host_is_gone = False
        self._last_messages: Sequence[Message] = ()
        self._deferred: list[Prepared] = []
        self._reset(lockstep=False, start_ns=0)
        self._start_idle()

    def serve(self, keep_on: Callable[[], bool]) -> None:
        """Poll until `keep_on` returns False. It is called at least every `IDLE_WAIT_S`."""
        wait = DeadlineWait()
        with wait.deferred():
            while keep_on():
                executor = self._due_now()
                due_ns = None if executor is None else executor.next_due_ns
                wait.defer(due_ns is not None)
                if executor is None or due_ns is None:
                    self.poll(IDLE_WAIT_S)
                    continue
                left_ns = due_ns - executor.clock.now_ns()
                if left_ns <= 0:
                    wait.missed()
                    self.poll()
                elif wait.until(min(left_ns, IDLE_WAIT_NS), self.poll):
                    executor.run_due(executor.clock.now_ns())

    def poll(self, timeout_s: float = 0.0) -> None:
        """Handle the received messages, waiting at most `timeout_s` for them, then run the tasks that are due."""
        if self._tick_is_open:
            timeout_s = 0.0
        elif timeout_s > 0.0:
            timeout_s = self._wait(timeout_s)
        messages = self._link.receive(timeout_s)
        if messages:
            self._heard_ns = self._monotonic.now_ns()
            handlers, other = self._handlers, self._handle_other
            self._ahead = len(messages)
            for message in messages:
                self._ahead -= 1
                handlers.get(type(message), other)(message)
        elif self._tick_is_open:
            self._answer_tick()
        if self._link.strangers != self._strangers:
            self._report_strangers()
        executor = self._due_now()
        if executor is not None:
            executor.run_due(executor.clock.now_ns())
        if self._host_is_gone:
            self._end_run()
        self.role.serve_peers(self._now_ns)

    def _wait(self, timeout_s: float) -> float:
        """Wait for all peers that may send. Return the remaining time to wait for the host alone."""
        others = self.role.descriptors()
        if not others:
            return timeout_s
        host = self._link.transport.fileno()
        if host is None:
            return timeout_s
        wake_s = self._link.wake_s()
        wait_readable((host, *others), timeout_s if wake_s is None else min(timeout_s, wake_s))
        return 0.0

    def _now_ns(self) -> int:
        """The vehicle's clock, which is this machine's clock between runs."""
        return self._clock.now_ns() if self._running else self._monotonic.now_ns()

    def _due_now(self) -> Executor | None:
        """Executor of the tasks that this machine's clock triggers, None in lockstep."""
        if not self._running:
            return self._idle
        return None if self._lockstep else self.executor

    # -- start and end of a run

    def _reset(self, lockstep: bool, start_ns: int) -> None:
        self._lockstep = lockstep
        self._ticks = TickClock(start_ns)
        self._last_tick: int | None = None
        self._tick_is_open = False
        self._deferred.clear()
        disturbed = None if lockstep else SteppedClock(self._monotonic)
        self._clock: Clock = self._ticks if disturbed is None else disturbed
        self.executor = Executor(self._clock)
        self._faults.start_run(disturbed, self.executor)
        self.role.reset(self._clock, lockstep)

    def _start_idle(self) -> None:
        """Start the tasks between runs, in which the role may serve other peers than the host."""
        self._idle = Executor(self._monotonic)
        self.role.add_peer_tasks(self._idle)

    def _on_run(self, message: Message) -> None:
        self._faults.answering = True
        if message.command == dialect.XITL_RUN_COMMAND_START:
            lockstep = message.clock_mode == dialect.XITL_CLOCK_MODE_LOCKSTEP
            self._start_run(lockstep, min(message.time_usec * 1000, LATEST_NS), message.token)
        elif message.command == dialect.XITL_RUN_COMMAND_STOP:
            self._end_run()
        repeatable = message.clock_mode == dialect.XITL_CLOCK_MODE_LOCKSTEP
        now_ns = 0 if repeatable and not self._lockstep else self._clock.now_ns()
        self._link.send(node_info(now_ns, self.identity))
        self._link.send(self._status_message(now_ns, repeatable))
        self._faults.answering = False

    def _start_run(self, lockstep: bool, start_ns: int, token: int) -> None:
        if self._running:  # the host of the last run is gone
            self.role.end_run(self._clock.now_ns())
        self._link.reset_counters()
        self._reset(lockstep, start_ns)
        self._running, self._token = True, token or 1
        self._strangers = self._report_strangers_ns = 0
        self._host_is_gone = False
        executor = self.executor
        self.role.start_run(executor, self._silent_s)
        executor.add("telemetry", self.role.telemetry_hz, self._telemetry)
        executor.add("status", STATUS_RATE_HZ, self._status)
        self.role.add_peer_tasks(executor)
        if lockstep:
            executor.run_due(self._clock.now_ns())

    def _end_run(self) -> None:
        """End the run. The last messages are repeated when the host asks again, because it may have missed them."""
        self._host_is_gone = False
        was_running, self._running = self._running, False
        self._tick_is_open = False
        now_ns = self._clock.now_ns()
        self._link.send_prepared(self._deferred)
        self._deferred.clear()
        if was_running:
            self._faults.end()
            self._send_misses(now_ns)
            self._last_messages = self.role.end_run(now_ns)
            self._start_idle()
        if self.executor.next_due_ns is not None:
            self._link.send(*self._last_messages)
            self._send_task_stats(now_ns)

    # Messages

    def _handle_other(self, message: Message) -> None:
        replies = self.role.handle(message, self._clock.now_ns())
        if replies:
            self._link.send(*replies)

    def _on_tick(self, message: Message) -> None:
        if not (self._running and self._lockstep):
            return
        if message.tick != self._last_tick:
            self._last_tick = message.tick
            self._ticks.advance_to(min(message.time_usec * 1000, LATEST_NS))
            self.executor.run_urgent(self._clock.now_ns())
            self._answer_tick()
        elif self._tick_is_open:
            self._answer_tick()
        else:  # only the answer: waiting messages are sent with the next tick
            self._link.send(*self.role.end_tick(message.tick, self._clock.now_ns()))

    def _answer_tick(self) -> None:
        """Answer the last tick. If the role is not ready, the tick stays open and `poll` asks the role again."""
        assert self._last_tick is not None
        now_ns = self._clock.now_ns()
        answer = self.role.end_tick(self._last_tick, now_ns)
        self._link.send_prepared([*self._deferred, *map(prepare, answer)])
        self._deferred.clear()
        self._tick_is_open = not self.role.has_followed
        if not self._tick_is_open:
            self.executor.run_due(now_ns)

    def _send(self, *messages: Message) -> None:
        if self._lockstep and self._running:
            self._deferred += map(prepare, messages)  # prepare now, while the host works
        else:
            self._link.send(*messages)

    def _on_timesync(self, message: Message) -> None:
        received_ns = self._clock.now_ns()
        answer = dialect.MAVLink_xitl_timesync_message(message.t1_ns, received_ns, 0, message.sequence)
        answer.t3_ns = self._clock.now_ns()
        self._link.send(answer)
        self._link.heard_total(message.frames_sent, self._link.counters.received - self._ahead)

    def _on_faults(self, message: Message) -> None:
        if self._running:
            for sentence in self._faults.handle(message):
                self.role.add_event(_WARNING, sentence)

    def _report_strangers(self) -> None:
        """Report strangers at the first one of a run, and every `STRANGERS_EVERY_NS` while they continue."""
        now_ns = self._monotonic.now_ns()
        if not self._running or now_ns < self._report_strangers_ns:
            return
        count, self._strangers = self._link.strangers - self._strangers, self._link.strangers
        self._report_strangers_ns = now_ns + STRANGERS_EVERY_NS
        transport = self._link.transport
        self._say(
            f"refused {count} datagrams or calls, the last from {transport.stranger}: {transport.peer} has the run"
        )
        self.role.add_event(_WARNING, f"Refused {transport.stranger}: not this run's host")

    # Tasks

    def _telemetry(self, now_ns: int) -> None:
        self._send(*self.role.telemetry(now_ns))
        if self.executor.misses:
            self._send_misses(now_ns)

    def _status(self, now_ns: int) -> None:
        self._faults.lapse()
        self.role.log_task_stats(now_ns, self.executor.stats)
        self._send_task_stats(now_ns)
        self._send(self._status_message(now_ns, self._lockstep))
        if not self._lockstep and self._silence_ns:
            self._host_is_gone = self._silent_s() * 1e9 > self._silence_ns

    def _silent_s(self) -> float:
        return 0.0 if self._lockstep else (self._monotonic.now_ns() - self._heard_ns) * 1e-9

    # Reports

    def _send_misses(self, now_ns: int) -> None:
        misses = self.executor.misses.drain(MISSES_A_CYCLE)
        if misses and not self._lockstep:
            self.role.log_missed_deadlines(now_ns, misses)
            self._send(*map(task_miss, misses))

    def _send_task_stats(self, now_ns: int) -> None:
        self._send(*[task_stats(now_ns, stats) for stats in self.executor.stats])

    def _status_message(self, now_ns: int, repeatable: bool) -> Message:
        counters = self._link.counters
        return node_status(
            now_ns,
            replace(counters, received=counters.received - self._ahead),
            self._faults.impaired,
            self.role.traffic,
            0 if repeatable else self.executor.misses.unreported,
            UNKNOWN if repeatable else self._health.read(),
            self._token if self._running else 0,
        )
