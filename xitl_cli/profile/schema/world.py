"""`site` and `world`: the local origin, the structures around it and the drifting bodies."""

from __future__ import annotations

from typing import Annotated, get_args

from sim_core.dataclass import dataclass
from sim_core.keys import (
    AmongVessels,
    Bounds,
    Direction,
    IfGiven,
    Items,
    NonNegative,
    Place,
    Positive,
    Share,
    Specification,
    SpecificationError,
    Vector,
)
from sim_core.world.spec import (
    BuildingSpec,
    BuoySpec,
    DamSpec,
    DebrisName,
    LogBoomSpec,
    MeshFileSpec,
    RiverSpec,
    ShoalSpec,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SiteSpec(Specification):
    """The local origin on the Earth."""

    name: str
    latitude_deg: Annotated[float, Bounds(at_least=-90, at_most=90)]
    longitude_deg: Annotated[float, Bounds(at_least=-180, at_most=180)]
    altitude_m: Annotated[float, Bounds(at_least=-500, at_most=9000)]
    magnetic_field_ned_gauss: Annotated[Vector | None, "null: the world magnetic model of `year`"] = None
    year: Annotated[float, Bounds(at_least=1980, at_most=2100)] = 2026.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchSpec(Specification):
    """One body that is launched into the water."""

    at_s: Annotated[NonNegative, "simulation time"] = 0.0
    kind: DebrisName = "trunk"
    pos_ned_m: Annotated[Place, "position, north and east"]
    heading_deg: Direction = 0.0
    length_m: Annotated[
        Annotated[float, Bounds(at_least=0.1, at_most=50)] | None, "null: the usual size of its kind"
    ] = None
    windage: Annotated[
        Share | None, "leeway as a share of the wind at 10 m; null: by its shape above and below water"
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EncountersSpec(Specification):
    """Bodies with kinds, sizes, positions and instants drawn from the run's seed.

    Each is launched so that it drifts onto the mission's legs when the vessel is expected there at
    `mission.speed_mps`.
    """

    count: Annotated[int, Bounds(at_least=0, at_most=200)] = 0
    kinds: tuple[DebrisName, ...] = ("trunk", "branch", "plants", "animal")
    ahead_m: Annotated[
        tuple[Positive, Positive], "smallest and largest distance of the vessel from the encounter at the launch"
    ] = (40.0, 60.0)
    off_m: Annotated[NonNegative, "largest distance by which it may miss the leg"] = 1.0

    def check(self) -> None:
        if self.count and not self.kinds:
            raise SpecificationError(
                ("kinds",), f"is empty; add one of {', '.join(get_args(DebrisName))}, or set count: 0"
            )
        if self.ahead_m[0] > self.ahead_m[1]:
            raise SpecificationError(
                ("ahead_m",), f"= {list(self.ahead_m)} is from far to near; write the nearer first"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class DebrisSpec(Specification):
    """Drifting bodies: single launches, and random encounters."""

    launches: tuple[LaunchSpec, ...] = ()
    encounters: EncountersSpec = EncountersSpec()
    control: Annotated[
        str | None, "address that receives `xitl world launch`, such as `udp://127.0.0.1:14670`; null: none"
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AisRadioSpec(Specification):
    """Range of AIS between vessels, and the share of lost transmissions."""

    range_m: Annotated[Positive, "20 nautical miles, as between ships"] = 37_040.0
    loss: Annotated[Share, "share of lost transmissions, at each receiver"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldSpec(Specification):
    """Structures in the river, drawn in the recording and seen by lidar, sonar and range sensors."""

    log_boom: LogBoomSpec | None = None
    dam: DamSpec | None = None
    river: RiverSpec | None = None
    shoals: tuple[ShoalSpec, ...] = ()
    buildings: tuple[BuildingSpec, ...] = ()
    meshes: tuple[MeshFileSpec, ...] = ()
    contact: Annotated[bool, "the vessel collides with the structures; it collides with debris in any case"] = False
    debris: DebrisSpec = DebrisSpec()
    buoys: Annotated[tuple[BuoySpec, ...], Items(0, 200), IfGiven()] = ()
    encounter_distance_m: Annotated[
        Positive, AmongVessels(), "vessels with hulls nearer than this count as too close"
    ] = 10.0
    ais: Annotated[AisRadioSpec, AmongVessels()] = AisRadioSpec()
