"""The writer's files beside those of the `mcap` package's own."""

from __future__ import annotations

import io
import tracemalloc
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from xitl_cli.record.mcap_writer import ChunkWriter, message_record

CHUNKS = (
    [(1, 20, b"b" * 300, 19), (2, 10, b"", 10), (1, 30, bytes(range(256)), 30)],
    [(3, 5, b"late", 0)],
    [(2, 2**63, b"far", 2**64 - 1)] * 3,
)
"""Channel, log time, payload and publish time."""


@pytest.mark.parametrize(
    ("name", "theirs"), [("lz4", CompressionType.LZ4), ("zstd", CompressionType.ZSTD), ("none", CompressionType.NONE)]
)
def test_a_file_is_byte_for_byte_that_of_the_package(name: str, theirs: CompressionType) -> None:
    ours_stream, their_stream = io.BytesIO(), io.BytesIO()
    ours, other = ChunkWriter(ours_stream, name), Writer(their_stream, compression=theirs, chunk_size=1 << 20)
    other.start("xitl", "xitl")
    for number in (1, 2):
        schema = (f"t/msg/X{number}", "ros2msg", b"uint8[] x" * number)
        assert ours.register_schema(*schema) == other.register_schema(*schema) == number
    ours.metadata("run", {"seed": "1", "ünit": "m/s²"})
    other.add_metadata("run", {"seed": "1", "ünit": "m/s²"})
    for topic, schema_id in (("/a", 1), ("/b", 2)):
        assert ours.register_channel(topic, "cdr", schema_id) == other.register_channel(topic, "cdr", schema_id)
    for number, chunk in enumerate(CHUNKS):
        if number == 1:  # another channel and a file in between
            assert ours.register_channel("/c", "cdr", 1) == other.register_channel("/c", "cdr", 1)
            ours.attach("profile.yaml", "application/yaml", b"extends: sitl\n")
            other.add_attachment(0, 0, "profile.yaml", "application/yaml", b"extends: sitl\n")
        ours.write_chunk(
            [(channel, log_ns, message_record(channel, log_ns, *rest)) for channel, log_ns, *rest in chunk]
        )
        for message in chunk:
            other.add_message(*message)
        other.flush()
    ours.finish()
    other.finish()
    assert ours_stream.getvalue() == their_stream.getvalue()


def test_an_empty_file_is_too() -> None:
    ours_stream, their_stream = io.BytesIO(), io.BytesIO()
    ChunkWriter(ours_stream, "lz4").finish()
    other = Writer(their_stream)
    other.start("xitl", "xitl")
    other.finish()
    assert ours_stream.getvalue() == their_stream.getvalue()


@pytest.mark.medium
def test_the_memory_of_a_writer_does_not_grow_with_its_chunks(tmp_path: Path) -> None:
    chunks = 1600  # the index of half of them is larger than the part of it in memory
    with (tmp_path / "run.mcap").open("wb") as stream:
        writer = ChunkWriter(stream, "none")
        schema = writer.register_schema("t/msg/X", "ros2msg", b"uint8 x")
        channel = writer.register_channel("/x", "cdr", schema)

        def traced_bytes(first: int, end: int) -> int:
            for number in range(first, end):
                writer.write_chunk([(channel, 1000 + number, message_record(channel, 1000 + number, b"x", 0))])
            return tracemalloc.get_traced_memory()[0]

        tracemalloc.start()
        try:
            before = traced_bytes(0, chunks // 2)
            after = traced_bytes(chunks // 2, chunks)
        finally:
            tracemalloc.stop()
        assert after - before < chunks // 2  # less than a byte for each chunk
        assert writer.span_ns == (1000, 999 + chunks)
        writer.finish()
    with (tmp_path / "run.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        assert len(summary.chunk_indexes) == chunks
        assert [message.log_time for _, _, message in reader.iter_messages()] == list(range(1000, 1000 + chunks))
