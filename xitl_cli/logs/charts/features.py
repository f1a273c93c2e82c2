"""Features of a GeoJSON file (RFC 7946) with their style (simplestyle-spec 1.1)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from agent.files import read_bytes
from sim_core.geojson import GeoJsonError, GeoJsonGeometry, read_geometries
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.table import Floats

MOST_BYTES = 100_000_000
_GREY = "#555555"
_COLOUR = re.compile(r"#?([0-9a-fA-F]{3}|[0-9a-fA-F]{6})")


class ShapeKind(Enum):
    """Kind of a shape. The value is its name on a page."""

    POLYGON = "polygon"
    LINE = "line"
    POINT = "point"

    @property
    def order(self) -> int:
        """Position in the order of drawing."""
        return list(ShapeKind).index(self)


@dataclass(frozen=True, slots=True)
class ChartStyle:
    """Colours are #rrggbb; opacities are 0 to 1."""

    name: str = ""
    fill: str = _GREY
    fill_opacity: float = 0.6
    stroke: str = _GREY
    stroke_opacity: float = 1.0
    stroke_width_px: float = 2.0
    marker: str = "#7e7e7e"


@dataclass(frozen=True, slots=True)
class ChartShape:
    """A polygon with its holes, a line or a point, in metres east and north."""

    kind: ShapeKind
    rings_en_m: tuple[Floats, ...]
    """(P, 2) each: outer ring and holes of a polygon; one line; one point."""
    style: ChartStyle


@dataclass(frozen=True, slots=True)
class Feature:
    """A shape in degrees."""

    kind: ShapeKind
    rings_deg: tuple[Floats, ...]
    """(P, 2) each, longitude and latitude."""
    style: ChartStyle

    def placed(self, rings_en_m: Sequence[Floats]) -> ChartShape:
        """Return the shape with its rings in metres."""
        return ChartShape(self.kind, tuple(rings_en_m), self.style)


def read_features(path: Path) -> list[Feature]:
    """Return the features of a GeoJSON file, one or more. Raises LogError with the place in the file."""
    try:
        document = json.loads(read_bytes(path, MOST_BYTES).decode("utf-8-sig"))
    except OSError as error:
        raise LogError(
            f"{path}: cannot be read ({error.strerror}); name a GeoJSON or MBTiles file, or a folder"
        ) from error
    except json.JSONDecodeError as error:
        if not error.doc.lstrip().startswith("{"):
            raise _no_chart(path) from error
        raise LogError(f"{path}: is damaged at line {error.lineno} ({error.msg}); save the file again") from error
    except (ValueError, RecursionError) as error:
        raise _no_chart(path) from error
    try:
        features = [feature for geometry in read_geometries(document) for feature in _features(geometry)]
    except GeoJsonError as wrong:
        raise LogError(f"{path}: {wrong}") from wrong
    if not features:
        raise LogError(f"{path}: has no polygon, line or point; draw some, or choose another file")
    return features


def _no_chart(path: Path) -> LogError:
    return LogError(
        f"{path}: is no chart; give GeoJSON, MBTiles with raster tiles, or a folder of tiles {{z}}/{{x}}/{{y}}.png"
    )


def _features(geometry: GeoJsonGeometry) -> Iterator[Feature]:
    where, members, properties = geometry
    if not members:  # a feature may be without a place
        return
    kind = members.get("type")
    if not isinstance(kind, str) or kind not in _GEOMETRIES:
        raise GeoJsonError(f"{where}type is {str(kind)[:40]!r}, which is not of GeoJSON; save the file again")
    style = _style(properties, f"{where.removesuffix('geometry.')}properties.")
    shape, nesting, several = _GEOMETRIES[kind]
    parts = members.get("coordinates")
    for number, part in enumerate(parts if several and isinstance(parts, list) else [parts]):
        name = f"{where}coordinates" + (f".{number}" if several else "")
        rings = part if nesting == 2 else [part] if nesting == 1 else [[part]]
        if not isinstance(rings, list) or not rings:
            raise GeoJsonError(f"{name} is not a list; save the file again")
        yield Feature(shape, tuple(_ring(ring, name) for ring in rings), style)


_GEOMETRIES: Mapping[str, tuple[ShapeKind, int, bool]] = {
    "Point": (ShapeKind.POINT, 0, False),
    "MultiPoint": (ShapeKind.POINT, 0, True),
    "LineString": (ShapeKind.LINE, 1, False),
    "MultiLineString": (ShapeKind.LINE, 1, True),
    "Polygon": (ShapeKind.POLYGON, 2, False),
    "MultiPolygon": (ShapeKind.POLYGON, 2, True),
}
"""Kind of shape, nesting of its rings, and whether `coordinates` has several of them."""


def _ring(places: Any, where: str) -> Floats:
    if not isinstance(places, list) or not places:
        raise GeoJsonError(f"{where} is not a list of positions; save the file again")
    for place in places:
        numbers = place[:2] if isinstance(place, list) else []
        if len(numbers) < 2 or not all(isinstance(one, int | float) and math.isfinite(one) for one in numbers):
            raise GeoJsonError(f"{where}: {str(place)[:60]} is not a position; write [longitude, latitude]")
        longitude, latitude = numbers
        if abs(longitude) > 180.0 or abs(latitude) > 90.0:
            raise GeoJsonError(
                f"{where}: [{longitude:g}, {latitude:g}] is not longitude and latitude in degrees of WGS84; "
                "convert the file to EPSG:4326"
            )
    return np.array([place[:2] for place in places], dtype=np.float64)


def _style(properties: Any, where: str) -> ChartStyle:
    found = properties if isinstance(properties, dict) else {}

    def colour(key: str, otherwise: str) -> str:
        value = found.get(key)
        if value is None:
            return otherwise
        match = _COLOUR.fullmatch(value) if isinstance(value, str) else None
        if match is None:
            raise GeoJsonError(f"{where}{key}: {str(value)[:40]!r} is not a colour; write #rrggbb")
        digits = match[1] if len(match[1]) == 6 else "".join(2 * digit for digit in match[1])
        return f"#{digits.lower()}"

    def number(key: str, most: float, otherwise: float) -> float:
        value = found.get(key)
        if value is None:
            return otherwise
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= most:
            raise GeoJsonError(f"{where}{key}: {str(value)[:40]!r} is not a number from 0 to {most:g}; correct it")
        return float(value)

    usual = ChartStyle()
    name = found.get("name", found.get("title"))
    return ChartStyle(
        str(name)[:80] if isinstance(name, str | int | float) else "",
        colour("fill", usual.fill),
        number("fill-opacity", 1.0, usual.fill_opacity),
        colour("stroke", usual.stroke),
        number("stroke-opacity", 1.0, usual.stroke_opacity),
        number("stroke-width", 100.0, usual.stroke_width_px),
        colour("marker-color", usual.marker),
    )
