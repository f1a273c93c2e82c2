"""Detections made from known places are associated with the tracks at these places."""

from __future__ import annotations

import math

import numpy as np

from agent.companion.camera_fusion import (
    ANGLE_RAD,
    FEWEST_IMAGES,
    GATE,
    MOST_WAITING,
    PLACE_M,
    CameraFusion,
    ImageDetection,
)
from agent.companion.detection import Cluster
from agent.companion.pose_history import PoseHistory
from agent.companion.tracking import ObstacleTrack

CAMERA_FRD_M = np.array((1.0, 0.0, -0.9))
WATERLINE_M = 0.1
HEIGHT_M = 1.0
"""Of the camera over the water: 0.9 m above the origin of the body, which is 0.1 m above the water."""
SECOND = 1_000_000_000
ROLL_RAD = math.radians(8.0)


def history(roll_rad: float = 0.0, heading_rad: float = 0.0) -> PoseHistory:
    """Return a vessel at rest in the origin from 1 s to 5 s."""
    poses = PoseHistory()
    roll = np.array((math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad), 0.0, 0.0))
    yaw = math.cos(0.5 * heading_rad), math.sin(0.5 * heading_rad)
    quat = np.array((yaw[0] * roll[0], yaw[0] * roll[1], yaw[1] * roll[1], yaw[1] * roll[0]))
    for step in range(41):
        stamp_ns = SECOND + step * SECOND // 10
        poses.add_attitude(stamp_ns, quat, np.zeros(3))
        poses.add_position(stamp_ns, np.zeros(3), np.zeros(3))
    return poses


def track(number: int, north_m: float, east_m: float) -> ObstacleTrack:
    """Return a track at rest of an object of 0.8 m."""
    place = np.array((north_m, east_m))
    cluster = Cluster(SECOND, place[None], place, 0.8, 0.8, 0.9, 0.0, 20)
    tracked = ObstacleTrack(number, cluster, np.zeros(2), 3)
    tracked.state[2:] = 0.0
    return tracked


def seen(
    place_ne_m: tuple[float, float], label: str, stamp_ns: int, poses: PoseHistory, confidence: float = 0.9
) -> ImageDetection:
    """Return the detection of an object whose near waterline is at a place."""
    pose = poses.pose_at(2 * SECOND)
    assert pose is not None
    camera = pose.rot_ned_frd @ CAMERA_FRD_M
    ray_ned = np.array((*place_ne_m, WATERLINE_M)) - camera
    ray_ned[:2] *= 1.0 - 0.4 / np.hypot(*ray_ned[:2])  # its near side
    forward, right, down = (pose.rot_ned_frd.T @ ray_ned).tolist()
    bearing, bottom = math.atan2(right, forward), -math.atan2(down, math.hypot(forward, right))
    return ImageDetection(stamp_ns, CAMERA_FRD_M, bearing, 0.05, bottom, confidence, label)


def fused(
    tracks: list[ObstacleTrack], places: dict[tuple[float, float], str], poses: PoseHistory, images: int = FEWEST_IMAGES
) -> CameraFusion:
    fusion = CameraFusion(WATERLINE_M)
    for image in range(images):
        for place, label in places.items():
            fusion.add(seen(place, label, 2 * SECOND + image * SECOND // 5, poses))
    fusion.update(poses, tracks)
    return fusion


def test_each_track_gets_the_class_of_the_object_at_its_place() -> None:
    """Two of them in one direction: the row of the waterline separates them."""
    near, far, aside = (12.0, 1.0), (36.0, 3.0), (20.0, -9.0)
    tracks = [track(1, *near), track(2, *far), track(3, *aside)]
    fusion = fused(tracks, {far: "vessel", near: "buoy", aside: "debris"}, history())
    assert [fusion.class_of(number)[0] for number in (1, 2, 3)] == ["buoy", "vessel", "debris"]
    assert fusion.matched == fusion.received == 9
    assert fusion.dropped == 0


def test_roll_and_heading_of_the_vessel_are_taken_out() -> None:
    poses = history(ROLL_RAD, 2.0)
    bearing = 2.0 + 0.4
    place = 18.0 * math.cos(bearing), 18.0 * math.sin(bearing)
    assert fused([track(5, *place)], {place: "buoy"}, poses).class_of(5) == ("buoy", 1.0)


def test_a_track_elsewhere_gets_no_class() -> None:
    for off in ((18.0, 3.5), (7.0, 0.0)):
        fusion = fused([track(1, *off)], {(18.0, 0.0): "buoy"}, history())
        assert fusion.class_of(1) == ("", 0.0)
        assert fusion.matched == 0


def test_one_detection_is_for_one_track() -> None:
    tracks = [track(1, 18.0, 0.0), track(2, 18.4, 0.5)]
    fusion = fused(tracks, {(18.0, 0.0): "buoy"}, history())
    assert (fusion.class_of(1)[0], fusion.class_of(2)[0]) == ("buoy", "")


def test_the_class_needs_several_images_and_most_evidence_decides() -> None:
    place, poses = (15.0, 0.0), history()
    assert fused([track(1, *place)], {place: "buoy"}, poses, FEWEST_IMAGES - 1).class_of(1) == ("", 0.0)
    fusion = fused([track(1, *place)], {place: "buoy"}, poses, 4)
    fusion.add(seen(place, "debris", 4 * SECOND, poses))
    fusion.update(poses, [track(1, *place)])
    label, share = fusion.class_of(1)
    assert label == "buoy"
    assert 0.7 < share < 0.8  # 3 to 4 of the newest five, older ones faded


def test_detections_wait_for_their_pose_and_every_drop_is_counted() -> None:
    place, poses = (15.0, 0.0), history()
    fusion = CameraFusion(WATERLINE_M)
    fusion.add(seen(place, "buoy", 5 * SECOND + SECOND // 2, poses))  # half a second after the newest pose
    fusion.update(poses, [track(1, *place)])
    assert (fusion.matched, fusion.dropped) == (0, 0)
    fusion.add(seen(place, "buoy", 2 * SECOND, poses)._replace(bearing_rad=math.nan))
    assert fusion.dropped == 1
    for _ in range(MOST_WAITING):
        fusion.add(seen(place, "buoy", 6 * SECOND, poses))
    assert fusion.dropped == 2
    early = CameraFusion(WATERLINE_M)
    early.add(seen(place, "buoy", SECOND // 2, poses))  # before the first pose
    early.update(poses, [])
    assert (early.dropped, early.early) == (1, 1)


def test_a_pair_is_associated_within_the_gate_of_both_angles() -> None:
    """Off by shares of a standard deviation in bearing and depression, around the ellipse of the gate."""
    poses, length_m, width_m, place = history(), 3.0, 1.2, (24.0, 7.0)
    middle, middle_ns = np.array(place), 2 * SECOND
    cluster = Cluster(SECOND, middle[None], middle, length_m, width_m, 0.9, 0.3, 20)
    off = middle - CAMERA_FRD_M[:2]
    range_m = float(np.hypot(*off))
    near_m = range_m - 0.5 * width_m
    reach_m = PLACE_M + 0.25 * length_m
    across_rad = math.sqrt(ANGLE_RAD**2 + (reach_m / range_m) ** 2)
    along_rad = math.sqrt(ANGLE_RAD**2 + (HEIGHT_M * reach_m / near_m**2) ** 2)
    for share in (0.98, 1.02):
        for turn_rad in np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False):
            deviations = share * math.sqrt(GATE)
            bearing_rad = math.atan2(off[1], off[0]) + deviations * math.cos(turn_rad) * across_rad
            bottom_rad = -math.atan2(HEIGHT_M, near_m) + deviations * math.sin(turn_rad) * along_rad
            tracked = ObstacleTrack(1, cluster, np.zeros(2), 3)
            fusion = CameraFusion(WATERLINE_M)
            fusion.add(ImageDetection(middle_ns, CAMERA_FRD_M, bearing_rad, 0.05, bottom_rad, 0.9, "buoy"))
            fusion.update(poses, [tracked])
            assert fusion.matched == (share < 1.0)


def test_a_pair_uses_the_place_of_the_track_at_the_image_and_not_behind_the_camera() -> None:
    poses, tracked = history(), track(1, 14.0, 0.0)
    tracked.state[2:] = (1.0, -2.0)
    fusion = CameraFusion(WATERLINE_M)
    fusion.add(seen((16.0, -4.0), "buoy", 3 * SECOND, poses))  # 2 s after the track's last correction
    fusion.update(poses, [tracked])
    assert fusion.matched == 1
    astern = CameraFusion(WATERLINE_M)
    astern.add(seen((-20.0, 0.0), "buoy", 3 * SECOND, poses)._replace(bearing_rad=-math.pi + 0.001))
    astern.update(poses, [track(1, -20.0, 0.1)])
    assert astern.matched == 1, "bearings are compared around the circle"


def test_evidence_fades_by_a_twentieth_an_image() -> None:
    place, poses = (15.0, 0.0), history()
    tracks = [track(1, *place), track(2, 15.0, 12.0)]
    fusion = CameraFusion(WATERLINE_M)
    for image, (label, confidence) in enumerate([("buoy", 0.9), ("log", 0.7), ("buoy", 0.2), ("log", 0.3)]):
        fusion.add(seen(place, label, 2 * SECOND + image * SECOND // 5, poses, confidence))
    fusion.update(poses, tracks)
    buoy, log = 0.9 * 0.95**3 + 0.2 * 0.95, 0.7 * 0.95**2 + 0.3
    label, share = fusion.class_of(1)
    assert (label, fusion.class_of(2)) == ("buoy", ("", 0.0))
    assert abs(share - buoy / (buoy + log)) < 1e-12
    fusion.update(poses, tracks[1:])
    assert fusion.class_of(1) == ("", 0.0), "a lost track has no class"


def test_images_wait_for_a_pose_up_to_two_seconds_ahead() -> None:
    place = (15.0, 0.0)
    poses = history()  # up to 5 s
    for after_ns, matched, dropped in ((0, 1, 0), (1, 0, 0), (2 * SECOND, 0, 0), (2 * SECOND + 1, 0, 1)):
        fusion = CameraFusion(WATERLINE_M)
        fusion.add(seen(place, "buoy", 5 * SECOND + after_ns, poses))
        fusion.update(poses, [track(1, *place)])
        assert (fusion.matched, fusion.dropped, fusion.early) == (matched, dropped, dropped)
    begun = CameraFusion(WATERLINE_M)
    for stamp_ns in (2 * SECOND, SECOND // 2):
        begun.add(seen(place, "buoy", stamp_ns, poses))
    begun.update(poses, [track(1, *place)])
    assert (begun.matched, begun.dropped, begun.early) == (1, 1, 0)
    nameless = seen(place, "", 2 * SECOND, poses)
    begun.add(nameless)
    for changed in (nameless._replace(label="x", position_frd_m=np.array((0.0, math.nan, 0.0))), nameless):
        begun.add(changed)
    assert (begun.received, begun.dropped) == (5, 4)
