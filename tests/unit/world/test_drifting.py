"""Bodies adrift against closed forms: drag, swimming, waves, and the boom that holds them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sim_core.environment.spec import Water as StillLake
from sim_core.environment.spec import WaveSpec
from sim_core.environment.waves import realise_waves
from sim_core.kinematics import Kinematics
from sim_core.world.contact import Outline
from sim_core.world.debris import BodyKind, DebrisState, Launch, bodies_at, drift, launched, make_body, no_debris
from sim_core.world.plan import Capsules
from sim_core.world.river import FlatBed
from sim_core.world.waterway import STILL, Afloat, StepTimes, WaterMotion, Waterway
from sim_core.world.waterway import step as waterway_step

DT_NS = 20_000_000
STILL_WATER = np.zeros((1, 3))


def one(kind: BodyKind, heading_rad: float = 0.0, current: tuple[float, float] = (0.0, 0.0)) -> DebrisState:
    return launched(no_debris(), Launch(0, kind, 0.0, 0.0, heading_rad), np.array([*current, 0.0]), 0.0)


def drifted(debris: DebrisState, current: tuple[float, float], seconds: float, dt_ns: int = DT_NS) -> DebrisState:
    water = np.array([[*current, 0.0]])
    for _ in range(round(seconds * 1e9 / dt_ns)):
        debris = drift(debris, dt_ns, water, np.zeros(1))
    return debris


@pytest.mark.medium
@pytest.mark.parametrize("kind", [BodyKind.TRUNK, BodyKind.PLANTS])
def test_it_comes_to_the_current_as_quadratic_drag_brings_it(kind: BodyKind) -> None:
    """w' = -w^2 / l for the slip w has the solution w0 / (1 + w0 t / l), which the step keeps exactly."""
    debris, seconds, current = one(kind), 12.0, 0.8
    steady = debris.figures
    slip_length = float(steady.masses_kg[0, 0] / steady.drag_kgpm[0, 0])
    # Along its length: the eddies turn it by a few degrees, so the slip across stays small.
    ended = drifted(debris, (current, 0.0), seconds)
    expected = current - current / (1.0 + current * seconds / slip_length)
    assert ended.vel_ned_mps[0, 0] == pytest.approx(expected, abs=0.02 * current)
    late = drifted(debris, (current, 0.0), 600.0, 10 * DT_NS)
    assert late.vel_ned_mps[0, :2] == pytest.approx([current, 0.0], abs=0.02)


def test_the_drag_is_exact_whatever_the_step() -> None:
    debris = one(BodyKind.TRUNK)
    figures = debris.figures
    slip_length = float(figures.masses_kg[0, 0] / figures.drag_kgpm[0, 0])
    moved = drift(debris, 10_000_000_000, np.array([[1.0, 0.0, 0.0]]), np.zeros(1))
    assert moved.vel_ned_mps[0, 0] == pytest.approx(1.0 - 1.0 / (1.0 + 10.0 / slip_length), rel=1e-12)


def test_launched_into_a_current_it_goes_with_it_at_once() -> None:
    current = (0.3, -0.6)
    ended = drifted(one(BodyKind.TRUNK, 1.0, current), current, 30.0)
    assert ended.pos_ned_m[0, :2] == pytest.approx(30.0 * np.array(current), abs=1e-9)


def test_an_animal_swims_ahead() -> None:
    ended = drifted(one(BodyKind.ANIMAL, math.radians(90.0)), (0.0, 0.0), 10.0)
    assert np.hypot(*ended.vel_ned_mps[0, :2]) == pytest.approx(make_body(BodyKind.ANIMAL).swim_mps, rel=0.02)
    assert ended.pos_ned_m[0, 1] > 2.3


@pytest.mark.medium
def test_it_turns_a_little_and_each_in_its_own_way() -> None:
    debris = one(BodyKind.TRUNK)
    for _ in range(3):
        debris = launched(debris, Launch(0, BodyKind.TRUNK, 50.0, 0.0), np.zeros(3), 0.0)
    ended = drifted(debris, (0.0, 0.0), 60.0)
    assert len(set(np.round(ended.yaw_rad, 4))) == 4
    assert np.abs(ended.yaw_rad).max() < math.radians(40.0)


def test_it_rides_the_waves() -> None:
    field = realise_waves(WaveSpec("regular", 0.3, 4.0, 0.0), StillLake(), np.random.default_rng(1))
    debris = one(BodyKind.TRUNK)
    middle = make_body(BodyKind.TRUNK).middle_below_surface_m
    for step in range(200):
        surface = -field.elevation_m(step * 0.02, debris.pos_ned_m[:, :2])
        before = debris.pos_ned_m[0, 2]
        debris = drift(debris, DT_NS, STILL_WATER, surface)
        assert debris.pos_ned_m[0, 2] == pytest.approx(surface[0] + middle)
        assert debris.vel_ned_mps[0, 2] == pytest.approx((debris.pos_ned_m[0, 2] - before) / 0.02)


def test_rays_meet_it_between_its_steps() -> None:
    debris = drifted(one(BodyKind.TRUNK, 0.3, (0.5, 0.2)), (0.5, 0.2), 1.0)
    early = bodies_at(debris, 990_000_000)
    assert early.pos_ned_m[0] == pytest.approx(debris.pos_ned_m[0] - 0.01 * debris.vel_ned_mps[0])
    rotation = bodies_at(debris, debris.time_ns).rot_ned_body[0]
    assert rotation @ rotation.T == pytest.approx(np.eye(3))
    yaw = float(debris.yaw_rad[0])
    assert rotation[:, 0] == pytest.approx([math.cos(yaw), math.sin(yaw), 0.0])
    assert np.linalg.det(rotation) == pytest.approx(1.0)


ZERO = np.zeros((1, 3))
FAR_OFF = Kinematics(
    pos_ned_m=np.array([[1000.0, 1000.0, 0.0]]),
    vel_ned_mps=ZERO,
    acc_ned_mps2=ZERO,
    quat_ned_frd=np.array([[1.0, 0.0, 0.0, 0.0]]),
    rot_ned_frd=np.eye(3)[None],
    gyro_frd_radps=ZERO,
    angular_acc_frd_radps2=ZERO,
)


def carried(waterway: Waterway, current: tuple[float, float], seconds: float) -> Afloat:
    hull = np.zeros((2, 3)), np.full(1, 0.2)
    outline = Outline(*hull, 100.0, 1.0, *hull)
    water = WaterMotion(lambda places: np.array([[*current, 0.0]]), lambda places: np.zeros(len(places)), 997.8)
    afloat = STILL
    for step in range(round(seconds * 1e9 / DT_NS)):
        afloat = waterway_step(waterway, outline, afloat, StepTimes(step * DT_NS, DT_NS, DT_NS), FAR_OFF, water)
    return afloat


BOOM = Capsules(
    np.array([[-20.0, 15.0], [0.0, 15.0]]), np.array([[0.0, 15.0], [20.0, 15.0]]), np.full(2, 0.4), ("log boom",) * 2
)


@pytest.mark.medium
@pytest.mark.parametrize("kind", BodyKind)
@pytest.mark.parametrize(
    "heading_deg",
    [50.0, *(pytest.param(heading, marks=(pytest.mark.slow, pytest.mark.nightly)) for heading in (0.0, 90.0, 200.0))],
)
def test_the_boom_holds_it(kind: BodyKind, heading_deg: float) -> None:
    waterway = Waterway(BOOM, launches=(Launch(0, kind, 3.0, 8.0, math.radians(heading_deg)),))
    debris = carried(waterway, (0.0, 1.2), 40.0).debris
    assert debris.pos_ned_m[0, 1] < 15.0 - 0.3 - 0.5 * make_body(kind).radius_m
    assert debris.pos_ned_m[0, 1] > 8.0
    assert abs(debris.vel_ned_mps[0, 1]) < 0.02


@pytest.mark.medium
def test_it_slides_along_a_slanting_boom() -> None:
    """63 degrees of slant: the current's part along the boom pushes more than the friction of its part across."""
    slanting = Capsules(np.array([[-20.0, 0.0]]), np.array([[20.0, 80.0]]), np.array([0.4]), ("log boom",))
    waterway = Waterway(slanting, launches=(Launch(0, BodyKind.PLANTS, -10.0, 10.0, 0.0),))
    early, late = (carried(waterway, (0.0, 1.0), seconds).debris.pos_ned_m[0] for seconds in (20.0, 30.0))
    along = np.array([1.0, 2.0]) / math.sqrt(5.0)
    assert float((late - early)[:2] @ along) > 3.0
    assert abs(float((late - early)[:2] @ (-along[1], along[0]))) < 0.2  # the raft is no circle, and turns


@pytest.mark.medium
def test_a_bank_stops_it() -> None:
    class Slope:
        def bed_down_m(self, north_east_m: np.ndarray) -> np.ndarray:
            return 5.0 - 0.5 * north_east_m[..., 1]

        def gradient(self, north_east_m: np.ndarray) -> np.ndarray:
            return np.broadcast_to([0.0, -0.5], north_east_m.shape)

    waterway = Waterway(Capsules.joined(()), Slope(), (Launch(0, BodyKind.TRUNK, 0.0, 0.0, math.radians(90.0)),))
    debris = carried(waterway, (0.0, 0.7), 25.0).debris
    bow_east_m = debris.pos_ned_m[0, 1] + abs(math.sin(debris.yaw_rad[0])) * debris.figures.half_axis_m[0]
    aground_east_m = (5.0 - make_body(BodyKind.TRUNK).draught_m) / 0.5
    assert bow_east_m == pytest.approx(aground_east_m, abs=0.1)


def test_launches_come_when_they_are_due() -> None:
    launches = tuple(Launch(at * 1_000_000_000, BodyKind.BRANCH, 0.0, 0.0) for at in (1, 2, 2))
    waterway = Waterway(Capsules.joined(()), FlatBed(20.0), launches)
    assert [len(carried(waterway, (0.0, 0.0), seconds).debris.bodies) for seconds in (0.9, 1.5, 2.5)] == [0, 1, 3]
