"""The next pose from the clouds alone: it goes on as it went, and the water says how the body rolls.

With few points a pose is noisy, so that it is weighed against the prediction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.companion.estimate import Estimate, Motion
from agent.companion.rigid import exponential, inverse, logarithm
from agent.companion.water_plane import WaterPlane

Array = NDArray[np.float64]

MOST_SURPRISE_MPS = 8.0
"""How far from what was predicted a pose may be for each second that went by. Vessels gain some m/s in a second."""
GAIN = np.array([0.8, 0.8, 0.3, 0.9, 0.9, 0.9])
"""Share of a pose's surprise that is believed, of place and attitude (alpha of an alpha-beta filter)."""
RATE_GAIN = GAIN**2 / (2.0 - GAIN)
"""The beta that belongs to it (Benedict and Bordner, IRE Trans. AC-7, 1962)."""

ROCKING = 0.65
"""Share believed of how fast the body turns against the water within a cloud: waves turn the water too."""

REFERENCE_CLOUDS = 30
"""Whose mean is the plane of the water: some periods of the waves."""
LEVEL_GAIN = 0.2
HEIGHT_GAIN = 0.4
"""Share of the tilt and of the height off the water that is taken back with every cloud; waves are averaged out."""


class LidarOnly:
    """water: what the cloud in hand shows of it."""

    def __init__(self, water: WaterPlane) -> None:
        self._water = water
        self._normal: Array = np.zeros(3)
        self._height_m = 0.0
        self._levels = 0
        self._surface: tuple[Array, float] | None = None

    def taken_up(self) -> None:
        """Where the water was last is not known."""
        self._surface = None

    def predicted(self, before: Estimate | None, dt_s: float, motion: Motion | None) -> Estimate:
        """Even motion, rocking as the water shows."""
        if before is None:
            return Estimate(np.eye(4), self._rocked(np.zeros(6)))
        pose = self._floated(before.pose_odom @ exponential(before.twist_frd * dt_s))
        self._surface = None
        return Estimate(pose, self._rocked(before.twist_frd))

    def corrected(self, guess: Estimate, aligned: Array, solid_frd_m: Array, dt_s: float) -> Estimate | None:
        """By fixed shares of the surprise."""
        surprise = logarithm(inverse(guess.pose_odom) @ aligned)
        if not float(np.linalg.norm(surprise[:3])) <= MOST_SURPRISE_MPS * dt_s:  # also when it is not a number
            return None
        pose = guess.pose_odom @ exponential(GAIN * surprise)
        return Estimate(pose, self._rocked(guess.twist_frd + RATE_GAIN * surprise / dt_s))

    def levelled(self, estimate: Estimate, motion: Motion | None) -> Estimate:
        """Height and tilt a little nearer to what the water says, whose plane stays where it was."""
        level = self._water.level
        if level is None:
            return estimate
        pose = estimate.pose_odom
        normal, down_m = pose[:3, :3] @ level.normal_frd, level.down_m
        height_m = down_m + float(normal @ pose[:3, 3])
        if self._levels < REFERENCE_CLOUDS:
            share = 1.0 / (self._levels + 1)
            self._normal = self._normal + share * (normal - self._normal)
            self._height_m += share * (height_m - self._height_m)
            self._levels += 1
        reference = self._normal / np.linalg.norm(self._normal)
        turn = np.concatenate([np.zeros(3), LEVEL_GAIN * np.cross(normal, reference)])
        levelled = pose.copy()
        levelled[:3, :3] = exponential(turn)[:3, :3] @ pose[:3, :3]
        levelled[:3, 3] += HEIGHT_GAIN * (self._height_m - down_m - float(reference @ pose[:3, 3])) * reference
        normal = levelled[:3, :3] @ level.normal_frd
        self._surface = (normal, down_m + float(normal @ levelled[:3, 3]))
        return Estimate(levelled, estimate.twist_frd)

    def _rocked(self, twist: Array) -> Array:
        """(6,) a twist that rolls and pitches as this cloud's water says, where it shows any, and does not heave.

        Heave of some cm in a second is below what the prediction makes of it.
        """
        level = self._water.level
        if level is None:
            return twist
        normal = level.normal_frd
        rocked = twist.copy()
        rocked[:3] -= (normal @ twist[:3]) * normal
        rocked[3:] = ROCKING * level.turn_frd_radps + (normal @ twist[3:]) * normal
        return rocked

    def _floated(self, guess: Array) -> Array:
        """A predicted pose, tilted and lifted so that the water is where the last cloud saw it."""
        level, before = self._water.level, self._surface
        if level is None or before is None:
            return guess
        normal, last_normal = guess[:3, :3] @ level.normal_frd, before[0]
        turn = np.concatenate([np.zeros(3), np.cross(normal, last_normal)])
        floated = guess.copy()
        floated[:3, :3] = exponential(turn)[:3, :3] @ guess[:3, :3]
        floated[:3, 3] += (before[1] - level.down_m - float(last_normal @ guess[:3, 3])) * last_normal
        return floated
