"""The closed forms against cases that are known by other means: they are references, and have none but these."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.vessel.spec import AddedMass, Damping, DemiHull, HullSection, OpenWater, Propeller, VesselSpec
from xitl_cli.plugins.studies.manoeuvres.closed_forms import (
    HorizontalMotion,
    LinearSeakeeping,
    steady_speed_mps,
    surge_run,
    thrust_n,
    waterline,
    wave_theory,
)

WATER = Water(density_kgpm3=1000.0)
LENGTH_M, WIDTH_M, DRAFT_M = 2.0, 0.5, 0.25


def barge(**changed: object) -> VesselSpec:
    """A box of 2 m by 0.5 m that floats 0.25 m deep, its origin at the waterline, its weight 15 cm below it."""
    model = VesselSpec(
        name="barge",
        mass_kg=1000.0 * LENGTH_M * WIDTH_M * DRAFT_M,
        inertia_kgm2=(8.0, 80.0, 85.0),
        centre_of_gravity_frd_m=(0.0, 0.0, 0.15),
        hulls=(
            DemiHull(
                length_m=LENGTH_M, keel_frd_m=(0.0, 0.0, DRAFT_M), section=HullSection(width_m=WIDTH_M, depth_m=0.5)
            ),
        ),
        added_mass=AddedMass(10.0, 200.0, 300.0, 2.0, 60.0, 60.0),
        damping_linear=Damping(surge=20.0, sway=80.0, heave=400.0, roll=10.0, pitch=100.0, yaw=60.0),
        stern_force="off",
        propellers=tuple(
            Propeller(
                position_frd_m=(-1.0, side, 0.0),
                medium="water",
                max_thrust_n=30.0,
                max_reverse_thrust_n=20.0,
                spin_up_s=0.1,
                spin_down_s=0.1,
            )
            for side in (-0.2, 0.2)
        ),
    )
    return replace(model, **changed)  # type: ignore[arg-type]


def test_a_box_afloat() -> None:
    found = waterline(barge(), WATER)
    assert found is not None
    assert (found.draft_m, found.trim_rad) == pytest.approx((DRAFT_M, 0.0), abs=1e-6)
    assert found.bm_transverse_m == pytest.approx(WIDTH_M**2 / 12 / DRAFT_M, rel=1e-4)
    assert found.gm_transverse_m == pytest.approx(WIDTH_M**2 / 12 / DRAFT_M - DRAFT_M / 2 + 0.15, rel=1e-3)
    assert found.gm_longitudinal_m == pytest.approx(LENGTH_M**2 / 12 / DRAFT_M - DRAFT_M / 2 + 0.15, rel=1e-3)
    assert found.stiffness[0, 0] == pytest.approx(1000 * GRAVITY_MPS2 * LENGTH_M * WIDTH_M)


def test_a_box_with_its_weight_forward_goes_down_by_the_bow() -> None:
    found = waterline(barge(centre_of_gravity_frd_m=(0.02, 0.0, 0.15)), WATER)
    assert found is not None
    assert found.trim_rad == pytest.approx(-0.02 / found.gm_longitudinal_m, rel=1e-2)


def linear(model: VesselSpec) -> LinearSeakeeping:
    afloat = waterline(model, WATER)
    assert afloat is not None
    added = np.diag([10.0, 200.0, 300.0, 2.0, 60.0, 60.0])
    rigid = np.diag([model.mass_kg] * 3 + [8.0, 80.0, 85.0])
    rigid[1, 3] = rigid[3, 1] = -0.15 * model.mass_kg  # the weight is 15 cm below the origin
    rigid[0, 4] = rigid[4, 0] = 0.15 * model.mass_kg
    rigid[3, 3] += 0.15**2 * model.mass_kg
    rigid[4, 4] += 0.15**2 * model.mass_kg
    stiffness = np.zeros((6, 6))
    stiffness[2:5, 2:5] = afloat.stiffness
    return LinearSeakeeping(rigid + added, added, np.diag([20.0, 80.0, 400.0, 10.0, 100.0, 60.0]), stiffness)


def test_a_release_is_a_damped_cosine() -> None:
    small, time_s = linear(barge()), np.arange(0.0, 4.0, 0.01)
    stiffness, mass, drag = 1000 * GRAVITY_MPS2 * LENGTH_M * WIDTH_M, 550.0, 400.0
    decay = drag / 2 / mass
    omega = math.sqrt(stiffness / mass - decay**2)
    expected = np.exp(-decay * time_s) * (np.cos(omega * time_s) + decay / omega * np.sin(omega * time_s))
    assert small.released(2, time_s) == pytest.approx(expected, abs=1e-6)


def test_a_box_in_head_seas_is_the_mean_of_the_wave() -> None:
    """Without mass, water or damping of its own it rises with the mean of the wave along its bottom."""
    model, number = barge(), np.array([2 * math.pi / 3.0, 2 * math.pi / 60.0])
    afloat = waterline(model, WATER)
    assert afloat is not None
    small = linear(model)
    nothing = replace(small, mass=1e-9 * np.eye(6), added_mass=np.zeros((6, 6)), damping=np.zeros((6, 6)))
    found = wave_theory(model, WATER, afloat, nothing, "head", number, np.sqrt(GRAVITY_MPS2 * number))
    half = 0.5 * number * LENGTH_M
    draft_m = model.mass_kg / (WATER.density_kgpm3 * LENGTH_M * WIDTH_M)
    assert np.abs(found[2]) == pytest.approx(np.exp(-number * draft_m) * np.sin(half) / half, rel=1e-4)


@pytest.mark.parametrize(("heading", "axis"), [("head", 4), ("beam", 3)])
def test_a_box_follows_long_waves(heading: str, axis: int) -> None:
    """But for the square of its natural period over the wave's, 6.2 s."""
    model, number = barge(), np.array([2 * math.pi / 60.0])
    afloat, small = waterline(model, WATER), linear(model)
    assert afloat is not None
    found = wave_theory(model, WATER, afloat, small, heading, number, np.sqrt(GRAVITY_MPS2 * number))
    assert np.abs(found[2]) == pytest.approx(1.0, abs=0.03)
    assert np.angle(found[2]) == pytest.approx(0.0, abs=0.02)
    slope = -1j if heading == "head" else 1j  # the wave goes aft, or to starboard: bow up, or starboard down, before it
    assert found[axis] / number == pytest.approx(slope if axis == 4 else -slope, abs=0.1)


def test_thrust_and_drag_of_a_linear_boat() -> None:
    model = barge()
    assert steady_speed_mps(model, WATER, np.ones(2)) == pytest.approx(3.0)
    assert steady_speed_mps(model, WATER, -np.ones(2)) == pytest.approx(-2.0)
    mass = model.mass_kg + 10
    time_s, way_m = surge_run(model, WATER, np.zeros(2), np.zeros(2), 1.0, lambda speed: speed <= 0.5)
    assert time_s == pytest.approx(mass / 20 * math.log(2), abs=0.011)
    assert way_m == pytest.approx(0.5 * mass / 20, abs=0.01)


def test_an_air_propeller_keeps_its_power() -> None:
    propeller = Propeller(position_frd_m=(0, 0, 0), max_thrust_n=100.0, max_reverse_thrust_n=50.0, diameter_m=0.8)
    thrust = thrust_n(propeller, WATER, 1.0, 5.0)
    disc = 1.2 * math.pi * 0.8**2 / 4
    through = 2.5 + math.sqrt(2.5**2 + thrust / (2 * disc))
    assert thrust * through == pytest.approx(100.0 * math.sqrt(100.0 / (2 * disc)))
    assert thrust < 100.0


@pytest.mark.parametrize(("speed_mps", "coefficient"), [(-0.5, 0.2), (0.0, 0.2), (0.5, 0.25), (2.0, 0.3)])
def test_a_table_astern_is_over_the_whole_speed_of_the_hull(speed_mps: float, coefficient: float) -> None:
    """J_s = u / (n D) with n = -5/s and D = 0.2 m, whatever the wake."""
    curve = OpenWater(
        diameter_m=0.2,
        max_speed_rps=10.0,
        thrust_polynomial=(0.4, -0.4, 0.0),
        astern_advance_ratio=(-1.0, 0.0),
        astern_thrust_coefficient=(0.3, 0.2),
    )
    screw = Propeller((0, 0, 0), medium="water", wake_fraction=0.5, thrust_deduction=0.1, open_water=curve)
    newtons = thrust_n(screw, WATER, -0.5, speed_mps)
    assert newtons == pytest.approx(-0.9 * coefficient * 1000.0 * 25.0 * 0.2**4)


def test_a_linear_boat_turns_as_nomoto_has_it() -> None:
    """No sway, as its added mass does not differ with the direction: N = 60 r, and X = 20 u."""
    model = barge(added_mass=AddedMass(10.0, 10.0, 300.0, 2.0, 60.0, 60.0))
    added = np.diag([10.0, 10.0, 300.0, 2.0, 60.0, 60.0])
    small = replace(linear(model), mass=linear(model).mass - linear(model).added_mass + added, added_mass=added)
    motion = HorizontalMotion(model, WATER, small)
    found = motion.steady(np.array([1.0, 0.9]), (2.0, 0.0, 0.01))
    assert found is not None
    moment = 0.2 * 30 * (1 - 0.81)
    u, v, r = found
    assert 60 * r == pytest.approx(moment)
    assert 80 * v == pytest.approx(-(model.mass_kg + 10) * u * r)
    assert 20 * u == pytest.approx(30 * 1.81 + (model.mass_kg + 10) * v * r)
    run = motion.run(
        np.ones(2), u, lambda time_s, turned_deg: 5.0, lambda angle: np.array([1.0, 0.9]), lambda: False, 40.0
    )
    assert run.velocity[-1] == pytest.approx(found, rel=1e-3)
    assert run.yaw_rad[-1] - run.yaw_rad[-21] == pytest.approx(r, rel=1e-4)  # a second
    radius = math.hypot(u, v) / r
    across = math.hypot(run.north_m[-1] - run.north_m[-21], run.east_m[-1] - run.east_m[-21])
    assert across == pytest.approx(2 * radius * math.sin(r / 2), rel=1e-3)
