"""What a companion sees and says, read back by the `mcap` library, its ROS 2 decoder and protobuf's own."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from agent.companion.sonar import SonarPing
from agent.wire import dialect as mav
from sim_core.sensors.radar import MarineRadar, RadarSector
from sim_core.sensors.spec import MarineRadarSpec
from xitl_cli.logs import open_log
from xitl_cli.mapping import clouds as recorded
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import CompanionMessage, FaultEvent, RadarPlot

POINTS = np.array([[1.0, 2.0, 3.0], [4.0, -5.0, -6.0]], np.float32)
INTENSITY = np.array([7, 200], np.uint8)


def ros(path: Path) -> dict[str, list]:
    with path.open("rb") as file:
        topics: dict[str, list] = {}
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        chosen = [c.topic for c in reader.get_summary().channels.values() if c.message_encoding == "cdr"]
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=chosen):
            topics.setdefault(channel.topic, []).append((message.log_time, decoded))
    return topics


def test_topics_are_there_only_when_used(tmp_path: Path) -> None:
    for name, touch in (("one", False), ("two", True)):
        recorder = Recorder(tmp_path / name, "lz4")
        recorder.write(1, FaultEvent("x", active=True))
        if touch:
            assert recorder.perception is recorder.perception
        recorder.close()
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_clouds_are_forward_left_up_with_their_fields(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    offset = np.array([0.0, 0.05], np.float32)
    recorder.perception.lidar_points(5_000_000_000, POINTS, offset, INTENSITY)
    recorder.perception.sonar_points(6, POINTS, INTENSITY)
    recorder.perception.map_points(7, POINTS, INTENSITY, "sonar")
    recorder.perception.map_points(8, POINTS[:1], INTENSITY[:1], "lidar")
    recorder.close()
    with open_log(tmp_path / "run.mcap") as log:
        table = log.tables["/lidar/points"]
        names = [str(table.values(f"fields[{n}].name")[0]) for n in range(5)]
        assert names == ["x", "y", "z", "t", "intensity"]
        assert table.values("frame_id")[0] == "base_link"
        assert log.tables["/companion/map"].values("frame_id")[0] == "odom"
        for axis, turn in zip("xyzw", (0.0, 0.0, 0.0, 1.0), strict=True):  # the points are in the axes of the frame
            assert table.values(f"pose.orientation.{axis}")[0] == turn
            assert axis == "w" or table.values(f"pose.position.{axis}")[0] == 0.0
        first = np.frombuffer(table.values("data")[0][:12], dtype="<f4")
        assert first.tolist() == [1.0, -2.0, -3.0]
        (cloud,) = recorded.clouds(log)
        assert (cloud.stamp_ns, cloud.points_m.tolist()) == (5_000_000_000, POINTS.tolist())
        assert (cloud.offset_s.tolist(), cloud.intensity.tolist()) == (offset.tolist(), INTENSITY.tolist())
        told = recorded.map_points(log)
        assert told["sonar"].points_odom_m.tolist() == POINTS.tolist()
        assert told["lidar"].points_odom_m.tolist() == POINTS[:1].tolist()
        assert told["lidar"].seen_ns.tolist() == [8]
        assert len(log.tables["/sonar/points"]) == 1


def test_pings_read_back(tmp_path: Path) -> None:
    pings = [
        SonarPing(n, 10 + n, 399 - n, (0.5, 0.0, 0.4), 1e-5, 1480.0, np.arange(200 + n, dtype=np.uint8))
        for n in range(3)
    ]
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    for ping in pings:
        recorder.perception.ping(ping.stamp_ns, ping)
    recorder.close()
    for stamp_ns, message in ros(tmp_path / "run.mcap")["/sonar/ping"]:
        ping = pings[message.number]
        assert (stamp_ns, message.angle_grad) == (ping.stamp_ns, ping.angle_grad)
        assert bytes(message.intensity) == ping.intensity.tobytes()
    with open_log(tmp_path / "run.mcap") as log:
        for got, ping in zip(recorded.pings(log), pings, strict=True):
            assert got[:6] == ping[:6]
            assert got.intensity.tolist() == ping.intensity.tolist()


def test_a_pose_is_turned_into_the_axes_that_are_drawn_and_back(tmp_path: Path) -> None:
    c, s = np.cos(0.3), np.sin(0.3)
    pose = np.array([[c, -s, 0, 1.0], [s, c, 0, 2.0], [0, 0, 1, 3.0], [0, 0, 0, 1]])  # turns right, seen from above
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    recorder.perception.odometry(4, np.eye(4), np.zeros(3))
    recorder.perception.odometry(5, pose, np.array([1.0, 0.5, 0.25]))
    recorder.perception.odom_frame(5, np.zeros(3), np.array([1.0, 0, 0, 0]))
    recorder.close()
    _, message = ros(tmp_path / "run.mcap")["/companion/odometry"][1]
    place, turn, speed = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist.linear
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    assert (place.x, place.y, place.z) == pytest.approx((1.0, -2.0, -3.0))
    assert (turn.w, turn.z) == pytest.approx((np.cos(0.15), -np.sin(0.15)))  # clockwise is negative about up
    assert (speed.x, speed.y, speed.z) == pytest.approx((1.0, -0.5, -0.25))
    rate = message.twist.twist.angular
    assert (rate.x, rate.y, rate.z) == (0.0, 0.0, 0.0)
    for covariance in (message.pose.covariance, message.twist.covariance):
        assert np.diag(np.reshape(covariance, (6, 6))).tolist() == [1e6] * 6  # the odometry states none
    with open_log(tmp_path / "run.mcap") as log:
        back = recorded.online(log)
    assert back.pos_m[1].tolist() == pytest.approx([1.0, 2.0, 3.0])
    assert back.quat_wxyz[1].tolist() == pytest.approx([np.cos(0.15), 0, 0, np.sin(0.15)])


def test_bodies_contacts_obstacles_and_status_read_back(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    perception = recorder.perception
    quat = np.array([[1.0, 0, 0, 0], [0, 0, 0, 1.0]])
    perception.bodies(1, ["trunk", "animal"], np.array([5.0, 1.2]), np.eye(3)[:2], quat, np.ones((2, 3)))
    perception.contact(2, "trunk 0", np.array([1.0, 2.0, 0.0]), 300.0, 1.5, began=True)
    obstacle = mav.MAVLink_xitl_obstacle_message(
        9, [1.0, 2.0, 3.0], [0.1, 0.2, 0.3], [5.0, 0.5, 0.4], 0.7, 21.0, 2.5, 4, 33, 12
    )
    perception.obstacle(3, obstacle)
    names = list(get_type_hints(CompanionMessage))[:13]
    counts = range(1, 14)
    perception.companion(4, mav.MAVLink_xitl_companion_status_message(8, *counts, 0.25, 1))
    recorder.close()
    topics = ros(tmp_path / "run.mcap")
    trunk, animal = (body for _, body in topics["/truth/bodies"])
    assert (trunk.kind, trunk.number, trunk.length_m) == ("trunk", 0, 5.0)
    assert (animal.kind, list(animal.position_ned_m), list(animal.quaternion_ned_frd)) == (
        "animal",
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    )
    _, contact = topics["/contacts"][0]
    assert (contact.what, contact.force_n, contact.speed_mps, contact.began) == ("trunk 0", 300.0, 1.5, 1)
    _, seen = topics["/companion/obstacles"][0]
    assert (seen.id, seen.points, seen.hits, seen.seen_ns) == (4, 33, 12, 9000)
    assert (seen.range_m, seen.closing_speed_mps, seen.size_m[0]) == (21.0, 2.5, 5.0)
    _, status = topics["/companion/status"][0]
    assert [getattr(status, name) for name in names] == list(counts)
    assert (status.latency_s, status.manoeuvre) == (0.25, 1)


def test_radar_sectors_and_plots_are_read_back(tmp_path: Path) -> None:
    radar = MarineRadar(MarineRadarSpec(spokes=120, bins=64))
    image = np.arange(5 * 64, dtype=np.uint8).reshape(5, 64)
    plot = RadarPlot(3, 7_000, 120.5, 1.0, 2.0, 33.0, 12.0, 0.1, 40)
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    recorder.perception.radar_sector(8, radar, RadarSector(12, 3, 0.0, 0.5, np.zeros(0), image))
    recorder.perception.radar_plot(9, plot)
    recorder.close()
    topics = ros(tmp_path / "run.mcap")
    ((stamp_ns, sector),) = topics["/marine_radar/sector"]
    assert (stamp_ns, sector.turn, sector.number, sector.spokes, sector.bins) == (8, 3, 12, 5, 64)
    assert sector.angle_start_rad == pytest.approx(0.0, abs=1e-12)  # half a turn on from astern
    assert sector.angle_increment_rad == pytest.approx(np.radians(3.0))
    assert (sector.time_increment_s, sector.scan_time_s) == pytest.approx((radar.spoke_s, 60.0 / radar.spec.rpm))
    bin_m = radar.spec.range_m / 64  # the middles of the first and of the last
    assert (sector.range_min_m, sector.range_max_m) == pytest.approx((0.5 * bin_m, 63.5 * bin_m))
    assert sector.heading_rad == 0.5
    assert np.frombuffer(bytes(sector.intensity), np.uint8).reshape(5, 64).tolist() == image.tolist()
    ((stamp_ns, found),) = topics["/marine_radar/plots"]
    assert stamp_ns == 9
    assert {name: getattr(found, name) for name in get_type_hints(RadarPlot)} == asdict(plot)
