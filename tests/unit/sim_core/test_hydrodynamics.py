"""Coriolis terms and the whole equation of motion against Fossen's matrices, written out with loops."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from vessels import FULL

from sim_core.environment.spec import GRAVITY_MPS2, Water
from sim_core.environment.waves import StillHull
from sim_core.kinematics import Kinematics
from sim_core.vessel.forces import coriolis_products, stern_forces, transport_products
from sim_core.vessel.vessel import Surroundings, Vessel, accelerate

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


def test_equation_of_motion_agrees_with_fossen_in_a_current() -> None:
    """M nu_r' + C(nu_r) nu_r + D(nu_r) nu_r + g = tau with the force at the stern, strip by strip."""
    water = Water(density_kgpm3=997.8, level_m=-0.01)
    vessel = Vessel.from_spec(FULL, water, 0.0025)
    mass = vessel.hydrodynamics.rigid_mass + vessel.hydrodynamics.added_mass
    added = np.array([5.1, 72.0, 216.0])
    linear = np.array([15.0, 250.0, 500.0, 50.0, 50.0, 150.0])
    quadratic = np.array([20.0, 150.0, 0.0, 0.0, 0.0, 200.0])
    n = 6
    rot = Rotation.from_euler("ZYX", RNG.uniform(-0.3, 0.3, (n, 3)) * [10.0, 1.0, 1.0]).as_matrix()
    pos, vel, gyro = RNG.normal(0.0, 0.05, (n, 3)), RNG.standard_normal((n, 3)), RNG.normal(0.0, 0.5, (n, 3))
    current = np.array([0.5, -0.3, 0.0])
    rotor = RNG.uniform(-1.0, 1.0, (n, 2))
    zero = np.zeros((n, 3))
    motion = Kinematics(pos, vel, zero, np.zeros((n, 4)), rot, gyro, zero)
    surface = StillHull(12).sample(0.0, pos, rot)
    around = Surroundings(np.tile(current, (n, 1)), vel, surface)  # air that moves along: no wind force
    at_rest = np.arccos(1.0 - vessel.draft_m / 0.2)
    centroid_below_axis = 2.0 / 3.0 * (0.2 * np.sin(at_rest)) ** 3 / (113.0 / (997.8 * 2 * 2.3))
    acceleration = accelerate(vessel, motion, rotor, around)
    for i in range(n):
        R = rot[i]
        nu_r = np.concatenate([R.T @ (vel[i] - current), gyro[i]])
        tau = np.concatenate([R.T @ [0.0, 0.0, FULL.mass_kg * GRAVITY_MPS2], np.zeros(3)])
        for point in vessel.buoyancy.axes_frd_m:
            depth = (pos[i] + R @ point)[2] - 0.01 + 0.2
            h = min(max(depth, 0.0), 0.4)
            area = 0.04 * np.arccos((0.2 - h) / 0.2) - (0.2 - h) * np.sqrt(0.4 * h - h * h)
            lift = R.T @ [0.0, 0.0, -997.8 * GRAVITY_MPS2 * 2.3 / 6 * area]
            tau += np.concatenate([lift, np.cross(point, lift)])
            tau[4] += centroid_below_axis * lift[0]
        for propeller, speed in zip(FULL.propellers, rotor[i], strict=True):
            thrust = speed * abs(speed) * (250.0 if speed > 0 else 150.0)
            pushed = np.array([thrust, 0.0, 0.0])
            tau += np.concatenate([pushed, np.cross(propeller.position_frd_m, pushed)])
        tau -= linear * nu_r + quadratic * np.abs(nu_r) * nu_r
        trailing = -np.sign(nu_r[0]) * 2.3 / 2
        side = -abs(nu_r[0]) * added[1] / 2.3 * (nu_r[1] + trailing * nu_r[5])
        down = -abs(nu_r[0]) * added[2] / 2.3 * (nu_r[2] - trailing * nu_r[4])
        tau += [0.0, side, down, 0.0, -trailing * down, trailing * side]
        nu_r_dot = np.linalg.solve(mass, tau - fossen_coriolis(mass, nu_r) @ nu_r)
        expected = nu_r_dot + np.concatenate([np.cross(nu_r[3:], nu_r[:3]), np.zeros(3)])
        np.testing.assert_allclose(acceleration[i], expected, rtol=1e-9, atol=1e-9)


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
