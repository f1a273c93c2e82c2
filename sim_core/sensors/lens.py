"""Lenses: from directions in the optical axes (x right, y down, z ahead) to pixels, and back.

A pixel's centre has whole coordinates: the first one is (0, 0), as in OpenCV. Equations: OpenCV's documentation of
`calib3d` (Brown 1966 and Conrady 1919, with three radial and two tangential coefficients) and of `fisheye` (Kannala and
Brandt 2006, equidistant, with four coefficients).
"""

from __future__ import annotations

import math

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.sensors.camera_spec import LensSpec

_STEPS = 30
"""Most steps of Newton's method, which needs four to six for real lenses."""


@dataclass(frozen=True, slots=True)
class Lens:
    """A lens on a sensor of `width_px` by `height_px`."""

    width_px: int
    height_px: int
    focal_px: float
    distortion: tuple[float, ...]
    """Pinhole: k1, k2, p1, p2, k3. Fisheye: k1, k2, k3, k4."""
    fisheye: bool = False

    @classmethod
    def from_spec(cls, spec: LensSpec, width_px: int, height_px: int) -> Lens:
        """Return the lens of a specification, with square pixels and the axis through the middle."""
        half_rad = 0.5 * math.radians(spec.view_deg)
        fisheye = spec.model == "fisheye"
        focal_px = 0.5 * width_px / (half_rad if fisheye else math.tan(half_rad))
        given = spec.distortion
        return cls(width_px, height_px, focal_px, (*given, *[0.0] * (4 + (not fisheye) - len(given))), fisheye)

    @property
    def centre_px(self) -> tuple[float, float]:
        """Pixel on the optical axis."""
        return 0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1)

    @property
    def matrix(self) -> Array:
        """Camera matrix, (3, 3)."""
        x_px, y_px = self.centre_px
        return np.array([[self.focal_px, 0.0, x_px], [0.0, self.focal_px, y_px], [0.0, 0.0, 1.0]])

    @property
    def is_ideal(self) -> bool:
        """Whether it is a pinhole without distortion, which a renderer draws directly."""
        return not self.fisheye and not any(self.distortion)

    def project(self, points_m: Array) -> Array:
        """Return the (..., 2) pixels of (..., 3) points; NaN for points that a pinhole cannot see, behind it."""
        x, y, z = np.moveaxis(np.asarray(points_m, dtype=float), -1, 0)
        if self.fisheye:
            across = np.hypot(x, y)
            angle = self._bent(np.arctan2(across, z))
            with np.errstate(invalid="ignore", divide="ignore"):
                scale = np.where(across > 0.0, angle / across, 0.0)
            plane = np.stack([x * scale, y * scale], axis=-1)
        else:
            with np.errstate(invalid="ignore", divide="ignore"):
                ahead = np.where(z > 0.0, z, np.nan)
            plane = self._distorted(np.stack([x / ahead, y / ahead], axis=-1))
        pixels: Array = plane * self.focal_px + self.centre_px
        return pixels

    def directions(self, pixels: Array) -> Array:
        """Return the (..., 3) unit directions of (..., 2) pixels; NaN outside of the lens's image.

        The distortion is inverted by Newton's method.
        """
        plane = (np.asarray(pixels, dtype=float) - self.centre_px) / self.focal_px
        if self.fisheye:
            bent = np.hypot(*np.moveaxis(plane, -1, 0))
            angle = bent.copy()
            for _ in range(_STEPS):
                angle = angle - (self._bent(angle) - bent) / self._bent_slope(angle)
            angle = np.where(np.abs(self._bent(angle) - bent) < 1e-9, angle, np.nan)
            angle = np.where(angle <= math.pi, angle, np.nan)
            with np.errstate(invalid="ignore", divide="ignore"):
                scale = np.where(bent > 0.0, np.sin(angle) / bent, 0.0)
            return np.concatenate([plane * scale[..., None], np.cos(angle)[..., None]], axis=-1)
        ideal = self._undistorted(plane)
        rays = np.concatenate([ideal, np.ones_like(ideal[..., :1])], axis=-1)
        unit: Array = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        return unit

    def all_directions(self) -> Array:
        """Return the (height, width, 3) unit direction of each pixel."""
        grid = np.stack(np.meshgrid(np.arange(float(self.width_px)), np.arange(float(self.height_px))), axis=-1)
        return self.directions(grid)

    def _bent(self, angle: Array) -> Array:
        k1, k2, k3, k4 = self.distortion
        square = angle * angle
        bent: Array = angle * (1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4))))
        return bent

    def _bent_slope(self, angle: Array) -> Array:
        k1, k2, k3, k4 = self.distortion
        square = angle * angle
        slope: Array = 1.0 + square * (3 * k1 + square * (5 * k2 + square * (7 * k3 + square * 9 * k4)))
        return slope

    def _distorted(self, plane: Array) -> Array:
        if not any(self.distortion):
            return plane
        k1, k2, p1, p2, k3 = self.distortion
        x, y = np.moveaxis(plane, -1, 0)
        square = x * x + y * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k3))
        return np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
                y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=-1,
        )

    def _undistorted(self, plane: Array) -> Array:
        if not any(self.distortion):
            return plane
        k1, k2, p1, p2, k3 = self.distortion
        found = plane.copy()
        for _ in range(_STEPS):
            x, y = np.moveaxis(found, -1, 0)
            square = x * x + y * y
            radial = 1.0 + square * (k1 + square * (k2 + square * k3))
            slope = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))
            error_x, error_y = np.moveaxis(self._distorted(found) - plane, -1, 0)
            of_x_by_x = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            of_y_by_y = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            mixed = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            determinant = of_x_by_x * of_y_by_y - mixed * mixed
            step_x = (of_y_by_y * error_x - mixed * error_y) / determinant
            step_y = (of_x_by_x * error_y - mixed * error_x) / determinant
            found = found - np.stack([step_x, step_y], axis=-1)
        wrong = np.linalg.norm(self._distorted(found) - plane, axis=-1) > 1e-9
        return np.where(wrong[..., None], np.nan, found)
