"""Contact with triangles: nearest places by brute force, and hulls that run into rocks, walls and poles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from asv import ASV
from numpy import int32

from sim_core.environment.environment import Environment
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState, initial, step
from sim_core.vessel.spec import VesselSpec
from sim_core.world import mesh_contact
from sim_core.world.contact import Outline
from sim_core.world.geometry import CONCRETE, ROCK, UPRIGHT, Mesh, box, cylinder, ellipsoid, moved
from sim_core.world.mesh_contact import CELL_M, Triangles, find_reachable, nearest_on_triangles
from sim_core.world.plan import Capsules
from sim_core.world.waterway import Waterway
from xitl_cli.profile import load_profile

FULL, THIRD = (load_profile(name).vehicle for name in ("asv-full", "asv-third"))
ROCK_10_M = moved(ellipsoid((5.0, 5.0, 5.0), ROCK, 24, 16), (0.0, 0.0, 2.0))
"""Its middle at the origin, 2 m below the water: 4.6 m of radius at the waterline."""


def sphere_centres(outline: Outline, motion: Kinematics) -> Array:
    """Centres (N, S, 3) of the spheres, in NED."""
    turned: Array = np.einsum("nij,sj->nsi", motion.rot_ned_frd, outline.spheres_frd_m)
    return turned + motion.pos_ned_m[:, None]


def lake(*meshes: Mesh, vessel: VesselSpec | None = None, dt_s: float = 0.0025) -> Simulation:
    triangles = Triangles.from_meshes([(f"rock {n}", mesh) for n, mesh in enumerate(meshes)], 0.0)
    waterway = Waterway(Capsules.joined(()), triangles=triangles)
    return Simulation.from_spec(vessel or ASV, Environment(), dt_s, waterway)


def under_way(simulation: Simulation, place: Array, heading_rad: Array, speed_mps: float) -> SimulationState:
    """Vessels (N, 2) and (N,) that already go ahead."""
    state = initial(simulation, place, heading_rad, np.random.default_rng(1))
    ahead = np.column_stack([np.cos(heading_rad), np.sin(heading_rad), np.zeros(len(place))])
    motion = replace(state.vessel.motion, vel_ned_mps=speed_mps * ahead)
    return replace(state, vessel=replace(state.vessel, motion=motion))


def sailed(simulation: Simulation, state: SimulationState, seconds: float, throttle: float) -> list[SimulationState]:
    rng, command, states = np.random.default_rng(1), np.full((1, 2), throttle), [state]
    for _ in range(round(seconds / simulation.dt_s)):
        states.append(step(simulation, states[-1], command, rng))
    return states


def energy_j(vessel: VesselSpec, state: SimulationState) -> Array:
    """Of motion, rotation included, added mass not: what the hull itself brings."""
    motion = state.vessel.motion
    spin = np.asarray(vessel.inertia_kgm2) * motion.gyro_frd_radps**2
    whole: Array = 0.5 * vessel.mass_kg * np.vecdot(motion.vel_ned_mps, motion.vel_ned_mps) + 0.5 * spin.sum(axis=1)
    return whole


@pytest.mark.medium
def test_the_nearest_place_on_a_triangle_is_that_of_dense_sampling() -> None:
    rng = np.random.default_rng(3)
    corners, points = rng.uniform(-1.0, 1.0, (200, 3, 3)), rng.uniform(-2.0, 2.0, (200, 3))
    corners[0, 2] = corners[0, 1]  # two corners the same: an edge
    corners[1] = corners[1, :1]  # all three: a point
    share = np.array([(u, v, 100 - u - v) for u in range(101) for v in range(101 - u)]) / 100.0
    found = nearest_on_triangles(points, corners)
    sampled = np.linalg.norm((share @ corners) - points[:, None], axis=2).min(axis=1)
    apart = np.linalg.norm(found - points, axis=1)
    assert np.all(apart <= sampled + 1e-9)
    assert apart == pytest.approx(sampled, abs=0.03)  # of the sampling


def test_the_cells_find_every_triangle_that_a_box_meets(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    monkeypatch.setattr(mesh_contact, "_MOST_CELLS", 16)
    corners = rng.uniform(-60.0, 60.0, (300, 1, 3)) * [1, 1, 0.02] + rng.uniform(-4.0, 4.0, (300, 3, 3)) * [1, 1, 0.1]
    corners[:3] *= [5.0, 5.0, 1.0]
    mesh = Mesh(corners.reshape(-1, 3), np.arange(900, dtype=int32).reshape(-1, 3), ROCK)
    triangles = Triangles.from_meshes([("rocks", mesh)], 0.0)
    assert len(triangles) == 300
    assert len(triangles.everywhere)
    low, high = corners.min(axis=1), corners.max(axis=1)
    for _ in range(50):
        at, size = rng.uniform(-60.0, 60.0, 3) * [1, 1, 0.02], rng.uniform(0.1, 3 * CELL_M, 3)
        meets = np.flatnonzero(np.all((low < at + size) & (high > at), axis=1))
        assert sorted(triangles.within(at, at + size).tolist()) == meets.tolist()


@pytest.mark.medium
@pytest.mark.parametrize("vessel", [FULL, THIRD], ids=["asv-full", "asv-third"])
@pytest.mark.parametrize(("speed_mps", "dt_s"), [(1.0, 0.0025), (3.0, 0.0025), (5.0, 0.0025), (5.0, 0.005)])
def test_a_10_m_rock_stops_a_boat_from_every_side(vessel: VesselSpec, speed_mps: float, dt_s: float) -> None:
    """Eight at once, each from another side, every other one askew."""
    simulation = lake(ROCK_10_M, vessel=vessel, dt_s=dt_s)
    bearing = np.arange(8) * math.pi / 4
    askew = np.where(np.arange(8) % 2, 0.5, 0.0)
    place = (4.9 + simulation.outline.reach_m) * np.column_stack([np.cos(bearing), np.sin(bearing)])
    state = under_way(simulation, place, bearing + math.pi + askew, speed_mps)
    before = energy_j(vessel, state)
    touched = np.zeros(8, bool)
    for each in sailed(simulation, state, 1.2, 0.0):
        spheres = sphere_centres(simulation.outline, each.vessel.motion)
        inside = np.linalg.norm(spheres - [0.0, 0.0, 2.0], axis=2).min(axis=1)
        assert inside.min() > 4.8  # of 5 m, whose flat sides lie up to 0.1 m within: no middle of a sphere gets through
        assert np.all(energy_j(vessel, each) <= before * 1.02 + 1.0)
        touched[each.contacts.vessel] = True
        assert set(each.contacts.what) <= {"rock 0"}
    assert touched[::2].all()
    assert touched.all() or speed_mps < 2.0


@pytest.mark.medium
def test_a_boat_that_pushes_on_stays_outside() -> None:
    simulation = lake(ROCK_10_M)
    states = sailed(simulation, under_way(simulation, np.array([[-7.0, 0.3]]), np.zeros(1), 3.0), 6.0, 1.0)
    gone = [state.vessel.motion.pos_ned_m[0] for state in states]
    assert min(float(np.linalg.norm(place[:2])) for place in gone) > 4.6
    assert max(place[0] for place in gone[:2000]) < -4.6  # it did not come out behind
    for state in states:
        spheres = sphere_centres(simulation.outline, state.vessel.motion)
        assert np.linalg.norm(spheres - [0.0, 0.0, 2.0], axis=2).min() > 4.8


@pytest.mark.medium
@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("speed_mps", [0.5, 5.0])
def test_a_wall_whose_triangles_face_anywhere_is_not_passed(inside_out: bool, speed_mps: float) -> None:
    """A sheet without thickness, as users export a quay."""
    corners = np.array([[8.0, -30.0, -3.0], [8.0, 30.0, -3.0], [8.0, 30.0, 3.0], [8.0, -30.0, 3.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=int32)
    simulation = lake(Mesh(corners, faces[:, ::-1] if inside_out else faces, CONCRETE))
    states = sailed(simulation, under_way(simulation, np.array([[5.0, 0.0]]), np.array([0.6]), speed_mps), 4.0, 0.8)
    bows = np.array([sphere_centres(simulation.outline, each.vessel.motion)[0, :, 0].max() for each in states])
    assert bows.max() < 8.0
    assert bows.max() > 7.8 - 0.02


@pytest.mark.medium
def test_a_pole_thinner_than_the_hull_is_felt() -> None:
    pole = moved(cylinder(0.05, 6.0, CONCRETE, sides=6), (6.0, 0.6, 0.0), UPRIGHT)  # ahead of the starboard hull
    simulation = lake(pole)
    states = sailed(simulation, under_way(simulation, np.zeros((1, 2)), np.zeros(1), 3.0), 4.0, 0.3)
    assert any(len(state.contacts) for state in states)
    assert states[-1].vessel.motion.rot_ned_frd[0, 1, 0] > 0.2  # it turns about the pole, to starboard


@pytest.mark.medium
def test_there_is_no_force_at_a_distance_and_none_over_the_mast() -> None:
    quay = moved(box((40.0, 2.0, 4.0), CONCRETE), (0.0, 2.0, 0.0))  # 0.2 m beside the starboard hull
    bridge = moved(box((4.0, 40.0, 1.0), CONCRETE), (20.0, 0.0, -3.0))
    simulation, open_water = lake(quay, bridge), lake()
    state = under_way(simulation, np.array([[-10.0, 0.0]]), np.zeros(1), 3.0)
    assert len(find_reachable(simulation.waterway.triangles, simulation.outline, state.vessel.motion))
    for one, other in zip(sailed(simulation, state, 9.0, 0.4), sailed(open_water, state, 9.0, 0.4), strict=True):
        assert not len(one.contacts)
        assert np.array_equal(one.vessel.motion.pos_ned_m, other.vessel.motion.pos_ned_m)


@pytest.mark.medium
def test_vessels_of_a_batch_feel_their_own_rocks() -> None:
    """The one beside nothing goes on as if there were nothing, the other as if it were alone."""
    simulation = lake(ROCK_10_M)
    places, headings = np.array([[-7.0, 0.0], [-7.0, 40.0]]), np.zeros(2)
    both = sailed(simulation, under_way(simulation, places, headings, 3.0), 3.0, 0.2)[-1].vessel.motion.pos_ned_m
    for number, world in ((0, simulation), (1, lake())):
        alone = under_way(world, places[number : number + 1], headings[:1], 3.0)
        (place,) = sailed(world, alone, 3.0, 0.2)[-1].vessel.motion.pos_ned_m
        assert both[number] == pytest.approx(place, abs=1e-9)
    assert np.linalg.norm(both[0, :2]) > 4.6
    assert both[1, 0] > both[0, 0] + 2.0


def test_what_no_hull_reaches_is_not_kept() -> None:
    crown = moved(ellipsoid((3.0, 3.0, 3.0), ROCK), (0.0, 0.0, -12.0))
    assert len(Triangles.from_meshes([("tree", crown)], 0.0)) == 0
    assert len(Triangles.from_meshes([], 0.0)) == 0
