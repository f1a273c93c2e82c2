"""The data that a view draws: one scene, then instants of it. Live runs and recordings both produce them.

Positions are in metres, east, north, up in the map. Attitudes are quaternions (w, x, y, z) from the body's FLU axes to
ENU. Unknown values are None. Unknown numbers are NaN.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.tide import NO_TIDE, Tide
from xitl_cli.logs.charts.chart import Chart

Array = NDArray[np.float64]
Points = NDArray[np.float32]
Faces = NDArray[np.uint32]
Colour = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class SceneMesh:
    """Triangles of one colour."""

    name: str
    vertices_m: Points
    """(V, 3), in the map. Meshes of a vessel or body are in its FLU axes."""
    faces: Faces
    """(F, 3), indices of vertices."""
    colour: Colour
    opacity: float = 1.0


@dataclass(frozen=True, slots=True)
class SceneThruster:
    """A propeller of a vessel."""

    place_flu_m: tuple[float, float, float]
    axis_flu: tuple[float, float, float]
    """Direction of positive thrust."""
    diameter_m: float
    motor: int
    """Index of its motor command."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneVessel:
    """A vessel and its mission."""

    meshes: tuple[SceneMesh, ...]
    """Hulls and their fittings, without the thrusters."""
    thrusters: tuple[SceneThruster, ...] = ()
    length_m: float = 2.0
    mission_enu_m: Array = field(default_factory=lambda: np.empty((0, 3)))
    """(W, 3), the start first."""
    acceptance_radius_m: float = 0.0
    """Distance at which a waypoint counts as reached; 0 if unknown."""
    wdri: float | None = None
    """WDRI of its profile's graph, None without one."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneWaves:
    """Components of the sea: elevation = sum of amplitude cos(k . x - omega t + phase)."""

    amplitude_m: Array
    """(C,)."""
    wave_vector_en_radpm: Array
    """(C, 2), east and north."""
    angular_frequency_radps: Array
    """(C,), at a fixed place."""
    phase_rad: Array
    """(C,)."""

    def elevation_m(self, time_s: float, places_en_m: Array) -> Array:
        """Return the elevation (...,) above the still level at places (..., 2)."""
        phase = places_en_m @ self.wave_vector_en_radpm.T - self.angular_frequency_radps * time_s + self.phase_rad
        return np.asarray(np.cos(phase) @ self.amplitude_m)


@dataclass(frozen=True, slots=True, eq=False)
class SceneWater:
    """The water surface."""

    level_m: float = 0.0
    """Mean level of the still water."""
    centre_en_m: tuple[float, float] = (0.0, 0.0)
    """Centre of the area of interest."""
    waves: SceneWaves | None = None
    """None if the waves are unknown or the water is flat."""
    bounded: bool = False
    """True if land bounds the water."""
    tide: Tide = NO_TIDE
    colour: Colour | None = None
    """None for the usual colour."""

    def level_at_m(self, time_s: float) -> float:
        """Return the level of the still water at a time."""
        return self.level_m + self.tide.height_m(time_s)


@dataclass(frozen=True, slots=True, eq=False)
class ViewScene:
    """The constant part of a view."""

    title: str
    meshes: tuple[SceneMesh, ...] = ()
    """Surroundings."""
    vessels: Mapping[str, SceneVessel] = field(default_factory=dict)
    """By name. A single vessel has the name ""."""
    water: SceneWater = field(default_factory=SceneWater)
    notes: tuple[str, ...] = ()
    """Messages to the user about parts that the view cannot draw."""
    chart: Chart | None = None
    """Chart on the water."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewImage:
    """An image of a camera."""

    time_s: float
    data: bytes
    """JPEG or PNG; float32 in metres, row by row, of a depth image."""
    size_px: tuple[int, int] | None = None
    """Width and height of a depth image, None for a file."""


@dataclass(frozen=True, slots=True, eq=False)
class VesselInstant:
    """A vessel at an instant."""

    position_enu_m: Array
    attitude_wxyz: Array
    estimate_position_enu_m: Array | None = None
    estimate_attitude_wxyz: Array | None = None
    motors: tuple[float, ...] = ()
    """Commands, -1 to 1."""
    mode: str = ""
    armed: bool = False
    waypoints_reached: int = 0
    waypoints_total: int = 0
    mission_enu_m: Array | None = None
    """(W, 3), the start first; None for the mission of the `SceneVessel`."""
    target_enu_m: Array | None = None
    """Waypoint that the vessel heads for."""
    clouds: Mapping[str, Points] = field(default_factory=dict)
    """Points (P, 3) in the map by sensor: `lidar`, `sonar`, `map`."""
    obstacles_enu_m: Array = field(default_factory=lambda: np.empty((0, 3)))
    """(O, 3), centres of the obstacles that the companion tracks."""
    obstacle_radius_m: Array = field(default_factory=lambda: np.empty(0))
    """(O,), radii of these obstacles."""
    numbers: Mapping[str, float] = field(default_factory=dict)
    """Values of the panel by their label, which includes the unit."""
    guided_enu_m: Array | None = None
    """Target in GUIDED."""
    images: Mapping[str, ViewImage] = field(default_factory=dict)
    """Images of a live view since the previous instant, by camera."""
    obstacle_classes: tuple[str, ...] = ()
    """`obstacle_class` of each obstacle; empty without a companion that fuses cameras."""


def obstacle_class(label: str, share: float) -> str:
    """Return the text for the class of an obstacle and its share of the evidence; empty without a class."""
    return f"{label} {100.0 * share:.0f} %" if label else ""


@dataclass(frozen=True, slots=True, eq=False)
class BodyInstant:
    """Debris at an instant."""

    position_enu_m: Array
    attitude_wxyz: Array
    meshes: tuple[SceneMesh, ...] = ()
    """Required when the drawing first shows the body, optional afterwards."""


@dataclass(frozen=True, slots=True)
class ViewEvent:
    """A text message."""

    time_s: float
    severity: int
    """MAV_SEVERITY; 0 is worst."""
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class ViewInstant:
    """The world at an instant."""

    time_s: float
    vessels: Mapping[str, VesselInstant]
    """By name."""
    wind_en_mps: tuple[float, float] = (0.0, 0.0)
    """Velocity of the wind at the first vessel, in the direction of the flow."""
    current_en_mps: tuple[float, float] = (0.0, 0.0)
    """Velocity of the current at the first vessel, in the direction of the flow."""
    bodies: Mapping[int, BodyInstant] = field(default_factory=dict)
    """Debris by number."""
    events: tuple[ViewEvent, ...] = ()
    """Messages since the previous instant."""
    paused: bool = False
    """True while the run is paused."""
    pace: float = float("nan")
    """Multiple of real time."""
    waves: SceneWaves | None = None
    """New waves that replace the previous ones. None or the same object means no change."""
    drawings: Mapping[str, tuple[SceneMesh, ...]] = field(default_factory=dict)
    """Temporary drawings of plug-ins in the map, by name. The same object means no change."""
