"""The image of a chart on the water, and its nodes in a scene."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from xitl_cli.logs.charts.chart import Area, Chart
from xitl_cli.logs.charts.features import ChartShape, ChartStyle, ShapeKind
from xitl_cli.logs.charts.tiles import ChartTile
from xitl_cli.plugins.view.chart_drawing import add_chart, chart_image

AREA = Area(-100.0, -100.0, 100.0, 100.0)
pytest.importorskip("PIL")


def square(half_m: float) -> np.ndarray:
    return half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])


def at(image: np.ndarray, east_m: float, north_m: float) -> list[int]:
    """RGBA of a place."""
    rows, columns = image.shape[:2]
    found = image[int((100.0 - north_m) / 200.0 * rows), int((east_m + 100.0) / 200.0 * columns)]
    return [int(part) for part in found]


def test_shapes_are_where_they_belong_and_holes_are_clear() -> None:
    style = ChartStyle("shoal", fill="#ff0000", fill_opacity=1.0, stroke="#00ff00", stroke_width_px=3.0)
    polygon = ChartShape(ShapeKind.POLYGON, (square(60.0), square(20.0)), style)
    buoy = ChartShape(ShapeKind.POINT, (np.array([[80.0, -40.0]]),), ChartStyle(marker="#0000ff"))
    image = chart_image(Chart(Path("chart"), AREA, (polygon, buoy)))
    assert at(image, 40.0, 0.0) == [255, 0, 0, 255]
    assert at(image, 60.0, 30.0) == [0, 255, 0, 255]
    assert at(image, 0.0, 0.0)[3] == 0
    assert at(image, -90.0, 90.0)[3] == 0
    assert at(image, 80.0, -40.0) == [0, 0, 255, 255]


def test_tiles_are_stretched_to_their_place_and_broken_ones_omitted() -> None:
    image_module = pytest.importorskip("PIL.Image")
    out = io.BytesIO()
    image_module.new("RGB", (4, 4), (10, 200, 30)).save(out, "PNG")
    good = ChartTile(17, 0, 0, out.getvalue(), "image/png", 0.0, 0.0, 50.0, 150.0)
    broken = ChartTile(17, 0, 1, out.getvalue()[:40], "image/png", -50.0, -50.0, 0.0, 0.0)
    image = chart_image(Chart(Path("chart"), AREA, tiles=(good, broken)))
    assert at(image, 25.0, 50.0) == [10, 200, 30, 255]
    assert at(image, 60.0, 50.0)[3] == at(image, -25.0, -25.0)[3] == 0


@dataclass
class Scene:
    """Stands in for viser's scene; keeps what is added."""

    added: dict[str, dict[str, Any]] = field(default_factory=dict)

    def _add(self, path: str, *values: Any, **keys: Any) -> Any:
        self.added[path] = {"values": values, **keys}
        return SimpleNamespace(visible=True)

    add_frame = add_image = add_label = _add


def test_the_image_lies_north_up_on_its_area_and_names_are_labels() -> None:
    scene = Scene()
    buoy = ChartShape(ShapeKind.POINT, (np.array([[80.0, -40.0]]),), ChartStyle("buoy 3"))
    add_chart(scene, Chart(Path("chart"), Area(-100.0, -50.0, 300.0, 150.0), (buoy,)), 1.5)
    image = scene.added["/chart/image"]
    assert image["values"][1:] == (400.0, 200.0)
    assert image["position"] == (100.0, 50.0, 1.5)
    label = scene.added["/chart/name 0"]
    assert label["values"] == ("buoy 3",)
    assert label["position"][:2] == (80.0, -40.0)
