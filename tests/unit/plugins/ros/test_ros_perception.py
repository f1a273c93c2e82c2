"""Ranges, scans, clouds, echoes, missions and batteries as messages of ROS."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

from agent.wire import dialect
from agent.wire.codec import Message, Packer
from sim_core.sensors.radar import MarineRadar, RadarSector
from sim_core.sensors.spec import ObstacleScannerSpec, RangefinderSpec
from xitl_cli.plugins.ros.conversion import RosConversion
from xitl_cli.plugins.ros.definitions import deserialize, to_ros1
from xitl_cli.plugins.ros.frames import sensor_frames
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.sensors import MessagesSpec
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.recorder import PerceptionRecorder, TopicWriter
from xitl_cli.record.topics import TOPICS


@pytest.fixture(scope="module")
def profile() -> RunProfile:
    return load_profile("sitl-perception").runnable()


def with_sensors(profile: RunProfile, **sensors: Any) -> RosConversion:
    assert profile.sensors is not None
    return RosConversion([replace(profile, sensors=replace(profile.sensors, **sensors))])


def sent(conversion: RosConversion, message: Message, link: str = "agent/tx") -> dict[str, Any]:
    payload = TOPICS["/link/{link}/tx"].message_type().encode(0, Packer(1, 1).pack(message))
    found = conversion.convert(f"/link/{link}", payload, 0)
    return {message.topic.full_name(message.vessel): deserialize(message.cdr, message.topic.type) for message in found}


def distance(number: int, current_cm: int, limits_cm: tuple[int, int] = (30, 1000)) -> Message:
    return dialect.MAVLink_distance_sensor_message(2500, *limits_cm, current_cm, 1, number, 25, 4, 0.1, 0.1)


@pytest.fixture
def ranging(profile: RunProfile) -> RosConversion:
    down = RangefinderSpec(max_range_m=10.0, beam_deg=10.0, noise_m=0.02)
    ahead = RangefinderSpec(
        max_range_m=10.0, through="air", direction_frd=(3.0, 3.0, 0.0), position_frd_m=(1.0, 0.5, -0.2)
    )
    return with_sensors(profile, rangefinders=(down, ahead))


def test_a_range_is_along_its_frames_x_axis(ranging: RosConversion) -> None:
    found = sent(ranging, distance(0, 421))["/range/rangefinder_0"]
    assert found.header.frame_id == "rangefinder_0_link"
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (2, 500_000_000)
    assert (found.range, found.min_range, found.max_range) == pytest.approx((4.21, 0.3, 10.0))
    assert found.field_of_view == pytest.approx(math.radians(10.0))
    assert found.variance == pytest.approx(0.0004)
    assert (found.radiation_type, sent(ranging, distance(1, 421))["/range/rangefinder_1"].radiation_type) == (0, 1)
    static = next(iter(ranging.static()))
    transforms = {each.child_frame_id: each.transform for each in deserialize(static.cdr, static.topic.type).transforms}
    for frame, looks in (
        ("rangefinder_0_link", [0.0, 0.0, -1.0]),
        ("rangefinder_1_link", [0.5**0.5, -(0.5**0.5), 0.0]),
    ):
        turn = transforms[frame].rotation
        seen = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([1.0, 0.0, 0.0])
        assert seen.tolist() == pytest.approx(looks, abs=1e-12)


def test_beyond_its_limits_a_range_is_infinite(ranging: RosConversion) -> None:
    assert sent(ranging, distance(0, 1001))["/range/rangefinder_0"].range == math.inf
    assert sent(ranging, distance(0, 29))["/range/rangefinder_0"].range == -math.inf


def test_the_ranges_that_a_companion_sends_are_not_of_a_rangefinder(ranging: RosConversion) -> None:
    assert sent(ranging, distance(0, 421, (1, 5000))) == {}
    assert sent(ranging, distance(7, 421)) == {}


def test_sectors_become_a_scan_counter_clockwise(profile: RunProfile) -> None:
    """Sector k of OBSTACLE_DISTANCE is 5 k degrees to starboard of the bow."""
    scanner = ObstacleScannerSpec(max_range_m=50.0)
    conversion = with_sensors(profile, lidar=None, messages=MessagesSpec(obstacle_distance=scanner))
    distances = [5001] * 72
    distances[0], distances[18] = 1000, 2000
    message = dialect.MAVLink_obstacle_distance_message(1_000_000, 0, distances, 5, 50, 5000, 5.0, 0.0, 12)
    scan = sent(conversion, message)["/scan"]
    angles = scan.angle_min + scan.angle_increment * np.arange(72)
    found = {
        round(math.degrees(angle)) % 360: value for angle, value in zip(angles, scan.ranges, strict=True) if value < 50
    }
    assert found == pytest.approx({0: 10.0, 270: 20.0})  # ahead, and to starboard
    assert scan.header.frame_id == "base_link"
    assert np.isinf(scan.ranges).sum() == 70


def recorded(tmp_path: Path, write: Any) -> list[tuple[str, bytes, int]]:
    """What a recorder wrote: topic, payload, stamp."""
    from mcap.reader import make_reader

    file = McapFile(tmp_path / "run.mcap")
    write(PerceptionRecorder(TopicWriter(file, from_start=False)))
    file.close()
    with (tmp_path / "run.mcap").open("rb") as stream:
        return [
            (channel.topic, message.data, message.log_time)
            for _, channel, message in make_reader(stream).iter_messages()
        ]


def test_a_cloud_becomes_a_scan_of_what_stands_out_of_the_water(profile: RunProfile, tmp_path: Path) -> None:
    points = np.array([[10, 0, -1], [12, 0.01, -1], [0, 20, -2], [30, 30, 0.5], [5, -5, -9]], dtype=np.float32)

    def write(recorder: PerceptionRecorder) -> None:
        recorder.lidar_points(10**9, points, np.zeros(5, np.float32), np.zeros(5, np.uint8))

    ((topic, payload, stamp_ns),) = recorded(tmp_path, write)
    found = {
        m.topic.name: deserialize(m.cdr, m.topic.type)
        for m in RosConversion([profile]).convert(topic, payload, stamp_ns)
    }
    scan, cloud = found["scan"], found["points"]
    angles = np.degrees(scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges)))
    seen = [
        (angle, value)
        for angle, value in zip(angles.tolist(), scan.ranges.tolist(), strict=True)
        if math.isfinite(value)
    ]
    assert [value for _, value in seen] == pytest.approx([20.0, 12.0, 10.0], abs=1e-4)  # below and far above: not
    assert [angle for angle, _ in seen] == pytest.approx([-90.0, 0.0, 0.0], abs=1.0)
    assert cloud.width == 5


def test_a_ping_is_a_point_a_sample_along_its_beam(profile: RunProfile, tmp_path: Path) -> None:
    from agent.companion.sonar import SonarPing

    assert profile.sensors is not None
    assert profile.sensors.sonar is not None
    intensity = np.array([0, 10, 200, 3], dtype=np.uint8)
    ping = SonarPing(1, 0, 50, profile.sensors.sonar.position_frd_m, 2e-3 / 1.5, 1500.0, intensity)
    ((topic, payload, stamp_ns),) = recorded(tmp_path, lambda recorder: recorder.ping(10**9, ping))
    (message,) = RosConversion([profile]).convert(topic, payload, stamp_ns)
    echo = deserialize(message.cdr, message.topic.type)
    assert (message.topic.name, echo.header.frame_id, echo.width) == ("sonar/echo", "sonar_link", 4)
    points = echo.data.tobytes()
    packed = np.frombuffer(points, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
    ranges_m = (np.arange(4) + 0.5) * 1.0  # of 1500 m/s there and back
    bearing = math.radians(45.0) - math.radians(profile.sensors.sonar.heading_deg)
    assert packed["x"] == pytest.approx(ranges_m * math.cos(bearing), rel=1e-6)
    assert packed["y"] == pytest.approx(-ranges_m * math.sin(bearing), rel=1e-6)
    assert packed["intensity"].tolist() == [0.0, 10.0, 200.0, 3.0]


def test_a_mission_that_is_uploaded_is_a_path_in_the_map(profile: RunProfile) -> None:
    """Places against pymap3d."""
    conversion, site = RosConversion([profile]), profile.site
    count = dialect.MAVLink_mission_count_message(1, 1, 3, 0)
    assert sent(conversion, count) == {}
    places, found = [(0.0, 0.0), (0.001, 0.002), (0.003, -0.001)], dict[str, Any]()
    for number, (north_deg, east_deg) in enumerate(places):
        lat, lon = round((site.latitude_deg + north_deg) * 1e7), round((site.longitude_deg + east_deg) * 1e7)
        item = dialect.MAVLink_mission_item_int_message(1, 1, number, 6, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, lat, lon, 0.0, 0)
        assert found == {}
        found = sent(conversion, item)
    path = found["/mission"]
    assert path.header.frame_id == "map"
    for pose, (north_deg, east_deg) in zip(path.poses, places, strict=True):
        lat, lon = site.latitude_deg + north_deg, site.longitude_deg + east_deg
        east, north, _ = pymap3d.geodetic2enu(
            lat, lon, site.altitude_m, site.latitude_deg, site.longitude_deg, site.altitude_m
        )
        assert [pose.pose.position.x, pose.pose.position.y] == pytest.approx([east, north], abs=0.02)  # 1e-7 degrees


def test_mode_and_arming_are_told_as_they_change(profile: RunProfile) -> None:
    conversion = RosConversion([profile])

    def beat(mode: int, armed: bool, autopilot: int = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA) -> Message:
        return dialect.MAVLink_heartbeat_message(11, autopilot, 1 | 128 * armed, mode, 4, 3)

    first = sent(conversion, beat(10, False), "agent/rx")
    assert (first["/mode"].data, first["/armed"].data) == ("AUTO", False)
    assert sent(conversion, beat(10, False), "agent/rx") == {}
    assert set(sent(conversion, beat(10, True), "agent/rx")) == {"/armed"}
    assert sent(conversion, beat(15, True), "agent/rx")["/mode"].data == "GUIDED"
    assert sent(conversion, beat(0, False, dialect.MAV_AUTOPILOT_INVALID), "agent/rx") == {}  # a station's


def test_a_battery_is_told_where_the_autopilot_has_one(profile: RunProfile) -> None:
    conversion = RosConversion([profile])

    def status(millivolts: int, centiamperes: int, percent: int) -> Message:
        return dialect.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, centiamperes, percent, 0, 0, 0, 0, 0, 0)

    assert sent(conversion, status(0xFFFF, -1, -1), "agent/rx") == {}
    battery = sent(conversion, status(12_600, 350, 87), "agent/rx")["/battery"]
    assert (battery.voltage, battery.current, battery.percentage) == pytest.approx((12.6, -3.5, 0.87))
    unknown = sent(conversion, status(12_600, -1, -1), "agent/rx")["/battery"]
    assert math.isnan(unknown.current)
    assert math.isnan(unknown.percentage)


def test_junk_in_a_link_is_no_message(profile: RunProfile) -> None:
    conversion, encode = RosConversion([profile]), TOPICS["/link/{link}/tx"].message_type().encode
    for frame in (b"", b"\xfd", b"\xfd" + bytes(8), b"\xfe\x09\x00\x01\x01\x00" + bytes(11), bytes(40)):
        assert list(conversion.convert("/link/agent/tx", encode(0, frame), 0)) == []
        assert list(conversion.convert("/link/agent/rx", encode(0, frame), 0)) == []


def test_a_radar_sector_is_that_of_marine_sensor_msgs(tmp_path: Path) -> None:
    """Angles of ROS are counter-clockwise about the frame's z axis, which is up."""
    profile = load_profile("sitl-radar").runnable()
    assert profile.sensors is not None
    assert profile.sensors.radar is not None
    radar = MarineRadar(profile.sensors.radar)
    intensity = np.arange(radar.sector_spokes * radar.spec.bins).reshape(radar.sector_spokes, -1).astype(np.uint8)
    sector = RadarSector(6, 2, 0.0, 1.0, np.zeros(0), intensity)
    file = McapFile(tmp_path / "run.mcap", "lz4")
    topics = TopicWriter(file, ())
    kept: list[bytes] = []
    topics.watch("/marine_radar/sector", lambda stamp_ns, *values: kept.append(message_type.encode(stamp_ns, *values)))
    message_type = TOPICS["/marine_radar/sector"].message_type()
    PerceptionRecorder(topics).radar_sector(5_000_000_000, radar, sector)
    file.close()
    conversion = RosConversion([profile])
    (message,) = conversion.convert("/marine_radar/sector", kept[0], 5_000_000_000)
    found = deserialize(message.cdr, message.topic.type)
    assert message.topic.type == "marine_sensor_msgs/msg/RadarSector"
    assert message.topic.full_name() not in TOPICS  # a bag has the recorded topics too
    assert (found.header.frame_id, found.header.stamp.sec) == ("radar_link", 5)
    assert found.angle_start == pytest.approx(-1.5 * math.pi)  # from astern, a quarter of a turn on: to port
    assert found.angle_increment == pytest.approx(-math.tau / 720)
    assert found.time_increment.nanosec == pytest.approx(2.5e9 / 720, abs=1)
    assert (found.scan_time.sec, found.scan_time.nanosec) == (2, 500_000_000)
    assert found.range_min == pytest.approx(0.5 * radar.bin_m)
    assert found.range_max == pytest.approx(400.0 - 0.5 * radar.bin_m)
    assert np.array([echo.echoes for echo in found.intensities]).tolist() == intensity.tolist()
    assert to_ros1(message.cdr, message.topic.type)
    (frame,) = [frame for frame in sensor_frames(profile) if frame.name == "radar_link"]
    assert frame.position_m == (0.0, 0.0, 3.0)
