"""A recording in several files: what each file has, judged by the `mcap` package, and the files as one log."""

from __future__ import annotations

import shutil
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove import messages
from mcap.reader import make_reader
from mcap.records import Channel, Message

from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.logs.export.repair import repair_log
from xitl_cli.logs.formats.mcap.recording_set import RecordingSet
from xitl_cli.record.mcap_file import McapFile, RecordingError, SplitLimits
from xitl_cli.record.mcap_writer import MESSAGE_BYTES
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.scene_changes import SceneChange, scene_changes
from xitl_cli.record.topics import SeaComponents

SECOND_NS = 1_000_000_000
BY_TIME = SplitLimits(time_ns=10 * SECOND_NS)


def entity(name: str, **values: Any) -> messages.SceneUpdate:
    return messages.SceneUpdate(entities=[messages.SceneEntity(frame_id="map", id=name, **values)])


def write(path: Path, split: SplitLimits | None, close: bool = True) -> Recorder:
    """A recording of 35 s with a message a second, and a scene that changes. It is flushed at its end only."""
    recorder = Recorder(McapFile(path, "lz4", now_s=map(float, count()).__next__, split=split), links=("agent",))
    recorder.metadata("xitl", {"profile": "test", "seed": "1"})
    recorder.attach("profile.yaml", "application/yaml", b"name: test\n")
    recorder.scene(entity("dam"))
    recorder.scene(entity("mission"))
    for second in range(36):
        stamp_ns = second * SECOND_NS
        recorder.fix(stamp_ns, -8.8, -63.95, float(second))
        recorder.frame_sent(stamp_ns, bytes([second] * 20))
        if second == 3:
            recorder.perception.odom_frame(stamp_ns, np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0]))
        if second == 12:
            recorder.scene(entity("mission", frame_locked=True), stamp_ns)
            recorder.scene(entity("flash", lifetime=messages.Duration(sec=1, nsec=0)), stamp_ns)
        if second == 23:
            deletion = messages.SceneEntityDeletion(type=messages.SceneEntityDeletionType.MatchingId, id="dam")
            recorder.scene(messages.SceneUpdate(deletions=[deletion]), stamp_ns)
    recorder.flush_if_due()
    if close:
        recorder.close()
    return recorder


def content(path: Path) -> tuple[list[tuple[Channel, Message]], dict[str, dict[str, str]], dict[str, bytes]]:
    """Messages, metadata and attachments of a file with an index, checked by their checksums."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        rows = [(channel, message) for _, channel, message in reader.iter_messages(log_time_order=False)]
        assert summary.statistics.message_count == len(rows)
        metadata = {one.name: dict(one.metadata) for one in reader.iter_metadata()}
        return rows, metadata, {one.name: one.data for one in reader.iter_attachments()}


def on_topic(path: Path, topic: str) -> list[Message]:
    return [message for channel, message in content(path)[0] if channel.topic == topic]


def by_topic(path: Path, repeated: bool) -> dict[str, list[tuple[int, int, bytes]]]:
    """Messages by topic. repeated: keep those that are published before the file begins."""
    topics: dict[str, list[tuple[int, int, bytes]]] = {}
    for channel, message in content(path)[0]:
        if repeated or message.publish_time >= message.log_time:
            row = message.log_time, message.publish_time, message.data
            topics.setdefault(channel.topic, []).append(row)
    return topics


def test_the_files_have_the_messages_of_the_unsplit_recording_in_order(tmp_path: Path) -> None:
    write(tmp_path / "whole.mcap", None)
    recorder = write(tmp_path / "run.mcap", BY_TIME)
    names = ["run.mcap", "run-002.mcap", "run-003.mcap", "run-004.mcap"]
    assert sorted(path.name for path in tmp_path.glob("run*")) == sorted(names)
    assert [file.file for file in recorder.files] == names
    assert [file.from_ns for file in recorder.files] == [0, 10 * SECOND_NS, 20 * SECOND_NS, 30 * SECOND_NS]
    assert [file.until_ns for file in recorder.files] == [second * SECOND_NS for second in (9, 19, 29, 35)]
    assert [file.size_bytes for file in recorder.files] == [(tmp_path / name).stat().st_size for name in names]
    joined: dict[str, list[tuple[int, int, bytes]]] = {}
    for name in names:
        for topic, rows in by_topic(tmp_path / name, repeated=False).items():
            joined.setdefault(topic, []).extend(rows)
    assert joined == by_topic(tmp_path / "whole.mcap", repeated=True)


def test_each_file_alone_has_what_a_viewer_needs(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", BY_TIME)
    _, _, attached = content(tmp_path / "run.mcap")
    odom = on_topic(tmp_path / "run.mcap", "/tf")[-1].data
    dam, first = (entity(name).encode() for name in ("dam", "mission"))
    second = entity("mission", frame_locked=True).encode()
    shown = {"run-002.mcap": [dam, first], "run-003.mcap": [dam, second], "run-004.mcap": [second]}
    for number, (name, entities) in enumerate(shown.items(), start=2):
        rows, metadata, also = content(tmp_path / name)
        assert also == attached
        assert metadata["xitl"] == {"profile": "test", "seed": "1"}
        assert metadata["xitl_split"]["number"] == str(number)
        begin_ns = (number - 1) * 10 * SECOND_NS
        assert min(message.log_time for _, message in rows) == begin_ns
        scene = on_topic(tmp_path / name, "/scene")[: len(entities)]
        assert [message.data for message in scene] == entities
        assert {message.log_time for message in scene} == {begin_ns}
        assert on_topic(tmp_path / name, "/tf")[0].data == odom


def test_a_file_has_at_most_the_bytes_of_the_limit(tmp_path: Path) -> None:
    most = 20_000
    file = McapFile(tmp_path / "run.mcap", "none", now_s=lambda: 0.0, split=SplitLimits(message_bytes=most))
    log = file.ros_channel("/x", "t/msg/X", "uint8[] x")
    sizes = [100, 7000, 12_000, 300, 30_000, 50, 19_000]
    for stamp, size in enumerate(sizes):
        log(bytes(size), stamp)
    file.close()
    found = [[len(one.data) for one in on_topic(tmp_path / part.file, "/x")] for part in file.files]
    assert found == [[100, 7000, 12_000, 300], [30_000], [50, 19_000]]
    assert all(sum(MESSAGE_BYTES + size for size in part) <= most for part in found if len(part) > 1)


def test_waves_set_by_an_operator_are_repeated(tmp_path: Path) -> None:
    recorder = Recorder(McapFile(tmp_path / "run.mcap", "lz4", split=BY_TIME), links=("agent",))
    for second, height_m in ((1, 0.1), (2, 0.5)):
        recorder.write(second * SECOND_NS, SeaComponents((height_m,), (1.0,), (0.0,), (0.0,), (0.0,)))
    recorder.fix(11 * SECOND_NS, 0.0, 0.0, 0.0)
    recorder.close()
    waves = on_topic(tmp_path / "run.mcap", "/environment/waves")
    assert [one.data for one in on_topic(tmp_path / "run-002.mcap", "/environment/waves")] == [waves[-1].data]


def test_changes_of_a_scene_are_those_that_were_encoded() -> None:
    kinds = messages.SceneEntityDeletionType
    update = messages.SceneUpdate(
        deletions=[
            messages.SceneEntityDeletion(timestamp=messages.Timestamp(1, 5), type=kinds.MatchingId, id="old"),
            messages.SceneEntityDeletion(type=kinds.All),
        ],
        entities=[
            messages.SceneEntity(frame_id="map", id="boom", texts=[messages.TextPrimitive(text="boom")]),
            messages.SceneEntity(frame_id="odom", id="ghost", lifetime=messages.Duration(sec=2, nsec=0)),
        ],
    )
    boom = messages.SceneUpdate(
        entities=[messages.SceneEntity(frame_id="map", id="boom", texts=[messages.TextPrimitive(text="boom")])]
    )
    assert list(scene_changes(update.encode())) == [
        SceneChange(("", "old"), None),
        SceneChange((), None),
        SceneChange(("map", "boom"), boom.encode()),
        SceneChange(("odom", "ghost"), None),
    ]
    with pytest.raises(ValueError, match="beyond its message"):
        list(scene_changes(boom.encode()[:-1]))


@pytest.mark.parametrize("length", [100, 200, 20_000, 3_000_000])
def test_long_entities_and_fields_of_other_versions_are_passed_over(length: int) -> None:
    """A length takes up to four bytes. Field 15 is a number of two bytes, of eight and of four fixed ones."""
    boom = messages.SceneEntity(frame_id="map", id="boom", texts=[messages.TextPrimitive(text="x" * length)])
    update = messages.SceneUpdate(entities=[boom]).encode()
    unknown = b"\x78\xac\x02", b"\x79" + b"\x12" * 8, b"\x7d" + b"\x12" * 4
    changes = list(scene_changes(b"".join(field + update for field in unknown)))
    assert changes == [SceneChange(("map", "boom"), update)] * 3
    for field in unknown:
        with pytest.raises(ValueError, match="beyond its message"):
            list(scene_changes(update + field[:-1]))
    with pytest.raises(ValueError, match="unknown wire type 3"):
        list(scene_changes(update + b"\x7b"))


def test_the_set_is_one_log_equal_to_the_unsplit_recording(tmp_path: Path) -> None:
    write(tmp_path / "whole.mcap", None)
    write(tmp_path / "run.mcap", BY_TIME)
    for path in (tmp_path / "run.mcap", tmp_path):
        with open_log(tmp_path / "whole.mcap") as whole, open_log(path) as joined:
            assert isinstance(joined, RecordingSet)
            assert list(joined.tables) == list(whole.tables)
            assert set(joined.rowless) == set(whole.rowless)
            assert joined.span_ns == whole.span_ns
            assert joined.base == "simulation"
            assert joined.health.records == whole.health.records
            assert not joined.health.degraded
            assert joined.attachment("profile.yaml") == b"name: test\n"
            for name, table in whole.tables.items():
                assert list(joined.payloads(name)) == list(whole.payloads(name))
                np.testing.assert_array_equal(joined[name].stamp_ns, table.stamp_ns)
                assert joined[name].columns == table.columns
                assert (np.diff(joined[name].file_offset) > 0).all()
                for column in table:
                    np.testing.assert_array_equal(joined[name][column], table[column])
            rows = np.array([30, 2, 11, 11])
            np.testing.assert_array_equal(
                joined["/truth/fix"].values("altitude", rows), whole["/truth/fix"].values("altitude", rows)
            )


def test_a_later_file_alone_is_that_file(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", BY_TIME)
    with open_log(tmp_path / "run-003.mcap") as log:
        assert log.path.name == "run-003.mcap"
        assert log.span_ns == (20 * SECOND_NS, 29 * SECOND_NS)
        assert len(log["/truth/fix"]) == 10
        assert len(log["/scene"]) == 3  # the dam and the mission, and the deletion of the dam


def test_each_gap_is_named_in_one_sentence(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", SplitLimits(time_ns=5 * SECOND_NS))
    for number in (3, 4, 6, 8):
        (tmp_path / f"run-{number:03d}.mcap").unlink()
    with open_log(tmp_path) as log:
        assert log.health.degraded
        assert log.health.gaps == (
            "run-003.mcap to run-004.mcap are missing: no data from 9.0 s to 20.0 s; copy all files of the run again",
            "run-006.mcap is missing: no data from 24.0 s to 30.0 s; copy all files of the run again",
            "run-008.mcap is missing: no data from 34.0 s on; copy all files of the run again",
        )
        assert sorted(set(log["/truth/fix"]["altitude"] // 5)) == [0, 1, 4, 6]


def test_a_file_without_any_byte_is_named(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", BY_TIME)
    (tmp_path / "run-004.mcap").write_bytes(b"")
    with open_log(tmp_path) as log:
        assert log.health.gaps == (
            "run-004.mcap is empty: no data from 29.0 s on; the run was killed there, or the file was not copied",
        )
    (tmp_path / "run-002.mcap").write_bytes(b"not a recording")
    with open_log(tmp_path) as log:
        assert log.health.gaps[0].startswith("run-002.mcap cannot be read (")
        assert "no data from 9.0 s to 20.0 s" in log.health.gaps[0]


def test_files_of_another_run_or_name_do_not_join(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", BY_TIME)
    shutil.copy(tmp_path / "run-002.mcap", tmp_path / "run-005.mcap")
    other = McapFile(tmp_path / "run-006.mcap")
    other.metadata("xitl", {"profile": "other", "seed": "2"})
    other.metadata("xitl_split", {"number": "6", "from_ns": "0", "repeated": "{}"})
    other.close()
    with open_log(tmp_path) as log:
        assert log.facts["files"] == "4"
        assert not log.health.degraded


def test_a_recording_that_reached_no_limit_is_one_file(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap", SplitLimits(time_ns=100 * SECOND_NS))
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]
    with open_log(tmp_path) as log:
        assert not isinstance(log, RecordingSet)
        assert not log.health.degraded


def test_without_an_end_only_the_last_file_lacks_its_index(tmp_path: Path) -> None:
    recorder = write(tmp_path / "run.mcap", BY_TIME, close=False)
    for name in ("run.mcap", "run-002.mcap", "run-003.mcap"):
        content(tmp_path / name)
    with open_log(tmp_path) as log:
        assert log.health.unclosed
        assert not log.health.gaps
        np.testing.assert_array_equal(log["/truth/fix"]["altitude"], np.arange(36.0))
        repaired = repair_log(log, None, overwrite=False)
        assert repaired.out == tmp_path / "run-004-repaired.mcap"
    recorder.close()


def test_a_next_file_that_exists_is_refused_and_stays(tmp_path: Path) -> None:
    (tmp_path / "run-002.mcap").write_bytes(b"mine")
    file = McapFile(tmp_path / "run.mcap", split=BY_TIME)
    log = file.ros_channel("/x", "t/msg/X", "uint8[] x")
    log(b"1", 0)
    with pytest.raises(RecordingError, match=r"run-002.mcap: the next file .* cannot be created \(File exists\)"):
        log(b"2", 10 * SECOND_NS)
    log(b"3", 30 * SECOND_NS)
    file.close()
    assert (tmp_path / "run-002.mcap").read_bytes() == b"mine"
    assert [one.data for one in on_topic(tmp_path / "run.mcap", "/x")] == [b"1"]
    assert [part.file for part in file.files] == ["run.mcap"]
    assert issubclass(RecordingError, UserError)


@pytest.mark.parametrize(
    ("limits", "stamps_s", "bytes_each", "begins_s"),
    [
        (SplitLimits(time_ns=2 * SECOND_NS), (0.0, 1.5, 3.0, 4.5, 6.0, 7.5), 10, (0.0, 3.0, 4.5, 6.0)),
        (SplitLimits(time_ns=2 * SECOND_NS), (0.0, 1.9, 9.0, 9.9, 10.0), 10, (0.0, 9.0, 10.0)),
        (SplitLimits(message_bytes=3 * (MESSAGE_BYTES + 10)), range(7), 10, (0.0, 3.0, 6.0)),
        (SplitLimits(message_bytes=100), range(3), 1000, (0.0, 1.0, 2.0)),  # one message is larger than the limit
        (
            SplitLimits(message_bytes=3 * (MESSAGE_BYTES + 10), time_ns=4 * SECOND_NS),
            (0.0, 0.5, 1.0, 3.0, 4.0, 6.9, 7.0, 8.0),
            10,
            (0.0, 3.0, 7.0),  # four seconds from the file of 3 s on
        ),
    ],
)
def test_a_next_file_begins_at_whole_periods_and_when_a_file_is_full(
    tmp_path: Path, limits: SplitLimits, stamps_s: Any, bytes_each: int, begins_s: tuple[float, ...]
) -> None:
    file = McapFile(tmp_path / "run.mcap", "none", split=limits)
    write_payload = file.ros_channel("/data", "pkg/msg/Data", "uint8[] data\n")
    for stamp_s in stamps_s:
        write_payload(bytes(bytes_each), round(stamp_s * SECOND_NS))
    file.close()
    assert [one.from_ns * 1e-9 for one in file.files] == pytest.approx(begins_s)
