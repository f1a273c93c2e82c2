"""From the profile to the simulated world: vessel, water, current, waves and wind of `sim_core`."""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator, default_rng

from sim_core.environment.environment import Environment
from sim_core.environment.water import ChannelCurrent, Current, StillWater, UniformCurrent, Water
from sim_core.environment.waves import FlatWater, IrregularWaves, RegularWave, WaveField
from sim_core.environment.wind import (
    Air,
    DiscreteGust,
    Gust,
    NoGust,
    OrnsteinUhlenbeckGust,
    SpectralGust,
    StillAir,
    Wind,
)
from sim_core.geodesy import LocalFrame
from sim_core.noise import GaussMarkov
from sim_core.sensors.magnetometer import local_field_ned_gauss
from sim_core.simulation import Simulation, SimulationState, initial
from sim_core.vessel.model import AddedMass, Damping, Hull, Propeller, SteeringGear, VesselModel, Windage
from sim_core.world.waterway import OPEN_WATER
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema import environment as schema
from xitl_cli.profile.schema.place import Site
from xitl_cli.profile.schema.vehicle import Propeller as PropellerKeys
from xitl_cli.profile.schema.vehicle import Vehicle
from xitl_cli.run.core.seeds import Seeds
from xitl_cli.run.world.scenery import Scenery, scenery_of
from xitl_cli.run.world.waterway import has_waterway, waterway_of


def build(profile: RunProfile, seeds: Seeds, scenery: Scenery | None = None) -> tuple[Simulation, SimulationState]:
    """The world at time 0, the vessel at rest at the mission's start.

    Raises UserError when a model refuses a value that the profile's own checks let through.
    """
    try:
        environment = _environment(profile.environment, default_rng(seeds.of("waves")))
        waterway = waterway_of(profile, scenery or scenery_of(profile)) if has_waterway(profile) else OPEN_WATER
        dt_s = 1.0 / profile.clock.physics_rate_hz
        simulation = Simulation.of(vessel_model(profile.vehicle), environment, dt_s, waterway)
    except ValueError as error:
        raise UserError(f"{profile.name}: {error}") from error
    start = profile.mission.start
    place = np.array([[start.north_m, start.east_m]])
    heading = np.array([math.radians(start.heading_deg)])
    return simulation, initial(simulation, place, heading, default_rng(seeds.of("environment at the start")))


def vessel_model(vehicle: Vehicle) -> VesselModel:
    """The vessel of a profile."""
    return VesselModel(
        name=vehicle.name,
        mass_kg=vehicle.mass_kg,
        inertia_kgm2=vehicle.inertia_kgm2,
        hull=Hull(**vehicle.hull.model_dump()),
        added_mass=AddedMass(**vehicle.added_mass.model_dump()),
        damping_linear=Damping(**vehicle.damping_linear.model_dump()),
        damping_quadratic=Damping(**vehicle.damping_quadratic.model_dump()),
        propellers=tuple(_propeller(propeller) for propeller in vehicle.propellers),
        wind=Windage(**vehicle.wind.model_dump()),
    )


def local_frame(site: Site) -> LocalFrame:
    """NED at the site. Mean sea level is taken for the ellipsoid: their difference is constant over the site."""
    return LocalFrame(site.latitude_deg, site.longitude_deg, site.altitude_m)


def magnetic_field_ned_gauss(site: Site) -> tuple[float, float, float]:
    """The field the profile gives, else that of the world magnetic model."""
    if site.magnetic_field_ned_gauss is not None:
        return site.magnetic_field_ned_gauss
    return local_field_ned_gauss(site.latitude_deg, site.longitude_deg, site.altitude_m, site.year).ned_gauss


def _propeller(propeller: PropellerKeys) -> Propeller:
    gear = propeller.steering
    return Propeller(
        **propeller.model_dump(exclude={"steering"}),
        steering=None if gear is None else SteeringGear(**gear.model_dump()),
    )


def _environment(environment: schema.Environment, rng: Generator) -> Environment:
    water = Water(**environment.water.model_dump())
    return Environment(
        water=water,
        current=_current(environment.current),
        waves=_waves(environment.waves, water, rng),
        wind=_wind(environment.wind),
    )


def _current(current: schema.Current) -> Current:
    if not current.speed_mps and not current.deviation_mps:
        return StillWater()
    uniform = UniformCurrent(
        speed_mps=current.speed_mps,
        direction_deg=current.direction_deg,
        deviation_mps=current.deviation_mps,
        correlation_s=current.correlation_s,
    )
    return uniform if current.channel_width_m is None else ChannelCurrent(uniform, current.channel_width_m)


def _waves(waves: schema.Waves, water: Water, rng: Generator) -> WaveField | FlatWater:
    if waves.spectrum == "none" or not waves.significant_height_m:
        return FlatWater()
    if waves.spectrum == "regular":
        return RegularWave(waves.significant_height_m, waves.peak_period_s, waves.direction_deg).realise(water, rng)
    return IrregularWaves(
        spectrum=waves.spectrum,
        significant_height_m=waves.significant_height_m,
        peak_period_s=waves.peak_period_s,
        direction_deg=waves.direction_deg,
        gamma=waves.gamma,
        spreading=waves.spreading,
        components=waves.components,
    ).realise(water, rng)


def _wind(wind: schema.Wind) -> Air:
    if not wind.mean_mps and wind.gust.spectrum == "none" and not wind.discrete_gusts:
        return StillAir()
    return Wind(
        mean_mps=wind.mean_mps,
        direction_deg=wind.direction_deg,
        direction_deviation_deg=wind.direction_deviation_deg,
        direction_correlation_s=wind.direction_correlation_s,
        gust=_gust(wind),
        discrete_gusts=tuple(DiscreteGust(**gust.model_dump()) for gust in wind.discrete_gusts),
    )


def _gust(wind: schema.Wind) -> Gust:
    if wind.gust.spectrum == "none":
        return NoGust()
    if wind.gust.spectrum == "ornstein-uhlenbeck":
        return OrnsteinUhlenbeckGust(GaussMarkov(wind.gust.deviation_mps, wind.gust.correlation_s))
    return SpectralGust.from_spectrum(
        wind.gust.spectrum, wind.mean_mps, wind.reference_height_m, wind.gust.deviation_mps or None
    )
