"""Coriolis terms and the whole equation of motion against Fossen's matrices, written out with loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from vessels import FULL

from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.environment.waves import StillHull
from sim_core.kinematics import Kinematics
from sim_core.vessel.floating import floating_pose
from sim_core.vessel.hydrodynamics import (
    CrossFlow,
    Hydrodynamics,
    coriolis_products,
    hoerner_coefficient,
    stern_forces,
    transport_products,
)
from sim_core.vessel.spec import AddedMass, CrossFlowDrag, Damping, Matrix, VesselSpec
from sim_core.vessel.vessel import Surroundings, Vessel, accelerate
from xitl_cli.plugins.studies.manoeuvres.published import HOERNER

RNG = np.random.default_rng(7)


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def fossen_coriolis(mass: np.ndarray, nu: np.ndarray) -> np.ndarray:
    linear = skew(mass[:3, :3] @ nu[:3] + mass[:3, 3:] @ nu[3:])
    angular = skew(mass[3:, :3] @ nu[:3] + mass[3:, 3:] @ nu[3:])
    return np.block([[np.zeros((3, 3)), -linear], [-linear, -angular]])


def full_mass() -> np.ndarray:
    root = RNG.standard_normal((6, 6))
    return root @ root.T + 6.0 * np.eye(6)


def test_coriolis_matches_the_matrix_form_for_a_full_mass_matrix() -> None:
    for _ in range(20):
        mass, nu = full_mass(), RNG.standard_normal(6)
        force = np.outer(nu, nu).reshape(36) @ coriolis_products(mass)
        np.testing.assert_allclose(force, fossen_coriolis(mass, nu) @ nu, atol=1e-12)


def test_coriolis_does_no_work() -> None:
    for _ in range(20):
        mass, nu = full_mass(), RNG.standard_normal(6)
        force = np.outer(nu, nu).reshape(36) @ coriolis_products(mass)
        assert abs(nu @ force) < 1e-12 * np.abs(nu) @ np.abs(force)


def test_transport_terms() -> None:
    mass, nu = full_mass(), RNG.standard_normal(6)
    force = np.outer(nu, nu).reshape(36) @ transport_products(mass)
    np.testing.assert_allclose(force, mass @ np.concatenate([np.cross(nu[3:], nu[:3]), np.zeros(3)]), atol=1e-12)


Term = Callable[[float, float, float, float, float, float], float]
NAMED: dict[str, tuple[int, float, Term]] = {  # component, value, the product that the name stands for
    "X_uu": (0, -12.0, lambda u, v, w, p, q, r: abs(u) * u),
    "X_vr": (0, 31.0, lambda u, v, w, p, q, r: v * r),
    "X_vv": (0, -8.0, lambda u, v, w, p, q, r: v * v),
    "X_uuu": (0, -3.0, lambda u, v, w, p, q, r: u**3),
    "Y_vv": (1, -140.0, lambda u, v, w, p, q, r: abs(v) * v),
    "Y_rv": (1, -25.0, lambda u, v, w, p, q, r: abs(r) * v),
    "Y_|v|r": (1, 14.0, lambda u, v, w, p, q, r: abs(v) * r),
    "Y_ur": (1, -17.0, lambda u, v, w, p, q, r: u * r),
    "Y_vvr": (1, 6.0, lambda u, v, w, p, q, r: v * v * r),
    "Z_ww": (2, -200.0, lambda u, v, w, p, q, r: abs(w) * w),
    "Z_uq": (2, 9.0, lambda u, v, w, p, q, r: u * q),
    "K_pp": (3, -11.0, lambda u, v, w, p, q, r: abs(p) * p),
    "M_wq": (4, -5.0, lambda u, v, w, p, q, r: abs(w) * q),
    "N_vr": (5, -33.0, lambda u, v, w, p, q, r: abs(v) * r),
    "N_uv": (5, 21.0, lambda u, v, w, p, q, r: u * v),
    "N_rrr": (5, -44.0, lambda u, v, w, p, q, r: r**3),
    "N_|u|v": (5, 2.5, lambda u, v, w, p, q, r: abs(u) * v),
}


def rows(matrix: np.ndarray) -> Matrix:
    return tuple(tuple(row) for row in matrix.tolist())  # type: ignore[return-value]


def with_matrices() -> tuple[VesselSpec, np.ndarray, np.ndarray]:
    """Everything a table can have, off-diagonal and unsymmetric, and its added mass and linear damping."""
    rng = np.random.default_rng(11)
    scale = np.diag([5.0, 8.0, 14.0, 8.0, 9.0, 6.0])
    added = scale @ (np.eye(6) + 0.15 * rng.standard_normal((6, 6))) @ scale
    damping = scale @ (np.eye(6) + 0.15 * rng.standard_normal((6, 6))) @ scale
    model = replace(
        FULL,
        inertia_products_kgm2=(1.5, -3.0, 0.7),
        centre_of_gravity_frd_m=(0.13, -0.04, -0.11),
        added_mass=AddedMass(),
        added_mass_matrix=rows(added),
        damping_linear=Damping(),
        damping_linear_matrix=rows(damping),
        damping_quadratic=Damping(),
        derivatives={name: value for name, (_, value, _) in NAMED.items()},
        cross_flow_drag=CrossFlowDrag(length_m=2.1, draft_m=0.11, width_m=0.35, strips=7),
        centre_of_lateral_resistance_frd_m=(-0.2, 0.0, 0.17),
    )
    return model, added, damping


def per_axis() -> tuple[VesselSpec, np.ndarray, np.ndarray]:
    """Diagonals at the centre of lateral resistance, a few terms by name, the stern force switched on."""
    named = {"Y_rdot": -4.0, "N_vdot": -7.0, "Y_r": 12.0, "N_v": -9.0}
    centre = (0.05, 0.0, 0.12)
    model = replace(
        FULL,
        centre_of_gravity_frd_m=(0.1, 0.02, -0.05),
        centre_of_lateral_resistance_frd_m=centre,
        derivatives=named,
        stern_force="on",
    )
    there = np.block([[np.eye(3), -skew(np.array(centre))], [np.zeros((3, 3)), np.eye(3)]])
    added = there.T @ np.diag([5.1, 72.0, 216.0, 78.0, 95.0, 34.0]) @ there
    damping = there.T @ np.diag([15.0, 250.0, 500.0, 230.0, 270.0, 150.0]) @ there
    added[1, 5] += 4.0
    added[5, 1] += 7.0
    damping[1, 5] -= 12.0
    damping[5, 1] += 9.0
    return model, added, damping


def drag_of_strips(nu: np.ndarray) -> np.ndarray:
    """Of `with_matrices`, strip by strip; half the width over the draft is 1.59, where Hoerner's curve has 0.70."""
    coefficient = 0.7599 + (0.6914 - 0.7599) * (0.35 / 0.22 - 1.3081) / (1.6392 - 1.3081)
    force = np.zeros(6)
    for strip in range(7):
        place = np.array([-0.2 + 2.1 * ((strip + 0.5) / 7 - 0.5), 0.0, 0.17])
        across = (nu[:3] + np.cross(nu[3:], place))[1]
        side = np.array([0.0, -0.5 * 997.8 * coefficient * 0.11 * 0.3 * abs(across) * across, 0.0])
        force += np.concatenate([side, np.cross(place, side)])
    return force


def drag_per_axis(nu: np.ndarray) -> np.ndarray:
    """Quadratic damping and what the stern sheds, of `per_axis`, at the centre of lateral resistance."""
    centre = np.array([0.05, 0.0, 0.12])
    u, v, w = nu[:3] + np.cross(nu[3:], centre)
    p, q, r = nu[3:]
    trailing = -np.sign(u) * 2.3 / 2
    side = -abs(u) * 72.0 / 2.3 * (v + trailing * r)
    down = -abs(u) * 216.0 / 2.3 * (w - trailing * q)
    there = np.array([0.0, side, down, 0.0, -trailing * down, trailing * side])
    there -= np.array([20.0, 150.0, 0.0, 0.0, 0.0, 200.0]) * np.abs([u, v, w, p, q, r]) * [u, v, w, p, q, r]
    return there + np.concatenate([np.zeros(3), np.cross(centre, there[:3])])


@pytest.mark.parametrize("vessel_of", [with_matrices, per_axis])
def test_acceleration_is_fossens_equation_written_out(vessel_of: Callable[..., Any]) -> None:
    """M nu_r' + C_RB(nu_r) nu_r + C_A(nu_r) nu_r + D nu_r + d(nu_r) + g = tau + tau_wind, in a current."""
    model, added, damping = vessel_of()
    gravity_centre, mass = np.array(model.centre_of_gravity_frd_m), model.mass_kg
    xy, xz, yz = model.inertia_products_kgm2
    inertia = np.diag(model.inertia_kgm2) - [[0, xy, xz], [xy, 0, yz], [xz, yz, 0]]
    arm = skew(gravity_centre)
    rigid = np.block([[mass * np.eye(3), -mass * arm], [mass * arm, inertia - mass * arm @ arm]])
    water = Water(density_kgpm3=997.8, level_m=-0.01)
    vessel = Vessel.from_spec(model, water, 0.0025)
    np.testing.assert_allclose(vessel.hydrodynamics.rigid_mass, rigid, atol=1e-12)
    np.testing.assert_allclose(vessel.hydrodynamics.added_mass, added, atol=1e-12)

    n = 30
    rng = np.random.default_rng(5)
    rot = Rotation.from_euler("ZYX", rng.uniform(-0.3, 0.3, (n, 3)) * [10.0, 1.0, 1.0]).as_matrix()
    pos, vel, gyro = rng.normal(0.0, 0.05, (n, 3)), rng.standard_normal((n, 3)), rng.normal(0.0, 0.5, (n, 3))
    current, wind = np.array([0.5, -0.3, 0.0]), np.array([-4.0, 3.0, 0.0])
    rotor, zero = rng.uniform(-1.0, 1.0, (n, 2)), np.zeros((n, 3))
    motion = Kinematics(pos, vel, zero, np.zeros((n, 4)), rot, gyro, zero)
    surface = StillHull(12).sample(0.0, pos, rot)
    around = Surroundings(np.tile(current, (n, 1)), np.tile(wind, (n, 1)), surface, zero[:, :2])
    upright = floating_pose(replace(model, centre_of_gravity_frd_m=(0.0, 0.0, 0.0)), water)
    at_rest = np.arccos(1.0 - upright.draft_m / 0.2)
    centroid_below_axis = 2.0 / 3.0 * (0.2 * np.sin(at_rest)) ** 3 / (113.0 / (997.8 * 2 * 2.3))
    areas_down = -vessel.rest.depth_m - 0.5 * 1.3 / 2.3
    acceleration = accelerate(vessel, motion, rotor, around)
    for i in range(n):
        R = rot[i]
        nu = np.concatenate([R.T @ (vel[i] - current), gyro[i]])
        weight = R.T @ [0.0, 0.0, mass * GRAVITY_MPS2]
        tau = np.concatenate([weight, np.cross(gravity_centre, weight)])
        for point in vessel.buoyancy.points_frd_m:
            depth = (pos[i] + R @ point)[2] - 0.01 + 0.2
            h = min(max(depth, 0.0), 0.4)
            area = 0.04 * np.arccos((0.2 - h) / 0.2) - (0.2 - h) * np.sqrt(0.4 * h - h * h)
            lift = R.T @ [0.0, 0.0, -997.8 * GRAVITY_MPS2 * 2.3 / 6 * area]
            tau += np.concatenate([lift, np.cross(point, lift)])
            tau[4] += centroid_below_axis * lift[0]
        for propeller, speed in zip(model.propellers, rotor[i], strict=True):
            pushed = np.array([speed * abs(speed) * (250.0 if speed > 0 else 150.0), 0.0, 0.0])
            tau += np.concatenate([pushed, np.cross(propeller.position_frd_m, pushed)])
        through_air = R.T @ (vel[i] - wind)
        pressure, angle = 0.6 * (through_air[:2] @ through_air[:2]), -np.arctan2(through_air[1], through_air[0])
        blown = pressure * np.array([-0.7 * 0.9 * np.cos(angle), 0.9 * 1.3 * np.sin(angle), 0.0])
        tau += np.concatenate([blown, np.cross([0.0, 0.0, areas_down], blown)])
        tau[5] += pressure * 0.1 * 1.3 * 2.3 * np.sin(2.0 * angle)
        tau -= damping @ nu
        if vessel_of is with_matrices:
            for component, value, term in NAMED.values():
                tau[component] += value * term(*nu)
            tau += drag_of_strips(nu)
        else:
            tau += drag_per_axis(nu)
        coriolis = fossen_coriolis(rigid, nu) + fossen_coriolis(0.5 * (added + added.T), nu)
        nu_dot = np.linalg.solve(rigid + added, tau - coriolis @ nu)
        expected = nu_dot + np.concatenate([np.cross(nu[3:], nu[:3]), np.zeros(3)])
        np.testing.assert_allclose(acceleration[i], expected, rtol=1e-9, atol=1e-9)


def test_cross_flow_drag_of_pure_sway_and_pure_yaw() -> None:
    """Y = -1/2 rho C_D T L |v| v, and N = -rho C_D T L^4 / 64 |r| r, the integral of |x|^3 over the length."""
    flow = CrossFlow.from_spec(
        CrossFlowDrag(length_m=2.0, draft_m=0.2, coefficient=1.1, strips=200), 1000.0, np.array([0.0, 0.0, 0.1])
    )
    for nu, component, expected in (
        ([0.0, -0.7, 0.0, 0.0, 0.0, 0.0], 1, 0.5 * 1000.0 * 1.1 * 0.2 * 2.0 * 0.49),
        ([0.0, -0.7, 0.0, 0.0, 0.0, 0.0], 3, -0.1 * 0.5 * 1000.0 * 1.1 * 0.2 * 2.0 * 0.49),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.9], 5, -1000.0 * 1.1 * 0.2 * 2.0**4 / 64.0 * 0.81),
    ):
        force = np.concatenate(flow.terms(np.array([nu])), axis=1) @ flow.wrench
        assert force[0, component] == pytest.approx(expected, rel=1e-4)  # strips miss 1 / (2 n^2) of the cube


def test_hoerners_curve_is_the_published_one() -> None:
    ratios, coefficients = np.array(HOERNER).T
    assert [hoerner_coefficient(2.0 * ratio, 1.0) for ratio in ratios] == pytest.approx(coefficients)
    assert hoerner_coefficient(1e-3, 1.0) == coefficients[0]
    assert hoerner_coefficient(20.0, 1.0) == coefficients[-1]


def test_a_vessel_described_about_another_origin_moves_the_same() -> None:
    """The body's origin is a choice: moved aft, up and aside, it moves the hull the same."""
    moved = np.array([0.3, -0.1, 0.2])  # of the old origin, from the new one
    matrices, _, _ = with_matrices()
    near = replace(matrices, derivatives={}, centre_of_lateral_resistance_frd_m=(-0.2, 0.0, 0.17))
    there = np.block([[np.eye(3), -skew(moved)], [np.zeros((3, 3)), np.eye(3)]])
    symmetric = np.array(near.added_mass_matrix)
    symmetric = 0.5 * (symmetric + symmetric.T)

    def shifted(place: tuple[float, float, float]) -> tuple[float, float, float]:
        return tuple((np.array(place) + moved).tolist())  # type: ignore[return-value]

    near = replace(near, added_mass_matrix=rows(symmetric))
    far = replace(
        near,
        centre_of_gravity_frd_m=shifted(near.centre_of_gravity_frd_m),
        added_mass_matrix=rows(there.T @ symmetric @ there),
        damping_linear_matrix=rows(there.T @ np.array(near.damping_linear_matrix) @ there),
        centre_of_lateral_resistance_frd_m=shifted((-0.2, 0.0, 0.17)),
    )
    rng = np.random.default_rng(3)
    nu = rng.standard_normal((20, 6))
    nu_far = np.concatenate([nu[:, :3] - np.cross(nu[:, 3:], moved), nu[:, 3:]], axis=1)
    wrenches = []
    for model, velocity in ((near, nu), (far, nu_far)):
        parts = Hydrodynamics.from_spec(model, 997.8, 0.1)
        force = np.concatenate(parts.terms(velocity), axis=1) @ parts.wrench
        wrenches.append(force @ parts.inverse_mass)
    a, a_far = wrenches
    w = nu[:, 3:]
    at_old_origin = a_far[:, :3] + np.cross(a_far[:, 3:], moved) + np.cross(w, np.cross(w, moved))
    np.testing.assert_allclose(a_far[:, 3:], a[:, 3:], atol=1e-9)
    np.testing.assert_allclose(at_old_origin, a[:, :3], atol=1e-9)


def test_force_at_the_stern_only_sheds_energy_ahead_and_astern() -> None:
    """Its power is that of the shed wake, -|u| a (v + x r)^2 - |u| b (w - x q)^2 with x the trailing end."""
    added = np.diag([5.0, 72.0, 216.0, 78.0, 95.0, 34.0])
    products, lift = stern_forces(added, 2.3)
    for _ in range(20):
        nu = RNG.standard_normal(6)
        force = np.outer(nu, nu).reshape(36) @ products + abs(nu[0]) * nu @ lift
        x = -np.sign(nu[0]) * 1.15
        wake = 72.0 / 2.3 * (nu[1] + x * nu[5]) ** 2 + 216.0 / 2.3 * (nu[2] - x * nu[4]) ** 2
        assert force @ nu == pytest.approx(-abs(nu[0]) * wake)
