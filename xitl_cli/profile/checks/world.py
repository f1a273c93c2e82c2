"""Checks of vessel and world: the vessel floats upright, steps are short enough, meshes and addresses are valid."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from sim_core.environment.spec import Water
from sim_core.keys import MESH_FORMATS, SpecificationError
from sim_core.vessel.actuators import ActuatorError
from sim_core.vessel.spec import VesselSpec
from xitl_cli.profile.checks.link import problem_of_url
from xitl_cli.profile.files.entry import KeyPath, finding, shown
from xitl_cli.profile.schema import Profile

SHORT_STEP_S = 1e-6  # short enough for any vessel


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield a vessel that sinks, capsizes or is too stiff, unusable meshes, and an invalid address."""
    if profile.vehicle is not None:
        yield from _afloat(profile.vehicle, profile)
    yield from _short_table(profile)
    if profile.world is None:
        return
    for number, mesh in enumerate(profile.world.meshes):
        path, key = ("world", "meshes", number, "file"), f"world.meshes.{number}.file"
        if not mesh.file.lower().endswith(tuple(f".{kind}" for kind in MESH_FORMATS)):
            yield path, f"{key} = {shown(mesh.file)} is not of a known format; use one of {', '.join(MESH_FORMATS)}"
        elif not is_file(mesh.file):
            yield path, f"{key}: {mesh.file} does not exist; check the path"
        else:
            from sim_core.world.geometry import WorldError, import_mesh  # few profiles have meshes

            try:
                import_mesh(mesh)
            except WorldError as error:
                yield path, f"{key}: {error}"
    if (control := profile.world.debris.control) is not None:
        problem = problem_of_url(control)
        if problem is None and not control.startswith("udp://"):
            problem = "is not UDP; write it like udp://127.0.0.1:14670"
        if problem is not None:
            yield finding("world.debris.control", f"= {shown(control)} {problem}")


def _afloat(vehicle: VesselSpec, profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield why the vessel does not float upright in still water, moves too fast for the steps, or cannot be drawn."""
    from sim_core.vessel.sections import visual_shape
    from sim_core.vessel.vessel import Vessel

    water = profile.environment.water if profile.environment else Water()
    rate_hz = profile.clock.physics_rate_hz if profile.clock else None
    try:
        Vessel.from_spec(vehicle, water, 1.0 / rate_hz if rate_hz else SHORT_STEP_S)
        if vehicle.visual is not None:
            visual_shape(vehicle.visual, vehicle.length_m)
    except SpecificationError as error:
        yield ("vehicle", *error.path), f"vehicle.{error}"
    except ActuatorError as error:
        yield ("vehicle", "actuators", error.name), f"{error}; correct its package"
    except ValueError as error:
        yield finding("clock.physics_rate_hz", f"= {rate_hz:g}: {error}")


def _short_table(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """Yield a tide's table that does not cover the run, and the lag of its stream."""
    environment, clock = profile.environment, profile.clock
    if environment is None or clock is None or environment.water.tide is None:
        return
    span_s = environment.water.tide.span_s(environment.start_utc)
    if span_s is None:
        return
    stream = environment.current.tide
    lag_s = 0.0 if stream is None else 60.0 * stream.lag_min
    first_s, last_s = min(0.0, -lag_s), clock.duration_s + max(0.0, -lag_s)
    table = ("environment", "water", "tide", "table")
    if span_s[0] > first_s:
        yield table, f"{'.'.join(table)} begins at {span_s[0]:g} s, but the run needs it from {first_s:g} s; add rows"
    if span_s[1] < last_s:
        yield (
            table,
            f"{'.'.join(table)} ends at {span_s[1]:g} s, but the run needs it to {last_s:g} s; add rows, or use a "
            "smaller clock.duration_s",
        )


def is_directory(path: str) -> bool:
    """Whether there is such a directory; False for an invalid name."""
    try:
        return Path(path).is_dir()
    except (OSError, ValueError):
        return False


def is_file(path: str) -> bool:
    """Whether there is such a file; False for an invalid name."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False
