"""Prediction and correction of the odometry's pose: aided by the autopilot, or from the clouds alone.

`AidedFilter` is an error-state Kalman filter. A vessel that avoids an obstacle faces open water for seconds, where a
lidar says nothing of how it turned. Its autopilot knows: from its gyroscopes how it turned since the cloud before, from
gravity where down is, and how its velocity changed. The autopilot's position is not used. The errors (9,) are of
position, attitude (a turn of the odometry's frame) and velocity, all in the odometry's frame (Sola, Quaternion
kinematics for the error-state Kalman filter, arXiv:1711.02508, sec. 7).

`LidarOnlyFilter` is an alpha-beta filter: constant velocity, and roll and pitch as the water shows them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from agent.companion.pose_history import PoseHistory, VehiclePose
from agent.companion.rigid_motion import cross_matrix, exponential, inverse, logarithm
from agent.companion.water_plane import WaterPlane

Array = NDArray[np.float64]


class AutopilotMotion(NamedTuple):
    """How the autopilot says the body moved from one cloud's end to the next.

    turned (3, 3): the body now seen from the body then. rate_frd_radps (3,): mean of the cloud's own time.
    attitude_ned (3, 3): body to NED now. vel_ned_mps (3,) now, of which gained_ned_mps (3,) since then.
    """

    turned: Array
    rate_frd_radps: Array
    attitude_ned: Array
    vel_ned_mps: Array
    gained_ned_mps: Array


class OdometryState(NamedTuple):
    """pose_odom (4, 4): body FRD to the odometry's frame. twist_frd (6,): velocity and rates in the body."""

    pose_odom: Array
    twist_frd: Array


class OdometryFilter(Protocol):
    """Weighs what a cloud says against what was to be expected. Called in this order for each cloud."""

    def resume(self) -> None:
        """The cloud before was not this filter's, or there was none."""

    def predict(self, before: OdometryState | None, dt_s: float, motion: AutopilotMotion | None) -> OdometryState:
        """At the cloud's end; before is None for the first cloud."""

    def correct(self, guess: OdometryState, aligned: Array, solid_frd_m: Array, dt_s: float) -> OdometryState | None:
        """With the pose (4, 4) that registration found for the points (n, 3); None where that cannot be."""

    def hold_level(self, estimate: OdometryState, motion: AutopilotMotion | None) -> OdometryState:
        """Held to the water, and to what is known of down."""


INITIAL = np.diag([1e-6] * 3 + [1e-6] * 3 + [0.04] * 3)
"""Covariance of the errors where the odometry begins, m, rad and m/s squared."""
RESUMED = np.diag([0.09] * 3 + [np.radians(2.0) ** 2] * 3 + [0.04] * 3)
"""The same after clouds that were placed without the autopilot."""
PROCESS = np.diag([0.02**2] * 3 + [np.radians(0.15) ** 2] * 3 + [0.05**2] * 3)
"""Covariance that a second adds: what the autopilot's estimate is off by from second to second."""
POINT_M = 0.5
"""Of a point against the one it is joined with: the local map has a point each some decimetres."""
REGISTRATION = np.diag(np.array([0.02, 0.02, 0.02, 0.05, 0.05, 0.001]) ** 2)
"""Of a registered pose, m and rad squared, however many points there are. Of roll and pitch gravity knows more."""
DOWN_RAD = 0.01
HEIGHT_M = 0.25
"""Of one cloud's water: waves, which last longer than a cloud."""
MOST_OFF_M, MOST_OFF_RAD, DEVIATIONS = 1.0, 0.1, 3.0
"""A registration farther from the prediction, by more than so many deviations of it, found something else."""
MOST_GAIN_MPS2, DOUBTED_MPS = 10.0, 1.0
"""A velocity that changes faster was wrong before, and how far off it may be now."""
AIDED_REFERENCE_CLOUDS = 50
"""Whose mean is down, and whose mean height is that of the water."""
_NOTHING = 1e-9  # registration hands back the prediction where it could join no points
_DOWN = np.array([0.0, 0.0, 1.0])


class _Told(NamedTuple):
    epoch: int
    end_ns: int
    steady: Array
    pose: VehiclePose


class AutopilotMotionSource:
    """What an autopilot's history says of each cloud's time. own_ns: from the sensors' clock to the history's.

    Each motion begins where the one before ended, as that was told: what an extrapolation was off by is made up for.
    """

    def __init__(self, history: PoseHistory, own_ns: Callable[[int], int]) -> None:
        self._history = history
        self._own_ns = own_ns
        self._last: _Told | None = None

    def motion_between(self, before_ns: int | None, begin_ns: int, end_ns: int) -> AutopilotMotion | None:
        """From the end of the cloud before (None: there was none) to this one's end; None where it is not known."""
        told, began = self._told(end_ns), self._history.steady_attitude_at(self._own_ns(begin_ns))
        if told is None or began is None:
            return None
        then: _Told | None = told
        if before_ns is not None:
            last = self._last
            continued = last is not None and last.end_ns == before_ns and last.epoch == told.epoch
            then = last if continued else self._told(before_ns)
        if then is None:
            return None
        self._last = told
        rate = _turn_of(began.T @ told.steady) / max((end_ns - begin_ns) * 1e-9, 1e-3)
        vel_mps = told.pose.vel_ned_mps
        gained_mps = vel_mps - then.pose.vel_ned_mps
        return AutopilotMotion(then.steady.T @ told.steady, rate, told.pose.rot_ned_frd, vel_mps, gained_mps)

    def _told(self, stamp_ns: int) -> _Told | None:
        own_ns = self._own_ns(stamp_ns)
        pose, steady = self._history.pose_at(own_ns), self._history.steady_attitude_at(own_ns)
        if pose is None or steady is None:
            return None
        return _Told(self._history.epoch, stamp_ns, steady, pose)


class AidedFilter:
    """water: what the cloud in hand shows of it."""

    def __init__(self, water: WaterPlane) -> None:
        self._water = water
        self._covariance: Array = INITIAL  # (9, 9)
        self._down: Array = np.zeros(3)
        self._downs = 0
        self._height_m = 0.0
        self._heights = 0

    def resume(self) -> None:
        """How far off the estimate is, is not known from before."""
        self._covariance = RESUMED

    def predict(self, before: OdometryState | None, dt_s: float, motion: AutopilotMotion | None) -> OdometryState:
        """Turned and sped up as the autopilot says."""
        assert motion is not None
        if before is None:
            self._covariance = INITIAL
            return OdometryState(np.eye(4), _twist(np.eye(3), motion.attitude_ned.T @ motion.vel_ned_mps, motion))
        earlier = before.pose_odom[:3, :3]
        pose = before.pose_odom.copy()
        pose[:3, :3] = earlier @ motion.turned
        gained_mps = pose[:3, :3] @ motion.attitude_ned.T @ motion.gained_ned_mps
        doubted = float(np.linalg.norm(gained_mps)) > MOST_GAIN_MPS2 * dt_s
        if doubted:
            gained_mps = np.zeros(3)
        vel_mps = earlier @ before.twist_frd[:3]
        pose[:3, 3] += (vel_mps + 0.5 * gained_mps) * dt_s
        transition = np.eye(9)
        transition[:3, 6:] = dt_s * np.eye(3)
        transition[6:, 3:6] = -cross_matrix(gained_mps)
        transition[:3, 3:6] = 0.5 * dt_s * transition[6:, 3:6]
        self._covariance = transition @ self._covariance @ transition.T + PROCESS * dt_s
        if doubted:
            self._covariance[6:, 6:] += DOUBTED_MPS**2 * np.eye(3)
        return OdometryState(pose, _twist(pose[:3, :3], vel_mps + gained_mps, motion))

    def correct(self, guess: OdometryState, aligned: Array, solid_frd_m: Array, dt_s: float) -> OdometryState | None:
        """As much as the points bear that were to be joined."""
        turn = _turn_of(aligned[:3, :3] @ guess.pose_odom[:3, :3].T)
        residual = np.concatenate([aligned[:3, 3] - guess.pose_odom[:3, 3], turn])
        place_m2, turn_rad2 = np.trace(self._covariance[:3, :3]), np.trace(self._covariance[3:6, 3:6])
        most_m, most_rad = MOST_OFF_M + DEVIATIONS * place_m2**0.5, MOST_OFF_RAD + DEVIATIONS * turn_rad2**0.5
        if not (float(np.linalg.norm(residual[:3])) <= most_m and float(np.linalg.norm(turn)) <= most_rad):
            return None
        if float(np.linalg.norm(residual)) < _NOTHING:
            return guess
        information = _information(solid_frd_m @ guess.pose_odom[:3, :3].T)
        noise = (POINT_M**2 * np.linalg.inv(information) + REGISTRATION).astype(np.float64)
        return self._observed(guess, np.eye(6, 9), residual, noise)

    def hold_level(self, estimate: OdometryState, motion: AutopilotMotion | None) -> OdometryState:
        """Down is where the autopilot says, and the water at its height."""
        assert motion is not None
        down = estimate.pose_odom[:3, :3] @ motion.attitude_ned.T @ _DOWN
        if self._downs < AIDED_REFERENCE_CLOUDS:
            self._downs += 1
            self._down = self._down + (down - self._down) / self._downs
        reference = self._down / np.linalg.norm(self._down)
        level_axes = np.linalg.svd(reference[None])[2][1:]
        jacobian = np.zeros((2, 9))
        jacobian[:, 3:6] = level_axes
        estimate = self._observed(estimate, jacobian, level_axes @ np.cross(down, reference), DOWN_RAD**2 * np.eye(2))
        level = self._water.level
        if level is None:
            return estimate
        height_m = level.down_m + float(reference @ estimate.pose_odom[:3, 3])
        if self._heights < AIDED_REFERENCE_CLOUDS:
            self._heights += 1
            self._height_m += (height_m - self._height_m) / self._heights
        jacobian = np.zeros((1, 9))
        jacobian[0, :3] = reference
        return self._observed(estimate, jacobian, np.array([self._height_m - height_m]), HEIGHT_M**2 * np.eye(1))

    def _observed(self, estimate: OdometryState, jacobian: Array, residual: Array, noise: Array) -> OdometryState:
        """After an observation (k,) of covariance noise (k, k); jacobian (k, 9) of it by the errors."""
        before = self._covariance
        gain = np.linalg.solve(jacobian @ before @ jacobian.T + noise, jacobian @ before).T
        after = (np.eye(9) - gain @ jacobian) @ before
        self._covariance = 0.5 * (after + after.T)
        error = gain @ residual
        pose, twist = estimate.pose_odom.copy(), estimate.twist_frd.copy()
        vel_mps = pose[:3, :3] @ twist[:3] + error[6:]
        pose[:3, 3] += error[:3]
        pose[:3, :3] = exponential(np.concatenate([np.zeros(3), error[3:6]]))[:3, :3] @ pose[:3, :3]
        twist[:3] = pose[:3, :3].T @ vel_mps
        return OdometryState(pose, twist)


def _twist(rot_odom_frd: Array, vel_odom_mps: Array, motion: AutopilotMotion) -> Array:
    return np.concatenate([rot_odom_frd.T @ vel_odom_mps, motion.rate_frd_radps])


def _information(around_m: Array) -> Array:
    """(6, 6) of points (n, 3) around the body on its place and attitude, each of weight one.

    The normal equations of point-to-point registration; what they leave open is nearly zero.
    """
    total, squares = around_m.sum(axis=0), around_m.T @ around_m
    information = 1e-3 * np.eye(6)
    information[:3, :3] += len(around_m) * np.eye(3)
    information[:3, 3:] = -cross_matrix(total)
    information[3:, :3] = cross_matrix(total)
    information[3:, 3:] += np.trace(squares) * np.eye(3) - squares
    return information


def _turn_of(rotation: Array) -> Array:
    """(3,) of a rotation (3, 3)."""
    motion = np.eye(4)
    motion[:3, :3] = rotation
    return logarithm(motion)[3:]


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


class LidarOnlyFilter:
    """water: what the cloud in hand shows of it."""

    def __init__(self, water: WaterPlane) -> None:
        self._water = water
        self._normal: Array = np.zeros(3)
        self._height_m = 0.0
        self._levels = 0
        self._surface: tuple[Array, float] | None = None

    def resume(self) -> None:
        """Where the water was last is not known."""
        self._surface = None

    def predict(self, before: OdometryState | None, dt_s: float, motion: AutopilotMotion | None) -> OdometryState:
        """Even motion, rocking as the water shows."""
        if before is None:
            return OdometryState(np.eye(4), self._rocked(np.zeros(6)))
        pose = self._floated(before.pose_odom @ exponential(before.twist_frd * dt_s))
        self._surface = None
        return OdometryState(pose, self._rocked(before.twist_frd))

    def correct(self, guess: OdometryState, aligned: Array, solid_frd_m: Array, dt_s: float) -> OdometryState | None:
        """By fixed shares of the surprise."""
        surprise = logarithm(inverse(guess.pose_odom) @ aligned)
        if not float(np.linalg.norm(surprise[:3])) <= MOST_SURPRISE_MPS * dt_s:  # also when it is not a number
            return None
        pose = guess.pose_odom @ exponential(GAIN * surprise)
        return OdometryState(pose, self._rocked(guess.twist_frd + RATE_GAIN * surprise / dt_s))

    def hold_level(self, estimate: OdometryState, motion: AutopilotMotion | None) -> OdometryState:
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
        return OdometryState(levelled, estimate.twist_frd)

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
