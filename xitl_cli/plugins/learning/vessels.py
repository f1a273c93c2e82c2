"""The state of a batch of vessels as plain arrays, for rewards, ends of episodes and observations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array


@dataclass(frozen=True, slots=True, eq=False)
class Vessels:
    """N vessels at one instant. All arrays have one row for each vessel. Do not change them.

    Positions are in NED (north, east, down) from the origin of the profile. Body axes are FRD (forward, right, down).
    """

    time_s: Array
    """Time since the start of the episode, (N,)."""
    position_ned_m: Array
    """Position, (N, 3)."""
    start_ned_m: Array
    """Position at the start of the episode, (N, 3)."""
    velocity_ned_mps: Array
    """Velocity over ground, (N, 3), north, east and down."""
    velocity_frd_mps: Array
    """Velocity over ground, (N, 3), forward, right and down."""
    euler_rad: Array
    """Roll, pitch and yaw, (N, 3). The yaw is the heading from north, clockwise, from -pi to pi."""
    rates_frd_radps: Array
    """Turn rates about the body axes, (N, 3). The last one is positive to starboard."""
    actuators: Array
    """State of the actuators, (N, C): shares of full speed or full angle, in the order of the action."""
    current_ned_mps: Array
    """Velocity of the water, (N, 3), without the motion in waves."""
    wind_ned_mps: Array
    """Velocity of the air, (N, 3)."""
    contact: Array
    """1 for a vessel that touched a structure in the latest step, else 0, (N,)."""
    goal: Array
    """Numbers of the goal of the episode, (N, G)."""
    sensors: Mapping[str, Array]
    """Newest samples of the observed sensors by name, each (N, K). Positions of `gnss` are from the origin."""

    def __len__(self) -> int:
        """Number of vessels."""
        return len(self.time_s)

    def ahead_right(self, vector_ned: Array) -> Array:
        """Turn (N, 2) or (N, 3) vectors from north and east to ahead and right of the bow, (N, 2)."""
        cosine, sine = np.cos(self.euler_rad[:, 2]), np.sin(self.euler_rad[:, 2])
        north, east = vector_ned[:, 0], vector_ned[:, 1]
        return np.stack([cosine * north + sine * east, cosine * east - sine * north], axis=1)
