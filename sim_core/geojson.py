"""Geometries of a GeoJSON document (RFC 7946)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

MOST_DEPTH = 8
_LISTS = {"FeatureCollection": "features", "GeometryCollection": "geometries"}
_WGS84 = ("CRS84", "EPSG::4326", "EPSG:4326")


class GeoJsonError(ValueError):
    """A member, what is wrong with it and the fix, as one sentence."""


class GeoJsonGeometry(NamedTuple):
    """A geometry that is no collection."""

    where: str
    """Prefix of the names of its members in messages, such as `features.0.geometry.`."""
    members: Mapping[str, Any]
    """`type`, `coordinates` and others, unchecked. Empty for a feature without a geometry."""
    properties: Any
    """`properties` of its feature, unchecked; None without a feature."""


def read_geometries(document: Any) -> Iterator[GeoJsonGeometry]:
    """Yield the geometries of a document in their order. Raises GeoJsonError for a member that is not of GeoJSON."""
    if not isinstance(document, dict):
        raise GeoJsonError("is not GeoJSON; a file is a FeatureCollection, a Feature or a geometry")
    crs = document.get("crs")
    if crs is not None and not str(crs).rstrip("'}").endswith(_WGS84):
        raise GeoJsonError("crs is not WGS84, which GeoJSON requires (RFC 7946); convert it to EPSG:4326")
    yield from _geometries(document, "", 0, None)


def _geometries(member: Mapping[str, Any], where: str, depth: int, properties: Any) -> Iterator[GeoJsonGeometry]:
    kind = member.get("type")
    if isinstance(kind, str) and kind in _LISTS and depth < MOST_DEPTH:
        key = _LISTS[kind]
        members = member.get(key)
        if not isinstance(members, list):
            raise GeoJsonError(f"{where}{key} is not a list; save the file again")
        for number, below in enumerate(members):
            if not isinstance(below, dict):
                raise GeoJsonError(f"{where}{key}.{number} is not an object; save the file again")
            yield from _geometries(below, f"{where}{key}.{number}.", depth + 1, properties)
    elif kind == "Feature":
        geometry, where = member.get("geometry"), f"{where}geometry."
        if isinstance(geometry, dict):
            yield from _geometries(geometry, where, depth + 1, member.get("properties"))
        else:
            yield GeoJsonGeometry(where, {}, member.get("properties"))
    else:
        yield GeoJsonGeometry(where, member, properties)
