"""Motions in regular waves against strip theory written out here, in the frequency domain.

With x the motion of the body and x_w that of the water as the strips feel it (mean velocity, and the turn of the plane
through the strips), both exp(-i omega t): (-omega^2 (M + A) - i omega D + C) x = (-omega^2 A - i omega D) x_w + F,
F being the buoyancy of the strips under the waves and the slide of the displaced water down their mean slope. The waves
decay with the depth: by their mean along the bottoms, and by their mean over the volume.
"""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from vessels import BARE, FULL

from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, Water, WaveSpec
from sim_core.environment.waves import realise_waves
from sim_core.frames import matrix_to_euler
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.spec import Damping, VesselSpec

DENSITY = 997.8
HEIGHT_M = 0.01
BOAT = replace(FULL, wind=BARE.wind, damping_linear=Damping(15, 250, 500, 120, 300, 150), damping_quadratic=Damping())


def response(model: VesselSpec, period_s: float, heading_deg: float) -> np.ndarray:
    """(6,) complex motion per metre of amplitude of waves that go north."""
    hull = model.hull
    assert hull is not None
    weight = model.mass_kg * GRAVITY_MPS2
    angle = np.linspace(0.0, np.pi, 400_001)
    area = hull.radius_m**2 * (angle - np.sin(angle) * np.cos(angle))
    half_angle = np.interp(model.mass_kg / (2.0 * DENSITY * hull.length_m), area, angle)
    draft_m, width_m = hull.radius_m * (1.0 - np.cos(half_angle)), 2.0 * hull.radius_m * np.sin(half_angle)
    axis_m = hull.keel_below_cg_m - hull.radius_m
    buoyancy_m = axis_m + width_m**3 / 12.0 / np.interp(half_angle, angle, area)

    strip_m = hull.length_m / hull.strips
    x = np.tile((np.arange(hull.strips) + 0.5) * strip_m - 0.5 * hull.length_m, 2)
    y = np.repeat([-0.5, 0.5], hull.strips) * (hull.width_m - 2.0 * hull.radius_m)
    omega = 2.0 * np.pi / period_s
    k, heading = omega**2 / GRAVITY_MPS2, np.radians(heading_deg)
    ahead, aside = k * np.cos(heading), -k * np.sin(heading)  # the waves' vector along the body's axes
    crest = np.exp(1j * (ahead * x + aside * y))
    mean = crest.mean()
    tilt_x, tilt_y = (crest * x).sum() / (x @ x), (crest * y).sum() / (y @ y)

    across = (np.arange(2000) + 0.5) / 2000 * width_m - 0.5 * width_m
    down = np.sqrt(hull.radius_m**2 - across**2) - (hull.radius_m - draft_m)
    bottom = np.exp(-k * down).mean()
    volume = (-np.expm1(-k * down) / k).mean() / down.mean()

    stiffness = DENSITY * GRAVITY_MPS2 * width_m * strip_m
    restoring = np.zeros((6, 6))
    restoring[2, 2] = stiffness * len(x)
    restoring[3, 3] = stiffness * (y @ y) - weight * axis_m
    restoring[4, 4] = stiffness * (x @ x) - weight * buoyancy_m
    slope_x, slope_y = 1j * ahead * mean * volume, 1j * aside * mean * volume
    crest, mean = crest * bottom, mean * bottom
    tilt_x, tilt_y = tilt_x * bottom, tilt_y * bottom
    force = np.array(
        [
            -weight * slope_x,
            -weight * slope_y,
            -stiffness * crest.sum(),
            -stiffness * (crest * y).sum() + weight * axis_m * slope_y,
            stiffness * (crest * x).sum() - weight * buoyancy_m * slope_x,
            0.0,
        ]
    )
    # Displacements of the water: along the waves a quarter of a period ahead of its rise, down, roll and pitch.
    water = np.array([slope_x / k, slope_y / k, -mean, -tilt_y, tilt_x, 0.0])

    drag_m = hull.keel_below_cg_m - 0.5 * draft_m  # where added mass and damping act
    lever = np.eye(6)
    lever[0, 4], lever[1, 3] = drag_m, -drag_m
    added = lever.T @ np.diag(astuple(model.added_mass)) @ lever
    damping = lever.T @ np.diag(astuple(model.damping_linear)) @ lever
    rigid = np.diag([model.mass_kg] * 3 + list(model.inertia_kgm2))
    dynamic = -(omega**2) * (rigid + added) - 1j * omega * damping + restoring
    return np.linalg.solve(dynamic, (-(omega**2) * added - 1j * omega * damping) @ water + force)


def simulated(model: VesselSpec, period_s: float, headings_deg: tuple[float, ...]) -> np.ndarray:
    """(N, 3) amplitudes of heave, roll and pitch per metre of amplitude of the waves."""
    water = Water(density_kgpm3=DENSITY, level_m=0.0, depth_m=200.0)
    waves = realise_waves(WaveSpec("regular", HEIGHT_M, period_s), water, np.random.default_rng(0))
    simulation = Simulation.from_spec(model, Environment(water=water, waves=waves), 0.0025)
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((len(headings_deg), 2)), np.radians(headings_deg), rng)
    seen, times = [], []
    last_s = 8.0 * period_s
    for number in range(round((12.0 + last_s) / 0.0025)):
        state = step(simulation, state, np.zeros((1, 2)), rng)
        if number * 0.0025 > 12.0:
            motion = state.vessel.motion
            seen.append(np.column_stack([motion.pos_ned_m[:, 2:], matrix_to_euler(motion.rot_ned_frd)[:, :2]]))
            times.append(state.time_ns * 1e-9)
    phase = 2.0 * np.pi / period_s * np.array(times)
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase)])
    fitted = np.linalg.lstsq(basis, np.array(seen).reshape(len(times), -1), rcond=None)[0]
    return np.hypot(fitted[0], fitted[1]).reshape(-1, 3) / (0.5 * HEIGHT_M)


@pytest.mark.medium
@pytest.mark.parametrize("period_s", [1.0, 1.3, 1.7, 2.5])
def test_motions_in_head_and_beam_seas_are_those_of_strip_theory(period_s: float) -> None:
    """Within 2 % of the response: quadratic in 5 mm on 100 mm of draft, and 0.8 % that the drift shifts the period."""
    headings_deg = (180.0, 90.0)
    got = simulated(BOAT, period_s, headings_deg)
    for row, heading_deg in zip(got, headings_deg, strict=True):
        expected = np.abs(response(BOAT, period_s, heading_deg))[2:5]
        np.testing.assert_allclose(row, expected, rtol=0.02, atol=0.01)


@pytest.mark.medium
def test_heave_in_beam_seas_is_that_of_the_hulls_not_of_the_water_between_them() -> None:
    """At T = 1.3 s the waves are 2.6 m long and the hulls 1.2 m apart: 0.16 m a metre, 0.35 by the centreline."""
    assert abs(response(FULL, 1.3, 90.0)[2]) == pytest.approx(0.16, abs=0.01)
    assert simulated(FULL, 1.3, (90.0,))[0, 0] == pytest.approx(0.16, abs=0.01)
