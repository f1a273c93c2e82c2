"""The whole profile, and the same with all that a run needs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from xitl_cli.errors import UserError
from xitl_cli.profile.schema.companion import Companion
from xitl_cli.profile.schema.derived_graph import complete_graph_group
from xitl_cli.profile.schema.environment import Environment
from xitl_cli.profile.schema.faults import Fault
from xitl_cli.profile.schema.graph import NodeGraph
from xitl_cli.profile.schema.group import Group
from xitl_cli.profile.schema.operation import Autopilot, Driver, Mission
from xitl_cli.profile.schema.place import Site, World
from xitl_cli.profile.schema.sensors import Sensors
from xitl_cli.profile.schema.session import Clock, Recording
from xitl_cli.profile.schema.vehicle import Vehicle

Technique = Literal["mitl", "sitl", "hitl", "huitl", "ritl", "syitl"]


class Profile(Group):
    """A profile; every group is optional, since a profile may be a part of others or describe a graph only."""

    name: str
    description: str = ""
    technique: Technique | None = None
    site: Site | None = None
    world: World | None = None
    vehicle: Vehicle | None = None
    environment: Environment | None = None
    sensors: Sensors | None = None
    mission: Mission | None = None
    driver: Driver | None = None
    autopilot: Autopilot | None = None
    companion: Companion | None = None
    clock: Clock | None = None
    recording: Recording | None = None
    faults: dict[str, Fault] | None = None
    graph: NodeGraph | None = None

    def missing_for_run(self) -> tuple[str, ...]:
        """The groups a run needs and this profile lacks."""
        needed = ["technique", "site", "vehicle", "environment", "mission", "driver", "autopilot"]
        if self.autopilot is not None and self.autopilot.kind != "none":
            needed.append("sensors")
        return tuple(group for group in needed if getattr(self, group) is None)

    def runnable(self) -> RunProfile:
        """The same profile with every group in place; UserError naming what is missing for a run."""
        missing, graph = self.missing_for_run(), complete_graph_group(self)
        if (
            missing
            or self.technique is None
            or self.site is None
            or self.vehicle is None
            or self.environment is None
            or self.mission is None
            or self.driver is None
            or self.autopilot is None
            or graph is None
        ):
            raise UserError(f"{self.name}: {self._lack(missing)}; `xitl profiles list` marks those that run")
        return RunProfile(
            name=self.name,
            description=self.description,
            technique=self.technique,
            site=self.site,
            world=self.world or World(),
            vehicle=self.vehicle,
            environment=self.environment,
            sensors=self.sensors,
            mission=self.mission,
            driver=self.driver,
            autopilot=self.autopilot,
            companion=self.companion,
            clock=self.clock or Clock(),
            recording=self.recording or Recording(),
            faults=self.faults or {},
            graph=graph,
        )

    def role(self) -> Literal["runs", "graph only", "part"]:
        """What the profile is good for: a run, its graph, or as a part of other profiles."""
        if not self.missing_for_run():
            return "runs"
        groups = set(type(self).model_fields) - {"name", "description", "technique"}
        present = {group for group in groups if getattr(self, group) is not None}
        return "graph only" if present == {"graph"} else "part"

    def _lack(self, missing: tuple[str, ...]) -> str:
        needs = ", ".join(missing)
        if self.role() == "graph only":
            return f"describes a graph only; `xitl wdri {self.name}` shows it, a run also needs {needs}"
        return f"is a part of a profile; a run also needs {needs}"


@dataclass(frozen=True, slots=True)
class RunProfile:
    """A profile that can run. `sensors` is None only where there is no autopilot to feed."""

    name: str
    description: str
    technique: Technique
    site: Site
    world: World
    vehicle: Vehicle
    environment: Environment
    sensors: Sensors | None
    mission: Mission
    driver: Driver
    autopilot: Autopilot
    companion: Companion | None
    clock: Clock
    recording: Recording
    faults: dict[str, Fault]
    graph: NodeGraph
