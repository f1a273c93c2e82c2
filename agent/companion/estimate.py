"""What an odometry believes of the body at an instant, and who may say what comes next."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Motion(NamedTuple):
    """How the autopilot says the body moved from one cloud's end to the next.

    turned (3, 3): the body now seen from the body then. rate_frd_radps (3,): mean of the cloud's own time.
    attitude_ned (3, 3): body to NED now. vel_ned_mps (3,) now, of which gained_ned_mps (3,) since then.
    """

    turned: Array
    rate_frd_radps: Array
    attitude_ned: Array
    vel_ned_mps: Array
    gained_ned_mps: Array


class Estimate(NamedTuple):
    """pose_odom (4, 4): body FRD to the odometry's frame. twist_frd (6,): velocity and rates in the body."""

    pose_odom: Array
    twist_frd: Array


class Filter(Protocol):
    """Weighs what a cloud says against what was to be expected. Called in this order for each cloud."""

    def taken_up(self) -> None:
        """The cloud before was not this filter's, or there was none."""

    def predicted(self, before: Estimate | None, dt_s: float, motion: Motion | None) -> Estimate:
        """At the cloud's end; before is None for the first cloud."""

    def corrected(self, guess: Estimate, aligned: Array, solid_frd_m: Array, dt_s: float) -> Estimate | None:
        """With the pose (4, 4) that registration found for the points (n, 3); None where that cannot be."""

    def levelled(self, estimate: Estimate, motion: Motion | None) -> Estimate:
        """Held to the water, and to what is known of down."""
