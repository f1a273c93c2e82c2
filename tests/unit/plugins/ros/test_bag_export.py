"""Bags that are written, read back by rosbags, mcap-ros2-support and our own reader."""

from __future__ import annotations

import json
import lzma
import sqlite3
import struct
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from scipy.spatial.transform import Rotation

import xitl_cli.logs.signals as signals
from agent.wire import dialect
from agent.wire.codec import Packer
from sim_core.geodesy import LocalFrame
from sim_core.kinematics import Kinematics
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.vessel_bag import namespaces_of_vessels
from xitl_cli.logs.signals.receivers import gnss_receivers
from xitl_cli.plugins.logs.command import export
from xitl_cli.plugins.ros.bag_export import recorded_messages
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.resolved import resolved_yaml
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotionEstimate
from xitl_cli.run.world.world import local_frame

DATA = Path(__file__).parents[3] / "data"
FORMATS = ("rosbag2-mcap", "rosbag2-sqlite3", "rosbag1")
IMU_COUNT, CLOUD_POINTS = 40, 25
POINT = b"\0\1\0\0" + struct.pack("<3d", 1.0, 2.0, 3.0)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """0.2 s of a run, as a recorder writes it."""
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    recorder, packer = Recorder(path, "lz4"), Packer(1, 1)
    recorder.metadata("xitl", {"profile": "sitl-perception"})
    recorder.attach("profile.yaml", "application/yaml", resolved_yaml(load_profile("sitl-perception")).encode())
    for number in range(IMU_COUNT):
        stamp_ns = number * 5_000_000
        gyro, accel = [0.0, 0.0, 0.01 * number], [0.0, 0.0, -9.8]
        message = dialect.MAVLink_xitl_imu_message(stamp_ns // 1000, gyro, accel, 20.0)
        recorder.frame_sent(stamp_ns, packer.pack(message))
        if number % 10 == 0:
            recorder.environment(stamp_ns, np.array([0.5, 0.0, 0.0]), np.array([0.0, 3.0, 0.0]), 0.0)
            turn, still = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
            ahead = np.array([200.0, 0.0, 0.0])  # 10 m in 0.05 s
            recorder.estimate(stamp_ns, MotionEstimate(np.array([number, 2.0, 0.0]), ahead, turn, still))
    points = np.tile(np.array([10.0, 1.0, -1.0], dtype=np.float32), (CLOUD_POINTS, 1))
    offsets = np.linspace(0.0, 0.1, CLOUD_POINTS, dtype=np.float32)
    recorder.perception.lidar_points(100_000_000, points, offsets, np.full(CLOUD_POINTS, 7, dtype=np.uint8))
    recorder.close()
    return path


@pytest.fixture(scope="module")
def sailed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2 s of a vessel on its way, 0.3 m off in its estimate, as a recorder writes it."""
    path = tmp_path_factory.mktemp("sailed") / "run.mcap"
    recorder, profile = Recorder(path, "lz4"), load_profile("sitl")
    recorder.metadata("xitl", {"profile": "sitl"})
    recorder.attach("profile.yaml", "application/yaml", resolved_yaml(profile).encode())
    sail(recorder, local_frame(profile.runnable().site), 0.0)
    recorder.close()
    return path


@pytest.fixture(scope="module")
def convoy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of four vessels, 10 m beside each other."""
    path = tmp_path_factory.mktemp("convoy") / "run.mcap"
    file, profile = McapFile(path, "lz4"), load_profile("fleet-convoy")
    run = Recorder(file, links=(), from_start=False)
    vessels = profile.run_profiles()
    run.metadata("xitl", {"profile": "fleet-convoy", "vessels": ", ".join(one.vessel for one in vessels)})
    run.attach("profile.yaml", "application/yaml", resolved_yaml(profile).encode())
    for number, one in enumerate(vessels):
        sail(Recorder(file, links=("agent",), vessel=one.vessel), local_frame(one.site), 10.0 * number)
    run.close()
    return path


def sail(recorder: Recorder, frame: LocalFrame, east_m: float) -> None:
    """2 s to the north, `east_m` beside the site, the fixes between two positions of the truth."""
    zero, level = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    speed, further = np.array([[5.0, 0.0, 0.0]]), np.array([[0.05, 0.0, 0.0]])
    for number in range(100):
        place = np.array([[0.1 * number, east_m, 0.0]])
        motion = Kinematics(place, speed, zero, level, np.eye(3)[None], zero, zero)
        recorder.truth(number * 20_000_000, motion, np.zeros((1, 2)))
        if number % 5 == 0:
            off = place[0] + [0.0, 0.3, 0.0]
            recorder.estimate(number * 20_000_000, MotionEstimate(off, speed[0], level[0], zero[0]))
            there = frame.geodetic(place + further)
            recorder.fix(number * 20_000_000 + 10_000_000, *(float(each[0]) for each in there))


def written(recording: Path, out: Path, bag_format: str, names: list[str] | None = None, **options: Any) -> Path:
    export(recording, names, bag_format, out, **options)
    return out


def place(folder: Path, bag_format: str) -> Path:
    return folder / ("made.bag" if bag_format == "rosbag1" else "made")


@pytest.mark.medium
@pytest.mark.parametrize("bag_format", FORMATS)
def test_a_recording_is_read_back_by_rosbags(recording: Path, tmp_path: Path, bag_format: str) -> None:
    bag = written(recording, place(tmp_path, bag_format), bag_format)
    with AnyReader([bag]) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
        read = [(one.topic, reader.deserialize(data, one.msgtype)) for one, _, data in reader.messages()]
        types = {topic: info.msgtype for topic, info in reader.topics.items()}
    found: dict[str, Any] = dict(read)
    assert counts["/imu/data"] == IMU_COUNT
    assert types["/imu/data"] == "sensor_msgs/msg/Imu"
    assert found["/imu/data"].angular_velocity.z == pytest.approx(-0.39)
    assert found["/imu/data"].header.frame_id == "imu_link"
    cloud = found["/points"]
    assert (cloud.width, [field.name for field in cloud.fields]) == (
        CLOUD_POINTS, ["x", "y", "z", "intensity", "time"],
    )  # fmt: skip
    assert [found["/wind"].vector.x, found["/wind"].vector.y] == [3.0, 0.0]
    assert {each.child_frame_id for each in found["/tf_static"].transforms} >= {"imu_link", "lidar_link"}
    assert [(each.header.frame_id, each.child_frame_id) for each in found["/tf"].transforms][-1] == ("map", "odom")
    assert counts["/link/agent/tx"] == IMU_COUNT  # ours go along as they are
    assert found["/environment"].current_ned_mps.tolist() == [0.5, 0.0, 0.0]
    assert not set(counts) & {"/scene", "/log", "/truth/pose"}  # Foxglove's, which ROS has no place for


@pytest.mark.medium
def test_mcap_ros2_support_reads_the_clouds_in_it(recording: Path, tmp_path: Path) -> None:
    bag = written(recording, tmp_path / "made", "rosbag2-mcap")
    with (bag / "made.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        ((_, _, _, cloud),) = reader.iter_decoded_messages(topics=["/points"])
    packed = np.frombuffer(cloud.data, dtype=[(name, "<f4") for name in ("x", "y", "z", "intensity", "time")])
    lidar = load_profile("sitl-perception").runnable().sensors.lidar  # type: ignore[union-attr]
    assert lidar is not None
    forward, right, down = lidar.position_frd_m
    mount = Rotation.from_euler("ZYX", [lidar.yaw_deg, lidar.pitch_deg, lidar.roll_deg], degrees=True)
    seen_frd = mount.inv().apply([10.0 - forward, 1.0 - right, -1.0 - down])
    for axis, expected in zip("xyz", (seen_frd[0], -seen_frd[1], -seen_frd[2]), strict=True):
        assert packed[axis] == pytest.approx(expected, abs=1e-5)
    assert set(packed["intensity"]) == {7.0}
    assert packed["time"][-1] == pytest.approx(0.1)


@pytest.mark.medium
def test_what_is_said_once_is_latched(recording: Path, tmp_path: Path) -> None:
    with AnyReader([written(recording, tmp_path / "made", "rosbag2-mcap")]) as reader:
        durable = {
            one.topic: one.ext.offered_qos_profiles[0].durability  # type: ignore[union-attr]
            for one in reader.connections
        }
    latched = {topic for topic, kind in durable.items() if kind is QosDurability.TRANSIENT_LOCAL}
    assert {"/tf_static", "/mission"} <= latched
    assert "/imu/data" not in latched


@pytest.mark.medium
def test_our_own_reader_takes_the_bag_for_a_log(recording: Path, tmp_path: Path) -> None:
    with open_log(written(recording, tmp_path / "made.bag", "rosbag1")) as log:
        assert len(log.tables["/imu/data"]) == IMU_COUNT
        assert log.tables["/odometry"].values("pose.pose.position.y") == pytest.approx([0.0, 10.0, 20.0, 30.0])


@pytest.mark.medium
@pytest.mark.parametrize("bag_format", FORMATS)
def test_a_bag_of_a_run_is_compared_about_the_same_place_on_the_earth(
    sailed: Path, tmp_path: Path, bag_format: str
) -> None:
    """By the topics that a run has live; fixes that came late say when they were made."""
    bag = written(
        sailed, place(tmp_path, bag_format), bag_format, ["odometry", "ground_truth/odom", "ground_truth/fix"]
    )
    if bag_format == "rosbag2-sqlite3":
        with sqlite3.connect(bag / "made.db3") as database:
            of_fix = "(SELECT id FROM topics WHERE name = '/ground_truth/fix')"
            late = database.execute(f"UPDATE messages SET timestamp = timestamp + 30000000 WHERE topic_id = {of_fix}")
            assert late.rowcount == 20
    with open_log(sailed) as run, open_log(bag) as read:
        there = signals.position_ned(run)
        assert there is not None
        assert there.origin is not None
        again = signals.position_ned(read, origin=there.origin)
        assert again is not None
        assert again.path.source == "/odometry.pose.pose.position"
        assert again.path.values == pytest.approx(there.path.values, abs=1e-6)
        assert gnss_receivers(read) == []  # the truth is none


@pytest.mark.medium
@pytest.mark.parametrize("bag_format", FORMATS)
def test_a_vessel_of_a_bag_is_read_as_if_it_were_alone(convoy: Path, tmp_path: Path, bag_format: str) -> None:
    bag = written(convoy, place(tmp_path, bag_format), bag_format)
    with open_log(convoy) as run:
        names = run.vessels
    assert len(names) == 4
    with open_log(bag) as every:
        assert (set(every.vessels), every.vessel) == (set(names), "")
        assert {f"/{name}/odometry" for name in names} <= set(every.tables)
    for name in names:
        with open_log(convoy, name) as run, open_log(bag, name) as one:
            assert (set(one.vessels), one.vessel) == (set(names), name)
            assert {"/odometry", "/ground_truth/fix", "/tf_static"} <= set(one.tables)
            assert not [topic for topic in (*one.tables, *one.rowless) if topic.split("/")[1] in names]
            assert len(list(one.payloads("/odometry"))) == len(one["/odometry"]) == 20
            there, again = signals.position_ned(run), signals.position_ned(one)
            assert there is not None
            assert again is not None
            assert again.origin == pytest.approx(there.origin, abs=1e-9)
            assert again.path.values == pytest.approx(there.path.values, abs=1e-6)
            assert again.path.values[0, 1] == pytest.approx(10.0 * names.index(name) + 0.3)
    with open_log(bag, "") as first:
        assert first.vessel in names
    with pytest.raises(LogError, match=f"has no vessel 'nobody'; choose from {', '.join(sorted(names))}"):
        open_log(bag, "nobody")
    with pytest.raises(UserError, match="a bag keeps its topic names"):
        written(bag, place(tmp_path / "again", bag_format), bag_format, vessel=names[0])


@pytest.mark.medium
def test_namespaces_are_told_from_parts_of_a_vessel(sailed: Path, tmp_path: Path) -> None:
    marked = ["/harbour/a/robot_description", "/harbour/b/robot_description", "/harbour/b/arm/robot_description"]
    assert namespaces_of_vessels(marked) == {"a": "/harbour/a", "b": "/harbour/b"}
    assert namespaces_of_vessels(["/robot_description", "/arm/robot_description", "/odometry"]) == {}
    bag = written(sailed, tmp_path / "made", "rosbag2-mcap", ["odometry", "ground_truth/odom"])
    with pytest.raises(LogError, match="has one vessel only"):
        open_log(bag, "a")
    with open_log(bag, "") as log:
        assert (log.vessels, log.vessel) == ((), "")


@pytest.mark.medium
def test_names_and_times_choose(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is latched comes along when it is asked for, also of a stretch that begins later."""
    names = ["imu/data", "/environment", "tf_static", "nosuch"]
    bag = written(recording, tmp_path / "made", "rosbag2-mcap", names, from_time="0.1", until_time="0.15")
    with AnyReader([bag]) as reader:
        counts = {topic: info.msgcount for topic, info in reader.topics.items()}
        first_ns = reader.start_time
    assert counts == {"/imu/data": 11, "/environment": 2, "/wind": 2, "/current": 2, "/tf_static": 1}
    assert first_ns == 100_000_000
    assert "no messages of nosuch" in capsys.readouterr().out


@pytest.mark.medium
def test_a_bag_that_is_there_stays_without_overwrite(recording: Path, tmp_path: Path) -> None:
    bag = written(recording, tmp_path / "made", "rosbag2-mcap", ["imu/data"])
    with pytest.raises(UserError, match="add --overwrite"):
        written(recording, bag, "rosbag2-mcap", ["wind"])
    written(recording, bag, "rosbag2-mcap", ["wind"], overwrite=True)
    with AnyReader([bag]) as reader:
        assert list(reader.topics) == ["/wind"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["made"]  # nothing half made is left


@pytest.mark.medium
def test_a_bag_of_ros_1_ends_so_that_its_readers_know_it(recording: Path, tmp_path: Path) -> None:
    written(recording, tmp_path / "made", "rosbag1", ["wind"])
    with AnyReader([tmp_path / "made.bag"]) as reader:
        assert list(reader.topics) == ["/wind"]
    with pytest.raises(UserError, match=r"made\.bag: already exists"):
        written(recording, tmp_path / "made", "rosbag1", ["wind"])


@pytest.mark.medium
def test_a_directory_that_is_no_bag_is_not_replaced(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "letter.txt").write_text("dear")
    bag = tmp_path / "made" / "run-rosbag2-mcap"
    export(recording, ["wind"], "rosbag2-mcap", tmp_path / "made", overwrite=True)
    assert (tmp_path / "made" / "letter.txt").read_text() == "dear"
    assert (bag / "metadata.yaml").is_file()


@pytest.mark.medium
def test_names_that_nothing_is_of_are_refused(recording: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no messages of nosuch"):
        written(recording, tmp_path / "made", "rosbag2-mcap", ["nosuch"])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.medium
def test_a_recording_cut_short_names_the_repair(recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-2000])
    with pytest.raises(UserError, match="xitl logs repair"):
        written(cut, tmp_path / "made", "rosbag2-mcap")


@pytest.mark.medium
def test_ros_messages_of_an_mcap_that_is_no_bag_stay_as_they_are(tmp_path: Path) -> None:
    """Beside them a topic of JSON, and a type that is another one in ROS."""
    from mcap.writer import Writer

    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "another program")
        for topic, encoding, schema, kind, text, payload in (
            ("/place", "cdr", "geometry_msgs/msg/Point", "ros2msg", "float64 x\nfloat64 y\nfloat64 z\n", POINT),
            (
                "/bare",
                "cdr",
                "std_msgs/msg/Float64",
                "ros2msg",
                "float64 value\n",
                b"\0\1\0\0" + struct.pack("<d", 4.0),
            ),
            (
                "/json",
                "json",
                "x",
                "jsonschema",
                '{"type": "object", "properties": {"a": {"type": "number"}}}',
                b'{"a": 5}',
            ),
        ):
            number = writer.register_channel(topic, encoding, writer.register_schema(schema, kind, text.encode()))
            writer.add_message(number, 10**9, payload, 10**9)
        writer.finish()
    for bag_format in FORMATS:
        with AnyReader([written(path, place(tmp_path, bag_format), bag_format, overwrite=True)]) as reader:
            read = {
                one.topic: (one.msgtype, reader.deserialize(data, one.msgtype)) for one, _, data in reader.messages()
            }
        assert read["/place"][0] == "geometry_msgs/msg/Point"
        assert (read["/place"][1].x, read["/place"][1].z) == (1.0, 3.0)
        assert read["/bare"][1].value == 4.0
        assert read["/json"][1].a == 5.0


@pytest.mark.medium
@pytest.mark.parametrize("bag_format", FORMATS)
def test_definitions_and_messages_that_are_broken_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bag_format: str
) -> None:
    from mcap.writer import Writer

    path = tmp_path / "broken.mcap"
    texts = (b"float64 $$", b"nosuch/Type a\n", b"", b"\xff\xfe", b"float64 x\n")
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "another program")
        for number, text in enumerate(texts):
            schema = writer.register_schema(f"a/msg/B{number}", "ros2msg", text)
            channel = writer.register_channel(f"/t{number}", "cdr", schema)
            writer.add_message(channel, 1, b"\0\1\0\0" + (struct.pack("<d", 1.0) if number == 4 else b""), 1)
            if number == 4:
                writer.add_message(channel, 2, b"\0\1\0\0", 2)
        writer.finish()
    with AnyReader([written(path, place(tmp_path, bag_format), bag_format)]) as reader:
        read = [(one.topic, data) for one, _, data in reader.messages()]
    assert "/t4" in {topic for topic, _ in read}
    assert not {"/t0", "/t1", "/t3"} & {topic for topic, _ in read}
    if bag_format == "rosbag1":
        assert "1 of /t4" in capsys.readouterr().out


@pytest.mark.medium
def test_bags_go_over_into_each_other(recording: Path, tmp_path: Path) -> None:
    """From ROS 2 to ROS 1 and back: the same messages of every topic."""
    first = written(recording, tmp_path / "first", "rosbag2-sqlite3")
    second = written(first, tmp_path / "second.bag", "rosbag1")
    third = written(second, tmp_path / "third", "rosbag2-mcap")
    with AnyReader([first]) as before, AnyReader([third]) as after:
        assert Counter((c.topic, bytes(d)) for c, _, d in before.messages()) == Counter(
            (c.topic, bytes(d)) for c, _, d in after.messages()
        )


@pytest.mark.medium
def test_a_log_of_ardupilot_is_motion_and_sensors_and_rows(tmp_path: Path) -> None:
    """Against the log's own columns: ATT in degrees from north, POS in degrees, IMU in FRD."""
    log_path = tmp_path / "boat.bin"
    log_path.write_bytes(lzma.decompress((DATA / "logs" / "boat-auto-calm.bin.xz").read_bytes()))
    names = ["fix", "odometry", "imu/data", "mode", "tf", "tf_static", "POS"]
    bag = written(log_path, tmp_path / "boat", "rosbag2-mcap", names)
    with AnyReader([bag]) as reader:
        read = [(one.topic, stamp, reader.deserialize(data, one.msgtype)) for one, stamp, data in reader.messages()]
    found: dict[str, list[Any]] = {}
    for topic, _, message in read:
        found.setdefault(topic, []).append(message)
    with open_log(log_path) as log:
        places, imu = log.tables["POS"], log.tables["IMU"]
        latitudes, rolls = np.asarray(places.values("Lat")), np.asarray(imu.values("GyrX"))
    assert [fix.latitude for fix in found["/fix"]] == pytest.approx(latitudes.tolist(), abs=1e-9)
    assert [row.lat for row in found["/POS"]] == pytest.approx(latitudes.tolist(), abs=1e-9)
    assert found["/imu/data"][100].linear_acceleration.z == pytest.approx(9.8, abs=1.0)
    assert abs(rolls).max() >= abs(found["/imu/data"][100].angular_velocity.x)
    assert {(each.header.frame_id, each.child_frame_id) for each in found["/odometry"]} == {("odom", "base_link")}
    for each in found["/odometry"]:
        for covariance in (each.pose.covariance, each.twist.covariance):
            assert np.diag(covariance.reshape(6, 6)).tolist() == [1e6] * 6  # a log states no accuracy
    speed = np.array([[each.twist.twist.linear.x, each.twist.twist.linear.y] for each in found["/odometry"]])
    sailing = speed[np.hypot(*speed.T) > 1.0]
    assert len(sailing) > 100
    assert np.median(sailing[:, 0]) > 5.0 * abs(np.median(sailing[:, 1]))  # a boat goes ahead
    assert "AUTO" in {mode.data for mode in found["/mode"]}
    assert [stamp for _, stamp, _ in read] == sorted(stamp for _, stamp, _ in read)


@pytest.mark.medium
def test_json_says_what_was_written(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = written(recording, tmp_path / "made", "rosbag2-mcap", ["wind"], as_json=True)
    said = json.loads(capsys.readouterr().out)
    assert (said["files"], said["rows"]) == ([str(bag)], 4)


def test_the_mcap_export_is_of_ros2_to_rosbags(recording: Path, tmp_path: Path) -> None:
    written(recording, tmp_path / "made.mcap", "mcap")
    with AnyReader([tmp_path / "made.mcap"]) as reader:
        assert reader.topics["/environment"].msgcount == 4
        for one, _, data in reader.messages():
            reader.deserialize(data, one.msgtype)


def test_the_order_of_messages_does_not_depend_on_the_speed_of_the_run(tmp_path: Path) -> None:
    read = []
    for often in (False, True):
        seconds = iter(range(100))
        path = tmp_path / f"{often}.mcap"
        file = McapFile(path, now_s=lambda seconds=seconds: float(next(seconds)))  # type: ignore[misc]
        clock, point = (file.ros_channel(topic, "geometry_msgs/msg/Point", "float64 x") for topic in ("/a", "/b"))
        for stamp_ns in (1, 2):
            point(POINT, stamp_ns)
            if often:
                file.flush_if_due()
            clock(POINT, stamp_ns)
        file.close()
        read.append([(topic, stamp_ns) for topic, _, _, stamp_ns in recorded_messages(open_log(path).files)])
    assert read[0] == read[1] == [("/a", 1), ("/b", 1), ("/a", 2), ("/b", 2)]
