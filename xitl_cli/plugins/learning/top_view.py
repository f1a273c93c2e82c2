"""A picture of the track from above, north up, drawn with numpy alone."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.world.contact import Outline
from xitl_cli.plugins.learning.vessels import Vessels

Picture = NDArray[np.uint8]
SIZE = 400
"""Width and height of the picture in pixels."""
LEAST_M = 20.0
"""Least width of the shown water."""
MARGIN = 1.25
WATER, GRID, TRACK, HULL, GOAL = (222, 235, 247), (190, 210, 228), (200, 60, 50), (40, 40, 40), (240, 140, 20)
GRIDS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 10000.0)


class TopView:
    """The tracks of N vessels since the starts of their episodes."""

    def __init__(self, outline: Outline) -> None:
        self._outline = outline
        self._places: list[list[tuple[float, float]]] = []

    def add(self, vessels: Vessels, began: NDArray[np.bool_] | None) -> None:
        """Add the present places. began: flags of the vessels whose track begins here, (N,), None for none."""
        if len(self._places) != len(vessels):
            self._places = [[] for _ in range(len(vessels))]
        places = vessels.position_ned_m[:, :2].tolist()
        for row, (north_m, east_m) in enumerate(places):
            if began is not None and began[row]:
                self._places[row] = []
            self._places[row].append((north_m, east_m))

    def picture(self, vessels: Vessels, row: int) -> Picture:
        """Return the track of one vessel with its hulls and its goal, (SIZE, SIZE, 3)."""
        track = np.array(self._places[row])
        goal = vessels.goal[row, :2] if vessels.goal.shape[1] >= 2 else None
        shown = track if goal is None else np.vstack([track, goal])
        low, high = shown.min(axis=0), shown.max(axis=0)
        width_m = max(MARGIN * float((high - low).max()), LEAST_M)
        canvas = Canvas(0.5 * (low + high), width_m)
        canvas.grid()
        canvas.line(track, TRACK, 1.5)
        if goal is not None:
            canvas.line(goal[None], GOAL, 5.0)
        # The hulls as wide lines from stern to bow
        yaw_rad = float(vessels.euler_rad[row, 2])
        turn = np.array([[math.cos(yaw_rad), math.sin(yaw_rad)], [-math.sin(yaw_rad), math.cos(yaw_rad)]])
        ends_m = track[-1] + self._outline.ends_frd_m[:, :2] @ turn
        for ends, radius_m in zip(ends_m.reshape(-1, 2, 2), self._outline.radius_m.tolist(), strict=True):
            canvas.line(ends, HULL, max(radius_m * canvas.pixels_per_m, 1.5))
        return canvas.pixels


class Canvas:
    """Square water around a centre. pixels: (SIZE, SIZE, 3)."""

    def __init__(self, centre_ne_m: Array, width_m: float) -> None:
        self.pixels: Picture = np.full((SIZE, SIZE, 3), WATER, dtype=np.uint8)
        self.pixels_per_m = SIZE / width_m
        self._centre_ne_m = centre_ne_m
        self._width_m = width_m

    def grid(self) -> None:
        """Draw lines of constant north and east."""
        apart_m = next((apart for apart in GRIDS_M if self._width_m / apart <= 10.0), GRIDS_M[-1])
        for axis, centre_m in enumerate(self._centre_ne_m.tolist()):
            first = math.ceil((centre_m - 0.5 * self._width_m) / apart_m)
            last = math.floor((centre_m + 0.5 * self._width_m) / apart_m)
            for number in range(first, last + 1):
                place = np.array(self._centre_ne_m)
                place[axis] = number * apart_m
                row, column = self._pixel(place[None])[0].astype(int).tolist()
                if axis == 0:
                    self.pixels[min(max(row, 0), SIZE - 1), :] = GRID
                else:
                    self.pixels[:, min(max(column, 0), SIZE - 1)] = GRID

    def line(self, places_ne_m: Array, colour: tuple[int, int, int], radius: float) -> None:
        """Draw a line through (K, 2) places, of this radius in pixels. One place gives a dot."""
        corners = self._pixel(places_ne_m)
        lengths = np.hypot(*np.diff(corners, axis=0).T)
        along = np.concatenate([[0.0], np.cumsum(lengths)])
        at = np.linspace(0.0, along[-1], max(math.ceil(along[-1]), 1) + 1)
        points = np.stack([np.interp(at, along, corners[:, axis]) for axis in range(2)], axis=1)
        reach = math.ceil(radius)
        steps = np.arange(-reach, reach + 1)
        disc = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        disc = disc[np.hypot(*disc.T) <= radius]
        covered = (np.rint(points).astype(int)[:, None] + disc).reshape(-1, 2)
        inside = covered[((covered >= 0) & (covered < SIZE)).all(axis=1)]
        self.pixels[inside[:, 0], inside[:, 1]] = colour

    def _pixel(self, places_ne_m: Array) -> Array:
        """Return rows and columns, (K, 2)."""
        offset = (places_ne_m - self._centre_ne_m) * self.pixels_per_m
        return np.stack([0.5 * SIZE - offset[:, 0], 0.5 * SIZE + offset[:, 1]], axis=1)
