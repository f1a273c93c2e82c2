"""Throttle and steering of any vessel as its commands, without an autopilot.

Steering is an angle, positive for the bow to starboard; 35 degrees are full steering. A rudder or a propeller on a gear
takes this angle, up to its limit. A vessel without either steers by difference of thrust: the propellers of the inner
side push `angle / 35` less, and stop at full steering.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.vessel.spec import VesselSpec

FULL_STEERING_DEG = 35.0
"""Rudder angle of a turning circle (IMO MSC.137(76))."""


@dataclass(frozen=True, slots=True)
class Helm:
    """Constants of one vessel with P propellers and G gears and rudders."""

    by: Literal["rudder", "gear", "difference of thrust", "nothing"]
    """Means of steering."""
    ahead: Array
    """Command of each propeller at full throttle, (P,), 0 for a propeller that pushes sideways."""
    turning_m: Array
    """Lever of each propeller's thrust ahead about the centre of gravity, (P,), positive for the bow to starboard."""
    most_deg: Array
    """Limit of each gear and rudder, (G,)."""
    sign: Array
    """Sign of each gear and rudder, (G,)."""

    @classmethod
    def from_spec(cls, model: VesselSpec) -> Helm:
        """Compute the constants from the places and directions of the actuators."""
        centre_m = model.centre_of_gravity_frd_m
        angle = np.radians([propeller.angle_deg for propeller in model.propellers])
        along = np.cos(angle)
        ahead = np.where(np.abs(along) > 0.5, np.sign(along), 0.0)
        x, y = (np.array([p.position_frd_m for p in model.propellers])[:, :2] - centre_m[:2]).T
        turning = ahead * (x * np.sin(angle) - y * along)
        gears = [(p.steering.max_angle_deg, p.position_frd_m[0]) for p in model.propellers if p.steering is not None]
        rudders = [(rudder.max_angle_deg, rudder.position_frd_m[0]) for rudder in model.rudders]
        most = np.array([angle_deg for angle_deg, _ in gears + rudders])
        sign = np.array([-1.0 if place_m > centre_m[0] else 1.0 for _, place_m in gears + rudders])
        by: Literal["rudder", "gear", "difference of thrust", "nothing"] = "nothing"
        if rudders:
            by = "rudder"
        elif gears:
            by = "gear"
        elif turning.min() < -1e-6 and turning.max() > 1e-6:
            by = "difference of thrust"
        return cls(by, ahead, turning, most, sign)

    def command(self, throttle: float, steering_deg: float = 0.0) -> Array:
        """Return (C,) in [-1, 1] for a throttle in [-1, 1] and an angle, which is limited to 35 degrees."""
        steering_deg = min(max(steering_deg, -FULL_STEERING_DEG), FULL_STEERING_DEG)
        propellers = throttle * self.ahead
        if self.by == "difference of thrust":
            inner = self.turning_m * steering_deg < -1e-9
            propellers = np.where(
                inner, propellers * math.sqrt(1.0 - abs(steering_deg) / FULL_STEERING_DEG), propellers
            )
        angles = np.clip(self.sign * steering_deg / self.most_deg, -1.0, 1.0) if len(self.most_deg) else self.most_deg
        return np.concatenate([propellers, angles])

    def straight(self, throttle: float, yaw_rad: float, rate_radps: float) -> Array:
        """Return (C,) that keeps a northerly course under way ahead: it corrects deviations due to rounding."""
        return self.command(throttle, -math.degrees(yaw_rad + rate_radps))

    def spot_turn(self, forward_n: Array, reverse_n: Array) -> Array:
        """Return (C,) that turns the bow to starboard on the spot: one side ahead, the other astern, with equal thrust.

        forward_n, reverse_n: (P,) full thrust of each.
        """
        starboard = self.ahead * np.sign(np.where(np.abs(self.turning_m) > 1e-6, self.turning_m, 0.0))
        full = np.where(starboard > 0, forward_n, reverse_n)
        used = full[starboard != 0]
        share = used.min() / full if used.size and used.min() > 0 else np.zeros(len(full))
        return np.concatenate([starboard * np.sqrt(np.minimum(share, 1.0)), np.zeros(len(self.most_deg))])
