"""Another autopilot behind a bridge: starts, prepares, times, checks and stops it, and collects its log."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

from agent.bridges.counts import BridgeCounts
from agent.bridges.kinds import FAILED
from agent.mavlink.commands import version_text
from agent.wire import dialect
from sim_core.dataclass import dataclass
from sim_core.geodesy import LocalFrame
from sim_core.kinematics import Kinematics
from xitl_cli.errors import UserError
from xitl_cli.firmware.process import CONSOLE, FirmwareProcess, newest_log
from xitl_cli.graph.graph import ACTUATORS, SENSORS, AgentTraffic
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.table import Table, first_of
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotorCommand, TaskTiming
from xitl_cli.run.core.node import PluginNodeError, RunContext, RunNode, RunStep
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import Send
from xitl_cli.run.links.bridge_clock import SIMULATED_UNEVEN_NS, AutopilotClock
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.links.launch import FirmwareLaunch, Px4Launch, resolved_bridge
from xitl_cli.run.links.ports import PortClaims
from xitl_cli.run.links.setup import live_parameters, mission_plans
from xitl_cli.run.nodes.drivers import VehicleDriver
from xitl_cli.run.nodes.preparation import CalibrationStep, MissionStep, ParameterStep, Preparation

MOVES_MPS = 0.2
DRIVES = 0.02


@dataclass(slots=True)
class Milestones:
    """Seconds from the start of the run; None until the milestone is reached."""

    heartbeat_s: float | None = None
    """First heartbeat."""
    origin_s: float | None = None
    """The estimator has an origin."""
    ready_s: float | None = None
    """The pre-arm checks pass."""
    armed_s: float | None = None
    motion_s: float | None = None
    """After arming, the motors turn and the vessel moves faster than `MOVES_MPS` over ground."""

    def update(self, sim_ns: int, view: AgentView, command: MotorCommand, motion: Kinematics) -> None:
        """Check for new milestones; call it at every exchange."""
        now_s = sim_ns * 1e-9
        if self.heartbeat_s is None and view.heard:
            self.heartbeat_s = now_s
        if self.origin_s is None and view.has_origin:
            self.origin_s = now_s
        if self.ready_s is None and view.ready_to_arm:
            self.ready_s = now_s
        if self.armed_s is None and view.armed:
            self.armed_s = now_s
        if self.motion_s is None and self.armed_s is not None and max(map(abs, command.motors)) > DRIVES:
            north_mps, east_mps, _ = motion.vel_ned_mps[0].tolist()
            if math.hypot(north_mps, east_mps) > MOVES_MPS:
                self.motion_s = now_s


_LOOPS = ("NL", "NLoop")  # depends on the version


@dataclass(frozen=True, slots=True)
class SchedulerRecord:
    """Sums over all rows. A value is None when the log does not have it."""

    rows: int
    fields: tuple[str, ...]
    """Columns that this version logs."""
    loops: int | None = None
    long_loops: int | None = None
    """Loops that took longer than their period."""
    max_us: int | None = None
    """Longest loop."""
    load_mean_percent: float | None = None
    """Mean share of the processor's time."""
    load_max_percent: float | None = None


def scheduler_record(log: Path) -> SchedulerRecord | None:
    """Read a DataFlash log. Returns None when it cannot be read or has no PM records."""
    try:
        with DataFlashLog(log) as opened:
            table = opened.tables.get("PM")
            if table is None:
                return None
            loops, long_loops = _column(table, first_of(table, _LOOPS)), _column(table, first_of(table, ("NLon",)))
            longest, load = _column(table, first_of(table, ("MaxT",))), _column(table, first_of(table, ("Load",)))
            return SchedulerRecord(
                rows=len(table),
                fields=tuple(name for name in table.columns if name != "TimeUS"),
                loops=None if loops is None else int(loops.sum()),
                long_loops=None if long_loops is None else int(long_loops.sum()),
                max_us=None if longest is None else int(longest.max()),
                load_mean_percent=None if load is None else float(load.mean()) / 10.0,
                load_max_percent=None if load is None else float(load.max()) / 10.0,
            )
    except LogError:
        return None


def drop_partial_record(log: Path) -> int:
    """Cut an incomplete last record off a DataFlash log; returns the number of bytes.

    ArduPilot writes its log in blocks of 512 bytes, whatever the length of its records (AP_Logger_File::io_timer). A
    log may therefore end within a record although the autopilot ended normally.
    """
    try:
        with DataFlashLog(log) as opened:
            health = opened.health
    except LogError:
        return 0
    if health.truncated_bytes:
        os.truncate(log, health.size_bytes - health.truncated_bytes)
    return health.truncated_bytes


def _column(table: Table, name: str | None) -> NDArray[np.float64] | None:
    """Return the logged values without scaling, or None when no row has them."""
    if name is None or table.columns[name].kind != "number" or table.columns[name].shape:
        return None
    values = table.values(name, raw=True).astype(np.float64)
    known: NDArray[np.float64] = values[np.isfinite(values)]
    return known if len(known) else None


HOST = "PS1"


@dataclass(frozen=True, slots=True)
class AutopilotReport:
    """Report of another autopilot."""

    kind: str
    firmware: str = ""
    """As the autopilot reports it; empty without a report."""
    vehicle: str = ""
    """As the autopilot reports it; empty without a report."""
    milestones: Milestones = field(default_factory=Milestones)
    bridge: BridgeCounts | None = None
    """The latest counts of the bridge; None before the first."""
    program: str | None = None
    """Program that the run started; None for an autopilot that the user started."""
    log: bool = False
    """Whether the autopilot's log was collected."""
    scheduler: SchedulerRecord | None = None
    """From that log. It measures processor time only with a real clock."""
    real_clock: bool | None = None
    """Whether the autopilot runs on a real clock; None when unknown."""
    utc_offset_s: float | None = None
    """The autopilot's UTC less the host's."""

    def section(self, tasks: Sequence[TaskTiming]) -> dict[str, Any]:
        """Return `autopilot` of summary.json; docs/recording.md explains the keys. tasks: all tasks of the run."""
        times, agent = self.milestones, [task for task in tasks if task.node != HOST]
        return {
            "kind": self.kind,
            "firmware": self.firmware or None,
            "vehicle": self.vehicle or None,
            "program": self.program,
            "time_to_heartbeat_s": times.heartbeat_s,
            "time_to_origin_s": times.origin_s,
            "time_to_ready_s": times.ready_s,
            "time_to_arm_s": times.armed_s,
            "time_to_motion_s": times.motion_s,
            "bridge": None if self.bridge is None else asdict(self.bridge),
            "log": self.log,
            "clock": None if self.real_clock is None else "real" if self.real_clock else "simulated",
            "utc_offset_s": self.utc_offset_s,
            "scheduler": (
                None if self.scheduler is None else {**asdict(self.scheduler), "fields": list(self.scheduler.fields)}
            ),
            "agent": {"cycles": sum(task.cycles for task in agent), "missed": sum(task.missed for task in agent)},
        }


BRIDGE = "Bridge: "
WRONG_VEHICLE = f"{BRIDGE}the autopilot is "
CHECK_EVERY = 16  # exchanges
LOCKSTEP_STOP_S = 2.0  # the world runs until the autopilot has ended; after this time it no longer responds
NO_BRIDGE_NS = 10_000_000_000  # a bridge reports its counts every second
PAIR_MS = 50  # attitude and position arrive at different rates
_MAKES = {"ardupilot": dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, "px4": dialect.MAV_AUTOPILOT_PX4}
CALL_S = 0.7  # the agent connects again every half second


def make_launch(
    profile: RunProfile, ports: PortClaims, ground_stations: tuple[str, ...] = (), ais: str | None = None
) -> FirmwareLaunch | Px4Launch | None:
    """Return the launcher of an autopilot that this run starts, otherwise None. Raises UserError."""
    if not profile.autopilot.started_here:
        return None
    if profile.autopilot.kind == "px4":
        return Px4Launch(profile)
    bridge = resolved_bridge(profile.autopilot.bridge, ports)
    return FirmwareLaunch(profile, bridge, ports.free("udp"), ground_stations, ais)


class BridgeNode(RunNode):
    """The autopilot of `profile` behind the agent. Its log goes to `run_directory`. bridge: settings of the bridge.

    ais: address to which an autopilot of this run connects for AIS sentences.

    Raises UserError when the run has to start the autopilot and cannot find it.
    """

    def __init__(
        self,
        profile: RunProfile,
        run_directory: Path | None,
        ground_stations: tuple[str, ...] = (),
        ais: str | None = None,
    ) -> None:
        self._profile = profile
        self._directory = run_directory
        autopilot = profile.autopilot
        self.milestones = Milestones()
        self._ports = PortClaims()
        self._launch = make_launch(profile, self._ports, ground_stations, ais)
        self.bridge = autopilot.bridge if self._launch is None else self._launch.bridge
        self._process: FirmwareProcess | None = None
        self._agent: AgentConnection | None = None
        self._view: AgentView | None = None
        self._counts: BridgeCounts | None = None
        self._recorder: Recorder | None = None
        self._now_ns: Callable[[], int] = lambda: 0
        self._version = ""
        self._vehicle = ""
        self._problem: str | None = None
        self._failure = ""
        self._exchanges = 0
        self._restarts: int | None = None
        self._text = ""
        self._bridge_problems: deque[str] = deque(maxlen=2)
        self._log: Path | None = None
        self._clock: AutopilotClock | None = None

    @property
    def station_url(self) -> str | None:
        """The address at which the autopilot waits for a ground station, or None."""
        return self._launch.station_url if isinstance(self._launch, Px4Launch) else None

    def preparation(self, driver: VehicleDriver, agent: AgentConnection, send: Send, frame: LocalFrame) -> Preparation:
        """Return the driver that runs before `driver`. agent: the bridge; `send` sends to it."""
        profile, autopilot, target = self._profile, self._profile.autopilot, agent.target
        plans = mission_plans(profile, frame)
        self._agent, self._view = agent, agent.inbox.view
        simulated = self._launch is not None and autopilot.firmware_build == "sitl"
        uneven_ns = SIMULATED_UNEVEN_NS if simulated else 0
        self._clock = AutopilotClock(profile.clock.mode == "lockstep", send, uneven_ns)
        return Preparation(
            driver,
            self._view,
            ParameterStep(send, target, live_parameters(profile), autopilot.kind == "px4"),
            MissionStep(send, target, plans),
            CalibrationStep(send, target, autopilot.firmware_build == "linux"),
            autopilot.moored_until_armed,
            self.bridge.mavlink,
            autopilot.connect_timeout_s,
            autopilot.arm_timeout_s,
            self._bridge_problems_text,
        )

    def begin(self, context: RunContext) -> None:
        """Start the firmware if the run has to, and stamp the messages of the autopilot by the autopilot's clock.

        In real time the agent gets time to connect to the autopilot. In lockstep it connects before time runs.
        """
        self._recorder, self._now_ns = context.recorder, context.clock.now_ns
        if self._agent is not None and self._clock is not None:
            inbox = self._agent.inbox
            self._clock.begin(context)
            inbox.use_vehicle_clock(self._clock.sim_ns)
            inbox.view.pair_ms = PAIR_MS
            # The world of ArduPilot's simulator uses ArduPilot's metres; our receiver is on the Earth.
            own_world = self._profile.autopilot.kind == "ardupilot" and self.bridge.sensors is not None
            inbox.view.sphere_metres = own_world
        if self._launch is None or self._directory is None or self._agent is None:
            return
        try:
            self._process = self._launch.start(self._directory)
        except UserError as error:
            raise self._with_build(error) from error
        calls = self.bridge.world is None and self._profile.clock.mode == "realtime"
        until_s = time.monotonic() + (CALL_S if calls else 0.0)
        while time.monotonic() < until_s:
            self._agent.receive(0.02)

    # In the run

    def handle(self, message: Any) -> None:
        """Handle a message from the bridge, after the view has handled it."""
        number = message.get_msgId()
        if self._clock is not None:
            self._clock.handle(message)
        if number == dialect.MAVLINK_MSG_ID_XITL_BRIDGE_STATUS:
            self._counts = BridgeCounts.of_message(message)
            if self._recorder is not None:
                self._recorder.write(self._now_ns(), self._counts)
        elif number == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self._version = version_text(message)
        elif number == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._vehicle = _vehicle(message.type)
            kind, autopilot = self._profile.autopilot.kind, message.autopilot
            if self._problem is None and autopilot != _MAKES.get(kind, autopilot):
                make = {number: name for name, number in _MAKES.items()}.get(autopilot, "another one")
                self._problem = f"the autopilot is {make} (MAV_AUTOPILOT {autopilot}), not {kind}"
        elif number == dialect.MAVLINK_MSG_ID_STATUSTEXT and self._view is not None and self._view.texts:
            text, severity = self._view.texts[-1], message.severity
            if text is self._text:  # the same object means that the text is not complete yet
                return
            self._text = text
            if severity <= dialect.MAV_SEVERITY_CRITICAL and text.startswith(BRIDGE + FAILED):
                self._failure = self._failure or text.removeprefix(BRIDGE + FAILED)
            elif severity <= dialect.MAV_SEVERITY_ERROR and text.startswith(WRONG_VEHICLE):
                self._problem = text.removeprefix(BRIDGE)
            elif text.startswith(BRIDGE) and severity > dialect.MAV_SEVERITY_WARNING:
                self._bridge_problems.clear()
            elif text.startswith(BRIDGE) and text not in self._bridge_problems:
                self._bridge_problems.append(text)

    def _bridge_problems_text(self) -> str:
        """Return the bridge's latest problems that are not over, as the end of a sentence."""
        problems = "; ".join(text.removeprefix(BRIDGE) for text in self._bridge_problems)
        return f"; the bridge reports: {problems}" if problems else ""

    def exchange(self, step: RunStep) -> None:
        sim_ns = step.now_ns
        if self._agent is not None and self._view is not None and self._clock is not None:
            self.milestones.update(sim_ns, self._view, self._agent.inbox.command, step.motion)
            if self._view.heard:
                self._clock.update(sim_ns)
        if self._counts is None and sim_ns > NO_BRIDGE_NS:
            raise UserError(
                "autopilot.link: the agent at this address runs the embedded autopilot and is no bridge; start it with "
                "--role bridge, or use autopilot.kind: embedded"
            )
        if self.milestones.armed_s is not None and self._view is not None and self._profile.driver.kind == "mission":
            restarts = 0 if self._counts is None else self._counts.restarts
            if self._restarts is None:
                self._restarts = restarts
            elif restarts > self._restarts and not self._view.armed:  # no driver would arm it again
                raise UserError(
                    f"the autopilot restarted during the mission, before {sim_ns * 1e-9:.1f} s of simulation time, "
                    "and is disarmed; find the reason in its power and its log, then run again"
                )
        self._exchanges += 1
        if self._failure or self._problem is not None or self._exchanges % CHECK_EVERY == 0:
            self.check()

    def check(self) -> None:
        """Raise UserError when the bridge of a package has failed, or the autopilot has ended or is the wrong kind."""
        if self._failure:
            raise PluginNodeError(f"autopilot.bridge.sensors: {self._failure}")
        if self._problem is not None:
            raise UserError(f"{self._problem}; use a matching firmware, or another autopilot.bridge.mavlink")
        if self._process is None:
            return
        try:
            self._process.check()
        except UserError as error:
            raise (error if self._heard else self._with_build(error)) from error

    @property
    def _heard(self) -> bool:
        return self._view is not None and self._view.heard

    def _with_build(self, error: UserError) -> UserError:
        """Add a hint on the build to the error of an autopilot that ended before its first heartbeat."""
        build = self._profile.autopilot.firmware_build
        return UserError(f"{error}, and check that it is a {build} build, as in autopilot.firmware_build")

    def silent_s(self) -> float:
        """Return the longest silence in lockstep.

        It is longer at first, when the user may still have to start the autopilot.
        """
        autopilot = self._profile.autopilot
        return autopilot.silent_s if self._heard else max(autopilot.silent_s, autopilot.connect_timeout_s)

    def why_silent(self, seconds: float, sim_s: float) -> UserError:
        """Return the error for an autopilot that has been silent for too long."""
        if self._process is None and self.bridge.world is not None and not self._heard:
            return UserError(
                f"{self.bridge.world}: no autopilot connected within {seconds:.0f} s; start one "
                "with --model JSON:HOST, where HOST is the machine of the bridge, or use autopilot.firmware: find"
            )
        problems = self._bridge_problems_text()
        stopped = f"stopped and was silent for {seconds:.3g} s, at {sim_s:.2f} s of simulation time; check"
        if self._process is not None:
            return UserError(f"{self._process.program.name} {stopped} {self._process.directory / CONSOLE}{problems}")
        return UserError(f"{self.bridge.mavlink}: the autopilot {stopped} its power, its cables and its log{problems}")

    # After the run

    def end(self) -> None:
        """Stop the autopilot and keep its log. Safe to call again."""
        if self._launch is None:
            return
        if self._process is not None and self._directory is not None:

            def serve(seconds: float) -> None:
                """Let the agent continue the autopilot's time, without which the autopilot does not end."""
                if self._agent is not None and self._agent.is_open:
                    self._agent.receive(seconds)
                else:
                    time.sleep(seconds)

            if self._profile.clock.mode == "lockstep":
                self._process.stop(LOCKSTEP_STOP_S, serve)
            else:
                self._process.stop()
            log = newest_log(self._process.directory, self._launch.log_suffix)
            if log is not None:
                self._log = log.replace(self._directory / self._launch.log_name)
                if self._process.ended_in_order and self._profile.autopilot.kind == "ardupilot":
                    drop_partial_record(self._log)
            self._process = None
        self._launch.end()

    def close(self) -> None:
        self.end()
        self._ports.close()

    def traffic_behind(self, bridge: AgentTraffic) -> AgentTraffic:
        """Return the traffic of the autopilot behind the bridge, for the graph of the run."""
        return traffic_behind(self._profile, self.milestones.heartbeat_s is not None, self._counts, bridge)

    def report(self) -> dict[str, Any]:
        clocks = [] if self._clock is None else [self._clock.report()]
        return {"clocks": clocks, "autopilot": self.known()}

    def known(self) -> AutopilotReport:
        """Return the report so far."""
        autopilot = self._profile.autopilot
        return AutopilotReport(
            kind=autopilot.kind,
            firmware=self._version,
            vehicle=self._vehicle,
            milestones=self.milestones,
            bridge=self._counts,
            program=None if self._launch is None else str(self._launch.program),
            log=self._log is not None,
            scheduler=None if self._log is None or autopilot.kind == "px4" else scheduler_record(self._log),
            real_clock=None if self._launch is None else autopilot.firmware_build == "linux",
            utc_offset_s=None if self._clock is None else self._clock.utc_offset_s,
        )


def traffic_behind(profile: RunProfile, heard: bool, counts: BridgeCounts | None, bridge: AgentTraffic) -> AgentTraffic:
    """Return the traffic of the autopilot behind a bridge, for the graph of the run.

    The autopilot is present when a heartbeat arrived. It gets the frames that the bridge could pass on. An autopilot at
    a serial device is a board, except at a pseudo terminal, which a program on this machine serves.
    """
    if not heard:
        return replace(bridge, nodes="", to_agent={}, from_agent={}, estimates=0, efforts=0)
    passed_on = ("script_in",) if profile.autopilot.bridge.sensors == "hil" else ("imu_out", "solution_out", "gnss_out")
    to_agent, from_agent = dict(bridge.to_agent), dict(bridge.from_agent)
    if counts is None or not any(getattr(counts, count) for count in passed_on):
        to_agent = {number: frames for number, frames in to_agent.items() if number not in SENSORS}
    if not bridge.efforts:
        from_agent.pop(ACTUATORS, None)  # neutral commands from the bridge itself
    kind, machine, device = bridge.kind, bridge.machine, urlsplit(profile.autopilot.bridge.mavlink)
    if device.scheme == "serial" and not Path(device.path).resolve().is_relative_to("/dev/pts"):
        kind, machine = "real", f"board at {device.path}"
    return replace(bridge, kind=kind, machine=machine, to_agent=to_agent, from_agent=from_agent)


def _vehicle(mav_type: int) -> str:
    entry = dialect.enums["MAV_TYPE"].get(mav_type)
    return entry.name.removeprefix("MAV_TYPE_").replace("_", " ").lower() if entry else f"MAV_TYPE {mav_type}"
