"""Drops of rain: numbers and speeds against published values, streaks against their closed form, and their picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core import frames
from sim_core.environment.waves import FlatWater
from sim_core.sensors.camera_spec import LensSpec
from sim_core.sensors.lens import Lens
from xitl_cli.plugins.cameras.daylight import daylight, visible_extinction_per_m
from xitl_cli.plugins.cameras.gimbal import ROT_FRD_OPTICAL
from xitl_cli.plugins.cameras.rain import Rain, fall_mps, number_per_m3_mm, streaks
from xitl_cli.plugins.cameras.renderer import SEA_ID, DrawnWorld, Renderer, Shot, Viewpoint

SIZE_PX, TANGENT = (640, 480), (0.8, 0.6)
FOCAL_PX = 400.0
LEVEL = frames.quat_to_matrix(frames.euler_to_quat(np.zeros(3))) @ ROT_FRD_OPTICAL


def rain(mmph: float = 50.0, exposure_s: float = 0.004, seed: int = 3, **changes: object) -> Rain:
    return replace(Rain(mmph, exposure_s, exposure_s, 0.0, np.zeros(3), seed), **changes)


def paths(falling: Rain, wind_ne_mps: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Return the velocities of drops across the view, (S, 2) in m/s, from their streaks, and their depths."""
    corners = streaks(falling, np.array(wind_ne_mps), LEVEL, SIZE_PX, TANGENT).astype(float)
    middle_px = 0.5 * (corners[:, 0, :2] + corners[:, 1, :2]), 0.5 * (corners[:, 2, :2] + corners[:, 3, :2])
    across_px = (middle_px[1] - middle_px[0]) * [320.0, 240.0]
    core = corners[:, 0, 5] / (corners[:, 0, 5] + 1.0)  # without the round ends
    depth_m = corners[:, 0, 2]
    return across_px * core[:, None] * depth_m[:, None] / FOCAL_PX / falling.exposure_s, depth_m


def test_drops_fall_as_gunn_and_kinzer_measured() -> None:
    diameter_mm = np.array([0.5, 1.0, 2.0, 3.0, 4.0, 5.0])
    measured_mps = np.array([2.06, 4.03, 6.49, 8.06, 8.83, 9.09])
    assert fall_mps(diameter_mm) == pytest.approx(measured_mps, rel=0.03)


@pytest.mark.parametrize("mmph", [2.0, 10.0, 50.0])
def test_the_drops_bring_the_rain(mmph: float) -> None:
    diameter_mm = np.linspace(0.1, 8.0, 800)
    volume_mm3 = np.pi / 6.0 * diameter_mm**3
    flux = number_per_m3_mm(diameter_mm, mmph) * np.maximum(fall_mps(diameter_mm), 0.0) * volume_mm3
    # Marshall and Palmer's fit is one of two coefficients: below 10 mm/h it brings up to a fifth more
    assert 3600e-6 * np.trapezoid(flux, diameter_mm) == pytest.approx(mmph, rel=0.2)


def test_a_streak_is_as_long_as_its_drop_falls_during_the_exposure() -> None:
    velocity, _ = paths(rain())
    assert len(velocity) > 500
    assert np.abs(velocity[:, 0]).max() < 1e-3
    assert velocity[:, 1].min() > fall_mps(np.array(0.5)) - 1e-3
    assert velocity[:, 1].max() < fall_mps(np.array(6.0)) + 1e-3


def test_wind_and_the_speed_of_the_camera_turn_streaks() -> None:
    windy, _ = paths(rain(), wind_ne_mps=(0.0, 5.0))
    moving, _ = paths(rain(camera_ned_mps=np.array([0.0, -5.0, 0.0])))
    assert windy[:, 0] == pytest.approx(5.0, abs=1e-3)
    assert moving == pytest.approx(windy, abs=1e-6)


def test_the_parts_of_an_exposure_continue_each_other() -> None:
    whole, first, second = (
        streaks(rain(part_s=part_s, after_s=after_s), np.array([1.0, 2.0]), LEVEL, SIZE_PX, TANGENT).astype(float)
        for part_s, after_s in ((0.004, 0.0), (0.002, -0.001), (0.002, 0.001))
    )
    assert len(whole) == len(first) == len(second)

    def ends(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the ends of the paths, without the round ends."""
        begin, end = corners[:, :2, :2].mean(axis=1), corners[:, 2:, :2].mean(axis=1)
        core = (corners[:, 0, 5] / (corners[:, 0, 5] + 1.0))[:, None]
        return 0.5 * (begin + end - core * (end - begin)), 0.5 * (begin + end + core * (end - begin))

    assert ends(first)[0] == pytest.approx(ends(whole)[0], abs=1e-4)
    assert ends(first)[1] == pytest.approx(ends(second)[0], abs=1e-4)
    assert ends(second)[1] == pytest.approx(ends(whole)[1], abs=1e-4)


@pytest.mark.medium
def test_rain_is_drawn_before_water_and_objects_keep_their_numbers() -> None:
    lens = Lens.from_spec(LensSpec(view_deg=75), 320, 240)
    sun = np.array([0.6, 0.5, -0.62])
    world = DrawnWorld(
        time_s=0.0,
        waves=FlatWater(),
        water_down_m=0.0,
        wind_ne_mps=np.array([3.0, 1.0]),
        light=daylight(sun / np.linalg.norm(sun), 0.9),
        extinction_per_m=visible_extinction_per_m(None, 50.0),
        water_colour=np.array([0.02, 0.04, 0.05]),
        placed=(),
    )
    down = frames.quat_to_matrix(frames.euler_to_quat(np.radians([0.0, -60.0, 0.0]))) @ ROT_FRD_OPTICAL
    dry = Shot(Viewpoint(np.array([0.0, 0.0, -3.0]), down), world)
    renderer = Renderer({})
    pictures = {}
    for name, falling in (("dry", None), ("a", rain()), ("b", rain()), ("other", rain(seed=4)), ("none", None)):
        pictures[name] = renderer.colour([replace(dry, rain=falling)], lens, 1.0).astype(int)
        numbers = renderer.numbers(lens)
        assert numbers is not None
        assert (numbers == SEA_ID).all()
    renderer.close()
    assert (pictures["a"] == pictures["b"]).all()
    assert (pictures["dry"] == pictures["none"]).all()
    assert (pictures["a"] != pictures["other"]).any()
    brighter = (pictures["a"] - pictures["dry"]).max(axis=2)
    assert 0.01 < (brighter > 3).mean() < 0.5
