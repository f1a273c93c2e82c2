"""Declarations of nodes, drivers and live outputs, which plug-ins import from `xitl_cli.plugin`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import TYPE_CHECKING, Any

from sim_core.dataclass import dataclass

if TYPE_CHECKING:
    from numpy.random import Generator

    from sim_core.geodesy import LocalFrame
    from xitl_cli.graph.graph import Edge
    from xitl_cli.profile.schema import RunProfile
    from xitl_cli.record.topics import Topic
    from xitl_cli.run.composition.parts import Place
    from xitl_cli.run.core.node import ControlNode, RunNode
    from xitl_cli.run.links.autopilot_commands import AutopilotCommands
    from xitl_cli.run.traffic.self_report import VesselVoices
    from xitl_cli.run.world.plant import PlantView
    from xitl_cli.scenery import Scenery
    from xitl_cli.seeds import Seeds

__all__ = ["DriverContext", "DriverKind", "LiveOutputKind", "NodeContext", "NodeKind"]


@dataclass(frozen=True, slots=True)
class NodeContext:
    """The vessel and the world of a node of a plug-in. Frames are NED and FRD, as everywhere inside xitl."""

    name: str
    """Name of the plug-in: the key below `plugins` of the profile."""

    profile: RunProfile
    """Profile of the vessel; `profile.vessel` is its name, empty where there is one vessel."""

    plant: PlantView
    """The world as this vessel meets it. `state` and `motion()` are of the latest physics step."""

    scenery: Scenery
    """Objects that do not move: bed, banks, log boom, dam, buildings."""

    control: ControlNode
    """The node whose motor commands move the vessel: `command`, `progress`."""

    seeds: Seeds
    """Seeds of the vessel, for a node that needs several independent streams."""

    rng: Generator
    """Random generator of this node. It depends on `clock.seed`, the vessel and the name of the plug-in alone."""

    parts: Mapping[type, Any] = field(default_factory=dict)
    """The objects that `NodeKind.needs` asks for, by type."""

    components_url: str = ""
    """Address at which MAVLink components of the vessel, such as cameras, reach its ground stations. Open a `Link`
    there with `profile.autopilot.system_id` and another component than the autopilot. Empty without ground stations."""


@dataclass(frozen=True, slots=True)
class NodeKind:
    """A kind of node of a run, under the name of its entry point (group `xitl.nodes`).

    A vessel has the node when its profile has the group `plugins.NAME`.
    """

    keys: type
    """Keys of the profile below `plugins.NAME`: a frozen dataclass that derives from `sim_core.keys.Specification`."""

    make: Callable[[Any, NodeContext], RunNode]
    """`make(keys, context)` returns the node of one vessel. Raises UserError when the run cannot have it."""

    topics: Sequence[Topic] = ()
    """Topics that the node records. With several vessels, the vessel's name is in front of each name."""

    needs: Sequence[type] = ()
    """Other nodes of the vessel that `make` finds in `NodeContext.parts`, such as `AutopilotNode`. A run without one of
    them is refused."""

    edges: Sequence[Edge] = ()
    """Links that the node adds to the graph of each run that has it, by the names of the graph's nodes:
    `("PS1", "M")`."""

    place: Place | None = None
    """Place of the node in a step, None for the usual one: after the mission's score, before the live outputs."""


@dataclass(frozen=True, slots=True)
class DriverContext:
    """The autopilot that a driver commands, and the run around it."""

    profile: RunProfile
    """Profile of the vessel; `profile.vessel` is its name, empty where there is one vessel."""

    commands: AutopilotCommands
    """Sends commands to the autopilot; `commands.view` has its state: mode, armed, waypoints reached, texts."""

    frame: LocalFrame
    """The local frame: NED in metres about the site."""

    keys: Any = None
    """Keys of the profile below `plugins.NAME`, None for a driver of xitl, whose keys are in `driver`."""

    ground_stations: tuple[str, ...] = ()
    """Addresses at which ground stations may connect."""

    others: Callable[[], str] = lambda: ""
    """Returns a text with the vessels to wait for, empty when this vessel may set out."""

    voices: VesselVoices | None = None
    """Reports of all vessels of a fleet, None outside of a run."""


@dataclass(frozen=True, slots=True)
class DriverKind:
    """A kind of driver, under the name of its entry point (group `xitl.drivers`).

    A vessel with an autopilot has the driver when its profile says `driver.kind: NAME`.
    """

    make: Callable[[DriverContext], Any]
    """`make(context)` returns the `xitl_cli.run.nodes.drivers.VehicleDriver` of one vessel.

    Raises UserError when the run cannot have it.
    """

    keys: type | None = None
    """Keys of the profile below `plugins.NAME`: a frozen dataclass that derives from `sim_core.keys.Specification`. If
    the profile has no such group, all keys have their default values."""


@dataclass(frozen=True, slots=True)
class LiveOutputKind:
    """A kind of live output, under the name of its entry point (group `xitl.live_outputs`).

    A run has the output when its profile says `live.outputs: [NAME]`, or with `--live NAME`.
    """

    make: Callable[[Sequence[RunProfile], Any], Any]
    """`make(profiles, keys)` returns the `xitl_cli.run.core.live_output.LiveOutput` of one run.

    profiles: one for each vessel. Raises UserError when the run cannot have it.
    """

    keys: type | None = None
    """Keys of the profile below `plugins.NAME`, as `DriverKind.keys`."""
