"""What is drawn: nodes of a viser server, without a browser."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from sim_core.environment.spec import EnvironmentSpec, Water
from sim_core.environment.tide import make_tide
from sim_core.environment.tide_spec import ConstituentSpec, TideSpec
from xitl_cli.plugins.view import shapes
from xitl_cli.plugins.view.drawing import (
    GUIDED,
    MISSION,
    REACHED,
    TRACK_PIECE,
    TRACK_PIECES,
    SceneDrawing,
    stream_arrows,
)
from xitl_cli.plugins.view.instruments import legend
from xitl_cli.plugins.view.model import (
    BodyInstant,
    SceneThruster,
    SceneVessel,
    SceneWater,
    SceneWaves,
    VesselInstant,
    ViewInstant,
    ViewScene,
    obstacle_class,
)
from xitl_cli.plugins.view.scene import NO_WAVES

viser = pytest.importorskip("viser")

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
BOAT = SceneVessel(
    (shapes.boat(2.0).mesh("boat", (255, 255, 255)),),
    (SceneThruster((-1.0, 0.0, -0.1), (1.0, 0.0, 0.0), 0.2, 0),),
    mission_enu_m=np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0]]),
)
AT_START = VesselInstant(np.zeros(3), LEVEL)


@pytest.fixture(scope="module")
def server() -> Iterator[object]:
    made = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield made
    made.stop()


class DrawingOnServer(SceneDrawing):
    """A drawing that tells its server."""

    def __init__(self, server: viser.ViserServer, scene: ViewScene) -> None:
        super().__init__(server, scene)
        self.server = server


@pytest.fixture
def drawing(server: viser.ViserServer) -> DrawingOnServer:
    server.scene.reset()
    return DrawingOnServer(server, ViewScene("test", vessels={"": BOAT}))


def node(drawing: DrawingOnServer, path: str) -> object:
    found = drawing.server.scene.get_handle_by_name(path)
    assert found is not None, path
    return found


def draw(drawing: DrawingOnServer, time_s: float, vessel: VesselInstant, **world: object) -> None:
    drawing.draw(ViewInstant(time_s, {"": vessel}, **world))  # type: ignore[arg-type]


def test_hull_and_ghost_are_where_truth_and_estimate_are(drawing: DrawingOnServer) -> None:
    place, believed = np.array([3.0, 4.0, 0.1]), np.array([3.5, 4.0, 0.1])
    draw(drawing, 0.0, replace(AT_START, position_enu_m=place, estimate_position_enu_m=believed))
    assert node(drawing, "/vessels/vessel").position == pytest.approx(place)
    assert node(drawing, "/estimates/vessel").position == pytest.approx(believed)
    drawing.show_estimates(False)
    draw(drawing, 0.1, replace(AT_START, estimate_position_enu_m=believed))
    assert not node(drawing, "/estimates/vessel").visible


def test_a_propeller_turns_with_its_command(drawing: DrawingOnServer) -> None:
    draw(drawing, 0.0, replace(AT_START, motors=(0.5,)))
    draw(drawing, 0.02, replace(AT_START, motors=(0.5,)))
    w, x, _, _ = node(drawing, "/vessels/vessel/propellers/0").wxyz
    assert x * w > 0.0
    draw(drawing, 0.06, replace(AT_START, motors=(-0.5,)))
    w, x, _, _ = node(drawing, "/vessels/vessel/propellers/0").wxyz
    assert x * w < 0.0
    still = np.array(node(drawing, "/vessels/vessel/propellers/0").wxyz)
    draw(drawing, 0.08, replace(AT_START, motors=(0.0,)))
    assert node(drawing, "/vessels/vessel/propellers/0").wxyz == pytest.approx(still)


def test_waypoints_that_were_reached_change_their_colour(drawing: DrawingOnServer) -> None:
    draw(drawing, 0.0, replace(AT_START, waypoints_reached=1))
    assert tuple(node(drawing, "/missions/vessel/waypoint 1").color) == REACHED
    assert tuple(node(drawing, "/missions/vessel/waypoint 2").color) == MISSION


def test_a_mission_that_is_another_is_drawn_in_place_of_the_first_until_time_goes_back(
    drawing: DrawingOnServer,
) -> None:
    other = np.array([[0.0, 0.0, 0.0], [5.0, 6.0, 0.0]])
    draw(drawing, 0.0, AT_START)
    draw(drawing, 1.0, replace(AT_START, mission_enu_m=other, waypoints_reached=1))
    handles = drawing.server.scene.get_handle_by_name
    assert node(drawing, "/missions/vessel/waypoint 1").position[:2] == pytest.approx([5.0, 6.0])
    assert tuple(node(drawing, "/missions/vessel/waypoint 1").color) == REACHED
    assert handles("/missions/vessel/waypoint 2") is None
    draw(drawing, 0.5, AT_START)
    assert node(drawing, "/missions/vessel/waypoint 1").position[:2] == pytest.approx([10.0, 0.0])
    assert handles("/missions/vessel/waypoint 2") is not None


def test_the_track_grows_and_begins_anew_when_time_goes_back(drawing: DrawingOnServer) -> None:
    for step in range(5):
        draw(drawing, float(step), replace(AT_START, position_enu_m=np.array([2.0 * step, 0.0, 0.0])))
    points = node(drawing, "/tracks/vessel/new").points
    assert points[:4, :, 0].tolist() == [[0.0, 2.0], [2.0, 4.0], [4.0, 6.0], [6.0, 8.0]]
    assert (points[4:, :, 0] == 8.0).all()
    draw(drawing, 1.0, AT_START)
    assert drawing.server.scene.get_handle_by_name("/tracks/vessel/new") is None


@pytest.mark.medium
def test_a_long_track_has_two_nodes_of_constant_size(drawing: DrawingOnServer) -> None:
    def sail(first: int, end: int) -> None:
        for step in range(first, end):
            draw(drawing, float(step), replace(AT_START, position_enu_m=np.array([1.0 * step, 0.0, 0.0])))

    handles = drawing.server.scene.get_handle_by_name
    sail(0, TRACK_PIECE + 1)
    past = node(drawing, "/tracks/vessel/past").points
    assert past.shape == (TRACK_PIECES * TRACK_PIECE, 2, 3)
    assert past[-TRACK_PIECE:, :, 0].tolist() == [[step, step + 1] for step in range(TRACK_PIECE)]
    assert (past[:-TRACK_PIECE, :, 0] == 0.0).all()
    sail(TRACK_PIECE + 1, 3 * TRACK_PIECE + 1)
    assert node(drawing, "/tracks/vessel/past").points[-3 * TRACK_PIECE :, 1, 0].tolist() == list(
        range(1, 3 * TRACK_PIECE + 1)
    )
    draw(drawing, 0.0, AT_START)
    assert handles("/tracks/vessel/past") is handles("/tracks/vessel/new") is None


def test_streams_point_where_they_go(drawing: DrawingOnServer) -> None:
    draw(drawing, 0.0, AT_START, wind_en_mps=(0.0, 4.0), current_en_mps=(0.5, 0.0))
    wind, current = node(drawing, "/streams/vessel/wind"), node(drawing, "/streams/vessel/current")
    assert wind.wxyz == pytest.approx([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    assert current.wxyz == pytest.approx([1.0, 0.0, 0.0, 0.0])
    draw(drawing, 0.1, AT_START)
    assert not wind.visible


def test_clouds_obstacles_target_and_debris(drawing: DrawingOnServer) -> None:
    points = np.zeros((10, 3), dtype=np.float32)
    body = BodyInstant(np.ones(3), LEVEL, (shapes.cuboid((1.0, 1.0, 1.0)).mesh("trunk", (90, 60, 30)),))
    seen = replace(
        AT_START,
        clouds={"lidar": points},
        obstacles_enu_m=np.ones((2, 3)),
        obstacle_radius_m=np.array([1.0, 2.0]),
        target_enu_m=np.array([10.0, 0.0, 0.0]),
    )
    draw(drawing, 0.0, seen, bodies={3: body})
    assert len(node(drawing, "/clouds/vessel/lidar").points) == 10
    assert len(node(drawing, "/obstacles/vessel").batched_positions) == 2
    assert node(drawing, "/targets/vessel").position == pytest.approx([10.0, 0.0, 0.0])
    assert node(drawing, "/debris/3").position == pytest.approx(np.ones(3))
    draw(drawing, 0.1, AT_START)
    assert drawing.server.scene.get_handle_by_name("/obstacles/vessel") is None
    assert not node(drawing, "/debris/3").visible
    assert not node(drawing, "/clouds/vessel/lidar").visible
    draw(drawing, 0.2, replace(seen, clouds={"lidar": points[:4].copy()}))
    assert node(drawing, "/clouds/vessel/lidar").visible
    assert len(node(drawing, "/clouds/vessel/lidar").points) == 4


def test_the_class_of_an_obstacle_is_written_above_it(drawing: DrawingOnServer) -> None:
    places = np.array([[5.0, 1.0, -0.5], [9.0, 2.0, -0.5], [7.0, 3.0, -0.5]])
    seen = replace(AT_START, obstacles_enu_m=places, obstacle_radius_m=np.ones(3))
    draw(drawing, 0.0, replace(seen, obstacle_classes=("", obstacle_class("buoy", 0.924), obstacle_class("boom", 1.0))))
    first, second = (node(drawing, f"/obstacle classes/vessel/{number}") for number in (0, 1))
    assert (first.text, second.text) == ("buoy 92 %", "boom 100 %")
    assert first.position == pytest.approx([9.0, 2.0, 1.6])
    draw(drawing, 0.1, replace(seen, obstacle_classes=("", "", "vessel 60 %")))
    assert (first.text, first.position[0], first.visible, second.visible) == ("vessel 60 %", 7.0, True, False)
    draw(drawing, 0.2, AT_START)
    assert not first.visible


def test_a_guided_target_is_a_mark_until_there_is_none(drawing: DrawingOnServer) -> None:
    draw(drawing, 0.0, AT_START)
    assert drawing.server.scene.get_handle_by_name("/guided/vessel") is None
    draw(drawing, 0.1, replace(AT_START, guided_enu_m=np.array([20.0, 5.0, 0.0])))
    mark = node(drawing, "/guided/vessel")
    assert mark.position == pytest.approx([20.0, 5.0, 0.0])
    assert mark.visible
    assert tuple(mark.color) == GUIDED
    draw(drawing, 0.2, replace(AT_START, guided_enu_m=np.array([-3.0, 8.0, 0.0])))
    assert mark.position == pytest.approx([-3.0, 8.0, 0.0])
    draw(drawing, 0.3, AT_START)
    assert not mark.visible


@pytest.mark.parametrize("length_m", [0.2, 2.0, 9.0])
def test_arrows_are_as_long_as_the_legend_says(server: viser.ViserServer, length_m: float) -> None:
    server.scene.reset()
    drawing = DrawingOnServer(server, ViewScene("test", vessels={"": replace(BOAT, length_m=length_m)}))
    draw(drawing, 0.0, AT_START, wind_en_mps=(3.0, 4.0), current_en_mps=(0.0, 0.5))
    speeds_mps = {"wind": 5.0, "current": 0.5}
    for arrow in stream_arrows(length_m):
        drawn = node(drawing, f"/streams/vessel/{arrow.name}")
        assert drawn.scale[0] == pytest.approx(arrow.m_per_mps * speeds_mps[arrow.name])
        assert tuple(drawn.color) == arrow.colour
    told = legend(ViewInstant(0.0, {"": AT_START}), replace(BOAT, length_m=length_m), {})
    assert [(entry.colour, entry.scale) for entry in told if entry.scale] == [
        (arrow.colour, f"1 m = {1.0 / arrow.m_per_mps:.2g} m/s") for arrow in stream_arrows(length_m)
    ]


def test_a_vessel_that_no_scene_has_is_a_plain_boat(drawing: DrawingOnServer) -> None:
    drawing.draw(ViewInstant(0.0, {"other": AT_START}))
    assert node(drawing, "/vessels/other/0") is not None


def test_water_takes_up_waves_that_somebody_raises_and_lies_flat_again(drawing: DrawingOnServer) -> None:
    draw(drawing, 0.0, AT_START)
    assert len(node(drawing, "/water").vertices) == 4
    swell = SceneWaves(np.array([0.4]), np.array([[0.1, 0.0]]), np.array([1.0]), np.array([0.0]))
    draw(drawing, 1.0, AT_START, waves=swell)
    heights = np.array(node(drawing, "/water").vertices)[:, 2]
    assert heights.max() == pytest.approx(0.4, rel=0.05)
    draw(drawing, 1.1, AT_START)
    assert not np.array_equal(np.asarray(node(drawing, "/water").vertices)[:, 2], heights)
    draw(drawing, 2.0, AT_START, waves=NO_WAVES)
    assert not np.asarray(node(drawing, "/water").vertices)[:, 2].any()


def test_water_and_mission_rise_with_the_tide(server: viser.ViserServer) -> None:
    server.scene.reset()
    keys = TideSpec(constituents=(ConstituentSpec("quick", 2.0, 90.0, speed_degph=360.0),))
    water = SceneWater(level_m=0.1, tide=make_tide(EnvironmentSpec(water=Water(tide=keys))))
    drawing = DrawingOnServer(server, ViewScene("test", vessels={"": BOAT}, water=water))
    draw(drawing, 0.0, AT_START)
    assert node(drawing, "/water").position[2] == pytest.approx(0.1)
    before_m = float(node(drawing, "/missions/vessel/waypoint 1").position[2])
    draw(drawing, 900.0, AT_START)
    assert node(drawing, "/water").position[2] == pytest.approx(2.1)
    assert node(drawing, "/missions/vessel/waypoint 1").position[2] == pytest.approx(before_m + 2.0)


def test_a_drawing_of_a_moment_is_replaced_and_removed(drawing: DrawingOnServer) -> None:
    ball, other = ((shapes.boat(size).mesh("ball", (255, 0, 0)),) for size in (1.0, 2.0))
    draw(drawing, 0.0, AT_START, drawings={"radar": ball})
    first = node(drawing, "/drawings/radar/0")
    draw(drawing, 0.1, AT_START, drawings={"radar": ball})
    assert node(drawing, "/drawings/radar/0") is first
    draw(drawing, 0.2, AT_START, drawings={"radar": other})
    assert node(drawing, "/drawings/radar/0").vertices == pytest.approx(other[0].vertices_m)
    draw(drawing, 0.3, AT_START)
    assert drawing.server.scene.get_handle_by_name("/drawings/radar/0") is None
