"""A vessel that floats, meshes that exist, an address where launches can be heard."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from sim_core.environment.spec import Water
from sim_core.world.spec import MESH_FORMATS
from xitl_cli.profile.checks.link import problem_of_url
from xitl_cli.profile.files.entry import KeyPath, shown
from xitl_cli.profile.schema import Profile


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """A mass that the hulls cannot carry, files that are not there, an address that is none."""
    if (vehicle := profile.vehicle) is not None and (hull := vehicle.hull) is not None:
        water = profile.environment.water if profile.environment else Water()
        carried_kg = 2 * math.pi * hull.radius_m**2 * hull.length_m * water.density_kgpm3
        if vehicle.mass_kg >= carried_kg:
            yield (
                ("vehicle", "mass_kg"),
                f"vehicle.mass_kg = {vehicle.mass_kg:g} sinks: the two hulls carry {carried_kg:.4g} kg; "
                "use less mass or a larger vehicle.hull",
            )
    if profile.world is None:
        return
    for number, mesh in enumerate(profile.world.meshes):
        path, key = ("world", "meshes", number, "file"), f"world.meshes.{number}.file"
        if not mesh.file.lower().endswith(tuple(f".{kind}" for kind in MESH_FORMATS)):
            yield path, f"{key} = {shown(mesh.file)} is not of a known format; use one of {', '.join(MESH_FORMATS)}"
        elif not is_file(mesh.file):
            yield path, f"{key}: {mesh.file} does not exist; check the path"
    if (control := profile.world.debris.control) is not None:
        problem = problem_of_url(control)
        if problem is None and not control.startswith("udp://"):
            problem = "is heard by UDP alone; write it like udp://127.0.0.1:14670"
        if problem is not None:
            yield ("world", "debris", "control"), f"world.debris.control = {shown(control)} {problem}"


def is_file(path: str) -> bool:
    """Whether there is such a file; False for what no file can be called."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False
