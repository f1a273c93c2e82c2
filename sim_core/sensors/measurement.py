"""What sensors share: motion of a point fixed in the body (lever arm), steps and limits of an output register.

Lever arms are constant matrices on rows of the body's motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.frames import Array

_FIRST = np.kron(np.eye(3), np.ones((1, 3)))
_SECOND = np.kron(np.ones((1, 3)), np.eye(3))


def cross_matrix(position_frd_m: tuple[float, float, float]) -> Array:
    """(3, 3) S with `w x r = w @ S` for rows w (N, 3): the point's velocity from an angular rate."""
    x, y, z = position_frd_m
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def centripetal_matrix(position_frd_m: tuple[float, float, float]) -> Array:
    """(9, 3) C with `w x (w x r) = w (w . r) - r (w . w) = pair_products(w) @ C`: its acceleration at a steady rate."""
    r = np.array(position_frd_m, dtype=np.float64)
    identity = np.eye(3)
    return (identity[:, None, :] * r[None, :, None] - identity[:, :, None] * r[None, None, :]).reshape(9, 3)


def pair_products(rate_frd_radps: Array) -> Array:
    """(N, 3) -> (N, 9) products w_a w_b, row by row; by selection, in half the time of an outer product at N = 1."""
    products: Array = rate_frd_radps.dot(_FIRST) * rate_frd_radps.dot(_SECOND)
    return products


@dataclass(frozen=True, slots=True)
class Digitiser:
    """Rounds to the nearest `resolution` and saturates at plus or minus `full_scale`; None leaves that out.

    Both are arrays without dimensions, which a small array meets in half the time it takes to convert a Python float.
    """

    resolution: Array | None
    full_scale: Array | None

    def read(self, value: Array) -> Array:
        """Any shape, unit of the two fields."""
        if self.resolution is not None:
            value = np.rint(value / self.resolution) * self.resolution
        if self.full_scale is not None:
            value = np.minimum(np.maximum(value, -self.full_scale), self.full_scale)
        return value


def digitiser(resolution: float, full_scale: float | None = None) -> Digitiser:
    """`resolution` 0 for no steps, `full_scale` None for no limit."""
    return Digitiser(
        resolution=np.array(resolution) if resolution else None,
        full_scale=None if full_scale is None else np.array(full_scale),
    )
