"""Bags of ROS 1 and ROS 2, written and read back by `rosbags`."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import made_bags
import numpy as np
import pytest
from mcap_truth import table_is_equal
from rosbags.rosbag2 import CompressionMode, StoragePlugin

import xitl_cli.logs.signals as signals
from xitl_cli.logs import open_log
from xitl_cli.logs.formats.bag.ros1_bag import MAGIC, Ros1Bag
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log

STEPS = 40


def sent(store: Any) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for topic, _, _, message in made_bags.messages(store, STEPS):
        found.setdefault(topic, []).append(message)
    return found


def check(log: Log, store: Any) -> None:
    """Every value of every message, and when it was received."""
    assert not log.health.degraded
    assert not log.health.undecoded
    assert log.base == "utc"
    every = sent(store)
    assert set(log.tables) == set(every)
    for topic, messages in every.items():
        assert len(log.tables[topic]) == STEPS
        assert table_is_equal(log.tables[topic], messages) >= STEPS
    stamps = [stamp for topic, _, stamp, _ in made_bags.messages(store, STEPS) if topic == "/fix"]
    assert log.tables["/fix"].stamp_ns.tolist() == stamps
    assert (np.diff(log.tables["/imu/data"].file_offset) > 0).all()


@pytest.mark.parametrize("compression", [None, "LZ4", "BZ2"])
def test_a_ros1_bag_holds_what_was_written(tmp_path: Path, compression: str | None) -> None:
    with open_log(made_bags.write_bag1(tmp_path / "boat.bag", STEPS, compression)) as log:
        assert log.format == "rosbag1"
        assert log.closed
        assert int(log.facts["chunks"]) > 3
        check(log, made_bags.ROS1)


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("packed", [None, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_so_does_a_ros2_bag(tmp_path: Path, storage: StoragePlugin, packed: CompressionMode | None) -> None:
    if storage is StoragePlugin.MCAP and packed is CompressionMode.MESSAGE:
        pytest.skip("rosbag2 compresses the chunks of MCAP instead")
    with open_log(made_bags.write_bag2(tmp_path / "bag", STEPS, storage, packed)) as log:
        assert log.format == ("mcap" if storage is StoragePlugin.MCAP else "rosbag2")
        check(log, made_bags.ROS2)


def test_a_database_alone_is_a_bag_as_well(tmp_path: Path) -> None:
    with open_log(made_bags.write_bag2(tmp_path / "bag", STEPS) / "bag.db3") as log:
        check(log, made_bags.ROS2)


def test_a_bag_in_several_files_is_one_log(tmp_path: Path) -> None:
    folder = made_bags.write_bag2(tmp_path / "bag", STEPS)
    first, second = folder / "bag.db3", folder / "bag_1.db3"
    second.write_bytes(first.read_bytes())
    for file, kept in ((first, "<"), (second, ">=")):
        with sqlite3.connect(file) as database:
            middle = made_bags.BEGIN_NS + STEPS // 2 * made_bags.STEP_NS
            database.execute(f"DELETE FROM messages WHERE NOT timestamp {kept} {middle}")
        database.close()
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("  - bag.db3\n", "  - bag.db3\n  - bag_1.db3\n", 1))
    with open_log(folder) as log:
        check(log, made_bags.ROS2)
        assert log["/fix"].values("latitude", np.array([39, 0, 20])).tolist() == [
            log["/fix"]["latitude"][row] for row in (39, 0, 20)
        ]
    second.unlink()
    with open_log(folder) as log:
        assert len(log["/fix"]) == STEPS // 2
        assert "bag_1.db3" in log.health.damage[0].why


def test_types_of_ros_itself_need_no_definition_in_the_bag(tmp_path: Path) -> None:
    folder = made_bags.write_bag2(tmp_path / "bag", STEPS)
    with sqlite3.connect(folder / "bag.db3") as database:
        database.execute("DROP TABLE message_definitions")
    database.close()
    with open_log(folder) as log:
        assert table_is_equal(log["/odometry"], sent(made_bags.ROS2)["/odometry"]) >= STEPS
        rows, why = log.health.undecoded["/winch"]
    assert rows == STEPS
    assert "boat_msgs/msg/Winch" in why


def chunks_of(bag: Path) -> list[Any]:
    """Chunks of a whole bag, with place and size in the file."""
    with Ros1Bag(bag) as log:
        return list(log._chunks)


def test_a_bag_that_was_never_closed_reads_to_its_end(tmp_path: Path) -> None:
    whole = made_bags.write_bag1(tmp_path / "boat.bag", STEPS)
    data = whole.read_bytes()
    last = chunks_of(whole)[-1]
    chunk_end = last.place + last.size
    middle = last.place + last.size // 2
    cut = tmp_path / "boat.bag.active"
    cut.write_bytes(data[:chunk_end])  # the index of the last chunk and all behind it are missing
    with open_log(cut) as log:
        assert not log.closed
        assert log.health.unclosed
        assert {name: len(table) for name, table in log.tables.items()} == dict.fromkeys(sent(made_bags.ROS1), STEPS)
    cut.write_bytes(data[:middle])
    with open_log(cut) as log:
        assert log.health.truncated_bytes > 0
        assert 0 < len(log["/fix"]) < STEPS
        assert table_is_equal(log["/fix"], sent(made_bags.ROS1)["/fix"][: len(log["/fix"])]) > 0


def test_behind_damage_the_next_chunk_is_found(tmp_path: Path) -> None:
    path = made_bags.write_bag1(tmp_path / "boat.bag", STEPS)
    second, chunks = chunks_of(path)[1], len(chunks_of(path))
    data = bytearray(path.read_bytes())
    data[second.place - 60 : second.place + 40] = bytes(100)
    path.write_bytes(data)
    with Ros1Bag(path) as log:
        assert log.health.damaged == 1
        assert STEPS * (chunks - 2) / chunks < len(log["/winch"]) < STEPS


@pytest.mark.parametrize("cut", [14, 60, 200, 4200, 5000, 9000])
def test_cut_anywhere_it_is_refused_with_a_sentence_or_read(tmp_path: Path, cut: int) -> None:
    path = made_bags.write_bag1(tmp_path / "boat.bag", STEPS)
    path.write_bytes(path.read_bytes()[:cut])
    if cut < 4200:  # within the first record
        with pytest.raises(LogError, match="without a readable record"):
            open_log(path)
        return
    with open_log(path) as log:
        assert log.health.degraded
        for table in log.tables.values():
            assert len(table) < STEPS


@pytest.mark.medium
def test_noise_in_a_bag_never_raises(tmp_path: Path) -> None:
    data = made_bags.write_bag1(tmp_path / "boat.bag", STEPS, "LZ4").read_bytes()
    rng = np.random.default_rng(3)
    path = tmp_path / "noisy.bag"
    for _ in range(30):
        noisy = bytearray(data)
        for place in rng.integers(len(MAGIC), len(data), 40).tolist():
            noisy[place] = int(rng.integers(256))
        path.write_bytes(noisy)
        with open_log(path) as log:
            for table in log.tables.values():
                for column in table:
                    table.values(column)
            log.health.as_json()


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("old.bag", b"#ROSBAG V1.2\n" + bytes(50), "rosbag fix"),
        ("some.db3", b"SQLite format 3\0" + bytes(84), "SQLite"),
    ],
)
def test_what_is_no_bag_is_refused_with_a_sentence(tmp_path: Path, name: str, data: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(LogError, match=said):
        open_log(tmp_path / name)


def test_so_are_other_databases_and_folders(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "other.db3") as database:
        database.execute("CREATE TABLE birds (name TEXT)")
    database.close()
    with pytest.raises(LogError, match="not a ROS 2 bag"):
        open_log(tmp_path / "other.db3")
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  relative_file_paths: [bag_0.mcap]\n")
    with pytest.raises(LogError, match="none of these files exists"):
        open_log(folder)
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information: {{relative_file_paths: [{'b' * 300}.mcap]}}\n")
    with pytest.raises(LogError, match="none of these files exists"):
        open_log(folder)
    (folder / "metadata.yaml").write_text("{")
    with pytest.raises(LogError, match="not valid metadata of a bag"):
        open_log(folder)


def test_a_damaged_database_gives_what_is_before_the_damage(tmp_path: Path) -> None:
    path = made_bags.write_bag2(tmp_path / "bag", 400) / "bag.db3"
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2)
        file.write(b"\xff" * 4096)
    with open_log(path) as log:
        assert log.health.degraded
        assert 0 < len(log["/fix"]) < 400


@pytest.mark.parametrize("ros", [1, 2])
def test_a_foreign_bag_tells_attitude_position_and_speed(tmp_path: Path, ros: int) -> None:
    """Against the circle itself: counter-clockwise from the east, 2 m/s on 20 m."""
    path = made_bags.write_bag1(tmp_path / "boat.bag") if ros == 1 else made_bags.write_bag2(tmp_path / "bag")
    with open_log(path) as log:
        angle = made_bags.SPEED_MPS / made_bags.RADIUS_M * 0.1 * np.arange(STEPS)
        yaw, speed, rate = signals.yaw(log), signals.ground_speed(log), signals.yaw_rate(log)
        local, fixes = signals.position_ned(log), signals.position_geodetic(log)
        assert None not in (yaw, speed, rate, local, fixes)
        assert np.allclose(np.cos(np.radians(yaw.values) + angle), 1.0)
        assert np.allclose(speed.values, made_bags.SPEED_MPS)
        assert np.allclose(rate.values, -np.degrees(0.1))
        north_m, east_m = made_bags.RADIUS_M * np.sin(angle), made_bags.RADIUS_M * np.cos(angle)
        assert np.allclose(local.path.values[:, :2], np.stack([north_m, east_m], axis=1))
        assert np.allclose(fixes.values[:, 0], 52.0 + north_m / 111_195.0)
