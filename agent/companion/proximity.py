"""What is near, in the standard messages that ground stations draw and other autopilots avoid by."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.companion.pose_history import VehiclePose
from agent.companion.vehicle import heading_rad
from agent.wire import dialect as mav

Array = NDArray[np.float64]

SECTORS, SECTOR_DEG = 72, 5
_UNKNOWN = 65535
_LASER = 0  # MAV_DISTANCE_SENSOR
_FORWARD = 0  # MAV_SENSOR_ORIENTATION
_VIEW_SECTORS = 6  # to either side of the bow
_LEAST_CM = 50


def proximity_messages(points_ne_m: Array, pose: VehiclePose, stamp_ns: int, bow_m: float, range_m: float) -> list[Any]:
    """OBSTACLE_DISTANCE from the body's origin, and DISTANCE_SENSOR from the bow, bow_m before it.

    Sectors in view without a thing are one centimetre beyond the range; those out of view and empty are not known.
    """
    most_cm = min(round(range_m * 100.0), 60_000)
    off = points_ne_m - pose.pos_ned_m[:2]
    bow_rad = heading_rad(pose)
    distance_m = np.hypot(off[:, 0], off[:, 1])
    bearing = np.arctan2(off[:, 1], off[:, 0]) - bow_rad
    sector = np.round(bearing / math.radians(SECTOR_DEG)).astype(np.int64) % SECTORS
    nearest_cm = np.full(SECTORS, np.inf)
    np.minimum.at(nearest_cm, sector, distance_m * 100.0)
    view = np.arange(SECTORS)
    ahead = np.minimum(view, SECTORS - view) <= _VIEW_SECTORS
    empty = np.where(ahead, most_cm + 1, _UNKNOWN)
    found = nearest_cm <= most_cm
    distances = np.where(found, np.maximum(np.where(found, nearest_cm, 0.0), _LEAST_CM), empty).astype(np.int64)
    time_usec = max(stamp_ns // 1000, 0)
    forward_m = distance_m[found[sector] & ahead[sector]]
    forward_cm = most_cm + 1 if not len(forward_m) else min(max(round((forward_m.min() - bow_m) * 100.0), 1), most_cm)
    view_rad = math.radians(SECTOR_DEG * (2 * _VIEW_SECTORS + 1))
    return [
        mav.MAVLink_obstacle_distance_message(
            time_usec, _LASER, distances.tolist(), SECTOR_DEG, _LEAST_CM, most_cm, float(SECTOR_DEG), 0.0,
            mav.MAV_FRAME_BODY_FRD,
        ),
        mav.MAVLink_distance_sensor_message(
            (time_usec // 1000) & 0xFFFFFFFF, 1, most_cm, forward_cm, _LASER, 0, _FORWARD, 255, view_rad, view_rad
        ),
    ]  # fmt: skip
