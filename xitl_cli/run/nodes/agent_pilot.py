"""An autopilot behind an agent, wherever it runs: sensors out over the link, motor commands back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from agent.wire.signing import Signing
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotionEstimate, TaskTiming
from xitl_cli.run.faults import FaultSchedule
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.connection import WARNING, AgentConnection, StoppedWaitingError, tick_and_wait
from xitl_cli.run.links.inbox import AgentInbox
from xitl_cli.run.links.peer import (
    AGENT_COMPONENT_ID,
    AGENT_SYSTEM_ID,
    AgentOptions,
    Peer,
    missing_addresses,
    open_peer,
)
from xitl_cli.run.links.setup import embedded_parameters, mission_places
from xitl_cli.run.links.waiting import wait_for_any
from xitl_cli.run.nodes.actuator_use import ActuatorUse
from xitl_cli.run.nodes.bridge import Attended, AutopilotReport
from xitl_cli.run.nodes.companion import LINK as COMPANION
from xitl_cli.run.nodes.companion import CompanionLine, NoCompanion
from xitl_cli.run.nodes.drivers import make_driver
from xitl_cli.run.nodes.estimation import EstimateCheck
from xitl_cli.run.nodes.orders import Orders
from xitl_cli.run.nodes.score import EstimationScore
from xitl_cli.run.nodes.standby import Redundancy
from xitl_cli.run.pace import Lockstep, Pace
from xitl_cli.run.pilot import (
    ActuatorReport,
    ClockReport,
    FaultReport,
    LinkReport,
    NodeReport,
    Progress,
    TakeoverReport,
    Traffic,
)
from xitl_cli.run.seeds import Seeds
from xitl_cli.run.sensors.sensing import local_frame, sensing_of
from xitl_cli.signing import read_key_file

SYNC_RATE_HZ = 10.0
LINKS_RATE_HZ = 1.0


def links_of(profile: RunProfile) -> tuple[str, ...]:
    """Names of the links to agents."""
    agents = _autopilots_of(profile)
    return agents if profile.companion is None else (*agents, COMPANION)


def _autopilots_of(profile: RunProfile) -> tuple[str, ...]:
    return ("agent",) if profile.autopilot.standby is None else ("agent", "standby")


class AgentPilot:
    """See Pilot. In lockstep every exchange is a tick and its answer; in real time both sides go on their own.

    A second agent, if the profile has one in standby, gets all that the first one gets. `attended` is the autopilot of
    another make, to which the agent is then a bridge. interrupted: asked while the answer to a tick is waited for.
    companion: the companion computer that the profile has, or nobody.
    """

    def __init__(
        self,
        profile: RunProfile,
        seeds: Seeds,
        options: AgentOptions | None = None,
        attended: Attended | None = None,
    ) -> None:
        self._profile = profile
        self._options = options or AgentOptions()
        self._lockstep = profile.clock.mode == "lockstep"
        self._frame = local_frame(profile.site)
        self._sensing = sensing_of(profile, seeds)
        self._faults = FaultSchedule(profile.faults, seeds) if profile.faults else None
        standby = profile.autopilot.standby
        self._agents = [self._connection(name) for name in _autopilots_of(profile)]
        self.companion = NoCompanion() if profile.companion is None else CompanionLine(profile, self._send)
        first = self._agents[0]
        self._view = first.inbox.view
        if standby is not None:
            self._view = AgentView(self._frame, lambda severity, text: None, lambda agent_us, estimate: None)
        self._attended = attended
        self._driver = make_driver(
            profile, Orders(self._view, self._send, AGENT_SYSTEM_ID, AGENT_COMPONENT_ID), self._frame
        )
        if attended is not None:
            self._driver = attended.preparation(self._driver, self._view, self._send, self._frame)
            first.why_silent = attended.why_silent
        self._redundancy = None if standby is None else Redundancy(self._agents, self._view, standby)
        for agent in self._agents:
            agent.inbox.on_message = self._take if standby is None else self._hears(agent)
        self._check = EstimateCheck(profile.clock.physics_rate_hz)
        self._sync_every = max(round(profile.clock.exchange_rate_hz / SYNC_RATE_HZ), 1)
        self._links_every = max(round(profile.clock.exchange_rate_hz / LINKS_RATE_HZ), 1)
        self.estimation: EstimationScore | None = self._check.score
        self.command = first.inbox.command
        self.stale_exchanges = 0
        self.interrupted: Callable[[], bool] = lambda: False
        if isinstance(self.companion, CompanionLine):
            self.companion.interrupted = lambda: self.interrupted()
        self._use = ActuatorUse()
        self._pace: Pace = Lockstep()  # until the run begins
        self._exchanges = 0
        self._step = 0
        self._sim_ns = 0

    def _connection(self, name: str) -> AgentConnection:
        profile = self._profile
        autopilot = profile.autopilot

        def on_estimate(stamp_ns: int | None, estimate: MotionEstimate) -> None:
            if agent is self._active:
                self._on_estimate(stamp_ns, estimate)

        inbox = AgentInbox(name, self._frame, profile.vehicle.commands, self._lockstep, on_estimate)
        key = autopilot.link_key_file
        agent = AgentConnection(name, profile, inbox, None if key is None else Signing(read_key_file(key)))
        return agent

    def _take(self, message: Any) -> None:
        if self._attended is not None:
            self._attended.take(message)
        self._driver.take(message)
        self.companion.forward(message)

    def _hears(self, agent: AgentConnection) -> Callable[[Any], None]:
        """Of two agents the driver hears the one that steers."""

        def take(message: Any) -> None:
            if agent is self._active:
                self._view.take(message)
                self._driver.take(message)
                self.companion.forward(message)

        return take

    @property
    def _active(self) -> AgentConnection:
        return self._agents[0] if self._redundancy is None else self._redundancy.active

    # Before the run

    def prepare(self) -> None:
        for agent in self._agents:
            agent.reach(self._open_peer(agent.name))
        self.companion.prepare()

    def _open_peer(self, name: str) -> Peer:
        autopilot, options = self._profile.autopilot, self._options
        if name == "agent":
            return open_peer(autopilot.runs, autopilot.link, options)
        assert autopilot.standby is not None
        own = replace(options, ground_stations=(), log_dir=None)
        return open_peer(autopilot.standby.runs, autopilot.standby.link, own)

    def begin(self, recorder: Recorder, pace: Pace) -> None:
        self._recorder = recorder
        self._pace = pace
        parameters: dict[str, float] = {}
        mission: list[tuple[float, float, float]] = []
        if self._attended is None:
            parameters = embedded_parameters(self._profile)
            mission = mission_places(self._profile, self._frame) if self._profile.mission.waypoints_ned_m else []
        for agent in self._agents:
            agent.begin(recorder, pace, self._now_ns, parameters, mission)
        self.companion.begin(recorder, pace, self._now_ns)
        if self._attended is not None:
            self._attended.begin(recorder, pace, self._now_ns, self._agents[0].inbox)
            self._attended.start(self._agents[0].receive)
        for address in missing_addresses(self._profile, self._options):
            recorder.log(0, WARNING, "run", f"{address} is in use: no ground station can connect there")

    # In the run

    def sense(self, sim_ns: int, motion: Kinematics, air_ned_mps: Array) -> None:
        self._sim_ns = sim_ns
        self._step += 1
        self._check.add_truth(sim_ns, motion)
        messages = self._sensing.due(self._step, sim_ns, motion, air_ned_mps)
        if messages:
            for agent in self._agents:
                if agent.gone is None:
                    agent.send_sensors(messages)

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        self._driver.update(sim_ns)
        if self._faults is not None:
            self._apply_faults(self._faults, sim_ns)
        self._exchanges += 1
        self.companion.before(self._exchanges)
        if self._lockstep:
            self._tick_and_wait(sim_ns)
        else:
            self._take_in(sim_ns)
        self.companion.after(sim_ns, self._exchanges)
        if self._attended is not None:
            self._attended.update(sim_ns, self.command, motion)
        if self._exchanges % self._links_every == 0:
            for agent in self._agents:
                agent.record_links(self._recorder, sim_ns)
            self.companion.record_links(self._recorder, sim_ns)
            if not self._lockstep:
                self._recorder.write(sim_ns, self._use.record())

    def _take_in(self, sim_ns: int) -> None:
        """Real time: what has come since, whoever sent it."""
        for agent in self._agents:
            if agent.gone is None:
                if self._exchanges % self._sync_every == 1:
                    agent.request_time()
                agent.receive(0.0)
                agent.watch()
                if agent.gone is not None and self._redundancy is not None:
                    agent.inbox.say(WARNING, "run", str(agent.gone))
        motors = None if self._redundancy is None else self._redundancy.update(sim_ns, self._recorder)
        active = self._active
        if active.gone is not None and all(agent.gone is not None for agent in self._agents):
            raise active.gone
        inbox = active.inbox
        age_ns = inbox.age_ns()
        self._use.add(inbox.fresh, age_ns)
        self.stale_exchanges = self._use.report.stale
        self.command = replace(
            inbox.command,
            motors=inbox.command.motors if motors is None else motors,
            age_s=None if age_ns is None else age_ns * 1e-9,
        )
        for agent in self._agents:
            agent.inbox.fresh = False

    def _apply_faults(self, faults: FaultSchedule, sim_ns: int) -> None:
        faults.record(sim_ns, self._recorder)
        for agent in self._agents:
            if agent.gone is None:
                agent.apply_faults(sim_ns, faults.at(sim_ns, agent.name))
                if self._exchanges % self._links_every == 0:
                    faults.count_impaired(*agent.impaired, agent.name)
        self.companion.apply_faults(sim_ns, faults, self._exchanges % self._links_every == 0)

    def idle(self, seconds: float) -> None:
        agents = [agent for agent in self._agents if agent.gone is None]
        links = [*(agent.link for agent in agents), *self.companion.open_links()]
        if len(links) > 1:
            wait_for_any(links, seconds)
            seconds = 0.0
        for agent in agents:
            agent.receive(seconds)
        self.companion.idle(seconds)

    def _tick_and_wait(self, sim_ns: int) -> None:
        agent = self._agents[0]
        silent_s = self._profile.autopilot.silent_s if self._attended is None else self._attended.silent_s
        tick_and_wait(agent, sim_ns, self._exchanges, silent_s, self._check_autopilot)
        self.command = agent.inbox.command

    def _check_autopilot(self) -> None:
        if self.interrupted():
            raise StoppedWaitingError
        if self._attended is not None:
            self._attended.check()

    def _send(self, message: Any) -> None:
        for agent in self._agents:
            if agent.gone is None:
                agent.send(message)

    def _on_estimate(self, stamp_ns: int | None, estimate: MotionEstimate) -> None:
        self._recorder.estimate(self._now_ns() if stamp_ns is None else stamp_ns, estimate)
        self._check.add_estimate(stamp_ns, estimate, self._view.armed)

    def _now_ns(self) -> int:
        return self._pace.now_sim_ns(self._sim_ns)

    def progress(self) -> Progress:
        view, texts = self._view, self._active.inbox.view.texts
        faults = () if self._faults is None else self._faults.names_in_force()
        return replace(self._driver.progress(), mode=view.mode, armed=view.armed, messages=tuple(texts), faults=faults)

    def position_error_m(self) -> float | None:
        return self._check.position_error_m

    # After the run

    def end(self) -> None:
        for agent in self._agents:
            agent.stop()
            if self._faults is not None:
                self._faults.count_impaired(*agent.impaired, agent.name)
        self.companion.end()
        if self._attended is not None:
            self._attended.end()

    def close(self) -> None:
        for agent in self._agents:
            agent.close()
        self.companion.close()
        if self._attended is not None:
            self._attended.end()

    def links(self) -> list[LinkReport]:
        return [*(report for agent in self._agents for report in agent.links()), *self.companion.links()]

    def tasks(self) -> list[TaskTiming]:
        return [*(task for agent in self._agents for task in agent.inbox.view.tasks.values()), *self.companion.tasks()]

    def clocks(self) -> list[ClockReport]:
        slope = self._pace.slope(self._profile.clock.physics_rate_hz)
        physics = ClockReport("PS1", 0.0, 0.0, 0.0, slope_s=slope.mean_s, slope_std_s=slope.deviation_s)
        others = [] if self._attended is None else self._attended.clocks()
        return [*(agent.inbox.timing.report() for agent in self._agents), *others, *self.companion.clocks(), physics]

    def nodes(self) -> list[NodeReport]:
        reports = [report for agent in self._agents if (report := agent.node()) is not None]
        return [*reports, *self.companion.nodes()]

    def actuators(self) -> ActuatorReport | None:
        return self._use.report

    def takeovers(self) -> list[TakeoverReport]:
        return [] if self._redundancy is None else self._redundancy.takeovers

    def faults(self) -> list[FaultReport]:
        return [] if self._faults is None else self._faults.reports(self._sensing.fault_counts())

    def autopilot(self) -> AutopilotReport | None:
        return None if self._attended is None else self._attended.report()

    def traffic(self) -> Traffic:
        return {agent.name: agent.inbox.traffic for agent in self._agents} | self.companion.traffic()
