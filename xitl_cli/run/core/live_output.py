"""Live outputs: plug-ins that show a run in progress and may pass on commands of a person.

A run loads the outputs that its profile selects from the entry-point group `xitl.live_outputs` (nodes/plugin_nodes.py):

    output = factory(profiles)                   profiles: one a vessel
    output.vessel_node(LiveVessel(...))          once for each vessel
    output.world_nodes(LiveRun(...))             once, after the vessels
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.core.node import ControlNode, RunNode


@dataclass(frozen=True, slots=True)
class LiveVessel:
    """One vessel of a run, for the nodes that watch it."""

    profile: RunProfile
    plant: Any
    """Its view of the plant, `run.world.plant.PlantView`."""
    control: ControlNode
    mission: Any
    """The node of its mission score, `run.nodes.mission.MissionNode`."""
    status: Callable[[], Any]
    """Its status now, `run.nodes.display.RunStatus`."""


@dataclass(frozen=True, slots=True)
class LiveRun:
    """A whole run, for the nodes of the world."""

    plant: Any
    """The plant of all vessels, `run.world.plant.Plant`."""
    scene: Callable[[], bytes]
    """The recorded scene, an encoded Foxglove SceneUpdate."""
    tell: Callable[[str], None]
    """Prints a line for the user, such as the address of a page."""
    interrupted: Callable[[], bool]
    """Returns True when the user asked to stop."""


class LiveOutput:
    """One live output of one run. By default it adds no node."""

    def vessel_node(self, vessel: LiveVessel) -> RunNode | None:
        """The node that watches a vessel. It runs last of the vessel's nodes."""
        return None

    def world_nodes(self, run: LiveRun) -> Sequence[RunNode]:
        """Nodes that run after all vessels."""
        return ()
