"""What an output register does to a value: steps and a full scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.frames import Array


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
