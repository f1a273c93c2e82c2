"""Tiles of a chart, several files as one log, and sizes of CDR elements, each by a rule of its own."""

from __future__ import annotations

import sqlite3
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.charts.tiles import ChartTile, read_tiles, tile_at, tile_corner
from xitl_cli.logs.formats.mcap.cdr import (
    CDR,
    ROS1,
    CdrArray,
    CdrNumber,
    CdrStruct,
    CdrTime,
    end_of_elements,
    has_fixed_size,
)
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.joined import JoinedLog, joined_tables
from xitl_cli.logs.model.log import Damage, LogHealth
from xitl_cli.logs.model.table import Column

PNG, JPEG = b"\x89PNG-of-a-tile", b"\xff\xd8\xff-of-a-tile"


# Tiles


@pytest.mark.parametrize(
    ("zoom", "column", "row", "place"),
    [
        (0, 0, 0, (-180.0, 85.0511288)), (0, 1, 1, (180.0, -85.0511288)), (1, 1, 1, (0.0, 0.0)),
        # The tile with Berlin, as OpenStreetMap's wiki has it (Slippy map tilenames)
        (7, 63, 42, (-2.8125, 52.4827802)),
    ],
)  # fmt: skip
def test_corners_of_tiles(zoom: int, column: int, row: int, place: tuple[float, float]) -> None:
    assert tile_corner(zoom, column, row) == pytest.approx(place, abs=1e-7)
    assert tile_at(zoom, place) == pytest.approx((column, row), abs=1e-3 if zoom == 0 else 1e-6)
    corners = ChartTile(zoom, column, row, PNG, "image/png").corners_deg()
    assert corners[:, 0] == pytest.approx([place[0], place[0] + 360.0 / 2**zoom])
    assert corners[1, 1] == pytest.approx(place[1], abs=1e-7)
    assert corners[0, 1] < corners[1, 1]


def test_sides_of_a_tile_in_metres() -> None:
    tile = ChartTile(1, 0, 0, PNG, "image/png").placed(np.array([-5.0, -7.0]), np.array([11.0, 13.0]))
    assert (tile.west_m, tile.south_m, tile.east_m, tile.north_m) == (-5.0, -7.0, 11.0, 13.0)


def folder(path: Path, *tiles: tuple[int, int, int], data: bytes = PNG, suffix: str = "png") -> Path:
    for zoom, column, row in tiles:
        place = path / str(zoom) / str(column)
        place.mkdir(parents=True, exist_ok=True)
        (place / f"{row}.{suffix}").write_bytes(data)
    return path


def mbtiles(path: Path, *tiles: tuple[int, int, int], data: bytes = PNG) -> Path:
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE metadata (name, value)")
        base.execute("CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data)")
        rows = [(zoom, column, 2**zoom - 1 - row, data) for zoom, column, row in tiles]
        base.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", rows)
        base.commit()
    return path


def chosen(path: Path, south_west: tuple[float, float], north_east: tuple[float, float]) -> list[tuple[int, int, int]]:
    return [(tile.zoom, tile.column, tile.row) for tile in read_tiles(path, south_west, north_east).tiles]


MANY = [
    (zoom, column, row)
    for zoom in (3, 5, 8)
    for column in range(2**zoom // 2, 2**zoom // 2 + 8)
    for row in range(2**zoom // 2 - 8, 2**zoom // 2)
    if row >= 0
]


@pytest.mark.parametrize("make", [folder, mbtiles])
def test_an_area_is_drawn_at_the_highest_zoom_with_few_tiles(make: Any, tmp_path: Path) -> None:
    path = make(tmp_path / "tiles", *MANY)
    deg = 360.0 / 2**8
    # Four by six tiles of zoom 8 are 24, four by seven are more.
    assert {zoom for zoom, *_ in chosen(path, (0.1, 0.1), (3.9 * deg, 5.9 * deg))} == {8}
    assert {zoom for zoom, *_ in chosen(path, (0.1, 0.1), (3.9 * deg, 6.9 * deg))} == {5}
    assert chosen(path, (0.1, 0.1), (0.2, 0.2)) == [(8, 128, 127)]
    assert chosen(path, (0.1, 0.1), (1.2 * deg, 0.2)) == [(8, 128, 127), (8, 129, 127)]
    assert chosen(path, (0.1, 0.1), (0.2, 1.2 * deg)) == [(8, 128, 126), (8, 128, 127)]
    found = read_tiles(path, (0.1, 0.1), (0.2, 0.2))
    assert found.bounds_deg[0] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert found.bounds_deg[1] == pytest.approx(tile_corner(8, 136, 120))
    assert found.tiles[0].media_type == "image/png"


def test_an_area_that_needs_many_tiles_at_every_zoom_has_the_lowest(tmp_path: Path) -> None:
    path = folder(tmp_path / "tiles", (8, 128, 127), (9, 256, 255), (9, 257, 255))
    assert chosen(path, (-90.0, -60.0), (90.0, 60.0)) == []  # the first 24 by 24 tiles, of which there are none
    assert chosen(path, (0.1, 0.1), (30.0, 30.0)) == [(8, 128, 127)]
    assert chosen(path, (0.1, 0.1), (36.0, 0.2)) == [(8, 128, 127)]


def test_tiles_that_are_missing_are_left_out(tmp_path: Path) -> None:
    path = folder(tmp_path / "tiles", (8, 128, 127), (8, 130, 127), data=JPEG, suffix="jpg")
    deg = 360.0 / 2**8
    found = read_tiles(path, (0.1, 0.1), (2.5 * deg, 0.2))
    assert [(tile.column, tile.media_type) for tile in found.tiles] == [(128, "image/jpeg"), (130, "image/jpeg")]


def test_what_is_no_tile_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="tile 8/128/127 is no PNG, JPEG or WebP image"):
        read_tiles(folder(tmp_path / "a", (8, 128, 127), data=b"GIF89a"), (0.1, 0.1), (0.2, 0.2))
    with pytest.raises(LogError, match="has no tiles"):
        read_tiles(folder(tmp_path / "b", (25, 1, 1)), (0.1, 0.1), (0.2, 0.2))  # deeper than any map
    with closing(sqlite3.connect(mbtiles(tmp_path / "c"))) as base:
        base.execute("INSERT INTO metadata VALUES ('format', 'pbf')")
        base.commit()
    with pytest.raises(LogError, match="has vector tiles"):
        read_tiles(tmp_path / "c", (0.1, 0.1), (0.2, 0.2))


# Several files as one log


def tables() -> tuple[dict[str, MadeTable], dict[str, MadeTable]]:
    first = {
        "A": MadeTable(
            "A", [1, 2], {"x": [1.0, 2.0], "t": ["a", "b"], "v": [[1.0, 2.0], [3.0, 4.0]], "one": [1, 2]}, place=[3, 5]
        ),
        "B": MadeTable("B", [1], {"x": [7]}),
    }
    second = {
        "A": MadeTable("A", [3], {"x": [3.0], "t": ["c"], "v": [[5.0, 6.0, 7.0]]}, place=[4]),
        "C": MadeTable("C", [9], {"x": [8]}),
    }
    return first, second


def test_topics_of_several_files_are_joined() -> None:
    joined = joined_tables(tables(), [0, 1 << 44])  # type: ignore[arg-type]
    assert list(joined) == ["A", "B", "C"]
    table = joined["A"]
    assert list(table.columns) == ["x", "t", "v"]  # those that all files have
    assert table.columns["v"] == Column("v", shape=(-1,))
    assert (len(table), table.indexed_rows, table.stamp_ns.tolist()) == (3, 3, [1, 2, 3])
    assert table.file_offset.tolist() == [3, 5, (1 << 44) + 4]
    assert table.values("x").tolist() == [1.0, 2.0, 3.0]
    assert table.values("x", np.array([2, 0, 2])).tolist() == [3.0, 1.0, 3.0]
    assert table.values("t", slice(1, None)).tolist() == ["b", "c"]
    np.testing.assert_array_equal(table.values("v"), [[1, 2, np.nan], [3, 4, np.nan], [5, 6, 7]])
    np.testing.assert_array_equal(table.values("v", np.array([1]))[:, :2], [[3, 4]])  # no row of the second file
    assert table.values("v", np.array([], dtype=np.intp)).shape[0] == 0
    assert table.values("x", np.array([True, False, True])).tolist() == [1.0, 3.0]
    assert joined["B"].values("x").tolist() == [7]


def test_a_joined_log_has_the_health_and_the_span_of_its_files() -> None:
    one, other = (
        MadeLog(MadeTable("A", [5, 9], {"x": [1, 2]}), kind="mcap"),
        MadeLog(MadeTable("A", [7, 20], {"x": [1, 2]}), kind="mcap"),
    )
    one.health = LogHealth(100, 5, 1, (Damage(3, 4, "x"),), 4, 2, 7, undecoded={"q": (2, "why")}, back_in_time=1)
    other.health = LogHealth(50, 6, unclosed=True, undecoded={"q": (3, "why"), "r": (1, "so")}, redefined=2)
    one.facts = {"seed": "1"}
    log = JoinedLog(Path("a.mcap"), [one, other], ["the second file is missing"], ExitStack())
    assert log.span_ns == (5, 20)
    health = log.health
    assert (health.size_bytes, health.records, health.damaged, health.lost_bytes) == (150, 11, 2, 4)
    assert [damage.why for damage in health.damage] == ["x", "the second file is missing"]
    assert (health.suspect, health.truncated_bytes, health.unclosed) == (2, 7, True)
    assert (health.back_in_time, health.redefined) == (1, 2)
    assert health.undecoded == {"q": (5, "why"), "r": (1, "so")}
    assert log.facts == {"seed": "1", "files": "2"}
    assert JoinedLog(Path("a.mcap"), [MadeLog(), MadeLog()], [], ExitStack()).span_ns is None


# Sizes of CDR elements


DOUBLE, LONG, SHORT, BYTE = (
    CdrNumber(code, size, False) for code, size in (("f8", 8), ("i4", 4), ("i2", 2), ("u1", 1))
)


@pytest.mark.parametrize(
    ("node", "at", "count", "end"),
    [
        (BYTE, 5, 3, 8),
        (SHORT, 5, 1, 8),  # from 6, after the header of 4
        (LONG, 9, 2, 20),  # from 12
        (DOUBLE, 4, 2, 20),
        (DOUBLE, 5, 1, 20),  # from 12, eight after the header
        (DOUBLE, 13, 0, 13),
        (CdrTime(), 5, 1, 16),  # two of four bytes
        (CdrStruct((("a", BYTE), ("b", DOUBLE), ("c", BYTE))), 4, 1, 21),  # 1, 7 of padding, 8, 1
        (CdrStruct((("a", BYTE), ("b", DOUBLE), ("c", BYTE))), 4, 2, 37),  # then to 28, 8, 1
        (CdrStruct(()), 4, 3, 7),  # an empty message has a byte
        (CdrArray(SHORT, 3), 5, 1, 12),
        (CdrArray(SHORT, 0), 5, 1, 5),
        (CdrArray(CdrStruct((("a", LONG), ("b", BYTE))), 2), 4, 1, 17),  # 5, 3 of padding, 5
    ],
)
def test_the_end_of_elements_with_their_padding(node: Any, at: int, count: int, end: int) -> None:
    assert end_of_elements(node, at, count) == end
    many = end_of_elements(node, np.array([at, at + 8]), np.array([count, count]))
    assert np.asarray(many).tolist() == [end, end + 8]


def test_ros_1_has_no_padding() -> None:
    node = CdrStruct((("a", BYTE), ("b", DOUBLE), ("t", CdrTime()), ("c", CdrArray(SHORT, 3))))
    assert end_of_elements(node, 5, 2, ROS1) == 5 + 2 * (1 + 8 + 8 + 6)
    assert end_of_elements(CdrStruct(()), 5, 2, ROS1) == 5
    assert has_fixed_size(node)
    assert not has_fixed_size(CdrStruct((("s", CdrArray(BYTE, None)),)))
    assert (CDR.header, ROS1.header) == (4, 0)
