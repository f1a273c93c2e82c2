"""The autopilot behind an agent: sends sensor samples over the link and receives motor commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agent.wire.link import Link
from agent.wire.signing import Signing
from sim_core.environment.wind import Air
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.record.topics import ActuatorAge, MotionEstimate
from xitl_cli.run.core import directory
from xitl_cli.run.core.node import ControlNode, ExchangePart, RunContext, RunStep
from xitl_cli.run.core.reports import ActuatorReport, Progress
from xitl_cli.run.core.scores import EstimateCheck
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.agent_workers import AgentWorkers
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.links.connection import (
    WARNING,
    AgentConnection,
    StoppedWaitingError,
    Supervision,
    connections_report,
)
from xitl_cli.run.links.inbox import AgentInbox, MessageRoute
from xitl_cli.run.links.peer import AgentOptions, open_peer
from xitl_cli.run.links.setup import Plans, embedded_parameters, mission_plans
from xitl_cli.run.nodes.drivers import VehicleDriver
from xitl_cli.run.sensors.sensing import make_sensing
from xitl_cli.run.traffic.self_report import SelfReport, report_from_estimate
from xitl_cli.run.world.plant import PlantView
from xitl_cli.run.world.world import local_frame
from xitl_cli.seeds import Seeds
from xitl_cli.signing import read_key_file

if TYPE_CHECKING:
    from sim_core.sensors.rangefinder import HullsAround, TideNow
    from xitl_cli.run.links.standby import Redundancy

SYNC_RATE_HZ = 10.0
STILL_AIR = np.zeros((1, 3))


def autopilot_links(profile: RunProfile) -> tuple[str, ...]:
    """Return the names of the links to the autopilot's agents."""
    return ("agent",) if profile.autopilot.standby is None else ("agent", "standby")


class AutopilotNode(ControlNode):
    """Sends samples to its agents and receives motor commands.

    In lockstep every exchange is a tick (`ticking`, the part of an exchange ahead of the other nodes) and its answer.
    In real time both sides run freely. A second agent, if the profile has one in standby, gets the same messages as the
    first.

    `make_driver`: creates the node that commands the autopilot over its first agent. `interrupted`: returns True when
    the user asked to stop; called during the wait for an answer. supervision: see there. workers: run the first agent
    if it would otherwise be in this process. air, tide_m, plant: as in make_sensing.

    heard: route to subscribe to the messages of the active agent. driver: runs before this node.
    """

    def __init__(
        self,
        profile: RunProfile,
        seeds: Seeds,
        make_driver: Callable[[AutopilotCommands, AgentConnection], VehicleDriver],
        options: AgentOptions | None = None,
        supervision: Supervision | None = None,
        interrupted: Callable[[], bool] = lambda: False,
        hulls: HullsAround | None = None,
        workers: AgentWorkers | None = None,
        air: Callable[[], Air] | None = None,
        tide_m: TideNow | None = None,
        plant: PlantView | None = None,
    ) -> None:
        self.heard = MessageRoute()
        self.ticking = ExchangePart(self._tick)
        self._profile = profile
        self._options = options or AgentOptions(profile.autopilot.system_id)
        self._workers = workers
        self._supervision = supervision or Supervision(lambda: profile.autopilot.silent_s)
        self._interrupted = interrupted
        self._lockstep = profile.clock.mode == "lockstep"
        self._frame = local_frame(profile.site)
        self._sensing = make_sensing(profile, seeds, hulls, air, tide_m, plant)
        self._recorded = profile.sensors is not None and profile.sensors.recorded is not None  # another vessel
        self.agents = [self._connection(name) for name in autopilot_links(profile)]
        first, standby = self.agents[0], profile.autopilot.standby
        self.view = first.inbox.view
        self._redundancy: Redundancy | None = None
        if standby is not None:
            self.view = AgentView(self._frame, lambda severity, text: None, lambda agent_us, estimate: None)
            from xitl_cli.run.links.standby import Redundancy

            self._redundancy = Redundancy(self.agents, self.view, standby)
        self.driver = make_driver(self.new_commands(), first)
        self.sense_every = self._sensing.every
        self._check = EstimateCheck(profile.clock.physics_rate_hz / self.sense_every)
        self._sync_every = max(round(profile.clock.exchange_rate_hz / SYNC_RATE_HZ), 1)
        self._time_is_due = False
        self._use = ActuatorUse()
        self._context: RunContext | None = None
        self._estimate: tuple[int, MotionEstimate] | None = None
        self._exchanges = 0
        self.command = first.inbox.command
        self.progress = self._progress()

    def _connection(self, name: str) -> AgentConnection:
        profile, key = self._profile, self._profile.autopilot.link_key_file
        vehicle = profile.vehicle
        added = vehicle.commands - vehicle.own_commands if profile.autopilot.kind == "embedded" else 0
        inbox = AgentInbox(
            name,
            self._frame,
            vehicle.commands,
            self._lockstep,
            partial(self._on_estimate, name),
            partial(self._on_message, name),
            added,
        )
        signing = None if key is None else Signing(read_key_file(key, "autopilot.link_key_file"))
        why_silent = self._supervision.why_silent if name == "agent" else None
        return AgentConnection(name, profile, inbox, signing, why_silent=why_silent)

    @property
    def active(self) -> AgentConnection:
        """The agent whose motor commands move the vessel."""
        return self.agents[0] if self._redundancy is None else self._redundancy.active

    def send(self, message: Any) -> None:
        """Send a message to every agent."""
        for agent in self._present():
            agent.send(message)

    def new_commands(self) -> AutopilotCommands:
        """Return a commander of the autopilot with its own record of requests."""
        return AutopilotCommands(self.view, self.send, *self.agents[0].target)

    def said(self) -> SelfReport | None:
        """Return the autopilot's newest report of the vessel's motion, as others may receive it."""
        return None if self._estimate is None else report_from_estimate(*self._estimate, self.view.armed)

    def _present(self) -> list[AgentConnection]:
        return [agent for agent in self.agents if agent.gone is None]

    def _on_message(self, name: str, message: Any) -> None:
        """Handle a message. Of two agents, only the active one counts."""
        if self._redundancy is not None:
            if name != self.active.name:
                return
            self.view.handle(message)
        self.heard.publish(message)

    def _on_estimate(self, name: str, stamp_ns: int | None, estimate: MotionEstimate) -> None:
        if name == self.active.name and self._context is not None:
            now_ns = self._context.clock.now_ns() if stamp_ns is None else stamp_ns
            self._estimate = now_ns, estimate
            self._context.recorder.estimate(now_ns, estimate)
            self._check.add_estimate(stamp_ns, estimate, self.view.armed)
            self.position_error_m = self._check.position_error_m

    # Before the run

    def prepare(self) -> None:
        autopilot, options = self._profile.autopilot, self._options
        for agent in self.agents:
            if agent.name == "agent":
                agent.reach(open_peer(autopilot.runs, autopilot.link, options, self._workers, self._profile.vessel))
            else:
                assert autopilot.standby is not None
                own = replace(options, ground_stations=(), log_dir=None)
                agent.reach(open_peer(autopilot.standby.runs, autopilot.standby.link, own))

    def begin(self, context: RunContext) -> None:
        self._context = context
        parameters: dict[str, float] = {}
        plans: Plans = {}
        if self._profile.autopilot.kind == "embedded":
            parameters = embedded_parameters(self._profile)
            plans = mission_plans(self._profile, self._frame)
        for agent in self.agents:
            agent.begin(context, parameters, plans)
        self.progress = self._progress()

    # In the run

    def sense(self, step: RunStep) -> None:
        if not self._recorded:
            self._check.add_truth(step.now_ns, step.motion)
        air_ned_mps = step.state.wind_ned_mps if self._sensing.feels_wind else STILL_AIR
        messages = self._sensing.due(step.number, step.now_ns, step.motion, air_ned_mps)
        if self._time_is_due:  # sent ahead of the samples; after them it would wait for a slow board
            self._time_is_due = False
            for agent in self._present():
                agent.request_time()
        if messages:
            for agent in self._present():
                agent.send_sensors(messages)

    def _tick(self, step: RunStep) -> None:
        self._exchanges += 1
        if self._lockstep:
            self.agents[0].send_tick(step.now_ns, self._exchanges)

    def exchange(self, step: RunStep) -> None:
        if self._lockstep:

            def check_waiting() -> None:
                if self._interrupted():
                    raise StoppedWaitingError
                self._supervision.check()

            agent = self.agents[0]
            agent.wait_for_answer(step.now_ns, self._exchanges, self._supervision.silent_s(), check_waiting)
            self.command = agent.inbox.command
        else:
            self._receive_all(step.now_ns)
        self.progress = self._progress()

    def _receive_all(self, now_ns: int) -> None:
        """Real time: handle all messages that have arrived since the last exchange."""
        assert self._context is not None
        self._time_is_due = self._exchanges % self._sync_every == 0
        for agent in self._present():
            agent.receive(0.0)
            agent.watch()
            if agent.gone is not None and self._redundancy is not None:
                agent.inbox.say(WARNING, "run", str(agent.gone))
        motors = None if self._redundancy is None else self._redundancy.update(now_ns, self._context.recorder)
        active = self.active
        if active.gone is not None and not self._present():
            raise active.gone
        inbox = active.inbox
        age_ns = inbox.age_ns()
        self._use.add(inbox.fresh, age_ns)
        self.command = replace(
            inbox.command,
            motors=inbox.command.motors if motors is None else motors,
            age_s=None if age_ns is None else age_ns * 1e-9,
        )
        for agent in self.agents:
            agent.inbox.fresh = False

    def _progress(self) -> Progress:
        view, texts = self.view, self.active.inbox.view.texts
        return replace(
            self.driver.progress(),
            mode=view.mode,
            armed=view.armed,
            messages=tuple(texts),
            guided_ne_m=view.guided_target_ne_m(),
            desired_heading_deg=view.desired_heading_deg,
        )

    def links(self) -> Sequence[Link]:
        return [agent.link for agent in self._present()]

    def receive(self, timeout_s: float) -> None:
        for agent in self._present():
            agent.receive(timeout_s)

    # After the run

    def end(self) -> None:
        for agent in self.agents:
            agent.stop()

    def close(self) -> None:
        for agent in self.agents:
            agent.close()

    def save(self, folder: Path) -> None:
        directory.keep_dataflash(folder)

    def sample_faults(self) -> dict[str, dict[str, int]]:
        """Return the number of samples that each injected fault has changed, by the fault's name."""
        return self._sensing.fault_counts()

    def set_sample_fault(self, name: str, fault: FaultSpec) -> None:
        """Set a fault of the sensors that is not in the profile, or that has other times there."""
        self._sensing.set_fault(name, fault)

    def actuator_age(self) -> ActuatorAge:
        """Return the age of the motor commands so far, for the recording."""
        return self._use.record()

    def report(self) -> dict[str, Any]:
        score = self._check.score
        connections = connections_report(self.agents)
        return {
            **connections,
            "agents": [self._supervision.traffic_behind(agent) for agent in connections["agents"]],
            "estimation": {
                "position_rms_m": score.position_rms_m,
                "position_nees": score.position_nees,
                "heading_rms_deg": score.heading_rms_deg,
                "heading_nees": score.heading_nees,
            },
            "stale_exchanges": self._use.report.stale,
            "actuators": self._use.report,
            "takeovers": [] if self._redundancy is None else self._redundancy.takeovers,
            **self._sensing.recorded_report(),
        }


class ActuatorUse:
    """Counts every exchange, and sequences of exchanges without new commands."""

    def __init__(self) -> None:
        self.report = ActuatorReport()
        self._exchanges = 0
        self._stale = 0

    def add(self, fresh: bool, age_ns: int | None) -> None:
        """Add an exchange: whether a new command has arrived, and the age of the current one, None while unknown."""
        report = self.report
        self._exchanges += 1
        if age_ns is not None:
            report.age.add(age_ns)
        if fresh:
            self._stale = 0
            return
        self._stale += 1
        self.report = replace(report, stale=report.stale + 1, longest_stale=max(report.longest_stale, self._stale))

    def record(self) -> ActuatorAge:
        """Return the counts as a record."""
        report = self.report
        p50_ns, p99_ns = report.age.quantile_ns(0.5), report.age.quantile_ns(0.99)
        return ActuatorAge(
            exchanges=self._exchanges,
            stale=report.stale,
            longest_stale=report.longest_stale,
            age_p50_s=None if p50_ns is None else p50_ns * 1e-9,
            age_p99_s=None if p99_ns is None else p99_ns * 1e-9,
            age_max_s=report.age.max_ns * 1e-9 if report.age.count else None,
        )
