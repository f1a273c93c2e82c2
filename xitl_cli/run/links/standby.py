"""Redundancy of two agents: the standby follows the active agent's state and takes over when that agent is silent."""

from __future__ import annotations

import time
from collections.abc import Sequence
from math import copysign

from agent.mavlink.modes import ROVER_MODE_NUMBERS
from sim_core.dataclass import dataclass
from xitl_cli.profile.schema.agents import StandbySpec
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import TakeoverReport
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.links.connection import WARNING, AgentConnection


@dataclass(frozen=True, slots=True)
class AgentSwitch:
    """A switch of the active agent."""

    active: int
    """Number of the agent that steers from now on."""
    silent_ns: int
    """Silence of the former agent."""


class TakeoverDecision:
    """Decides which agent steers; agent 0 does at the start.

    Motor commands are an agent's signs of life. When the active agent has been silent for `takeover_s` and another has
    not, the other takes over. It stays active until it is silent itself, even if the first agent returns. All instants
    are of one clock.
    """

    def __init__(self, takeover_s: float, agents: int = 2, now_ns: int = 0) -> None:
        self.active = 0
        self._limit_ns = round(takeover_s * 1e9)
        self._heard_ns = [now_ns] * agents

    def heard(self, agent: int, now_ns: int) -> None:
        """Note a motor command of an agent."""
        self._heard_ns[agent] = now_ns

    def decide(self, now_ns: int) -> AgentSwitch | None:
        """Return the switch that is due now, or None; `active` has then changed."""
        silent_ns = now_ns - self._heard_ns[self.active]
        if silent_ns < self._limit_ns:
            return None
        latest = max(range(len(self._heard_ns)), key=self._heard_ns.__getitem__)
        if latest == self.active or now_ns - self._heard_ns[latest] >= self._limit_ns:
            return None
        self.active = latest
        return AgentSwitch(latest, silent_ns)


class MotorRamp:
    """Ramp of the motor commands from one agent's to another's, by at most `max_step` for each motor and exchange.

    It starts with `start` and ends at the first exchange at which all motors have their commands. At other times
    commands pass unchanged. `largest`: the largest step since the start. The first exchange determines it, because a
    motor that has further to go makes a full step.
    """

    def __init__(self, max_step: float) -> None:
        self.largest = 0.0
        self._max_step = max_step
        self._last: tuple[float, ...] = ()
        self._under_way = False

    def start(self) -> None:
        """Start the ramp: another agent steers from the next exchange on."""
        self._under_way = True
        self.largest = 0.0

    @property
    def under_way(self) -> bool:
        """Whether steps are limited now."""
        return self._under_way

    def next(self, wanted: Sequence[float]) -> tuple[float, ...]:
        """Return the commands of this exchange; call it once an exchange."""
        if self._under_way and self._last:
            limit = self._max_step
            pairs = list(zip(self._last, wanted, strict=True))
            reached = tuple(to if abs(to - at) <= limit else at + copysign(limit, to - at) for at, to in pairs)
            self.largest = max(self.largest, *(min(abs(to - at), limit) for at, to in pairs))
            self._under_way = reached != tuple(wanted)
            self._last = reached
        else:
            self._under_way = False
            self._last = tuple(wanted)
        return self._last


SETTLED_NS = 1_500_000_000  # heartbeats arrive at 1 Hz: before, agents with the same orders may seem to differ
PATIENCE_NS = 3_000_000_000
SPEAKS_NS = 500_000_000


class StandbyFollower:
    """Brings a standby agent into the state of the active agent: armed or not, mode, waypoint."""

    def __init__(self, agent: AgentConnection) -> None:
        self._view = agent.inbox.view
        self._commands = AutopilotCommands(self._view, agent.send, *agent.target)
        self._wanted: tuple[bool, str] | None = None
        self._astray_ns: int | None = None

    def update(self, sim_ns: int, active: AgentView, speaks: bool = True) -> None:
        """Send the orders that are due. An active agent that no longer `speaks` is not followed."""
        if not speaks:
            self._astray_ns = None
            return
        wanted, view, commands = (active.armed, active.mode), self._view, self._commands
        if wanted != self._wanted:
            self._wanted = wanted
            commands.forget()
        if (view.armed, view.mode) == wanted and view.target_seq == active.target_seq:
            self._astray_ns = None
            return
        if self._astray_ns is None:
            self._astray_ns = sim_ns
        if sim_ns - self._astray_ns < SETTLED_NS:
            return
        patient = sim_ns - self._astray_ns < PATIENCE_NS
        if view.mode != active.mode and active.mode in ROVER_MODE_NUMBERS:
            commands.set_mode(sim_ns, active.mode)
        elif view.armed != active.armed:
            if view.ready_to_arm or not active.armed:
                commands.arm(sim_ns, active.armed)
        elif not patient and active.target_seq is not None:
            commands.set_waypoint(active.target_seq)
        if not patient:
            self._astray_ns = None
            commands.forget()


class Redundancy:
    """Decides at every exchange which agent steers, and with which motor commands.

    `view`: view of the driver. It has the state of the active agent, and the waypoints that any agent has reached.
    """

    def __init__(self, agents: Sequence[AgentConnection], view: AgentView, standby: StandbySpec) -> None:
        self.takeovers: list[TakeoverReport] = []
        self._agents = agents
        self._view = view
        self._decision = TakeoverDecision(standby.takeover_s, len(agents), time.monotonic_ns())
        self._ramp = MotorRamp(standby.max_step)
        self._followers = [StandbyFollower(agent) for agent in agents]

    @property
    def active(self) -> AgentConnection:
        """The agent that steers."""
        return self._agents[self._decision.active]

    def update(self, sim_ns: int, recorder: Recorder) -> tuple[float, ...]:
        """Switch if it is due, and keep the standby agent in line.

        Returns the motors. Call it after all messages are handled.
        """
        before = self.active
        for number, agent in enumerate(self._agents):
            if agent.gone is None and agent.inbox.command_ns:
                self._decision.heard(number, agent.inbox.command_ns)
        switch = self._decision.decide(time.monotonic_ns())
        if switch is not None:
            self._view.adopt(self.active.inbox.view)
            self._ramp.start()
        motors = self._ramp.next(self.active.inbox.command.motors)
        if switch is not None:
            silent_s, name = switch.silent_ns * 1e-9, self.active.name
            takeover = TakeoverReport(before.name, name, silent_s, self._ramp.largest, sim_ns * 1e-9)
            recorder.write(sim_ns, takeover)
            text = f"{name} takes over from {before.name}, silent for {silent_s:.2f} s"
            recorder.log(sim_ns, WARNING, "run", text)
            self.takeovers.append(takeover)
        speaks = time.monotonic_ns() - self.active.inbox.command_ns < SPEAKS_NS
        for number, agent in enumerate(self._agents):
            if agent is not self.active and agent.gone is None:
                self._followers[number].update(sim_ns, self._view, speaks)
        return motors
