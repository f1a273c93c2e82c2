"""Courses drawn on a map: GeoJSON (RFC 7946), KML (OGC 07-147r2) and GPX 1.0 and 1.1. Places are in WGS84.

A file has one course: one line, or points in their order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from xitl_cli.profile.missions.course import Course, FileItem, MissionFileError, place_of, sorted_course
from xitl_cli.profile.missions.ground_station_files import number_of, read_json
from xitl_cli.profile.missions.xml_tree import Element, read_xml

_WGS84 = ("CRS84", "EPSG::4326", "EPSG:4326")
ONE_COURSE = "keep one, or save the one to sail in a file of its own"


def read_geojson(text: str) -> Course:
    """Return one LineString or MultiPoint, or Points in their order. Raises MissionFileError."""
    found = read_json(text)
    if not isinstance(found, dict):
        raise MissionFileError("is not GeoJSON; a file is a FeatureCollection, a Feature or a geometry")
    crs = found.get("crs")
    if crs is not None and not str(crs).rstrip("'}").endswith(_WGS84):
        raise MissionFileError("crs is not WGS84, which GeoJSON is in (RFC 7946); convert it to EPSG:4326")
    lines: list[list[FileItem]] = []
    points: list[FileItem] = []
    for where, geometry in _geometries(found, "", 0):
        kind, coordinates = geometry.get("type"), geometry.get("coordinates")
        if kind == "Point":
            points.append(_position(coordinates, f"{where}coordinates"))
        elif kind in ("LineString", "MultiPoint") and isinstance(coordinates, list):
            lines.append([_position(one, f"{where}coordinates.{n}") for n, one in enumerate(coordinates)])
        else:
            what = f"{where}type is {str(kind)[:40]!r}, which is no course"
            raise MissionFileError(f"{what}; use a LineString, a MultiPoint or Points")
    return _one_course(lines, points)


def _geometries(found: dict[str, Any], where: str, depth: int) -> Iterator[tuple[str, dict[str, Any]]]:
    kind = found.get("type")
    lists = {"FeatureCollection": "features", "GeometryCollection": "geometries"}
    if isinstance(kind, str) and kind in lists and depth < 8:
        key = lists[kind]
        members = found.get(key)
        if not isinstance(members, list):
            raise MissionFileError(f"{where}{key} is not a list; save the file again")
        for number, one in enumerate(members):
            if not isinstance(one, dict):
                raise MissionFileError(f"{where}{key}.{number} is not an object; save the file again")
            yield from _geometries(one, f"{where}{key}.{number}.", depth + 1)
    elif kind == "Feature":
        geometry = found.get("geometry")
        if not isinstance(geometry, dict):
            raise MissionFileError(f"{where}geometry is missing; draw it, or remove the feature")
        yield from _geometries(geometry, f"{where}geometry.", depth + 1)
    else:
        yield where, found


def _position(value: Any, where: str) -> FileItem:
    if not isinstance(value, list) or len(value) < 2:
        raise MissionFileError(f"{where} is not a position; write [longitude, latitude]")
    longitude_deg, latitude_deg = (number_of(one, where) for one in value[:2])
    return FileItem(place_deg=place_of(latitude_deg, longitude_deg, where), where=where)


def read_kml(text: str) -> Course:
    """Return one LineString, or the Points of the placemarks in their order. Raises MissionFileError with the line."""
    root = read_xml(text)
    if root.name != "kml":
        raise MissionFileError(f"its root is <{root.name}>, not <kml>; save it as KML again", root.line)
    lines: list[list[FileItem]] = []
    points: list[FileItem] = []
    for element in root.walk():
        if element.name in ("Polygon", "Track", "MultiTrack", "NetworkLink"):
            what = f"<{element.name}> is no course; use a LineString or Points"
            raise MissionFileError(what, element.line)
        if element.name in ("LineString", "Point"):
            places = [_kml_place(words, element) for words in element.text_of("coordinates").split()]
            if not places:
                raise MissionFileError(f"<{element.name}> has no coordinates; draw it, or remove it", element.line)
            if element.name == "Point":
                points += places
            else:
                lines.append(places)
    return _one_course(lines, points)


def _kml_place(words: str, element: Element) -> FileItem:
    where, numbers = f"<{element.name}>", words.split(",")
    if len(numbers) < 2:
        raise MissionFileError(f"{where}: {words[:40]!r} is no place; write longitude,latitude", element.line)
    longitude_deg, latitude_deg = (_decimal(number, where, element.line) for number in numbers[:2])
    return FileItem(
        place_deg=place_of(latitude_deg, longitude_deg, where, element.line), where=where, line=element.line
    )


def read_gpx(text: str) -> Course:
    """Return the route, otherwise the track, otherwise the waypoints. Raises MissionFileError with the line."""
    root = read_xml(text)
    if root.name != "gpx":
        raise MissionFileError(f"its root is <{root.name}>, not <gpx>; save it as GPX again", root.line)
    for name, point in (("rte", "rtept"), ("trk", "trkpt")):
        found = [element for element in root.children if element.name == name]
        if len(found) > 1:
            raise MissionFileError(f"has {len(found)} of <{name}>; {ONE_COURSE}", found[1].line)
        if found:
            return _one_course([[_gpx_place(one) for one in found[0].walk() if one.name == point]], [])
    return _one_course([], [_gpx_place(one) for one in root.children if one.name == "wpt"])


def _gpx_place(element: Element) -> FileItem:
    where = f"<{element.name}>"
    latitude_deg, longitude_deg = (
        _decimal(element.attributes.get(key, ""), f"{where} {key}", element.line) for key in ("lat", "lon")
    )
    return FileItem(
        place_deg=place_of(latitude_deg, longitude_deg, where, element.line), where=where, line=element.line
    )


def _decimal(text: str, where: str, line: int) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise MissionFileError(f"{where}: {text.strip()[:40]!r} is not a number; write degrees", line)
    return value


def _one_course(lines: list[list[FileItem]], points: list[FileItem]) -> Course:
    if len(lines) > 1:
        raise MissionFileError(f"has {len(lines)} lines; {ONE_COURSE}", lines[1][0].line if lines[1] else None)
    if lines and points:
        raise MissionFileError(f"has a line and {len(points)} points beside it; {ONE_COURSE}", points[0].line)
    return sorted_course(lines[0] if lines else points, "line or point")
