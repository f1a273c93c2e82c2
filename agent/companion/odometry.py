"""Where the body has moved since the odometry began, from lidar clouds, and from what the autopilot says of its motion.

KISS-ICP (Vizzo et al., KISS-ICP: in defense of point-to-point ICP, IEEE RA-L 8(2), 2023) in the parts that its package
offers. Three things are different on a river. Prediction and the motion within a cloud go by the clock, so that a lost
cloud is a longer step and no jump, and a cloud that fits nowhere is refused before it gets into the map. A cloud holds
some hundred points that stand still and thousands on the water: these are thinned until they carry height and attitude
and cannot hold the vessel back. And with so few points a pose is weighed against the prediction: with the autopilot's
attitude and velocity (inertial.py) where they are told, else by the clouds alone (lidar_only.py).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.odometry_filters import (
    AidedFilter,
    AutopilotMotion,
    LidarOnlyFilter,
    OdometryFilter,
    OdometryState,
)
from agent.companion.rigid_motion import drifted, exponential
from agent.companion.water_plane import WaterPlane

Array = NDArray[np.float64]
Points = NDArray[np.float32]
MotionSource = Callable[["int | None", int, int], "AutopilotMotion | None"]
"""Of the end of the cloud before and begin and end of this one, on the sensors' clock; None where it is not known."""

LEAST_POINTS = 30
"""That are not of the water."""
MOST_CLOUD_S = 1.0
"""A cloud takes no longer; a later point is damage."""
LOST_AFTER = 10
"""Clouds refused on end, after which the map is begun anew where the vessel should be by now."""
THRESHOLD_M = 0.5
"""Scale of the robust kernel; pairs are three times that apart at most. Fixed: the package's adaptive one stays at its
start, 2 m, as long as a vessel moves evenly, and in a sparse cloud joins what does not belong together."""
MOST_TURNS = 20
"""Of ICP a cloud. What they are after that is below the noise of a pose, and there may be hundreds."""


def no_motion(before_ns: int | None, begin_ns: int, end_ns: int) -> AutopilotMotion | None:
    """Of an odometry by clouds alone."""
    return None


class OdometryError(Exception):
    """One sentence for the user: what is wrong with the odometry and what to do."""


class RegisteredCloud(NamedTuple):
    """A cloud in its place.

    stamp_ns: of the cloud's last point. pose_odom: (4, 4), body FRD at that instant to the frame `odom`, which is body
    FRD at the first cloud's last point. vel_frd_mps: (3,). points_frd_m: (m, 3), where its good points above the water
    lie seen from the body at that instant. kept: (n,) which of the given points these are.
    """

    stamp_ns: int
    pose_odom: Array
    vel_frd_mps: Array
    points_frd_m: Points
    kept: NDArray[np.bool_]


class LidarOdometry:
    """Takes clouds in order of time; the same clouds give the same poses, bit for bit.

    max_range_m, min_range_m: of the points that are used. voxel_m: edge of the cells of the local map, which keeps what
    is within max_range_m. motion: what the autopilot says of how the body moved; without it, clouds alone count.
    poses, poses_refused: clouds that were placed, and not. unaided: clouds without a motion. points_refused: points
    that cannot be. restarts: how often the local map was begun anew.

    Raises OdometryError where KISS-ICP is not installed.
    """

    def __init__(
        self,
        max_range_m: float = 150.0,
        voxel_m: float = 1.0,
        min_range_m: float = 1.0,
        motion: MotionSource = no_motion,
    ) -> None:
        try:
            from kiss_icp.config import KISSConfig  # type: ignore[import-untyped]
            from kiss_icp.mapping import get_voxel_hash_map  # type: ignore[import-untyped]
            from kiss_icp.registration import get_registration  # type: ignore[import-untyped]
            from kiss_icp.voxelization import voxel_down_sample  # type: ignore[import-untyped]
        except ImportError as error:
            raise OdometryError(
                f"the odometry needs KISS-ICP, which cannot be loaded ({error}); pip install 'xitl[perception]'"
            ) from error
        config = KISSConfig()
        config.data.max_range, config.data.min_range = max_range_m, min_range_m
        config.mapping.voxel_size = voxel_m
        config.registration.max_num_iterations = MOST_TURNS
        config.registration.max_num_threads = 1  # sums in one order, and the other core is the simulation's
        self._config = config
        self._new_map: Any = get_voxel_hash_map
        self._thin: Any = voxel_down_sample
        self._registration: Any = get_registration(config)
        self._map: Any = self._new_map(config)
        self._voxel_m = voxel_m
        self._range_m = (min_range_m, max_range_m)
        self._motion = motion
        self._water = WaterPlane()
        self._inertial, self._lidar_only = AidedFilter(self._water), LidarOnlyFilter(self._water)
        self._filter: OdometryFilter = self._lidar_only
        self.poses = self.poses_refused = self.unaided = self.points_refused = self.restarts = 0
        self._refused_on_end = 0
        self._stamp_ns: int | None = None
        self._at: OdometryState | None = None

    def register(self, stamp_ns: int, points_frd_m: Points, offset_s: Points) -> RegisteredCloud | None:
        """Place a cloud that began at `stamp_ns`: (n, 3), each point offset_s (n,) later. None if it fits nowhere."""
        kept = self._good(points_frd_m, offset_s)
        points, offset = points_frd_m[kept], offset_s[kept]
        last_s = float(offset.max(initial=0.0))
        end_ns = stamp_ns + round(last_s * 1e9)
        lag_s = offset - np.float32(last_s)
        before_ns = self._stamp_ns
        if before_ns is not None and end_ns <= before_ns:
            self.poses_refused += 1
            return None
        motion = self._motion(before_ns, stamp_ns, end_ns)
        self.unaided += motion is None
        wet = self._water.water_mask(points, lag_s)
        if motion is not None:
            wet |= self._water.crest_mask(points, lag_s, motion.attitude_ned[2], motion.rate_frd_radps)
        few = np.count_nonzero(~wet) < LEAST_POINTS
        if few and (motion is None or self._at is None):
            self.poses_refused += 1
            return None
        dt_s = 0.0 if before_ns is None else (end_ns - before_ns) * 1e-9
        guess = self._chosen(motion).predict(self._at, dt_s, motion)
        if few:
            self._carry_on(end_ns, guess, motion)
            return None
        here = drifted(points, lag_s, guess.twist_frd)
        solid, level = here[~wet].astype(np.float64), here[wet].astype(np.float64)
        found: OdometryState | None = guess
        if self._at is not None:
            thin = self._thin(solid, 0.15 * self._voxel_m)
            aligned = self._aligned(thin, level, guess.pose_odom)
            found = self._filter.correct(guess, aligned, thin, dt_s)
        if found is None:
            self._doubt(end_ns, guess, motion, solid)
            return None
        self._stamp_ns, self._at = end_ns, self._filter.hold_level(found, motion)
        self._map.update(self._kept_of(solid, level), self._at.pose_odom)
        self._refused_on_end = 0
        self.poses += 1
        kept[np.flatnonzero(kept)[wet]] = False
        there = drifted(points[~wet], lag_s[~wet], self._at.twist_frd)
        return RegisteredCloud(end_ns, self._at.pose_odom.copy(), self._at.twist_frd[:3].copy(), there, kept)

    def pose_at(self, stamp_ns: int) -> Array | None:
        """(4, 4) at another instant, as if the vessel moved on as it does; None before the first pose."""
        if self._stamp_ns is None or self._at is None:
            return None
        pose: Array = self._at.pose_odom @ exponential(self._at.twist_frd * ((stamp_ns - self._stamp_ns) * 1e-9))
        return pose

    def _chosen(self, motion: AutopilotMotion | None) -> OdometryFilter:
        chosen: OdometryFilter = self._lidar_only if motion is None else self._inertial
        if chosen is not self._filter:
            self._filter = chosen
            chosen.resume()
        return chosen

    def _good(self, points_frd_m: Points, offset_s: Points) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore", over="ignore"):
            squared = np.einsum("ij,ij->i", points_frd_m, points_frd_m)
            sound = np.isfinite(squared) & (offset_s >= 0.0) & (offset_s <= MOST_CLOUD_S)
            least_m, most_m = self._range_m
            kept: NDArray[np.bool_] = sound & (squared >= least_m**2) & (squared <= most_m**2)
        self.points_refused += len(sound) - int(np.count_nonzero(sound))
        return kept

    def _aligned(self, thin: Array, level: Array, guess: Array) -> Array:
        """The pose of a cloud in the local map."""
        pose: Array = self._registration.align_points_to_map(
            points=np.concatenate([thin, self._thin(level, 1.5 * self._voxel_m)]),
            voxel_map=self._map,
            initial_guess=guess,
            max_correspondance_distance=3.0 * THRESHOLD_M,
            kernel=THRESHOLD_M,
        )
        return pose

    def _kept_of(self, solid: Array, level: Array) -> Array:
        """What of a cloud goes into the local map."""
        return np.concatenate([self._thin(solid, 0.1 * self._voxel_m), self._thin(level, 0.75 * self._voxel_m)])

    def _carry_on(self, end_ns: int, guess: OdometryState, motion: AutopilotMotion | None) -> None:
        """A cloud that says nothing of where the vessel is; the autopilot's motion does for a while."""
        self.poses_refused += 1
        if motion is not None:
            self._stamp_ns, self._at = end_ns, self._filter.hold_level(guess, motion)

    def _doubt(self, end_ns: int, guess: OdometryState, motion: AutopilotMotion | None, solid: Array) -> None:
        """A cloud that does not fit; after many of them it is the map that does not."""
        self._carry_on(end_ns, guess, motion)
        self._refused_on_end += 1
        if self._refused_on_end >= LOST_AFTER:
            self._refused_on_end = 0
            self.restarts += 1
            self._map = self._new_map(self._config)
            if motion is None:
                self._stamp_ns, self._at = end_ns, guess
            assert self._at is not None
            self._map.update(solid, self._at.pose_odom)
