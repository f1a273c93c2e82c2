"""An autopilot behind an agent, wherever it runs: sensors out over the link, motor commands back."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

from agent.node import PROTOCOL
from agent.wire import dialect
from agent.wire.link import Link
from sim_core.kinematics import Kinematics
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.recording.recorder import Recorder
from xitl_cli.recording.records import Estimate, MotorCommand, Task
from xitl_cli.run.agent_options import AgentOptions, missing_addresses
from xitl_cli.run.agent_setup import Setup, mission_of, parameters_of
from xitl_cli.run.agent_view import AgentView
from xitl_cli.run.driver import make_driver
from xitl_cli.run.link_timing import LinkTiming, LockstepTiming
from xitl_cli.run.orders import Orders
from xitl_cli.run.pace import Pace
from xitl_cli.run.peer import (
    AGENT_COMPONENT_ID,
    AGENT_SYSTEM_ID,
    HOST_COMPONENT_ID,
    HOST_SYSTEM_ID,
    Peer,
    open_peer,
)
from xitl_cli.run.pilot import ClockReport, LinkReport, NodeReport, Progress
from xitl_cli.run.score import EstimationScore
from xitl_cli.run.seeds import Seeds
from xitl_cli.run.sensing import Sensing, local_frame
from xitl_cli.run.truth_history import TruthHistory

HELLO_INTERVAL_S = 0.5
START_TRIES = 6
TICK_REPEAT_S = 0.5
SILENT_S = 5.0
SYNC_RATE_HZ = 10.0
SYNC_BURST = 10
END_WAIT_S = 1.0
WARNING = 4  # MAV_SEVERITY_WARNING


class AgentPilot:
    """See Pilot. In lockstep every exchange is a tick and its answer; in real time both sides go on their own."""

    def __init__(self, profile: RunProfile, seeds: Seeds, options: AgentOptions | None = None) -> None:
        assert profile.sensors is not None
        self._profile = profile
        self._options = options or AgentOptions()
        self._lockstep = profile.clock.mode == "lockstep"
        self._frame = local_frame(profile.site)
        self._sensing = Sensing(profile.sensors, profile.site, profile.clock.physics_rate_hz, seeds)
        self._view = AgentView(self._frame, self._on_text, self._on_estimate)
        orders = Orders(self._view, self._send, AGENT_SYSTEM_ID, AGENT_COMPONENT_ID)
        self._driver = make_driver(profile, orders, self._frame)
        self._truth = TruthHistory(profile.clock.physics_rate_hz)
        self._timing = LockstepTiming() if self._lockstep else LinkTiming()
        self._sync_every = max(round(profile.clock.exchange_rate_hz / SYNC_RATE_HZ), 1)
        self.estimation: EstimationScore | None = EstimationScore()
        self._position_error_m: float | None = None
        self.command = MotorCommand((0.0,) * len(profile.vehicle.propellers))
        self._command_ns = 0
        self._fresh = False
        self.stale_exchanges = 0
        self._tick = 0
        self._answered_tick = -1
        self._step = 0
        self._sim_ns = 0
        self._peer: Peer | None = None

    # Before the run

    def prepare(self) -> None:
        self._peer = peer = open_peer(self._profile.autopilot, self._options)
        self._link = Link(peer.transport, HOST_SYSTEM_ID, HOST_COMPONENT_ID)
        started_s = time.monotonic()
        timeout_s = self._profile.autopilot.connect_timeout_s
        while self._view.status is None:
            if time.monotonic() - started_s > timeout_s:
                raise peer.unreachable(timeout_s)
            peer.check()
            self._send_run(dialect.XITL_RUN_COMMAND_HELLO)
            self._receive(HELLO_INTERVAL_S)
        protocol = self._view.status.protocol
        if protocol != PROTOCOL:
            raise UserError(
                f"{peer.transport.peer}: the agent speaks version {protocol} of the XITL dialect, "
                f"this host version {PROTOCOL}; install the same release of xitl on both"
            )

    def begin(self, recorder: Recorder, pace: Pace) -> None:
        self._recorder = recorder
        self._pace = pace
        self._link.tap = self._on_frame
        self._start_agent()
        setup = Setup(self._link.send, self._receive, AGENT_SYSTEM_ID, AGENT_COMPONENT_ID)
        setup.set_parameters(parameters_of(self._profile))
        waypoints = self._profile.mission.waypoints_ned_m
        if waypoints:
            setup.upload_mission(mission_of(self._profile, self._frame))
        if not self._lockstep:
            for _ in range(SYNC_BURST):
                self._send(self._timing.request())
                self._receive(0.02)
        for address in missing_addresses(self._profile, self._options):
            self._recorder.say(0, WARNING, "run", f"{address} is in use: no ground station can connect there")

    def _start_agent(self) -> None:
        """Start, and wait for the answer: both ends count their frames from behind the start message."""
        assert self._peer is not None
        self._view.status = None
        for _ in range(START_TRIES):
            self._send_run(dialect.XITL_RUN_COMMAND_START)
            self._link.reset_counters()
            self._receive(HELLO_INTERVAL_S)
            if self._view.status is not None and self._view.status.running:
                return
            self._peer.check()
        raise self._peer.unreachable(START_TRIES * HELLO_INTERVAL_S)

    # In the run

    def sense(self, sim_ns: int, motion: Kinematics) -> None:
        self._sim_ns = sim_ns
        self._step += 1
        self._truth.add(sim_ns, motion)
        messages = self._sensing.due(self._step, sim_ns, motion)
        if not messages:
            return
        self._timing.sent(messages)
        self._link.send(*messages)

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        self._driver.update(sim_ns)
        if self._lockstep:
            self._tick_and_wait(sim_ns)
            return
        if self._tick % self._sync_every == 0:
            self._send(self._timing.request())
        self._tick += 1
        self._receive(0.0)
        assert self._peer is not None
        self._peer.check()
        if not self._fresh:
            self.stale_exchanges += 1
            self.command = replace(self.command, age_s=(sim_ns - self._command_ns) * 1e-9)
        self._fresh = False

    def idle(self, seconds: float) -> None:
        self._receive(seconds)

    def _tick_and_wait(self, sim_ns: int) -> None:
        assert self._peer is not None
        self._tick += 1
        tick = dialect.MAVLink_xitl_tick_message(sim_ns // 1000, self._tick)
        self._link.send(tick)
        self._receive(0.0)
        if self._answered_tick == self._tick:
            return
        started_s = sent_s = time.monotonic()
        while self._answered_tick != self._tick:
            self._receive(TICK_REPEAT_S)
            now_s = time.monotonic()
            if now_s - started_s > SILENT_S:
                raise self._silent(sim_ns)
            if now_s - sent_s > TICK_REPEAT_S:
                self._peer.check()
                self._link.send(tick)
                sent_s = now_s

    def _silent(self, sim_ns: int) -> UserError:
        assert self._peer is not None
        return UserError(
            f"{self._peer.transport.peer}: the agent stopped answering at {sim_ns * 1e-9:.2f} s of simulation time; "
            "look at its log and at the cable"
        )

    def progress(self) -> Progress:
        view = self._view
        return replace(self._driver.progress(), mode=view.mode, armed=view.armed, messages=tuple(view.texts))

    def position_error_m(self) -> float | None:
        return self._position_error_m

    # After the run

    def end(self) -> None:
        self._view.status = None
        self._send_run(dialect.XITL_RUN_COMMAND_STOP)
        deadline_s = time.monotonic() + END_WAIT_S
        while self._view.status is None and time.monotonic() < deadline_s:
            self._receive(0.05)

    def close(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def links(self) -> list[LinkReport]:
        counters, status = self._link.counters, self._view.status
        return [
            LinkReport(
                name="sensors",
                sent=counters.sent,
                received=None if status is None else status.frames_received,
                lost=None if status is None else status.frames_lost,
                unsent=counters.unsent,
                dropped=0 if status is None else status.frames_dropped,
                latency=self._timing.sensors,
            ),
            LinkReport(
                name="actuators",
                sent=None if status is None else counters.received + counters.lost,
                received=counters.received,
                lost=counters.lost,
                unsent=None,
                dropped=counters.dropped,
                latency=self._timing.actuators,
            ),
        ]

    def tasks(self) -> list[Task]:
        return list(self._view.tasks.values())

    def clocks(self) -> list[ClockReport]:
        return [self._timing.report()]

    def nodes(self) -> list[NodeReport]:
        status, info = self._view.status, self._view.info
        if status is None or info is None:
            return []
        return [
            NodeReport(
                nodes=info.nodes,
                machine=info.machine,
                version=info.version,
                memory_mib=status.memory_kib / 1024 if status.memory_kib else None,
                refused=status.messages_refused,
            )
        ]

    # Messages

    def _receive(self, timeout_s: float) -> list[Any]:
        assert self._peer is not None
        self._peer.pump()
        messages = self._link.receive(timeout_s)
        for message in messages:
            number = message.get_msgId()
            if number == dialect.MAVLINK_MSG_ID_XITL_ACTUATORS:
                self._on_actuators(message)
            elif number == dialect.MAVLINK_MSG_ID_XITL_TIMESYNC:
                self._on_timesync(message)
            else:
                self._view.take(message)
                self._driver.take(message)
                if number == dialect.MAVLINK_MSG_ID_XITL_TASK_STATS and self._link.tap is not None:
                    for task in self._view.tasks.values():
                        self._recorder.task(self._now_ns(), task)
        return messages

    def _send(self, message: Any) -> None:
        self._link.send(message)

    def _send_run(self, command: int) -> None:
        mode = dialect.XITL_CLOCK_MODE_LOCKSTEP if self._lockstep else dialect.XITL_CLOCK_MODE_REALTIME
        name = self._profile.name.encode()[:32]
        self._link.send(dialect.MAVLink_xitl_run_message(self._sim_ns // 1000, name, command, mode, PROTOCOL))

    def _on_frame(self, direction: str, frame: bytes) -> None:
        if direction == "tx":
            self._recorder.frame_sent(self._now_ns(), frame)
        else:
            self._recorder.frame_received(self._now_ns(), frame)

    def _on_actuators(self, message: Any) -> None:
        flags = message.flags
        self.command = MotorCommand(
            motors=tuple(message.command[: len(self.command.motors)]),
            armed=bool(flags & dialect.XITL_ACTUATOR_FLAGS_ARMED),
            failsafe=bool(flags & dialect.XITL_ACTUATOR_FLAGS_FAILSAFE),
        )
        self._command_ns = self._now_ns()
        self._fresh = True
        self._answered_tick = message.tick
        self._timing.arrived(message)

    def _on_timesync(self, message: Any) -> None:
        clock = self._timing.answered(message)
        if clock is not None:
            self._recorder.clock(self._now_ns(), clock)

    def _on_text(self, severity: int, text: str) -> None:
        self._recorder.say(self._now_ns(), severity, "autopilot", text)

    def _on_estimate(self, agent_us: int, estimate: Estimate) -> None:
        stamp_ns = self._sim_of_agent(agent_us * 1000)
        self._recorder.estimate(self._now_ns(), estimate)
        truth = None if stamp_ns is None else self._truth.at(stamp_ns)
        if truth is None:
            return
        north, east = (estimate.pos_ned_m - truth.pos_ned_m[0])[:2].tolist()
        self._position_error_m = math.hypot(north, east)
        if self._view.armed and self.estimation is not None:
            self.estimation.add(truth.pos_ned_m[0], truth.quat_ned_frd[0], estimate.pos_ned_m, estimate.quat_ned_frd)

    def _sim_of_agent(self, agent_ns: int) -> int | None:
        """Simulation time of an instant on the agent's clock, None while the clocks' relation is unknown."""
        if self._lockstep:
            return agent_ns
        host_ns = self._timing.host_ns(agent_ns)
        return None if host_ns is None else self._pace.sim_of_host(host_ns)

    def _now_ns(self) -> int:
        return self._pace.now_sim_ns(self._sim_ns)
