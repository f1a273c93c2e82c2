"""The nodes of the world that the vessels share, of live outputs and of the operator. `Place` has their order."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from itertools import chain
from typing import TYPE_CHECKING, TypeVar

from sim_core.dataclass import dataclass
from xitl_cli.run.composition.parts import Need, Part, Parts, Place, made_parts, part
from xitl_cli.run.composition.setup import RunSetup
from xitl_cli.run.core.node import ControlNode, RunNode
from xitl_cli.run.nodes.display import DisplayNode, StatusSource
from xitl_cli.run.nodes.recorders import CommandRecorder, PaceRecorder, ScriptedRecorder, TruthRecorder
from xitl_cli.run.nodes.stations import StationAddresses
from xitl_cli.run.traffic.self_report import SelfReport, report_from_motion
from xitl_cli.run.world.plant import Plant

if TYPE_CHECKING:  # nodes that few runs have; the functions that make them import them
    from sim_core.world.traffic import ScriptedVessel
    from xitl_cli.run.nodes.ais import AisNode
    from xitl_cli.run.nodes.encounters import EncounterNode
    from xitl_cli.run.nodes.operator import OperatorNode
    from xitl_cli.run.nodes.river import RiverNode, TideNode

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class AllVessels:
    """Everything that was made for the vessels of a run."""

    parts: Mapping[str, Parts]
    """By the vessel's name, in the order of the run."""

    def having(self, kind: type[T]) -> Mapping[str, T]:
        """Return the object of this type of each vessel that has one, by the vessel's name."""
        made = {name: parts.get(kind) for name, parts in self.parts.items()}
        return {name: provided for name, provided in made.items() if provided is not None}


def world_parts(setup: RunSetup, vessels: Mapping[str, Parts], opened: ExitStack) -> Parts:
    """Make the nodes of the world; `opened` closes them. Raises UserError for a port that is not available."""
    declared = [*WORLD_PARTS]
    if setup.live:
        from xitl_cli.run.core.live_output import LiveRun

        live = LiveRun(setup.plant, setup.scene, setup.tell, setup.interrupted)
        for node in chain.from_iterable(output.world_nodes(live) for output in setup.live):
            opened.callback(node.close)
            declared.append(_live_part(node))
    return made_parts(declared, {RunSetup: setup, AllVessels: AllVessels(vessels)}, setup, opened)


@part(Place.DISPLAY, also_at={Place.SHOWING: "showing"})
def display(setup: RunSetup, vessels: AllVessels) -> DisplayNode:
    warnings = [*setup.scenery.warnings, *setup.stations.warnings]
    sources = list(vessels.having(StatusSource).values())
    return DisplayNode(setup.make_display, warnings, setup.profile.clock, sources)


@part(Place.RIVER, when=RunSetup.has_river, also_at={Place.LAUNCHING: "launching"})
def river(setup: RunSetup, vessels: AllVessels) -> RiverNode:
    from xitl_cli.run.nodes.river import river_from_profile

    control = vessels.parts[setup.profile.vessel].need(ControlNode)
    return river_from_profile(setup.profile, setup.seeds, setup.plant, lambda: control.progress)


@part(Place.OPERATOR, when=RunSetup.operated)
def operator(setup: RunSetup, vessels: AllVessels, river: RiverNode) -> OperatorNode:
    from xitl_cli.run.nodes.operator import OperatorNode
    from xitl_cli.run.nodes.vessel_orders import VesselOrders
    from xitl_cli.run.operator.environment_changes import EnvironmentChanges
    from xitl_cli.run.operator.steering import Steering

    changes = EnvironmentChanges(setup.plant, setup.profile.environment, setup.seeds)
    names = [profile.vessel for profile in setup.profiles]
    steering, orders = vessels.having(Steering), vessels.having(VesselOrders)
    node = OperatorNode(changes, river, names, steering, orders, setup.operation.events)
    for attend in setup.operation.people:
        attend(node)
    return node


@part(Place.TRUTH)
def truth(setup: RunSetup, vessels: AllVessels) -> TruthRecorder:
    return TruthRecorder(setup.profile, list(vessels.having(CommandRecorder).values()), setup.plant)


@part(Place.SCRIPTED_VESSELS, when=RunSetup.has_traffic)
def scripted_vessels(setup: RunSetup) -> ScriptedRecorder:
    clock, recording = setup.profile.clock, setup.profile.recording
    fleet = setup.plant.need_fleet()
    for vessel in fleet.traffic:
        setup.voices.add(vessel.name, partial(_scripted_report, setup.plant, vessel), lambda: False)
    return ScriptedRecorder(fleet, clock.physics_rate_hz, recording.truth_rate_hz, recording.scene)


@part(Place.AIS, when=RunSetup.is_fleet)
def ais(setup: RunSetup, vessels: AllVessels) -> AisNode:
    from xitl_cli.run.nodes.ais import AisNode, AisRecorder

    return AisNode(list(setup.profiles), setup.voices, vessels.having(AisRecorder))


@part(Place.ENCOUNTERS, when=RunSetup.is_fleet)
def encounters(setup: RunSetup) -> EncounterNode:
    from xitl_cli.run.nodes.encounters import EncounterNode

    profile = setup.profile
    distance_m, rate_hz = profile.world.encounter_distance_m, profile.clock.physics_rate_hz
    return EncounterNode(setup.plant, setup.plant.need_fleet(), distance_m, rate_hz)


@part(Place.TIDE, when=RunSetup.has_tide)
def tide(setup: RunSetup) -> TideNode:
    from xitl_cli.run.nodes.river import TideNode

    return TideNode(setup.profiles, setup.plant)


@part(Place.PACE)
def pace(setup: RunSetup) -> PaceRecorder:
    return PaceRecorder(setup.profile.clock)


@part(Place.STATIONS)
def stations(setup: RunSetup) -> StationAddresses:
    return setup.stations


WORLD_PARTS = (display, river, operator, truth, scripted_vessels, ais, encounters, tide, pace, stations)


def _live_part(node: RunNode) -> Part:
    return Part(
        "live output", partial(_attached, node), (Need("operator", "OperatorNode", optional=True),), place=Place.LIVE
    )


def _attached(node: RunNode, operator: OperatorNode | None) -> RunNode:
    if operator is not None:
        node.attach_operator(operator)
    return node


def _scripted_report(plant: Plant, vessel: ScriptedVessel) -> SelfReport:
    from sim_core.world.traffic import scripted_motion

    now_ns, tide_m = plant.state.time_ns, plant.vessels[0].tide_m()
    return report_from_motion(now_ns, scripted_motion([vessel], now_ns * 1e-9, tide_m))
