"""Scripted vessels: where they are against the geometry of their tracks, what they look like, and running into one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from asv import ASV

from sim_core import fleet as fleets
from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water
from sim_core.fleet import Fleet, SeenHull
from sim_core.sensors.rangefinder import ObstacleScanner, Rangefinder
from sim_core.sensors.spec import ObstacleScannerSpec, RangefinderSpec
from sim_core.vessel.spec import DemiHull, HullSection
from sim_core.world.debris import BodyKind, Launch, volume_below_m3
from sim_core.world.plan import OPEN_WATER, convex_hull, inset
from sim_core.world.primitive_rays import PrimitiveCaster
from sim_core.world.spec import TrafficSpec
from sim_core.world.traffic import ScriptedTrack, ScriptedVessel, scripted_motion

SPEED_MPS, RADIUS_M = 2.0, 20.0


def barge(*places: tuple[float, float], name: str = "barge", level_m: float = 0.0, **keys: object) -> ScriptedVessel:
    spec = TrafficSpec(track_ned_m=places, length_m=60.0, beam_m=12.0, draft_m=2.0, height_m=3.0, **keys)
    return ScriptedVessel.from_spec(name, spec, level_m)


@pytest.mark.parametrize(
    ("places", "loop"),
    [
        ([(0.0, 0.0), (300.0, 0.0)], False),
        ([(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (30.0, 60.0)], False),
        ([(0.0, 0.0), (100.0, 0.0), (10.0, 5.0), (10.0, 6.0)], False),  # a hairpin, and no room for an arc
        ([(0.0, 0.0), (100.0, 0.0)], True),  # to and fro
        ([(0.0, 0.0), (100.0, 0.0), (50.0, 80.0)], True),
    ],
)
def test_the_pose_is_continuous_and_the_heading_is_the_way_made_good(places, loop: bool) -> None:
    track = ScriptedTrack.through(places, SPEED_MPS, RADIUS_M, loop, start_s=5.0)
    step_s = 0.05
    rows = [track.at(number * step_s) for number in range(12_000)]
    place = np.array([row[0] for row in rows])
    heading, speed, rate = np.array([row[1:] for row in rows]).T
    moved = np.diff(place, axis=0)
    assert np.hypot(*moved.T).max() <= SPEED_MPS * step_s * (1.0 + 1e-9)
    # No turn is faster than on an arc of half the radius.
    assert np.abs(np.angle(np.exp(1j * np.diff(heading)))).max() <= SPEED_MPS / (0.5 * RADIUS_M) * step_s * (1 + 1e-9)
    assert place[0] == pytest.approx(places[0])
    assert not speed[: int(5.0 / step_s)].any()
    # Velocity and rate are those of place and heading, in the middle of a step, but where a piece ends in it.
    steady = (speed[1:] == speed[:-1]) & (rate[1:] == rate[:-1])
    middle = heading[:-1] + 0.5 * step_s * rate[:-1]
    along = (speed[:-1] * step_s)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
    assert np.abs(moved - along)[steady].max() < 1e-4  # of chord and arc
    if loop:
        assert speed[-1] > 0.0 or rate[-1] != 0.0
        lap = round((track.end_s - track.lap_s) / step_s)
        assert place[8000 + lap] == pytest.approx(place[8000], abs=2 * SPEED_MPS * step_s)
    else:
        assert place[-1] == pytest.approx(places[-1])
        assert speed[-1] == rate[-1] == 0.0


def test_on_an_arc_the_acceleration_is_the_change_of_the_velocity() -> None:
    vessel = barge((0.0, 0.0), (200.0, 0.0), (200.0, 200.0), speed_mps=SPEED_MPS)
    middle_s, step_s = (140.0 + 0.5 * 60.0 * math.pi / 2) / SPEED_MPS, 0.01
    before, now, after = (scripted_motion([vessel], middle_s + late_s) for late_s in (-step_s, 0.0, step_s))
    assert now.gyro_frd_radps[0, 2] == pytest.approx(SPEED_MPS / 60.0)
    assert now.acc_ned_mps2 == pytest.approx((after.vel_ned_mps - before.vel_ned_mps) / (2.0 * step_s), abs=1e-8)


def test_a_right_angle_is_rounded_by_an_arc_of_the_radius() -> None:
    track = ScriptedTrack.through([(0.0, 0.0), (100.0, 0.0), (100.0, 100.0)], SPEED_MPS, RADIUS_M)
    places = np.array(
        [track.at(40.0 + share * RADIUS_M * math.pi / 2 / SPEED_MPS)[0] for share in np.linspace(0, 1, 9)]
    )
    assert np.hypot(*(places - [80.0, 20.0]).T) == pytest.approx(np.full(9, RADIUS_M))
    assert track.end_s == pytest.approx((80.0 + RADIUS_M * math.pi / 2 + 80.0) / SPEED_MPS)


def test_its_hull_is_as_large_as_it_says_and_closed() -> None:
    vessel = barge((10.0, -5.0), heading_deg=90.0)
    assert np.ptp(vessel.mesh.vertices_m, axis=0) == pytest.approx([60.0, 12.0, 5.0])
    plan_m2 = 60.0 * 12.0 - 2 * 0.5 * 9.0 * 3.0
    assert volume_below_m3(vessel.mesh, 0.0) == pytest.approx(2.0 * plan_m2)
    motion = scripted_motion([vessel], 3.0)
    assert motion.pos_ned_m[0] == pytest.approx([10.0, -5.0, 0.0])
    assert motion.rot_ned_frd[0] @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])
    assert not motion.vel_ned_mps.any()
    high = barge((0.0, 0.0), level_m=0.4)
    assert scripted_motion([high], 0.0).pos_ned_m[0, 2] == -0.4


def test_polygons_are_shrunk_and_wrapped() -> None:
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])
    assert inset(square, 0.5) == pytest.approx(np.array([[0.5, 0.5], [3.5, 0.5], [3.5, 1.5], [0.5, 1.5]]))
    assert inset(square[::-1], 0.5) == pytest.approx(inset(square, 0.5)[::-1])
    inside = np.random.default_rng(1).uniform([0.0, 0.0], [4.0, 2.0], (50, 2))
    assert sorted(convex_hull(np.concatenate([inside, square])).tolist()) == sorted(square.tolist())


@pytest.mark.medium
def test_a_vessel_that_is_run_over_takes_the_speed_of_the_barge_and_the_barge_keeps_to_its_track() -> None:
    """Against a wall that moves: it leaves at (1 + e) times the wall's speed, if nothing holds it back."""
    traffic = [barge((-40.0, 0.0), (300.0, 0.0), speed_mps=SPEED_MPS)]
    fleet = Fleet.from_spec([ASV], Environment(), 0.0025, names=("asv",), traffic=traffic)
    # Its stern is 0.35 m before the bow.
    state = fleets.initial(fleet, np.array([[-8.5, 0.0]]), np.zeros(1), np.random.default_rng(1))
    commands, fastest, what = fleet.by_model([[0.0, 0.0]]), 0.0, set()
    rng = np.random.default_rng(1)
    for _ in range(1200):
        state = fleets.step(fleet, state, commands, rng)
        view = fleets.state_of(fleet, state, 0)
        fastest = max(fastest, float(view.vessel.motion.vel_ned_mps[0, 0]))
        what |= set(view.contacts.what)
    assert what == {"barge"}
    assert SPEED_MPS < fastest < 2.0 * SPEED_MPS
    # Pushed along before the bow.
    assert view.vessel.motion.pos_ned_m[0, 0] > -10.0 + SPEED_MPS * 3.0 + 0.8
    both = fleets.joined_motion(fleet, state)
    assert both.pos_ned_m[1] == pytest.approx([-40.0 + SPEED_MPS * 3.0, 0.0, 0.0])


def test_two_scripted_vessels_pass_through_each_other_and_say_nothing() -> None:
    traffic = [barge((0.0, 0.0), name=name) for name in ("one", "other")]
    fleet = Fleet.from_spec([ASV], Environment(), 0.0025, traffic=traffic)
    state = fleets.initial(fleet, np.array([[200.0, 0.0]]), np.zeros(1), np.random.default_rng(1))
    state = fleets.step(fleet, state, fleet.by_model([[0.0, 0.0]]), np.random.default_rng(1))
    assert not len(state.close)


BOX_VESSEL = replace(
    ASV,
    hull=None,
    hulls=(DemiHull(length_m=4.0, keel_frd_m=(0.0, 0.0, 0.25), section=HullSection(width_m=2.0, depth_m=0.6)),),
)


def seen_from_the_origin(heading_rad: float = 0.0) -> tuple[Fleet, fleets.FleetState]:
    """A box-shaped vessel 20 m to the east, its bow east; a barge 50 m ahead, athwart; one far off."""
    traffic = [barge((50.0, 0.0), heading_deg=90.0), barge((900.0, 0.0), name="far")]
    fleet = Fleet.from_spec([ASV, BOX_VESSEL], Environment(Water()), 0.0025, traffic=traffic)
    headings = np.array([heading_rad, math.pi / 2])
    return fleet, fleets.initial(fleet, np.array([[0.0, 0.0], [0.0, 20.0]]), headings, np.random.default_rng(1))


def test_range_sensors_meet_the_sides_of_hulls() -> None:
    fleet, state = seen_from_the_origin(0.3)
    truth = fleets.kinematics_of(fleet, state, 0)

    def hulls(range_m: float):
        return fleets.hull_walls(fleet, state, 0, range_m)

    def ranged(degrees: float, pitch: float = 0.0, hulls=hulls) -> float:
        turn = math.radians(degrees) - 0.3
        ahead = (math.cos(turn) * math.cos(pitch), math.sin(turn) * math.cos(pitch), math.sin(pitch))
        unit = Rangefinder(RangefinderSpec(direction_frd=ahead, through="air"), 20.0, 500.0, hulls=hulls)
        return float(unit.measure(unit.initial(1, RNG), truth, RNG)[1].range_m[0])

    RNG = np.random.default_rng(1)
    assert ranged(0.0) == pytest.approx(50.0 - 6.0)
    assert ranged(10.0) == pytest.approx(44.0 / math.cos(math.radians(10.0)))
    assert ranged(90.0) == pytest.approx(20.0 - 2.0)
    assert ranged(92.0) == pytest.approx(18.0 / math.cos(math.radians(2.0)))
    assert math.isinf(ranged(180.0))
    assert math.isinf(ranged(0.0, hulls=None))
    assert math.isinf(ranged(0.0, pitch=-0.2)) or ranged(0.0, pitch=-0.2) > 400.0  # over the barge
    assert hulls(10.0) is OPEN_WATER
    scanner = ObstacleScanner(ObstacleScannerSpec(), OPEN_WATER, hulls)
    _, sample = scanner.measure(scanner.initial(1, RNG), truth, RNG)
    ahead, abeam = round(-math.degrees(0.3) / 5.0) % 72, round((90.0 - math.degrees(0.3)) / 5.0)
    assert sample.range_m[0, ahead] == pytest.approx(44.0, rel=2e-3)
    assert sample.range_m[0, abeam] == pytest.approx(18.0, rel=2e-3)
    assert math.isinf(sample.range_m[0, 36])


def test_looking_down_no_hull_is_asked_for() -> None:
    def never(range_m: float):
        raise AssertionError

    fleet, state = seen_from_the_origin()
    sounder = Rangefinder(RangefinderSpec(), 20.0, hulls=never)
    rng = np.random.default_rng(1)
    truth = fleets.kinematics_of(fleet, state, 0)
    _, sample = sounder.measure(sounder.initial(1, rng), truth, rng)
    assert sample.range_m[0] == pytest.approx(20.0 - truth.pos_ned_m[0, 2])


def test_rays_meet_the_hulls_of_others_and_not_ones_own() -> None:
    fleet, state = seen_from_the_origin()
    state = fleets.launch(fleet, state, Launch(0, BodyKind.TRUNK, 0.0, -30.0, 0.0))
    bodies = fleets.drifting_bodies(fleet, state, but=0)
    assert len(bodies.meshes) == 4  # a trunk, a vessel, two barges
    assert len(fleets.drifting_bodies(fleet, state).meshes) == 5
    down = float(fleets.kinematics_of(fleet, state, 1).pos_ned_m[0, 2])  # through the middle of the box
    origin = np.array([[0.0, 0.0, down]] * 2 + [[0.0, 0.0, 0.1]] * 2, np.float32)
    ways = np.radians([0.0, 90.0, -90.0, 180.0])
    direction = np.column_stack([np.cos(ways), np.sin(ways), np.zeros(4)]).astype(np.float32)
    hits = PrimitiveCaster([], []).cast(origin, direction, bodies)
    assert hits.range_m[:2] == pytest.approx([44.0, 18.0], abs=1e-3)
    assert hits.range_m[2] == pytest.approx(30.0, abs=0.3)
    assert np.isinf(hits.range_m[3])
    assert hits.normal_ned[0] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-6)


def test_sides_follow_a_hull_that_turns() -> None:
    shape = SeenHull.of_model(BOX_VESSEL)
    turn = 0.7
    rotation = np.array(
        [[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    walls = shape.walls(np.array([5.0, 6.0, 0.1]), rotation)
    corners = sorted(
        (rotation[:2, :2] @ [ahead, right] + [5.0, 6.0]).tolist() for ahead in (2, -2) for right in (1, -1)
    )
    assert np.array(sorted(walls.from_ne_m.tolist())) == pytest.approx(np.array(corners))
    assert walls.top_down_m == pytest.approx(np.full(4, 0.1 + 0.25 - 0.6))
    assert walls.bottom_down_m == pytest.approx(np.full(4, 0.1 + 0.25))
