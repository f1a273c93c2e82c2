"""Hulls of any section: closed forms of naval architecture, sums over fine grids, round hulls, and meshes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from vessels import FULL

from sim_core.environment.environment import Environment
from sim_core.environment.spec import GRAVITY_MPS2, Water, WaveSpec
from sim_core.environment.waves import realise_waves
from sim_core.frames import Array, euler_to_quat, quat_to_matrix
from sim_core.keys import SpecificationError
from sim_core.simulation import Simulation, initial, step
from sim_core.vessel.buoyancy import FlatPoses, RoundHulls, SectionHulls, make_buoyancy
from sim_core.vessel.floating import FloatingPose, floating_pose
from sim_core.vessel.sections import cut_strips, hull_shape
from sim_core.vessel.spec import AddedMass, Damping, DemiHull, HullMesh, HullSection, VesselSpec, Windage
from sim_core.vessel.vessel import Surroundings, accelerate

WATER = Water(density_kgpm3=1000.0)
DEEP = replace(WATER, depth_m=1e3)
NEWTON_PER_M3 = 1000.0 * GRAVITY_MPS2
BOX = HullSection(width_m=1.0, depth_m=0.6)
V = HullSection(offsets_m=((0.0, 0.0), (0.6, 0.6)))
CHINE = HullSection(offsets_m=((0.0, 0.1), (0.15, 0.4), (0.5, 0.5), (0.6, 0.35)))


def vessel(*hulls: DemiHull, mass_kg: float, **keys: object) -> VesselSpec:
    return replace(FULL, hull=None, hulls=hulls, mass_kg=mass_kg, **keys)


def hull(section: HullSection | None = BOX, length_m: float = 4.0, y_m: float = 0.0, **keys: object) -> DemiHull:
    return DemiHull(**{"length_m": length_m, "keel_frd_m": (0.0, y_m, 0.3), "section": section, "strips": 20} | keys)


def poses(model: VesselSpec, depth_m: Array, roll_rad: Array, pitch_rad: Array) -> FlatPoses:
    rotation = quat_to_matrix(euler_to_quat(np.column_stack([roll_rad, pitch_rad, 0.0 * roll_rad])))
    return FlatPoses(make_buoyancy(model, WATER), depth_m, rotation[:, 2])


@pytest.mark.parametrize("section", [BOX, V, CHINE, HullSection(radius_m=0.3)], ids=["box", "V", "chine", "round"])
def test_the_triangles_that_are_drawn_enclose_the_hull(section: HullSection) -> None:
    """A trapezoid ahead of a prism: all sides face outward, and the volume is that of the strips."""
    drawn = hull(section, taper=((-0.5, 1.0), (0.1, 1.0), (0.5, 0.2)))
    shape = hull_shape(drawn)
    solid = trimesh.Trimesh(shape.vertices_m, shape.faces, process=False)
    assert solid.is_watertight
    strips = cut_strips(drawn)
    assert solid.volume == pytest.approx(strips.length_m @ strips.area_m2, rel=1e-9)
    low, high = solid.bounds
    assert (low[0], high[0]) == pytest.approx((-2.0, 2.0))
    assert high[1] - low[1] == pytest.approx(drawn.width_m, rel=0.01)
    assert (low[2], high[2]) == pytest.approx((0.3 - drawn.height_m, 0.3), abs=1e-3)


def some_poses(model: VesselSpec, count: int = 60) -> FlatPoses:
    """Of little and of great heel, trim and draft, some of them dry or under water."""
    rng = np.random.default_rng(4)
    return poses(model, *(rng.uniform(-most, most, count) for most in (0.5, 1.3, 0.3)))


def righting_lever_m(model: VesselSpec, heel_rad: float) -> float:
    """GZ at the displacement of the vessel."""
    weight_n, low, high = model.mass_kg * GRAVITY_MPS2, -1.0, 1.0
    for _ in range(7):  # to rounding
        depth = np.linspace(low, high, 100)
        wrench = poses(model, depth, np.full(100, heel_rad), np.zeros(100)).wrench()
        place = int(np.searchsorted(np.linalg.norm(wrench[:, :3], axis=1), weight_n))
        low, high = depth[place - 1], depth[place]
    return -float(wrench[place, 3]) / weight_n


def test_a_box_floats_by_the_book() -> None:
    """T = m / (rho L B), KB = T / 2, BM = B^2 / (12 T); along the hull the strips lose 1 / n^2 of BM_L."""
    pose = floating_pose(vessel(hull(), mass_kg=800.0), WATER)
    assert pose.draft_m == pytest.approx(0.2, abs=1e-12)
    assert pose.displacement_m3 == pytest.approx(0.8)
    assert pose.waterplane_area_m2 == pytest.approx(4.0)
    assert pose.centre_of_buoyancy_frd_m == pytest.approx([0.0, 0.0, 0.2], abs=1e-12)
    assert pose.gm_transverse_m == pytest.approx(0.1 + 1.0 / (12 * 0.2) - 0.3, rel=1e-7)
    assert pose.gm_longitudinal_m == pytest.approx(0.1 + 16.0 / (12 * 0.2) * (1 - 1 / 400) - 0.3, rel=1e-7)
    assert (pose.heel_rad, pose.trim_rad) == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("heel_deg", [1.0, 10.0, 20.0])
def test_the_righting_lever_of_a_box_is_the_wall_sided_formula(heel_deg: float) -> None:
    """GZ = (GM + BM tan^2 / 2) sin, as long as neither deck nor bilge comes to the water: 21.8 degrees here."""
    model, heel = vessel(hull(), mass_kg=800.0), np.radians(heel_deg)
    metacentric, radius = 0.1 + 1.0 / 2.4 - 0.3, 1.0 / 2.4
    wanted = (metacentric + 0.5 * radius * np.tan(heel) ** 2) * np.sin(heel)
    assert righting_lever_m(model, heel) == pytest.approx(wanted, rel=1e-9)


def test_a_wedge_floats_by_the_book() -> None:
    """With sides at 45 degrees T = sqrt(V / L), KB = 2 T / 3, BM = (2 T)^3 / (12 T^2)."""
    pose = floating_pose(vessel(hull(V), mass_kg=400.0), WATER)
    draft = np.sqrt(0.1)
    assert pose.draft_m == pytest.approx(draft, abs=1e-12)
    assert pose.gm_transverse_m == pytest.approx(2 * draft / 3 + 2 * draft / 3 - 0.3, rel=1e-7)


def test_a_hull_that_narrows_to_the_bow_trims_about_the_middle_of_its_waterline() -> None:
    """A triangle of length L and width B at the stern: I_L = B L^3 / 36 about its centroid, I_T = L B^3 / 48."""
    pointed = hull(taper=((-0.5, 1.0), (0.5, 0.0)), strips=100)
    pose = floating_pose(vessel(pointed, mass_kg=400.0, centre_of_gravity_frd_m=(-2.0 / 3.0, 0.0, 0.1)), WATER)
    assert pose.draft_m == pytest.approx(0.2, abs=1e-6)
    assert pose.trim_rad == pytest.approx(0.0, abs=1e-6)
    assert pose.gm_longitudinal_m == pytest.approx(0.1 + 64.0 / 36.0 / 0.4 - 0.2, rel=1e-3)
    assert pose.gm_transverse_m == pytest.approx(0.1 + 4.0 / 48.0 / 0.4 - 0.2, rel=1e-3)


@pytest.mark.parametrize("section", [BOX, V, CHINE], ids=["box", "V", "chine"])
def test_the_wrench_is_that_of_a_sum_over_a_grid(section: HullSection) -> None:
    model = vessel(hull(section, length_m=1.0, strips=4), mass_kg=20.0)
    flat = some_poses(model, 20)
    cell = 0.005
    y, up = np.meshgrid(np.arange(-0.6, 0.6, cell) + cell / 2, np.arange(0.0, 0.6, cell) + cell / 2)
    table = section.offsets_m or ((0.0, 0.5), (0.6, 0.5))
    inside = np.abs(y) < np.interp(up, *np.array(table).T)
    along = (np.arange(4) - 1.5) / 4
    points = np.array([[x, a, 0.3 - b] for x in along for a, b in zip(y[inside], up[inside], strict=True)])
    under = (flat.down_frd @ points.T + flat.depth_m[:, None]) > 0.0
    force = -NEWTON_PER_M3 * cell * cell * 0.25 * flat.down_frd
    wanted = np.concatenate([under.sum(axis=1)[:, None] * force, np.cross(under @ points, force)], axis=1)
    # Half a cell at the most over a waterline of 1.3 m: 3.3 kg, and in the middle a third of that.
    difference = np.abs(flat.wrench() - wanted)
    assert difference.max() < 32.0
    assert np.median(difference.max(axis=1)) < 10.0
    deep = under.sum(axis=1) > 2000
    afloat = replace(flat, depth_m=flat.depth_m[deep], down_frd=flat.down_frd[deep])
    np.testing.assert_allclose(afloat.centre_frd_m(), (under @ points)[deep] / under.sum(axis=1)[deep, None], atol=cell)


def test_two_round_hulls_feel_the_same_either_way() -> None:
    """Polygons of 32 corners and the circle's area: they differ by 1 % of r^2 where the surface cuts, at the most."""
    model = FULL
    flat = some_poses(model)
    assert isinstance(flat.hulls, RoundHulls)
    polygons = replace(flat, hulls=SectionHulls.from_spec(model, WATER))
    heel = np.abs(np.arctan2(flat.down_frd[:, 1], flat.down_frd[:, 2]))
    # The pitching moment takes the centre of buoyancy at rest for round hulls; the others are exact for each alone.
    difference = np.abs(flat.wrench() - polygons.wrench())[heel < 0.5]
    assert difference[:, [0, 1, 2, 3, 5]].max() < 0.01 * 0.2**2 * 2 * 2.3 * NEWTON_PER_M3
    one, other = (floating_pose(model, WATER, hulls) for hulls in (flat.hulls, polygons.hulls))
    for name in ("draft_m", "gm_transverse_m", "gm_longitudinal_m", "waterplane_area_m2"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=2e-3)
    assert one.centre_of_buoyancy_frd_m == pytest.approx(other.centre_of_buoyancy_frd_m, abs=1e-4)


def test_the_short_form_is_the_long_one() -> None:
    long = some_poses(replace(FULL, hull=None, hulls=FULL.demi_hulls))
    np.testing.assert_array_equal(some_poses(FULL).wrench(), long.wrench())


def test_round_hulls_of_several_radii_and_places() -> None:
    """A trimaran: each hull with the depth of its own axis, against the same as polygons."""
    middle = hull(HullSection(radius_m=0.3), keel_frd_m=(0.2, 0.0, 0.5))
    side = HullSection(radius_m=0.1)
    floats = [hull(side, 2.0, keel_frd_m=(-0.5, y, 0.3), strips=6) for y in (-1.2, 1.2)]
    model = vessel(middle, *floats, mass_kg=450.0)
    exact = make_buoyancy(model, WATER)
    assert isinstance(exact, RoundHulls)
    assert len(exact.points_frd_m) == 32
    one, other = (floating_pose(model, WATER, hulls) for hulls in (exact, SectionHulls.from_spec(model, WATER)))
    assert one.trim_rad == pytest.approx(other.trim_rad, abs=2e-4)
    assert abs(one.trim_rad) > 0.005
    assert one.draft_m == pytest.approx(other.draft_m, rel=3e-3)
    assert one.gm_transverse_m == pytest.approx(other.gm_transverse_m, rel=0.01)


def test_a_taper_takes_its_share_of_the_volume() -> None:
    """From full width amidships to a tenth of it at the ends: 0.55 of the prism, its middle where it is full."""
    diamond = hull(taper=((-0.5, 0.1), (0.1, 1.0), (0.5, 0.1)), strips=7)
    buoyancy = make_buoyancy(vessel(diamond, mass_kg=100.0), WATER)
    assert buoyancy.volume_m3 == pytest.approx(0.55 * 4.0 * 0.6, rel=1e-12)
    under = FlatPoses(buoyancy, np.array([5.0]), np.array([[0.0, 0.0, 1.0]]))
    # Two trapezoids: (x0 (2 w0 + w1) + x1 (w0 + 2 w1)) / (3 (w0 + w1)) from -2 to 0.4 m, and from 0.4 to 2 m
    aft, fore = (-2.0 * 1.2 + 0.4 * 2.1) / 3.3, (0.4 * 2.1 + 2.0 * 1.2) / 3.3
    assert under.centre_frd_m()[0] == pytest.approx([0.6 * aft + 0.4 * fore, 0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize("count", [2, 3])
def test_several_hulls_stand_by_their_distance(count: int) -> None:
    """BM = sum(L B^3 / 12 + L B y^2) / V."""
    places = np.linspace(-1.5, 1.5, count)
    model = vessel(
        *(hull(HullSection(width_m=0.3, depth_m=0.6), y_m=y) for y in places.tolist()), mass_kg=240.0 * count
    )
    pose = floating_pose(model, WATER)
    second_m4 = 4.0 * 0.3**3 / 12 * count + 4.0 * 0.3 * float(places @ places)
    assert pose.draft_m == pytest.approx(0.2)
    assert pose.gm_transverse_m == pytest.approx(0.1 + second_m4 / (0.24 * count) - 0.3, rel=1e-7)


def test_a_weight_out_of_the_middle_heels_and_trims() -> None:
    """(GM + rise of the centre of buoyancy) tan = distance; with upright sides it rises by BM tan^2 / 2 of both."""
    model = vessel(hull(), mass_kg=800.0, centre_of_gravity_frd_m=(0.1, 0.005, 0.1))
    pose = floating_pose(model, WATER)
    across, along = 1.0 / 2.4, 16.0 / 2.4 * (1 - 1 / 400)
    heel, trim = np.tan(pose.heel_rad), np.tan(pose.trim_rad)
    above = 0.1 - 0.2 + 0.5 * (across * heel**2 + along * trim**2)  # of the centre of buoyancy over that of gravity
    assert heel == pytest.approx(0.005 / (above + across), rel=5e-4)
    assert trim == pytest.approx(-0.1 / (above + along), rel=5e-4)


def test_an_inclined_vessel_at_rest_stays_at_rest() -> None:
    model = vessel(hull(), mass_kg=800.0, centre_of_gravity_frd_m=(0.1, 0.005, 0.1))
    simulation = Simulation.from_spec(model, Environment(water=WATER), 0.0025)
    start = initial(simulation, np.zeros((1, 2)), np.array([1.0]), np.random.default_rng(0)).vessel.motion
    assert start.pos_ned_m[0, 2] == pytest.approx(simulation.vessel.rest.depth_m - WATER.level_m)
    weight_n = 800.0 * GRAVITY_MPS2 * start.rot_ned_frd[:, 2]
    flat = FlatPoses(simulation.vessel.buoyancy, start.pos_ned_m[:, 2] + WATER.level_m, start.rot_ned_frd[:, 2])
    wrench = flat.wrench() + np.concatenate([weight_n, np.cross([0.1, 0.005, 0.1], weight_n)], axis=1)
    np.testing.assert_allclose(wrench, 0.0, atol=1e-5)  # of 7.8 kN


def written(shape: trimesh.Trimesh, path: Path) -> str:
    shape.export(path)
    return str(path)


def mesh_hull(
    file: str, width_m: float, depth_m: float, length_m: float = 4.0, strips: int = 20, scale: float = 1.0
) -> DemiHull:
    mesh = HullMesh(file=file, width_m=width_m, depth_m=depth_m, scale=scale)
    return hull(None, length_m, mesh=mesh, strips=strips)


@pytest.mark.parametrize("name", ["box.stl", "box.obj", "box.ply", "box.glb"])
def test_a_mesh_of_a_box_is_the_box(name: str, tmp_path: Path) -> None:
    """Wherever its own origin is."""
    shape = trimesh.creation.box((4000.0, 1000.0, 600.0))
    shape.apply_translation((70.0, -30.0, 5.0))
    file = written(shape, tmp_path / name)
    flat, wanted = (
        some_poses(vessel(mesh_hull(file, 1.0, 0.6, scale=0.001), mass_kg=50.0)),
        some_poses(vessel(hull(), mass_kg=50.0)),
    )
    np.testing.assert_allclose(flat.wrench(), wanted.wrench(), atol=0.02)  # of 24 kN: the file has single precision


@pytest.mark.medium
def test_a_mesh_of_a_cylinder_is_the_round_hull(tmp_path: Path) -> None:
    shape = trimesh.creation.cylinder(0.3, 4.0, sections=100)
    shape.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0)))
    file = written(shape, tmp_path / "cylinder.stl")
    low = {"mass_kg": 400.0, "centre_of_gravity_frd_m": (0.0, 0.0, 0.1)}
    one = floating_pose(vessel(mesh_hull(file, 0.6, 0.6, strips=6), **low), WATER)
    other = floating_pose(vessel(hull(HullSection(radius_m=0.3), strips=6), **low), WATER)
    # The metacentre is the cylinder's axis; the waterline of 32 corners is within 0.5 % of it, its cube within 1.5 %.
    assert one.gm_transverse_m == pytest.approx(0.1, abs=0.015 * 0.3)
    assert one.draft_m == pytest.approx(other.draft_m, rel=3e-3)
    assert one.waterplane_area_m2 == pytest.approx(other.waterplane_area_m2, rel=0.01)
    assert one.gm_longitudinal_m == pytest.approx(other.gm_longitudinal_m, rel=0.01)


def test_a_mesh_of_two_hulls_is_the_catamaran(tmp_path: Path) -> None:
    """A plane across it cuts two loops; the file is turned inside out, too."""
    sides = [trimesh.creation.box((4.0, 0.3, 0.6)) for _ in range(2)]
    for shape, y in zip(sides, (-1.0, 1.0), strict=True):
        shape.apply_translation((0.0, y, 0.0))
    both = trimesh.util.concatenate(sides)
    both.invert()
    file = written(both, tmp_path / "both.stl")
    one = floating_pose(vessel(mesh_hull(file, 2.3, 0.6), mass_kg=400.0), WATER)
    pair = [hull(HullSection(width_m=0.3, depth_m=0.6), y_m=y) for y in (-1.0, 1.0)]
    other = floating_pose(vessel(*pair, mass_kg=400.0), WATER)
    for name in ("draft_m", "gm_transverse_m", "gm_longitudinal_m"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-5)


def open_box() -> trimesh.Trimesh:
    shape = trimesh.creation.box((4.0, 1.0, 0.6))
    return trimesh.Trimesh(shape.vertices, shape.faces[:-1], process=False)


def one_face_turned() -> trimesh.Trimesh:
    shape = trimesh.creation.box((4.0, 1.0, 0.6))
    faces = shape.faces.copy()
    faces[0] = faces[0][::-1]
    return trimesh.Trimesh(shape.vertices, faces, process=False)


def flat_plate() -> trimesh.Trimesh:
    corners = np.array([[-2.0, -0.5, 0.0], [2.0, -0.5, 0.0], [2.0, 0.5, 0.6]])
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 1]], process=False)


@pytest.mark.parametrize(
    ("shape", "problem"),
    [
        (open_box(), "is not closed: 3 of its 18 edges belong to a single triangle; close its holes"),
        (one_face_turned(), "has triangles that face inward and others that face outward"),
        (flat_plate(), "encloses no volume"),
    ],
)
def test_a_mesh_that_is_no_hull_is_refused(shape: trimesh.Trimesh, problem: str, tmp_path: Path) -> None:
    file = written(shape, tmp_path / "hull.obj")
    with pytest.raises(SpecificationError, match=r"hulls\.0\.mesh\.file = .*hull\.obj " + problem) as error:
        make_buoyancy(vessel(mesh_hull(file, 1.0, 0.6), mass_kg=100.0), WATER)
    assert error.value.path == ("hulls", 0, "mesh", "file")


@pytest.mark.parametrize(
    ("keys", "path", "problem"),
    [
        (
            (2.0, 0.6),
            ("mesh", "width_m"),
            "width_m = 2 does not fit .*, which is 4 x 1 x 0.6 m long, wide and deep; use 1",
        ),
        ((1.0, 0.5), ("mesh", "depth_m"), "depth_m = 0.5 does not fit .*; use 0.6, or correct"),
        ((1.0, 0.6, 5.0), ("length_m",), "length_m = 5 does not fit .*; use 4, or correct the mesh's scale or axes"),
    ],
)
def test_a_mesh_of_another_size_than_its_keys_is_refused(
    keys: tuple[float, ...], path: tuple[str, ...], problem: str, tmp_path: Path
) -> None:
    file = written(trimesh.creation.box((4.0, 1.0, 0.6)), tmp_path / "hull.stl")
    with pytest.raises(SpecificationError, match=problem) as error:
        make_buoyancy(vessel(mesh_hull(file, *keys), mass_kg=100.0), WATER)
    assert error.value.path == ("hulls", 0, *path)


def test_a_mesh_with_a_pointed_bow_has_its_volume_where_it_is(tmp_path: Path) -> None:
    """A wedge in plan: two thirds of the way to the stern, whatever the number of strips."""
    corners = np.array(
        [(x, side * (0.5 if x < 0 else 0.0), z) for x in (-2.0, 2.0) for side in (-1, 1) for z in (0.0, 0.6)]
    )
    solid = trimesh.Trimesh(corners).convex_hull
    file = written(solid, tmp_path / "wedge.stl")
    buoyancy = make_buoyancy(vessel(mesh_hull(file, 1.0, 0.6, strips=3), mass_kg=100.0), WATER)
    assert buoyancy.volume_m3 == pytest.approx(1.2)
    under = FlatPoses(buoyancy, np.array([5.0]), np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(under.centre_frd_m()[0], [-2.0 / 3.0, 0.0, 0.0], atol=1e-5)


@pytest.mark.parametrize(
    ("keys", "path", "problem"),
    [
        ({"mass_kg": 2400.0}, ("mass_kg",), "= 2400 sinks: its hull carries 2400 kg; use less mass"),
        (
            {"mass_kg": 800.0, "centre_of_gravity_frd_m": (0.0, 0.0, -0.25)},
            ("centre_of_gravity_frd_m",),
            r"= \[0, 0, -0.25\] capsizes at rest: GM_T = -0.0333 m, as the weight is 0.55 m above the keel and the "
            "metacentre 0.517 m; lower the weight by more than 0.0333 m, or use wider hulls",
        ),
        (
            {"mass_kg": 800.0, "centre_of_gravity_frd_m": (0.0, 0.1, 0.1)},
            ("centre_of_gravity_frd_m",),
            r"= \[0, 0.1, 0.1\] (lies with|has no position).*: the weight is 0.1 m to starboard of the buoyancy",
        ),
        (
            {"mass_kg": 800.0, "centre_of_gravity_frd_m": (-1.9, 0.0, 0.1)},
            ("centre_of_gravity_frd_m",),
            r"= \[-1.9, 0, 0.1\] (lies with|has no position).*: the weight is 1.9 m behind the buoyancy",
        ),
    ],
)  # fmt: skip
def test_what_does_not_float_upright_is_refused(keys: dict, path: tuple[str, ...], problem: str) -> None:
    with pytest.raises(SpecificationError, match=problem) as error:
        floating_pose(vessel(hull(), **keys), WATER)
    assert error.value.path == path


def test_a_catamaran_whose_weight_is_too_high_capsizes() -> None:
    high = replace(FULL, hull=replace(FULL.hull, keel_below_cg_m=6.0))
    with pytest.raises(SpecificationError, match=r"hull\.keel_below_cg_m = 6 capsizes at rest: GM_T = -0.7"):
        floating_pose(high, WATER)


def wave_wrench(model: VesselSpec, wave_length_m: float, direction_deg: float, crest_at_m: float) -> Array:
    """(6,) of a regular wave of 2 cm on the vessel at rest, heading north, without drag and added mass."""
    period = np.sqrt(2.0 * np.pi * wave_length_m / GRAVITY_MPS2)
    field = replace(
        realise_waves(WaveSpec("regular", 0.02, period, direction_deg), DEEP, np.random.default_rng(0)),
        phase_rad=np.array([-2.0 * np.pi * crest_at_m / wave_length_m]),
    )
    bare = replace(model, added_mass=AddedMass(), damping_linear=Damping(), damping_quadratic=Damping(), wind=Windage())
    simulation = Simulation.from_spec(bare, Environment(water=DEEP, waves=field), 0.01)
    state = initial(simulation, np.zeros((1, 2)), np.zeros(1), np.random.default_rng(0)).vessel
    surface = simulation.hull_waves.sample(0.0, state.motion.pos_ned_m, state.motion.rot_ned_frd)
    around = Surroundings(surface.orbital_ned_mps, np.zeros((1, 3)), surface, np.zeros((1, 2)))
    acceleration = accelerate(simulation.vessel, state.motion, state.rotor_speed, around)
    wrench: Array = (acceleration @ np.linalg.inv(simulation.vessel.hydrodynamics.inverse_mass))[0]
    return wrench


@pytest.mark.medium
@pytest.mark.parametrize("lengths", [8.0, 2.0, 1.0, 0.7])
def test_waves_along_the_hull_lift_it_by_their_mean(lengths: float) -> None:
    """rho g B a 2 sin(k L / 2) / k under a crest amidships, and the pitching moment a quarter wave on.

    The pressure decays to the bottom by exp(-k T), and over the draft T of 0.2 m to its mean.
    """
    model, wave_m = vessel(hull(), mass_kg=800.0), 4.0 * lengths
    k = 2.0 * np.pi / wave_m
    bottom, over_draft = np.exp(-0.2 * k), -np.expm1(-0.2 * k) / (0.2 * k)
    heave = -bottom * NEWTON_PER_M3 * 0.01 * 2.0 * np.sin(2.0 * k) / k
    # Twenty strips: (k dx)^2 / 24 of an integral of sines; dx 0.2 m.
    coarse = (k * 0.2) ** 2 / 24 * NEWTON_PER_M3 * 0.01 * 4.0
    assert wave_wrench(model, wave_m, 0.0, 0.0)[2] == pytest.approx(heave, abs=coarse + 0.02)
    # About the origin: less the push, the weight times the mean slope, at the centre of buoyancy 0.2 m below it.
    pitch = bottom * NEWTON_PER_M3 * 0.01 * (2.0 * np.sin(2.0 * k) / k**2 - 4.0 * np.cos(2.0 * k) / k)
    push = over_draft * 0.8 * NEWTON_PER_M3 * 0.01 * 2.0 * np.sin(2.0 * k) / 4.0
    wrench = wave_wrench(model, wave_m, 0.0, wave_m / 4)
    assert wrench[0] == pytest.approx(-push, abs=coarse + 0.02)
    assert wrench[4] == pytest.approx(pitch - 0.2 * push, abs=4 * coarse + 0.5)


@pytest.mark.medium
def test_waves_across_a_single_hull_push_and_roll_it() -> None:
    """A long one: the weight times the slope to the side, and about the centre of buoyancy the stiffness times it."""
    model, wave_m = vessel(hull(), mass_kg=800.0), 40.0
    slope = 0.01 * 2.0 * np.pi / wave_m
    wrench = wave_wrench(model, wave_m, 90.0, wave_m / 4)  # it rises to starboard
    kt = 0.2 * 2.0 * np.pi / wave_m  # over the draft
    push = 800.0 * GRAVITY_MPS2 * slope * -np.expm1(-kt) / kt
    assert wrench[1] == pytest.approx(-push, rel=5e-3)
    assert wrench[3] == pytest.approx(0.2 * push - NEWTON_PER_M3 * 4.0 / 12 * slope * np.exp(-kt), rel=0.01)


def test_shares_of_dry_and_drowned_strips() -> None:
    flat = np.array([[0.0, 0.0, 1.0]] * 3)
    for model in (vessel(hull(), mass_kg=50.0), replace(FULL, hull=replace(FULL.hull, keel_below_cg_m=0.3))):
        hulls = make_buoyancy(model, WATER)
        bow_up = np.array([[-np.sin(0.2), 0.0, np.cos(0.2)]] * 3)
        surface = Simulation.from_spec(model, Environment(water=WATER), 0.01).hull_waves.sample(
            0.0, np.zeros((3, 3)), np.tile(np.eye(3), (3, 1, 1))
        )
        depth = np.column_stack([np.zeros((3, 2)), np.array([-1.0, 0.0, 1.0]) - WATER.level_m])
        dry, drowned = hulls.immersion(depth, flat, surface)
        assert dry.tolist() == [1.0, 0.0, 0.0]
        assert drowned.tolist() == [0.0, 0.0, 1.0]
        dry, drowned = hulls.immersion(depth, bow_up, surface)
        assert 0.0 < dry[1] < 0.5 or 0.0 < drowned[1] < 0.5


def test_means_over_the_hulls_go_by_what_each_displaces() -> None:
    """A slope of the surface pushes each hull by what it displaces, so the floats do not count like the middle hull."""
    floats = [
        hull(HullSection(width_m=0.2, depth_m=0.3), 2.0, keel_frd_m=(0.0, y, 0.2), strips=12) for y in (-1.0, 1.0)
    ]
    for middle in (hull(strips=12), hull(HullSection(radius_m=0.4), strips=12)):
        share = make_buoyancy(vessel(middle, *floats, mass_kg=600.0), WATER).point_share
        assert share.sum() == pytest.approx(1.0)
        assert share[:24].sum() == pytest.approx(1.0 - 2 * share[24:48].sum())
        assert 0.0 < share[24:48].sum() < 0.1
    field = realise_waves(WaveSpec("regular", 0.02, 1.5, 20.0), DEEP, np.random.default_rng(0))
    points, share = np.array([[0.0, -1.0, 0.0], [0.5, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.1, 0.8, 0.1])
    surface = field.at_hull(points, share).sample(0.7, np.zeros((1, 3)), np.eye(3)[None])
    gradient = share @ field.slope(0.7, points[:, :2])
    assert surface.gradient_ned[0, :2] == pytest.approx(gradient, abs=1e-8)


@pytest.mark.medium
def test_a_trimaran_rides_waves() -> None:
    side = HullSection(offsets_m=((0.0, 0.0), (0.3, 0.1)))
    floats = [hull(side, 2.0, y_m=y, strips=6, keel_frd_m=(-0.5, y, 0.25)) for y in (-1.2, 1.2)]
    model = vessel(hull(CHINE, taper=((-0.5, 0.9), (0.1, 1.0), (0.5, 0.2))), *floats, mass_kg=400.0)
    field = realise_waves(WaveSpec("jonswap", 0.3, 2.5, 60.0, spreading=5.0), WATER, np.random.default_rng(2))
    simulation = Simulation.from_spec(model, Environment(water=WATER, waves=field), 0.01)
    rng = np.random.default_rng(0)
    state = initial(simulation, np.zeros((2, 2)), np.array([0.0, 1.0]), rng)
    heights = []
    for _ in range(300):
        state = step(simulation, state, np.full((1, 2), 0.3), rng)
        heights.append(state.vessel.motion.pos_ned_m[:, 2])
    assert np.isfinite(heights).all()
    assert np.all(np.std(heights, axis=0) > 0.02)
    assert np.all(np.abs(np.array(heights)) < 0.8)


def test_the_pose_of_the_shipped_catamaran() -> None:
    pose: FloatingPose = floating_pose(FULL, Water(density_kgpm3=997.8))
    assert pose.draft_m == pytest.approx(0.1, abs=0.001)
    # BM = 2 x 2.3 m x 0.3466 m x (0.6 m)^2 / 0.1132 m^3 and the hulls' own.
    assert pose.gm_transverse_m == pytest.approx(5.02, abs=0.03)


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"section": {}}, "needs one form; give radius_m, or width_m and depth_m, or offsets_m"),
        ({"section": {"radius_m": 0.2, "width_m": 0.3}}, "needs one form"),
        ({"section": {"width_m": 0.3}}, "is a box without its size; give width_m and depth_m"),
        ({"section": {"offsets_m": ((0.1, 0.0), (0.3, 0.2))}}, "offsets_m begins 0.1 m above the keel"),
        ({"section": {"offsets_m": ((0.0, 0.0), (0.3, 0.2), (0.2, 0.2))}}, "offsets_m goes from 0.3 to 0.2; sort it"),
        ({"section": {"offsets_m": ((0.0, 0.0), (0.3, -0.2))}}, "offsets_m has a half width of -0.2 m"),
        ({"section": {"offsets_m": ((0.0, 0.0), (0.3, 0.0))}}, "offsets_m has no half width above 0"),
        ({"taper": ((-0.5, 1.0), (0.4, 1.0))}, "taper reaches from -0.5 to 0.4 of the length"),
        (
            {"taper": ((-0.5, 1.0), (0.2, 1.0), (0.2, 0.5), (0.5, 0.0))},
            "taper goes from 0.2 to 0.2; sort it from stern",
        ),
        ({"taper": ((-0.5, -1.0), (0.5, 1.0))}, "taper has a share of -1"),
        ({"section": None}, "needs a section or a mesh; give one of the two"),
        (
            {"section": None, "mesh": HullMesh(file="x.stl", width_m=1, depth_m=1), "taper": ((-0.5, 1), (0.5, 0))},
            "taper is only for a section, because a mesh has its own ends",
        ),
    ],
)
def test_a_hull_that_cannot_be_drawn_is_refused(keys: dict, problem: str) -> None:
    with pytest.raises(SpecificationError, match=problem):
        hull(**{name: HullSection(**value) if isinstance(value, dict) else value for name, value in keys.items()})
