"""A chart on the water of a view: one image of its tiles and shapes, and labels with the names."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.charts.chart import Area, Chart
from xitl_cli.logs.charts.features import ChartShape, ShapeKind
from xitl_cli.plugins.view.model import Array

if TYPE_CHECKING:
    from PIL import Image

MOST_PIXELS = 1536
MARKER_M = 1.5
MOST_LABELS = 60
FACING_UP = (0.0, 1.0, 0.0, 0.0)
"""An image's axes are right, down and away from the viewer."""


def add_chart(api: Any, chart: Chart, up_m: float) -> Any:
    """Add a chart to a scene at a height, and return the node that shows or hides it."""
    area = chart.area
    node = api.add_frame("/chart", show_axes=False)
    api.add_image(
        "/chart/image",
        chart_image(chart),
        area.east - area.west,
        area.north - area.south,
        format="png",
        wxyz=FACING_UP,
        position=(0.5 * (area.west + area.east), 0.5 * (area.south + area.north), up_m),
        cast_shadow=False,
        receive_shadow=False,
    )
    named = [shape for shape in chart.shapes if shape.style.name][:MOST_LABELS]
    for number, shape in enumerate(named):
        east_m, north_m = _middle(shape, area)
        api.add_label(
            f"/chart/name {number}", shape.style.name, position=(east_m, north_m, up_m + 1.0), anchor="bottom-center"
        )
    return node


def chart_image(chart: Chart) -> NDArray[np.uint8]:
    """Return the chart as (H, W, 4), RGBA, north up. It is transparent where the chart has nothing.

    A tile that cannot be read as an image is omitted.
    """
    from PIL import Image, ImageDraw

    area = chart.area
    px_per_m = MOST_PIXELS / max(area.east - area.west, area.north - area.south)
    size = (max(round((area.east - area.west) * px_per_m), 1), max(round((area.north - area.south) * px_per_m), 1))
    whole = Image.new("RGBA", size)

    def pixels(places_en_m: Array) -> list[tuple[float, float]]:
        return [
            ((east - area.west) * px_per_m, (area.north - north) * px_per_m) for east, north in places_en_m.tolist()
        ]

    for tile in chart.tiles:
        image = _tile_image(tile.image)
        if image is not None:
            (left, top), (right, bottom) = pixels(np.array([[tile.west_m, tile.north_m], [tile.east_m, tile.south_m]]))
            sides = max(round(right) - round(left), 1), max(round(bottom) - round(top), 1)
            whole.paste(image.resize(sides), (round(left), round(top)))
    for shape in chart.shapes:
        layer = Image.new("RGBA", size)
        pen, style = ImageDraw.Draw(layer), shape.style
        rings = [pixels(ring) for ring in shape.rings_en_m]
        stroke, width = _rgba(style.stroke, style.stroke_opacity), max(round(style.stroke_width_px), 1)
        if shape.kind is ShapeKind.POLYGON:
            for number, ring in enumerate(rings):  # holes become transparent again
                if len(ring) > 2:
                    pen.polygon(ring, (0, 0, 0, 0) if number else _rgba(style.fill, style.fill_opacity))
        if shape.kind is ShapeKind.POINT:
            ((across, down),), half = rings[0], max(MARKER_M * px_per_m, 3.0)
            pen.ellipse((across - half, down - half, across + half, down + half), _rgba(style.marker, 1.0), "black")
        elif style.stroke_width_px > 0.0:
            for ring in rings:
                pen.line(ring, stroke, width)
        whole.alpha_composite(layer)
    return np.asarray(whole)


def _tile_image(data: bytes) -> Image.Image | None:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data)) as image:
            return image.convert("RGBA")
    except (OSError, ValueError, Image.DecompressionBombError):
        return None


def _rgba(colour: str, opacity: float) -> tuple[int, int, int, int]:
    red, green, blue = (int(colour[first : first + 2], 16) for first in (1, 3, 5))
    return red, green, blue, round(255 * opacity)


def _middle(shape: ChartShape, area: Area) -> tuple[float, float]:
    """Return the middle of the shape's bounds within the area."""
    ring = np.clip(shape.rings_en_m[0], (area.west, area.south), (area.east, area.north))
    east_m, north_m = (0.5 * (ring.min(axis=0) + ring.max(axis=0))).tolist()
    return east_m, north_m
