"""From the profile to the simulated world: the vessel in its environment, the fixed objects, and the debris.

For contact, a dam is its bounding box, boom and buildings are their plans, and all else is its visible triangles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.random import default_rng

from sim_core import fleet as fleets
from sim_core.environment.environment import Environment
from sim_core.environment.tide import make_tide
from sim_core.fleet import Fleet, FleetState
from sim_core.frames import Array
from sim_core.geodesy import LocalFrame
from sim_core.sensors.magnetometer import local_field_ned_gauss
from sim_core.simulation import Simulation, SimulationState, initial
from sim_core.world.debris import BodyKind, BuoyForm, Launch
from sim_core.world.mesh_contact import NO_TRIANGLES, Triangles
from sim_core.world.plan import Capsules, box_capsules
from sim_core.world.spec import BuoySpec
from sim_core.world.structures import NEAR_SURFACE_M
from sim_core.world.traffic import ScriptedVessel
from sim_core.world.waterway import OPEN_WATER, Waterway
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.world import LaunchSpec, SiteSpec
from xitl_cli.run.world.plant import Plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds


def build_plant(profiles: Sequence[RunProfile], seeds: Seeds, scenery: Scenery) -> Plant:
    """Return the world at time 0 with a vessel for each profile, at rest at its mission's start.

    The world is that of the first profile.

    seeds: of the water, without a vessel's name.

    Raises UserError when a model refuses a value that passed the profile's checks.
    """
    drawn = default_rng(seeds.sequence("environment"))
    if len(profiles) == 1 and not profiles[0].traffic:
        return Plant(*build_simulation(profiles[0], seeds, scenery), drawn)
    return Plant(*build_fleet(profiles, seeds, scenery), drawn)


def build_simulation(
    profile: RunProfile, seeds: Seeds, scenery: Scenery | None = None
) -> tuple[Simulation, SimulationState]:
    """Return the world at time 0 with one vessel. Raises UserError as `build_plant`."""
    try:
        water = _water(profile, seeds, scenery)
        simulation = Simulation.from_spec(profile.vehicle, *water)
    except ValueError as error:
        raise UserError(f"{profile.name}: {error}") from error
    return simulation, initial(simulation, *_starts([profile]), default_rng(seeds.sequence(_AT_START)))


def build_fleet(
    profiles: Sequence[RunProfile], seeds: Seeds, scenery: Scenery | None = None
) -> tuple[Fleet, FleetState]:
    """Return the world with several vessels, or with scripted ones. Raises UserError as `build_plant`."""
    lead = profiles[0]
    models, names = [profile.vehicle for profile in profiles], [profile.vessel for profile in profiles]
    try:
        water = _water(lead, seeds, scenery)
        level_m = lead.environment.water.level_m
        traffic = [ScriptedVessel.from_spec(name, spec, level_m) for name, spec in lead.traffic.items()]
        fleet = Fleet.from_spec(models, *water, names, traffic)
    except ValueError as error:
        raise UserError(f"{lead.name}: {error}") from error
    return fleet, fleets.initial(fleet, *_starts(profiles), default_rng(seeds.sequence(_AT_START)))


_AT_START = "environment at the start"


def _water(profile: RunProfile, seeds: Seeds, scenery: Scenery | None) -> tuple[Environment, float, Waterway]:
    """Return environment, step length in s, and waterway."""
    environment = Environment.from_spec(profile.environment, default_rng(seeds.sequence("waves")))
    waterway = build_waterway(profile, scenery or Scenery(profile)) if has_waterway(profile) else OPEN_WATER
    return environment, 1.0 / profile.clock.physics_rate_hz, waterway


def _starts(profiles: Sequence[RunProfile]) -> tuple[Array, Array]:
    """Return places (N, 2) and headings (N,)."""
    starts = [profile.mission.start for profile in profiles]
    places = np.array([[start.north_m, start.east_m] for start in starts])
    return places, np.array([math.radians(start.heading_deg) for start in starts])


def has_waterway(profile: RunProfile) -> bool:
    """Whether a run of this profile has more than open water: contact, debris, or buoys."""
    world, debris = profile.world, profile.world.debris
    return bool(world.contact or world.buoys or debris.launches or debris.encounters.count or debris.control)


def build_waterway(profile: RunProfile, scenery: Scenery) -> Waterway:
    """Return the waterway; open water when the profile has neither contact nor bodies afloat."""
    if not has_waterway(profile):
        return OPEN_WATER
    tide_m = make_tide(profile.environment).bounds_m
    lowest_down_m, highest_down_m = (scenery.water_down_m - height_m for height_m in tide_m)
    parts = [] if scenery.boom is None else scenery.boom.capsules(scenery.water_down_m)
    for number, solid in enumerate(scenery.boxes):
        middle_down_m, height_m = float(solid.centre_m[2]), float(solid.size_m[2])
        nearest_down_m = min(max(middle_down_m, highest_down_m), lowest_down_m)
        if abs(middle_down_m - nearest_down_m) >= 0.5 * height_m + NEAR_SURFACE_M:
            continue
        heading_rad = math.atan2(solid.rotation[1, 0], solid.rotation[0, 0])
        name = "dam" if profile.world.dam is not None and number == 0 else "building"
        north, east, _ = solid.centre_m.tolist()
        parts.append(box_capsules(name, (north, east), (float(solid.size_m[0]), float(solid.size_m[1])), heading_rad))
    drifting = sorted(map(launch_from, profile.world.debris.launches), key=lambda launch: launch.at_ns)
    launches = [*map(_moored, profile.world.buoys), *drifting]
    contact = profile.world.contact
    triangles = Triangles.from_meshes(scenery.felt, scenery.water_down_m, tide_m) if contact else NO_TRIANGLES
    return Waterway(Capsules.joined(parts), scenery.bed, tuple(launches), contact, triangles)


def launch_from(spec: LaunchSpec) -> Launch:
    """Return a launch of the profile."""
    north_m, east_m = spec.pos_ned_m
    kind = BodyKind[spec.kind.upper()]
    heading_rad = math.radians(spec.heading_deg)
    return Launch(round(spec.at_s * 1e9), kind, north_m, east_m, heading_rad, spec.length_m, spec.windage)


def _moored(spec: BuoySpec) -> Launch:
    """Return the launch of a buoy at the start."""
    form = BuoyForm(spec.shape, spec.colour, spec.reflector_m2)
    return Launch(0, BodyKind.BUOY, *spec.pos_ned_m, 0.0, spec.diameter_m, buoy=form, swing_m=spec.swing_m)


def local_frame(site: SiteSpec) -> LocalFrame:
    """Return NED at the site. Mean sea level counts as the ellipsoid: their difference is constant over the site."""
    return LocalFrame(site.latitude_deg, site.longitude_deg, site.altitude_m)


def magnetic_field_ned_gauss(site: SiteSpec) -> tuple[float, float, float]:
    """Return the profile's field, otherwise that of the world magnetic model."""
    if site.magnetic_field_ned_gauss is not None:
        return site.magnetic_field_ned_gauss
    return local_field_ned_gauss(site.latitude_deg, site.longitude_deg, site.altitude_m, site.year).ned_gauss
