"""The next pose as the autopilot's attitude and velocity say, corrected by the cloud: an error-state Kalman filter.

A vessel that steers around something looks at open water for seconds, where a lidar says nothing of how it turned. Its
autopilot knows: by its gyroscopes how it turned since the cloud before, by gravity where down is, by its velocity how
that changed. Where the autopilot says that the vessel is, is not used. The errors (9,) are of place, attitude (a turn
of the odometry's frame) and velocity, all in the odometry's frame (Sola, Quaternion kinematics for the error-state
Kalman filter, arXiv:1711.02508, sec. 7).

Noises were set on six runs with three to four detours each; a factor of two in any of them changes little.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.companion.estimate import Estimate, Motion
from agent.companion.pose_history import PoseHistory
from agent.companion.rigid import cross_matrix, exponential, logarithm
from agent.companion.water_plane import WaterPlane

Array = NDArray[np.float64]

BEGUN = np.diag([1e-6] * 3 + [1e-6] * 3 + [0.04] * 3)
WANDER = np.diag([0.02**2] * 3 + [np.radians(0.15) ** 2] * 3 + [0.05**2] * 3)
"""Of place, attitude and velocity in a second: what the autopilot's estimate is off by from second to second."""
POINT_M = 0.5
"""Of a point against the one it is joined with: the local map has a point each some decimetres."""
ALIGNED = np.diag(np.array([0.02, 0.02, 0.02, 0.05, 0.05, 0.001]) ** 2)
"""Of registration however many points there are. Of roll and pitch it knows less than gravity does."""
DOWN_RAD = 0.01
HEIGHT_M = 0.25
"""Of one cloud's water: waves, which last longer than a cloud."""
MOST_OFF_M, MOST_OFF_RAD, DOUBTS = 1.0, 0.1, 3.0
"""A registration farther from the prediction, by more than so many deviations of it, found something else."""
MOST_GAIN_MPS2 = 10.0
"""An estimate of velocity that changes faster was wrong before."""
REFERENCE_CLOUDS = 50
"""Whose mean is down, and whose mean height is that of the water."""
_DOWN = np.array([0.0, 0.0, 1.0])


def motion_of(history: PoseHistory, before_ns: int | None, begin_ns: int, end_ns: int) -> Motion | None:
    """Until a cloud's end, from that of the cloud before (None: there was none), as an autopilot's messages say.

    Instants are of the history's clock. None where the history has no answer.
    """
    now, then = history.at(end_ns), history.at(end_ns if before_ns is None else before_ns)
    turned = np.eye(3) if before_ns is None else history.turn(before_ns, end_ns)
    within = history.turn(begin_ns, end_ns)
    if now is None or then is None or turned is None or within is None:
        return None
    rate = _turn_of(within) / max((end_ns - begin_ns) * 1e-9, 1e-3)
    return Motion(turned, rate, now.rot_ned_frd, now.vel_ned_mps, now.vel_ned_mps - then.vel_ned_mps)


class Inertial:
    """water: what the cloud in hand shows of it."""

    def __init__(self, water: WaterPlane) -> None:
        self._water = water
        self._spread: Array = BEGUN
        self._down: Array = np.zeros(3)
        self._downs = 0
        self._height_m = 0.0
        self._heights = 0

    def taken_up(self) -> None:
        """How far off the estimate is, is not known from before."""
        self._spread = BEGUN

    def predicted(self, before: Estimate | None, dt_s: float, motion: Motion | None) -> Estimate:
        """Turned and sped up as the autopilot says."""
        assert motion is not None
        if before is None:
            return Estimate(np.eye(4), _twist(np.eye(3), motion.attitude_ned.T @ motion.vel_ned_mps, motion))
        earlier = before.pose_odom[:3, :3]
        pose = before.pose_odom.copy()
        pose[:3, :3] = earlier @ motion.turned
        gained_mps = pose[:3, :3] @ motion.attitude_ned.T @ motion.gained_ned_mps
        gained_mps *= min(1.0, MOST_GAIN_MPS2 * dt_s / max(float(np.linalg.norm(gained_mps)), 1e-9))
        vel_mps = earlier @ before.twist_frd[:3]
        pose[:3, 3] += (vel_mps + 0.5 * gained_mps) * dt_s
        carried = np.eye(9)
        carried[:3, 6:] = dt_s * np.eye(3)
        self._spread = carried @ self._spread @ carried.T + WANDER * dt_s
        return Estimate(pose, _twist(pose[:3, :3], vel_mps + gained_mps, motion))

    def corrected(self, guess: Estimate, aligned: Array, solid_frd_m: Array, dt_s: float) -> Estimate | None:
        """As much as the points bear, that were joined."""
        turned = _turn_of(aligned[:3, :3] @ guess.pose_odom[:3, :3].T)
        off = np.concatenate([aligned[:3, 3] - guess.pose_odom[:3, 3], turned])
        doubt_m = MOST_OFF_M + DOUBTS * float(np.sqrt(np.trace(self._spread[:3, :3])))
        doubt_rad = MOST_OFF_RAD + DOUBTS * float(np.sqrt(np.trace(self._spread[3:6, 3:6])))
        if not (float(np.linalg.norm(off[:3])) <= doubt_m and float(np.linalg.norm(off[3:])) <= doubt_rad):
            return None
        information = _borne(solid_frd_m @ guess.pose_odom[:3, :3].T)
        noise = (POINT_M**2 * np.linalg.inv(information) + ALIGNED).astype(np.float64)
        return self._weighed(guess, np.eye(6, 9), off, noise)

    def levelled(self, estimate: Estimate, motion: Motion | None) -> Estimate:
        """Down is where the autopilot says, and the water at its height."""
        assert motion is not None
        down = estimate.pose_odom[:3, :3] @ motion.attitude_ned.T @ _DOWN
        if self._downs < REFERENCE_CLOUDS:
            self._downs += 1
            self._down = self._down + (down - self._down) / self._downs
        reference = self._down / np.linalg.norm(self._down)
        level_axes = np.linalg.svd(reference[None])[2][1:]
        sides = np.zeros((2, 9))
        sides[:, 3:6] = level_axes
        estimate = self._weighed(estimate, sides, level_axes @ np.cross(down, reference), DOWN_RAD**2 * np.eye(2))
        level = self._water.level
        if level is None:
            return estimate
        height_m = level.down_m + float(reference @ estimate.pose_odom[:3, 3])
        if self._heights < REFERENCE_CLOUDS:
            self._heights += 1
            self._height_m += (height_m - self._height_m) / self._heights
        sides = np.zeros((1, 9))
        sides[0, :3] = reference
        return self._weighed(estimate, sides, np.array([self._height_m - height_m]), HEIGHT_M**2 * np.eye(1))

    def _weighed(self, estimate: Estimate, sides: Array, off: Array, noise: Array) -> Estimate:
        """After an observation that is `off` (k,) from what is expected; sides (k, 9): how errors show in it."""
        spread = self._spread
        gain = np.linalg.solve(sides @ spread @ sides.T + noise, sides @ spread).T
        spread = (np.eye(9) - gain @ sides) @ spread
        self._spread = 0.5 * (spread + spread.T)
        error = gain @ off
        pose, twist = estimate.pose_odom.copy(), estimate.twist_frd.copy()
        vel_mps = pose[:3, :3] @ twist[:3] + error[6:]
        pose[:3, 3] += error[:3]
        pose[:3, :3] = exponential(np.concatenate([np.zeros(3), error[3:6]]))[:3, :3] @ pose[:3, :3]
        twist[:3] = pose[:3, :3].T @ vel_mps
        return Estimate(pose, twist)


def _twist(rot_odom_frd: Array, vel_odom_mps: Array, motion: Motion) -> Array:
    return np.concatenate([rot_odom_frd.T @ vel_odom_mps, motion.rate_frd_radps])


def _borne(around_m: Array) -> Array:
    """(6, 6) what points (n, 3) around the body say of its place and attitude, each of weight one.

    The normal equations of point-to-point registration; what they leave open is nearly zero.
    """
    total, squares = around_m.sum(axis=0), around_m.T @ around_m
    borne = 1e-3 * np.eye(6)
    borne[:3, :3] += len(around_m) * np.eye(3)
    borne[:3, 3:] = -cross_matrix(total)
    borne[3:, :3] = cross_matrix(total)
    borne[3:, 3:] += np.trace(squares) * np.eye(3) - squares
    return borne


def _turn_of(rotation: Array) -> Array:
    """(3,) of a rotation (3, 3)."""
    motion = np.eye(4)
    motion[:3, :3] = rotation
    return logarithm(motion)[3:]
