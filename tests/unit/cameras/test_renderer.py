"""Pictures against OpenCV, the lidar's ray caster, and the waves of the simulation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.random import default_rng

from sim_core import frames
from sim_core.environment.environment import Environment
from sim_core.environment.waves import FlatWater
from sim_core.sensors.camera_spec import LensSpec
from sim_core.sensors.lens import Lens
from sim_core.world.geometry import CONCRETE, STEEL, Mesh, box, moved, sphere
from xitl_cli.plugins.cameras.daylight import Daylight, daylight, visible_extinction_per_m
from xitl_cli.plugins.cameras.gimbal import ROT_FRD_OPTICAL
from xitl_cli.plugins.cameras.image_sensor import ImageResponse, ImageSensor, faces_of
from xitl_cli.plugins.cameras.images import ObjectClass
from xitl_cli.plugins.cameras.models import VERTEX, TriangleModel, WorldObject, triangles, world_model
from xitl_cli.plugins.cameras.renderer import (
    SEA_ID,
    SKY_ID,
    DrawnWorld,
    PlacedModel,
    Renderer,
    Shot,
    Viewpoint,
)
from xitl_cli.profile import load_profile
from xitl_cli.scenery import Scenery

LENS = Lens.from_spec(LensSpec(view_deg=75), 640, 480)


def view(north_m: float, east_m: float, down_m: float, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> Viewpoint:
    quat = frames.euler_to_quat(np.radians([0.0, pitch_deg, yaw_deg]))
    return Viewpoint(np.array([north_m, east_m, down_m]), frames.quat_to_matrix(quat) @ ROT_FRD_OPTICAL)


def surroundings(
    *placed: PlacedModel, waves: object = FlatWater(), time_s: float = 0.0, **changes: object
) -> DrawnWorld:
    sun = np.array([0.6, 0.5, -0.62])
    world = DrawnWorld(
        time_s=time_s,
        waves=waves,
        water_down_m=0.0,
        wind_ne_mps=np.array([3.0, 1.0]),
        light=daylight(sun / np.linalg.norm(sun), 0.2),
        extinction_per_m=visible_extinction_per_m(None),
        water_colour=np.array([0.02, 0.04, 0.05]),
        placed=placed,
    )
    return replace(world, **changes)


def model(*meshes: Mesh, colour: tuple[float, float, float] = (0.8, 0.2, 0.1)) -> TriangleModel:
    vertices = [triangles(mesh, colour, ObjectClass.OTHER, number) for number, mesh in enumerate(meshes)]
    objects = [
        WorldObject(f"object {number}", ObjectClass.OTHER, (0, 0, 0), (1, 1, 1)) for number in range(len(meshes))
    ]
    return TriangleModel(np.concatenate(vertices), tuple(objects))


def at_origin(name: str) -> PlacedModel:
    return PlacedModel(name, np.zeros(3), np.eye(3), 1)


@pytest.fixture(scope="module")
def river() -> Iterator[tuple[Scenery, TriangleModel, Renderer]]:
    scenery = Scenery(load_profile("sitl-perception"))
    world = world_model(scenery)
    renderer = Renderer({"world": world}, ("world",))
    yield scenery, world, renderer
    renderer.close()


@pytest.mark.medium
def test_distances_are_those_of_the_lidars_ray_caster(river: tuple[Scenery, TriangleModel, Renderer]) -> None:
    scenery, world, renderer = river
    where = view(8.0, 14.0, -1.6, yaw_deg=70.0, pitch_deg=-2.0)
    still = replace(surroundings(PlacedModel("world", np.zeros(3), np.eye(3), 1)), water_down_m=scenery.water_down_m)
    measured = renderer.measure(where, LENS, still)
    number = measured[..., 0].astype(int)
    # Pixels inside of an object, not at its edge, that are not of the ground, which is drawn with larger triangles
    inside = (number < SEA_ID) & (number == cv2.erode(number.astype(np.float32), np.ones((3, 3))).astype(int))
    inside &= number == cv2.dilate(number.astype(np.float32), np.ones((3, 3))).astype(int)
    kinds = np.array([ObjectClass.GROUND, *(one.kind for one in world.objects)])
    inside &= kinds[np.where(number < SEA_ID, number, 0)] != ObjectClass.GROUND
    rows, columns = np.nonzero(inside)
    some = default_rng(3).choice(len(rows), 3000, replace=False)
    directions = LENS.directions(np.column_stack([columns, rows])[some].astype(float))
    ned = directions @ where.rot_ned_optical.T
    hits = scenery.caster().cast(np.tile(where.pos_ned_m, (len(ned), 1)).astype(np.float32), ned.astype(np.float32))
    theirs = hits.range_m * directions[:, 2]
    near = theirs < 60.0
    off = np.abs(measured[rows[some], columns[some], 1] - theirs)[near]
    assert near.sum() > 500
    assert np.median(off) < 0.002
    # A ray through the middle of a pixel may pass an inner edge of a rough object, such as a gap between two rocks.
    assert np.mean(off < 0.02) > 0.985


@pytest.mark.medium
def test_the_water_is_the_surface_of_the_simulation(river: tuple[Scenery, TriangleModel, Renderer]) -> None:
    _, _, renderer = river
    profile = load_profile("sitl", ["environment.waves.significant_height_m=0.5", "environment.waves.peak_period_s=3"])
    waves = Environment.from_spec(profile.environment, default_rng(2)).waves
    where, time_s = view(5.0, -40.0, -2.0, yaw_deg=-60.0, pitch_deg=-25.0), 12.3
    measured = renderer.measure(where, LENS, surroundings(waves=waves, time_s=time_s))
    water = measured[..., 0] == SEA_ID
    directions = LENS.all_directions()[water]
    points = directions / directions[:, 2:] * measured[water, 1:2]
    places = points @ where.rot_ned_optical.T + where.pos_ned_m
    near = np.linalg.norm(places[:, :2] - where.pos_ned_m[:2], axis=1) < 15.0
    up_m = -places[near, 2]
    assert near.sum() > 50_000
    assert up_m.std() > 0.05
    exact_m = waves.elevation_m(time_s, places[near, :2])
    off_m = np.abs(up_m - exact_m)
    assert np.sqrt(np.mean(off_m**2)) < 0.005
    assert np.percentile(off_m, 99) < 0.02
    assert off_m.max() < 0.08  # just behind a crest


CENTRES = np.array([[20.0, 0.0, -40.0], [20.0, 7.0, -44.0], [15.0, -9.0, -36.0], [9.0, 4.5, -41.0]])


@pytest.fixture(scope="module")
def balls() -> Iterator[Renderer]:
    one = model(*(moved(sphere(0.35, STEEL, 32, 24), centre) for centre in CENTRES))
    renderer = Renderer({"balls": one})
    yield renderer
    renderer.close()


@pytest.mark.medium
@pytest.mark.parametrize(
    "spec",
    [
        LensSpec(view_deg=70),
        pytest.param(LensSpec(view_deg=80, distortion=(-0.25, 0.06, 0.001, -0.0008)), marks=pytest.mark.slow),
        pytest.param(LensSpec(model="fisheye", view_deg=190, distortion=(0.02, -0.01)), marks=pytest.mark.slow),
    ],
    ids=["pinhole", "distorted", "fisheye"],
)
def test_an_object_is_where_its_lens_projects_it(balls: Renderer, spec: LensSpec) -> None:
    lens = Lens.from_spec(spec, 640, 480)
    where = view(0.0, 0.0, -40.0)
    measured = balls.measure(where, lens, surroundings(at_origin("balls")))
    for number, centre in enumerate(CENTRES):
        rows, columns = np.nonzero(measured[..., 0] == 1 + number)
        seen = lens.project((centre - where.pos_ned_m) @ where.rot_ned_optical)
        assert len(rows) > 20
        # The middle of the picture of a ball is off its centre by its size squared; of pixels by a tenth.
        np.testing.assert_allclose([columns.mean(), rows.mean()], seen, atol=0.35)


@pytest.mark.parametrize("view_deg", [100.0, 180.0, 220.0])
def test_every_pixel_of_a_fisheye_is_drawn_once(view_deg: float) -> None:
    lens = Lens.from_spec(LensSpec(model="fisheye", view_deg=view_deg), 90, 90)
    times = sum(np.asarray(face.pixels is not None and face.pixels.here, int) for face in faces_of(lens))
    seen = np.isfinite(lens.all_directions()).all(axis=-1)
    assert seen.any()
    np.testing.assert_array_equal(times, seen.astype(int))


def board(squares_m: float) -> tuple[TriangleModel, np.ndarray, int]:
    """A marker of ArUco of six by six squares with a white rim, upright across the north, and its corners."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    picture = np.pad(cv2.aruco.generateImageMarker(dictionary, 7, 6), 1, constant_values=255)
    parts = []
    for row, column in np.ndindex(picture.shape):
        centre = (0.0, (column - 3.5) * squares_m, (row - 3.5) * squares_m)
        colour = (0.95, 0.95, 0.95) if picture[row, column] else (0.02, 0.02, 0.02)
        square = moved(box((0.01, squares_m, squares_m), CONCRETE), centre)
        parts.append(triangles(square, colour, ObjectClass.OTHER, 0, 0.0))
    half = 3.0 * squares_m
    corners = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    return (
        TriangleModel(np.concatenate(parts), (WorldObject("board", ObjectClass.OTHER, (0, 0, 0), (1, 1, 1)),)),
        corners,
        7,
    )


@pytest.mark.medium
def test_opencv_finds_the_true_pose_of_a_marker() -> None:
    marker, corners, number = board(0.25)
    renderer = Renderer({"board": marker})
    turn_deg, place = 24.0, np.array([9.0, 1.2, -3.0])
    rotation = frames.quat_to_matrix(frames.euler_to_quat(np.radians([0.0, 0.0, turn_deg])))
    world = surroundings(PlacedModel("board", place, rotation, 1))
    where = view(0.0, 0.0, -2.5)
    image = renderer.colour([Shot(where, world)], LENS, world.light.exposure)
    renderer.close()
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    found, numbers, _ = detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    assert numbers is not None
    assert numbers.ravel().tolist() == [number]
    precise = cv2.cornerSubPix(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), found[0][0], (4, 4), (-1, -1), (3, 50, 1e-4))
    _, turn, offset = cv2.solvePnP(corners, precise, LENS.matrix, np.zeros(5), flags=cv2.SOLVEPNP_ITERATIVE)
    exact = (place - where.pos_ned_m - rotation @ [0.005, 0.0, 0.0]) @ where.rot_ned_optical
    assert np.linalg.norm(offset.ravel() - exact) < 0.01 * np.linalg.norm(exact)
    # Axes of the board in the image: its x is east, its y down, in NED.
    normal = cv2.Rodrigues(turn)[0] @ [0.0, 0.0, 1.0]
    true_normal = where.rot_ned_optical.T @ rotation @ [1.0, 0.0, 0.0]
    assert np.degrees(np.arccos(normal @ true_normal)) < 1.5


@pytest.mark.medium
def test_the_same_picture_is_drawn_again(river: tuple[Scenery, TriangleModel, Renderer]) -> None:
    _, world, renderer = river
    where, around = view(3.0, 2.0, -1.5, 40.0), surroundings(PlacedModel("world", np.zeros(3), np.eye(3), 1))
    exposure = around.light.exposure
    first = renderer.colour([Shot(where, around)], LENS, exposure)
    renderer.colour([Shot(view(-30.0, 2.0, -1.5, 140.0), around)], LENS, exposure)
    again = renderer.colour([Shot(where, around)], LENS, exposure)
    np.testing.assert_array_equal(first, again)
    other = Renderer({"world": world}, ("world",))
    np.testing.assert_array_equal(first, other.colour([Shot(where, around)], LENS, exposure))
    other.close()


@pytest.mark.medium
def test_a_rolling_shutter_slants_and_an_exposure_blurs() -> None:
    pole = model(moved(box((0.3, 0.3, 30.0), STEEL), (20.0, 0.0, -10.0)), colour=(0.05, 0.05, 0.05))
    renderer = Renderer({"pole": pole})
    world = surroundings(at_origin("pole"))
    exposure = world.light.exposure
    step_deg = 0.9  # of yaw from each band of rows to the next
    bands = [
        Shot(view(0, 0, -10.0, yaw_deg=step_deg * number), world, (60 * number, 60 * number + 60))
        for number in range(8)
    ]
    image = renderer.colour(bands, LENS, exposure)[..., 1].astype(int)
    darkest = [int(np.argmin(image[60 * number + 30])) for number in range(8)]
    expected = [LENS.centre_px[0] - LENS.focal_px * math.tan(math.radians(step_deg * number)) for number in range(8)]
    np.testing.assert_allclose(darkest, expected, atol=4.5)  # the pole is six pixels wide
    sharp = renderer.colour([Shot(view(0, 0, -10.0), world)], LENS, exposure)[100, :, 1].astype(int)
    shots = [Shot(view(0, 0, -10.0, yaw_deg=0.2 * number), world, None, 0.2) for number in range(-2, 3)]
    blurred = renderer.colour(shots, LENS, exposure)[100, :, 1].astype(int)
    renderer.close()
    level = int(np.median(sharp))
    assert (level - blurred > 8).sum() > (level - sharp > 8).sum()
    assert blurred.min() > sharp.min() + 8


@pytest.mark.medium
def test_fog_hides_what_is_beyond_the_visibility() -> None:
    wall = model(moved(box((1.0, 20.0, 20.0), CONCRETE), (60.0, 0.0, -10.0)), colour=(0.02, 0.02, 0.02))
    renderer = Renderer({"wall": wall})

    def contrast(visibility_m: float) -> float:
        world = surroundings(at_origin("wall"), extinction_per_m=visible_extinction_per_m(visibility_m))
        image = renderer.colour([Shot(view(0, 0, -8.0), world)], LENS, world.light.exposure)
        rows = image[200:230].astype(float) / 255.0
        light = np.where(rows > 0.04045, ((rows + 0.055) / 1.055) ** 2.4, rows / 12.92)[..., 1]
        return float(1.0 - light[:, 310:330].mean() / light[:, 2:20].mean())

    clear, misty, thick = contrast(5000.0), contrast(120.0), contrast(40.0)
    renderer.close()
    assert clear > 0.6
    # Koschmieder: a black object has 2 % of its contrast at the visibility, exp(-3.912 d / V) at a distance d.
    assert misty / clear == pytest.approx(math.exp(-3.912 * 59.5 / 120.0), abs=0.06)
    assert thick < 0.02


@pytest.mark.parametrize(("read", "shot"), [(0.02, 0.03), (0.0, 0.01), (0.004, 0.01), (0.1, 0.0)])
def test_noise_has_the_deviation_of_its_keys(read: float, shot: float) -> None:
    calm = np.full((480, 640, 3), 128, np.uint8)
    sensor = ImageSensor(640, 480)
    noisy = sensor.expose(calm, ImageResponse(read_noise=read, shot_noise=shot, grain_at=(5, 9)))
    rounding = math.sqrt(1.0 / 12.0)
    expected = math.hypot(255.0 * math.sqrt(read**2 + shot**2 * 128.0 / 255.0), rounding)
    measured = noisy.astype(float) - 128.0
    assert measured.std() == pytest.approx(expected, rel=0.02)
    assert measured.mean() == pytest.approx(0.0, abs=0.02 * expected + 0.02)
    elsewhere = sensor.expose(calm, ImageResponse(read_noise=read, shot_noise=shot, grain_at=(6, 9)))
    np.testing.assert_array_equal(noisy[:, 1:], elsewhere[:, :-1])


def test_vignetting_darkens_the_corners_by_its_share_of_the_light() -> None:
    even = np.full((480, 640, 3), 200, np.uint8)
    image = ImageSensor(640, 480).expose(even, ImageResponse(vignetting=0.36))
    assert image[240, 320].tolist() == [200, 200, 200]
    assert image[0, 0, 0] == pytest.approx(200 * math.sqrt(1.0 - 0.36), abs=1.0)


@pytest.mark.medium
def test_sky_and_water_meet_at_the_horizon() -> None:
    none = model(moved(box((1.0, 1.0, 1.0), STEEL), (-500.0, 0.0, 0.0)))
    renderer = Renderer({"one": none})
    measured = renderer.measure(view(0.0, 0.0, -3.0, pitch_deg=-4.0), LENS, surroundings(at_origin("one")))
    renderer.close()
    numbers = measured[:, 320, 0]
    horizon = LENS.centre_px[1] - LENS.focal_px * math.tan(math.radians(4.0))
    assert set(np.unique(numbers)) == {SEA_ID, SKY_ID}
    assert int((numbers == SKY_ID).sum()) == pytest.approx(horizon, abs=1.5)
    assert VERTEX.itemsize == 48


@pytest.mark.medium
def test_a_moving_object_has_its_shadow_on_the_water_where_the_sun_throws_it() -> None:
    plate_m = 1.0, -2.0, -3.0  # above the water
    sun = np.array([0.0, 1.0, -1.0]) / np.sqrt(2.0)  # in the east
    plate = model(box((2.0, 2.0, 0.2), STEEL))
    above = view(0.0, 0.0, -12.0, pitch_deg=-90.0)
    placed = PlacedModel("plate", np.array(plate_m), np.eye(3), 1)
    water = {"water_colour": np.array([0.2, 0.2, 0.2]), "wind_ne_mps": np.zeros(2)}

    def darker(still: tuple[str, ...], light: Daylight) -> np.ndarray:
        """Return where the plate darkens the water, (P, 2) north and east."""
        renderer = Renderer({"plate": plate}, still)
        pictures = []
        for objects in ((), (placed,)):
            world = surroundings(*objects, light=light, **water)
            pictures.append(renderer.colour([Shot(above, world)], LENS, light.exposure).astype(float).mean(axis=2))
            numbers = renderer.numbers(LENS)
        renderer.close()
        rows, columns = np.nonzero((pictures[1] < 0.85 * pictures[0]) & (numbers == SEA_ID))
        rays = LENS.directions(np.column_stack([columns, rows]).astype(float)) @ above.rot_ned_optical.T
        return 12.0 * rays[:, :2] / rays[:, 2:]

    shadow_ne_m = darker((), daylight(sun, 0.0))
    low, high = shadow_ne_m.min(axis=0), shadow_ne_m.max(axis=0)
    # Three metres high, so three metres to the west; the plate is 0.2 m thick
    assert low == pytest.approx([0.0, -6.1], abs=0.2)
    assert high == pytest.approx([2.0, -3.9], abs=0.2)
    assert not len(darker((), daylight(sun, 1.0)))  # clouds hide the sun
    assert not len(darker((), daylight(np.array([0.0, 0.94, 0.34]), 0.0)))  # night
    assert not len(darker(("plate",), daylight(sun, 0.0)))  # what never moves
