"""Raster tiles of the Web Mercator projection: a folder {z}/{x}/{y}.png, or an MBTiles file (version 1.3)."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from agent.files import read_bytes
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.table import Floats

MOST_TILES = 24
"""Number of tiles that an area needs at most. The highest zoom with fewer tiles is drawn."""
MOST_ZOOM = 24
_KINDS = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}
Place = tuple[float, float]
"""Longitude and latitude, deg."""


@dataclass(frozen=True, slots=True)
class ChartTile:
    """An image of the ground."""

    zoom: int
    column: int
    row: int
    """From the north."""
    image: bytes
    media_type: str
    west_m: float = math.nan
    south_m: float = math.nan
    east_m: float = math.nan
    north_m: float = math.nan

    def corners_deg(self) -> Floats:
        """Return longitude and latitude (2, 2) of the south-west and the north-east corner."""
        return np.array(
            [tile_corner(self.zoom, self.column, self.row + 1), tile_corner(self.zoom, self.column + 1, self.row)]
        )

    def placed(self, south_west_en_m: Floats, north_east_en_m: Floats) -> ChartTile:
        """Return the tile with its sides in metres."""
        (west, south), (east, north) = south_west_en_m.tolist(), north_east_en_m.tolist()
        return replace(self, west_m=west, south_m=south, east_m=east, north_m=north)


@dataclass(frozen=True, slots=True)
class FoundTiles:
    """Tiles of an area, and the bounds of all tiles of that zoom."""

    tiles: tuple[ChartTile, ...]
    bounds_deg: Floats
    """(2, 2), south-west and north-east: longitude and latitude."""


def tile_corner(zoom: int, column: float, row: float) -> Place:
    """Return longitude and latitude of the north-west corner of a tile."""
    turn = math.pi * (1.0 - 2.0 * row / 2.0**zoom)
    return 360.0 * column / 2.0**zoom - 180.0, math.degrees(math.atan(math.sinh(turn)))


def tile_at(zoom: int, place: Place) -> tuple[float, float]:
    """Return column and row of a place, with fractions. Latitudes beyond the projection are moved to its edge."""
    longitude, latitude = place
    sine = math.sin(math.radians(max(-85.05, min(85.05, latitude))))
    count = 2.0**zoom
    return (longitude + 180.0) / 360.0 * count, (0.5 - math.atanh(sine) / math.tau) * count


def read_tiles(path: Path, south_west: Place, north_east: Place) -> FoundTiles:
    """Return the tiles of an area, at the highest zoom that needs at most MOST_TILES.

    Raises LogError for a folder without tiles, for a file that is not MBTiles, and for tiles that cannot be read or are
    no images.
    """
    try:
        if path.is_dir():
            return _of_folder(path, south_west, north_east)
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as base:
            return _of_mbtiles(path, base, south_west, north_east)
    except OSError as error:
        raise LogError(f"{error.filename}: cannot be read ({error.strerror}); give readable tiles") from error
    except (sqlite3.Error, UnicodeError, MemoryError) as error:  # SQLite runs out of memory by a damaged length
        raise LogError(f"{path}: is not an MBTiles file ({error}); give one with raster tiles") from error


def _of_folder(path: Path, south_west: Place, north_east: Place) -> FoundTiles:
    def numbers(folder: Path) -> list[int]:
        return sorted(int(below.stem) for below in folder.iterdir() if below.stem.isdecimal())

    zooms = [zoom for zoom in numbers(path) if zoom <= MOST_ZOOM and (path / str(zoom)).is_dir()]
    columns = {zoom: numbers(path / str(zoom)) for zoom in zooms}
    zooms = [zoom for zoom in zooms if columns[zoom]]
    if not zooms:
        raise LogError(f"{path}: has no tiles; a folder of tiles has files {{z}}/{{x}}/{{y}}.png")

    def image(zoom: int, column: int, row: int) -> bytes | None:
        for suffix in (".png", ".jpg", ".jpeg", ".webp"):
            file = path / str(zoom) / str(column) / f"{row}{suffix}"
            if file.is_file():
                return read_bytes(file)
        return None

    def bounds(zoom: int) -> tuple[int, int, int, int]:
        rows = [row for column in columns[zoom] for row in numbers(path / str(zoom) / str(column))]
        if not rows:
            raise LogError(f"{path / str(zoom)}: has no tiles; a folder of tiles has files {{z}}/{{x}}/{{y}}.png")
        return columns[zoom][0], min(rows), columns[zoom][-1], max(rows)

    return _chosen(path, zooms, image, bounds, south_west, north_east)


_USABLE = f"""
CREATE TEMP VIEW usable AS SELECT zoom_level, tile_column, tile_row, tile_data FROM tiles
WHERE typeof(zoom_level) = 'integer' AND zoom_level BETWEEN 0 AND {MOST_ZOOM} AND typeof(tile_data) = 'blob'
AND typeof(tile_column) = 'integer' AND tile_column BETWEEN 0 AND (1 << zoom_level) - 1
AND typeof(tile_row) = 'integer' AND tile_row BETWEEN 0 AND (1 << zoom_level) - 1
"""


def _of_mbtiles(path: Path, base: sqlite3.Connection, south_west: Place, north_east: Place) -> FoundTiles:
    kind = base.execute("SELECT value FROM metadata WHERE name = 'format'").fetchone()
    if kind is not None and kind[0] == "pbf":
        raise LogError(f"{path}: has vector tiles; give an MBTiles file with raster tiles (png, jpg or webp)")
    base.execute(_USABLE)
    zooms = [row[0] for row in base.execute("SELECT DISTINCT zoom_level FROM usable ORDER BY 1")]
    if not zooms:
        raise LogError(f"{path}: has no tiles; give another MBTiles file")

    def image(zoom: int, column: int, row: int) -> bytes | None:
        # MBTiles counts rows from the south.
        found = base.execute(
            "SELECT tile_data FROM usable WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
            (zoom, column, 2**zoom - 1 - row),
        ).fetchone()
        return None if found is None else bytes(found[0])

    def bounds(zoom: int) -> tuple[int, int, int, int]:
        query = (
            "SELECT min(tile_column), min(tile_row), max(tile_column), max(tile_row) FROM usable WHERE zoom_level = ?"
        )
        west, south, east, north = base.execute(query, (zoom,)).fetchone()
        return west, 2**zoom - 1 - north, east, 2**zoom - 1 - south

    return _chosen(path, zooms, image, bounds, south_west, north_east)


def _chosen(
    path: Path,
    zooms: list[int],
    image: Callable[[int, int, int], bytes | None],
    bounds: Callable[[int], tuple[int, int, int, int]],
    south_west: Place,
    north_east: Place,
) -> FoundTiles:
    def ranges(zoom: int) -> tuple[range, range]:
        (west, south), (east, north) = tile_at(zoom, south_west), tile_at(zoom, north_east)
        return range(math.floor(west), math.floor(east) + 1), range(math.floor(north), math.floor(south) + 1)

    few = [zoom for zoom in zooms if math.prod(map(len, ranges(zoom))) <= MOST_TILES]
    zoom = few[-1] if few else zooms[0]
    columns, rows = ranges(zoom)
    tiles = []
    for column in columns[:MOST_TILES]:
        for row in rows[:MOST_TILES]:
            data = image(zoom, column, row)
            if data is None:
                continue
            kind = next((kind for beginning, kind in _KINDS.items() if data.startswith(beginning)), None)
            if kind is None:
                raise LogError(f"{path}: tile {zoom}/{column}/{row} is no PNG, JPEG or WebP image; give raster tiles")
            tiles.append(ChartTile(zoom, column, row, data, kind))
    west, north, east, south = bounds(zoom)
    around = np.array([tile_corner(zoom, west, south + 1), tile_corner(zoom, east + 1, north)])
    return FoundTiles(tuple(tiles), around)
