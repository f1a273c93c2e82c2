"""Where a click on the picture meets the water."""

from __future__ import annotations

import pytest

from xitl_cli.plugins.view.controls import water_place


@pytest.mark.parametrize(
    ("origin", "direction", "level_m", "place"),
    [
        ((3.0, 7.0, 10.0), (0.0, 0.0, -1.0), 0.0, (7.0, 3.0)),  # straight down: east, north, up in; north, east out
        ((0.0, 0.0, 10.0), (0.6, 0.0, -0.8), 0.0, (0.0, 7.5)),
        ((0.0, 0.0, 10.0), (0.6, 0.0, -0.8), 2.0, (0.0, 6.0)),
        ((0.0, 0.0, 10.0), (1.0, 0.0, 0.0), 0.0, None),  # along the horizon
        ((0.0, 0.0, 10.0), (0.0, 0.6, 0.8), 0.0, None),  # into the sky
        ((0.0, 0.0, -1.0), (0.0, 0.0, -1.0), 0.0, None),  # from under water
        ((0.0, 0.0, 1.0), (1.0, 0.0, -1e-4), 0.0, None),  # ten kilometres away
    ],
)
def test_a_ray_meets_the_water(
    origin: tuple[float, ...], direction: tuple[float, ...], level_m: float, place: tuple[float, float] | None
) -> None:
    assert water_place(origin, direction, level_m) == (None if place is None else pytest.approx(place))
