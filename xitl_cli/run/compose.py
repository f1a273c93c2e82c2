"""Create the nodes of a run from its profiles. The order of the lists is the order of the calls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeVar

from sim_core.environment.tide import NO_TIDE
from sim_core.fleet import Fleet
from sim_core.world.traffic import ScriptedVessel, scripted_motion
from sim_core.world.waterway import OPEN_WATER
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.core.faults import FaultSchedule
from xitl_cli.run.core.live_output import LiveOutput, LiveRun, LiveVessel
from xitl_cli.run.core.node import ControlNode, RunNode, VesselNodes, WorldNodes
from xitl_cli.run.links.agent_workers import AgentWorkers
from xitl_cli.run.links.connection import AgentConnection, Supervision
from xitl_cli.run.links.peer import options_from_profile
from xitl_cli.run.links.stations import StationAddresses
from xitl_cli.run.nodes.ais import AisLine, AisNode, AisRecorder, hears_sentences, receiver_of
from xitl_cli.run.nodes.autopilot import AutopilotNode, autopilot_links
from xitl_cli.run.nodes.autopilot_commands import AutopilotCommands
from xitl_cli.run.nodes.autopilot_events import AutopilotEventNode
from xitl_cli.run.nodes.bridge import BridgeNode
from xitl_cli.run.nodes.companion import COMPANION_LINK, CompanionNode
from xitl_cli.run.nodes.direct_control import direct_control
from xitl_cli.run.nodes.drivers import VehicleDriver, make_driver
from xitl_cli.run.nodes.encounters import EncounterNode
from xitl_cli.run.nodes.estimate_rate import EstimateRate
from xitl_cli.run.nodes.fault_injection import FaultInjection
from xitl_cli.run.nodes.findings import findings_from_profile
from xitl_cli.run.nodes.follow import FollowDriver
from xitl_cli.run.nodes.mission_score import MissionNode
from xitl_cli.run.nodes.model_range import ModelRange
from xitl_cli.run.nodes.perception import PerceptionInstrument, PerceptionNode
from xitl_cli.run.nodes.plugin_nodes import plugin_nodes
from xitl_cli.run.nodes.recorders import LinkRecorder, PaceRecorder, SensorRecorder, TruthRecorder
from xitl_cli.run.nodes.river import CollisionNode, river_from_profile
from xitl_cli.run.nodes.ros_companion import RosCompanionNode
from xitl_cli.run.nodes.scripted import ScriptedRecorder
from xitl_cli.run.nodes.tide import TideNode
from xitl_cli.run.nodes.track import TrackNode
from xitl_cli.run.operator.control import OperatedControl
from xitl_cli.run.operator.environment_changes import EnvironmentChanges
from xitl_cli.run.operator.node import OperatorNode
from xitl_cli.run.operator.operation import UNATTENDED, Operation
from xitl_cli.run.operator.orders import Steering, VesselOrders
from xitl_cli.run.sensors.lidar import make_lidar
from xitl_cli.run.sensors.sonar import make_sonar
from xitl_cli.run.status_display import DisplayNode, StatusDisplay, StatusSource
from xitl_cli.run.traffic.receivers import AisReceiver
from xitl_cli.run.traffic.self_report import SelfReport, VesselVoices, report_from_motion
from xitl_cli.run.world.plant import Plant, PlantView
from xitl_cli.run.world.world import has_waterway, local_frame
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

Node = TypeVar("Node", bound=RunNode)


@dataclass(frozen=True, slots=True)
class RunSetup:
    """Everything that the nodes of one vessel are created from."""

    profile: RunProfile
    seeds: Seeds
    scenery: Scenery
    plant: PlantView
    """The vessel's view of the plant."""
    out: Path
    """Directory for the vessel's own files."""
    interrupted: Callable[[], bool]
    """Returns True when the user asked to stop."""
    stations: StationAddresses
    """Addresses of the ground stations of all autopilots."""
    voices: VesselVoices = field(default_factory=VesselVoices)
    """Reports of the vessels about themselves: position, readiness, end."""
    departs_after: tuple[str, ...] = ()
    """Names of the vessels that must be ready before this one departs."""
    receivers: dict[str, AisReceiver] = field(default_factory=dict)
    """AIS receivers by vessel."""
    workers: AgentWorkers | None = None
    """Processes for embedded autopilots, None if they run in this process."""
    operated: bool = False
    """Whether an operator may act during the run."""
    orders: dict[str, VesselOrders] = field(default_factory=dict)
    """Operator's orders to the autopilots, by vessel."""
    steering: dict[str, Steering] = field(default_factory=dict)
    """Operator's orders to everything that can be steered, by vessel."""
    live: Sequence[LiveOutput] = ()
    """Live outputs that the profile asks for."""

    def others(self) -> str:
        """Return the vessels that this one still waits for; empty when it may depart."""
        return self.voices.waited_for(self.departs_after)


def link_names(profile: RunProfile) -> tuple[str, ...]:
    """Names of the agent links whose raw frames are recorded."""
    agents = autopilot_links(profile)
    companion = profile.companion
    return agents if companion is None or not companion.is_ours else (*agents, COMPANION_LINK)


def compose(setup: RunSetup, opened: ExitStack) -> VesselNodes:
    """Create the nodes of a vessel; `opened` closes them.

    Raises UserError for firmware, files, meshes and ports that are not available.
    """
    profile, plant, realtime = setup.profile, setup.plant, setup.profile.clock.mode == "realtime"
    simulation = plant.simulation

    def made(node: Node) -> Node:
        opened.callback(node.close)
        return node

    # Who moves the vessel.
    bridge = autopilot = companion = line = ais = events = None
    if profile.autopilot.kind == "none":
        by_nodes = profile.driver.kind == "ros"
        silent_s = profile.ros.silent_s
        control: ControlNode = made(
            OperatedControl(profile, silent_s) if by_nodes else direct_control(profile, setup.others)
        )
    else:
        if profile.autopilot.kind != "embedded":
            if hears_sentences(profile):
                line = AisLine(profile)
                opened.callback(line.close)
            calls = line.url if line is not None and profile.autopilot.ais_link is None else None
            bridge = made(BridgeNode(profile, setup.out, setup.stations.of(profile.vessel).urls, calls))
            if bridge.station_url is not None:
                setup.stations.call(bridge.station_url)
        control = autopilot = made(_autopilot(setup, bridge))
        events = AutopilotEventNode(autopilot.view)
        autopilot.heard.subscribe(events.handle)
        if profile.companion is not None and profile.companion.is_ours:
            companion = made(CompanionNode(profile, autopilot.send, setup.interrupted))
            autopilot.heard.subscribe(companion.forward)
    autopilots = [] if autopilot is None else autopilot.agents
    agents = autopilots if companion is None else [*autopilots, companion.agent]
    if profile.vessel:
        own = (lambda: report_from_motion(plant.state.time_ns, plant.motion())) if autopilot is None else autopilot.said
        receiver = None if autopilot is None else receiver_of(profile, autopilot.send, line)
        ready = (lambda: True) if autopilot is None else (lambda: autopilot.driver.ready)
        setup.voices.add(profile.vessel, own, lambda: control.progress.finished, ready)
        if receiver is not None:
            ais = setup.receivers[profile.vessel] = AisRecorder(receiver)

    # What is around it, what looks at it, what scores it.
    open_water = simulation.waterway is OPEN_WATER and not setup.operated
    collisions = None if open_water else CollisionNode(plant, bool(profile.vessel))
    perception = _perception(setup, companion)
    if perception is not None:
        made(perception)
    findings = None
    if autopilot is not None and companion is not None:
        hulls = setup.plant.bodies if profile.vessel else None
        findings = findings_from_profile(profile, setup.scenery, hulls, setup.plant.tide_m)
        companion.heard.subscribe(findings.handle)
        autopilot.heard.subscribe(findings.handle_autopilot)
    mission = MissionNode(profile, control)

    # Injected faults and recorders.
    faults = links = None
    if autopilot is not None:
        if profile.faults or setup.operated:
            faults = FaultInjection(
                FaultSchedule(profile.faults, setup.seeds),
                plant,
                agents,
                autopilots,
                profile.clock,
                autopilot.sample_faults,
                autopilot.set_sample_fault,
            )
        if setup.operated and faults is not None:
            frame = local_frame(profile.site)
            orders = VesselOrders(
                profile, autopilot.new_commands(), frame, faults, autopilot.driver, profile.ros.silent_s
            )
            autopilot.heard.subscribe(orders.handle)
            setup.orders[profile.vessel] = setup.steering[profile.vessel] = orders
        # In lockstep how much has come from a companion depends on the wall clock.
        age = autopilot.actuator_age if realtime else None
        links = LinkRecorder(profile.clock, agents if realtime else autopilots, age)
    elif profile.faults:
        faults = FaultInjection(FaultSchedule(profile.faults, setup.seeds), plant, (), (), profile.clock)
    sensors = estimate_rate = None
    if autopilot is not None and companion is None and profile.ros.enabled and profile.ros.estimate_rate_hz:
        estimate_rate = EstimateRate(autopilot.new_commands(), profile.ros.estimate_rate_hz)
    if autopilot is None and profile.sensors is not None and profile.ros.enabled:
        sensors = SensorRecorder(
            profile, setup.seeds, plant.hulls, lambda: plant.simulation.environment.wind, plant.tide_m
        )
    steering = setup.steering.get(profile.vessel)
    nodes_of_ros = None
    if profile.companion is not None and not profile.companion.is_ours and steering is not None:
        nodes_of_ros = RosCompanionNode(profile.companion, steering.asked_by)
    if isinstance(control, OperatedControl):
        setup.steering[profile.vessel] = control
    in_force = tuple if faults is None else faults.schedule.names_in_force
    status = StatusSource(profile, setup.plant, control, mission.score, agents, in_force)

    order: list[RunNode | None] = [
        collisions,
        ais,
        sensors,
        perception,
        findings,
        None if autopilot is None else autopilot.driver,
        faults,
        None if companion is None else companion.intake,
        None if autopilot is None else autopilot.ticking,
        control,
        events,
        bridge,
        companion,
        estimate_rate,
        links,
        nodes_of_ros,
        TruthRecorder(profile, control, plant),
        ModelRange(simulation),
        mission,
        *map(made, plugin_nodes(profile, plant, setup.scenery, control, setup.seeds)),
        TrackNode(control) if profile.vessel else None,
        *(output.vessel_node(LiveVessel(profile, plant, control, mission, status)) for output in setup.live),
    ]
    return VesselNodes(profile.vessel, control, _present(order), status, _is_awaited(profile))


def compose_world(
    setups: Sequence[RunSetup],
    vessels: Sequence[VesselNodes],
    plant: Plant,
    make_display: Callable[[], StatusDisplay],
    warnings: Sequence[str],
    opened: ExitStack,
    drawn: Callable[[], bytes],
    tell: Callable[[str], None],
    operation: Operation = UNATTENDED,
) -> WorldNodes:
    """Create the nodes of the shared world, of live outputs and of the operator; `opened` closes them.

    warnings: warnings that are known at the start. drawn: returns the encoded scene. tell: prints a line for the user.
    Raises UserError for a port that is not available.
    """
    first, leading = setups[0], vessels[0]
    profile = first.profile
    seeds = Seeds(profile.clock.seed)
    river = operator = None
    if has_waterway(profile) or first.operated:
        river = river_from_profile(profile, seeds, plant, lambda: leading.control.progress)
        opened.callback(river.close)
        if first.operated:
            changes = EnvironmentChanges(plant, profile.environment, seeds)
            names = [setup.profile.vessel for setup in setups]
            operator = OperatorNode(changes, river, names, first.steering, first.orders, operation.events)
            for meet in operation.people:
                meet(operator)
    display = DisplayNode(make_display, warnings, profile.clock, [vessel.status for vessel in vessels])
    opened.callback(display.close)
    ahead: list[RunNode | None] = [display, operator, river]
    fleet = plant.simulation if isinstance(plant.simulation, Fleet) else None
    among = [] if fleet is None else _among_vessels(setups, plant, fleet)
    live_run = LiveRun(plant, drawn, tell, first.interrupted)
    live = [node for output in first.live for node in output.world_nodes(live_run)]
    for node in live:
        opened.callback(node.close)
        if operator is not None:
            node.attach_operator(operator)
    profiles = [setup.profile for setup in setups]
    tide = None if plant.simulation.environment.tide is NO_TIDE else TideNode(profiles, plant)
    behind: list[RunNode | None] = [
        *among,
        tide,
        None if river is None else river.launching,
        PaceRecorder(profile.clock),
        display.showing,
        first.stations,
        *live,
    ]
    return WorldNodes(_present(ahead), _present(behind))


def _among_vessels(setups: Sequence[RunSetup], plant: Plant, fleet: Fleet) -> list[RunNode]:
    """Create the nodes for AIS, encounters and scripted vessels."""
    first, profile = setups[0], setups[0].profile
    physics_hz, recording = profile.clock.physics_rate_hz, profile.recording
    for vessel in fleet.traffic:
        first.voices.add(vessel.name, partial(_scripted_report, plant, vessel), lambda: False)
    nodes: list[RunNode] = []
    if fleet.traffic:
        nodes.append(ScriptedRecorder(fleet, physics_hz, recording.truth_rate_hz, recording.scene))
    nodes.append(AisNode([setup.profile for setup in setups], first.voices, first.receivers))
    nodes.append(EncounterNode(plant, fleet, profile.world.encounter_distance_m, physics_hz))
    return nodes


def _scripted_report(plant: Plant, vessel: ScriptedVessel) -> SelfReport:
    now_ns, tide_m = plant.state.time_ns, plant.vessels[0].tide_m()
    return report_from_motion(now_ns, scripted_motion([vessel], now_ns * 1e-9, tide_m))


def _is_awaited(profile: RunProfile) -> bool:
    """Whether the run waits for this vessel to finish. A vessel of a fleet that follows or drifts never finishes."""
    driver, waypoints = profile.driver.kind, profile.mission.course_ned_m
    return not profile.vessel or (driver != "follow" and (driver != "none" or len(waypoints) > 0))


def _present(nodes: Sequence[RunNode | None]) -> tuple[RunNode, ...]:
    return tuple(node for node in nodes if node is not None)


def _autopilot(setup: RunSetup, bridge: BridgeNode | None) -> AutopilotNode:
    """Create the node of the autopilot: embedded in the agent, or behind it as a bridge."""
    profile, stations = setup.profile, setup.stations.of(setup.profile.vessel)
    frame = local_frame(profile.site)

    def driver_of(commands: AutopilotCommands, agent: AgentConnection) -> VehicleDriver:
        follow = profile.driver.follow
        if profile.driver.kind == "follow" and follow is not None:
            mission, arm_s = profile.mission, profile.autopilot.arm_timeout_s
            driver: VehicleDriver = FollowDriver(
                commands, frame, follow, setup.voices, profile.vessel, mission.speed_mps, arm_s
            )
        else:
            driver = make_driver(profile, commands, frame, stations.told, setup.others)
        return driver if bridge is None else bridge.preparation(driver, agent, commands.send, frame)

    options, supervision = options_from_profile(profile, setup.out, stations.urls), None
    if bridge is not None:
        options = options_from_profile(profile, setup.out, bridge=bridge.bridge)
        supervision = Supervision(bridge.silent_s, bridge.check, bridge.why_silent)
    plant = setup.plant
    autopilot = AutopilotNode(
        profile,
        setup.seeds,
        driver_of,
        options,
        supervision,
        setup.interrupted,
        plant.hulls,
        setup.workers,
        lambda: plant.simulation.environment.wind,
        plant.tide_m,
    )
    if bridge is not None:
        autopilot.heard.subscribe(bridge.handle)
    autopilot.heard.subscribe(autopilot.driver.handle)
    return autopilot


def _perception(setup: RunSetup, companion: CompanionNode | None) -> PerceptionNode | None:
    """Create lidar and sonar. The companion, if there is one, receives their data."""
    profile, sensors, plant = setup.profile, setup.profile.sensors, setup.plant
    instruments: dict[str, PerceptionInstrument] = {}
    if sensors is not None and sensors.lidar is not None:
        instruments["lidar"] = make_lidar(profile, setup.seeds, setup.scenery, plant)
    if sensors is not None and sensors.sonar is not None:
        instruments["sonar"] = make_sonar(profile, setup.seeds, setup.scenery, plant)
    if not instruments:
        return None
    send = (lambda messages: None) if companion is None else companion.send
    return PerceptionNode(instruments, send, lambda: setup.scenery.warnings)
