"""Charts below a track: GeoJSON and tiles about an origin, and one sentence for what is no chart of this place."""

from __future__ import annotations

import io
import json
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pyproj import Transformer

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.charts.chart import read_chart
from xitl_cli.logs.charts.features import ShapeKind
from xitl_cli.logs.charts.tiles import MOST_TILES, tile_at, tile_corner
from xitl_cli.logs.model.errors import LogError

ORIGIN = (-8.8, -63.95, 70.0)
TRACK = np.array([[0.0, 0.0], [100.0, 50.0]])


def degrees(*places_en_m: tuple[float, float]) -> list[list[float]]:
    """Longitude and latitude, by PROJ's topocentric conversion."""
    back = Transformer.from_pipeline(
        "+proj=pipeline +step +inv +proj=topocentric +lat_0=-8.8 +lon_0=-63.95 +h_0=70 +ellps=WGS84 "
        "+step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    return [list(back.transform(east, north, 0.0))[:2] for east, north in places_en_m]


def feature(kind: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def geojson(folder: Path, *features: dict[str, Any]) -> Path:
    path = folder / "chart.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")
    return path


def tile_image(colour: tuple[int, int, int]) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (8, 8), colour).save(out, "PNG")
    return out.getvalue()


def test_features_are_in_metres_about_the_origin_with_their_style(tmp_path: Path) -> None:
    square = [(-50.0, -20.0), (150.0, -20.0), (150.0, 80.0), (-50.0, -20.0)]
    path = geojson(
        tmp_path,
        feature("Point", degrees((30.0, 40.0))[0], name="buoy", **{"marker-color": "#f00"}),
        feature("LineString", degrees((0.0, 0.0), (10.0, 20.0)), stroke="0a0b0c", **{"stroke-width": 3}),
        feature("Polygon", [degrees(*square), degrees((0, 0), (5, 0), (5, 5), (0, 0))], fill="#123456"),
        feature("MultiPoint", degrees((5000.0, 0.0), (1.0, 2.0))),
        {"type": "Feature", "properties": None, "geometry": None},
    )
    chart = read_chart(path, ORIGIN, TRACK)
    assert [shape.kind for shape in chart.shapes] == [ShapeKind.POLYGON, ShapeKind.LINE, *[ShapeKind.POINT] * 2]
    polygon, line, buoy, _ = chart.shapes  # the point that is 5 km away is omitted
    assert polygon.rings_en_m[0] == pytest.approx(np.array(square), abs=1e-3)
    assert len(polygon.rings_en_m) == 2
    assert (polygon.style.fill, polygon.style.fill_opacity) == ("#123456", 0.6)  # simplestyle-spec's default
    assert line.rings_en_m[0] == pytest.approx(np.array([(0.0, 0.0), (10.0, 20.0)]), abs=1e-3)
    assert (line.style.stroke, line.style.stroke_width_px) == ("#0a0b0c", 3.0)
    assert (buoy.style.name, buoy.style.marker) == ("buoy", "#ff0000")
    assert (chart.area.west, chart.area.east) == (-100.0, 200.0)


@pytest.mark.parametrize(
    ("features", "sentence"),
    [
        ([feature("Point", [437512.0, 9027000.0])], r"features.0.geometry.coordinates: \[437512, 9.027e\+06\] is not "
         r"longitude and latitude in degrees of WGS84; convert the file to EPSG:4326"),
        ([feature("LineString", [[1.0, 2.0], ["a", 3.0]])], r"\['a', 3.0\] is not a position; write \[longitude, lat"),
        ([feature("Point", degrees((0.0, 0.0))[0], fill="blueish")], "properties.fill: 'blueish' is not a colour"),
        ([feature("Point", degrees((0.0, 0.0))[0], **{"fill-opacity": 7})], "fill-opacity: '7' is not a number from 0"),
        ([feature("Circle", [0.0, 0.0])], "type is 'Circle', which is not of GeoJSON"),
        ([feature("Polygon", 3)], "coordinates is not a list"),
        ([], "has no polygon, line or point"),
        ([feature("Point", [-63.95, -7.9])], r"is 99 km away from the track, at 000°; choose a chart of this place"),
        ([feature("Point", degrees((0.0, 0.0))[0][::-1])], "km away .* are latitude, longitude; GeoJSON has longitude"),
    ],
)  # fmt: skip
def test_what_is_no_chart_of_this_place_is_one_sentence(
    tmp_path: Path, features: Sequence[dict[str, Any]], sentence: str
) -> None:
    path = geojson(tmp_path, *features)
    with pytest.raises(LogError, match=sentence) as caught:
        read_chart(path, ORIGIN, TRACK)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [("chart.geojson", b"{"), ("chart.geojson", b"\x89PNG"), ("chart.mbtiles", b"no database" * 99)],
)
def test_another_kind_of_file_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=r"is no chart; give GeoJSON|is damaged at line 1 |is not an MBTiles file"):
        read_chart(tmp_path / name, ORIGIN, TRACK)


@pytest.mark.parametrize("name", ["missing.geojson", "missing.mbtiles"])
def test_a_missing_file_is_refused_and_not_made(tmp_path: Path, name: str) -> None:
    with pytest.raises(LogError, match=name):
        read_chart(tmp_path / name, ORIGIN, TRACK)
    assert not (tmp_path / name).exists()


def test_a_chart_in_another_reference_system_is_refused(tmp_path: Path) -> None:
    path = geojson(tmp_path, feature("Point", [0.0, 0.0]))
    document = {**json.loads(path.read_text()), "crs": {"type": "name", "properties": {"name": "EPSG:31983"}}}
    path.write_text(json.dumps(document))
    with pytest.raises(LogError, match="crs is not WGS84"):
        read_chart(path, ORIGIN, TRACK)


def test_a_log_without_an_origin_has_no_chart(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="positions on the Earth"):
        read_chart(geojson(tmp_path, feature("Point", [0.0, 0.0])), None, TRACK)


def mercator(zoom: int, column: int, row: int) -> tuple[float, float]:
    """Longitude and latitude of a tile's north-west corner, by PROJ."""
    half = 20037508.342789244
    size = 2.0 * half / 2**zoom
    back = Transformer.from_crs("EPSG:3857", "EPSG:4326", always_xy=True)
    longitude, latitude = back.transform(column * size - half, half - row * size)
    return float(longitude), float(latitude)


def test_tile_corners_are_those_of_web_mercator() -> None:
    for zoom, column, row in ((0, 0, 0), (5, 10, 17), (18, 84503, 137524)):
        corner = tile_corner(zoom, column, row)
        assert corner == pytest.approx(mercator(zoom, column, row), abs=1e-9)
        if row:
            assert tile_at(zoom, corner) == pytest.approx((column, row), abs=1e-6)


def tiles_around(zoom: int) -> list[tuple[int, int]]:
    column, row = (int(part) for part in tile_at(zoom, (ORIGIN[1], ORIGIN[0])))
    return [(column + across, row + down) for across in (-1, 0, 1) for down in (-1, 0, 1)]


@pytest.mark.parametrize("kind", ["folder", "mbtiles"])
def test_tiles_of_a_folder_and_of_mbtiles_are_placed_on_the_ground(tmp_path: Path, kind: str) -> None:
    wanted = {
        (zoom, *tile): tile_image((zoom, 10 * number, 0))
        for zoom in (10, 17, 22)
        for number, tile in enumerate(tiles_around(zoom))
    }
    if kind == "folder":
        path = tmp_path / "tiles"
        for (zoom, column, row), image in wanted.items():
            file = path / str(zoom) / str(column) / f"{row}.png"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(image)
    else:
        path = tmp_path / "chart.mbtiles"
        with closing(sqlite3.connect(path)) as base, base:
            base.execute("CREATE TABLE metadata (name text, value text)")
            base.execute("CREATE TABLE tiles (zoom_level int, tile_column int, tile_row int, tile_data blob)")
            rows = [(zoom, column, 2**zoom - 1 - row, image) for (zoom, column, row), image in wanted.items()]
            base.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", rows)
    chart = read_chart(path, ORIGIN, TRACK)
    assert {tile.zoom for tile in chart.tiles} == {17}  # zoom 22 needs too many tiles
    assert 0 < len(chart.tiles) <= MOST_TILES
    frame = LocalFrame(*ORIGIN)
    for tile in chart.tiles:
        assert tile.image == wanted[tile.zoom, tile.column, tile.row]
        longitude, latitude = mercator(tile.zoom, tile.column, tile.row)
        north, east, _ = frame.ned(np.array([latitude]), np.array([longitude]), np.array([70.0]))[0].tolist()
        assert (tile.west_m, tile.north_m) == pytest.approx((east, north), abs=0.01)
    assert min(tile.west_m for tile in chart.tiles) <= TRACK[0, 0]
    with pytest.raises(LogError, match=r"is 1\d\d km away from the track, at 180°"):
        read_chart(path, (ORIGIN[0] + 1.0, *ORIGIN[1:]), TRACK)


def test_vector_tiles_empty_folders_and_broken_tiles_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "chart.mbtiles"
    with closing(sqlite3.connect(path)) as base, base:
        base.execute("CREATE TABLE metadata (name text, value text)")
        base.execute("INSERT INTO metadata VALUES ('format', 'pbf')")
    with pytest.raises(LogError, match="has vector tiles"):
        read_chart(path, ORIGIN, TRACK)
    with pytest.raises(LogError, match="has no tiles; a folder of tiles has files"):
        read_chart(tmp_path, ORIGIN, TRACK)
    column, row = tiles_around(17)[4]
    (tmp_path / "17" / str(column)).mkdir(parents=True)
    (tmp_path / "17" / str(column) / f"{row}.png").write_bytes(b"<html>")
    with pytest.raises(LogError, match=rf"tile 17/{column}/{row} is no PNG, JPEG or WebP"):
        read_chart(tmp_path, ORIGIN, TRACK)
    with (tmp_path / "17" / str(column) / f"{row}.png").open("r+b") as tile:
        tile.truncate(17 << 20)
    with pytest.raises(LogError, match=r"\.png: cannot be read \(has more than 16 MiB\); give readable tiles"):
        read_chart(tmp_path, ORIGIN, TRACK)
