"""A chart below a track, in metres east and north of the track's origin.

    chart = read_chart(path, origin, track_en_m)

path: GeoJSON (RFC 7946) with the style of simplestyle-spec 1.1, a folder of tiles {z}/{x}/{y}.png, or MBTiles 1.3
with raster tiles. Nothing is fetched from a network.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.charts.features import ChartShape, read_features
from xitl_cli.logs.charts.tiles import ChartTile, read_tiles
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.table import Floats

LEAST_MARGIN_M = 100.0
MARGIN = 0.75
"""Width of the charted area beyond the track, as a share of the track's extent."""
FARTHEST_M = 2000.0
"""Largest distance between a chart and a track that the track's area does not reach."""
Origin = tuple[float, float, float]
"""Latitude, longitude (deg) and altitude (m)."""


@dataclass(frozen=True, slots=True)
class Area:
    """A rectangle in metres."""

    west: float
    south: float
    east: float
    north: float

    @classmethod
    def around(cls, places_en_m: Floats) -> Area:
        """Return the bounds of places (N, 2)."""
        (west, south), (east, north) = places_en_m.min(axis=0).tolist(), places_en_m.max(axis=0).tolist()
        return cls(west, south, east, north)

    @property
    def extent_m(self) -> float:
        return max(self.east - self.west, self.north - self.south)

    def wider(self, margin_m: float) -> Area:
        return Area(self.west - margin_m, self.south - margin_m, self.east + margin_m, self.north + margin_m)

    def distance_m(self, other: Area) -> float:
        """Return the distance to another rectangle, 0 if they overlap."""
        east = max(other.west - self.east, self.west - other.east, 0.0)
        north = max(other.south - self.north, self.south - other.north, 0.0)
        return math.hypot(east, north)


@dataclass(frozen=True, slots=True)
class Chart:
    """The part of a chart that is near a track."""

    path: Path
    area: Area
    shapes: tuple[ChartShape, ...] = ()
    """Polygons first, then lines, then points, in the order of the file."""
    tiles: tuple[ChartTile, ...] = ()


def read_chart(path: Path, origin: Origin | None, track_en_m: Floats) -> Chart:
    """Return the chart in a file or a folder, around a track (N, 2) in metres east and north of the origin.

    Raises LogError for a file that is not a chart, for coordinates that are not degrees of WGS84, for a chart that does
    not reach the track, and for a track whose origin on the Earth is unknown.
    """
    if origin is None:
        raise LogError(f"{path}: cannot be drawn below a log without positions on the Earth; give a log with them")
    track = Area.around(track_en_m)
    area = track.wider(max(MARGIN * track.extent_m, LEAST_MARGIN_M))
    frame = LocalFrame(*origin)
    if path.is_dir() or path.suffix.lower() == ".mbtiles":
        low, high = (_geodetic(frame, *corner) for corner in ((area.west, area.south), (area.east, area.north)))
        found = read_tiles(path, low, high)
        tiles = tuple(tile.placed(*_metres(frame, tile.corners_deg())) for tile in found.tiles)
        if not tiles:
            raise _far_away(path, Area.around(_metres(frame, found.bounds_deg)), track)
        return Chart(path, area, tiles=tiles)
    features = read_features(path)
    shapes = [feature.placed([_metres(frame, ring) for ring in feature.rings_deg]) for feature in features]
    bounds = [Area.around(np.concatenate(shape.rings_en_m)) for shape in shapes]
    nearest = min(track.distance_m(around) for around in bounds)
    if nearest > max(FARTHEST_M, track.extent_m):
        closest = min(bounds, key=track.distance_m)
        swapped = [ring[:, ::-1] for feature in features for ring in feature.rings_deg]
        valid = [ring for ring in swapped if np.abs(ring[:, 1]).max() <= 90.0]
        near = any(track.distance_m(Area.around(_metres(frame, ring))) <= FARTHEST_M for ring in valid)
        raise _far_away(path, closest, track, near)
    near_shapes = [shape for shape, around in zip(shapes, bounds, strict=True) if area.distance_m(around) == 0.0]
    return Chart(path, area, tuple(sorted(near_shapes, key=lambda shape: shape.kind.order)))


def _far_away(path: Path, chart: Area, track: Area, swapped: bool = False) -> LogError:
    north = 0.5 * (chart.south + chart.north - track.south - track.north)
    east = 0.5 * (chart.west + chart.east - track.west - track.east)
    far = track.distance_m(chart)
    distance = f"{far / 1e3:.0f} km" if far >= 10e3 else f"{far / 1e3:.1f} km"
    bearing = round(math.degrees(math.atan2(east, north))) % 360
    hint = (
        "its positions are latitude, longitude; GeoJSON has longitude first"
        if swapped
        else "choose a chart of this place"
    )
    return LogError(f"{path}: is {distance} away from the track, at {bearing:03d}°; {hint}")


def _metres(frame: LocalFrame, places_deg: Floats) -> Floats:
    """Return places (N, 2), longitude and latitude, as metres east and north."""
    ned = frame.ned(places_deg[:, 1], places_deg[:, 0], np.full(len(places_deg), frame.altitude_m))
    return np.ascontiguousarray(ned[:, 1::-1])


def _geodetic(frame: LocalFrame, east_m: float, north_m: float) -> tuple[float, float]:
    """Return longitude and latitude of a place."""
    latitude, longitude, _ = frame.geodetic(np.array([[north_m, east_m, 0.0]]))
    return float(longitude[0]), float(latitude[0])
