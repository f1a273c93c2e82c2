"""Draws the world with OpenGL, on a GPU or, without one, with Mesa's software renderer. It needs no display.

    renderer = Renderer(models)
    renderer.colour(shots, lens, exposure)  ->  image without noise
    renderer.measure(view, lens, world)     ->  object, metres and temperature of each pixel

Passes of one picture: the sky by direction (when the light has changed), shadows, objects mirrored at the still
water, the shape of the water, its light, objects, sky, rain. OpenCV then bends the picture as the lens does. A second
set of passes measures object, distance and temperature of each pixel.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from importlib.resources import files
from itertools import groupby
from typing import Any

import cv2
import numpy as np
from numpy import float32, uint8, uint16
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.waves import WaveField
from sim_core.frames import Array
from sim_core.sensors.lens import Lens
from xitl_cli.errors import UserError
from xitl_cli.plugins.cameras.daylight import SUN_RADIUS_RAD, Daylight
from xitl_cli.plugins.cameras.image_sensor import ViewFace, faces_of
from xitl_cli.plugins.cameras.models import VERTEX, WATER_C, TriangleModel
from xitl_cli.plugins.cameras.rain import Rain, streaks

NEAR_M, FAR_M = 0.08, 12_000.0
MOST_COMPONENTS = 64
SHADOW_PX, SHADOW_M, SHADOW_STEP_M = 1024, 120.0, 8.0
"""Size of the shadow map, and width of the square around the camera that has shadows."""
FOAM_PX, FOAM_M, LEAST_FOAM, FEWEST_WHITECAPS = 256, 128.0, 0.01, 1e-4
SHADE_PX, SHADE_M = 512, 64.0
"""Of the map of shadows on the water around the camera."""
LEAST_SUN, LOWEST_SUN = 0.02, 0.05
"""Weakest direct light with shadows, and lowest sun with shadows on the water, as the sine of its elevation."""
RIPPLE_PX, RIPPLE_M = 512, 6.5
SKY_PX = (512, 512)
CLOUDS_S = 5.0
"""The sky is drawn anew after this time."""
NEAREST_GAP, FARTHEST_GAP, GAP_PX, NEAR_SEA_M = 0.06, 0.25, 1.5, 1500.0
"""Of the rings of the water: least and largest gap by radius, the gap that a far pixel shows, and their last radius."""
SECTOR_RAD = math.radians(2.0)
GRID = np.array([(x, y, 1.0) for x in np.linspace(-1.0, 1.0, 9) for y in np.linspace(-1.0, 1.0, 9)])
"""Rays of a view whose half has a tangent of 1."""
SAMPLERS = (
    "sky_map",
    "shadow_map",
    "components",
    "ripples",
    "mirrored",
    "foam_map",
    "surface",
    "sky_values",
    "shade_map",
)
"""Names in the programs, by texture unit."""
SCREENS = "sky map", "sky", "water", "near water"
"""Programs that fill the picture."""
CLIP_DISTANCE = 0x3000
"""GL_CLIP_DISTANCE0."""
CUBE = np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CELL_M = 25.0
"""Of the grid in which models are searched for what is in sight."""
GRAINS_M, GRAIN_OF_PX = (0.25, 0.6, 1.5), 1.0
"""Sizes of the cubes in which corners become one, far away, and the smallest of them for a pixel of 1 m."""
SEA_ID, SKY_ID = 60_000, 65_000
"""Numbers of water and sky in the pictures. Those of objects are smaller."""
SKY_C = -20.0


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """Where a picture is taken from."""

    pos_ned_m: Array
    """(3,)."""
    rot_ned_optical: Array
    """Turns optical axes (x right, y down, z ahead) into NED, (3, 3)."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedModel:
    """A model at a place."""

    model: str
    """Name under which the renderer has it."""
    pos_ned_m: Array
    rot_ned_model: Array
    """(3, 3)."""
    first_id: int
    """Number of its first object in the pictures."""


@dataclass(frozen=True, slots=True, eq=False)
class FoamTrail:
    """Foam behind a vessel: the left and right edge of a band, newest first, and the share of foam along it."""

    left_ne_m: Array
    """(P, 2)."""
    right_ne_m: Array
    share: Array
    """(P,)."""


@dataclass(frozen=True, slots=True, eq=False)
class DrawnWorld:
    """The world at one instant."""

    time_s: float
    waves: Any
    """WaveField or FlatWater of sim_core.environment.waves."""
    water_down_m: float
    """Still surface in NED."""
    wind_ne_mps: Array
    """(2,)."""
    light: Daylight
    extinction_per_m: float
    water_colour: Array
    """Diffuse reflectance, (3,)."""
    placed: Sequence[PlacedModel]
    foam: Sequence[FoamTrail] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """What is drawn for an image, or for some of its rows."""

    view: Viewpoint
    world: DrawnWorld
    rows: tuple[int, int] | None = None
    """First row and the row after the last one; None for all."""
    share: float = 1.0
    """Weight in the mean of the shots with the same rows."""
    rain: Rain | None = None


class Target:
    """Buffers for the pictures of one lens."""

    def __init__(self, context: Any, lens: Lens) -> None:
        self.lens = lens
        self.faces = faces_of(lens)
        size = self.faces[0].size_px
        depth = context.depth_renderbuffer(size)
        self.depth = context.framebuffer(depth_attachment=depth)
        picture = context.texture(size, 4)
        self.colour = context.framebuffer([picture, context.texture(size, 1, dtype="u2")], depth)
        self.picture = context.framebuffer([picture], depth)
        """Without the numbers of the objects."""
        self.shape = context.texture(size, 2, dtype="u4")
        """Of the water, see surface.frag."""
        self.shaped = context.framebuffer([self.shape], depth)
        self.measured = context.framebuffer([context.texture(size, 4, dtype="f4")], depth)
        half = max(size[0] // 2, 1), max(size[1] // 2, 1)
        self.mirrored = context.texture(half, 4)
        self.mirrored.repeat_x = self.mirrored.repeat_y = False
        self.mirror = context.framebuffer([self.mirrored], context.depth_renderbuffer(half))


def make_context() -> Any:
    """Return an OpenGL context without a window. Raises UserError without moderngl, or without EGL."""
    try:
        import moderngl
    except ImportError as error:
        raise UserError("cameras need moderngl; install it with: pip install 'xitl[camera]'") from error
    try:
        wanted: Any = {"standalone": True, "backend": "egl", "require": 430}
        return moderngl.create_context(**wanted)
    except Exception as error:
        raise UserError(
            f"cameras cannot draw: no OpenGL without a display ({error}); install EGL and a software renderer, on "
            "Debian and Ubuntu: apt install libegl1 libgl1-mesa-dri"
        ) from error


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Triangles of a model in cells of a grid, so that those out of sight are not drawn."""

    vertices: NDArray[np.void]
    """(V,) each once."""
    indices: NDArray[np.uint32]
    """(3 T,) of the triangles, cell by cell."""
    rows: NDArray[np.uint32]
    """(D, C, 5) draw command of each cell, with less detail in each row of the first axis: number of indices, 1, first
    index, 0, 0."""
    middle_m: Array
    """(C, 3) middle of the sphere around each cell."""
    radius_m: Array
    """(C,)."""

    @classmethod
    def of(cls, vertices: NDArray[np.void]) -> Cells:
        """Return the cells of (3 T,) vertices."""
        corners = vertices["position"].astype(float).reshape(-1, 3, 3)
        place = np.floor(corners.mean(axis=1)[:, :2] / CELL_M).astype(np.int64)
        _, cell = np.unique(place, axis=0, return_inverse=True)
        sorted_triangles = np.argsort(cell, kind="stable")
        firsts = np.flatnonzero(np.diff(cell[sorted_triangles], prepend=-1))
        counts = np.diff(firsts, append=len(cell))
        middle, radius = np.empty((len(firsts), 3)), np.empty(len(firsts))
        for number, (first, count) in enumerate(zip(firsts, counts, strict=True)):
            points = corners[sorted_triangles[first : first + count]].reshape(-1, 3)
            middle[number] = 0.5 * (points.min(axis=0) + points.max(axis=0))
            radius[number] = np.linalg.norm(points - middle[number], axis=1).max()
        order = (3 * sorted_triangles[:, None] + np.arange(3)).ravel()
        single, indices = np.unique(vertices[order].view(f"V{VERTEX.itemsize}"), return_inverse=True)
        single = single.view(VERTEX)
        corner = indices.reshape(-1, 3)
        cell_of = cell[sorted_triangles]
        levels, rows, kept = [corner], [], []
        begun = 0
        for grain_m in GRAINS_M:
            # Corners in one cube of this size become one corner; triangles that vanish are left out
            cube = np.floor(single["position"] / grain_m).astype(np.int64)
            key = np.column_stack([cube, single["id"].astype(np.int64)])
            _, representative, same = np.unique(key, axis=0, return_index=True, return_inverse=True)
            levels.append(representative[same.ravel()][corner])
        for level in levels:
            thick = (level[:, 0] != level[:, 1]) & (level[:, 1] != level[:, 2]) & (level[:, 2] != level[:, 0])
            counts = np.bincount(cell_of[thick], minlength=len(firsts))
            row = np.zeros((len(firsts), 5), np.uint32)
            row[:, 0], row[:, 1] = 3 * counts, 1
            row[:, 2] = 3 * (begun + np.cumsum(counts) - counts)
            rows.append(row)
            kept.append(level[thick])
            begun += len(kept[-1])
        return cls(single, np.concatenate(kept).ravel().astype(np.uint32), np.stack(rows), middle, radius)

    def commands(self, to_clip: Array, camera_m: Array, px_per_rad: float) -> NDArray[np.uint32]:
        """Return the draw commands of the cells in sight, (K, 5), with as much detail as pixels can show.

        to_clip: (4, 4), from the axes of the model. camera_m: position of the camera in these axes.
        """
        across = np.array([to_clip[3] + to_clip[0], to_clip[3] - to_clip[0], to_clip[3] + to_clip[1],
                           to_clip[3] - to_clip[1], to_clip[3] + to_clip[2], to_clip[3] - to_clip[2]])  # fmt: skip
        across = across / np.maximum(np.linalg.norm(across[:, :3], axis=1, keepdims=True), 1e-9)
        distance = self.middle_m @ across[:, :3].T + across[:, 3]
        inside = np.flatnonzero((distance > -self.radius_m[:, None]).all(axis=1))
        away_m = np.linalg.norm(self.middle_m[inside] - camera_m, axis=1) - self.radius_m[inside]
        shown_m = np.maximum(away_m, 0.0) / px_per_rad
        level = np.searchsorted(np.array(GRAINS_M), GRAIN_OF_PX * shown_m)
        rows: NDArray[np.uint32] = self.rows[level, inside]
        return rows[rows[:, 0] > 0]


@dataclass(frozen=True, slots=True, eq=False)
class LoadedModel:
    """A model in the memory of the graphics card."""

    arrays: Mapping[str, Any]
    """Vertex array by program."""
    cells: Cells
    commands: Any
    """Buffer for the draw commands of the cells in sight."""


class Renderer:
    """Draws pictures of models in one OpenGL context.

    still: names of models that never move, and so cast shadows.
    """

    def __init__(self, models: Mapping[str, TriangleModel], still: Collection[str] = ()) -> None:
        context = self._context = make_context()
        self.device = str(context.info["GL_RENDERER"])
        """Name of the renderer, such as `llvmpipe (LLVM 15.0.6, 256 bits)`."""
        self._models: dict[str, LoadedModel] = {}
        self._programs = {
            name: self._program(vertex, fragment, *defined)
            for name, vertex, fragment, *defined in (
                ("sky map", "screen.vert", "sky_map.frag", "SCREEN"),
                ("sky", "screen.vert", "sky.frag", "SCREEN"),
                ("model", "model.vert", "model.frag"),
                ("mirrored model", "model.vert", "model.frag", "MIRRORED"),
                ("shadow", "model.vert", "shadow.frag"),
                ("model truth", "model.vert", "truth.frag"),
                ("water shape", "water.vert", "surface.frag"),
                ("water", "screen.vert", "water.frag", "SCREEN"),
                ("near water", "screen.vert", "water.frag", "SCREEN", "NEAR"),
                ("water truth", "water.vert", "truth.frag"),
                ("foam", "foam.vert", "foam.frag"),
                ("shade", "model.vert", "shade.frag"),
                ("rain", "rain.vert", "rain.frag"),
            )
        }
        self._uniforms = {name: {key: program[key] for key in program} for name, program in self._programs.items()}
        self._light = context.buffer(reserve=8 * 16)
        self._light.bind_to_uniform_block(0)
        self._screens = {name: context.vertex_array(self._programs[name], []) for name in SCREENS}
        self._sky_map = context.texture(SKY_PX, 4)
        self._sky_map.repeat_x = self._sky_map.repeat_y = False
        self._sky_values = context.texture(SKY_PX, 4)
        self._sky_values.repeat_x = self._sky_values.repeat_y = False
        self._sky_frame = context.framebuffer([self._sky_map, self._sky_values])
        self._sky_of: tuple[float, ...] = ()
        self._still = frozenset(still)
        self._shadow_of: tuple[float, ...] = ()
        self._to_shadow = np.eye(4)
        self._shadow_map = context.depth_texture((SHADOW_PX, SHADOW_PX))
        self._shadow_map.compare_func = "<="
        self._shadow_map.repeat_x = self._shadow_map.repeat_y = False
        self._shadow_frame = context.framebuffer(depth_attachment=self._shadow_map)
        self._components = context.texture((MOST_COMPONENTS, 1), 4, dtype="f4")
        self._components.filter = (context.NEAREST, context.NEAREST)
        self._ripples = context.texture((RIPPLE_PX, RIPPLE_PX), 4, _ripples(default_rng(1)).tobytes())
        self._ripples.build_mipmaps()
        self._ripples.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
        self._foam = context.texture((FOAM_PX, FOAM_PX), 1, dtype="f1")
        self._foam.repeat_x = self._foam.repeat_y = False
        self._foam_frame = context.framebuffer([self._foam])
        self._shade = context.texture((SHADE_PX, SHADE_PX), 1)
        self._shade.repeat_x = self._shade.repeat_y = False
        self._shade_frame = context.framebuffer([self._shade])
        self._targets: dict[Lens, Target] = {}
        for name, model in models.items():
            self.add(name, model)

    def add(self, name: str, model: TriangleModel) -> None:
        """Add a model, or replace it."""
        with self._context:
            self._load(name, model)

    def _load(self, name: str, model: TriangleModel) -> None:
        cells = Cells.of(model.vertices)
        buffer = self._context.buffer(cells.vertices.tobytes() or bytes(VERTEX.itemsize))
        indices = self._context.buffer(cells.indices.tobytes() or bytes(4))
        layout = (buffer, "3f 3f 4f 1f 1f", "in_position", "in_normal", "in_colour", "in_id", "in_temperature")
        arrays = {
            program: self._context.vertex_array(
                self._programs[program], [_used(layout, self._programs[program])], indices, index_element_size=4
            )
            for program in ("model", "mirrored model", "shadow", "shade", "model truth")
        }
        self._models[name] = LoadedModel(arrays, cells, self._context.buffer(reserve=max(cells.rows[0].nbytes, 20)))

    def close(self) -> None:
        """Release the context."""
        self._context.__enter__()  # releasing needs it, and no context is left afterwards
        self._context.release()

    # Pictures

    def colour(self, shots: Sequence[Shot], lens: Lens, exposure: float) -> NDArray[uint8]:
        """Return an image, (H, W, 3), sRGB: the mean of the shots of each row."""
        with self._context:  # several renderers may exist
            return self._image(shots, lens, exposure)

    def _image(self, shots: Sequence[Shot], lens: Lens, exposure: float) -> NDArray[uint8]:
        target = self._target(lens)
        image = np.zeros((lens.height_px, lens.width_px, 3), uint8)
        for rows, group in groupby(shots, lambda shot: shot.rows or (0, lens.height_px)):
            together = list(group)
            for face in target.faces:
                drawn_rows = rows if face.pixels is None else (0, face.size_px[1])
                pictures = (self._draw(target, face, shot, drawn_rows, exposure) for shot in together)
                face.seen(_mean(pictures, [shot.share for shot in together]), rows, image)
        return image

    def _draw(
        self, target: Target, face: ViewFace, shot: Shot, rows: tuple[int, int], exposure: float
    ) -> NDArray[uint8]:
        """Return some rows of a face at one instant, (R, w, 3)."""
        context, view, world, width = self._context, shot.view, shot.world, face.size_px[0]
        self._set_light(world, exposure)
        self._draw_sky_map(world, exposure)
        self._set_sea(view, world)
        self._ripples.use(3)
        self._draw_shadows(view, world)
        rotation = view.rot_ned_optical @ face.rot_optical_face
        to_clip = _projection(face.tangent) @ _homogeneous(rotation.T)
        near = self._draw_near_water(view, world, to_clip)
        self._draw_mirrored(target, to_clip, view, world)
        place = 0, rows[0], width, rows[1] - rows[0]
        target.depth.clear(depth=1.0)  # the other buffers are written where they are read
        target.shaped.scissor = place
        target.shaped.use()
        context.enable_only(context.DEPTH_TEST)
        self._draw_water("water shape", to_clip, rotation, face, view, world)
        frame = target.colour
        frame.scissor = place
        # The light of the water, where its shape is nearer than the screen, which is as far away as possible
        frame.depth_mask = False
        frame.use()
        context.depth_func = ">"
        target.shape.use(6)
        self._draw_screen("near water" if near else "water", rotation, face)
        frame.depth_mask = True
        frame.use()
        context.depth_func = "<"
        self._draw_models("model", to_clip, view, world.placed, px_per_rad=target.lens.focal_px)
        context.depth_func = "<="
        self._draw_screen("sky", rotation, face)
        context.depth_func = "<"
        if shot.rain is not None:
            self._draw_rain(target, place, face, rotation, shot.rain, world)
        target.shaped.scissor = frame.scissor = None
        raw = np.frombuffer(frame.read(place, components=4), uint8)  # three components take longer
        return np.asarray(cv2.cvtColor(raw.reshape(rows[1] - rows[0], width, 4), cv2.COLOR_RGBA2RGB), uint8)

    def numbers(self, lens: Lens) -> NDArray[uint16] | None:
        """Return the numbers of the objects in the latest image, of one shot, (H, W); None for a lens of many faces."""
        target = self._target(lens)
        if len(target.faces) > 1:
            return None
        (face,) = target.faces
        with self._context:
            raw = np.frombuffer(target.colour.read(components=1, attachment=1, dtype="u2", alignment=1), uint16)
        drawn = raw.reshape(face.size_px[1], face.size_px[0])
        if face.pixels is None:
            return drawn
        result = np.full((lens.height_px, lens.width_px), SKY_ID, uint16)
        result[face.pixels.here] = drawn[face.pixels.nearest]
        return result

    def measure(self, view: Viewpoint, lens: Lens, world: DrawnWorld) -> NDArray[float32]:
        """Return number of the object, metres along the optical axis and °C of each pixel, (H, W, 3)."""
        with self._context:
            return self._measured(view, lens, world)

    def _measured(self, view: Viewpoint, lens: Lens, world: DrawnWorld) -> NDArray[float32]:
        context, target = self._context, self._target(lens)
        self._set_light(world, 1.0)
        self._set_sea(view, world)
        result = np.empty((lens.height_px, lens.width_px, 3), float32)
        result[:] = SKY_ID, np.inf, SKY_C  # where the lens has no image
        for face in target.faces:
            rotation = view.rot_ned_optical @ face.rot_optical_face
            to_clip = _projection(face.tangent) @ _homogeneous(rotation.T)
            target.measured.use()
            target.measured.clear(SKY_ID, np.inf, SKY_C, 0.0, depth=1.0)
            context.enable_only(context.DEPTH_TEST)
            self._draw_models("model truth", to_clip, view, world.placed)
            self._draw_water("water truth", to_clip, rotation, face, view, world)
            raw = np.frombuffer(target.measured.read(components=4, dtype="f4"), float32)
            measured = raw.reshape(face.size_px[1], face.size_px[0], 4)[..., :3]
            if face.pixels is None:
                return measured.copy()
            seen = measured[face.pixels.nearest]
            seen[:, 1] *= face.pixels.depth
            result[face.pixels.here] = seen
        return result

    # Parts

    def _program(self, vertex: str, fragment: str, *defined: str) -> Any:
        folder = files(__package__) / "shaders"
        common = (folder / "common.glsl").read_text()
        sources = []
        for file in (vertex, fragment):
            names = [name for name in defined if name != "SCREEN" or file == fragment]
            lines = "#version 330", f"#define TILE_M {RIPPLE_M}", *(f"#define {name}" for name in names), common
            sources.append("\n".join(lines) + (folder / file).read_text())
        program = self._context.program(vertex_shader=sources[0], fragment_shader=sources[1])
        if "Light" in program:
            program["Light"].binding = 0
        for unit, sampler in enumerate(SAMPLERS):
            if sampler in program:
                program[sampler].value = unit
        return program

    def _write(self, program: str, **values: Any) -> None:
        """Set the uniforms that a program has; matrices are given row by row."""
        uniforms = self._uniforms[program]
        for name, value in values.items():
            if name in uniforms:
                array = np.asarray(value)
                if array.ndim == 2:
                    uniforms[name].write(np.ascontiguousarray(array.T, dtype=float32).tobytes())
                else:
                    uniforms[name].value = tuple(array.tolist()) if array.ndim else array.item()

    def _target(self, lens: Lens) -> Target:
        if lens not in self._targets:
            self._targets[lens] = Target(self._context, lens)
        return self._targets[lens]

    def _set_light(self, world: DrawnWorld, exposure: float) -> None:
        light, wind = world.light, float(np.hypot(*world.wind_ne_mps))
        sea_light = light.sky + light.sun * max(-float(light.sun_ned[2]), 0.0)
        from_water = world.water_colour * sea_light
        disc = math.exp(-400.0 * world.extinction_per_m) if light.sun[0] > 1e-3 else 0.0
        variance = _unresolved_variance(world, wind)
        whitecaps = 3.84e-6 * wind**3.41  # share of the sea (Monahan and O'Muircheartaigh 1980)
        crests = [1.0 - 3.0 * whitecaps, 1.0 / (1.5 * whitecaps)] if whitecaps > FEWEST_WHITECAPS else [2.0, 1.0]
        values = np.array(
            [
                [*light.sun_ned, math.cos(SUN_RADIUS_RAD)],
                [*light.sun, disc],
                [*light.sky, world.extinction_per_m],
                [*(from_water + 0.06 * light.sky), exposure],
                [*light.horizon, _clouds_s(world)],
                [*from_water, variance],
                [*(0.75 * sea_light), math.sqrt(0.5 * variance)],
                [1.0 / (0.1 + 0.02 * wind), *crests, 4.0 / exposure],
            ],
            dtype=float32,
        )
        self._light.write(values.tobytes())

    def _draw_sky_map(self, world: DrawnWorld, exposure: float) -> None:
        light = world.light
        wanted = exposure, *light.sun_ned.tolist(), light.clouds, world.extinction_per_m, _clouds_s(world)
        if wanted != self._sky_of:
            self._sky_of = wanted
            self._sky_frame.use()
            self._context.enable_only(self._context.NOTHING)
            self._write(
                "sky map",
                zenith=[*light.zenith, light.clouds],
                glow=[*light.glow, light.stars],
                cloud_light=light.cloud,
            )
            self._screens["sky map"].render(vertices=3)
        self._sky_map.use(0)
        self._sky_values.use(7)

    def _set_sea(self, view: Viewpoint, world: DrawnWorld) -> None:
        """Load the components with their phases at the camera, those with the most height first."""
        rows = np.zeros((MOST_COMPONENTS, 4), float32)
        count = 0
        waves = world.waves
        if isinstance(waves, WaveField):
            order = np.argsort(-waves.amplitude_m)[:MOST_COMPONENTS]
            count = len(order)
            phase = np.remainder(waves.phase_at(world.time_s, view.pos_ned_m[:2])[order], 2.0 * np.pi)
            rows[:count, :2], rows[:count, 2] = waves.wave_vector_radpm[order], phase
            rows[:count, 3] = waves.amplitude_m[order]
        self._components.write(rows.tobytes())
        self._components.use(2)
        wind = float(np.hypot(*world.wind_ne_mps))
        toward = world.wind_ne_mps / wind if wind > 0.0 else np.zeros(2)
        for program in ("water", "near water", "water shape", "water truth"):
            self._write(
                program,
                count=count,
                water_at=[0.0, 0.0, world.water_down_m - view.pos_ned_m[2]],
                ripples_at=np.remainder(view.pos_ned_m[:2] - 0.25 * toward * world.time_s, RIPPLE_M),
                water_id=float(SEA_ID),
                water_temperature=WATER_C,
            )

    def _draw_shadows(self, view: Viewpoint, world: DrawnWorld) -> None:
        """Draw the depth of what does not move as the sun sees it, around the camera.

        It is drawn again when the camera has moved by `SHADOW_STEP_M`, or the sun by a tenth of a degree.
        """
        sun = world.light.sun_ned
        middle_m = np.round(view.pos_ned_m / SHADOW_STEP_M) * SHADOW_STEP_M
        wanted = (*middle_m.tolist(), *np.round(sun, 3).tolist())
        self._shadow_map.use(1)
        if wanted == self._shadow_of:
            to_map = self._to_shadow.copy()
            to_map[:3, 3] += to_map[:3, :3] @ (view.pos_ned_m - middle_m)
            for program in ("model", "mirrored model"):
                self._write(program, to_shadow=to_map)
            return
        self._shadow_of = wanted
        across = np.cross(sun, [0.0, 0.0, 1.0])
        across = across / np.linalg.norm(across) if np.linalg.norm(across) > 1e-6 else np.array([1.0, 0.0, 0.0])
        axes = np.array([across, np.cross(sun, across), -sun])
        half = 0.5 * SHADOW_M
        to_shadow = np.eye(4)
        to_shadow[:3, :3] = axes / np.array([[half], [half], [2.0 * half]])
        self._shadow_frame.use()
        self._shadow_frame.clear(depth=1.0)
        if float(world.light.sun.max()) > LEAST_SUN:
            self._context.enable_only(self._context.DEPTH_TEST)
            still = [placed for placed in world.placed if placed.model in self._still]
            self._draw_models("shadow", to_shadow, Viewpoint(middle_m, view.rot_ned_optical), still)
        self._to_shadow = to_shadow.copy()
        self._to_shadow[2] *= 0.5
        self._to_shadow[2, 3] += 0.5
        self._draw_shadows(view, world)

    def _draw_near_water(self, view: Viewpoint, world: DrawnWorld, to_clip: Array) -> bool:
        """Draw the maps of foam and of shadows on the water. Return whether the picture may show some."""
        trails = [trail for trail in world.foam if _foam_in_sight(trail, view, world, to_clip)]
        casting = [placed for placed in world.placed if self._shadow_in_sight(placed, view, world, to_clip)]
        if not trails and not casting:
            return False
        self._draw_foam(trails, view)
        self._shade_frame.use()
        self._shade_frame.clear()
        if casting:  # on the still surface
            to_map = np.diag([2.0 / SHADE_M, 2.0 / SHADE_M, 0.0, 1.0]) @ _along_sun(view, world)
            self._context.enable_only(self._context.NOTHING)
            self._context.enable_direct(CLIP_DISTANCE)
            self._draw_models("shade", to_map, view, casting, _above_water(view, world, 0.0))
            self._context.disable_direct(CLIP_DISTANCE)
        self._shade.use(8)
        self._write("near water", shade_frame=[-0.5 * SHADE_M, -0.5 * SHADE_M, SHADE_M])
        return True

    def _draw_foam(self, trails: Sequence[FoamTrail], view: Viewpoint) -> None:
        self._foam_frame.use()
        self._foam_frame.clear()
        self._context.enable_only(self._context.BLEND)
        self._context.blend_func = self._context.ONE, self._context.ONE
        corner = [-0.5 * FOAM_M, -0.5 * FOAM_M, FOAM_M]
        self._write("foam", foam_frame=corner)
        for trail in trails:
            rows = np.empty((2 * len(trail.share), 3), float32)
            rows[0::2, :2], rows[1::2, :2] = trail.left_ne_m - view.pos_ned_m[:2], trail.right_ne_m - view.pos_ned_m[:2]
            rows[:, 2] = np.repeat(trail.share, 2)
            buffer = self._context.buffer(rows.tobytes())
            strip = self._context.vertex_array(self._programs["foam"], [(buffer, "2f 1f", "in_place", "in_share")])
            strip.render(self._context.TRIANGLE_STRIP)
            strip.release()
            buffer.release()
        self._foam.use(5)
        self._write("near water", foam_frame=corner)  # the edges of the maps are empty, so that there is none beyond

    def _shadow_in_sight(self, placed: PlacedModel, view: Viewpoint, world: DrawnWorld, to_clip: Array) -> bool:
        """Whether the picture may show the shadow of a moving model on the water."""
        sun = world.light.sun_ned
        if placed.model in self._still or world.light.sun.max() <= LEAST_SUN or -sun[2] <= LOWEST_SUN:
            return False
        cells = self._models[placed.model].cells
        if not len(cells.radius_m):
            return False
        offsets = cells.radius_m[:, None, None] * CUBE
        corners = (cells.middle_m[:, None] + offsets).reshape(-1, 3) @ placed.rot_ned_model.T
        corners = np.column_stack([corners + placed.pos_ned_m - view.pos_ned_m, np.ones(len(corners))])
        shadow = corners @ _along_sun(view, world).T
        near = bool((np.abs(shadow[:, :2]) < 0.5 * SHADE_M).all(axis=1).any())
        return near and _in_sight(shadow, to_clip)

    def _draw_mirrored(self, target: Target, to_clip: Array, view: Viewpoint, world: DrawnWorld) -> None:
        flip = np.diag([1.0, 1.0, -1.0, 1.0])
        flip[2, 3] = 2.0 * (world.water_down_m - view.pos_ned_m[2])
        target.mirror.use()
        target.mirror.clear()
        self._context.enable_only(self._context.DEPTH_TEST)
        self._context.enable_direct(CLIP_DISTANCE)
        above = _above_water(view, world, 0.02)
        self._draw_models("mirrored model", to_clip @ flip, view, world.placed, above, target.lens.focal_px / 4.0)
        self._context.disable_direct(CLIP_DISTANCE)
        target.mirrored.use(4)

    def _draw_models(
        self,
        program: str,
        to_clip: Array,
        view: Viewpoint,
        drawn: Sequence[PlacedModel],
        keep: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0),
        px_per_rad: float = math.inf,
    ) -> None:
        """Draw models. px_per_rad: resolution of the picture, for the detail of what is far away; inf: all detail."""
        self._write(program, to_clip=to_clip, keep=keep)
        for placed in drawn:
            loaded, at_m = self._models[placed.model], placed.pos_ned_m - view.pos_ned_m
            placement = np.eye(4)
            placement[:3, :3], placement[:3, 3] = placed.rot_ned_model, at_m
            rows = loaded.cells.commands(to_clip @ placement, -at_m @ placed.rot_ned_model, px_per_rad)
            if len(rows):
                self._write(program, rot_ned_model=placed.rot_ned_model, model_at=at_m, first_id=float(placed.first_id))
                loaded.commands.write(rows.tobytes())
                loaded.arrays[program].render_indirect(loaded.commands, count=len(rows))

    def _draw_water(
        self, program: str, to_clip: Array, rotation: Array, face: ViewFace, view: Viewpoint, world: DrawnWorld
    ) -> None:
        """Draw a fan of rings over the directions that the face sees."""
        height_m = world.water_down_m - view.pos_ned_m[2]
        crest_m = float(np.sum(world.waves.amplitude_m)) if isinstance(world.waves, WaveField) else 0.0
        vertices, indices = fan(rotation, face, abs(height_m), crest_m)
        self._write(program, to_clip=to_clip)
        points, order = self._context.buffer(vertices.tobytes()), self._context.buffer(indices.tobytes())
        layout = (points, "2f 2f", "in_bearing", "in_ring")
        water = self._context.vertex_array(self._programs[program], [layout], order, index_element_size=4)
        water.render(self._context.TRIANGLES)
        for used in (water, points, order):
            used.release()

    def _draw_rain(
        self,
        target: Target,
        place: tuple[int, int, int, int],
        face: ViewFace,
        rotation: Array,
        rain: Rain,
        world: DrawnWorld,
    ) -> None:
        """Draw drops in front of what is drawn, in a part of the picture."""
        corners = streaks(rain, world.wind_ne_mps, rotation, face.size_px, face.tangent)
        if not len(corners):
            return
        order = (4 * np.arange(len(corners))[:, None] + [0, 1, 2, 1, 3, 2]).astype(np.uint32)
        buffer, indices = self._context.buffer(corners.tobytes()), self._context.buffer(order.tobytes())
        layout = (buffer, "3f 4f", "in_place", "in_streak")
        drops = self._context.vertex_array(self._programs["rain"], [layout], indices, index_element_size=4)
        projection = _projection(face.tangent)
        self._write("rain", to_depth=projection[2, 2:])
        target.picture.scissor, target.picture.depth_mask = place, False
        target.picture.use()
        self._context.enable_only(self._context.DEPTH_TEST | self._context.BLEND)
        self._context.blend_func = self._context.SRC_ALPHA, self._context.ONE_MINUS_SRC_ALPHA
        drops.render(self._context.TRIANGLES)
        for used in (drops, buffer, indices):
            used.release()

    def _draw_screen(self, program: str, rotation: Array, face: ViewFace) -> None:
        """Draw all pixels of a face that the depth test permits."""
        self._write(program, rot_ned_view=rotation, tangent=face.tangent)
        self._screens[program].render(vertices=3)


def _clouds_s(world: DrawnWorld) -> float:
    """Return the time of the drawn clouds, which is the same whichever images were drawn before."""
    return CLOUDS_S * math.floor(world.time_s / CLOUDS_S)


def _mean(pictures: Iterable[NDArray[uint8]], shares: Sequence[float]) -> NDArray[uint8]:
    """Return the weighted mean of the light of pictures; the square of a value is nearly its light."""
    if len(shares) == 1:
        return next(iter(pictures))
    light = sum(share * picture.astype(float32) ** 2 for share, picture in zip(shares, pictures, strict=True))
    return np.rint(np.sqrt(light)).astype(uint8)


def _used(layout: tuple[Any, ...], program: Any) -> tuple[Any, ...]:
    """Return a layout without the attributes that a program does not use."""
    buffer, formats, *names = layout
    parts = formats.split()
    kept = [
        (part if name in program else f"{4 * int(part[:-1])}x", name if name in program else None)
        for part, name in zip(parts, names, strict=True)
    ]
    return buffer, " ".join(part for part, _ in kept), *(name for _, name in kept if name is not None)


def _foam_in_sight(trail: FoamTrail, view: Viewpoint, world: DrawnWorld, to_clip: Array) -> bool:
    """Whether a picture may show foam: some of its ends are not all beyond one side of the picture."""
    seen = trail.share > LEAST_FOAM
    ends = np.concatenate([trail.left_ne_m[seen], trail.right_ne_m[seen]]) - view.pos_ned_m[:2]
    if not len(ends):
        return False
    down = np.full((len(ends), 1), world.water_down_m - view.pos_ned_m[2])
    return _in_sight(np.hstack([ends, down, np.ones_like(down)]), to_clip)


def _in_sight(points: Array, to_clip: Array) -> bool:
    """Whether points (P, 4) are not all beyond one side of the picture."""
    x, y, _, w = to_clip @ points.T
    return not any(side.all() for side in (x > w, x < -w, y > w, y < -w))


def _along_sun(view: Viewpoint, world: DrawnWorld) -> Array:
    """Return the (4, 4) matrix that moves points, relative to the camera, along the sun to the still water."""
    matrix = np.eye(4)
    matrix[2, 2] = 0.0
    matrix[2, 3] = still_m = world.water_down_m - view.pos_ned_m[2]
    slope = world.light.sun_ned[:2] / world.light.sun_ned[2]
    matrix[:2, 2], matrix[:2, 3] = -slope, slope * still_m
    return matrix


def _above_water(view: Viewpoint, world: DrawnWorld, margin_m: float) -> tuple[float, float, float, float]:
    """Return the plane, relative to the camera, with what is above the still water, or less than a margin below it."""
    return 0.0, 0.0, -1.0, float(world.water_down_m - view.pos_ned_m[2]) + margin_m


def _projection(tangent: tuple[float, float]) -> Array:
    """Return the (4, 4) projection of optical axes. The first row of the image is the first row of the buffer."""
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = 1.0 / tangent[0], 1.0 / tangent[1]
    matrix[2, 2] = (FAR_M + NEAR_M) / (FAR_M - NEAR_M)
    matrix[2, 3] = -2.0 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
    matrix[3, 2] = 1.0
    return matrix


def _homogeneous(rotation: Array) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


def fan(
    rot_ned_face: Array, face: ViewFace, height_m: float, crest_m: float
) -> tuple[NDArray[float32], NDArray[np.uint32]]:
    """Return vertices (V, 4) and indices of rings about the camera: unit bearing, radius, distance to the next ring.

    It covers the directions that a face sees, for water up to `crest_m` above and below its still surface.
    """
    rays = GRID * [*face.tangent, 1.0] @ rot_ned_face.T
    forward = rot_ned_face[:, 2]
    half_view = math.atan(math.hypot(*face.tangent))
    tilt = abs(math.asin(float(np.clip(forward[2], -1.0, 1.0))))
    slopes = rays[:, 2] / np.maximum(np.hypot(rays[:, 0], rays[:, 1]), 1e-9)
    far_m = 0.9 * FAR_M if slopes.min() <= 0.0 else 1.1 * (height_m + crest_m) / float(slopes.min())
    if tilt + half_view > 0.45 * math.pi:
        near_m, first, last = 0.0, -math.pi, math.pi
    else:
        near_m = 0.9 * max(height_m - crest_m, 0.0) / max(float(slopes.max()), 1e-3)
        middle = math.atan2(forward[1], forward[0])
        offsets = np.angle(np.exp(1j * (np.arctan2(rays[:, 1], rays[:, 0]) - middle)))
        first, last = middle + offsets.min() - 0.05, middle + offsets.max() + 0.05
    radius, fine = _rings(near_m, far_m, height_m, 0.5 * face.size_px[0] / face.tangent[0])
    pairs = max(math.ceil(0.5 * (last - first) / SECTOR_RAD), 4)
    bearing = np.linspace(first, last, 2 * pairs + 1)
    gap = np.diff(radius, append=radius[-1] * 1.1)
    place = np.empty((len(radius), len(bearing), 4), float32)
    place[..., 0], place[..., 1] = np.cos(bearing), np.sin(bearing)
    place[..., 2], place[..., 3] = radius[:, None], gap[:, None]
    # Far rings have half as many sectors; one row of triangles joins them to the near rings.
    vertices = np.concatenate([place[:fine].reshape(-1, 4), place[fine:, ::2].reshape(-1, 4)])
    begun, row = fine * len(bearing), np.arange(pairs)
    last_near = begun - len(bearing) + 2 * row
    near_outer = begun + row
    joint = [
        (last_near, last_near + 1, near_outer),
        (last_near + 1, near_outer + 1, near_outer),
        (last_near + 1, last_near + 2, near_outer + 1),
    ]
    triangles = [
        _quads(0, fine, len(bearing)),
        *(np.column_stack(three) for three in joint),
        _quads(begun, len(radius) - fine, pairs + 1),
    ]
    return vertices, np.concatenate(triangles).ravel().astype(np.uint32)


def _rings(near_m: float, far_m: float, height_m: float, px_per_rad: float) -> tuple[Array, int]:
    """Return the radii of rings, and how many of them are so near that a pixel separates them well.

    Near gaps are in proportion to the radius, farther ones to its square, as pixels see it, the farthest again to the
    radius.
    """
    start_m, end_m = max(near_m, 0.15 * height_m, 0.05), min(far_m, NEAR_SEA_M)
    turns_m = np.array([NEAREST_GAP, FARTHEST_GAP]) * px_per_rad * max(height_m, 0.05) / GAP_PX
    near_end_m, middle_end_m = np.clip(turns_m, start_m, max(start_m, end_m)).tolist()
    near = np.geomspace(start_m, near_end_m, _count(math.log(near_end_m / start_m), math.log1p(NEAREST_GAP)))
    inverse = 1.0 / near_end_m, 1.0 / middle_end_m
    middle = 1.0 / np.linspace(*inverse, _count(inverse[0] - inverse[1], NEAREST_GAP / turns_m[0]))
    end_m = max(end_m, middle_end_m)
    far = np.geomspace(middle_end_m, end_m, _count(math.log(end_m / middle_end_m), math.log1p(FARTHEST_GAP)))
    first = [] if near_m > 0.0 else [0.0]
    last = [2.0 * end_m, max(0.9 * FAR_M, 3.0 * end_m)] if far_m > NEAR_SEA_M else [1.2 * end_m]
    return np.concatenate([first, near, middle[1:], far[1:], last]), len(first) + len(near)


def _count(length: float, step: float) -> int:
    """Return how many points divide a length into steps."""
    return math.ceil(length / step) + 1


def _quads(begun: int, rings: int, across: int) -> NDArray[np.intp]:
    """Return the triangles between rings of so many vertices, (T, 3) indices. Neighbours follow each other."""
    low = (begun + np.arange(rings - 1)[:, None] * across + np.arange(across - 1)).ravel()
    return np.column_stack([low, low + 1, low + across, low + 1, low + across + 1, low + across]).reshape(-1, 3)


def _unresolved_variance(world: DrawnWorld, wind_mps: float) -> float:
    """Return the variance of the slopes of the waves that are too short to be components.

    Cox and Munk 1954: the mean square slope of a sea is 0.003 + 0.00512 times the wind at 12.5 m.
    """
    total = 0.003 + 0.00512 * wind_mps
    if isinstance(world.waves, WaveField):
        waves = world.waves
        total -= 0.5 * float(np.sum((waves.amplitude_m * np.hypot(*waves.wave_vector_radpm.T)) ** 2))
    return max(total, 0.002)


def _ripples(rng: Generator) -> NDArray[uint8]:
    """Return a periodic pattern (R, R, 4): slopes of unit variance and a noise, as the shader of water decodes them."""
    number = np.fft.fftfreq(RIPPLE_PX, 1.0 / RIPPLE_PX)
    across, along = np.meshgrid(number, number)
    length = np.hypot(across, along)
    with np.errstate(divide="ignore"):
        amplitude = np.where((length > 2.5) & (length < 120.0), length**-2.1, 0.0)
    spectrum = amplitude * np.exp(2j * math.pi * rng.uniform(size=amplitude.shape))
    slopes = [np.fft.ifft2(1j * part * spectrum).real for part in (along, across)]
    blotches = np.where((length > 2.5) & (length < 120.0), np.maximum(length, 1.0) ** -1.1, 0.0)
    noise = np.fft.ifft2(blotches * np.exp(2j * math.pi * rng.uniform(size=amplitude.shape))).real
    noise = 0.5 + 0.17 * noise / noise.std()
    slopes = [(4.0 + slope / slope.std()) / 8.0 for slope in slopes]
    return np.clip(np.rint(255.0 * np.stack([*slopes, noise, noise], axis=-1)), 0, 255).astype(uint8)
