"""Courses drawn on a map: GeoJSON (RFC 7946), KML (OGC 07-147r2) and GPX 1.0 and 1.1. Places are in WGS84.

A file has one course: one line, or points in their order.

XML is untrusted: a document type is refused, so that no entity is ever expanded. Neither KML nor GPX has one. Entity
bombs, external entities and external document types all need it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import field
from typing import Any
from xml.parsers import expat

from sim_core.dataclass import dataclass
from sim_core.geojson import GeoJsonError, read_geometries
from xitl_cli.profile.missions.course import Course, FileItem, MissionFileError, place_of, sorted_course
from xitl_cli.profile.missions.ground_station_files import number_of, read_json

ONE_COURSE = "keep one, or save the course in a separate file"


def read_geojson(text: str) -> Course:
    """Return one LineString or MultiPoint, or Points in their order. Raises MissionFileError."""
    lines: list[list[FileItem]] = []
    points: list[FileItem] = []
    try:
        geometries = list(read_geometries(read_json(text)))
    except GeoJsonError as error:
        raise MissionFileError(str(error)) from None
    for where, geometry, _ in geometries:
        if not geometry:
            raise MissionFileError(f"{where.rstrip('.')} is missing; draw it, or remove the feature")
        kind, coordinates = geometry.get("type"), geometry.get("coordinates")
        if kind == "Point":
            points.append(_position(coordinates, f"{where}coordinates"))
        elif kind in ("LineString", "MultiPoint") and isinstance(coordinates, list):
            lines.append([_position(point, f"{where}coordinates.{n}") for n, point in enumerate(coordinates)])
        else:
            text = f"{where}type is {str(kind)[:40]!r}, which is not a course"
            raise MissionFileError(f"{text}; use a LineString, a MultiPoint or Points")
    return _one_course(lines, points)


def _position(value: Any, where: str) -> FileItem:
    if not isinstance(value, list) or len(value) < 2:
        raise MissionFileError(f"{where} is not a position; write [longitude, latitude]")
    longitude_deg, latitude_deg = (number_of(number, where) for number in value[:2])
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
            raise MissionFileError(f"<{element.name}> is not a course; use a LineString or Points", element.line)
        if element.name in ("LineString", "Point"):
            places = []
            for words in element.text_of("coordinates").split():
                where, numbers = f"<{element.name}>", words.split(",")
                if len(numbers) < 2:
                    sentence = f"{where}: {words[:40]!r} is not a place; write longitude,latitude"
                    raise MissionFileError(sentence, element.line)
                longitude_deg, latitude_deg = (_decimal(number, where, element.line) for number in numbers[:2])
                place_deg = place_of(latitude_deg, longitude_deg, where, element.line)
                places.append(FileItem(place_deg=place_deg, where=where, line=element.line))
            if not places:
                raise MissionFileError(f"<{element.name}> has no coordinates; draw it, or remove it", element.line)
            if element.name == "Point":
                points += places
            else:
                lines.append(places)
    return _one_course(lines, points)


def read_gpx(text: str) -> Course:
    """Return the route, otherwise the track, otherwise the waypoints. Raises MissionFileError with the line."""
    root = read_xml(text)
    if root.name != "gpx":
        raise MissionFileError(f"its root is <{root.name}>, not <gpx>; save it as GPX again", root.line)
    for name, point in (("rte", "rtept"), ("trk", "trkpt")):
        courses = [element for element in root.children if element.name == name]
        if len(courses) > 1:
            raise MissionFileError(f"has {len(courses)} of <{name}>; {ONE_COURSE}", courses[1].line)
        if courses:
            return _one_course([[_gpx_place(below) for below in courses[0].walk() if below.name == point]], [])
    return _one_course([], [_gpx_place(below) for below in root.children if below.name == "wpt"])


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
        raise MissionFileError(f"has a line and {len(points)} points; {ONE_COURSE}", points[0].line)
    return sorted_course(lines[0] if lines else points, "line or point")


MOST_DEPTH = 100
MOST_ELEMENTS = 500_000


@dataclass(slots=True)
class Element:
    """One element of an XML document."""

    name: str
    """Without its namespace."""
    attributes: dict[str, str]
    line: int
    """1-based."""
    pieces: list[str] = field(default_factory=list)
    """Pieces of the text directly in it."""
    children: list[Element] = field(default_factory=list)

    def walk(self) -> Iterator[Element]:
        """Yield the element and all elements below it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()

    def text_of(self, name: str) -> str:
        """Return the text of the children of this name."""
        return " ".join("".join(child.pieces) for child in self.children if child.name == name)


def read_xml(text: str) -> Element:
    """Return the root of a document. Raises MissionFileError with the line."""
    document = Element("", {}, 0)
    open_elements = [document]
    count = itertools.count(1)
    parser = expat.ParserCreate(namespace_separator=" ")

    def refuse_doctype(name: str, *rest: object) -> None:
        sentence = "has a <!DOCTYPE>, which KML and GPX do not use; remove it with its entities"
        raise MissionFileError(sentence, parser.CurrentLineNumber)

    def start(name: str, attributes: dict[str, str]) -> None:
        line = parser.CurrentLineNumber
        if len(open_elements) > MOST_DEPTH or next(count) > MOST_ELEMENTS:
            raise MissionFileError("has too many or too deeply nested elements; save only the course", line)
        element = Element(name.rpartition(" ")[2], attributes, line)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda name: open_elements.pop()
    parser.CharacterDataHandler = lambda text: open_elements[-1].pieces.append(text)
    parser.buffer_text = True
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        problem = expat.ErrorString(error.code)
        raise MissionFileError(f"is not valid XML: {problem}; save it again", error.lineno) from None
    except MissionFileError:
        raise
    except (LookupError, ValueError) as error:  # of an encoding that is unknown, or that expat does not support
        raise MissionFileError(f"is not valid XML: {error}; save it as UTF-8", 1) from None
    return document.children[0]
