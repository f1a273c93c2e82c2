"""Colours of depth and temperature: a scale from black over red to yellow."""

from __future__ import annotations

import math
from io import BytesIO

import numpy as np
import pytest

from xitl_cli.record.image_colours import coloured_depth, coloured_temperature, picture_of_file

BLACK, MIDDLE, BRIGHTEST = [0, 0, 4], [184, 59, 80], [252, 255, 164]


def test_depth_is_bright_near_and_black_far_on_a_logarithmic_scale() -> None:
    depths_m = [0.1, 0.5, math.sqrt(0.5 * 500.0), 500.0, 2000.0, math.inf, math.nan]
    picture = coloured_depth(np.array([depths_m], dtype=np.float32))
    assert picture.dtype == np.uint8
    expected = [BRIGHTEST, BRIGHTEST, MIDDLE, BLACK, BLACK, BLACK, BLACK]
    assert picture[0].tolist() == pytest.approx(np.array(expected), abs=1)


def test_temperature_is_scaled_from_the_first_to_the_last_percentile() -> None:
    """In 0.01 K: 20 to 40 degrees above 280 K, with a single hotter point, which does not move the scale."""
    temperatures = np.linspace(28_000, 30_000, 101).repeat(10).reshape(10, 101).astype(np.uint16)
    temperatures[0, 50] = 60_000
    colours = coloured_temperature(temperatures).reshape(-1, 3).tolist()
    shown = dict(zip(temperatures.ravel().tolist(), colours, strict=True))
    assert shown[28_000] == BLACK
    assert shown[29_000] == pytest.approx(np.array(MIDDLE), abs=3)
    assert shown[30_000] == BRIGHTEST
    assert shown[60_000] == BRIGHTEST


def test_a_picture_of_even_temperature_shows_no_noise() -> None:
    """The scale spans at least 5 K, so that noise of 0.02 K is a hundredth of it at most."""
    temperatures = np.tile(np.array([29_000, 29_002], dtype=np.uint16), (4, 8))
    picture = coloured_temperature(temperatures).astype(int)
    assert np.ptp(picture, axis=(0, 1)).max() <= 3
    assert picture[0, 0].tolist() == pytest.approx(np.array(MIDDLE), abs=3)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "P", "I;16"])
def test_the_picture_of_a_file_has_its_colours_or_those_of_its_temperatures(mode: str) -> None:
    """A PNG of 16 bits has temperatures, here of a ramp of 10 K. The others are grey."""
    image = pytest.importorskip("PIL.Image")
    ramp = np.linspace(0, 1, 64).reshape(8, 8)
    grey = np.rint(255 * ramp).astype(np.uint8)
    if mode == "I;16":
        temperatures = np.rint(29_000 + 1000 * ramp).astype(np.uint16)
        made, expected = image.fromarray(temperatures), coloured_temperature(temperatures)
    else:
        made, expected = image.fromarray(grey).convert(mode), np.stack([grey] * 3, axis=-1)
    data = BytesIO()
    made.save(data, "png")
    picture = picture_of_file(data.getvalue())
    assert (picture.shape, picture.dtype) == ((8, 8, 3), np.uint8)
    np.testing.assert_array_equal(picture, expected)
    with pytest.raises(OSError, match="cannot identify"):
        picture_of_file(b"no image")
