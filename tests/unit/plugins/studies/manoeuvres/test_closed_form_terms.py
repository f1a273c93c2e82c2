"""Each term of the closed forms by hand, one at a time, because a whole manoeuvre hides a small one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_vessel_closed_forms import LENGTH_M, WATER, barge

from sim_core.environment.spec import Water
from sim_core.vessel.spec import (
    AddedMass,
    CrossFlowDrag,
    Damping,
    DemiHull,
    HullSection,
    OpenWater,
    Propeller,
    SteeringGear,
    VesselSpec,
    Windage,
)
from xitl_cli.plugins.studies.manoeuvres.closed_forms import (
    HorizontalMotion,
    LinearSeakeeping,
    Matrices,
    Term,
    lateral_centre,
    steady_speed_mps,
    surge_drag_n,
    surge_mass_kg,
    surge_run,
    terms_of,
    thrust_n,
    waterline,
)

NO_DRAG: dict[str, Any] = {"damping_linear": Damping(), "damping_quadratic": Damping(), "stern_force": "off"}


def matrix(**diagonal: float) -> tuple[tuple[float, ...], ...]:
    values = np.zeros((6, 6))
    for axis, name in enumerate(("surge", "sway", "heave", "roll", "pitch", "yaw")):
        values[axis, axis] = diagonal.get(name, 0.0)
    return tuple(tuple(map(float, row)) for row in values)


# Surge
@pytest.mark.parametrize("speed_mps", [2.0, -2.0])
@pytest.mark.parametrize(
    ("changed", "linear", "quadratic", "cubic"),
    [
        ({"damping_linear": Damping(surge=20.0)}, 20.0, 0.0, 0.0),
        ({"damping_quadratic": Damping(surge=5.0)}, 0.0, 5.0, 0.0),
        ({"derivatives": {"X_u": -3.0, "X_uu": -4.0, "X_uuu": -6.0}}, 3.0, 4.0, 6.0),
        ({"damping_linear_matrix": matrix(surge=7.0, sway=9.0)}, 7.0, 0.0, 0.0),
        ({"wind": Windage(frontal_area_m2=2.0, surge_coefficient=0.5, lateral_area_m2=9.0)}, 0.0, 0.6, 0.0),
    ],
)
def test_drag_ahead(changed: dict[str, Any], linear: float, quadratic: float, cubic: float, speed_mps: float) -> None:
    """The air has 1.2 kg/m3: half of it times 0.5 times 2 m2."""
    model = barge(**(NO_DRAG | {"derivatives": {"N_rr": -1.0}} | changed))
    speed = abs(speed_mps)
    size = linear * speed + quadratic * speed**2 + cubic * speed**3
    assert surge_drag_n(model, speed_mps) == pytest.approx(math.copysign(size, speed_mps))


def test_mass_ahead() -> None:
    model = barge()
    assert surge_mass_kg(model) == model.mass_kg + 10.0
    assert surge_mass_kg(replace(model, added_mass=AddedMass(), derivatives={"X_udot": -12.0})) == model.mass_kg + 12.0
    given = replace(model, added_mass=AddedMass(), added_mass_matrix=matrix(surge=14.0, sway=99.0))
    assert surge_mass_kg(given) == model.mass_kg + 14.0


def test_a_coasting_boat_with_quadratic_drag() -> None:
    """u = u0 / (1 + k u0 t) and x = ln(1 + k u0 t) / k with k = D / m."""
    model = barge(**(NO_DRAG | {"damping_quadratic": Damping(surge=40.0)}))
    k = 40.0 / surge_mass_kg(model)
    time_s, way_m = surge_run(model, WATER, np.zeros(2), np.zeros(2), 3.0, lambda speed: speed <= 1.0)
    assert time_s == pytest.approx((3.0 - 1.0) / (3.0 * 1.0 * k), rel=2e-3)
    assert way_m == pytest.approx(math.log(3.0) / k, rel=2e-3)


def test_a_steady_speed_with_propellers_at_an_angle() -> None:
    """At 50 degrees, half of the thrust by the cosine; at 70 degrees a propeller pushes sideways."""
    tilted = tuple(replace(one, angle_deg=angle) for one, angle in zip(barge().propellers, (50.0, 70.0), strict=True))
    found = steady_speed_mps(barge(propellers=tilted), WATER, np.ones(2))
    assert found == pytest.approx(30.0 * math.cos(math.radians(50.0)) / 20.0)


# Propellers
def screw(**changed: Any) -> Propeller:
    made: dict[str, Any] = {"position_frd_m": (0.0, 0.0, 0.0), "medium": "water", "max_thrust_n": 100.0}
    return Propeller(**(made | {"max_reverse_thrust_n": 60.0} | changed))


def test_thrust_grows_with_the_square_of_the_turns() -> None:
    assert thrust_n(screw(), WATER, 0.5, 3.0) == pytest.approx(25.0)
    assert thrust_n(screw(), WATER, -0.5, 3.0) == pytest.approx(-15.0)
    assert thrust_n(screw(), WATER, 0.0, 3.0) == 0.0
    assert thrust_n(screw(thrust_deduction=0.1), WATER, 1.0, 3.0) == pytest.approx(90.0)


def test_thrust_falls_to_zero_at_a_speed() -> None:
    """Linearly, at a speed that grows with the turns, and not against the thrust."""
    falling = screw(zero_thrust_speed_mps=8.0)
    assert thrust_n(falling, WATER, 1.0, 2.0) == pytest.approx(75.0)
    assert thrust_n(falling, WATER, 0.5, 2.0) == pytest.approx(25.0 * 0.5)
    assert thrust_n(falling, WATER, 1.0, -2.0) == pytest.approx(100.0)
    assert thrust_n(falling, WATER, -1.0, -2.0) == pytest.approx(-45.0)
    assert thrust_n(falling, WATER, -1.0, 2.0) == pytest.approx(-60.0)
    assert thrust_n(screw(zero_thrust_speed_mps=8.0, wake_fraction=0.25), WATER, 1.0, 4.0) == pytest.approx(62.5)
    assert thrust_n(falling, WATER, 0.0, 2.0) == 0.0


def test_thrust_of_an_open_water_curve() -> None:
    """rho K_T(J) n2 D4 with K_T = 0.4 - 0.4 J and J = u (1 - w) / (n D); astern a share of K_T at rest."""
    curve = OpenWater(diameter_m=0.2, max_speed_rps=10.0, thrust_polynomial=(0.4, -0.4, 0.0), reverse_share=0.5)
    of_curve = Propeller((0, 0, 0), medium="water", wake_fraction=0.2, thrust_deduction=0.1, open_water=curve)
    full = 1000.0 * 100.0 * 0.2**4
    assert thrust_n(of_curve, WATER, 1.0, 1.0) == pytest.approx(0.9 * full * (0.4 - 0.4 * 0.4), rel=1e-3)
    assert thrust_n(of_curve, WATER, 0.5, 0.5) == pytest.approx(0.9 * 0.25 * full * (0.4 - 0.4 * 0.4), rel=1e-3)
    assert thrust_n(of_curve, WATER, -1.0, 0.0) == pytest.approx(-0.9 * full * 0.2, rel=1e-3)
    assert thrust_n(of_curve, Water(density_kgpm3=500.0), 1.0, 0.0) == pytest.approx(0.9 * 0.5 * full * 0.4, rel=1e-3)
    assert thrust_n(of_curve, WATER, 0.0, 1.0) == 0.0


# Derivatives and matrices
def test_derivatives_by_their_names() -> None:
    """Products of two that would push to the same side for both directions are taken with a magnitude."""
    names = {
        "X_udot": -1.0,
        "N_r": -2.0,
        "Y_vv": -3.0,
        "N_ur": -4.0,
        "X_vr": 5.0,
        "Y_v|r|": -6.0,
        "K_pp": -7.0,
        "N_vvr": 8.0,
        "N_|v|v": -9.0,
    }
    terms = terms_of(barge(**NO_DRAG, added_mass=AddedMass(), derivatives=names))
    found = {tuple(term)[:3]: term.value for term in terms}
    u, v, p, r = 0, 1, 3, 5
    assert found == {
        (0, u, ()): -1.0,
        (5, None, ((r, False),)): -2.0,
        (1, None, ((v, True), (v, False))): -3.0,
        (5, None, ((u, False), (r, False))): -4.0,
        (0, None, ((v, False), (r, False))): 5.0,
        (1, None, ((v, False), (r, True))): -6.0,
        (3, None, ((p, True), (p, False))): -7.0,
        (5, None, ((v, False), (v, False), (r, False))): 8.0,
        (5, None, ((v, True), (v, False))): -9.0,
    }
    assert all(isinstance(term, Term) for term in terms)


def test_matrices_about_the_origin() -> None:
    """Mass at G and added mass at the centre of lateral resistance: Fossen 2021, equation 3.49, element by element."""
    place, mass = (0.3, 0.05, 0.15), barge().mass_kg
    model = barge(
        centre_of_gravity_frd_m=place,
        inertia_products_kgm2=(1.0, 2.0, 3.0),
        centre_of_lateral_resistance_frd_m=(0.2, 0.0, 0.1),
    )
    found = Matrices.from_spec(model, 0.25)
    rigid = found.mass - found.added_mass
    x, y, z = place
    assert rigid[:3, :3] == pytest.approx(mass * np.eye(3))
    assert rigid[:3, 3:] == pytest.approx(mass * np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]))
    assert rigid[3:, :3] == pytest.approx(rigid[:3, 3:].T)
    about_g = np.array([[8.0, -1.0, -2.0], [-1.0, 80.0, -3.0], [-2.0, -3.0, 85.0]])
    parallel = np.array(
        [[y * y + z * z, -x * y, -x * z], [-x * y, x * x + z * z, -y * z], [-x * z, -y * z, x * x + y * y]]
    )
    assert rigid[3:, 3:] == pytest.approx(about_g + mass * parallel)
    assert found.added_mass[1, 5] == pytest.approx(200.0 * 0.2)
    assert found.added_mass[5, 5] == pytest.approx(60.0 + 200.0 * 0.2**2)
    assert found.added_mass[1, 3] == pytest.approx(-200.0 * 0.1)
    assert found.damping[5, 1] == pytest.approx(80.0 * 0.2)
    assert found.damping[5, 5] == pytest.approx(60.0 + 80.0 * 0.2**2)


def test_given_matrices_and_derivatives_take_the_place_of_axes() -> None:
    given = barge(
        added_mass=AddedMass(),
        damping_linear=Damping(),
        added_mass_matrix=matrix(sway=7.0),
        damping_linear_matrix=matrix(yaw=8.0),
    )
    found = Matrices.from_spec(given, 0.25)
    assert (found.added_mass[1, 1], np.count_nonzero(found.added_mass)) == (7.0, 1)
    assert (found.damping[5, 5], np.count_nonzero(found.damping)) == (8.0, 1)
    named = barge(
        added_mass=AddedMass(), damping_linear=Damping(), derivatives={"N_r": -3.0, "N_rr": -4.0, "N_rdot": -2.0}
    )
    found = Matrices.from_spec(named, 0.25)
    assert (found.added_mass[5, 5], np.count_nonzero(found.added_mass)) == (2.0, 1)
    assert (found.damping[5, 5], np.count_nonzero(found.damping)) == (3.0, 1)  # N_rr is no linear damping


def test_the_lateral_centre_is_amidships_at_half_the_draft() -> None:
    section = HullSection(width_m=0.2, depth_m=0.5)
    hulls = (
        DemiHull(length_m=2.0, keel_frd_m=(0.5, -0.4, 0.3), section=section),
        DemiHull(length_m=1.0, keel_frd_m=(-1.0, 0.4, 0.2), section=section),
    )
    found = lateral_centre(barge(hulls=hulls), 0.1)
    assert found == pytest.approx([0.5 * (1.5 - 1.5), 0.0, 0.3 - 0.05])
    given = barge(centre_of_lateral_resistance_frd_m=(0.1, 0.2, 0.3))
    assert lateral_centre(given, 0.1) == pytest.approx([0.1, 0.2, 0.3])


def test_natural_periods_of_motions_that_do_not_couple() -> None:
    mass, stiffness = np.diag([1.0, 1.0, 500.0, 10.0, 80.0, 1.0]), np.zeros((6, 6))
    stiffness[2:5, 2:5] = np.diag([2000.0, 90.0, 5000.0])
    small = LinearSeakeeping(mass, np.zeros((6, 6)), np.zeros((6, 6)), stiffness)
    expected = [2.0 * math.pi * math.sqrt(m / k) for m, k in ((500.0, 2000.0), (10.0, 90.0), (80.0, 5000.0))]
    assert small.periods_s == pytest.approx(expected)
    time_s = np.arange(0.0, 3.0, 0.1)
    for axis, period_s in zip((2, 3, 4), expected, strict=True):
        assert small.released(axis, time_s) == pytest.approx(np.cos(2.0 * math.pi * time_s / period_s), abs=1e-9)


# Surge, sway and yaw
def motion(**changed: Any) -> HorizontalMotion:
    """Without mass: what is left are the forces of the terms that are given."""
    model = barge(**(NO_DRAG | {"added_mass": AddedMass(), "wind": Windage()} | changed))
    nothing = Matrices(1e-12 * np.eye(6), np.zeros((6, 6)), np.zeros((6, 6)))
    return HorizontalMotion(model, WATER, nothing)


STILL = [0.0, 0.0]
NU = (2.0, -0.5, 0.3)


def test_linear_damping_and_coriolis_terms_of_the_mass() -> None:
    """X = (m22 v + m26 r) r, Y = -m11 u r, N = m11 u v - (m22 v + m26 r) u, and damping against each velocity."""
    mass, damping = np.zeros((6, 6)), np.zeros((6, 6))
    mass[0, 0], mass[1, 1], mass[5, 5], mass[1, 5], mass[5, 1] = 100.0, 150.0, 30.0, 12.0, 12.0
    damping[np.ix_((0, 1, 5), (0, 1, 5))] = [[20.0, 0.0, 0.0], [0.0, 80.0, 5.0], [0.0, 7.0, 60.0]]
    found = HorizontalMotion(barge(**NO_DRAG), WATER, Matrices(mass, np.zeros((6, 6)), damping)).force(NU, STILL, [])
    u, v, r = NU
    across = 150.0 * v + 12.0 * r
    expected = (
        -20.0 * u + across * r,
        -80.0 * v - 5.0 * r - 100.0 * u * r,
        -7.0 * v - 60.0 * r + 100.0 * u * v - across * u,
    )
    assert found == pytest.approx(expected)


def test_quadratic_damping_acts_at_the_lateral_centre() -> None:
    centred = motion(
        damping_quadratic=Damping(surge=10.0, sway=20.0, yaw=30.0), centre_of_lateral_resistance_frd_m=(0.4, 0.0, 0.0)
    )
    u, v, r = NU
    beside = v + 0.4 * r
    push = -20.0 * abs(beside) * beside
    assert centred.force(NU, STILL, []) == pytest.approx((-10.0 * u * u, push, 0.4 * push - 30.0 * r * r))
    back = centred.force((-u, -v, -r), STILL, [])
    assert back == pytest.approx((10.0 * u * u, -push, -0.4 * push + 30.0 * r * r))


@pytest.mark.parametrize("ahead", [1.0, -1.0])
def test_the_force_at_the_stern_that_the_flow_leaves(ahead: float) -> None:
    """A strip of water of the mass A22 / L leaves the hull half a length behind midship, with the speed ahead."""
    added = np.zeros((6, 6))
    added[1, 1] = 200.0
    shedding = HorizontalMotion(
        barge(**(NO_DRAG | {"stern_force": "on"})), WATER, Matrices(1e-12 * np.eye(6), added, np.zeros((6, 6)))
    )
    u, v, r = ahead * 2.0, -0.5, 0.3
    stern = -ahead * 0.5 * LENGTH_M
    shed = -abs(u) * 200.0 / LENGTH_M * (v + stern * r)
    assert shedding.force((u, v, r), STILL, []) == pytest.approx((0.0, shed, stern * shed), abs=1e-9)


@pytest.mark.parametrize(
    ("changed", "sheds"),
    [({}, True), ({"stern_force": "off"}, False), ({"derivatives": {"N_rr": -1e-9}}, False)],
)
def test_only_vessels_given_by_axis_shed_by_default(changed: dict[str, Any], sheds: bool) -> None:
    added = np.zeros((6, 6))
    added[1, 1] = 200.0
    model = barge(**(NO_DRAG | {"stern_force": None} | changed))
    found = HorizontalMotion(model, WATER, Matrices(1e-12 * np.eye(6), added, np.zeros((6, 6)))).force(NU, STILL, [])
    assert bool(abs(found[1]) > 1.0) is sheds


def test_products_of_velocities() -> None:
    named = motion(derivatives={"X_vr": 5.0, "Y_v|v|": -3.0, "N_ur": -4.0, "N_rrr": -2.0, "K_p": -9.0, "N_r": -7.0})
    u, v, r = NU
    expected = (5.0 * v * r, -3.0 * v * abs(v), -4.0 * u * r - 2.0 * r**3)  # linear terms are in the matrix
    assert named.force(NU, STILL, []) == pytest.approx(expected)


def test_drag_of_the_flow_across_is_that_of_strips() -> None:
    """Half rho C T times v |v| along the length; the strips of a turn are at their middles."""
    cross = CrossFlowDrag(length_m=2.0, draft_m=0.25, coefficient=0.8, strips=4)
    strips = motion(cross_flow_drag=cross)
    per_m = 0.5 * 1000.0 * 0.8 * 0.25
    assert strips.force((0.0, -0.5, 0.0), STILL, []) == pytest.approx((0.0, per_m * 2.0 * 0.25, 0.0), abs=1e-9)
    middles = np.array([-0.75, -0.25, 0.25, 0.75])
    drag = -per_m * 0.5 * np.abs(-0.5 + middles * 0.8) * (-0.5 + middles * 0.8)
    assert strips.force((0.0, -0.5, 0.8), STILL, []) == pytest.approx((0.0, drag.sum(), middles @ drag), abs=1e-9)
    known = replace(cross, coefficient=None, width_m=2.0 * 0.25 * 0.9880)
    assert motion(cross_flow_drag=known).force((0.0, -0.5, 0.0), STILL, [])[1] == pytest.approx(
        0.5 * 1000.0 * 0.8284 * 0.25 * 2.0 * 0.25  # Hoerner's curve has 0.8284 at B / 2T = 0.988
    )


def test_still_air_brakes() -> None:
    wind = Windage(
        frontal_area_m2=2.0,
        lateral_area_m2=3.0,
        surge_coefficient=0.5,
        sway_coefficient=0.8,
        yaw_coefficient=0.1,
        length_m=4.0,
    )
    u, v, _ = NU
    speed = math.hypot(u, v)
    expected = (-0.6 * 0.5 * 2.0 * speed * u, -0.6 * 0.8 * 3.0 * speed * v, -1.2 * 0.1 * 3.0 * 4.0 * u * v)
    assert motion(wind=wind).force(NU, STILL, []) == pytest.approx(expected)


def geared(**changed: Any) -> VesselSpec:
    gear = SteeringGear(max_angle_deg=30.0, rate_degps=10.0)
    one = screw(position_frd_m=(-1.0, 0.2, 0.0), angle_deg=10.0, steering=gear, zero_thrust_speed_mps=10.0)
    other = screw(position_frd_m=(0.5, -0.3, 0.0), angle_deg=0.0)
    return barge(**(NO_DRAG | {"propellers": (one, other)} | changed))


def test_propellers_push_along_their_axes_and_turn_by_their_levers() -> None:
    """A gear of -0.2 rad turns its propeller by 0.2 rad more to starboard; the water comes along the axis."""
    found = HorizontalMotion(geared(), WATER, Matrices(1e-12 * np.eye(6), np.zeros((6, 6)), np.zeros((6, 6)))).force(
        NU, [1.0, -0.5], [-0.2]
    )
    u, v, r = NU
    angle = math.radians(10.0) + 0.2
    advance = math.cos(angle) * (u - 0.2 * r) + math.sin(angle) * (v - 1.0 * r)
    first, second = 100.0 * (1.0 - advance / 10.0), -15.0
    x, y = math.cos(angle) * first, math.sin(angle) * first
    assert found == pytest.approx((x + second, y, -1.0 * y - 0.2 * x + 0.3 * second))


def test_commands_are_speeds_and_angles() -> None:
    fractions, gears = HorizontalMotion(
        geared(), WATER, Matrices(np.eye(6), np.zeros((6, 6)), np.zeros((6, 6)))
    ).wanted(np.array([0.5, -1.0, 0.25]))
    assert (fractions, gears) == ([0.5, -1.0], [pytest.approx(math.radians(7.5))])


def test_orders_are_asked_from_the_start_and_ten_times_a_step() -> None:
    asked: list[tuple[float, float]] = []

    def order(time_s: float, turned_deg: float) -> float:
        asked.append((time_s, turned_deg))
        return 5.0 if time_s < 0.1 else -5.0

    model = barge()
    straight = HorizontalMotion(model, WATER, Matrices.from_spec(model, 0.25))
    run = straight.run(np.ones(2), 3.0, order, lambda angle: np.ones(2), lambda: False, 0.2, dt_s=0.05)
    assert asked[0] == (0.0, 0.0)
    assert [at for at, _ in asked[1:12]] == pytest.approx([0.005 * number for number in range(1, 12)])
    assert {turned for _, turned in asked} == {0.0}
    assert run.steering_deg[0] == 5.0
    # The step ends in the middle between the looks at 0.095 and 0.1 s.
    changed = int(np.flatnonzero(run.steering_deg == -5.0)[0])
    assert run.time_s[changed] == pytest.approx(0.0975)
    assert run.time_s[:changed] == pytest.approx([0.0, 0.05])
    assert (run.time_s[-1], run.north_m[-1]) == (pytest.approx(0.2, abs=0.05), pytest.approx(3.0 * run.time_s[-1]))
    assert np.abs(run.east_m).max() == 0.0


def test_shafts_follow_with_a_lag_and_gears_at_their_rate() -> None:
    """From 0.2 of full ahead to half, and 30 degrees of gear at 10 degrees/s: seen by the forces of a heavy boat."""
    model = geared(mass_kg=1e9, hulls=barge().hulls)
    heavy = HorizontalMotion(model, WATER, Matrices(1e9 * np.eye(6), np.zeros((6, 6)), np.zeros((6, 6))))
    before, after = np.array([0.2, 0.0, 0.0]), np.array([0.5, 0.0, 1.0])
    run = heavy.run(before, 0.0, lambda time_s, turned: 0.0, lambda angle: after, lambda: False, 2.0)
    fine_s = np.linspace(0.0, run.time_s[-1], 4001)
    spin_up_s = model.propellers[0].spin_up_s
    fraction = 0.5 + (0.2 - 0.5) * np.exp(-fine_s / spin_up_s)
    angle = np.radians(10.0) - np.radians(np.minimum(10.0 * fine_s, 30.0))
    thrust = 100.0 * fraction**2
    assert run.velocity[-1, 0] == pytest.approx(np.trapezoid(thrust * np.cos(angle), fine_s) / 1e9, rel=1e-3)
    assert run.velocity[-1, 1] == pytest.approx(np.trapezoid(thrust * np.sin(angle), fine_s) / 1e9, rel=1e-2)
    slower = heavy.run(after * [1.0, 1.0, 0.0], 0.0, lambda t, d: 0.0, lambda angle: before, lambda: False, 2.0)
    falling = 0.2 + (0.5 - 0.2) * np.exp(-fine_s / model.propellers[0].spin_down_s)
    along = np.trapezoid(100.0 * falling**2 * math.cos(math.radians(10.0)), fine_s) / 1e9
    assert slower.velocity[-1, 0] == pytest.approx(along, rel=1e-3)


def test_a_hull_with_a_taper_and_a_keel_that_is_not_amidships_floats_by_archimedes() -> None:
    """Two wedges: half widths fall linearly from the middle to both ends, so that the area is half that of a box."""
    wedge = DemiHull(
        length_m=LENGTH_M,
        keel_frd_m=(0.3, 0.0, 0.25),
        section=HullSection(width_m=0.5, depth_m=0.5),
        taper=((-0.5, 0.0), (0.0, 1.0), (0.5, 0.0)),
    )
    mass = 1000.0 * 0.5 * LENGTH_M * 0.5 * 0.2
    found = waterline(barge(hulls=(wedge,), mass_kg=mass, centre_of_gravity_frd_m=(0.3, 0.0, 0.1)), WATER)
    assert found is not None
    assert found.draft_m == pytest.approx(0.2, rel=1e-4)
    assert found.trim_rad == pytest.approx(0.0, abs=1e-6)
    second = 2.0 * LENGTH_M * 0.5**3 / 12.0 * 0.5 * 0.25  # the integral of b3 / 12 for b = B (1 - 2 |x| / L)
    assert found.bm_transverse_m == pytest.approx(second * 1000.0 / mass * 2.0 * 0.5, rel=1e-2)
