"""Images of cameras as messages of ROS: live, and in bags that rosbags reads."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from recorded_images import foxglove_calibration, foxglove_image, record
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation, Slerp
from synthetic_images import make_image

from sim_core.sensors.camera_spec import CameraSpec, LensSpec
from xitl_cli.logs import open_log
from xitl_cli.logs.export.exporting import BagFormat, ExportSelection
from xitl_cli.plugins.cameras.images import CameraFrame
from xitl_cli.plugins.ros.bag_export import export_bag
from xitl_cli.plugins.ros.camera_messages import compressed_format
from xitl_cli.plugins.ros.conversion import RosConversion
from xitl_cli.plugins.ros.definitions import deserialize
from xitl_cli.plugins.ros.frames import optical_turn
from xitl_cli.profile.load import load_profile
from xitl_cli.record.cdr import MessageType
from xitl_cli.record.topics import TOPICS

FRONT = CameraSpec(width_px=96, height_px=64, lens=LensSpec(distortion=(-0.2, 0.03)))
DEPTH = CameraSpec(name="depth", kind="depth", width_px=96, height_px=64)
CLASSES = CameraSpec(name="classes", kind="segmentation", width_px=96, height_px=64)
HEAT = CameraSpec(
    name="heat", kind="thermal", width_px=96, height_px=64, lens=LensSpec(model="fisheye", distortion=(0.1,))
)
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_OPTICAL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
CAMERAS = (FRONT, DEPTH, CLASSES, HEAT)


@pytest.mark.medium
@pytest.mark.parametrize("bag_format", ["rosbag2-mcap", "rosbag2-sqlite3", "rosbag1"])
def test_a_bag_has_images_and_lenses_of_all_cameras(tmp_path: Path, bag_format: BagFormat) -> None:
    path = record(tmp_path / "run.mcap", [make_image(spec, number) for number in (1, 2) for spec in CAMERAS])
    bag = tmp_path / ("bag.bag" if bag_format == "rosbag1" else "bag")
    with open_log(path) as log:
        export_bag(log, ExportSelection(()), (), bag_format, bag, overwrite=False)
    found: dict[str, list[Any]] = {}
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            if connection.topic.startswith("/cameras/"):
                message = reader.deserialize(data, connection.msgtype)
                found.setdefault(connection.topic.removeprefix("/cameras/"), []).append(message)
    assert {name for name in found if name not in ("frames", "truth")} == {
        *("front/image_raw/compressed", "classes/image_raw/compressed", "heat/image_raw/compressed", "depth/image_raw"),
        *(f"{spec.name}/camera_info" for spec in CAMERAS),
    }
    assert [frame.camera for frame in found["frames"][:4]] == [spec.name for spec in CAMERAS]
    assert found["truth"][0].label == "vessel"
    front, second = found["front/image_raw/compressed"]
    assert (front.header.frame_id, front.header.stamp.nanosec) == ("camera_front_optical", 100_000_000)
    assert (bytes(second.data), second.format) == (make_image(FRONT, 2).encoded, "rgb8; jpeg compressed bgr8")
    depth = found["depth/image_raw"][0]
    assert (depth.encoding, depth.height, depth.width, depth.step, depth.is_bigendian) == ("32FC1", 64, 96, 384, 0)
    assert np.array_equal(np.frombuffer(depth.data, "<f4").reshape(64, 96), make_image(DEPTH, 1).pixels)
    for spec, encoding in ((CLASSES, "mono8"), (HEAT, "mono16")):
        message = found[f"{spec.name}/image_raw/compressed"][0]
        assert message.format == f"{encoding}; png compressed "
        pixels = np.asarray(Image.open(BytesIO(bytes(message.data))))
        assert np.array_equal(pixels, make_image(spec, 1).pixels)


def messages(spec: CameraSpec, vessel: str = "", **ros: Any) -> list[Any]:
    profile = replace(load_profile("sitl").runnable(), vessel=vessel)
    conversion = RosConversion([profile])
    image, prefix = make_image(spec, 7), f"/{vessel}" if vessel else ""
    found = []
    for name, recorded in (
        ("image", foxglove_image(image, "any")),
        ("calibration", foxglove_calibration(image, "any")),
    ):
        topic = f"{prefix}/cameras/{spec.name}/{name}"
        assert conversion.wants(topic)
        found += list(conversion.convert(topic, recorded.encode(), image.stamp_ns))
    return found


def test_the_lens_projects_as_that_of_the_image() -> None:
    """With the camera matrix and the plumb_bob model of the message, by OpenCV's documented equations."""
    info = deserialize(messages(FRONT)[1].cdr, "sensor_msgs/msg/CameraInfo")
    assert info.distortion_model == "plumb_bob"
    k1, k2, p1, p2, k3 = info.d
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixel = info.k.reshape(3, 3) @ [*bent, 1.0]
    assert pixel[:2] == pytest.approx(make_image(FRONT, 7).lens.project(np.array([x, y, 1.0])), abs=1e-9)
    assert info.p.reshape(3, 4)[:, :3].tolist() == info.k.reshape(3, 3).tolist()
    assert (info.width, info.height, info.roi.width, info.binning_x) == (96, 64, 0, 0)


def test_a_fisheye_has_the_name_that_ros_gives_its_model() -> None:
    info = deserialize(messages(HEAT)[1].cdr, "sensor_msgs/msg/CameraInfo")
    assert (info.distortion_model, info.d.tolist()) == ("equidistant", [0.1, 0.0, 0.0, 0.0])


def test_topics_and_frames_of_a_fleet_have_the_name_of_the_vessel() -> None:
    image, info = messages(FRONT, "alpha")
    assert image.topic.full_name(image.vessel, "harbour") == "/harbour/alpha/cameras/front/image_raw/compressed"
    assert info.topic.full_name(info.vessel) == "/alpha/cameras/front/camera_info"
    message = deserialize(image.cdr, "sensor_msgs/msg/CompressedImage")
    assert message.header.frame_id == "alpha/camera_front_optical"


def test_the_optical_axes_are_those_of_rep_103() -> None:
    ahead = Rotation.from_quat(optical_turn(CameraSpec()))
    assert ahead.apply(np.eye(3)) == pytest.approx(np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]), abs=1e-12)
    up = Rotation.from_quat(optical_turn(CameraSpec(pitch_deg=30.0, yaw_deg=90.0)))  # to starboard, over the horizon
    assert up.apply([0.0, 0.0, 1.0]) == pytest.approx([0.0, -np.cos(np.pi / 6), 0.5], abs=1e-12)


def test_a_gimbal_turns_the_frame_of_its_camera() -> None:
    """Against scipy: the vessel yaws and rolls between two recorded attitudes, and the image lies between them."""
    cameras = "sensors.cameras=[{name: eye, position_frd_m: [1, 0.5, -2], gimbal: {}}, {name: fixed}]"
    conversion = RosConversion([load_profile("sitl", [cameras]).runnable()])
    attitude = TOPICS["/truth/odometry"].message_type().encode
    moved = [Rotation.from_euler("ZYX", angles, degrees=True) for angles in ((10, 0, 0), (16, 0, 4))]
    between = Slerp([0.0, 1.0], Rotation.concatenate(moved))(0.25)
    optical = Rotation.from_matrix(FRD_OPTICAL)
    mount = Rotation.from_euler("ZYX", (30, -20, 0), degrees=True)
    found: list[Any] = []
    for number, stamp_ns in enumerate((1_000_000_000, 1_020_000_000)):
        in_enu = Rotation.from_matrix(ENU_FROM_NED @ moved[number].as_matrix() @ np.diag([1.0, -1.0, -1.0]))
        zeros = [0.0] * 36
        payload = attitude(stamp_ns, "map", "base_link", [0.0] * 3, in_enu.as_quat().tolist(), zeros, [0.0] * 6, zeros)
        found += [one for one in conversion.convert("/truth/odometry", payload, stamp_ns) if one.topic.name == "/tf"]
        if not number:
            for name in ("eye", "fixed"):
                x, y, z, w = (between * mount * optical).as_quat().tolist()
                values = 1_005_000_000, name, 3, [0.0] * 3, [w, x, y, z], 0.0, 0.0, 0.0, 0.0
                payload = MessageType(CameraFrame).encode(*values)
                found += conversion.convert("/cameras/frames", payload, 1_005_000_000)
            assert not found, "it waits for the next attitude"
    ((message,),) = [deserialize(one.cdr, "tf2_msgs/msg/TFMessage").transforms for one in found]
    assert (message.header.frame_id, message.child_frame_id) == ("base_link", "camera_eye_optical")
    assert message.header.stamp.nanosec == 5_000_000
    place, turn = message.transform.translation, message.transform.rotation
    assert [place.x, place.y, place.z] == [1.0, -0.5, 2.0]
    expected = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]) @ (mount * optical).as_matrix())
    read = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
    assert (read.inv() * expected).magnitude() < 2e-5, "linear and spherical interpolation differ little"


@pytest.mark.parametrize(("mode", "text"), [("RGB", "rgb8; png compressed bgr8"), ("L", "mono8; png compressed ")])
def test_the_format_of_a_png_names_its_pixels(mode: str, text: str) -> None:
    file = BytesIO()
    Image.new(mode, (4, 3)).save(file, "PNG")
    assert compressed_format("png", file.getvalue()) == text
