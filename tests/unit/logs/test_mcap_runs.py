"""A run of our own, against the `mcap` package with its ROS 2 decoder and protobuf's runtime."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_truth import is_equal, payloads_of

from tests.recorded_run import recorded_run
from xitl_cli.logs.formats.mcap import container
from xitl_cli.logs.formats.mcap import table as table_module
from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.model.file_bytes import FileReader
from xitl_cli.logs.summary import summarize_log
from xitl_cli.record.mcap_file import McapFile

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run() -> Path:
    return recorded_run("sitl", 12.0) / "run.mcap"


def test_every_value_of_every_topic_is_the_same(run: Path) -> None:
    assert is_equal(run) > 40_000


def test_a_run_says_what_it_is(run: Path) -> None:
    with McapLog(run) as log:
        assert (log.format, log.base) == ("mcap", "simulation")
        assert log.facts["profile"] == "sitl"
        assert log.facts["seed"] == "1"
        assert log.facts["compression"] == "lz4"
        health = log.health
        assert not health.degraded
        assert health.undecoded == {}
        assert log.attachment("profile.yaml") == (run.parent / "profile.yaml").read_bytes()
        assert (log.attachment("xitl.xml") or b"").startswith(b"<?xml")
        assert log.attachment("none") is None
        stamps = np.concatenate([table.stamp_ns for table in log.tables.values()])
        assert log.span_ns == (stamps.min(), stamps.max())
        assert log.tables["/truth/state"].columns["velocity_ned_mps"].unit == "m/s"
        assert log.tables["/truth/state"].columns["stamp"].unit == "ns"


def test_raw_frames_are_also_there_decoded(run: Path) -> None:
    with McapLog(run) as log:
        assert not any(":" in name for name in log.tables)
        attitude = log.tables["/link/agent/rx:ATTITUDE_QUATERNION"]
        frames = log.tables["/link/agent/rx"].values("frame")
        assert len(attitude) == sum(frame[7:10] == b"\x1f\x00\x00" for frame in frames)
        assert "/link/agent/rx:HEARTBEAT" in log.tables
        assert "/link/agent/rx:NONE" not in log.tables
        assert "/truth/state:HEARTBEAT" not in log.tables
        assert sum(len(table) for table in log.frame_tables("/link/agent/rx").values()) == len(frames)
        assert log.health.undecoded == {}


def test_rows_can_be_had_in_any_order(run: Path) -> None:
    with McapLog(run) as log:
        table = log.tables["/truth/state"]
        whole = table.values("position_ned_m")
        chosen = np.array([7, 3, 3, len(table) - 1])
        np.testing.assert_array_equal(table.values("position_ned_m", chosen), whole[chosen])
        np.testing.assert_array_equal(table.values("position_ned_m", slice(5, 9)), whole[5:9])
        np.testing.assert_array_equal(
            table.values("position_ned_m", table.stamp_ns < 10**9), whole[table.stamp_ns < 10**9]
        )
        assert table.values("position_ned_m", slice(0, 0)).shape == (0, 3)
        with pytest.raises(KeyError):
            table.values("no such column")


def test_damage_inside_of_a_chunk_is_told_with_the_summary(run: Path, tmp_path: Path) -> None:
    """It is found when the topics are read, and not when the file is opened."""
    with run.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    data = bytearray(run.read_bytes())
    chunk = summary.chunk_indexes[0]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0x10
    (tmp_path / "run.mcap").write_bytes(data)
    with McapLog(tmp_path / "run.mcap") as log:
        assert not log.health.degraded
        assert summarize_log(log).health.degraded


@pytest.mark.parametrize("share", [0.35, 0.7, 0.97])
def test_a_run_cut_off_keeps_what_was_written(run: Path, tmp_path: Path, share: float) -> None:
    data = run.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(len(data) * share)])
    known = payloads_of(cut)
    with McapLog(cut) as log:
        assert log.health.unclosed
        assert log.health.degraded
        for topic, messages in known.items():
            stamps = log.tables[topic].stamp_ns[: len(messages)]
            np.testing.assert_array_equal(stamps, [stamp for stamp, _ in messages])
        whole = payloads_of(run)
        for topic, table in log.tables.items():  # what was saved of the last chunk is what had been written
            np.testing.assert_array_equal(table.stamp_ns, [stamp for stamp, _ in whole[topic][: len(table)]])


@pytest.mark.parametrize("compression", ["lz4", "zstd", "none"])
def test_one_topic_does_not_cost_the_whole_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: str
) -> None:
    """A point cloud and a number a second apart, over twenty seconds: who wants the number does not read the cloud."""
    path, now_s, random = tmp_path / "cloud.mcap", [0.0], np.random.default_rng(3)
    file = McapFile(path, compression, now_s=lambda: now_s[0])
    cloud = file.ros_channel("/cloud", "t/msg/Cloud", "uint8[] data")
    number = file.ros_channel("/number", "t/msg/Number", "float64 x")
    clouds = [random.bytes(20_000) for _ in range(200)]
    for step, points in enumerate(clouds):
        now_s[0] = step * 0.1
        cloud(b"\0\1\0\0" + len(points).to_bytes(4, "little") + points, step)
        if step % 10 == 0:
            number(b"\0\1\0\0" + np.float64(step).tobytes(), step)
        file.flush_if_due()
    file.close()
    read_bytes, read = [0], FileReader.read

    def counted(self: FileReader, place: int, size: int) -> bytes:
        data = read(self, place, size)
        read_bytes[0] += len(data)
        return data

    monkeypatch.setattr(FileReader, "read", counted)
    with McapLog(path) as log:
        assert {name: table.indexed_rows for name, table in log.tables.items()} == {"/cloud": 200, "/number": 20}
        assert log.tables["/number"].values("x").tolist() == list(range(0, 200, 10))
        assert read_bytes[0] < 0.05 * path.stat().st_size
        assert log.tables["/cloud"].values("data").tolist() == clouds
        assert not log.health.degraded


def test_topics_too_large_to_keep_are_read_again(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With no room for payloads, and batches of a few chunks, the values are the same."""

    def values() -> dict[str, list[object]]:
        with McapLog(run) as log:
            tables = {name: log.tables[name] for name in ("/truth/state", "/tf", "/link/agent/rx", "/tasks")}
            return {
                f"{name} {column}": table.values(column, slice(20, 90)).tolist()
                for name, table in tables.items()
                for column in table.columns
            }

    whole = values()
    monkeypatch.setattr(table_module, "_KEPT_BYTES", 0)
    monkeypatch.setattr(container, "BATCH_BYTES", 1000)
    with McapLog(run) as log:
        assert log.tables["/truth/state"].survey().kept is None
    assert values() == whole
    monkeypatch.setattr(table_module, "_PLAIN_BYTES", 0)
    assert values() == whole
