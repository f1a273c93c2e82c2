"""Common parts of the sensors: motion of a point fixed in the body (lever arm), resolution and limits of the output.

Lever arms are constant matrices on rows of the body's motion.
"""

from __future__ import annotations

import math

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array

_FIRST = np.kron(np.eye(3), np.ones((1, 3)))
_SECOND = np.kron(np.ones((1, 3)), np.eye(3))


def cross_matrix(position_frd_m: tuple[float, float, float]) -> Array:
    """Return the (3, 3) S with `w x r = w @ S` for rows w (N, 3): the point's velocity from an angular rate."""
    x, y, z = position_frd_m
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def centripetal_matrix(position_frd_m: tuple[float, float, float]) -> Array:
    """Return the (9, 3) C with `w x (w x r) = w (w . r) - r (w . w) = pair_products(w) @ C`.

    This is the point's acceleration at a steady rate.
    """
    r = np.array(position_frd_m, dtype=np.float64)
    identity = np.eye(3)
    return (identity[:, None, :] * r[None, :, None] - identity[:, :, None] * r[None, None, :]).reshape(9, 3)


def pair_products(rate_frd_radps: Array) -> Array:
    """Return the (N, 9) products w_a w_b, row by row. Selection takes half the time of an outer product at N = 1."""
    products: Array = rate_frd_radps.dot(_FIRST) * rate_frd_radps.dot(_SECOND)
    return products


@dataclass(frozen=True, slots=True)
class Digitiser:
    """Rounds to the nearest `resolution` and saturates at plus or minus `full_scale`.

    Both are arrays without dimensions, or rows of one value for each column. Small arrays combine with them in half the
    time of a Python float.
    """

    resolution: Array | None
    """None disables rounding."""
    full_scale: Array | None
    """None disables saturation."""
    least: Array | None
    """Minus full_scale."""

    def read(self, value: Array) -> Array:
        """Digitise values of any shape, in the unit of the two fields."""
        if self.resolution is not None:
            value = np.rint(value / self.resolution) * self.resolution
        if self.full_scale is not None and self.least is not None:
            value = np.minimum(np.maximum(value, self.least), self.full_scale)
        return value


FINEST = 2.0**-960
"""A step so fine that rounding to it leaves values between 1e-270 and 1e18 as they are, bit for bit."""


def joined_digitiser(*of_columns: tuple[int, float, float | None]) -> Digitiser:
    """Make one digitiser of rows from groups of columns: their number, `resolution` and `full_scale` of `digitiser`."""
    resolution = [step or FINEST for count, step, _ in of_columns for _ in range(count)]
    full_scale = [math.inf if most is None else most for count, _, most in of_columns for _ in range(count)]
    steps = any(step for _, step, _ in of_columns)
    return Digitiser(
        resolution=np.array([resolution]) if steps else None,
        full_scale=np.array([full_scale]) if any(map(math.isfinite, full_scale)) else None,
        least=-np.array([full_scale]) if any(map(math.isfinite, full_scale)) else None,
    )


def digitiser(resolution: float, full_scale: float | None = None) -> Digitiser:
    """Make a digitiser. `resolution`: 0 for no steps. `full_scale`: None for no limit."""
    return Digitiser(
        resolution=np.array(resolution) if resolution else None,
        full_scale=None if full_scale is None else np.array(full_scale),
        least=None if full_scale is None else np.array(-full_scale),
    )
