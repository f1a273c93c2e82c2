"""Sensors that can be, and whose samples reach somebody."""

from __future__ import annotations

import math
from collections.abc import Iterator

from xitl_cli.profile.entry import KeyPath, dotted
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.sensors import ObstacleScanner, Rangefinder, sensors_of

SHORTEST_DIRECTION = 1e-6


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Limits the wrong way round, beams that look nowhere, a wind vane without an autopilot that takes its wind."""
    if profile.sensors is None:
        return
    for path, sensor in sensors_of(profile.sensors):
        if isinstance(sensor, (Rangefinder, ObstacleScanner)) and sensor.min_range_m >= sensor.max_range_m:
            yield (
                (*path, "min_range_m"),
                f"{dotted((*path, 'min_range_m'))} = {sensor.min_range_m:g} is not below max_range_m = "
                f"{sensor.max_range_m:g}; lower it, or raise the other",
            )
        if isinstance(sensor, Rangefinder) and math.hypot(*sensor.direction_frd) < SHORTEST_DIRECTION:
            yield (
                (*path, "direction_frd"),
                f"{dotted((*path, 'direction_frd'))} = {shown(sensor.direction_frd)} looks nowhere; "
                "use [0, 0, 1] for down, [1, 0, 0] for ahead",
            )
    autopilot = profile.autopilot
    if profile.sensors.wind_vane is not None and autopilot is not None and autopilot.bridge.world is None:
        yield (
            ("sensors", "wind_vane"),
            "sensors.wind_vane reaches nobody: the wind goes to an autopilot whose world is served; "
            "leave it out, or use autopilot.bridge.world",
        )
