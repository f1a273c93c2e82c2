"""What a recording has on the disk, and in which chunks, judged by the `mcap` package."""

from __future__ import annotations

import errno
import resource
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from xitl_cli.errors import UserError
from xitl_cli.record import mcap_file
from xitl_cli.record.mcap_file import APART_BYTES, CHUNK_BYTES, McapFile, SplitLimits
from xitl_cli.record.mcap_writer import ChunkWriter

Found = list[tuple[int, int]]
"""Channel and log time."""


def chunks_of(path: Path) -> list[Found]:
    """Of what is there now, closed or not."""
    found = []
    with path.open("rb") as stream:
        try:
            for record in StreamReader(ReadDataStream(stream), emit_chunks=True).records:
                if isinstance(record, Chunk):
                    inner = [one for one in breakup_chunk(record) if isinstance(one, Message)]
                    found.append([(one.channel_id, one.log_time) for one in inner])
        except EndOfFile:
            pass
    return found


def test_a_busy_channel_has_chunks_of_its_own_and_each_keeps_its_order(tmp_path: Path) -> None:
    now_s = [0.0]
    file = McapFile(tmp_path / "run.mcap", now_s=lambda: now_s[0])
    busy, quiet, other = (file.ros_channel(name, "t/msg/X", "uint8[] x") for name in ("/busy", "/quiet", "/other"))
    written: Found = []
    for step in range(300):
        now_s[0] = step * 0.01
        for channel, (log, size) in enumerate(((busy, APART_BYTES // 40), (quiet, 10), (other, 10)), start=1):
            log(bytes(size), step)
            written.append((channel, step))
        file.flush_if_due()
    file.close()
    chunks = chunks_of(tmp_path / "run.mcap")
    assert [sorted({channel for channel, _ in chunk}) for chunk in chunks] == [[2, 3], [1]] * 3
    for channel in (1, 2, 3):
        stamps = [stamp for chunk in chunks for one, stamp in chunk if one == channel]
        assert stamps == [stamp for one, stamp in written if one == channel]


@pytest.mark.parametrize("size", [0, 100, 40_000])
def test_no_more_than_a_chunk_is_kept_without_a_flush(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    chunk_bytes = 2 * APART_BYTES
    monkeypatch.setattr(mcap_file, "CHUNK_BYTES", chunk_bytes)
    file = McapFile(tmp_path / "run.mcap", now_s=lambda: 0.0)
    logs = [file.ros_channel(f"/{number}", "t/msg/X", "uint8[] x") for number in range(3)]
    each = size + 31  # the record around a payload
    many = 5 * chunk_bytes // each
    for step in range(many):
        logs[step % 3](bytes(size), step)
    kept = many - sum(map(len, chunks_of(tmp_path / "run.mcap")))
    assert kept * each < chunk_bytes
    file.close()
    assert sum(map(len, chunks_of(tmp_path / "run.mcap"))) == many


def test_a_disk_that_fills_up_is_told_once_and_leaves_whole_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [0.0]
    file = McapFile(tmp_path / "run.mcap", "none", now_s=lambda: now_s[0])
    log = file.ros_channel("/x", "t/msg/X", "uint8[] x")
    log(bytes(100_000), 1)
    now_s[0] = 1.0
    file.flush_if_due()

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(ChunkWriter, "write_chunk", refuse)
    for stamp in (2, 3, 4):
        log(bytes(100_000), stamp)
    now_s[0] = 2.0
    with pytest.raises(UserError, match=r"run.mcap: .*No space left on device.*free space"):
        file.flush_if_due()
    log(bytes(2 * CHUNK_BYTES), 5)
    now_s[0] = 3.0
    file.flush_if_due()
    file.close()
    assert chunks_of(tmp_path / "run.mcap") == [[(1, 1)]]


def test_a_disk_that_fills_up_within_a_second_leaves_the_chunks_that_it_took(tmp_path: Path) -> None:
    file = McapFile(tmp_path / "run.mcap", "none", now_s=lambda: 0.0)  # no flush ever falls due
    log = file.ros_channel("/x", "t/msg/X", "uint8[] x")
    room = 5 * CHUNK_BYTES // 2
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # so that a write behind the limit is refused, as of a disk
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        for stamp in range(29):
            log(bytes(CHUNK_BYTES // 10), stamp)
        with pytest.raises(UserError, match=r"run.mcap: .*File too large.*free space"):
            log(bytes(CHUNK_BYTES // 10), 29)
        file.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    assert [[stamp for _, stamp in chunk] for chunk in chunks_of(tmp_path / "run.mcap")] == [
        list(range(10)),
        list(range(10, 20)),
    ]


class Shown:
    """A mirror that keeps the payloads of a topic."""

    def __init__(self) -> None:
        self.payloads: list[bytes] = []

    def open_channel(self, topic: str, *described: object) -> Callable[[bytes, int], object] | None:
        return (lambda payload, stamp_ns: self.payloads.append(payload)) if topic == "/second" else None


@pytest.mark.parametrize("options", [{}, {"mirrors": True}, {"split": SplitLimits(message_bytes=150)}])
def test_payloads_written_together_make_the_same_file_as_one_by_one(tmp_path: Path, options: dict[str, Any]) -> None:
    shown = Shown(), Shown()
    for folder, mirror in zip(("together", "single"), shown, strict=True):
        mirrors = {"mirrors": (mirror,)} if options.get("mirrors") else {}
        (tmp_path / folder).mkdir()
        file = McapFile(tmp_path / folder / "run.mcap", **{**options, **mirrors})
        writers = [file.ros_channel(name, "t/msg/X", "uint8[] x") for name in ("/first", "/second")]
        write = file.joined_writer(writers)
        for stamp_ns in range(5):
            payloads = [bytes([stamp_ns] * size) for size in (10, 20)]
            if folder == "together":
                write(payloads, stamp_ns)
            else:
                for one, payload in zip(writers, payloads, strict=True):
                    one(payload, stamp_ns)
        file.close()
    files = [sorted((tmp_path / folder).iterdir()) for folder in ("together", "single")]
    assert [path.read_bytes() for path in files[0]] == [path.read_bytes() for path in files[1]]
    assert len(files[0]) == (4 if "split" in options else 1)  # three records have 133 or 143 bytes
    assert len(shown[0].payloads) == (5 if "mirrors" in options else 0)
    assert shown[0].payloads == shown[1].payloads
