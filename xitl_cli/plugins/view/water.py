"""Water surface as a grid that follows the camera's subject and moves with the waves of the run.

The cells are small near the middle and grow outwards to the haze. A wave that is too short for a cell's size fades
there, so that the distant surface does not flicker.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xitl_cli.plugins.view.model import Array, Faces, Points, SceneWaves


@dataclass(frozen=True, slots=True)
class WaterResolution:
    """Resolution of the water surface."""

    near_cell_m: float
    """Size of the cells near the middle."""
    near_cells: int
    """Number of cells of this size to each side of the middle."""
    growth_cells: int
    """Number of growing cells beyond them, to the haze."""
    height_step_m: float = 0.0
    """Step to which heights are rounded, 0 for no rounding."""


SCREEN_WATER = WaterResolution(0.75, 26, 13)
PAGE_WATER = WaterResolution(1.5, 8, 5, 0.02)
"""Resolution for a page. The page stores the height of every vertex at every instant, about 10 kB per second."""
REACH_M = 1800.0


class WaterGrid:
    """Grid with vertices_m (V, 3) relative to its middle, and faces (F, 3).

    reach_m: half of its side length. waves: None for still water, whose grid is a square of two triangles.
    """

    def __init__(
        self, waves: SceneWaves | None, reach_m: float = REACH_M, resolution: WaterResolution = SCREEN_WATER
    ) -> None:
        self.waves = waves
        self._cell_m, self._step_m = resolution.near_cell_m, resolution.height_step_m
        axis = np.array([-reach_m, reach_m]) if waves is None else _axis(reach_m, resolution)
        east, north = (part.ravel() for part in np.meshgrid(axis, axis, indexing="xy"))
        self.vertices_m: Points = np.column_stack([east, north, np.zeros(len(east))]).astype(np.float32)
        self.faces = _faces(len(axis))
        if waves is not None:
            gap = np.gradient(axis)
            cell_m = np.maximum(*(part.ravel() for part in np.meshgrid(gap, gap, indexing="xy")))
            number = np.hypot(*waves.wave_vector_en_radpm.T)
            amplitude_m = waves.amplitude_m * np.exp(-((0.5 * cell_m[:, None] * number) ** 2))
            phase = self.vertices_m[:, :2].astype(np.float64) @ waves.wave_vector_en_radpm.T
            self._of_cosine: NDArray[np.float32] = (amplitude_m * np.cos(phase)).astype(np.float32)
            self._of_sine: NDArray[np.float32] = (amplitude_m * np.sin(phase)).astype(np.float32)

    def middle(self, place_en_m: Array) -> tuple[float, float]:
        """Return the grid's middle for a subject. It is a multiple of the cell size, so that waves do not swim."""
        if self.waves is None:
            return float(place_en_m[0]), float(place_en_m[1])
        east, north = (np.round(place_en_m / self._cell_m) * self._cell_m).tolist()
        return east, north

    def move(self, time_s: float, middle_en_m: tuple[float, float]) -> Points:
        """Return the vertices at an instant, relative to the middle and the still level. The array is reused."""
        waves = self.waves
        if waves is not None:
            phase = (
                waves.wave_vector_en_radpm @ np.asarray(middle_en_m)
                - waves.angular_frequency_radps * time_s
                + waves.phase_rad
            )
            cosine, sine = np.cos(phase).astype(np.float32), np.sin(phase).astype(np.float32)
            up_m = self._of_cosine @ cosine - self._of_sine @ sine
            self.vertices_m[:, 2] = np.round(up_m / self._step_m) * self._step_m if self._step_m else up_m
        return self.vertices_m


def _axis(reach_m: float, resolution: WaterResolution) -> Array:
    """Return the coordinates of the grid's lines."""
    cell_m, growing = resolution.near_cell_m, np.arange(1, resolution.growth_cells + 1)
    near_m = cell_m * resolution.near_cells
    ratio = 1.0
    for _ in range(60):  # the ratio of neighbouring cells for which they add up
        total = cell_m * float(np.sum(ratio**growing))
        ratio *= (max(reach_m - near_m, cell_m) / total) ** (1.0 / len(growing))
    cells = np.concatenate([np.full(resolution.near_cells, cell_m), cell_m * ratio**growing])
    half = np.cumsum(cells)
    return np.concatenate([-half[::-1], [0.0], half])


def _faces(lines: int) -> Faces:
    corner = np.arange(lines * lines).reshape(lines, lines)
    here, east = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel()
    north, beyond = corner[1:, :-1].ravel(), corner[1:, 1:].ravel()
    return np.concatenate([np.stack([here, east, beyond], -1), np.stack([here, beyond, north], -1)]).astype(np.uint32)


def heading_wxyz(east: float, north: float) -> tuple[float, float, float, float]:
    """Return the rotation (w, x, y, z) about the vertical from +x to a direction."""
    half = 0.5 * math.atan2(north, east)
    return math.cos(half), 0.0, 0.0, math.sin(half)
