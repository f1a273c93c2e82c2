"""Contact of vessels with any number of hulls: each hull touches where it is, with its own radius."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from asv import ASV

from sim_core.environment.environment import Environment
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, initial
from sim_core.vessel.spec import DemiHull, HullSection
from sim_core.world.contact import Contacts, compute_contacts, find_near
from sim_core.world.debris import no_debris
from sim_core.world.geometry import CONCRETE, box, moved
from sim_core.world.mesh_contact import Triangles, compute_mesh_contacts, find_reachable
from sim_core.world.plan import Capsules
from sim_core.world.river import Bed, FlatBed

FLOAT = HullSection(radius_m=0.1)
TRIMARAN = replace(
    ASV,
    mass_kg=420.0,
    hull=None,
    hulls=(
        DemiHull(length_m=3.0, keel_frd_m=(0.0, 0.0, 0.4), section=HullSection(width_m=0.6, depth_m=0.6)),
        DemiHull(length_m=1.0, keel_frd_m=(-0.5, -1.0, 0.2), section=FLOAT),
        DemiHull(length_m=1.0, keel_frd_m=(-0.5, 1.0, 0.2), section=FLOAT),
    ),
)
SIMULATION = Simulation.from_spec(TRIMARAN, Environment(), 0.0025)
OUTLINE = SIMULATION.outline
NOTHING = Capsules.joined(())


def lying(*places: tuple[float, float]) -> Kinematics:
    """Vessels that head north, at rest."""
    start = initial(SIMULATION, np.array(places), np.zeros(len(places)), np.random.default_rng(0))
    return start.vessel.motion


def touched(motion: Kinematics, standing: Capsules = NOTHING, bed: Bed | None = None) -> Contacts:
    near = find_near(standing, bed, OUTLINE, motion, no_debris())
    return compute_contacts(standing, bed, OUTLINE, motion, no_debris(), near, 0.0025)[0]


def test_each_hull_is_a_capsule_of_its_own() -> None:
    hulls = OUTLINE.capsules(lying((0.0, 0.0), (10.0, 20.0)))
    assert hulls.radius_m == pytest.approx([0.3, 0.1, 0.1] * 2)
    np.testing.assert_allclose(hulls.from_ne_m[3:], [[10 - 1.2, 20], [10 - 0.9, 19], [10 - 0.9, 21]], atol=1e-3)
    np.testing.assert_allclose(hulls.to_ne_m[3:], [[10 + 1.2, 20], [10 - 0.1, 19], [10 - 0.1, 21]], atol=1e-3)
    assert OUTLINE.keel_frd_m[:, 2] == pytest.approx([0.4, 0.4, 0.2, 0.2, 0.2, 0.2])
    assert OUTLINE.reach_m == pytest.approx(1.5)
    lowest = OUTLINE.spheres_frd_m[:, 2] + OUTLINE.sphere_radius_m
    assert set(np.round(lowest, 12)) == {0.2, 0.4}


def test_a_post_beside_a_float_pushes_that_float() -> None:
    """Of the second vessel alone, to port, at the height of the float's axis."""
    motion = lying((0.0, 0.0), (10.0, 20.0))
    post = Capsules(np.array([[9.5, 21.28]]), np.array([[9.5, 21.28]]), np.array([0.2]), ("post",))
    found = touched(motion, post)
    assert set(found.vessel.tolist()) == {1}
    assert np.all(found.force_ned_n[:, 1] < 0.0)
    assert found.force_ned_n[:, 0] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(found.place_ned_m[0], [9.5, 21.09, motion.pos_ned_m[1, 2] + 0.1], atol=1e-9)
    assert len(touched(motion, replace(post, from_ne_m=post.from_ne_m + 0.05, to_ne_m=post.to_ne_m + 0.05))) == 0


def test_the_deepest_hull_runs_aground() -> None:
    motion = lying((0.0, 0.0), (5.0, 5.0))
    found = touched(motion, bed=FlatBed(float(motion.pos_ned_m[0, 2]) + 0.39))
    assert found.vessel.tolist() == [0, 0, 1, 1]
    assert found.place_ned_m[:, 1] == pytest.approx([0.0, 0.0, 5.0, 5.0])
    assert np.all(found.force_ned_n[:, 2] < 0.0)


def test_triangles_are_met_by_each_radius() -> None:
    """A quay from 1.05 m to starboard is 5 cm within the float, and far from the middle hull."""
    quay = moved(box((40.0, 2.0, 4.0), CONCRETE), (0.0, 2.05, 0.0))
    triangles = Triangles.from_meshes([("quay", quay)], 0.0)
    motion = lying((0.0, -1.0), (0.0, 0.0))
    found = compute_mesh_contacts(triangles, OUTLINE, motion, find_reachable(triangles, OUTLINE, motion), 0.0025)
    assert set(found.vessel.tolist()) == {1}
    own = OUTLINE.spheres_frd_m[OUTLINE.sphere_radius_m == 0.1]
    assert len(found) == np.count_nonzero(own[:, 1] > 0)
    np.testing.assert_allclose(found.place_ned_m[:, 1], 1.05)
    assert np.all(found.force_ned_n[:, 1] < 0.0)
