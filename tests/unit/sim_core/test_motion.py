"""The vessel's motion against closed forms: speeds, decays, periods, conservation laws, agreement with an IMU."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from vessels import BARE, FULL, froude_scaled

from sim_core.environment.current import UniformCurrent
from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, CurrentSpec, Water, WaveSpec, WindSpec
from sim_core.environment.waves import realise_waves
from sim_core.environment.wind import Wind
from sim_core.frames import euler_to_quat, quat_to_euler, quat_to_matrix
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState, initial, step
from sim_core.vessel.spec import Damping, VesselSpec, Windage
from xitl_cli.profile import load_with_origins

DENSITY = 997.8
STOPPED = np.zeros((1, 2))
# Drag and added mass act at half the draft, which ties sway to roll. Closed forms of one axis have them at the origin:
SIMPLE = replace(FULL, centre_of_lateral_resistance_frd_m=(0.0, 0.0, 0.0))
CALM = Environment(water=Water(density_kgpm3=DENSITY, level_m=0.0))


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def at_start(simulation: Simulation, euler_rad=(0.0, 0.0, 0.0), body_mps=(0, 0, 0), gyro_radps=(0, 0, 0), down_m=0.0):
    state = initial(simulation, np.zeros((1, 2)), np.zeros(1), np.random.default_rng(0))
    quat = euler_to_quat(np.array([euler_rad]))
    rot = quat_to_matrix(quat)
    motion = replace(
        state.vessel.motion,
        pos_ned_m=state.vessel.motion.pos_ned_m + np.array([0.0, 0.0, down_m]),
        vel_ned_mps=(rot @ np.array(body_mps, dtype=float)).reshape(1, 3),
        quat_ned_frd=quat,
        rot_ned_frd=rot,
        gyro_frd_radps=np.array([gyro_radps], dtype=float),
    )
    return replace(state, vessel=replace(state.vessel, motion=motion))


def run(simulation: Simulation, state: SimulationState, duration_s: float, command=STOPPED) -> list[Kinematics]:
    rng = np.random.default_rng(0)
    motions = [state.vessel.motion]
    for _ in range(round(duration_s / simulation.dt_s)):
        state = step(simulation, state, command, rng)
        motions.append(state.vessel.motion)
    return motions


def period_s(signal: np.ndarray, dt_s: float) -> float:
    """Mean time between upward zero crossings, interpolated."""
    up = np.flatnonzero((signal[:-1] < 0.0) & (signal[1:] >= 0.0))
    times = (up + signal[up] / (signal[up] - signal[up + 1])) * dt_s
    return float(np.diff(times).mean())


def waterline_m(model: VesselSpec) -> tuple[float, float]:
    """Draft and width of one hull's waterline, from the mass by integration."""
    r, target = model.hull.radius_m, model.mass_kg / (2.0 * DENSITY * model.hull.length_m)
    angle = np.linspace(0.0, np.pi, 200_001)
    area = r * r * (angle - np.sin(angle) * np.cos(angle))
    half_angle = np.interp(target, area, angle)
    return r * (1.0 - np.cos(half_angle)), 2.0 * r * np.sin(half_angle)


def test_terminal_speed_solves_the_drag_equation() -> None:
    """15 u + 20 u^2 = T; thrust in line with the drag, so that trim does not enter."""
    level = tuple(replace(p, position_frd_m=(-0.7, p.position_frd_m[1], 0.0)) for p in BARE.propellers)
    model = replace(BARE, propellers=level, centre_of_lateral_resistance_frd_m=(0.0, 0.0, 0.0))
    simulation = Simulation.from_spec(model, CALM, 0.01)
    motion = run(simulation, at_start(simulation), 30.0, np.ones((1, 2)))[-1]
    expected = (-15.0 + np.sqrt(15.0**2 + 4.0 * 20.0 * 500.0)) / 40.0
    assert motion.vel_ned_mps[0, 0] == pytest.approx(expected, rel=1e-9)  # e^-40 of the way left after 30 s


@pytest.mark.medium
def test_three_metres_per_second_against_current_and_wind_leave_a_margin() -> None:
    """3 m/s over ground against 0.7 m/s of current and 8 m/s of wind at no more than 90 % command."""
    environment = Environment(
        water=Water(density_kgpm3=DENSITY),
        current=UniformCurrent(CurrentSpec(0.7, 180.0)),
        wind=Wind(WindSpec(8.0, 0.0, profile="uniform")),
    )
    simulation = Simulation.from_spec(FULL, environment, 0.01)
    motion = run(simulation, at_start(simulation), 30.0, np.full((1, 2), 0.9))[-1]
    assert motion.vel_ned_mps[0, 0] > 3.0


@pytest.mark.medium
@pytest.mark.parametrize(
    ("axis", "linear", "quadratic", "inertia"),
    [(0, 15.0, 20.0, 113.0 + 5.1), (1, 250.0, 150.0, 113.0 + 72.0), (5, 150.0, 200.0, 56.0 + 34.0)],
)
def test_decay_of_surge_sway_yaw(axis: int, linear: float, quadratic: float, inertia: float) -> None:
    """m u' = -a u - b u^2 has u(t) = a u0 e / (a + b u0 (1 - e)), e = exp(-a t / m)."""
    start = np.zeros(6)
    start[axis] = 1.5
    simulation = Simulation.from_spec(replace(SIMPLE, wind=BARE.wind), CALM, 0.0005)
    motions = run(simulation, at_start(simulation, body_mps=start[:3], gyro_radps=start[3:]), 2.0)
    t = np.arange(len(motions)) * 0.0005
    faded = np.exp(-linear * t / inertia)
    expected = linear * 1.5 * faded / (linear + quadratic * 1.5 * (1.0 - faded))
    nu = np.array([np.concatenate([(m.vel_ned_mps @ m.rot_ned_frd[0])[0], m.gyro_frd_radps[0]]) for m in motions])
    # An error of the second order: (decay rate x dt)^2, below (8 x 0.0005)^2, of each decay.
    np.testing.assert_allclose(nu[:, axis], expected, rtol=1e-4)


def test_heave_period_and_decay() -> None:
    simulation = Simulation.from_spec(FULL, CALM, 0.0025)
    motions = run(simulation, at_start(simulation, down_m=0.001), 4.0)
    down = np.array([m.pos_ned_m[0, 2] for m in motions]) - (motions[0].pos_ned_m[0, 2] - 0.001)
    _, width = waterline_m(FULL)
    stiffness = DENSITY * GRAVITY_MPS2 * 2.0 * width * 2.3
    inertia = 113.0 + 216.0
    rate = 500.0 / (2.0 * inertia)
    omega = np.sqrt(stiffness / inertia - rate**2)
    # 1 mm on a 100 mm draft bends the stiffness by 0.3 % of the motion, evenly both ways: the period keeps to 0.1 %.
    assert period_s(down, 0.0025) == pytest.approx(2.0 * np.pi / omega, rel=2e-3)
    last = round(4 * 2.0 * np.pi / omega / 0.0025)
    assert down[last] / down[0] == pytest.approx(np.exp(-rate * last * 0.0025), rel=0.02)


def metacentric_stiffness(model: VesselSpec, second_moment_m4: float) -> float:
    """rho g I - W (KG - KB), with the centre of buoyancy by integration over the segment."""
    draft, _ = waterline_m(model)
    r = model.hull.radius_m
    top = np.arccos(1.0 - draft / r)
    area = quad(lambda a: 2.0 * (r * np.sin(a)) ** 2, 0.0, top)[0]
    moment = quad(lambda a: 2.0 * (r * np.sin(a)) ** 2 * r * (1.0 - np.cos(a)), 0.0, top)[0]
    weight = model.mass_kg * GRAVITY_MPS2
    return DENSITY * GRAVITY_MPS2 * second_moment_m4 - weight * (model.hull.keel_below_cg_m - moment / area)


def test_roll_period() -> None:
    simulation = Simulation.from_spec(SIMPLE, CALM, 0.0025)
    motions = run(simulation, at_start(simulation, euler_rad=(0.003, 0.0, 0.0)), 4.0)
    roll = quat_to_euler(np.concatenate([m.quat_ned_frd for m in motions]))[:, 0]
    _, width = waterline_m(FULL)
    second_moment = 2.0 * (2.3 * width**3 / 12.0 + 2.3 * width * 0.6**2)
    inertia = 23.0 + 78.0
    rate = 230.0 / (2.0 * inertia)
    omega = np.sqrt(metacentric_stiffness(FULL, second_moment) / inertia - rate**2)
    assert period_s(roll, 0.0025) == pytest.approx(2.0 * np.pi / omega, rel=3e-3)


def test_pitch_period() -> None:
    """With 24 strips, whose lumping takes 1/24^2 off the longitudinal second moment."""
    model = replace(SIMPLE, hull=replace(FULL.hull, strips=24))
    simulation = Simulation.from_spec(model, CALM, 0.0025)
    motions = run(simulation, at_start(simulation, euler_rad=(0.0, 0.003, 0.0)), 4.0)
    pitch = quat_to_euler(np.concatenate([m.quat_ned_frd for m in motions]))[:, 1]
    _, width = waterline_m(model)
    inertia = 35.0 + 95.0
    rate = 270.0 / (2.0 * inertia)
    omega = np.sqrt(metacentric_stiffness(model, 2.0 * width * 2.3**3 / 12.0) / inertia - rate**2)
    assert period_s(pitch, 0.0025) == pytest.approx(2.0 * np.pi / omega, rel=4e-3)


def linearised(model: VesselSpec) -> np.ndarray:
    """(9, 9) of heave, roll and pitch, then the six velocities: M nu' + D nu + G eta = 0 with all at half the draft."""
    draft, width = waterline_m(model)
    arm = skew(np.array([0.0, 0.0, model.hull.keel_below_cg_m - 0.5 * draft]))
    there = np.block([[np.eye(3), -arm], [np.zeros((3, 3)), np.eye(3)]])
    rigid = np.diag([model.mass_kg] * 3 + list(model.inertia_kgm2))
    mass = rigid + there.T @ np.diag(astuple(model.added_mass)) @ there
    damping = there.T @ np.diag(astuple(model.damping_linear)) @ there
    length, half = model.hull.length_m, model.hull.centreline_m
    area = 2.0 * width * length
    stiffness = np.zeros((6, 3))
    stiffness[2, 0] = DENSITY * GRAVITY_MPS2 * area
    stiffness[3, 1] = metacentric_stiffness(model, area * (width**2 / 12.0 + half**2))
    stiffness[4, 2] = metacentric_stiffness(model, area * length**2 / 12.0)
    of_pose = np.zeros((3, 6))
    of_pose[(0, 1, 2), (2, 3, 4)] = 1.0
    return np.block([[np.zeros((3, 3)), of_pose], [-np.linalg.solve(mass, stiffness), -np.linalg.solve(mass, damping)]])


def measured_ratio(signal: np.ndarray) -> float:
    """Damping ratio by the logarithmic decrement of the first three half swings, crest to trough."""
    rate = np.diff(signal)
    turns = np.flatnonzero(rate[:-1] * rate[1:] < 0.0) + 1
    first, second, third, fourth = signal[turns[:4]]
    decrement = 0.5 * np.log((first - second) / (third - fourth))
    return float(decrement / np.hypot(np.pi, decrement))


def shipped(name: str) -> VesselSpec:
    vessel = load_with_origins(name).profile.vehicle
    assert vessel is not None
    return replace(vessel, hull=replace(vessel.hull, strips=24))  # lumping takes 1/24^2 off the second moment


@pytest.mark.medium
@pytest.mark.parametrize(("name", "scale"), [("sitl", 1.0), ("vehicles/asv-third", 1.0 / 3.0)])
def test_free_decays_in_heave_roll_and_pitch_have_the_damping_ratios_of_such_hulls(name: str, scale: float) -> None:
    """Let go from 2 mm, 3 mrad and 3 mrad: period and decay of the linearised motion, and damping ratios 0.1 to 0.4."""
    model = shipped(name)
    matrix = linearised(model)
    dt_s = round(0.0025 * scale**0.5, 6)
    simulation = Simulation.from_spec(replace(model, wind=Windage()), CALM, dt_s)
    for axis, start in enumerate((0.002 * scale, 0.003, 0.003)):
        euler = np.zeros(3)
        if axis:
            euler[axis - 1] = start
        state = at_start(simulation, euler_rad=euler, down_m=start if axis == 0 else 0.0)
        rest_m = state.vessel.motion.pos_ned_m[0, 2] - (start if axis == 0 else 0.0)
        motions = run(simulation, state, 4.0 * scale**0.5, np.zeros((1, model.commands)))
        moved = np.concatenate([m.pos_ned_m[:, 2:] - rest_m for m in motions])[:, 0]
        if axis:
            moved = quat_to_euler(np.concatenate([m.quat_ned_frd for m in motions]))[:, axis - 1]
        first = np.zeros(9)
        first[axis] = start
        step_matrix = expm(matrix * dt_s)
        expected = [first]
        for _ in motions[1:]:
            expected.append(step_matrix @ expected[-1])
        # 2 mm on a draft of 100 mm bend the stiffness by half a percent, seen as 1 % of the motion in two swings.
        np.testing.assert_allclose(moved, np.array(expected)[:, axis], atol=0.01 * start)
        roots, shapes = np.linalg.eig(matrix)
        swinging = np.flatnonzero(roots.imag > 1.0)
        mode = roots[swinging[np.argmax(np.abs(shapes[axis, swinging]))]]
        ratio, period = -mode.real / abs(mode), 2.0 * np.pi / abs(mode)
        assert period_s(moved, dt_s) * np.sqrt(1.0 - ratio**2) == pytest.approx(period, rel=0.02)
        assert measured_ratio(moved) == pytest.approx(ratio, rel=0.03)
        assert ratio == pytest.approx((0.110, 0.155, 0.145)[axis], abs=0.005)
        assert period == pytest.approx((0.913, 0.855, 0.878)[axis] * scale**0.5, rel=0.01)


@pytest.mark.medium
@pytest.mark.slow
def test_a_drifting_vessel_ends_with_the_current() -> None:
    environment = Environment(water=Water(density_kgpm3=DENSITY), current=UniformCurrent(CurrentSpec(0.7, 60.0)))
    simulation = Simulation.from_spec(replace(FULL, wind=BARE.wind), environment, 0.01)
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((4, 2)), np.array([0.0, 0.8, 2.0, 4.5]), rng)
    for _ in range(12_000):  # 120 s, e^-15 of the speed left by the linear drag in surge alone
        state = step(simulation, state, np.zeros((4, 2)), rng)
    flow = 0.7 * np.array([np.cos(np.pi / 3), np.sin(np.pi / 3), 0.0])
    np.testing.assert_allclose(state.vessel.motion.vel_ned_mps, np.tile(flow, (4, 1)), atol=1e-5)
    np.testing.assert_allclose(state.current_ned_mps, np.tile(flow, (4, 1)), atol=1e-12)


FRICTIONLESS = replace(BARE, added_mass=FULL.added_mass, damping_linear=Damping(), damping_quadratic=Damping())


def potential_j(motion: Kinematics, simulation: Simulation) -> float:
    """Weight, and buoyancy as the integral of each strip's lift over the depth of its axis."""
    axes = motion.rot_ned_frd[0] @ simulation.vessel.buoyancy.points_frd_m.T
    energy = -FRICTIONLESS.mass_kg * GRAVITY_MPS2 * motion.pos_ned_m[0, 2]
    for depth in motion.pos_ned_m[0, 2] + axes[2] + 0.2:
        top = np.arccos(1.0 - np.clip(depth / 0.2, 0.0, 2.0))
        # int_0^h A dh' with h = r (1 - cos a): r^3 int (a - sin a cos a) sin a da, in closed form
        integral = 0.2**3 * (np.sin(top) - top * np.cos(top) - np.sin(top) ** 3 / 3.0)
        energy += DENSITY * GRAVITY_MPS2 * 2.3 / 6 * integral
    return float(energy)


def energies_j(simulation: Simulation, motions: list[Kinematics]) -> tuple[np.ndarray, np.ndarray]:
    """Total and potential energy, the kinetic one with the water that the added mass stands for."""
    mass = simulation.vessel.hydrodynamics.rigid_mass + simulation.vessel.hydrodynamics.added_mass
    potential = np.array([potential_j(motion, simulation) for motion in motions])
    nu = [np.concatenate([(m.vel_ned_mps @ m.rot_ned_frd[0])[0], m.gyro_frd_radps[0]]) for m in motions]
    return potential + [0.5 * v @ mass @ v for v in nu], potential


@pytest.mark.medium
@pytest.mark.slow
def test_energy_is_conserved_without_damping() -> None:
    """In roll, heave and sway; pitch takes the centre of buoyancy at rest, which is good to second order only."""
    simulation = Simulation.from_spec(FRICTIONLESS, CALM, 0.0005)
    start = at_start(simulation, euler_rad=(0.1, 0, 0), body_mps=(0, 0.4, 0), gyro_radps=(0.3, 0, 0), down_m=0.02)
    total, potential = energies_j(simulation, run(simulation, start, 10.0)[::50])
    # Leap-frog lets the energy ripple by some (omega dt)^2 = 1.4e-5 of what is exchanged; it must not drift.
    assert np.ptp(potential) > 5.0
    assert np.ptp(total) < 1e-4 * np.ptp(potential)


@pytest.mark.medium
def test_damping_only_takes_energy() -> None:
    simulation = Simulation.from_spec(replace(FULL, wind=BARE.wind), CALM, 0.0005)
    start = at_start(simulation, euler_rad=(0.1, 0.0, 0.0), body_mps=(1.0, 0.3, 0.0), gyro_radps=(0, 0, 0.5))
    total, _ = energies_j(simulation, run(simulation, start, 5.0)[::200])
    assert (np.diff(total) < 0.0).all()


@pytest.mark.medium
def test_the_vessel_keeps_its_course_and_trim_at_full_speed() -> None:
    """Knocked off by 3 deg/s it comes back to a straight line; bow down by no more than the couple of thrust and drag.

    Thrust acts 0.55 m above the origin, drag 0.2 m below it; the Munk moment in pitch takes a third of the stiffness.
    """
    simulation = Simulation.from_spec(FULL, CALM, 0.0025)
    motion = run(simulation, at_start(simulation, gyro_radps=(0.0, 0.0, 0.05)), 30.0, np.ones((1, 2)))[-1]
    roll, pitch, _ = quat_to_euler(motion.quat_ned_frd)[0]
    assert abs(motion.gyro_frd_radps[0, 2]) < 1e-6
    assert abs(roll) < 1e-6
    _, width = waterline_m(FULL)
    stiffness = metacentric_stiffness(FULL, 2.0 * width * 2.3**3 / 12.0)
    assert -1.6 * 500.0 * (0.55 + 0.2) / stiffness < pitch < 0.0


@pytest.mark.medium
def test_a_beam_wind_heels_by_the_couple_of_wind_and_drag() -> None:
    """Adrift with the wind from port: its force at half the height of the areas, the hulls' drag at half the draft."""
    environment = Environment(water=CALM.water, wind=Wind(WindSpec(14.0, 270.0, profile="uniform")))
    simulation = Simulation.from_spec(replace(FULL, wind=replace(FULL.wind, yaw_coefficient=0.0)), environment, 0.005)
    motion = run(simulation, at_start(simulation), 20.0)[-1]
    roll, _, _ = quat_to_euler(motion.quat_ned_frd)[0]
    drift_mps = motion.vel_ned_mps[0, 1]
    force_n = 0.5 * 1.2 * 0.9 * 1.3 * (14.0 - drift_mps) ** 2
    assert 250.0 * drift_mps + 150.0 * drift_mps**2 == pytest.approx(force_n, rel=1e-3)
    draft, width = waterline_m(FULL)
    lever_m = 0.5 * draft + 0.5 * 1.3 / 2.3
    stiffness = metacentric_stiffness(FULL, 2.0 * (2.3 * width**3 / 12.0 + 2.3 * width * 0.6**2))
    assert force_n * lever_m > 0.005 * stiffness
    # 7 mrad of heel: the waterline's walls lean by 0.1 rad, which bends the stiffness by some 1 % at 5 mm of immersion.
    assert roll == pytest.approx(force_n * lever_m / stiffness, rel=0.02)


@pytest.mark.medium
def test_in_a_turn_to_starboard_the_vessel_heels_to_port() -> None:
    """Centrifugal force at the centre of gravity, above the water, against the drag below it."""
    simulation = Simulation.from_spec(FULL, CALM, 0.005)
    motion = run(simulation, at_start(simulation), 20.0, np.array([[1.0, 0.4]]))[-1]
    assert motion.gyro_frd_radps[0, 2] > 0.1
    assert quat_to_euler(motion.quat_ned_frd)[0, 0] < -0.005


def test_wind_and_vessel_turned_together_feel_the_same() -> None:
    accelerations = []
    for yaw_deg in (0.0, 137.0):
        environment = Environment(wind=Wind(WindSpec(9.0, 40.0 + yaw_deg, profile="uniform")))
        simulation = Simulation.from_spec(FULL, environment, 0.0025)
        motion = run(simulation, at_start(simulation, euler_rad=(0, 0, np.radians(yaw_deg))), 0.0025)[1]
        surge_sway_heave = motion.acc_ned_mps2 @ motion.rot_ned_frd[0]
        accelerations.append(np.concatenate([surge_sway_heave[0], motion.angular_acc_frd_radps2[0]]))
    np.testing.assert_allclose(accelerations[0], accelerations[1], atol=1e-9)
    assert accelerations[0][0] < -0.05  # from 40 degrees on the starboard bow: backward,
    assert accelerations[0][1] < -0.05  # and to port


@pytest.mark.medium
def test_an_imu_can_integrate_what_the_vessel_does() -> None:
    """Specific force and gyro, integrated without knowing the vessel, return velocity, position and attitude."""
    rng = np.random.default_rng(2)
    waves = realise_waves(WaveSpec("jonswap", 0.3, 2.5, 30.0, spreading=5.0), Water(), rng)
    simulation = Simulation.from_spec(FULL, Environment(waves=waves), 0.0025)
    motions = run(simulation, at_start(simulation), 10.0, np.array([[0.9, 0.3]]))
    attitude = Rotation.identity()
    velocity, position, gyro_before = np.zeros(3), motions[0].pos_ned_m[0].copy(), np.zeros(3)
    for motion in motions[1:]:
        old, velocity = velocity, velocity + 0.0025 * motion.acc_ned_mps2[0]
        position += 0.00125 * (old + velocity)
        attitude = attitude * Rotation.from_rotvec(0.00125 * (gyro_before + motion.gyro_frd_radps[0]))
        gyro_before = motion.gyro_frd_radps[0]
    np.testing.assert_allclose(velocity, motions[-1].vel_ned_mps[0], atol=1e-9)
    # Velocity and rates hold for the ends of the steps. Trapezoids of them differ from the step's own by dt^2 / 4 of
    # all that the acceleration changes, 3 m/s^2 and 3 rad/s^2; the quaternion errs by (w dt)^3 / 12 a step besides.
    np.testing.assert_allclose(position, motions[-1].pos_ned_m[0], atol=5e-6)
    np.testing.assert_allclose(attitude.as_matrix(), motions[-1].rot_ned_frd[0], atol=1e-5)
    gyro = np.array([m.gyro_frd_radps[0] for m in motions])
    rates = np.array([m.angular_acc_frd_radps2[0] for m in motions])
    np.testing.assert_allclose(np.diff(gyro, axis=0), 0.0025 * rates[1:], atol=1e-12)
    assert np.std(gyro[:, 1]) > 0.02  # the sea did move it


@pytest.mark.medium
@pytest.mark.slow
def test_a_froude_scaled_vessel_moves_alike() -> None:
    """A quarter of the length in half the time, through waves, current and wind: holds only if every term does."""
    tracks = []
    for scale in (1.0, 0.25):
        water = Water(depth_m=3.0 * scale, level_m=0.0)
        waves = realise_waves(WaveSpec("regular", 0.2 * scale, 2.5 * scale**0.5, 50.0), water, np.random.default_rng(0))
        wind, current = (
            Wind(WindSpec(6.0 * scale**0.5, 20.0, profile="uniform")),
            UniformCurrent(CurrentSpec(0.6 * scale**0.5, 80.0)),
        )
        environment = Environment(water, current, waves, wind)
        simulation = Simulation.from_spec(froude_scaled(FULL, scale), environment, 0.004 * scale**0.5)
        # The waves' mean force is held for a time that is no property of the vessel: for as many steps at both scales.
        simulation = replace(simulation, drift_ns=5 * simulation.dt_ns)
        motions = run(simulation, at_start(simulation), 20.0 * scale**0.5, np.array([[0.9, 0.4]]))
        positions = np.concatenate([m.pos_ned_m for m in motions]) / scale
        tracks.append(np.column_stack([positions, np.concatenate([m.quat_ned_frd for m in motions])]))
    np.testing.assert_allclose(tracks[0], tracks[1], atol=2e-4)
    assert np.ptp(tracks[0][:, 0]) > 5.0
