"""Inputs from which the nodes of a run are made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sim_core.dataclass import dataclass
from sim_core.environment.tide import NO_TIDE
from sim_core.world.waterway import OPEN_WATER
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.links.agent_workers import AgentWorkers
from xitl_cli.run.nodes.display import StatusDisplay
from xitl_cli.run.nodes.stations import StationAddresses
from xitl_cli.run.operator.operation import Operation
from xitl_cli.run.traffic.self_report import VesselVoices
from xitl_cli.run.world.plant import Plant, PlantView
from xitl_cli.run.world.world import has_waterway
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

if TYPE_CHECKING:
    from xitl_cli.run.core.live_output import LiveOutput


@dataclass(frozen=True, slots=True)
class RunSetup:
    """A run, before its nodes are made."""

    profiles: Sequence[RunProfile]
    """One a vessel; the first has the keys of the world."""
    plant: Plant
    scenery: Scenery
    out: Path
    """Directory of the run."""
    operation: Operation
    stations: StationAddresses
    voices: VesselVoices
    """Reports of the vessels about themselves: position, readiness, end."""
    live: Sequence[LiveOutput]
    """Live outputs that the profile asks for."""
    workers: AgentWorkers | None
    """Processes for embedded autopilots, None if they run in this process."""
    make_display: Callable[[], StatusDisplay]
    scene: Callable[[], bytes]
    """Returns the recorded scene, an encoded Foxglove SceneUpdate."""
    tell: Callable[[str], None]
    """Prints a line for the user."""
    interrupted: Callable[[], bool]
    """Returns True when the user asked to stop."""

    @property
    def profile(self) -> RunProfile:
        """Profile of the first vessel."""
        return self.profiles[0]

    @property
    def seeds(self) -> Seeds:
        """Seeds of the world."""
        return Seeds(self.profile.clock.seed)

    def operated(self) -> bool:
        """Whether an operator may act during the run."""
        return self.operation.operated

    def has_river(self) -> bool:
        """Whether something may drift in the water."""
        return has_waterway(self.profile) or self.operated()

    def has_tide(self) -> bool:
        """Whether the water has a tide or a tidal stream."""
        return self.plant.simulation.environment.tide is not NO_TIDE

    def is_fleet(self) -> bool:
        """Whether the run has a fleet and its traffic."""
        return self.plant.fleet is not None

    def has_traffic(self) -> bool:
        """Whether there are scripted vessels."""
        return self.plant.fleet is not None and bool(self.plant.fleet.traffic)


@dataclass(frozen=True, slots=True)
class VesselSetup:
    """One vessel of a run, before its nodes are made."""

    run: RunSetup
    profile: RunProfile
    seeds: Seeds
    plant: PlantView
    """The vessel's view of the plant."""
    out: Path
    """Directory for the vessel's own files."""
    departs_after: tuple[str, ...] = ()
    """Names of the vessels that must be ready before this one departs."""

    def others(self) -> str:
        """Return the vessels that this one still waits for; empty when it may depart."""
        return self.run.voices.waited_for(self.departs_after)

    def has_autopilot(self) -> bool:
        """Whether an autopilot steers the vessel."""
        return self.profile.autopilot.kind != "none"

    def has_bridge(self) -> bool:
        """Whether another autopilot steers it than the embedded one."""
        return self.profile.autopilot.kind not in ("none", "embedded")

    def has_ais_line(self) -> bool:
        """Whether the autopilot of a fleet's vessel has a line for AIS: an ArduPilot with a known address for it."""
        autopilot = self.profile.autopilot
        if not self.in_fleet() or autopilot.kind != "ardupilot":
            return False
        return autopilot.ais_link is not None or (autopilot.started_here and autopilot.firmware_build == "sitl")

    def is_driven_by_nodes(self) -> bool:
        """Whether nodes of ROS command a vessel without an autopilot."""
        return not self.has_autopilot() and self.profile.driver.kind == "ros"

    def is_driven_directly(self) -> bool:
        """Whether a driver commands a vessel without an autopilot."""
        return not self.has_autopilot() and self.profile.driver.kind not in ("ros", "none")

    def is_adrift(self) -> bool:
        """Whether the vessel has neither an autopilot nor a driver."""
        return not self.has_autopilot() and self.profile.driver.kind == "none"

    def has_companion(self) -> bool:
        """Whether xitl's companion is next to the autopilot."""
        companion = self.profile.companion
        return self.has_autopilot() and companion is not None and companion.is_ours

    def has_ros_companion(self) -> bool:
        """Whether nodes of ROS take the place of the companion, and may give orders."""
        companion = self.profile.companion
        return self.has_orders() and companion is not None and not companion.is_ours

    def has_obstacles(self) -> bool:
        """Whether the vessel can collide with anything."""
        return self.plant.simulation.waterway is not OPEN_WATER or self.run.operated()

    def has_faults(self) -> bool:
        """Whether faults can occur."""
        return bool(self.profile.faults) or self.has_orders()

    def has_orders(self) -> bool:
        """Whether an operator may give orders to the autopilot."""
        return self.has_autopilot() and self.run.operated()

    def records_sensors(self) -> bool:
        """Whether sensors are simulated for ROS alone, as no autopilot gets their samples."""
        return not self.has_autopilot() and self.profile.sensors is not None and self.profile.ros.enabled

    def asks_for_estimates(self) -> bool:
        """Whether nodes of ROS may want estimates at another rate than the autopilot's own."""
        return self.has_autopilot() and not self.has_companion() and self.profile.ros.enabled

    def in_fleet(self) -> bool:
        """Whether the vessel has a name of its own in a fleet."""
        return bool(self.profile.vessel)


def is_awaited(profile: RunProfile) -> bool:
    """Whether the run waits for this vessel to finish. In a fleet, a vessel that follows or drifts never does."""
    driver, waypoints = profile.driver.kind, profile.mission.course_ned_m
    return not profile.vessel or (driver != "follow" and (driver != "none" or len(waypoints) > 0))
