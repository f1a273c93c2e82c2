"""A world that can be built: a log boom with one line, mouths that fit into their dam, two banks, meshes that exist."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile
from xitl_cli.profile.schema.place import MESH_FORMATS, Dam, LogBoom, MeshFile, River

_BANK_M = 4.0


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """What of `world` does not go together."""
    if profile.world is None:
        return
    if profile.world.log_boom is not None:
        yield from _boom(profile.world.log_boom)
    if profile.world.dam is not None:
        yield from _dam(profile.world.dam)
    if profile.world.river is not None:
        yield from _river(profile.world.river)
    for number, mesh in enumerate(profile.world.meshes):
        yield from _mesh(number, mesh)


def _boom(boom: LogBoom) -> Iterator[tuple[KeyPath, str]]:
    if boom.points_ned_m is None and boom.anchors_ne_m is None:
        yield ("world", "log_boom"), "world.log_boom lies nowhere; give anchors_ne_m (or points_ned_m)"
    if boom.points_ned_m is not None and boom.anchors_ne_m is not None:
        yield (
            ("world", "log_boom", "anchors_ne_m"),
            "world.log_boom has anchors_ne_m and points_ned_m; leave out one of them (null)",
        )
    line = boom.anchors_ne_m or boom.points_ned_m or ()
    for number, (one, following) in enumerate(pairwise(line)):
        if one[:2] == following[:2]:
            key = "anchors_ne_m" if boom.anchors_ne_m else "points_ned_m"
            yield (
                ("world", "log_boom", key, number + 1),
                f"world.log_boom.{key}.{number + 1} = {_numbers(following)} is where the one before it is; "
                "leave one out",
            )


def _dam(dam: Dam) -> Iterator[tuple[KeyPath, str]]:
    intakes = dam.intakes
    if intakes is None:
        return
    most = dam.size_m[0] / intakes.count
    if intakes.width_m > most:
        yield (
            ("world", "dam", "intakes", "width_m"),
            f"world.dam.intakes.width_m = {intakes.width_m:g} is too wide for {intakes.count} intakes along "
            f"{dam.size_m[0]:g} m; use {most:g} or less",
        )
    middle, half = dam.centre_ned_m[2], dam.size_m[2] / 2
    top_m, bottom_m = intakes.down_m - intakes.height_m / 2, intakes.down_m + intakes.height_m / 2
    if top_m < middle - half or bottom_m > middle + half:
        yield (
            ("world", "dam", "intakes", "height_m"),
            f"world.dam.intakes reach from {top_m:g} to {bottom_m:g} m down, out of the dam, which reaches from "
            f"{middle - half:g} to {middle + half:g}; change down_m or height_m",
        )


def _river(river: River) -> Iterator[tuple[KeyPath, str]]:
    if river.along_m[0] >= river.along_m[1]:
        yield (
            ("world", "river", "along_m"),
            f"world.river.along_m = {_numbers(river.along_m)} has its ends the wrong way round; put the lesser first",
        )
    if river.trees and river.beside_m <= _BANK_M:
        yield (
            ("world", "river", "beside_m"),
            f"world.river.beside_m = {river.beside_m:g} leaves no room for trees; use more than {_BANK_M:g}",
        )


def _mesh(number: int, mesh: MeshFile) -> Iterator[tuple[KeyPath, str]]:
    path, key = ("world", "meshes", number, "file"), f"world.meshes.{number}.file"
    if not mesh.file.lower().endswith(tuple(f".{kind}" for kind in MESH_FORMATS)):
        yield path, f"{key} = {shown(mesh.file)} is not of a known format; use one of {', '.join(MESH_FORMATS)}"
    elif not _is_file(mesh.file):
        yield path, f"{key}: {mesh.file} does not exist; check the path"


def _is_file(path: str) -> bool:
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False


def _numbers(values: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"
