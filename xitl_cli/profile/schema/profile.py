"""The whole profile, its groups that are small, and the same profile with everything that a run needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, fields, is_dataclass, replace
from typing import Annotated, Any, Literal

from sim_core.dataclass import dataclass
from sim_core.environment.spec import EnvironmentSpec
from sim_core.keys import Bounds, IfGiven, MoreChoices, Positive, RateHz, Seed, Specification
from sim_core.vessel.actuators import ActuatorSpec
from sim_core.vessel.spec import VesselSpec
from sim_core.world.spec import AIS_NAME, FLEET_MMSI, SCRIPTED_MMSI, AisSpec, TrafficSpec
from xitl_cli.errors import UserError
from xitl_cli.profile.schema.agents import AutopilotSpec, CompanionSpec, DriverSpec, MissionSpec
from xitl_cli.profile.schema.derived_graph import complete_graph_group
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.profile.schema.graph import NodeGraph
from xitl_cli.profile.schema.ros import RosSpec
from xitl_cli.profile.schema.sensors import SensorsSpec
from xitl_cli.profile.schema.world import SiteSpec, WorldSpec
from xitl_cli.registry import DRIVERS, LIVE_OUTPUTS, NODES, PluginError, load, names, package_of


@dataclass(frozen=True, slots=True)
class GroupsByName:
    """Marks a key with groups whose class depends on the name of the group."""

    group: Callable[[str], type]
    """Returns the class of a name. Raises UserError, whose sentence begins with the name, without a class."""


def plugin_keys(name: str) -> type[Any]:
    """Return the keys of a plug-in's node, driver or live output. Raises PluginError for a missing or unusable one."""
    if name not in names(NODES):
        for registry, role in ((DRIVERS, "driver"), (LIVE_OUTPUTS, "live output")):
            if name in names(registry):
                keys = getattr(load(registry, name), "keys", None)
                if isinstance(keys, type) and is_dataclass(keys):
                    return keys
                raise PluginError(f"{name}: the {role} of {package_of(registry, name)} has no keys; remove the group")
    kind = load(NODES, name)
    if not (hasattr(kind, "keys") and hasattr(kind, "make") and hasattr(kind, "topics")):
        problem = f"registers {type(kind).__name__} in {NODES}, which is not xitl_cli.plugin.NodeKind"
    elif not (isinstance(kind.keys, type) and is_dataclass(kind.keys)):
        problem = f"has a NodeKind whose keys are not a dataclass: {kind.keys!r}"
    else:
        return kind.keys
    raise PluginError(f"{name}: the plug-in of {package_of(NODES, name)} {problem}; correct it")


def registered_keys(registry: str, name: str, kind: str) -> type[Any]:
    """Return the keys of `kind`, which a package registers in the group `registry` for `vehicle.actuators.NAME`.

    Raises PluginError for a missing or unusable package.
    """
    keys = load(registry, kind)
    if isinstance(keys, type) and issubclass(keys, ActuatorSpec) and is_dataclass(keys):
        return keys
    shown = keys.__name__ if isinstance(keys, type) else type(keys).__name__
    raise PluginError(
        f"{kind}: the plug-in of {package_of(registry, kind)} registers {shown} in {registry}, which is not a "
        "dataclass that derives from sim_core.vessel.actuators.ActuatorSpec; correct it"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewSpec(Specification):
    """The 3D view in a browser during a run; this group enables it."""

    show: Annotated[bool, "`--view` and `--no-view` do the same for one run"] = True
    host: Annotated[str, "address to listen on; the printed address has a token"] = "127.0.0.1"
    port: Annotated[Annotated[int, Bounds(at_least=1, at_most=65535)] | None, "null: 8470, or the next free port"] = (
        None
    )
    open: Annotated[bool | None, "opens this machine's browser; null: on a desktop with an interactive terminal"] = None
    pace: Annotated[
        Positive | None, "times real time, in lockstep, while a viewer is connected; null: as fast as possible"
    ] = 1.0
    rate_hz: Annotated[
        Annotated[float, Bounds(at_least=1, at_most=60)], "largest number of pictures per second of wall clock"
    ] = 20.0
    dark: Annotated[bool, "night; every viewer can change it"] = False
    map: Annotated[
        str | None, "map on the water: GeoJSON, MBTiles, or a folder of tiles {z}/{x}/{y}.png: [view.md](view.md#maps)"
    ] = None


OWN_LIVE_GROUPS = ("view", "ros")
"""Outputs of xitl that have their own group in a profile."""


def added_live_outputs() -> list[str]:
    """Return the names for `live.outputs`: all registered outputs without their own group."""
    return [name for name in names(LIVE_OUTPUTS) if name not in OWN_LIVE_GROUPS]


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveSpec(Specification):
    """The recorded topics, served to Foxglove during a run: [view.md](view.md). Other outputs by name."""

    foxglove: Annotated[
        bool | None, "`--live foxglove` does the same for one run; null: true, or false if `outputs` has names"
    ] = None
    outputs: Annotated[
        tuple[Annotated[Literal["foxglove"], MoreChoices(added_live_outputs)], ...],
        "live outputs of packages, by name: [plugins.md](plugins.md#a-live-output); `--live NAME` does the same",
    ] = ()
    port: Annotated[
        Annotated[int, Bounds(at_least=1, at_most=65535)] | None,
        "port of this machine, 127.0.0.1; null: 8765, or the next free port",
    ] = None
    commands: Annotated[bool, "clients may act, as with `--live-commands`; otherwise they can only read"] = False

    @property
    def streams_foxglove(self) -> bool:
        """Whether the run streams to Foxglove."""
        return not self.outputs if self.foxglove is None else self.foxglove


USUAL = "udp://127.0.0.1:14550", 5760
"""Address at which ground stations listen (UDP), and the port where they search a simulated vehicle (TCP)."""
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
class SplitSpec(Specification):
    """When the recording continues in a next file: at the first limit that is reached."""

    size_mb: Annotated[
        float | None,
        Bounds(at_least=0.1),
        "largest size of a file's messages before compression, in 10^6 bytes; null: no such limit",
    ] = None
    time_s: Annotated[
        float | None, Bounds(at_least=1), "simulation time from the beginning of a file; null: no such limit"
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSpec(Specification):
    """Contents of the recording."""

    compression: Literal["lz4", "zstd", "none"] = "lz4"
    truth_rate_hz: RateHz = 50.0
    scene: Annotated[bool, "a drawing of the surroundings"] = True
    dataflash: Annotated[bool, "the autopilot's own log"] = True
    split: Annotated[SplitSpec | None, "several files: [recording.md](recording.md#split-recordings)", IfGiven()] = None


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
        "nodes of other packages, by the name of the plug-in: [plugins.md](plugins.md); the package defines their "
        "keys; null removes an inherited node",
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
        """Return the simulated vessels by name; without `vessels`, a single one with the name ""."""
        if self.vessels is None:
            return {"": self}
        return {name: vessel for name, vessel in self.vessels.items() if vessel.traffic is None}

    @property
    def one_a_vehicle(self) -> list[Profile]:
        """Return the first vessel of each vehicle: a single vessel if all have the same vehicle."""
        first: list[Profile] = []
        for vessel in self.sailed.values():
            if all(vessel.vehicle != other.vehicle for other in first):
                first.append(vessel)
        return first

    def vessel(self, name: str) -> Profile:
        """Return one of `sailed`. Raises UserError for an unknown name."""
        if self.vessels is None:
            raise UserError(f"{self.name}: has a single vessel without a name; remove the name")
        if name not in self.sailed:
            hint = ", ".join([*self.sailed][:8]) + (" ..." if len(self.sailed) > 8 else "")
            problem = "is scripted" if name in self.vessels else "is not one of its vessels"
            raise UserError(f"{self.name}: {name!r} {problem}; use {hint}")
        return self.sailed[name]

    def missing_for_run(self) -> tuple[str, ...]:
        """Return the groups that a run needs and this profile does not have."""
        if self.vessels is not None:
            return tuple(dict.fromkeys(group for own in self.sailed.values() for group in own.missing_for_run()))
        needed = ["technique", "site", "vehicle", "environment", "mission", "driver", "autopilot"]
        if self.autopilot is not None and self.autopilot.kind != "none":
            needed.append("sensors")
        return tuple(group for group in needed if getattr(self, group) is None)

    def run_profiles(self) -> tuple[RunProfile, ...]:
        """Return each simulated vessel as a profile with every group, in their order: at least one.

        Site, world, environment, clock, recording, view, ros and traffic are the same in all. Raises UserError as
        `runnable` does.
        """
        if self.vessels is None:
            return (self.runnable(),)
        scripted = {name: vessel.traffic for name, vessel in self.vessels.items() if vessel.traffic is not None}
        traffic = {
            name: replace(spec, ais=_complete_ais(spec.ais, name, SCRIPTED_MMSI + number))
            for number, (name, spec) in enumerate(scripted.items(), start=1)
        }
        return tuple(vessel._run_profile(name, traffic) for name, vessel in self.sailed.items())

    def runnable(self) -> RunProfile:
        """Return the same profile with every group. Raises UserError for missing groups, and for several vessels."""
        if self.vessels is not None:
            raise UserError(f"{self.name}: has several vessels ({', '.join(self.sailed)}); use a profile with one")
        return self._run_profile("", {})

    def _run_profile(self, vessel: str, traffic: dict[str, TrafficSpec]) -> RunProfile:
        missing, graph = self.missing_for_run(), complete_graph_group(self)
        if missing or graph is None:
            problem = "is a part of a profile"
            if self.role() == "graph only":
                problem = f"describes only a graph (see `xitl wdri {self.name}`)"
            needs = f"a run also needs {', '.join(missing)}"
            raise UserError(f"{self.name}: {problem}; {needs}; `xitl profiles list` marks the profiles that can run")
        groups = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "vessels"} | {
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
            groups[group] = groups[group] or default()
        name, mmsi = vessel or groups["vehicle"].name, FLEET_MMSI + groups["autopilot"].system_id
        return RunProfile(**groups | {"ais": _complete_ais(self.ais or AisSpec(), name, mmsi)})

    def role(self) -> Literal["runs", "graph only", "part"]:
        """Use of the profile: for a run, for its graph, or as a part of other profiles."""
        if not self.missing_for_run():
            return "runs"
        groups = {field.name for field in fields(self)} - {"name", "description", "technique"}
        present = {group for group in groups if getattr(self, group) is not None}
        return "graph only" if present == {"graph"} else "part"


@dataclass(frozen=True, slots=True)
class RunProfile:
    """A profile that can run, or one vessel of it."""

    name: str
    description: str
    technique: Technique
    site: SiteSpec
    world: WorldSpec
    vehicle: VesselSpec
    environment: EnvironmentSpec
    sensors: SensorsSpec | None
    """None only without an autopilot."""
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
    """With name and MMSI."""
    vessel: str = ""
    """Name of the vessel; empty for a single vessel."""
    traffic: dict[str, TrafficSpec] = field(default_factory=dict)
    """Scripted vessels in its water, by name."""


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
