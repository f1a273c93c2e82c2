"""What a view draws: the scene once, then instants of it. A run as it goes on and a recording both give these.

Places are in metres, east, north, up of the map; attitudes are quaternions (w, x, y, z) from FLU of the body to ENU.
What is not known is None, NaN among numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Points = NDArray[np.float32]
Faces = NDArray[np.uint32]
Colour = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class SceneMesh:
    """Triangles of one colour: vertices (V, 3) and faces (F, 3), in the map or, of a vessel or body, in its FLU."""

    name: str
    vertices_m: Points
    faces: Faces
    colour: Colour
    opacity: float = 1.0


@dataclass(frozen=True, slots=True)
class SceneThruster:
    """A propeller: place and direction of positive thrust in FLU; the number of its motor command."""

    place_flu_m: tuple[float, float, float]
    axis_flu: tuple[float, float, float]
    diameter_m: float
    motor: int


@dataclass(frozen=True, slots=True, eq=False)
class SceneVessel:
    """Hulls and what is on them, without the thrusters. mission_enu_m: (W, 3), its start first.

    acceptance_radius_m: how near to a waypoint it counts as reached; 0 if that is not known.
    """

    meshes: tuple[SceneMesh, ...]
    thrusters: tuple[SceneThruster, ...] = ()
    length_m: float = 2.0
    mission_enu_m: Array = field(default_factory=lambda: np.empty((0, 3)))
    acceptance_radius_m: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SceneWaves:
    """Components of the sea: amplitude (C,), wave vector (C, 2) east and north, angular frequency (C,) at a fixed place
    and phase (C,): elevation = sum of amplitude cos(k . x - omega t + phase).
    """

    amplitude_m: Array
    wave_vector_en_radpm: Array
    angular_frequency_radps: Array
    phase_rad: Array

    def elevation_m(self, time_s: float, places_en_m: Array) -> Array:
        """(...,) at (..., 2) places, up over the still level."""
        phase = places_en_m @ self.wave_vector_en_radpm.T - self.angular_frequency_radps * time_s + self.phase_rad
        return np.asarray(np.cos(phase) @ self.amplitude_m)


@dataclass(frozen=True, slots=True, eq=False)
class SceneWater:
    """The surface: its still level, the middle and the size of what is of interest, its waves if they are known.

    bounded: by land, so that no water is drawn far outside of that piece.
    """

    level_m: float = 0.0
    centre_en_m: tuple[float, float] = (0.0, 0.0)
    size_en_m: tuple[float, float] = (200.0, 200.0)
    waves: SceneWaves | None = None
    bounded: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ViewScene:
    """All that does not change. vessels: by name, "" for one alone. notes: what could not be drawn, for the user."""

    title: str
    meshes: tuple[SceneMesh, ...] = ()
    vessels: Mapping[str, SceneVessel] = field(default_factory=dict)
    water: SceneWater = field(default_factory=SceneWater)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class VesselInstant:
    """A vessel at an instant.

    motors: -1 to 1. mission_enu_m: as SceneVessel has it, None for that one. clouds: points (P, 3) in the map by sensor
    (`lidar`, `sonar`, `map`). obstacles: (O, 3) centre and (O,) radius of what the companion tracks. numbers: what is
    told beside the picture, by its label with unit. target_enu_m: the waypoint it heads for. guided_enu_m: the place it
    goes to in GUIDED.
    """

    position_enu_m: Array
    attitude_wxyz: Array
    estimate_position_enu_m: Array | None = None
    estimate_attitude_wxyz: Array | None = None
    motors: tuple[float, ...] = ()
    mode: str = ""
    armed: bool = False
    waypoints_reached: int = 0
    waypoints_total: int = 0
    mission_enu_m: Array | None = None
    target_enu_m: Array | None = None
    clouds: Mapping[str, Points] = field(default_factory=dict)
    obstacles_enu_m: Array = field(default_factory=lambda: np.empty((0, 3)))
    obstacle_radius_m: Array = field(default_factory=lambda: np.empty(0))
    numbers: Mapping[str, float] = field(default_factory=dict)
    guided_enu_m: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class BodyInstant:
    """Debris: its mesh is given with the first instant that has it."""

    position_enu_m: Array
    attitude_wxyz: Array
    mesh: SceneMesh | None = None


@dataclass(frozen=True, slots=True)
class ViewEvent:
    """Something that was said. severity: of MAV_SEVERITY, 0 is worst."""

    time_s: float
    severity: int
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class ViewInstant:
    """The world at time_s. wind_en_mps, current_en_mps: where they blow and flow to, at the first vessel.

    bodies: by number. events: since the instant before. paused: the run stands still. pace: times real time.
    waves: others than those of the scene, or of an instant before; None, or the same object, while they stay the same.
    drawings: by name, drawings of plug-ins in the map that last a moment; the same object while one stays the same.
    """

    time_s: float
    vessels: Mapping[str, VesselInstant]
    wind_en_mps: tuple[float, float] = (0.0, 0.0)
    current_en_mps: tuple[float, float] = (0.0, 0.0)
    bodies: Mapping[int, BodyInstant] = field(default_factory=dict)
    events: tuple[ViewEvent, ...] = ()
    paused: bool = False
    pace: float = float("nan")
    waves: SceneWaves | None = None
    drawings: Mapping[str, tuple[SceneMesh, ...]] = field(default_factory=dict)
