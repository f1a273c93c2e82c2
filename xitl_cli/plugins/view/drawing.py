"""Draw a scene and its instants as nodes of a viser server, for live runs, recordings and pages.

drawing = SceneDrawing(server, scene)
drawing.draw(instant)

Existing nodes are moved and not created again, because a browser can keep up with moves only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import frd_to_flu, quat_multiply
from xitl_cli.plugins.view import shapes
from xitl_cli.plugins.view.chart_drawing import add_chart
from xitl_cli.plugins.view.look import DAY, NIGHT, show_lighting
from xitl_cli.plugins.view.model import (
    Array,
    BodyInstant,
    Colour,
    Points,
    SceneMesh,
    SceneVessel,
    SceneWater,
    SceneWaves,
    VesselInstant,
    ViewInstant,
    ViewScene,
)
from xitl_cli.plugins.view.scene import plain_vessel
from xitl_cli.plugins.view.shapes import SCREEN_WATER, WaterGrid, WaterResolution, heading_wxyz
from xitl_cli.run.world.colours import linear_colour
from xitl_cli.run.world.vessel_shape import propeller_mesh

if TYPE_CHECKING:
    import viser

MOST_POINTS = 30_000
"""Maximum number of points of one sensor's cloud. A browser without a graphics card draws more points for seconds."""
TRACK_STEP_M = 0.3
LEVEL_STEP_M = 0.01
"""Change of the water level after which the water and the marks on it move."""
CHART_DEPTH_M = 0.08
"""Height of tracks and marks above a chart."""
WAKE_S, WAKE_STEP_S = 30.0, 0.5
"""Drawn length of a wake, and the time between two points of it."""
TRACK_PIECE = 100
TRACK_PIECES = 60
SPIN_RADPS = 18.0
"""Drawn rate of a propeller at full command. It is low, so that the direction of rotation is visible."""
MOST_SPIN_RAD = 0.9
"""Maximum turn of a propeller between two pictures. It is less than half of the angle between two blades."""
WIND_M_PER_MPS, CURRENT_M_PER_MPS = 0.25, 1.5
"""Arrow length per m/s for a vessel of 1 m. It grows with the square root of the vessel's length: `stream_size`."""
LEAST_STREAM_MPS = 0.01
"""Minimum speed of a wind or current for an arrow."""
ESTIMATE: Colour = (0, 190, 170)
MISSION: Colour = (250, 190, 40)
REACHED: Colour = (60, 180, 90)
TRACK: Colour = (255, 120, 40)
TARGET: Colour = (240, 70, 60)
GUIDED: Colour = (215, 60, 200)
OBSTACLE: Colour = (235, 50, 60)
POST_M = 1.6
"""Height of the post of an obstacle."""
CLASS_SCALE = 1.5
"""Size of the text of a class. The page lays out texts of a size together, and the values of the instruments change
often."""
WIND: Colour = (245, 245, 250)
CURRENT: Colour = (40, 150, 255)
CLOUDS: Mapping[str, Colour] = {"lidar": (255, 90, 60), "sonar": (40, 220, 255), "map": (190, 120, 255)}
OTHER_CLOUD: Colour = (240, 240, 90)


@dataclass(frozen=True, slots=True)
class StreamArrow:
    """An entry of the legend. An arrow points where its stream flows to."""

    name: str
    colour: Colour
    m_per_mps: float
    """Length of the arrow in metres per m/s."""


def stream_size(length_m: float) -> float:
    """Return the length factor of the arrows at a vessel of this length."""
    return math.sqrt(max(length_m, 0.3))


def stream_arrows(length_m: float) -> tuple[StreamArrow, ...]:
    """Return the arrows that are drawn at a vessel of this length."""
    size = stream_size(length_m)
    return StreamArrow("wind", WIND, WIND_M_PER_MPS * size), StreamArrow("current", CURRENT, CURRENT_M_PER_MPS * size)


class SceneDrawing:
    """Draws the constant parts of a scene when it is created, and everything else at each instant.

    tracks: draw the tracks of the vessels. water: resolution of the water surface. dark: use the night colours. past:
    returns the way of a vessel before a time, (P, 3) east, north and time, for its wake; None uses the drawn instants.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: ViewScene,
        *,
        dark: bool = False,
        tracks: bool = True,
        water: WaterResolution = SCREEN_WATER,
        past: Callable[[str, float], Array] | None = None,
    ) -> None:
        self._past = past
        self.scene = scene
        self._server = server
        self._tracks = tracks
        self._time_s = math.nan
        self._vessels: dict[str, _VesselDrawing] = {}
        self._bodies: dict[int, Any] = {}
        self._passing: dict[str, tuple[tuple[SceneMesh, ...], list[Any]]] = {}
        api = server.scene
        api.configure_environment_map(None)
        api.configure_default_lights(False)
        api.world_axes.visible = False
        for number, mesh in enumerate(scene.meshes):
            _add_mesh(api, f"/surroundings/{number} {mesh.name}", mesh)
        self._chart = None
        if scene.chart is not None:
            self._chart = add_chart(api, scene.chart, scene.water.level_m + lift_m(scene.water) - CHART_DEPTH_M)
        self._look = api.add_frame("/look", show_axes=False)
        self._look_water = api.add_frame("/look/water", show_axes=False)
        self._wind_mps = 0.0
        self._water = _WaterDrawing(api, scene.water, water)
        self.dark = dark
        for name, vessel in scene.vessels.items():
            self._vessels[name] = _VesselDrawing(api, name, vessel, scene.water)

    @property
    def dark(self) -> bool:
        """True while the night colours are used."""
        return self._dark

    @dark.setter
    def dark(self, dark: bool) -> None:
        self._dark = dark
        lighting = NIGHT if dark else DAY
        show_lighting(self._server.scene, lighting)
        self._water.colour(lighting.water)
        # Without reflections, muddy water would look like ground. So only look.js gives the water its own colour.
        drawn = self.scene.water.colour or lighting.water
        self._look_water.position = linear_colour([part / 255.0 for part in drawn])
        self._tell_look()

    def _tell_look(self) -> None:
        """Send time, night and wind to the script of the page, see look.js."""
        time_s = self._time_s if math.isfinite(self._time_s) else 0.0
        self._look.position = (time_s, float(self._dark), self._wind_mps)

    def draw(self, instant: ViewInstant) -> None:
        """Draw an instant in one update. If it is earlier than the previous one, the tracks start again."""
        with self._server.atomic():
            if instant.time_s < self._time_s:
                for drawn in self._vessels.values():
                    drawn.forget_track()
            elapsed_s = instant.time_s - self._time_s if math.isfinite(self._time_s) else 0.0
            self._time_s = instant.time_s
            for name in instant.vessels:
                if name not in self._vessels:
                    self._vessels[name] = _VesselDrawing(self._server.scene, name, plain_vessel(), self.scene.water)
            self._wind_mps = math.hypot(*instant.wind_en_mps)
            self._tell_look()
            level_m = self.scene.water.level_at_m(instant.time_s)
            for name, vessel in instant.vessels.items():
                self._vessels[name].draw(vessel, elapsed_s, self._tracks, level_m)
                past = None if self._past is None else self._past(name, instant.time_s)
                self._vessels[name].wake.draw(instant.time_s, vessel.position_enu_m, past)
            self._draw_bodies(instant.bodies)
            self._draw_passing(instant.drawings)
            if instant.vessels:
                first = next(iter(instant.vessels))
                place = instant.vessels[first].position_enu_m
                if instant.waves is not None and instant.waves is not self._water.waves:
                    self._water.change(instant.waves)
                self._water.draw(instant.time_s, place[:2], level_m)
                self._vessels[first].draw_streams(place, instant.wind_en_mps, instant.current_en_mps)

    def show_estimates(self, shown: bool) -> None:
        """Show or hide the transparent hulls at the autopilots' estimated poses."""
        for vessel in self._vessels.values():
            vessel.show_estimate = shown

    def show_clouds(self, shown: bool) -> None:
        """Show or hide the point clouds of lidar and sonar."""
        for vessel in self._vessels.values():
            vessel.show_clouds = shown

    @property
    def has_chart(self) -> bool:
        """True if the scene has a chart."""
        return self._chart is not None

    def show_chart(self, shown: bool) -> None:
        """Show or hide the chart."""
        if self._chart is not None:
            self._chart.visible = shown

    def _draw_passing(self, drawings: Mapping[str, tuple[SceneMesh, ...]]) -> None:
        for name, (meshes, nodes) in list(self._passing.items()):
            if drawings.get(name) is not meshes:
                for node in nodes:
                    node.remove()
                del self._passing[name]
        for name, meshes in drawings.items():
            if name not in self._passing:
                nodes = [
                    _add_mesh(self._server.scene, f"/drawings/{name}/{number}", mesh)
                    for number, mesh in enumerate(meshes)
                ]
                self._passing[name] = meshes, nodes

    def _draw_bodies(self, bodies: Mapping[int, BodyInstant]) -> None:
        for number, body in bodies.items():
            if number not in self._bodies and body.meshes:
                node = self._server.scene.add_frame(f"/debris/{number}", show_axes=False)
                for part, mesh in enumerate(body.meshes):
                    _add_mesh(self._server.scene, f"/debris/{number}/body/{part}", mesh)
                self._bodies[number] = node
            if number in self._bodies:
                _place(self._bodies[number], body.position_enu_m, body.attitude_wxyz)
                self._bodies[number].visible = True
        for number in self._bodies.keys() - bodies.keys():
            self._bodies[number].visible = False


def add_drawing_options(
    server: viser.ViserServer, drawing: SceneDrawing, changed: Callable[[], object] = lambda: None
) -> None:
    """Add a folder with the options of a drawing to the page. changed: called after each change of the shown parts."""
    gui = server.gui
    with gui.add_folder("Show", order=7.0, expand_by_default=False):
        estimates = gui.add_checkbox("Estimated pose", True)
        clouds = gui.add_checkbox("Lidar and sonar", True)
        night = gui.add_checkbox("Night", drawing.dark)
        if drawing.has_chart:
            chart = gui.add_checkbox("Map", True)
            chart.on_update(lambda event: drawing.show_chart(chart.value))

    def choose(event: object) -> None:
        drawing.show_estimates(estimates.value)
        drawing.show_clouds(clouds.value)
        changed()

    def change_light(event: object) -> None:
        drawing.dark = night.value
        gui.configure_theme(dark_mode=night.value, show_logo=False, show_share_button=False)

    estimates.on_update(choose)
    clouds.on_update(choose)
    night.on_update(change_light)


def lift_m(water: SceneWater) -> float:
    """Return the height of marks above the still water, so that waves do not hide them."""
    if water.waves is None:
        return 0.1
    # On average, crests reach half of the significant wave height.
    return 0.1 + 0.5 * 4.0 * math.sqrt(0.5) * float(np.linalg.norm(water.waves.amplitude_m))


class _WaterDrawing:
    def __init__(self, api: Any, water: SceneWater, resolution: WaterResolution) -> None:
        self._api = api
        self._level_m = water.level_m
        self._resolution = resolution
        self._grid = WaterGrid(water.waves, resolution=resolution)
        self._middle = self._grid.middle(np.asarray(water.centre_en_m, dtype=np.float64))
        self._node = self._add()

    def _add(self) -> Any:
        return self._api.add_mesh_simple(
            "/water",
            self._grid.vertices_m,
            self._grid.faces,
            opacity=0.86,
            cast_shadow=False,
            receive_shadow=False,
            position=(*self._middle, self._level_m),
        )

    @property
    def waves(self) -> SceneWaves | None:
        return self._grid.waves

    def colour(self, colour: Colour) -> None:
        self._node.color = colour

    def change(self, waves: SceneWaves) -> None:
        """Replace the waves. A plane becomes a grid that waves can move."""
        corners, colour = len(self._grid.vertices_m), self._node.color
        self._grid = WaterGrid(waves, resolution=self._resolution)
        if len(self._grid.vertices_m) != corners:
            self._node = self._add()
            self._node.color = colour

    def draw(self, time_s: float, place_en_m: Array, level_m: float) -> None:
        middle = self._grid.middle(place_en_m)
        if abs(level_m - self._level_m) >= LEVEL_STEP_M:
            self._level_m = level_m
            self._node.position = (*self._middle, level_m)
        if self._grid.waves is not None:
            self._node.vertices = self._grid.move(time_s, middle)
        if middle != self._middle and (
            self._grid.waves is not None or math.dist(middle, self._middle) > 50.0  # a plane need not follow each step
        ):
            self._middle = middle
            self._node.position = (*middle, self._level_m)


class _WakeDrawing:
    """The way of a vessel as an invisible node, from which look.js paints the wake on the water."""

    def __init__(self, api: Any, path: str, vessel: SceneVessel) -> None:
        self._api, self._path = api, path
        beam_m = max(
            (float(np.ptp(mesh.vertices_m[:, 1])) for mesh in vessel.meshes if len(mesh.vertices_m)), default=0.0
        )
        self._size = np.array([[vessel.length_m, beam_m or 0.3 * vessel.length_m, 0.0]])
        self._points = np.empty((0, 3))
        self._node: Any = None

    def draw(self, time_s: float, place: Array, past: Array | None) -> None:
        """Draw the wake at an instant. past: see SceneDrawing."""
        last_s = self._points[-1, 2] if len(self._points) else -math.inf
        if last_s <= time_s < last_s + WAKE_STEP_S:
            return
        if past is None:
            kept = self._points[(self._points[:, 2] > time_s - WAKE_S) & (self._points[:, 2] < time_s)]
            past = np.concatenate([kept, [[float(place[0]), float(place[1]), time_s]]])
        self._points = past
        points = np.concatenate([self._size, past]).astype(np.float32)
        if self._node is None:
            self._node = self._api.add_point_cloud(
                self._path, points, (255, 255, 255), precision="float32", visible=False
            )
        else:
            self._node.points = points


class _TrackDrawing:
    """The track of a vessel in two nodes of constant size: each point changes the short one, each TRACK_PIECE the long.

    Further nodes would grow: viser needs 30 KB for each.
    """

    def __init__(self, api: Any, path: str) -> None:
        self._api, self._path = api, path
        self._nodes: dict[str, Any] = {}
        self._places: list[tuple[float, float, float]] = []
        self._past = np.empty((0, 2, 3), dtype=np.float32)

    def draw(self, place: tuple[float, float, float]) -> None:
        """Continue the track to a place (east, north, up)."""
        if self._places and math.dist(place, self._places[-1]) < TRACK_STEP_M:
            return
        self._places.append(place)
        count = len(self._places)
        if count < 2:
            return
        # A browser keeps the initial number of segments: future segments have the position of the last one.
        places = np.array([*self._places, *[place] * (TRACK_PIECE + 1 - count)], dtype=np.float32)
        segments = np.stack([places[:-1], places[1:]], axis=1)
        self._draw_node("new", segments)
        if count > TRACK_PIECE:
            if not len(self._past):
                self._past = np.full((TRACK_PIECES * TRACK_PIECE, 2, 3), segments[0, 0])
            self._past = np.concatenate([self._past[TRACK_PIECE:], segments])
            self._draw_node("past", self._past)
            self._places = [place]

    def _draw_node(self, name: str, segments: Points) -> None:
        if name in self._nodes:
            self._nodes[name].points = segments
        else:
            self._nodes[name] = self._api.add_line_segments(
                f"{self._path}/{name}", segments, colors=TRACK, thickness=3.0, thickness_units="screen"
            )

    def forget(self) -> None:
        """Remove the track. The next place begins a new one."""
        for node in self._nodes.values():
            node.remove()
        self._nodes, self._places, self._past = {}, [], self._past[:0]


class _VesselDrawing:
    """Nodes of one vessel: its hull, and its other nodes such as track, mission, clouds and arrows."""

    def __init__(self, api: Any, name: str, vessel: SceneVessel, water: SceneWater) -> None:
        self.show_estimate = self.show_clouds = True
        self._api = api
        self._path = f"/vessels/{name or 'vessel'}"
        self._level_m = water.level_m
        self._lift_m = lift_m(water)
        self._vessel = vessel
        self._mark_m = min(max(vessel.length_m, 0.6), 6.0)
        """Size of marks."""
        self._hull = api.add_frame(self._path, show_axes=False)
        self.wake = _WakeDrawing(api, self._path.replace("/vessels", "/wakes", 1), vessel)
        for number, mesh in enumerate(vessel.meshes):
            _add_mesh(api, f"{self._path}/{number}", mesh)
        self._propellers = []
        for number, thruster in enumerate(vessel.thrusters):
            drawn = propeller_mesh(thruster.diameter_m)
            turning = shapes.geometry(frd_to_flu(drawn.vertices_m), drawn.faces).mesh("propeller", (45, 48, 54))
            path = f"{self._path}/propellers/{number}"
            self._propellers.append(_add_mesh(api, path, turning, position=thruster.place_flu_m))
        self._turned_rad = [0.0] * len(vessel.thrusters)
        self._estimate: Any = None
        self._clouds: dict[str, tuple[Points, Any]] = {}
        self._obstacles: Any = None
        self._obstacle_classes: list[Any] = []
        self._obstacles_drawn: tuple[Any, ...] = ()
        self._target: Any = None
        self._guided: Any = None
        self._track = _TrackDrawing(api, self._path.replace("/vessels", "/tracks", 1))
        self._wind: Any = None
        self._current: Any = None
        self._mission: Array = np.empty((0, 3))
        self._mission_nodes: list[Any] = []
        self._marks: list[Any] = []
        self._draw_mission(vessel.mission_enu_m)

    def _draw_mission(self, places: Array, moved: bool = False) -> None:
        if not moved and (places is self._mission or np.array_equal(places, self._mission)):
            return
        for node in self._mission_nodes:
            node.remove()
        self._mission, self._mission_nodes, self._marks = places, [], []
        if len(places) < 2:
            return
        line = places.copy()
        line[:, 2] = self._level_m + self._lift_m
        path = self._path.replace("/vessels", "/missions", 1)
        lines = [_add_line(self._api, f"{path}/line", line, MISSION, 2.0)]
        size = self._mark_m
        mark = shapes.merged(
            [
                shapes.frustum((0.04 * size, 0.04 * size, 1.6 * size), sides=8).placed((0.0, 0.0, 0.8 * size)),
                shapes.frustum((0.5 * size, 0.5 * size, 0.5 * size), 0.0, 1.0, sides=4).placed((0.0, 0.0, 1.85 * size)),
            ]
        )
        for number, place in enumerate(line[1:], start=1):
            waypoint = mark.mesh("waypoint", MISSION)
            self._marks.append(_add_mesh(self._api, f"{path}/waypoint {number}", waypoint, position=tuple(place)))
            if self._vessel.acceptance_radius_m > 0.0:
                ring = _ring(self._vessel.acceptance_radius_m) + place
                lines.append(_add_line(self._api, f"{path}/radius {number}", ring, MISSION, 1.0))
        self._mission_nodes = [*lines, *self._marks]

    def draw(self, vessel: VesselInstant, elapsed_s: float, tracked: bool, level_m: float) -> None:
        if abs(level_m - self._level_m) >= LEVEL_STEP_M:
            self._level_m = level_m
            self._draw_mission(self._mission, moved=True)
        _place(self._hull, vessel.position_enu_m, vessel.attitude_wxyz)
        # Turn the propellers
        for propeller, (node, thruster) in enumerate(zip(self._propellers, self._vessel.thrusters, strict=True)):
            command = vessel.motors[thruster.motor] if thruster.motor < len(vessel.motors) else 0.0
            if command and elapsed_s > 0.0:
                turn = max(-MOST_SPIN_RAD, min(MOST_SPIN_RAD, SPIN_RADPS * command * elapsed_s))
                self._turned_rad[propeller] = (self._turned_rad[propeller] + turn) % (2.0 * math.pi)
                half = 0.5 * self._turned_rad[propeller]
                across = np.array(heading_wxyz(thruster.axis_flu[0], thruster.axis_flu[1]))
                node.wxyz = quat_multiply(across, np.array([math.cos(half), math.sin(half), 0.0, 0.0]))
        self._draw_estimate(vessel)
        if tracked:
            east_m, north_m, _ = vessel.position_enu_m.tolist()
            self._track.draw((east_m, north_m, self._level_m + self._lift_m + 0.03))
        self._draw_mission(self._vessel.mission_enu_m if vessel.mission_enu_m is None else vessel.mission_enu_m)
        for number, mark in enumerate(self._marks):
            colour = REACHED if number < vessel.waypoints_reached else MISSION
            if tuple(mark.color) != colour:
                mark.color = colour
        self._target = self._mark_at(vessel.target_enu_m, self._target, self._make_target)
        self._guided = self._mark_at(vessel.guided_enu_m, self._guided, self._make_guided)
        self._draw_clouds(vessel.clouds)
        self._draw_obstacles(vessel)

    def forget_track(self) -> None:
        self._track.forget()

    def _draw_estimate(self, vessel: VesselInstant) -> None:
        place, attitude = vessel.estimate_position_enu_m, vessel.estimate_attitude_wxyz
        shown = self.show_estimate and place is not None and bool(np.isfinite(place).all())
        if self._estimate is None:
            if not shown:
                return
            path = self._path.replace("/vessels", "/estimates", 1)
            self._estimate = self._api.add_frame(path, show_axes=False)
            for number, mesh in enumerate(self._vessel.meshes):
                ghost = SceneMesh(mesh.name, mesh.vertices_m, mesh.faces, ESTIMATE, 0.18)
                _add_mesh(self._api, f"{path}/{number}", ghost)
        if bool(self._estimate.visible) != shown:
            self._estimate.visible = shown
        if shown and place is not None:
            _place(self._estimate, place, vessel.attitude_wxyz if attitude is None else attitude)

    def _mark_at(self, place: Array | None, mark: Any, make: Callable[[], Any]) -> Any:
        """Move a mark to a place on the water, or hide it, and return it. The first place creates it."""
        if place is None:
            if mark is not None:
                mark.visible = False
            return mark
        mark = make() if mark is None else mark
        mark.visible = True
        mark.position = (float(place[0]), float(place[1]), self._level_m)
        return mark

    def _make_target(self) -> Any:
        size = self._mark_m
        cone = shapes.frustum((0.6 * size, 0.6 * size, 0.8 * size), 0.0, 1.0, sides=16)
        mark = cone.placed((0.0, 0.0, 2.9 * size)).mesh("target", TARGET)
        return _add_mesh(self._api, self._path.replace("/vessels", "/targets", 1), mark)

    def _make_guided(self) -> Any:
        """Add the target in GUIDED: a post with a ring on the water, because no waypoint marks it."""
        size, path = self._mark_m, self._path.replace("/vessels", "/guided", 1)
        post = shapes.frustum((0.12 * size, 0.12 * size, 2.2 * size), sides=8).placed((0.0, 0.0, 1.1 * size))
        cone = shapes.frustum((0.7 * size, 0.7 * size, 0.9 * size), 0.0, 1.0, sides=16)
        mark = shapes.merged([post, cone.placed((0.0, 0.0, 2.4 * size))]).mesh("guided target", GUIDED)
        node = _add_mesh(self._api, path, mark)
        _add_line(self._api, f"{path}/ring", _ring(1.2 * size, self._lift_m), GUIDED, 3.0)
        return node

    def _draw_clouds(self, clouds: Mapping[str, Points]) -> None:
        for name in self._clouds.keys() - clouds.keys():
            self._clouds[name][1].visible = False
        for name, points in clouds.items():
            known = self._clouds.get(name)
            if known is not None:
                if bool(known[1].visible) != self.show_clouds:
                    known[1].visible = self.show_clouds
                if known[0] is points:
                    continue
            some = np.asarray(points, dtype=np.float32)[:: max(math.ceil(len(points) / MOST_POINTS), 1)]
            if known is not None and len(known[0]) and len(some):
                known[1].points = some
                self._clouds[name] = points, known[1]
            elif len(some):
                size = {"sonar": 0.25, "map": 0.06}.get(name, 0.07)
                node = self._api.add_point_cloud(
                    f"{self._path.replace('/vessels', '/clouds', 1)}/{name}",
                    some,
                    CLOUDS.get(name, OTHER_CLOUD),
                    point_size=size,
                    precision="float32",
                    point_shading="flat",
                    visible=self.show_clouds,
                )
                self._clouds[name] = points, node

    def _draw_obstacles(self, vessel: VesselInstant) -> None:
        centres, radius_m = vessel.obstacles_enu_m, vessel.obstacle_radius_m
        if len(centres) == 0 and self._obstacles is None:
            return
        drawn = centres.tobytes(), radius_m.tobytes(), vessel.obstacle_classes
        if drawn == self._obstacles_drawn:
            return
        self._obstacles_drawn = drawn
        path = self._path.replace("/vessels", "/obstacles", 1)
        self._draw_obstacle_classes(vessel)
        if len(centres) == 0:
            self._obstacles.remove()
            self._obstacles = None
            return
        post = shapes.frustum((2.0, 2.0, POST_M), sides=24)
        around = np.maximum(radius_m, 0.3)
        self._obstacles = self._api.add_batched_meshes_simple(
            path,
            post.vertices_m,
            post.faces,
            np.tile([1.0, 0.0, 0.0, 0.0], (len(centres), 1)),
            np.column_stack([centres[:, :2], np.full(len(centres), self._level_m + 0.5 * POST_M)]),
            batched_scales=np.column_stack([around, around, np.ones(len(centres))]),
            batched_colors=OBSTACLE,
            opacity=0.35,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _draw_obstacle_classes(self, vessel: VesselInstant) -> None:
        """Write the class of each obstacle above it. Labels that are not needed are hidden, and used again later."""
        path = self._path.replace("/vessels", "/obstacle classes", 1)
        classes = [(number, text) for number, text in enumerate(vessel.obstacle_classes) if text]
        while len(self._obstacle_classes) < len(classes):
            name = f"{path}/{len(self._obstacle_classes)}"
            self._obstacle_classes.append(
                self._api.add_label(name, "", anchor="bottom-center", font_screen_scale=CLASS_SCALE)
            )
        for label in self._obstacle_classes[len(classes) :]:
            label.visible = False
        for label, (number, text) in zip(self._obstacle_classes, classes, strict=False):
            east_m, north_m, _ = vessel.obstacles_enu_m[number].tolist()
            label.position = (east_m, north_m, self._level_m + POST_M)
            label.visible = True
            if label.text != text:
                label.text = text

    def draw_streams(self, place: Array, wind_en_mps: tuple[float, float], current_en_mps: tuple[float, float]) -> None:
        """Draw the arrow of the wind above this vessel, and the arrow of the current on the water next to it."""
        size = stream_size(self._vessel.length_m)
        arrow_of_wind, arrow_of_current = stream_arrows(self._vessel.length_m)
        if self._wind is None:
            path = self._path.replace("/vessels", "/streams", 1)
            unit = shapes.arrow(1.0, 1.0)
            self._wind = _add_mesh(self._api, f"{path}/wind", unit.mesh("wind", WIND, 0.95))
            self._current = _add_mesh(self._api, f"{path}/current", unit.mesh("current", CURRENT, 0.95))
        east, north = float(place[0]), float(place[1])
        above = self._level_m + max(float(place[2]) - self._level_m, 0.0)
        for node, stream, m_per_mps, offset_m in (
            (self._wind, wind_en_mps, arrow_of_wind.m_per_mps, 1.5 * size),
            (self._current, current_en_mps, arrow_of_current.m_per_mps, 0.75 * size),
        ):
            speed = math.hypot(*stream)
            shown = speed > LEAST_STREAM_MPS
            if bool(node.visible) != shown:
                node.visible = shown
            if shown:
                length = m_per_mps * speed
                node.wxyz = heading_wxyz(*stream)
                node.scale = (length, 0.22 * size, 0.22 * size)
                along = -0.5 * length / speed
                node.position = (east + along * stream[0], north + along * stream[1], above + offset_m)


def _ring(radius_m: float, up_m: float = 0.0) -> Array:
    """Return the points (49, 3) of a level circle."""
    turn = np.linspace(0.0, 2.0 * math.pi, 49)
    return np.stack([radius_m * np.cos(turn), radius_m * np.sin(turn), np.full(len(turn), up_m)], axis=-1)


def _add_mesh(api: Any, path: str, mesh: SceneMesh, position: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Any:
    return api.add_mesh_simple(
        path,
        mesh.vertices_m,
        mesh.faces,
        color=mesh.colour,
        opacity=None if mesh.opacity >= 1.0 else mesh.opacity,
        side="double",
        cast_shadow=False,
        receive_shadow=False,
        position=position,
    )


def _add_line(api: Any, path: str, points: Array, colour: Colour, thickness: float) -> Any:
    segments = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
    return api.add_line_segments(path, segments, colors=colour, thickness=thickness, thickness_units="screen")


def _place(node: Any, position: Array, attitude_wxyz: Array) -> None:
    node.position = position
    node.wxyz = attitude_wxyz
