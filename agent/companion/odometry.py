"""Lidar odometry on water: the body's motion since the odometry began, from clouds and the autopilot's motion.

The method is KISS-ICP (Vizzo et al., KISS-ICP: in defense of point-to-point ICP, IEEE RA-L 8(2), 2023). It uses the
parts of the package, with three differences for a river:

- Prediction and deskewing use the clock. So a lost cloud is a longer step and not a jump. A cloud that does not fit is
  refused before it enters the map.
- Some hundred points of a cloud are static and thousands are on the water. The water points are thinned. They still
  carry height and attitude but cannot hold the vessel back.
- With so few points, a registered pose is weighted against the prediction, see odometry_filters.py.
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
    OdometryFilterState,
)
from agent.companion.rigid_motion import Array, Points, deskew, exponential
from agent.companion.settings import TUNED
from agent.companion.water_plane import WaterPlane

MotionSource = Callable[["int | None", int, int], "AutopilotMotion | None"]
"""Motion from the end of the last cloud to the end of this one, by (end before, begin, end) on the sensors' clock.

None if unknown.
"""

LONGEST_CLOUD_S = 1.0
"""A point with a later offset is invalid."""


def no_motion(before_ns: int | None, begin_ns: int, end_ns: int) -> AutopilotMotion | None:
    """Motion source of an odometry from clouds alone."""
    return None


class OdometryError(Exception):
    """Raised when the odometry cannot run. The message is one sentence with cause and remedy."""


class RegisteredCloud(NamedTuple):
    """A cloud at its pose."""

    stamp_ns: int
    """Instant of the cloud's last point."""
    pose_odom: Array
    """(4, 4), body FRD at that instant to the frame `odom`, which is body FRD at the first cloud's last point."""
    vel_frd_mps: Array
    """(3,)."""
    points_frd_m: Points
    """(m, 3), its valid points above the water, in body axes at that instant."""
    kept: NDArray[np.bool_]
    """(n,) mask of these points among the given points."""


class LidarOdometry:
    """Registers clouds in order of time. The same clouds give the same poses, bit for bit.

    max_range_m, min_range_m: range of the points that are used.
    voxel_m: edge of the cells of the local map, which covers max_range_m.
    motion: body motion from the autopilot; without it, only clouds are used.

    Raises OdometryError if KISS-ICP is not installed.
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
        config.registration.max_num_iterations = TUNED.icp_iterations
        config.registration.max_num_threads = 1  # fixed order of sums; the other core is for the simulation
        self._new_map: Callable[[], Any] = lambda: get_voxel_hash_map(config)
        self._down_sample: Any = voxel_down_sample
        self._registration: Any = get_registration(config)
        self._local_map = self._new_map()
        self._voxel_m = voxel_m
        self._range_m = (min_range_m, max_range_m)
        self._motion = motion
        self._water = WaterPlane()
        self._aided, self._lidar_only = AidedFilter(self._water), LidarOnlyFilter(self._water)
        self._filter: OdometryFilter = self._lidar_only
        self.poses = self.poses_refused = 0
        """Number of registered and of refused clouds."""
        self.unaided = 0
        """Number of clouds without a motion."""
        self.points_refused = 0
        """Number of points that are not finite or invalid."""
        self.restarts = 0
        """Number of restarts of the local map."""
        self._refused_in_a_row = 0
        self._end_ns: int | None = None  # end of the last cloud with a state
        self._state: OdometryFilterState | None = None

    def register(self, stamp_ns: int, points_frd_m: Points, offset_s: Points) -> RegisteredCloud | None:
        """Register a cloud that began at `stamp_ns`: points (n, 3), each offset_s (n,) later.

        Return None if it does not fit.
        """
        # Keep the valid points, with their time before the end of the cloud
        with np.errstate(invalid="ignore", over="ignore"):
            squared = np.einsum("ij,ij->i", points_frd_m, points_frd_m)
            sound = np.isfinite(squared) & (offset_s >= 0.0) & (offset_s <= LONGEST_CLOUD_S)
            least_m, most_m = self._range_m
            kept: NDArray[np.bool_] = sound & (squared >= least_m**2) & (squared <= most_m**2)
        self.points_refused += len(sound) - int(np.count_nonzero(sound))
        points, offset = points_frd_m[kept], offset_s[kept]
        last_s = float(offset.max(initial=0.0))
        end_ns, lag_s = stamp_ns + round(last_s * 1e9), offset - np.float32(last_s)
        if self._end_ns is not None and end_ns <= self._end_ns:
            self.poses_refused += 1
            return None

        # Get the body motion since the last cloud from the autopilot
        motion = self._motion(self._end_ns, stamp_ns, end_ns)
        self.unaided += motion is None

        # Separate points on the water from solid ones
        wet = self._water.water_mask(points, lag_s)
        if motion is not None:
            wet |= self._water.crest_mask(points, lag_s, motion.attitude_ned[2], motion.rate_frd_radps)
        too_few = np.count_nonzero(~wet) < TUNED.odometry_points
        if too_few and (motion is None or self._state is None):
            self.poses_refused += 1
            return None

        # Predict the state at the end of the cloud
        dt_s = 0.0 if self._end_ns is None else (end_ns - self._end_ns) * 1e-9
        chosen: OdometryFilter = self._lidar_only if motion is None else self._aided
        if chosen is not self._filter:
            self._filter = chosen
            chosen.resume()
        predicted = self._filter.predict(self._state, dt_s, motion)
        if too_few:
            self._refuse(end_ns, predicted, motion)
            return None

        # Deskew the cloud by the predicted motion
        deskewed = deskew(points, lag_s, predicted.twist_frd)
        solid, water = deskewed[~wet].astype(np.float64), deskewed[wet].astype(np.float64)

        # Align it with the local map, and correct the prediction by the aligned pose
        corrected: OdometryFilterState | None = predicted
        if self._state is not None:
            thinned = self._down_sample(solid, TUNED.icp_voxel_share * self._voxel_m)
            aligned = self._align(thinned, water, predicted.pose_odom)
            corrected = self._filter.correct(predicted, aligned, thinned, dt_s)
        if corrected is None:
            self._refuse_misfit(end_ns, predicted, motion, solid)
            return None

        # Hold the state to the water level, and update the local map
        self._end_ns, self._state = end_ns, self._filter.hold_level(corrected, motion)
        cell_m, water_cell_m = TUNED.map_voxel_share * self._voxel_m, TUNED.map_water_voxel_share * self._voxel_m
        thinned = np.concatenate([self._down_sample(solid, cell_m), self._down_sample(water, water_cell_m)])
        self._local_map.update(thinned, self._state.pose_odom)
        self._refused_in_a_row = 0
        self.poses += 1

        # Return the solid points, deskewed by the corrected motion
        kept[np.flatnonzero(kept)[wet]] = False
        pose, twist = self._state
        return RegisteredCloud(end_ns, pose.copy(), twist[:3].copy(), deskew(points[~wet], lag_s[~wet], twist), kept)

    def pose_at(self, stamp_ns: int) -> Array | None:
        """Pose (4, 4) at another instant, at constant twist from the last pose. None before the first."""
        if self._end_ns is None or self._state is None:
            return None
        pose: Array = self._state.pose_odom @ exponential(self._state.twist_frd * ((stamp_ns - self._end_ns) * 1e-9))
        return pose

    def _align(self, thinned: Array, water: Array, guess: Array) -> Array:
        """Align a cloud with the local map by ICP from a guess (4, 4). Return its pose (4, 4)."""
        thinned_water = self._down_sample(water, TUNED.icp_water_voxel_share * self._voxel_m)
        pose: Array = self._registration.align_points_to_map(
            points=np.concatenate([thinned, thinned_water]),
            voxel_map=self._local_map,
            initial_guess=guess,
            max_correspondance_distance=3.0 * TUNED.icp_threshold_m,
            kernel=TUNED.icp_threshold_m,
        )
        return pose

    def _refuse(self, end_ns: int, predicted: OdometryFilterState, motion: AutopilotMotion | None) -> None:
        """Refuse a cloud that does not determine the pose. The autopilot's motion propagates the state."""
        self.poses_refused += 1
        if motion is not None:
            self._end_ns, self._state = end_ns, self._filter.hold_level(predicted, motion)

    def _refuse_misfit(
        self, end_ns: int, predicted: OdometryFilterState, motion: AutopilotMotion | None, solid: Array
    ) -> None:
        """Refuse a cloud that does not fit the local map.

        After many in a row, the map restarts at the predicted pose.
        """
        self._refuse(end_ns, predicted, motion)
        self._refused_in_a_row += 1
        if self._refused_in_a_row >= TUNED.odometry_clouds_lost:
            self._refused_in_a_row = 0
            self.restarts += 1
            self._local_map = self._new_map()
            if motion is None:
                self._end_ns, self._state = end_ns, predicted
            assert self._state is not None
            self._local_map.update(solid, self._state.pose_odom)
