"""Buoys on their moorings, and leeway, against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_core.world.debris import BodyKind, BuoyForm, DebrisState, Launch, bodies_at, make_body
from sim_core.world.plan import Capsules
from sim_core.world.waterway import STILL, WaterMotion, Waterway, carry, launch_body
from xitl_cli.run.world.colours import BUOY_MARKS, coloured_parts

CURRENT = np.array([0.8, 0.0, 0.0])
STEP_NS = 20_000_000
FREE = Waterway(Capsules.joined(()))


def water(wind_ne_mps: tuple[float, float] = (0.0, 0.0), wave_m: float = 0.0, at_s: float = 0.0) -> WaterMotion:
    return WaterMotion(
        lambda places: np.tile(CURRENT, (len(places), 1)),
        lambda places: np.full(len(places), -wave_m * math.sin(2.0 * math.pi * at_s / 4.0)),
        1000.0,
        lambda: np.array(wind_ne_mps),
    )


def carried(
    launch: Launch, seconds: float, wind_ne_mps: tuple[float, float] = (0.0, 0.0), wave_m: float = 0.0
) -> tuple[DebrisState, np.ndarray]:
    debris = launch_body(STILL.debris, launch, water())
    track = []
    for step in range(round(seconds * 1e9 / STEP_NS)):
        debris = carry(FREE, debris, STEP_NS, water(wind_ne_mps, wave_m, step * STEP_NS * 1e-9), None)
        track.append(debris.pos_ned_m[0])
    return debris, np.array(track)


@pytest.mark.medium
@pytest.mark.parametrize("shape", ["can", "spar"])
def test_a_mooring_holds_a_buoy_in_the_current_at_its_swing(shape: str) -> None:
    launch = Launch(0, BodyKind.BUOY, 5.0, -3.0, 0.0, 0.8, buoy=BuoyForm(shape), swing_m=2.0)  # type: ignore[arg-type]
    debris, track = carried(launch, 30.0)
    away_m = np.hypot(*(track[:, :2] - (5.0, -3.0)).T)
    assert away_m[-1] == pytest.approx(2.0, abs=0.05)
    assert away_m.max() < 2.1
    # Downstream of the anchor. The drag is quadratic in each axis of the body, so its direction is off the flow by up
    # to max(t - atan(tan(t)^2)) = 12.1 degrees, by the heading of the body.
    assert track[-1, 0] - 5.0 > 2.0 * math.cos(math.radians(12.2)) - 0.05
    assert np.hypot(*debris.vel_ned_mps[0, :2]) < 0.05 * CURRENT[0]


@pytest.mark.medium
def test_a_moored_buoy_rises_and_falls_with_the_waves() -> None:
    launch = Launch(0, BodyKind.BUOY, 0.0, 0.0, 0.0, 0.8, swing_m=0.5)
    _, track = carried(launch, 12.0, wave_m=0.3)
    assert np.ptp(track[100:, 2]) == pytest.approx(0.6, rel=0.01)


@pytest.mark.medium
def test_a_body_drifts_with_the_current_and_its_leeway() -> None:
    drum = Launch(0, BodyKind.PLASTIC, 0.0, 0.0)
    body = make_body(BodyKind.PLASTIC, None, 1000.0)
    debris, _ = carried(drum, 60.0, wind_ne_mps=(0.0, 10.0))
    assert debris.vel_ned_mps[0, :2] == pytest.approx((0.8, 10.0 * body.windage), abs=0.02)
    debris, _ = carried(replace(drum, windage=0.0), 60.0, wind_ne_mps=(0.0, 10.0))
    assert debris.vel_ned_mps[0, 1] == pytest.approx(0.0, abs=1e-6)


def test_leeway_is_the_balance_of_drag_of_a_box() -> None:
    """A plank of density 0.6 shows 0.4 of its side: (1.225 x 0.4 / (1000 x 0.6))^0.5 of the wind."""
    assert make_body(BodyKind.PLANK, None, 1000.0).windage == pytest.approx(math.sqrt(1.225 * 0.4 / 600.0), rel=1e-6)


def test_a_buoy_is_seen_in_the_colours_of_its_mark() -> None:
    body = make_body(BodyKind.BUOY, 1.2, 1000.0, BuoyForm("pillar", "east"))
    parts = coloured_parts(body)
    assert [colour for _, colour in parts] == list(BUOY_MARKS["east"])  # black, yellow, black from the top
    heights = [part.vertices_m[part.faces].mean(axis=1)[:, 2] for part, _ in parts]
    assert heights[0].max() < heights[1].min() < heights[1].max() < heights[2].min()
    assert sum(len(part.faces) for part, _ in parts) == len(body.mesh.faces)
    striped = coloured_parts(make_body(BodyKind.BUOY, 1.0, 1000.0, BuoyForm("sphere", "safe-water")))
    assert len(striped) == 2
    assert len(striped[0][0].faces) == pytest.approx(len(striped[1][0].faces), rel=0.3)


def test_sensors_see_a_buoy_where_its_mooring_holds_it() -> None:
    debris = launch_body(STILL.debris, Launch(0, BodyKind.BUOY, 7.0, 1.0, swing_m=0.5), water())
    bodies = bodies_at(debris, 0)
    assert bodies.pos_ned_m[0, :2].tolist() == [7.0, 1.0]
    assert not bodies.vel_ned_mps.any()
