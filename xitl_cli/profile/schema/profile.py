"""The whole profile, and the same with all that a run needs."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, Literal

from sim_core.environment.spec import EnvironmentSpec
from sim_core.keys import Bounds, Positive, RateHz, Seed, Specification
from sim_core.vessel.spec import VesselSpec
from sim_core.world.spec import AIS_NAME, FLEET_MMSI, SCRIPTED_MMSI, AisSpec, TrafficSpec
from xitl_cli.errors import UserError
from xitl_cli.profile.schema.agents import AutopilotSpec, CompanionSpec, DriverSpec, MissionSpec
from xitl_cli.profile.schema.derived_graph import complete_graph_group
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.profile.schema.graph import NodeGraph
from xitl_cli.profile.schema.live import LiveSpec
from xitl_cli.profile.schema.plugins import GroupsByName, plugin_keys
from xitl_cli.profile.schema.ros import RosSpec
from xitl_cli.profile.schema.sensors import SensorsSpec
from xitl_cli.profile.schema.view import ViewSpec
from xitl_cli.profile.schema.world import SiteSpec, WorldSpec

USUAL = "udp://127.0.0.1:14550", 5760
"""Where ground stations listen (UDP), and the port at which they look for a simulated vehicle (TCP)."""
Technique = Literal["mitl", "sitl", "hitl", "huitl", "ritl", "syitl"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockSpec(Specification):
    """Simulation time of a run."""

    mode: Annotated[
        Literal["lockstep", "realtime"],
        "lockstep: as fast as possible; with the embedded autopilot a seed repeats every message; "
        "realtime: by the wall clock",
    ] = "lockstep"
    physics_rate_hz: Annotated[RateHz, "every other rate must divide it"] = 400.0
    exchange_rate_hz: Annotated[RateHz, "rate of commands from the autopilot"] = 50.0
    duration_s: Annotated[
        Positive, "largest duration, from the start; it includes the time for which the vessel is frozen"
    ] = 600.0
    seed: Annotated[Seed, Bounds(below=2**63), "seed of all random values"] = 1
    on_loss: Annotated[
        Literal["end", "drift", "continue"],
        "with `vessels`, after the autopilot of one vessel is lost: end the run; let that vessel drift with its "
        "motors stopped; or continue its last motor commands. The other vessels continue until all are lost",
    ] = "end"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSpec(Specification):
    """Contents of the recording."""

    compression: Literal["lz4", "zstd", "none"] = "lz4"
    truth_rate_hz: RateHz = 50.0
    scene: Annotated[bool, "a drawing of the surroundings"] = True
    dataflash: Annotated[bool, "the autopilot's own log"] = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile(Specification):
    """A profile; every group is optional, because a profile may be a part of others or describe only a graph."""

    name: Annotated[str, "name of the profile; if it is missing, the name of the file"]
    description: str = ""
    technique: Technique | None = None
    site: SiteSpec | None = None
    world: WorldSpec | None = None
    vehicle: VesselSpec | None = None
    environment: EnvironmentSpec | None = None
    sensors: SensorsSpec | None = None
    mission: MissionSpec | None = None
    driver: DriverSpec | None = None
    autopilot: AutopilotSpec | None = None
    companion: CompanionSpec | None = None
    clock: ClockSpec | None = None
    recording: RecordingSpec | None = None
    view: ViewSpec | None = None
    live: LiveSpec | None = None
    ros: RosSpec | None = None
    faults: Annotated[dict[str, FaultSpec] | None, "by name"] = None
    plugins: Annotated[
        dict[str, Any] | None,
        GroupsByName(plugin_keys),
        "nodes of other packages, by the name of the plug-in: [plugins.md](plugins.md); the package has their keys; "
        "null removes one that is inherited",
    ] = None
    graph: NodeGraph | None = None
    ais: AisSpec | None = None
    vessels: Annotated[
        dict[str, Profile] | None,
        "several vessels in one water, by name: [fleets.md](fleets.md); their own keys are below",
    ] = None
    traffic: Annotated[TrafficSpec | None, "for one of `vessels`: the vessel is scripted and has no other group"] = None

    @property
    def sailed(self) -> dict[str, Profile]:
        """The vessels that are simulated, by name: without `vessels` the one there is, called ""."""
        if self.vessels is None:
            return {"": self}
        return {name: vessel for name, vessel in self.vessels.items() if vessel.traffic is None}

    @property
    def one_a_vehicle(self) -> list[Profile]:
        """The first vessel of each vehicle: one, where all have the same."""
        found: list[Profile] = []
        for vessel in self.sailed.values():
            if all(vessel.vehicle != other.vehicle for other in found):
                found.append(vessel)
        return found

    def vessel(self, name: str) -> Profile:
        """One of `sailed`; UserError for a name that is none."""
        if self.vessels is None:
            raise UserError(f"{self.name}: has one vessel, without a name; leave the name out")
        if name not in self.sailed:
            hint = ", ".join([*self.sailed][:8]) + (" ..." if len(self.sailed) > 8 else "")
            scripted = "is scripted" if name in self.vessels else "is none of its vessels"
            raise UserError(f"{self.name}: {name!r} {scripted}; use {hint}")
        return self.sailed[name]

    def missing_for_run(self) -> tuple[str, ...]:
        """The groups a run needs and this profile lacks."""
        if self.vessels is not None:
            return tuple(dict.fromkeys(group for one in self.sailed.values() for group in one.missing_for_run()))
        needed = ["technique", "site", "vehicle", "environment", "mission", "driver", "autopilot"]
        if self.autopilot is not None and self.autopilot.kind != "none":
            needed.append("sensors")
        return tuple(group for group in needed if getattr(self, group) is None)

    def run_profiles(self) -> tuple[RunProfile, ...]:
        """Each vessel that is simulated as a profile with every group in place, in their order: at least one.

        Site, world, environment, clock, recording, view, ros and traffic are the same in all. UserError as of
        `runnable`.
        """
        if self.vessels is None:
            return (self.runnable(),)
        scripted = {name: one.traffic for name, one in self.vessels.items() if one.traffic is not None}
        traffic = {
            name: replace(one, ais=_complete_ais(one.ais, name, SCRIPTED_MMSI + number))
            for number, (name, one) in enumerate(scripted.items(), start=1)
        }
        return tuple(vessel._run_profile(name, traffic) for name, vessel in self.sailed.items())

    def runnable(self) -> RunProfile:
        """The same profile with every group in place; UserError naming what is missing for a run.

        Of one vessel: UserError where there are several.
        """
        if self.vessels is not None:
            raise UserError(f"{self.name}: has several vessels ({', '.join(self.sailed)}), and this is for one")
        return self._run_profile("", {})

    def _run_profile(self, vessel: str, traffic: dict[str, TrafficSpec]) -> RunProfile:
        missing, graph = self.missing_for_run(), complete_graph_group(self)
        if missing or graph is None:
            needs = ", ".join(missing)
            what = f"is a part of a profile; a run also needs {needs}"
            if self.role() == "graph only":
                what = f"describes a graph only; `xitl wdri {self.name}` shows it, a run also needs {needs}"
            raise UserError(f"{self.name}: {what}; `xitl profiles list` marks those that run")
        given = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "vessels"} | {
            "graph": graph,
            "vessel": vessel,
            "traffic": traffic,
        }
        for group, default in (
            ("world", WorldSpec),
            ("clock", ClockSpec),
            ("recording", RecordingSpec),
            ("view", lambda: ViewSpec(show=False)),
            ("live", lambda: LiveSpec(foxglove=False)),
            ("ros", lambda: RosSpec(enabled=False)),
            ("faults", dict),
            ("plugins", dict),
        ):
            given[group] = given[group] or default()
        called, number = vessel or given["vehicle"].name, FLEET_MMSI + given["autopilot"].system_id
        return RunProfile(**given | {"ais": _complete_ais(self.ais or AisSpec(), called, number)})

    def role(self) -> Literal["runs", "graph only", "part"]:
        """Use of the profile: for a run, for its graph, or as a part of other profiles."""
        if not self.missing_for_run():
            return "runs"
        groups = {field.name for field in fields(self)} - {"name", "description", "technique"}
        present = {group for group in groups if getattr(self, group) is not None}
        return "graph only" if present == {"graph"} else "part"


@dataclass(frozen=True, slots=True)
class RunProfile:
    """A profile that can run, or one vessel of it. `sensors` is None only where there is no autopilot to feed.

    vessel: its name, empty where there is one alone. traffic: the scripted vessels in its water, by name. Here `ais`
    has name and MMSI.
    """

    name: str
    description: str
    technique: Technique
    site: SiteSpec
    world: WorldSpec
    vehicle: VesselSpec
    environment: EnvironmentSpec
    sensors: SensorsSpec | None
    mission: MissionSpec
    driver: DriverSpec
    autopilot: AutopilotSpec
    companion: CompanionSpec | None
    clock: ClockSpec
    recording: RecordingSpec
    view: ViewSpec
    live: LiveSpec
    ros: RosSpec
    faults: dict[str, FaultSpec]
    plugins: dict[str, Any]
    graph: NodeGraph
    ais: AisSpec
    vessel: str = ""
    traffic: dict[str, TrafficSpec] = field(default_factory=dict)


def _complete_ais(ais: AisSpec, name: str, mmsi: int) -> AisSpec:
    return replace(ais, name=ais.name or name[:AIS_NAME], mmsi=ais.mmsi or mmsi)


def ground_stations_of(profile: Profile | RunProfile) -> tuple[str, ...]:
    """Return the ground station addresses of the autopilot. They are empty on a board: its command line has them."""
    autopilot = profile.autopilot
    if autopilot is None or autopilot.kind == "none" or autopilot.runs == "board":
        return ()
    if autopilot.ground_stations is not None:
        return autopilot.ground_stations
    if profile.clock is None or profile.clock.mode != "realtime":
        return ()
    return USUAL[0], f"tcp://{autopilot.ground_station_interface}:{USUAL[1]}"
