"""Camera fusion: associates the detections of cameras with the tracks of the lidar, so that an obstacle has a class.

A detection gives a bearing and, by its lower edge at the waterline, a depression. For each image, pairs of a detection
and a track are compared in both angles, with the pose of the image's instant. A pair whose squared distance in standard
deviations is beyond GATE is not associated. The nearest pairs are associated first, each detection and each track
once. GATE is the 99 % quantile of the chi-squared distribution with two degrees of freedom (Bar-Shalom, Li and
Kirubarajan 2001, "Estimation with Applications to Tracking and Navigation", 1.4.17).

The class of a track is the one with the most evidence: the sum of the confidences, in which older images fade.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.companion.pose_history import PoseHistory, VehiclePose
from agent.companion.tracking import ObstacleTrack

Array = NDArray[np.float64]

GATE = 9.21
ANGLE_RAD = math.radians(1.0)
"""Standard deviation of an angle between image and track: attitude of the autopilot, mount, and edge of the box."""
PLACE_M = 0.5
"""Standard deviation of the waterline of a track. The lidar sees the near side of an object, the camera all of it."""
FADE = 0.95
"""Weight of the evidence after one more image with the track."""
FEWEST_IMAGES = 3
"""Images with a track before it has a class."""
MOST_WAITING = 512
"""Detections that may wait for the pose of their instant."""
KEPT_NS = 2_000_000_000


class ImageDetection(NamedTuple):
    """An object in an image. Angles are in the body's axes: forward, right, down."""

    stamp_ns: int
    position_frd_m: Array
    """Position of the camera, (3,)."""
    bearing_rad: float
    """Clockwise from the bow."""
    width_rad: float
    bottom_rad: float
    """Elevation of the lower edge, up positive."""
    confidence: float
    label: str

    @classmethod
    def from_message(cls, message: Any, stamp_ns: int) -> ImageDetection:
        """Return the detection of an XITL_DETECTION, at an instant of this machine's clock."""
        place = np.array(message.position, dtype=np.float64)
        label = str(message.label)
        return cls(stamp_ns, place, message.bearing, message.width, message.bottom, message.confidence, label)

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        numbers = (self.bearing_rad, self.width_rad, self.bottom_rad, self.confidence)
        return all(map(math.isfinite, numbers)) and bool(np.isfinite(self.position_frd_m).all())


class CameraFusion:
    """Classes of tracks by the detections of cameras.

    waterline_m: depth of the water level below the body's origin.
    """

    def __init__(self, waterline_m: float) -> None:
        self.received = self.matched = self.dropped = 0
        self.early = 0  # those dropped before the first pose
        self._begun = False
        self._waterline_m = waterline_m
        self._waiting: deque[ImageDetection] = deque()
        self._evidence: dict[int, dict[str, float]] = {}
        self._images: dict[int, int] = {}

    def add(self, detection: ImageDetection) -> None:
        """Add a detection. Those of an image have the same instant and follow each other."""
        self.received += 1
        if not detection.is_finite or not detection.label:
            self.dropped += 1
            return
        self._waiting.append(detection)
        if len(self._waiting) > MOST_WAITING:
            self._waiting.popleft()
            self.dropped += 1

    def update(self, history: PoseHistory, tracks: Sequence[ObstacleTrack]) -> None:
        """Associate the detections of all images whose pose is known with the confirmed tracks."""
        newest_ns = history.newest_ns
        while self._waiting:
            stamp_ns = self._waiting[0].stamp_ns
            if newest_ns is None or newest_ns < stamp_ns <= newest_ns + KEPT_NS:
                break
            image = []
            while self._waiting and self._waiting[0].stamp_ns == stamp_ns:
                image.append(self._waiting.popleft())
            pose = history.pose_at(stamp_ns)
            if pose is None:
                self.dropped += len(image)
                self.early += 0 if self._begun else len(image)
            else:
                self._begun = True
                self._associate(image, tracks, pose)
        known = {track.number for track in tracks}
        for number in self._evidence.keys() - known:
            del self._evidence[number], self._images[number]

    def class_of(self, number: int) -> tuple[str, float]:
        """Return the class of a track, and its share of the evidence; an empty text and 0 for none."""
        if self._images.get(number, 0) < FEWEST_IMAGES:
            return "", 0.0
        evidence = self._evidence[number]
        label = max(sorted(evidence), key=evidence.__getitem__)
        return label, evidence[label] / sum(evidence.values())

    def _associate(self, image: Sequence[ImageDetection], tracks: Sequence[ObstacleTrack], pose: VehiclePose) -> None:
        pairs = [
            (distance, row, column)
            for row, detection in enumerate(image)
            for column, track in enumerate(tracks)
            for distance in [self._distance(detection, track, pose)]
            if distance < GATE
        ]
        free_rows, free_columns = set(range(len(image))), set(range(len(tracks)))
        for _, row, column in sorted(pairs):
            if row in free_rows and column in free_columns:
                free_rows.remove(row)
                free_columns.remove(column)
                self._note(tracks[column].number, image[row])

    def _note(self, number: int, detection: ImageDetection) -> None:
        self.matched += 1
        self._images[number] = self._images.get(number, 0) + 1
        evidence = self._evidence.setdefault(number, {})
        for label in evidence:
            evidence[label] *= FADE
        evidence[detection.label] = evidence.get(detection.label, 0.0) + detection.confidence

    def _distance(self, detection: ImageDetection, track: ObstacleTrack, pose: VehiclePose) -> float:
        """Squared distance of a detection from a track, in standard deviations of bearing and depression."""
        camera_ned_m = pose.pos_ned_m + pose.rot_ned_frd @ detection.position_frd_m
        height_m = float(pose.pos_ned_m[2]) + self._waterline_m - float(camera_ned_m[2])
        off = track.position_at(detection.stamp_ns) - camera_ned_m[:2]
        middle_m = math.hypot(*off.tolist())
        near_m = max(middle_m - 0.5 * track.width_m, 0.5)
        bearing_rad, bottom_rad = _level(detection, pose)
        off_rad = math.remainder(math.atan2(off[1], off[0]) - bearing_rad, math.tau)
        low_rad = bottom_rad + math.atan2(height_m, near_m)
        # The middles of box and track differ by a part of the object's length; the range error shifts the waterline.
        across = math.hypot(ANGLE_RAD, (PLACE_M + 0.25 * track.length_m) / max(middle_m, 1.0))
        along = math.hypot(ANGLE_RAD, height_m * (PLACE_M + 0.25 * track.length_m) / near_m**2)
        return (off_rad / across) ** 2 + (low_rad / along) ** 2


def _level(detection: ImageDetection, pose: VehiclePose) -> tuple[float, float]:
    """Bearing from north and elevation over the horizon of the middle of a box's lower edge."""
    flat = math.cos(detection.bottom_rad)
    ray_frd = np.array(
        (
            flat * math.cos(detection.bearing_rad),
            flat * math.sin(detection.bearing_rad),
            -math.sin(detection.bottom_rad),
        )
    )
    north, east, down = (pose.rot_ned_frd @ ray_frd).tolist()
    return math.atan2(east, north), -math.atan2(down, math.hypot(north, east))
