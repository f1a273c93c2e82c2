"""Handles the messages of one agent: dispatches, times, counts and records them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from agent.wire import dialect
from agent.wire.actuators import commands_of
from sim_core.geodesy import LocalFrame
from xitl_cli.errors import UserError
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import ClockExchange, MotionEstimate, MotorCommand
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.pace import Pace
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.link_accounts import LinkAccounts, LinkTiming, LockstepTiming, node_state

_HEAD = 10  # bytes of a MAVLink 2 frame before its payload
_US, _MS = 1_000, 1_000_000

# Offset of the time stamp in the payload, its size in bytes, and its unit in nanoseconds.
_STAMPS: dict[int, tuple[int, int, int]] = {
    dialect.MAVLINK_MSG_ID_XITL_ACTUATORS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_TASK_STATS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_NODE_STATUS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_NODE_INFO: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_BRIDGE_STATUS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_XITL_TIMESYNC: (16, 8, 1),
    dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: (0, 8, _US),
    dialect.MAVLINK_MSG_ID_ATTITUDE: (0, 4, _MS),
    dialect.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: (0, 4, _MS),
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: (0, 4, _MS),
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: (0, 4, _MS),
}


def sent_ns(frame: bytes) -> int | None:
    """Return the agent's clock at which it sent the frame, or None for a message without such a stamp."""
    stamp = _STAMPS.get(frame[7] | frame[8] << 8 | frame[9] << 16)
    if stamp is None:
        return None
    start, size, unit_ns = stamp
    end = min(start + size, frame[1])  # trailing zeros of a payload are not sent
    return int.from_bytes(frame[_HEAD + start : _HEAD + max(end, start)], "little") * unit_ns


OWN_IDS = dialect.MAVLINK_MSG_ID_XITL_RUN  # from here on: messages between host and agent, on the agent's clock

_NODES = {"agent": "LC", "companion": "HC"}
_SPEAKERS = {"agent": "autopilot", "companion": "companion"}

OnEstimate = Callable[[int | None, MotionEstimate], None]


class MessageRoute:
    """Passes each message to all subscribers, in the order of their subscription."""

    def __init__(self) -> None:
        self._handlers: list[Callable[[Any], object]] = []

    def subscribe(self, handler: Callable[[Any], object]) -> None:
        """Add a handler."""
        self._handlers.append(handler)

    def publish(self, message: Any) -> None:
        """Pass a message to all handlers."""
        for handler in self._handlers:
            handler(message)


class AgentInbox:
    """The messages of the agent on link `name`. `on_estimate` gets its estimates and the simulation time of each.

    `on_message` gets every message except those of the host-agent protocol. command: the latest motor commands. They
    answer `answered_tick` and arrived at command_ns on the host's monotonic clock. fresh: whether commands arrived
    since it was set to False. clock_stepped: likewise for a step of the agent's clock. undriven: number of the last
    commands, out of `motors`, that the agent does not give and that stay 0. no_run: the latest status without a run; a
    delayed status of the run may follow it.
    """

    def __init__(
        self,
        name: str,
        frame: LocalFrame,
        motors: int,
        lockstep: bool,
        on_estimate: OnEstimate,
        on_message: Callable[[Any], object] = lambda message: None,
        undriven: int = 0,
    ) -> None:
        node = _NODES.get(name, name)
        self._vehicle_sim_ns: Callable[[int], int | None] = self.sim_ns
        self._on_estimate = on_estimate
        self._on_message = on_message
        self.view = AgentView(frame, self._on_text, self._on_vehicle_estimate, node, self.sim_ns)
        self.timing = LockstepTiming(node) if lockstep else LinkTiming(node)
        self.accounts = LinkAccounts()
        self.traffic: dict[str, dict[int, int]] = {"tx": {}, "rx": {}}
        self.command = MotorCommand((0.0,) * motors)
        self._undriven = (0.0,) * undriven
        self.command_ns = 0
        self.answered_tick = -1
        self.fresh = False
        self.clock_stepped = False
        self.no_run: Any = None
        self._name = name
        self._speaker = _SPEAKERS.get(name, f"{name} autopilot")
        self._lockstep = lockstep
        self._command_stamp_ns: int | None = None
        self._clock: ClockExchange | None = None
        self._recorder: Recorder | None = None
        self._pace: Pace | None = None
        self._now_ns: Callable[[], int] = lambda: 0
        self._handlers: dict[int, Callable[[Any], None]] = {
            dialect.MAVLINK_MSG_ID_XITL_ACTUATORS: self._on_actuators,
            dialect.MAVLINK_MSG_ID_XITL_TIMESYNC: self._on_timesync,
            dialect.MAVLINK_MSG_ID_XITL_TASK_STATS: self._on_task_stats,
            dialect.MAVLINK_MSG_ID_XITL_TASK_MISS: self._on_task_miss,
            dialect.MAVLINK_MSG_ID_XITL_NODE_STATUS: self._on_node_status,
        }

    def begin(self, context: RunContext) -> None:
        """Record messages from now on."""
        self._recorder, self._pace, self._now_ns = context.recorder, context.pace, context.clock.now_ns

    def use_vehicle_clock(self, sim_ns: Callable[[int], int | None]) -> None:
        """Set the clock of the standard messages, which another autopilot sends.

        `sim_ns`: simulation time of its instants.
        """
        self._vehicle_sim_ns = sim_ns

    def handle(self, messages: list[Any]) -> None:
        """Handle messages in the order in which they arrived."""
        handlers, accounts = self._handlers, self.accounts
        for message in messages:
            handler = handlers.get(message.get_msgId())
            if handler is None:
                self.view.handle(message)
                self._on_message(message)
            else:
                handler(message)
            accounts.heard += 1

    def tap(self, direction: str, frame: bytes) -> None:
        """Record a raw frame on the link, see Link."""
        recorder = self._recorder
        assert recorder is not None
        counts, number = self.traffic[direction], frame[7] | frame[8] << 8 | frame[9] << 16
        counts[number] = counts.get(number, 0) + 1
        if direction == "tx":
            recorder.frame_sent(self._now_ns(), frame, self._name)
            return
        now_ns, left_ns = self._now_ns(), None
        if not self._lockstep:
            stamp_ns = sent_ns(frame)
            if stamp_ns is not None:
                left_ns = self._sim_of(stamp_ns) if number >= OWN_IDS else self._vehicle_sim_ns(stamp_ns // 1000)
        recorder.frame_received(now_ns, frame, left_ns, self._name)

    def sim_ns(self, agent_us: int) -> int | None:
        """Return the simulation time of an instant on the agent's clock, None while the clocks' relation is unknown."""
        return self._sim_of(agent_us * 1000)

    def _sim_of(self, agent_ns: int) -> int | None:
        if self._lockstep:
            return agent_ns
        host_ns = self.timing.host_ns(agent_ns)
        if host_ns is None or self._pace is None:
            return None
        return min(self._pace.sim_of_host(host_ns), self._now_ns())

    def age_ns(self) -> int | None:
        """Return the wall-clock age of the motor commands, or None while it is unknown."""
        if self._command_stamp_ns is None:
            return None
        sent_at_ns = self.timing.host_ns(self._command_stamp_ns)
        return None if sent_at_ns is None else max(time.monotonic_ns() - sent_at_ns, 0)

    def say(self, severity: int, source: str, text: str) -> None:
        """Write a sentence to the log."""
        if self._recorder is not None:
            self._recorder.log(self._now_ns(), severity, source, text)

    # One message each

    def _on_actuators(self, message: Any) -> None:
        flags, motors, taken = message.flags, commands_of(message) + self._undriven, len(self.command.motors)
        armed = bool(flags & dialect.XITL_ACTUATOR_FLAGS_ARMED)
        if len(motors) != taken:
            if armed:
                raise UserError(
                    f"{self._speaker}: it drives {len(motors)} outputs, and the vessel takes {taken} commands; "
                    "give it the parameters of this vessel (SERVOn_FUNCTION), or a bridge its outputs"
                )
            motors = (0.0,) * taken
        self.command = MotorCommand(
            motors=motors,
            armed=armed,
            failsafe=bool(flags & dialect.XITL_ACTUATOR_FLAGS_FAILSAFE),
        )
        self.command_ns = time.monotonic_ns()
        self._command_stamp_ns = message.time_usec * 1000
        self.fresh = True
        self.answered_tick = message.tick
        self.timing.arrived(message)

    def _on_timesync(self, message: Any) -> None:
        clock = self.timing.answered(message)
        if clock is None:
            return
        if self._recorder is not None:
            self._recorder.write(self._now_ns(), clock)
        before, self._clock = self._clock, clock
        if before is not None and clock.steps > before.steps:
            self.clock_stepped = True
            step_s = clock.offset_s - before.offset_s
            self.say(dialect.MAV_SEVERITY_WARNING, "run", f"the clock of {clock.node} stepped by {step_s:+.3f} s")

    def _on_task_stats(self, message: Any) -> None:
        task = self.view.task(message)
        if self._recorder is not None:
            self._recorder.write(self._now_ns(), task)

    def _on_task_miss(self, message: Any) -> None:
        miss = self.view.miss(message)
        if miss is not None and self._recorder is not None:
            self._recorder.write(self._now_ns(), miss)

    def _on_node_status(self, message: Any) -> None:
        self.view.handle(message)
        self.accounts.status(message)
        if not message.running:
            self.no_run = message
        if self._recorder is not None and self.view.info is not None:
            self._recorder.write(self._now_ns(), node_state(self._name, self.view.info, message))

    def _on_vehicle_estimate(self, agent_us: int, estimate: MotionEstimate) -> None:
        if self._recorder is not None:  # an agent may still have the run of a host that was killed
            self._on_estimate(self._vehicle_sim_ns(agent_us), estimate)

    def _on_text(self, severity: int, text: str) -> None:
        self.say(severity, self._speaker, text)
