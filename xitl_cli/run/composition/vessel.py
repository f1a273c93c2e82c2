"""The nodes of one vessel. `Place` has the order of their calls; they are made in the order of `VESSEL_PARTS`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, Any

from numpy.random import default_rng

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.graph.graph import Edge
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.graph import architecture, is_node_name
from xitl_cli.record.recorder import check_added_topic
from xitl_cli.record.topics import Topic
from xitl_cli.registry import NODES, SENSORS, load, names, package_of
from xitl_cli.run.composition.parts import Need, Part, Parts, Place, made_parts, part
from xitl_cli.run.composition.setup import VesselSetup
from xitl_cli.run.core.node import ControlNode, RunNode
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.links.connection import AgentConnection, Supervision
from xitl_cli.run.links.peer import options_from_profile
from xitl_cli.run.nodes.autopilot import AutopilotNode, autopilot_links
from xitl_cli.run.nodes.autopilot_events import AutopilotEventNode
from xitl_cli.run.nodes.companion import COMPANION_LINK, CompanionNode
from xitl_cli.run.nodes.display import StatusSource
from xitl_cli.run.nodes.drivers import VehicleDriver
from xitl_cli.run.nodes.mission import MissionNode, TrackNode
from xitl_cli.run.nodes.model_range import ModelRange
from xitl_cli.run.nodes.plugin_nodes import PluginNode, driver_of
from xitl_cli.run.nodes.recorders import CommandRecorder, LinkRecorder, SensorRecorder
from xitl_cli.run.traffic.self_report import report_from_motion
from xitl_cli.run.world.world import local_frame

if TYPE_CHECKING:  # nodes that few runs have; the functions that make them import them
    from xitl_cli.run.core.live_output import LiveOutput, LiveVessel
    from xitl_cli.run.nodes.ais import AisLine, AisRecorder
    from xitl_cli.run.nodes.bridge import BridgeNode
    from xitl_cli.run.nodes.companion import EstimateRate, RosCompanionNode
    from xitl_cli.run.nodes.direct_control import OperatedControl
    from xitl_cli.run.nodes.fault_injection import FaultInjection
    from xitl_cli.run.nodes.findings import FindingsNode
    from xitl_cli.run.nodes.perception import PerceptionInstrument, PerceptionNode
    from xitl_cli.run.nodes.river import CollisionNode
    from xitl_cli.run.nodes.vessel_orders import VesselOrders
    from xitl_cli.run_kinds import NodeContext, NodeKind


SENSORS_OF_PLUGINS = ("cameras",)
"""Keys of `sensors` whose nodes come from the entry points `xitl.sensors`."""


def link_names(profile: RunProfile) -> tuple[str, ...]:
    """Names of the agent links whose raw frames are recorded."""
    agents = autopilot_links(profile)
    companion = profile.companion
    return agents if companion is None or not companion.is_ours else (*agents, COMPANION_LINK)


def vessel_parts(setup: VesselSetup, opened: ExitStack) -> Parts:
    """Make the nodes of a vessel; `opened` closes them.

    Raises UserError for firmware, files, meshes and ports that are not available.
    """
    declared = (*VESSEL_PARTS, *_sensor_parts(setup), *_plugin_parts(setup), *map(_live_part, setup.run.live))
    return made_parts(declared, {VesselSetup: setup}, setup, opened)


@dataclass(frozen=True, slots=True)
class Agents:
    """Connections to the agents of a vessel."""

    of_autopilot: tuple[AgentConnection, ...]
    all: tuple[AgentConnection, ...]
    """Those of the autopilot, and the companion's."""


# The parts that move the vessel


@part(when=VesselSetup.has_ais_line)
def ais_line(setup: VesselSetup) -> AisLine:
    from xitl_cli.run.nodes.ais import AisLine

    return AisLine(setup.profile)


@part(Place.BRIDGE, when=VesselSetup.has_bridge)
def bridge(setup: VesselSetup, line: AisLine | None) -> BridgeNode:
    from xitl_cli.run.nodes.bridge import BridgeNode

    profile, stations = setup.profile, setup.run.stations
    calls = line.url if line is not None and profile.autopilot.ais_link is None else None
    node = BridgeNode(profile, setup.out, stations.of(profile.vessel).urls, calls)
    if node.station_url is not None:
        stations.call(node.station_url)
    return node


@part(
    Place.CONTROL,
    when=VesselSetup.has_autopilot,
    provides=("ControlNode",),
    also_at={Place.DRIVER: "driver", Place.TICK: "ticking"},
)
def autopilot(setup: VesselSetup, bridge: BridgeNode | None) -> AutopilotNode:
    profile, plant, stations = setup.profile, setup.plant, setup.run.stations.of(setup.profile.vessel)
    options, supervision = options_from_profile(profile, setup.out, stations.urls), None
    if bridge is not None:
        options = options_from_profile(profile, setup.out, bridge=bridge.bridge)
        supervision = Supervision(bridge.silent_s, bridge.check, bridge.why_silent, bridge.traffic_behind)
    node = AutopilotNode(
        profile,
        setup.seeds,
        partial(_driver, setup, bridge),
        options,
        supervision,
        setup.run.interrupted,
        plant.hulls,
        setup.run.workers,
        lambda: plant.simulation.environment.wind,
        plant.tide_m,
        plant if setup.in_fleet() else None,
    )
    if bridge is not None:
        node.heard.subscribe(bridge.handle)
    node.heard.subscribe(node.driver.handle)
    return node


def _driver(
    setup: VesselSetup, bridge: BridgeNode | None, commands: AutopilotCommands, agent: AgentConnection
) -> VehicleDriver:
    from xitl_cli.run_kinds import DriverContext

    profile, frame, run = setup.profile, local_frame(setup.profile.site), setup.run
    addresses = run.stations.of(profile.vessel).told
    keys = profile.plugins.get(profile.driver.kind)
    driver = driver_of(DriverContext(profile, commands, frame, keys, addresses, setup.others, run.voices))
    return driver if bridge is None else bridge.preparation(driver, agent, commands.send, frame)


DRIVEN: tuple[Edge, ...] = (("D", "PS1"), ("D", "M"))
"""The driver's commands reach the vessel and the recording."""


@part(Place.CONTROL, when=VesselSetup.is_driven_directly, edges=DRIVEN)
def direct(setup: VesselSetup) -> ControlNode:
    from xitl_cli.run.nodes.direct_control import direct_control

    return direct_control(setup.profile, setup.others)


@part(Place.CONTROL, when=VesselSetup.is_adrift)
def adrift(setup: VesselSetup) -> ControlNode:
    from xitl_cli.run.nodes.direct_control import direct_control

    return direct_control(setup.profile, setup.others)


@part(Place.CONTROL, when=VesselSetup.is_driven_by_nodes, provides=("ControlNode", "Steering"), edges=DRIVEN)
def operated(setup: VesselSetup) -> OperatedControl:
    from xitl_cli.run.nodes.direct_control import OperatedControl

    return OperatedControl(setup.profile, setup.profile.ros.silent_s)


@part(Place.AUTOPILOT_EVENTS, when=VesselSetup.has_autopilot)
def autopilot_events(autopilot: AutopilotNode) -> AutopilotEventNode:
    node = AutopilotEventNode(autopilot.view)
    autopilot.heard.subscribe(node.handle)
    return node


@part(Place.COMPANION, when=VesselSetup.has_companion, also_at={Place.COMPANION_INTAKE: "intake"})
def companion(setup: VesselSetup, autopilot: AutopilotNode) -> CompanionNode:
    node = CompanionNode(setup.profile, autopilot.send, setup.run.interrupted)
    autopilot.heard.subscribe(node.forward)
    return node


@part(when=VesselSetup.in_fleet)
def voice(setup: VesselSetup, control: ControlNode, autopilot: AutopilotNode | None) -> None:
    plant = setup.plant
    add, name, finished = setup.run.voices.add, setup.profile.vessel, lambda: control.progress.finished
    if autopilot is None:
        add(name, lambda: report_from_motion(plant.state.time_ns, plant.motion()), finished)
    else:
        driver = autopilot.driver
        add(name, autopilot.said, finished, lambda: driver.ready)


@part(Place.AIS_RECEIVER, when=lambda setup: setup.in_fleet() and setup.has_autopilot())
def ais_receiver(setup: VesselSetup, autopilot: AutopilotNode, line: AisLine | None) -> AisRecorder | None:
    from xitl_cli.run.nodes.ais import AisRecorder, receiver_of

    receiver = receiver_of(setup.profile, autopilot.send, line)
    return None if receiver is None else AisRecorder(receiver)


# The world around it, the sensors that observe it, the scores


@part(Place.COLLISIONS, when=VesselSetup.has_obstacles)
def collisions(setup: VesselSetup) -> CollisionNode:
    from xitl_cli.run.nodes.river import CollisionNode

    return CollisionNode(setup.plant, setup.in_fleet())


@part(Place.PERCEPTION, when=lambda setup: setup.profile.sensors is not None)
def perception(setup: VesselSetup, companion: CompanionNode | None) -> PerceptionNode | None:
    profile, scenery = setup.profile, setup.run.scenery
    assert profile.sensors is not None
    instruments: dict[str, PerceptionInstrument] = {}
    if profile.sensors.lidar is not None:
        from xitl_cli.run.sensors.lidar import make_lidar

        instruments["lidar"] = make_lidar(profile, setup.seeds, scenery, setup.plant)
    if profile.sensors.sonar is not None:
        from xitl_cli.run.sensors.sonar import make_sonar

        instruments["sonar"] = make_sonar(profile, setup.seeds, scenery, setup.plant)
    if profile.sensors.radar is not None:
        from xitl_cli.run.sensors.radar import make_radar

        instruments["radar"] = make_radar(profile, setup.seeds, scenery, setup.plant)
    if not instruments:
        return None
    from xitl_cli.run.nodes.perception import PerceptionNode

    return PerceptionNode(
        instruments, (lambda messages: None) if companion is None else companion.send, lambda: scenery.warnings
    )


@part(Place.FINDINGS, when=VesselSetup.has_companion)
def findings(setup: VesselSetup, autopilot: AutopilotNode, companion: CompanionNode) -> FindingsNode:
    from xitl_cli.run.nodes.findings import findings_from_profile

    bodies = setup.plant.bodies if setup.in_fleet() else None
    node = findings_from_profile(setup.profile, setup.run.scenery, bodies, setup.plant.tide_m)
    companion.heard.subscribe(node.handle)
    autopilot.heard.subscribe(node.handle_autopilot)
    return node


@part(Place.MISSION)
def mission(setup: VesselSetup, control: ControlNode) -> MissionNode:
    return MissionNode(setup.profile, control)


# Faults, orders and recorders


@part()
def agents(autopilot: AutopilotNode | None, companion: CompanionNode | None) -> Agents:
    of_autopilot = () if autopilot is None else tuple(autopilot.agents)
    return Agents(of_autopilot, of_autopilot if companion is None else (*of_autopilot, companion.agent))


@part(Place.FAULTS, when=VesselSetup.has_faults)
def faults(setup: VesselSetup, agents: Agents, autopilot: AutopilotNode | None) -> FaultInjection:
    from xitl_cli.run.core.faults import FaultSchedule
    from xitl_cli.run.nodes.fault_injection import FaultInjection

    schedule = FaultSchedule(setup.profile.faults, setup.seeds)
    of_samples = () if autopilot is None else (autopilot.sample_faults, autopilot.set_sample_fault)
    return FaultInjection(schedule, setup.plant, agents.all, agents.of_autopilot, setup.profile.clock, *of_samples)


@part(when=VesselSetup.has_orders, provides=("Steering",))
def orders(setup: VesselSetup, autopilot: AutopilotNode, faults: FaultInjection) -> VesselOrders:
    from xitl_cli.run.nodes.vessel_orders import VesselOrders

    profile, commands = setup.profile, autopilot.new_commands()
    frame = local_frame(profile.site)
    vessel = VesselOrders(profile, commands, frame, faults, autopilot.driver, profile.ros.silent_s)
    autopilot.heard.subscribe(vessel.handle)
    return vessel


@part(Place.LINKS, when=VesselSetup.has_autopilot)
def links(setup: VesselSetup, agents: Agents, autopilot: AutopilotNode) -> LinkRecorder:
    clock = setup.profile.clock
    if clock.mode == "realtime":
        return LinkRecorder(clock, agents.all, autopilot.actuator_age)
    # In lockstep, the amount of data from a companion depends on the wall clock.
    return LinkRecorder(clock, agents.of_autopilot, None)


@part(Place.ESTIMATE_RATE, when=VesselSetup.asks_for_estimates)
def estimate_rate(setup: VesselSetup, autopilot: AutopilotNode) -> EstimateRate | None:
    from xitl_cli.run.nodes.companion import EstimateRate

    rate_hz = setup.profile.ros.estimate_rate_hz
    return EstimateRate(autopilot.new_commands(), rate_hz) if rate_hz else None


@part(Place.SENSORS, when=VesselSetup.records_sensors)
def sensors(setup: VesselSetup) -> SensorRecorder:
    plant = setup.plant
    air = lambda: plant.simulation.environment.wind  # noqa: E731
    together = plant if setup.in_fleet() else None
    return SensorRecorder(setup.profile, setup.seeds, plant.hulls, air, plant.tide_m, together)


@part(Place.ROS_COMPANION, when=VesselSetup.has_ros_companion)
def ros_companion(setup: VesselSetup, orders: VesselOrders) -> RosCompanionNode:
    from xitl_cli.run.nodes.companion import RosCompanionNode

    assert setup.profile.companion is not None
    return RosCompanionNode(setup.profile.companion, orders.asked_by)


@part()
def status(
    setup: VesselSetup, control: ControlNode, mission: MissionNode, agents: Agents, faults: FaultInjection | None
) -> StatusSource:
    in_force: Callable[[], tuple[str, ...]] = tuple if faults is None else faults.schedule.names_in_force
    return StatusSource(setup.profile, setup.plant, control, mission.score, agents.all, in_force)


@part(Place.COMMANDS, edges=(("PS1", "M"),))
def commands(setup: VesselSetup, control: ControlNode) -> CommandRecorder:
    return CommandRecorder(setup.profile, control)


@part(Place.MODEL_RANGE)
def model_range(setup: VesselSetup) -> ModelRange:
    return ModelRange(setup.plant)


@part(Place.TRACK, when=VesselSetup.in_fleet)
def track(control: ControlNode) -> TrackNode:
    return TrackNode(control)


@part()
def live_vessel(setup: VesselSetup, control: ControlNode, mission: MissionNode, status: StatusSource) -> LiveVessel:
    from xitl_cli.run.core.live_output import LiveVessel

    return LiveVessel(setup.profile, setup.plant, control, mission, status)


VESSEL_PARTS = (
    ais_line,
    bridge,
    autopilot,
    direct,
    adrift,
    operated,
    autopilot_events,
    companion,
    voice,
    ais_receiver,
    collisions,
    perception,
    findings,
    mission,
    agents,
    faults,
    orders,
    links,
    estimate_rate,
    sensors,
    ros_companion,
    status,
    commands,
    model_range,
    track,
    live_vessel,
)


def _plugin_parts(setup: VesselSetup) -> list[Part]:
    """Return the nodes of the plug-ins in the vessel's profile, in the order of the profile.

    Raises UserError for a plug-in that cannot be loaded, a topic that clashes, and an edge of an unknown node.
    """
    parts: list[Part] = []
    topics: list[Topic] = []
    for name, keys in setup.profile.plugins.items():
        if name not in names(NODES) and name in (setup.profile.driver.kind, *setup.profile.live.outputs):
            continue
        kind: NodeKind = load(NODES, name)
        for topic in kind.topics:
            try:
                check_added_topic(topic, topics)
            except UserError as error:
                raise UserError(f"plugins.{name} ({package_of(NODES, name)}): {error}") from error
            topics.append(topic)
        for end in chain.from_iterable(kind.edges):
            if not is_node_name(end):
                raise UserError(
                    f"plugins.{name} ({package_of(NODES, name)}): its edges name {end}, which is not a node of "
                    f"the graph; the nodes are {', '.join(architecture())}"
                )
        needs = (Need("control", "ControlNode"), *(Need(needed.__name__, needed.__name__) for needed in kind.needs))
        place = Place.PLUGINS if kind.place is None else kind.place
        make = partial(_plugin_node, setup, name, keys, kind)
        parts.append(Part(f"plugins.{name}", make, needs, place=place, edges=tuple(kind.edges)))
    return parts


def _plugin_node(
    setup: VesselSetup, name: str, keys: Any, kind: NodeKind, *, control: ControlNode, **needed: Any
) -> PluginNode:
    parts = {type_: needed[type_.__name__] for type_ in kind.needs}
    context = _node_context(setup, name, f"plugins.{name}", control, parts)
    return PluginNode(name, partial(kind.make, keys, context), kind.topics)


def _node_context(
    setup: VesselSetup, name: str, stream: str, control: ControlNode, parts: Mapping[type, Any]
) -> NodeContext:
    """Return the context of a plug-in's node. stream: of its random numbers."""
    from xitl_cli.run_kinds import NodeContext

    rng, run = default_rng(setup.seeds.sequence(stream)), setup.run
    url = run.stations.components_url
    return NodeContext(name, setup.profile, setup.plant, run.scenery, control, setup.seeds, rng, parts, url)


def _sensor_parts(setup: VesselSetup) -> list[Part]:
    """Return the nodes of sensors that plug-ins of xitl make: their keys are in `sensors`.

    Raises PluginError when such a plug-in is missing.
    """
    parts = []
    for name in SENSORS_OF_PLUGINS if setup.profile.sensors is not None else ():
        if keys := getattr(setup.profile.sensors, name):
            kind: NodeKind = load(SENSORS, name)
            make = partial(_sensor_node, setup, name, keys, kind)
            parts.append(Part(name, make, (Need("control", "ControlNode"),), place=Place.PERCEPTION))
    return parts


def _sensor_node(setup: VesselSetup, name: str, keys: Any, kind: NodeKind, *, control: ControlNode) -> RunNode:
    return kind.make(keys, _node_context(setup, name, name, control, {}))


def _live_part(output: LiveOutput) -> Part:
    return Part("live output", output.vessel_node, (Need("vessel", "LiveVessel"),), place=Place.LIVE_VESSEL)
