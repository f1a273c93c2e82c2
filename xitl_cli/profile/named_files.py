"""Replaces the file names of a composed profile, `mission.file` and `environment.water.tide.file`, by the content."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from agent.files import read_text
from xitl_cli.profile.files.catalogue import shown_path
from xitl_cli.profile.files.entry import Entry, Key, Origin, Scalar, profile_error, shown

if TYPE_CHECKING:
    from xitl_cli.profile.missions.course import Course, FileItem

READERS: Mapping[str, str] = {
    ".plan": "ground_station_files:read_plan",
    ".waypoints": "ground_station_files:read_waypoints",
    ".txt": "ground_station_files:read_waypoints",
    ".geojson": "map_files:read_geojson",
    ".json": "map_files:read_geojson",
    ".kml": "map_files:read_kml",
    ".gpx": "map_files:read_gpx",
}
"""Modules of missions/ with their functions, which are imported for a profile that names such a file."""


def with_mission_files(entry: Entry) -> Entry:
    """Return `entry` with the mission files of the profile and its vessels read.

    Raises ProfileError with file and element.

    Places stay latitudes and longitudes: `with_places_in_metres` follows.
    """
    vessels = entry.child("vessels")
    if vessels is not None and isinstance(vessels.value, dict):
        assert isinstance(entry.value, dict)
        read = {name: with_mission_files(vessel) for name, vessel in vessels.value.items()}
        entry = Entry({**entry.value, "vessels": Entry(read, vessels.origin, vessels.replaced)}, entry.origin)
    mission = entry.child("mission")
    file = None if mission is None else mission.child("file")
    if mission is None or file is None or file.value is None:
        return entry
    assert isinstance(entry.value, dict)
    return Entry({**entry.value, "mission": _read(mission, file)}, entry.origin, entry.replaced)


def _read(mission: Entry, file: Entry) -> Entry:
    assert isinstance(mission.value, dict)
    course = _course(file)
    for key in ("waypoints_ned_m", "items"):
        if (own := mission.value.get(key)) is not None and own.value:
            raise profile_error(file.origin, f"mission.file and mission.{key} exclude each other; remove one of them")
    source = shown_path(Path(str(file.value)))
    lists = {"items": course.items, "fence": course.fence, "rally": course.rally}
    from_file = {
        key: Entry(tuple(_item(item, source) for item in items), file.origin) for key, items in lists.items() if items
    }
    if all(item.is_plain for item in course.items):
        from_file.pop("items", None)
        places = tuple(_place(item, source) for item in course.items)
        from_file = {"waypoints_ned_m": Entry(places, file.origin), **from_file}
    others = {key: value for key, value in mission.value.items() if key not in ("file", "waypoints_ned_m", "items")}
    return Entry({**from_file, **others}, mission.origin, mission.replaced)


def _course(file: Entry) -> Course:
    from xitl_cli.profile.missions.course import MissionFileError

    if not isinstance(file.value, str):
        raise profile_error(file.origin, f"mission.file = {shown(file.plain())} is not text; write the path of a file")
    path = Path(file.value)
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        sentence = f"mission.file = {shown(file.value)} has an unknown format; use one of {', '.join(READERS)}"
        raise profile_error(file.origin, sentence)
    module, _, function = reader.partition(":")
    read: Callable[[str], Course] = getattr(import_module(f"xitl_cli.profile.missions.{module}"), function)
    try:
        return read(_text(path, "mission.file", file.origin))
    except MissionFileError as error:
        raise profile_error(Origin(shown_path(path), error.line), str(error)) from None


def _item(item: FileItem, source: str) -> Entry:
    at = Origin(source, item.line)
    values: dict[str, Entry] = {
        "command": Entry(item.command, at),
        "parameters": Entry(tuple(Entry(value, at) for value in item.parameters), at),
        "altitude_m": Entry(item.altitude_m, at),
        "frame": Entry(item.frame, at),
    }
    if item.place_deg is not None:
        values["place_ned_m"] = _place(item, source)
    return Entry(values, at)


def _place(item: FileItem, source: str) -> Entry:
    assert item.place_deg is not None
    at = Origin(source, item.line)
    degrees: dict[str, Scalar] = {"lat": item.place_deg[0], "lon": item.place_deg[1]}
    return Entry({key: Entry(value, at) for key, value in degrees.items()}, at)


_TIDE = ("environment", "water", "tide")
_KEY = "environment.water.tide.file"


def with_tide_file(entry: Entry) -> Entry:
    """Return `entry` with the tide's file read as its `table`. Raises ProfileError with file and line.

    A row has a time and a height, and further columns are ignored. A first row without a number is a header. Empty
    rows and rows that begin with # are left out.
    """
    tide, depth = entry.nearest(_TIDE)
    file = tide.child("file") if depth == len(_TIDE) else None
    if file is None or file.value is None:
        return entry
    assert isinstance(tide.value, dict)
    if not isinstance(file.value, str):
        raise profile_error(file.origin, f"{_KEY} = {shown(file.plain())} is not text; write the path of a CSV file")
    for other in ("table", "constituents"):
        if (own := tide.value.get(other)) is not None and own.value:
            raise profile_error(file.origin, f"{_KEY} and tide.{other} exclude each other; remove one of them")
    table = Entry(_rows(Path(file.value), file.origin), file.origin)
    others = {key: value for key, value in tide.value.items() if key not in ("file", "table")}
    return _replaced(entry, _TIDE, Entry({**others, "table": table}, tide.origin, tide.replaced))


def _rows(path: Path, origin: Origin) -> tuple[Entry, ...]:
    source = shown_path(path)
    rows: list[Entry] = []
    reader, header = csv.reader(_text(path, _KEY, origin).splitlines()), True
    try:
        for cells in reader:
            at = Origin(source, reader.line_num)
            cells = [cell.strip() for cell in cells]
            if not any(cells) or cells[0].startswith("#"):
                continue
            height = _number(cells[1]) if len(cells) > 1 else None
            if height is None:
                if header and len(cells) > 1:
                    header = False
                    continue
                raise profile_error(
                    at, f"{shown(', '.join(cells))} is not a row of time and height; write for example 3600, 0.42"
                )
            header = False
            time: Scalar = _number(cells[0])
            rows.append(Entry((Entry(cells[0] if time is None else time, at), Entry(height, at)), at))
    except csv.Error as error:
        raise profile_error(
            Origin(source, reader.line_num), f"is not CSV ({error}); write a time and a height"
        ) from None
    if not rows:
        raise profile_error(Origin(source), "has no rows; write a time and a height in each row")
    return tuple(rows)


def _text(path: Path, key: str, origin: Origin) -> str:
    """Return the text of the file that `key` names, without a byte order mark."""
    try:
        return read_text(path).removeprefix("\ufeff")
    except OSError as error:
        reason = (error.strerror or "unknown reason").lower()
        raise profile_error(origin, f"{key}: {path} cannot be read: {reason}; check the path") from None
    except UnicodeDecodeError as error:
        raise profile_error(
            Origin(shown_path(path)), f"is not UTF-8 text (byte {error.start}); save it as UTF-8"
        ) from None


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _replaced(entry: Entry, path: tuple[Key, ...], new: Entry) -> Entry:
    if not path:
        return new
    assert isinstance(entry.value, dict)
    key = str(path[0])
    return Entry({**entry.value, key: _replaced(entry.value[key], path[1:], new)}, entry.origin, entry.replaced)
