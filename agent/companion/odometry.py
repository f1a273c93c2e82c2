"""Where the body has moved since the odometry began, from lidar clouds alone.

KISS-ICP (Vizzo et al., KISS-ICP: in defense of point-to-point ICP, IEEE RA-L 8(2), 2023) in the parts that its package
offers. Three things are different on a river. Prediction and the motion within a cloud go by the clock, so that a lost
cloud is a longer step and no jump, and a cloud that fits nowhere is refused before it gets into the map. A cloud holds
some hundred points that stand still and thousands on the water: these are thinned until they carry height and attitude
and cannot hold the vessel back. And with so few points a pose is noisy, so that it is weighed against the prediction.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.rigid import drifted, exponential, inverse, logarithm
from agent.companion.water_plane import WaterPlane

Array = NDArray[np.float64]
Points = NDArray[np.float32]

LEAST_POINTS = 30
"""That are not of the water."""
MOST_CLOUD_S = 1.0
"""A cloud takes no longer; a later point is damage."""
MOST_SURPRISE_MPS = 8.0
"""How far from what was predicted a pose may be for each second that went by. Vessels gain some m/s in a second."""
LOST_AFTER = 10
"""Clouds refused on end, after which the map is begun anew where the vessel should be by now."""
THRESHOLD_M = 0.5
"""Scale of the robust kernel; pairs are three times that apart at most. Fixed: the package's adaptive one stays at its
start, 2 m, as long as a vessel moves evenly, and in a sparse cloud joins what does not belong together."""
MOST_TURNS = 20
"""Of ICP a cloud. What they are after that is below the noise of a pose, and there may be hundreds."""
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


class OdometryError(Exception):
    """One sentence for the user: what is wrong with the odometry and what to do."""


class Placed(NamedTuple):
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
    is within max_range_m. poses, poses_refused: clouds that were placed, and not. points_refused: points that cannot
    be. restarts: how often the local map was begun anew.

    Raises OdometryError where KISS-ICP is not installed.
    """

    def __init__(self, max_range_m: float = 150.0, voxel_m: float = 1.0, min_range_m: float = 1.0) -> None:
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
        self._water = WaterPlane()
        self.poses = self.poses_refused = self.points_refused = self.restarts = 0
        self._refused_on_end = 0
        self._stamp_ns: int | None = None
        self._pose: Array = np.eye(4)
        self._twist: Array = np.zeros(6)
        self._normal: Array = np.zeros(3)
        self._height_m = 0.0
        self._levels = 0
        self._surface: tuple[Array, float] | None = None

    def register(self, stamp_ns: int, points_frd_m: Points, offset_s: Points) -> Placed | None:
        """Place a cloud that began at `stamp_ns`: (n, 3), each point offset_s (n,) later. None if it fits nowhere."""
        kept = self._good(points_frd_m, offset_s)
        points, offset = points_frd_m[kept], offset_s[kept]
        last_s = float(offset.max(initial=0.0))
        end_ns = stamp_ns + round(last_s * 1e9)
        lag_s = offset - np.float32(last_s)
        wet = self._water.of(points, lag_s)
        twist = self._rocked(self._twist)
        here = drifted(points, lag_s, twist)
        if np.count_nonzero(~wet) < LEAST_POINTS or (self._stamp_ns is not None and end_ns <= self._stamp_ns):
            self.poses_refused += 1
            return None
        solid, level = here[~wet].astype(np.float64), here[wet].astype(np.float64)
        if self._stamp_ns is not None:
            dt_s = (end_ns - self._stamp_ns) * 1e-9
            guess = self._floated(self._pose @ exponential(self._twist * dt_s))
            surprise = logarithm(inverse(guess) @ self._aligned(solid, level, guess))
            if not float(np.linalg.norm(surprise[:3])) <= MOST_SURPRISE_MPS * dt_s:  # also when it is not a number
                self._doubt(end_ns, guess, solid)
                return None
            self._pose = guess @ exponential(GAIN * surprise)
            self._twist = self._rocked(self._twist + RATE_GAIN * surprise / dt_s)
        self._pose = self._levelled(self._pose)
        self._map.update(self._kept_of(solid, level), self._pose)
        self._stamp_ns = end_ns
        self._refused_on_end = 0
        self.poses += 1
        kept[np.flatnonzero(kept)[wet]] = False
        self._remember()
        there = drifted(points[~wet], lag_s[~wet], self._twist)
        return Placed(end_ns, self._pose.copy(), self._twist[:3].copy(), there, kept)

    def pose_at(self, stamp_ns: int) -> Array | None:
        """(4, 4) at another instant, as if the vessel moved on as it does; None before the first pose."""
        if self._stamp_ns is None:
            return None
        pose: Array = self._pose @ exponential(self._twist * ((stamp_ns - self._stamp_ns) * 1e-9))
        return pose

    def _good(self, points_frd_m: Points, offset_s: Points) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore", over="ignore"):
            squared = np.einsum("ij,ij->i", points_frd_m, points_frd_m)
            sound = np.isfinite(squared) & (offset_s >= 0.0) & (offset_s <= MOST_CLOUD_S)
            least_m, most_m = self._range_m
            kept: NDArray[np.bool_] = sound & (squared >= least_m**2) & (squared <= most_m**2)
        self.points_refused += len(sound) - int(np.count_nonzero(sound))
        return kept

    def _aligned(self, solid: Array, level: Array, guess: Array) -> Array:
        """The pose of a cloud in the local map."""
        thinned = [self._thin(solid, 0.15 * self._voxel_m), self._thin(level, 1.5 * self._voxel_m)]
        pose: Array = self._registration.align_points_to_map(
            points=np.concatenate(thinned),
            voxel_map=self._map,
            initial_guess=guess,
            max_correspondance_distance=3.0 * THRESHOLD_M,
            kernel=THRESHOLD_M,
        )
        return pose

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

    def _remember(self) -> None:
        """Where the water is in the odometry's frame, by this cloud and its pose."""
        level = self._water.level
        self._surface = None
        if level is not None:
            normal = self._pose[:3, :3] @ level.normal_frd
            self._surface = (normal, level.down_m + float(normal @ self._pose[:3, 3]))

    def _levelled(self, pose: Array) -> Array:
        """The pose with its height and tilt a little nearer to what the water says, whose plane stays where it was."""
        level = self._water.level
        if level is None:
            return pose
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
        return levelled

    def _kept_of(self, solid: Array, level: Array) -> Array:
        """What of a cloud goes into the local map."""
        return np.concatenate([self._thin(solid, 0.1 * self._voxel_m), self._thin(level, 0.75 * self._voxel_m)])

    def _doubt(self, end_ns: int, guess: Array, solid: Array) -> None:
        """A cloud that does not fit; after many of them it is the map that does not."""
        self.poses_refused += 1
        self._surface = None
        self._refused_on_end += 1
        if self._refused_on_end >= LOST_AFTER:
            self._refused_on_end = 0
            self.restarts += 1
            self._map = self._new_map(self._config)
            self._map.update(solid, guess)
            self._pose, self._stamp_ns = guess, end_ns
