"""`xitl logs repair`: what it writes is whole to the readers of others, and holds all that could be read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros_files import write
from mcap_truth import payloads_of

from tests.golden import Golden
from tests.recorded import CALM
from xitl_cli.logs import open_log
from xitl_cli.logs.export.repair import RepairResult, repair_log
from xitl_cli.logs.model.errors import LogError

_ANY = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)
Content = dict[str, Any]


def content(path: Path, reader_type: type[SeekingReader | NonSeekingReader]) -> Content:
    """All there is in a file by one of the readers of the `mcap` package, which checks every checksum."""
    with path.open("rb") as file:
        reader = reader_type(file, validate_crcs=True)
        messages: dict[str, list[Any]] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            told = schema and (schema.name, schema.encoding, schema.data)
            kind = (channel.topic, channel.message_encoding, tuple(channel.metadata.items()), told)
            one = (message.log_time, message.publish_time, message.sequence, message.data)
            messages.setdefault(channel.topic, []).append((kind, one))
    with path.open("rb") as file:
        attachments = list(reader_type(file, validate_crcs=True).iter_attachments())
    with path.open("rb") as file:
        metadata = list(reader_type(file, validate_crcs=True).iter_metadata())
    return {"messages": messages, "attachments": attachments, "metadata": metadata}


def whole_content(path: Path) -> Content:
    """As `content` of both readers, which must say the same, and so must the summary, and our own reader."""
    sought = content(path, SeekingReader)
    assert sought == content(path, NonSeekingReader)
    with path.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = {summary.channels[key].topic: count for key, count in summary.statistics.channel_message_counts.items()}
    assert counts == {topic: len(messages) for topic, messages in sought["messages"].items()}
    assert summary.statistics.message_count == sum(counts.values())
    assert len(summary.attachment_indexes) == len(sought["attachments"])
    with open_log(path) as log:
        assert {topic: table.indexed_rows for topic, table in log.tables.items()} == counts
        for table in log.tables.values():
            assert len(table.stamp_ns) or log.health.undecoded
        assert not log.health.degraded
    return sought


def repaired(path: Path, **options: Any) -> RepairResult:
    with open_log(path) as log:
        return repair_log(log, options.pop("out", None), options.pop("overwrite", True))


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("repair")
    for compression in CompressionType:
        write(place / f"{compression.name}.mcap", 14, compression, chunk_size=8000)
    for name, options in (("loose", {"use_chunking": False}), ("mixed", {"chunk_size": 4000})):
        with (place / f"{name}.mcap").open("wb") as file:
            writer = Writer(file, compression=CompressionType.ZSTD, **options)  # type: ignore[arg-type]
            writer.start("test", "by hand")
            for number in range(2):  # two of one name
                writer.add_metadata("m", {"a": str(number)})
            schema = writer.register_schema("t/T", "ros2msg", b"uint8[] data")
            channels = [
                writer.register_channel("/a", "cdr", schema, {"qos": "best"}),
                writer.register_channel("/b", "cdr", 0),
            ]
            for step in range(300):
                payload = b"\0\1\0\0" + (step % 90).to_bytes(4, "little") + bytes(range(step % 90))
                writer.add_message(channels[step % 2], 2**63 + step, payload, step, sequence=step)
                if step == 150:
                    writer.add_attachment(7, 5, "a", "text/plain", b"attached" * 1000)
            writer.finish()
    return place


def bytes_of(recordings: Path, kind: str) -> bytes:
    return (recordings / f"{kind}.mcap").read_bytes()


KINDS = ("NONE", "LZ4", "ZSTD", "loose", "mixed")


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_lost_of_a_file_without_its_end(tmp_path: Path, recordings: Path, kind: str) -> None:
    (tmp_path / "run.mcap").write_bytes(bytes_of(recordings, kind))
    before = content(tmp_path / "run.mcap", NonSeekingReader)
    (tmp_path / "run.mcap").write_bytes(bytes_of(recordings, kind)[:-25])
    with (tmp_path / "run.mcap").open("rb") as file, pytest.raises(McapError):
        SeekingReader(file).get_summary()
    done = repaired(tmp_path / "run.mcap")
    assert done.out == tmp_path / "run-repaired.mcap"
    assert whole_content(done.out) == before
    assert done.written is not None
    assert done.written.messages == sum(map(len, before["messages"].values()))
    assert (done.written.rebuilt > 0) == (kind == "loose")


@pytest.mark.medium
@given(st.data())
@_ANY
def test_a_file_cut_at_any_byte(tmp_path: Path, recordings: Path, data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(KINDS))
    path = tmp_path / "cut.mcap"
    all_of_it = bytes_of(recordings, kind)
    path.write_bytes(all_of_it[: data.draw(st.integers(500, len(all_of_it) - 1))])
    known = payloads_of(path)
    with open_log(path) as log:
        rows = {name: table.indexed_rows for name, table in log.tables.items()}
    if not rows:
        with pytest.raises(LogError, match="nothing to repair"):
            repaired(path)
        return
    done = repaired(path)
    assert done.out is not None
    found = whole_content(done.out)["messages"]
    assert {topic: len(messages) for topic, messages in found.items()} == rows
    whole = tmp_path / "whole.mcap"
    whole.write_bytes(all_of_it)
    before = content(whole, NonSeekingReader)["messages"]
    for topic, messages in found.items():
        assert messages == before[topic][: len(messages)]
        assert len(messages) >= len(known.get(topic, ())) - 1  # whose last may be the first half of a message


_DAMAGE = st.tuples(st.integers(0, 10**6), st.sampled_from((1, 9, 512)), st.sampled_from((b"\0", b"\xff")))


@pytest.mark.medium
@given(kind=st.sampled_from(KINDS), damage=st.lists(_DAMAGE, min_size=1, max_size=4))
@example(kind="ZSTD", damage=[(73338, 512, b"\0"), (499477, 512, b"\0")])
@example(kind="loose", damage=[(131, 1, b"\0")])
@_ANY
def test_damage_anywhere_leaves_a_file_that_is_whole(
    tmp_path: Path, recordings: Path, kind: str, damage: list[tuple[int, int, bytes]]
) -> None:
    damaged = bytearray(bytes_of(recordings, kind))
    for at, size, byte in damage:
        place = 60 + at % (len(damaged) - 60)
        damaged[place : place + size] = byte * len(damaged[place : place + size])
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    with open_log(path) as log:
        channels = any(table.indexed_rows for table in log.tables.values())
    if not channels:  # the first chunk and the summary, which alone describe them, both hit
        with pytest.raises(LogError, match="nothing to repair"):
            repaired(path, out=tmp_path / "whole.mcap")
        return
    done = repaired(path, out=tmp_path / "whole.mcap")
    if done.out is None:
        assert bytes(damaged) == bytes_of(recordings, kind) or not done.health.degraded
        path.rename(tmp_path / "whole.mcap")
    with (tmp_path / "whole.mcap").open("rb") as file:
        summary = SeekingReader(file, validate_crcs=True).get_summary()
        assert summary is not None
    sought = content(tmp_path / "whole.mcap", SeekingReader)["messages"]
    if done.written is not None:
        assert sum(map(len, sought.values())) == done.written.messages
        assert repaired(tmp_path / "whole.mcap", out=tmp_path / "again.mcap").out is None


def test_an_index_that_is_wrong_is_made_anew(tmp_path: Path, recordings: Path) -> None:
    """Zeros over the first message index of a file: its messages are all there, and no reader that seeks finds them."""
    path = tmp_path / "run.mcap"
    path.write_bytes(bytes_of(recordings, "NONE"))
    before = content(path, NonSeekingReader)
    with path.open("rb") as file:
        summary = SeekingReader(file).get_summary()
        assert summary is not None
        first = min(summary.chunk_indexes[0].message_index_offsets.values())
    damaged = bytearray(bytes_of(recordings, "NONE"))
    damaged[first + 15 : first + 31] = bytes(16)
    path.write_bytes(damaged)
    done = repaired(path)
    assert done.out is not None
    assert whole_content(done.out) == before
    assert "message index" in done.health.damage[0].why


@pytest.mark.parametrize("opcode", [Opcode.CHANNEL, Opcode.SCHEMA])
def test_a_description_that_only_the_summary_has_is_written_before_its_messages(
    tmp_path: Path, recordings: Path, opcode: Opcode
) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(bytes_of(recordings, "loose"))
    before = content(path, NonSeekingReader)
    damaged = bytearray(bytes_of(recordings, "loose"))
    first = record_at(damaged, opcode)
    assert damaged[first + 9] == 1  # its id
    damaged[first + 9] = 7
    path.write_bytes(damaged)
    with pytest.raises(McapError):
        content(path, NonSeekingReader)
    done = repaired(path)
    assert "not described before it" in " ".join(damage.why for damage in done.health.damage)
    assert done.out is not None
    assert whole_content(done.out) == before


def record_at(data: bytes | bytearray, wanted: Opcode) -> int:
    """Offset of the first record of this kind."""
    at = 8
    while data[at] != wanted:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return at


def test_a_file_without_a_summary_gets_one(tmp_path: Path) -> None:
    path = tmp_path / "plain.mcap"
    with path.open("wb") as file:
        writer = Writer(file, index_types=IndexType.NONE, use_statistics=False, repeat_channels=False)
        writer.start()
        writer.add_message(writer.register_channel("/a", "json", 0), 1, b"{}", 1)
        writer.finish()
    done = repaired(path)
    assert done.out is not None
    assert len(whole_content(done.out)["messages"]["/a"]) == 1


def test_messages_of_a_channel_whose_description_is_lost_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "lost.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1, compression=CompressionType.NONE, repeat_channels=False)
        writer.start()
        channels = [writer.register_channel(topic, "json", 0) for topic in ("/kept", "/lost")]
        for step in range(4):
            writer.add_message(channels[step % 2], step, b"{}", step)
        writer.finish()
    data = bytearray(path.read_bytes())
    data[data.index(b"/lost") - 13] = 0x77  # the opcode of its channel
    path.write_bytes(data[:-30])
    done = repaired(path)
    assert done.out is not None
    assert done.written is not None
    assert done.written.strangers == 2
    assert list(whole_content(done.out)["messages"]) == ["/kept"]


@pytest.mark.medium
def test_it_overwrites_only_what_it_is_asked_to(tmp_path: Path, recordings: Path) -> None:
    path, out = tmp_path / "run.mcap", tmp_path / "run-repaired.mcap"
    path.write_bytes(bytes_of(recordings, "LZ4")[:-25])
    out.write_bytes(b"mine")
    for wanted in (None, out, path):
        with pytest.raises(LogError, match=r"already exists; .* --out, or add --overwrite"):
            repaired(path, out=wanted, overwrite=False)
    assert (path.read_bytes(), out.read_bytes()) == (bytes_of(recordings, "LZ4")[:-25], b"mine")
    repaired(path, out=path)  # the damaged one itself
    assert whole_content(path)["messages"]
    before = path.read_bytes()
    assert repaired(path).out is None  # whole by now
    assert (path.read_bytes(), out.read_bytes()) == (before, b"mine")
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run-repaired.mcap", "run.mcap"]


def test_other_formats_have_nothing_to_repair(golden: Golden) -> None:
    with pytest.raises(LogError) as refused:
        repaired(CALM)
    golden("error", refused.value)
