"""Sensors beside the usual four, and the truth for an autopilot that simulates its own: the rows of what is sent."""

from __future__ import annotations

import math
from collections.abc import Iterator

from numpy.random import default_rng

from sim_core.geodesy import LocalFrame
from sim_core.sensors.gnss import Gnss
from sim_core.sensors.odometry import Odometry
from sim_core.sensors.rangefinder import ObstacleScanner, Rangefinder, Wall, Walls, boom, box
from sim_core.sensors.wind_vane import WindVane
from sim_core.world.river import FlatBed
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.place import LogBoom, World
from xitl_cli.run.core.seeds import Seeds
from xitl_cli.run.sensors import sensor_messages as standard_messages
from xitl_cli.run.sensors.channel import Channel, SensorChannel, TruthChannel, VaneChannel
from xitl_cli.run.world.scenery import boom_of

BRIDGED = ("ardupilot", "px4")
LIMITS = {"min_range_m", "max_range_m"}


def further_channels(profile: RunProfile, seeds: Seeds, frame: LocalFrame) -> Iterator[Channel]:
    """All that the profile turns on."""
    assert profile.sensors is not None
    sensors, water, physics_hz = profile.sensors, profile.environment.water, profile.clock.physics_rate_hz
    walls = walls_of(profile.world, -water.level_m)
    for number, rangefinder in enumerate(sensors.rangefinders):
        unit = Rangefinder(
            bed_down_m=water.depth_m - water.level_m,
            surface_down_m=-water.level_m,
            walls=walls,
            **rangefinder.model_dump(exclude=LIMITS),
        )
        rng = default_rng(seeds.of(f"rangefinder {number}"))
        yield SensorChannel(unit, rng, physics_hz, standard_messages.distance_sensor(number, rangefinder))
    messages = sensors.messages
    if (fixes := messages.gps_input) is not None:
        receiver = Gnss(frame=frame, **fixes.model_dump(exclude={"gps_id"}))
        rng = default_rng(seeds.of("gps input"))
        yield SensorChannel(receiver, rng, physics_hz, standard_messages.gps_input(fixes.gps_id))
    if (scan := messages.obstacle_distance) is not None:
        scanner = ObstacleScanner(walls=walls, **scan.model_dump(exclude=LIMITS))
        rng = default_rng(seeds.of("obstacle distance"))
        yield SensorChannel(scanner, rng, physics_hz, standard_messages.obstacle_distance(scan))
    if (pose := messages.odometry) is not None:
        encode = standard_messages.odometry(pose.velocity_noise_mps, pose.rate_noise_radps)
        yield SensorChannel(Odometry(**pose.model_dump()), default_rng(seeds.of("odometry")), physics_hz, encode)
    if profile.autopilot.bridge.world is not None and profile.autopilot.kind in BRIDGED:
        vane = None
        if sensors.wind_vane is not None:
            rng = default_rng(seeds.of("wind vane"))
            vane = VaneChannel(WindVane(**sensors.wind_vane.model_dump()), rng, physics_hz)
            yield vane
        yield TruthChannel(round(physics_hz / profile.clock.exchange_rate_hz), vane)


def walls_of(world: World, surface_down_m: float = 0.0) -> Walls:
    """Log boom and dam, as far as they are upright; a boom that floats does so at the surface."""
    walls: list[Wall] = []
    if world.log_boom is not None:
        walls += _boom_walls(world.log_boom, surface_down_m)
    if world.dam is not None:
        (north_m, east_m, down_m), (length_m, width_m, height_m) = world.dam.centre_ned_m, world.dam.size_m
        heading_rad = math.radians(world.dam.heading_deg)
        walls += box((north_m, east_m), length_m, width_m, heading_rad, down_m - height_m / 2, down_m + height_m / 2)
    return Walls.of(walls)


def _boom_walls(keys: LogBoom, surface_down_m: float) -> list[Wall]:
    if keys.points_ned_m is not None:
        return boom(keys.points_ned_m, keys.float_radius_m)
    floats = boom_of(keys, FlatBed(0.0), surface_down_m).ends_ned_m.tolist()
    return [wall for ends in floats for wall in boom([(n, e, d) for n, e, d in ends], keys.float_radius_m)]
