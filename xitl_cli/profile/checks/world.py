"""A vessel that floats upright, meshes that exist, an address where launches can be heard."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from sim_core.environment.spec import Water
from sim_core.keys import MESH_FORMATS, SpecificationError
from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.checks.link import problem_of_url
from xitl_cli.profile.files.entry import KeyPath, shown
from xitl_cli.profile.schema import Profile


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """A vessel that sinks or capsizes, files that are not there, an address that is none."""
    if profile.vehicle is not None and (unfit := _unfit_to_float(profile.vehicle, profile)) is not None:
        yield ("vehicle", *unfit.path), f"vehicle.{unfit}"
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


def _unfit_to_float(vehicle: VesselSpec, profile: Profile) -> SpecificationError | None:
    """Why the vessel does not lie upright in still water."""
    from sim_core.vessel.floating import floating_pose

    try:
        floating_pose(vehicle, profile.environment.water if profile.environment else Water())
    except SpecificationError as error:
        return error
    return None


def is_file(path: str) -> bool:
    """Whether there is such a file; False for what no file can be called."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False
