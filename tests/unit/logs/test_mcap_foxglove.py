"""Recordings of foxglove-sdk, against protobuf's runtime and the json module; and hand-made JSON."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove import Channel, Context, channels, messages, open_mcap
from google.protobuf import descriptor_pb2
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_truth import is_equal

from xitl_cli.logs.formats.mcap.file import McapLog


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foxglove") / "fox.mcap"
    context = Context()
    with open_mcap(path, context=context):
        pose = channels.PoseInFrameChannel("/pose", context=context)
        scan = channels.LaserScanChannel("/scan", context=context)
        frames = channels.FrameTransformsChannel("/frames", context=context)
        cloud = channels.PointCloudChannel("/cloud", context=context)
        scene = channels.SceneUpdateChannel("/scene", context=context)
        fix = channels.LocationFixChannel("/fix", context=context)
        told = Channel("/told", message_encoding="json", context=context)
        for step in range(30):
            stamp = messages.Timestamp(sec=step, nsec=7)
            vector = messages.Vector3(x=0.1 * step, y=-1.0, z=math.nan)
            turn = messages.Quaternion(x=0.0, y=0.0, z=0.6, w=0.8)
            at = {"log_time": 10**9 * (step + 1)}
            place = messages.Pose(position=vector, orientation=turn) if step % 3 else None
            pose.log(messages.PoseInFrame(timestamp=stamp, frame_id="f" * step, pose=place), **at)
            scan.log(messages.LaserScan(frame_id="scan", ranges=[1.5] * (step % 5), intensities=[2.0, 3.0]), **at)
            one = messages.FrameTransform(timestamp=stamp, child_frame_id="b", translation=vector, rotation=turn)
            frames.log(messages.FrameTransforms(transforms=[one] * (1 + step % 2)), **at)
            field = messages.PackedElementField(name="x", offset=0, type=messages.PackedElementFieldNumericType.Float32)
            cloud.log(messages.PointCloud(fields=[field], data=bytes(range(4 * step))), **at)
            metadata = [messages.KeyValuePair(key="a", value=str(step))]
            scene.log(messages.SceneUpdate(entities=[messages.SceneEntity(id="e", metadata=metadata)]), **at)
            covariance = [float(step)] * 9
            fix.log(messages.LocationFix(latitude=1.0, longitude=2.0, position_covariance=covariance), **at)
            told.log({"count": step, "deep": {"x": 0.5 * step, "ok": step % 2 == 0}, "name": "n" * (step % 3)}, **at)
    return path


def test_every_value_of_every_topic_is_the_same(recorded: Path) -> None:
    assert is_equal(recorded, extra=frozenset({"/told"})) > 1000


def test_the_facts_of_the_file_are_those_of_its_summary(recorded: Path) -> None:
    with recorded.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    with McapLog(recorded) as log:
        assert log.facts["chunks"] == str(len(summary.chunk_indexes))
        assert log.facts["compression"] == summary.chunk_indexes[0].compression
        assert "attachments" not in log.facts


def test_what_is_not_there_is_not_made_up(recorded: Path) -> None:
    with McapLog(recorded) as log:
        x = log.tables["/pose"].values("pose.position.x")
        assert np.isnan(x[::3]).all()  # no pose in these
        assert np.isfinite(np.delete(x, np.arange(0, 30, 3))).all()
        assert set(log.tables["/scan"].values("timestamp")) == {-1}
        assert log.tables["/scan"].columns["ranges"].shape == (-1,)
        assert log.tables["/fix"].columns["position_covariance"].shape == (9,)
        assert "transforms[0].translation.x" in log.tables["/frames"].columns
        assert "transforms[1].translation.x" not in log.tables["/frames"].columns


def test_json_is_flattened_the_same_way(recorded: Path) -> None:
    with McapLog(recorded) as log:
        told = log.tables["/told"]
        assert told.values("count").tolist() == list(range(30))
        assert told.values("count").dtype == np.int64
        assert told.values("deep.x").tolist() == [0.5 * step for step in range(30)]
        assert told.values("deep.ok").tolist() == [1, 0] * 15
        assert told.values("name").tolist() == ["n" * (step % 3) for step in range(30)]


def _json_log(path: Path, rows: list[Any], schema: bytes | None = None) -> McapLog:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=200)
        writer.start("", "")
        number = 0 if schema is None else writer.register_schema("t", "jsonschema", schema)
        channel = writer.register_channel("/t", "json", number)
        for step, row in enumerate(rows):
            payload = row if isinstance(row, bytes) else json.dumps(row).encode()
            writer.add_message(channel, step, payload, step)
        writer.finish()
    return McapLog(path)


def test_json_whose_keys_come_and_go(tmp_path: Path) -> None:
    rows = [
        {"a": 1},
        {"a": 2.5, "b": "x"},
        {"b": 3, "c": [1, 2]},
        {"c": []},
        {"d": [{"e": 1}, {"e": "f"}]},
        {"a": None},
    ]
    with _json_log(tmp_path / "j.mcap", rows * 5, b"{}") as log:
        table = log.tables["/t"]
        np.testing.assert_array_equal(table.values("a"), [1, 2.5, *[math.nan] * 4] * 5)
        assert table.values("b").tolist() == ["", "x", "3", "", "", ""] * 5
        assert table.columns["c"].shape == (-1,)
        np.testing.assert_array_equal(table.values("c")[2], [1, 2])
        assert np.isnan(table.values("c")[3]).all()
        np.testing.assert_array_equal(table.values("d[0].e")[4::6], [1] * 5)
        np.testing.assert_array_equal(table.values("d.length")[4::6], [2] * 5)


def test_json_that_is_none_is_left_out_and_counted(tmp_path: Path) -> None:
    deep = b"[" * 100_000
    rows = [{"a": 1}, b"{", deep, b"\xff\xfe", b"", {"a": 2**70}, b'{"a": 1e999}', b'{"a": ' + b"9" * 5000 + b"}"]
    with _json_log(tmp_path / "bad.mcap", rows) as log:
        assert log.tables["/t"].values("a").tolist() == [1, 2.0**70, math.inf]
        assert log.health.undecoded["/t"][0] == 5


def test_json_without_an_object_is_one_value(tmp_path: Path) -> None:
    with _json_log(tmp_path / "v.mcap", [1, 2, 3]) as log:
        assert log.tables["/t"].values("value").tolist() == [1, 2, 3]


def _protobuf_log(path: Path, schema: bytes, name: str, payloads: list[bytes]) -> McapLog:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "")
        channel = writer.register_channel("/t", "protobuf", writer.register_schema(name, "protobuf", schema))
        for step, payload in enumerate(payloads):
            writer.add_message(channel, step, payload, step)
        writer.finish()
    return McapLog(path)


def test_protobuf_that_refers_to_itself_or_is_garbage(tmp_path: Path) -> None:
    kinds = descriptor_pb2.FieldDescriptorProto
    tree = descriptor_pb2.DescriptorProto(name="Tree")
    tree.field.add(name="next", number=1, type=kinds.TYPE_MESSAGE, type_name=".t.Tree", label=kinds.LABEL_OPTIONAL)
    tree.field.add(name="value", number=2, type=kinds.TYPE_INT32, label=kinds.LABEL_OPTIONAL)
    file = descriptor_pb2.FileDescriptorProto(name="t.proto", package="t", syntax="proto3", message_type=[tree])
    schema = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    with _protobuf_log(tmp_path / "tree.mcap", schema, "t.Tree", [b"\x10\x05", b"\xff\xff", b"\x10\x07"]) as log:
        assert log.tables["/t"].values("value").tolist() == [5, 7]
        assert np.isnan(log.tables["/t"].values("next.value")).all()
        assert log.health.undecoded["/t"][0] == 1
    for garbage in (schema[:-3], b"", b"\x00" * 50, schema):
        with _protobuf_log(tmp_path / "bad.mcap", garbage, "t.Other", [b"\x10\x05"]) as log:
            assert log.health.undecoded["/t"] == (1, "its definition cannot be read")
            assert log.tables["/t"].columns == {}
