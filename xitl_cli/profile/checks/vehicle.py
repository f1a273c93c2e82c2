"""A vessel that can be built, and that floats."""

from __future__ import annotations

import math
from collections.abc import Iterator

from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.environment import Water


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Hulls that overlap, a mass they cannot carry, moments of inertia that no body has."""
    vehicle = profile.vehicle
    if vehicle is None:
        return
    hull = vehicle.hull
    if hull.width_m < 4 * hull.radius_m:
        yield (
            ("vehicle", "hull", "width_m"),
            f"vehicle.hull.width_m = {hull.width_m:g} is too narrow for two hulls of radius {hull.radius_m:g} m; "
            f"use at least {4 * hull.radius_m:g}",
        )
    water = profile.environment.water if profile.environment else Water()
    carried_kg = 2 * math.pi * hull.radius_m**2 * hull.length_m * water.density_kgpm3
    if vehicle.mass_kg >= carried_kg:
        yield (
            ("vehicle", "mass_kg"),
            f"vehicle.mass_kg = {vehicle.mass_kg:g} sinks: the two hulls carry {carried_kg:.4g} kg; "
            "use less mass or a larger vehicle.hull",
        )
    ixx, iyy, izz = vehicle.inertia_kgm2
    if 2 * max(ixx, iyy, izz) > (ixx + iyy + izz) * (1 + 1e-9):
        yield (
            ("vehicle", "inertia_kgm2"),
            f"vehicle.inertia_kgm2 = [{ixx:g}, {iyy:g}, {izz:g}] belongs to no body: one moment exceeds the sum of the "
            f"other two; lower it to {ixx + iyy + izz - max(ixx, iyy, izz):g} or less",
        )
