"""Prediction and correction of the odometry's pose: aided by the autopilot, or from the clouds alone.

`AidedFilter` is an error-state Kalman filter. A vessel that avoids an obstacle faces open water for seconds. A lidar
then has no information on the vessel's rotation, but its autopilot has. It measures the rotation since the last cloud
by gyroscopes, down by gravity, and the change of velocity. The autopilot's position is not used. The errors (9,) are of
position, attitude and velocity, all in the odometry's frame. The attitude error is a rotation of that frame (Sola,
Quaternion kinematics for the error-state Kalman filter, arXiv:1711.02508, sec. 7).

`LidarOnlyFilter` is an alpha-beta filter: constant velocity, with roll and pitch from the water plane.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from agent.companion.pose_history import PoseHistory, VehiclePose
from agent.companion.rigid_motion import Array, cross_matrix, exponential, inverse, logarithm, rotation_vector
from agent.companion.settings import TUNED
from agent.companion.water_plane import WaterPlane


class AutopilotMotion(NamedTuple):
    """Body motion from one cloud's end to the next, from the autopilot."""

    turned: Array
    """(3, 3): from the present body axes to the earlier body axes."""
    rate_frd_radps: Array
    """(3,): mean over the time of this cloud."""
    attitude_ned: Array
    """(3, 3): body to NED now."""
    vel_ned_mps: Array
    """(3,) now."""
    gained_ned_mps: Array
    """(3,): change of velocity since the last cloud."""


class OdometryFilterState(NamedTuple):
    """State of the filter."""

    pose_odom: Array
    """(4, 4): body FRD to the odometry's frame."""
    twist_frd: Array
    """(6,): velocity and rates in the body."""


class OdometryFilter(Protocol):
    """Predicts and corrects the state. Called in this order for each cloud."""

    def resume(self) -> None:
        """Reset the uncertainty, because another filter processed the last cloud or there was none."""

    def predict(
        self, before: OdometryFilterState | None, dt_s: float, motion: AutopilotMotion | None
    ) -> OdometryFilterState:
        """Predict the state at the cloud's end. before: None for the first cloud."""

    def correct(
        self, guess: OdometryFilterState, aligned: Array, solid_frd_m: Array, dt_s: float
    ) -> OdometryFilterState | None:
        """Correct the state by the registered pose (4, 4) of the points (n, 3). Return None if that pose is refused."""

    def hold_level(self, estimate: OdometryFilterState, motion: AutopilotMotion | None) -> OdometryFilterState:
        """Hold the height and tilt of the state to the water level, and to the autopilot's down direction."""


def _diagonal(place: float, attitude: float, velocity: float) -> Array:
    """Covariance (9, 9) of position, attitude and velocity, from their variances."""
    return np.diag([place] * 3 + [attitude] * 3 + [velocity] * 3)


_INITIAL = _diagonal(TUNED.aided_initial_place_m2, TUNED.aided_initial_turn_rad2, TUNED.aided_initial_vel_m2ps2)
_RESUMED = _diagonal(
    TUNED.aided_resumed_place_m2, np.radians(TUNED.aided_resumed_turn_deg) ** 2, TUNED.aided_initial_vel_m2ps2
)
_PROCESS = _diagonal(
    TUNED.aided_process_place_m**2, np.radians(TUNED.aided_process_turn_deg) ** 2, TUNED.aided_process_vel_mps**2
)  # added per second
_REGISTRATION = np.diag(
    np.array(
        [TUNED.aided_registration_m] * 3 + [TUNED.aided_registration_tilt_rad] * 2 + [TUNED.aided_registration_yaw_rad]
    )
    ** 2
)
_GAIN = np.array(TUNED.lidar_only_gains)
_RATE_GAIN = _GAIN**2 / (2.0 - _GAIN)  # the beta for this alpha (Benedict and Bordner, IRE Trans. AC-7, 1962)
_NOTHING = 1e-9  # registration returns the prediction when it matched no points
_DOWN = np.array([0.0, 0.0, 1.0])


class _AutopilotSample(NamedTuple):
    epoch: int
    end_ns: int
    steady: Array
    pose: VehiclePose


class AutopilotMotionSource:
    """Motions from an autopilot's pose history.

    own_ns: converts the sensors' clock to the history's clock.

    Each motion begins at the pose at which the last one ended, as estimated then. So errors of extrapolation cancel.
    """

    def __init__(self, history: PoseHistory, own_ns: Callable[[int], int]) -> None:
        self._history = history
        self._own_ns = own_ns
        self._last: _AutopilotSample | None = None

    def motion_between(self, before_ns: int | None, begin_ns: int, end_ns: int) -> AutopilotMotion | None:
        """Motion from the end of the last cloud (None: there was none) to the end of this one. None if unknown."""
        now, began = self._sample_at(end_ns), self._history.steady_attitude_at(self._own_ns(begin_ns))
        if now is None or began is None:
            return None
        then: _AutopilotSample | None = now
        if before_ns is not None:
            last = self._last
            continued = last is not None and last.end_ns == before_ns and last.epoch == now.epoch
            then = last if continued else self._sample_at(before_ns)
        if then is None:
            return None
        self._last = now
        rate = rotation_vector(began.T @ now.steady) / max((end_ns - begin_ns) * 1e-9, 1e-3)
        vel_mps = now.pose.vel_ned_mps
        gained_mps = vel_mps - then.pose.vel_ned_mps
        return AutopilotMotion(then.steady.T @ now.steady, rate, now.pose.rot_ned_frd, vel_mps, gained_mps)

    def _sample_at(self, stamp_ns: int) -> _AutopilotSample | None:
        own_ns = self._own_ns(stamp_ns)
        pose, steady = self._history.pose_at(own_ns), self._history.steady_attitude_at(own_ns)
        if pose is None or steady is None:
            return None
        return _AutopilotSample(self._history.epoch, stamp_ns, steady, pose)


class AidedFilter:
    """Error-state Kalman filter on the autopilot's motion. water: the water plane of the present cloud."""

    def __init__(self, water: WaterPlane) -> None:
        self._water = water
        self._covariance: Array = _INITIAL  # (9, 9)
        self._down: Array = np.zeros(3)
        self._downs = 0
        self._height_m = 0.0
        self._heights = 0

    def resume(self) -> None:
        self._covariance = _RESUMED

    def predict(
        self, before: OdometryFilterState | None, dt_s: float, motion: AutopilotMotion | None
    ) -> OdometryFilterState:
        assert motion is not None
        if before is None:
            self._covariance = _INITIAL
            return OdometryFilterState(np.eye(4), _twist(np.eye(3), motion.attitude_ned.T @ motion.vel_ned_mps, motion))
        earlier = before.pose_odom[:3, :3]
        pose = before.pose_odom.copy()
        pose[:3, :3] = earlier @ motion.turned
        gained_mps = pose[:3, :3] @ motion.attitude_ned.T @ motion.gained_ned_mps
        doubted = float(np.linalg.norm(gained_mps)) > TUNED.aided_most_gain_mps2 * dt_s
        if doubted:
            gained_mps = np.zeros(3)
        vel_mps = earlier @ before.twist_frd[:3]
        pose[:3, 3] += (vel_mps + 0.5 * gained_mps) * dt_s
        transition = np.eye(9)
        transition[:3, 6:] = dt_s * np.eye(3)
        transition[6:, 3:6] = -cross_matrix(gained_mps)
        transition[:3, 3:6] = 0.5 * dt_s * transition[6:, 3:6]
        self._covariance = transition @ self._covariance @ transition.T + _PROCESS * dt_s
        if doubted:
            self._covariance[6:, 6:] += TUNED.aided_doubted_mps**2 * np.eye(3)
        return OdometryFilterState(pose, _twist(pose[:3, :3], vel_mps + gained_mps, motion))

    def correct(
        self, guess: OdometryFilterState, aligned: Array, solid_frd_m: Array, dt_s: float
    ) -> OdometryFilterState | None:
        """Weight the correction by the information of the registered points."""
        turn = rotation_vector(aligned[:3, :3] @ guess.pose_odom[:3, :3].T)
        residual = np.concatenate([aligned[:3, 3] - guess.pose_odom[:3, 3], turn])
        place_m2, turn_rad2 = np.trace(self._covariance[:3, :3]), np.trace(self._covariance[3:6, 3:6])
        most_m = TUNED.aided_gate_m + TUNED.aided_gate_deviations * place_m2**0.5
        most_rad = TUNED.aided_gate_rad + TUNED.aided_gate_deviations * turn_rad2**0.5
        if not (float(np.linalg.norm(residual[:3])) <= most_m and float(np.linalg.norm(turn)) <= most_rad):
            return None
        if float(np.linalg.norm(residual)) < _NOTHING:
            return guess
        information = _information(solid_frd_m @ guess.pose_odom[:3, :3].T)
        noise = (TUNED.aided_point_m**2 * np.linalg.inv(information) + _REGISTRATION).astype(np.float64)
        return self._observed(guess, np.eye(6, 9), residual, noise)

    def hold_level(self, estimate: OdometryFilterState, motion: AutopilotMotion | None) -> OdometryFilterState:
        assert motion is not None
        down = estimate.pose_odom[:3, :3] @ motion.attitude_ned.T @ _DOWN
        if self._downs < TUNED.aided_reference_clouds:
            self._downs += 1
            self._down = self._down + (down - self._down) / self._downs
        reference = self._down / np.linalg.norm(self._down)
        level_axes = np.linalg.svd(reference[None])[2][1:]
        jacobian = np.zeros((2, 9))
        jacobian[:, 3:6] = level_axes
        tilt, tilt_noise = level_axes @ np.cross(down, reference), TUNED.aided_down_rad**2 * np.eye(2)
        estimate = self._observed(estimate, jacobian, tilt, tilt_noise)
        level = self._water.level
        if level is None:
            return estimate
        height_m = level.down_m + float(reference @ estimate.pose_odom[:3, 3])
        if self._heights < TUNED.aided_reference_clouds:
            self._heights += 1
            self._height_m += (height_m - self._height_m) / self._heights
        jacobian = np.zeros((1, 9))
        jacobian[0, :3] = reference
        off_m, height_noise = np.array([self._height_m - height_m]), TUNED.aided_height_m**2 * np.eye(1)
        return self._observed(estimate, jacobian, off_m, height_noise)

    def _observed(
        self, estimate: OdometryFilterState, jacobian: Array, residual: Array, noise: Array
    ) -> OdometryFilterState:
        """Return the state after an observation (k,).

        noise: covariance (k, k).
        jacobian: (k, 9) with respect to the errors.
        """
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
        return OdometryFilterState(pose, twist)


def _twist(rot_odom_frd: Array, vel_odom_mps: Array, motion: AutopilotMotion) -> Array:
    return np.concatenate([rot_odom_frd.T @ vel_odom_mps, motion.rate_frd_radps])


def _information(around_m: Array) -> Array:
    """Information (6, 6) of points (n, 3) around the body on its position and attitude, each with weight one.

    These are the normal equations of point-to-point registration. Unobservable directions are nearly zero.
    """
    total, squares = around_m.sum(axis=0), around_m.T @ around_m
    information = 1e-3 * np.eye(6)
    information[:3, :3] += len(around_m) * np.eye(3)
    information[:3, 3:] = -cross_matrix(total)
    information[3:, :3] = cross_matrix(total)
    information[3:, 3:] += np.trace(squares) * np.eye(3) - squares
    return information


class LidarOnlyFilter:
    """Alpha-beta filter without the autopilot. water: the water plane of the present cloud."""

    def __init__(self, water: WaterPlane) -> None:
        self._water = water
        self._normal: Array = np.zeros(3)
        self._height_m = 0.0
        self._levels = 0
        self._surface: tuple[Array, float] | None = None

    def resume(self) -> None:
        self._surface = None

    def predict(
        self, before: OdometryFilterState | None, dt_s: float, motion: AutopilotMotion | None
    ) -> OdometryFilterState:
        if before is None:
            return OdometryFilterState(np.eye(4), self._rocked(np.zeros(6)))
        pose = self._floated(before.pose_odom @ exponential(before.twist_frd * dt_s))
        self._surface = None
        return OdometryFilterState(pose, self._rocked(before.twist_frd))

    def correct(
        self, guess: OdometryFilterState, aligned: Array, solid_frd_m: Array, dt_s: float
    ) -> OdometryFilterState | None:
        surprise = logarithm(inverse(guess.pose_odom) @ aligned)
        most_m = TUNED.lidar_only_surprise_mps * dt_s
        if not float(np.linalg.norm(surprise[:3])) <= most_m:  # also true for NaN
            return None
        pose = guess.pose_odom @ exponential(_GAIN * surprise)
        return OdometryFilterState(pose, self._rocked(guess.twist_frd + _RATE_GAIN * surprise / dt_s))

    def hold_level(self, estimate: OdometryFilterState, motion: AutopilotMotion | None) -> OdometryFilterState:
        level = self._water.level
        if level is None:
            return estimate
        pose = estimate.pose_odom
        normal, down_m = pose[:3, :3] @ level.normal_frd, level.down_m
        height_m = down_m + float(normal @ pose[:3, 3])
        if self._levels < TUNED.lidar_only_reference_clouds:
            share = 1.0 / (self._levels + 1)
            self._normal = self._normal + share * (normal - self._normal)
            self._height_m += share * (height_m - self._height_m)
            self._levels += 1
        reference = self._normal / np.linalg.norm(self._normal)
        turn = np.concatenate([np.zeros(3), TUNED.lidar_only_level_gain * np.cross(normal, reference)])
        levelled = pose.copy()
        levelled[:3, :3] = exponential(turn)[:3, :3] @ pose[:3, :3]
        off_m = self._height_m - down_m - float(reference @ pose[:3, 3])
        levelled[:3, 3] += TUNED.lidar_only_height_gain * off_m * reference
        normal = levelled[:3, :3] @ level.normal_frd
        self._surface = (normal, down_m + float(normal @ levelled[:3, 3]))
        return OdometryFilterState(levelled, estimate.twist_frd)

    def _rocked(self, twist: Array) -> Array:
        """Twist (6,) with the roll and pitch rates of this cloud's water plane, if visible, and without heave.

        Heave of some cm per second is below the accuracy of the prediction.
        """
        level = self._water.level
        if level is None:
            return twist
        normal = level.normal_frd
        rocked = twist.copy()
        rocked[:3] -= (normal @ twist[:3]) * normal
        rocked[3:] = TUNED.lidar_only_rocking_gain * level.turn_frd_radps + (normal @ twist[3:]) * normal
        return rocked

    def _floated(self, guess: Array) -> Array:
        """Tilt and lift a predicted pose so that the water plane matches that of the last cloud."""
        level, before = self._water.level, self._surface
        if level is None or before is None:
            return guess
        normal, last_normal = guess[:3, :3] @ level.normal_frd, before[0]
        turn = np.concatenate([np.zeros(3), np.cross(normal, last_normal)])
        floated = guess.copy()
        floated[:3, :3] = exponential(turn)[:3, :3] @ guess[:3, :3]
        floated[:3, 3] += (before[1] - level.down_m - float(last_normal @ guess[:3, 3])) * last_normal
        return floated
