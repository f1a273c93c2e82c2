"""Recordings of earlier versions, compared with the package `mcap-ros2-support`; and recordings of a later one."""

from __future__ import annotations

import lzma
import math
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

from tests.recorded_run import recorded_run
from xitl_cli.logs import LogError, open_log
from xitl_cli.logs.model.recording_schema import SCHEMA_VERSION, schema_version

PACKED = sorted((Path(__file__).parents[2] / "data/recordings").glob("*.mcap.xz"))

OTHER_DEFINITION = {"first-run-0": 9, "release-0.1.0": 0}
"""Frames of messages that have another definition today."""


@pytest.fixture(params=PACKED, ids=lambda path: path.name.split(".mcap")[0])
def earlier(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A recording of an earlier version, unpacked."""
    path = tmp_path / request.param.name.removesuffix(".xz")
    path.write_bytes(lzma.decompress(request.param.read_bytes()))
    return path


def test_each_earlier_version_is_kept() -> None:
    assert len(PACKED) == 2
    assert all(path.stat().st_size < 100_000 for path in PACKED)


def test_an_earlier_recording_reads_as_another_reader_reads_it(earlier: Path) -> None:
    reader = make_reader(BytesIO(earlier.read_bytes()), decoder_factories=[DecoderFactory()])
    wanted: dict[str, list[tuple[int, object]]] = {}
    for _, channel, message, decoded in reader.iter_decoded_messages(topics=["/truth/state", "/actuators"]):
        wanted.setdefault(channel.topic, []).append((message.log_time, decoded))
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    with open_log(earlier) as log:
        assert (log.base, schema_version(log.facts)) == ("simulation", 0)
        assert log.facts["version"] == "0.1.0"
        assert not log.health.degraded
        channels = {channel.id: channel.topic for channel in summary.channels.values()}
        counts = {
            channels[number]: count for number, count in summary.statistics.channel_message_counts.items() if count
        }
        assert {name: len(log[name].stamp_ns) for name in log.tables} == counts
        for topic, field in (("/truth/state", "position_ned_m"), ("/actuators", "age_s")):
            rows = wanted[topic]
            assert log[topic].stamp_ns.tolist() == [stamp_ns for stamp_ns, _ in rows]
            np.testing.assert_array_equal(log[topic][field], [getattr(row, field) for _, row in rows])


def test_each_frame_of_an_earlier_recording_is_decoded_or_counted(earlier: Path) -> None:
    with open_log(earlier) as log:
        frames = log.frame_tables("/link/agent/rx")
        decoded = sum(len(table.stamp_ns) for table in frames.values())
        left, _ = log.health.undecoded.get("/link/agent/rx", (0, ""))
        assert decoded + left == len(log["/link/agent/rx"].stamp_ns)
        assert left == OTHER_DEFINITION[earlier.stem]


def made(path: Path, **facts: str) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("xitl", "xitl")
        writer.add_metadata("xitl", facts)
        writer.finish()
    return path


def test_a_recording_of_a_later_version_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = made(tmp_path / "run.mcap", version="9.1", schema_version=str(SCHEMA_VERSION + 1))
    with pytest.raises(LogError) as refused:
        open_log(path)
    assert str(refused.value) == (
        f"{path}: xitl 9.1 wrote it with schema version {SCHEMA_VERSION + 1}, and this xitl reads up to "
        f"{SCHEMA_VERSION}; upgrade xitl to read it"
    )


@pytest.mark.parametrize("text", ["", "-1", "one", "9" * 40, "²", "1.0"])
def test_a_damaged_version_does_not_stop_the_reader(tmp_path: Path, text: str) -> None:
    with open_log(made(tmp_path / "run.mcap", schema_version=text)) as log:
        assert log.base == "simulation"


def test_a_run_writes_the_present_version() -> None:
    with open_log(recorded_run() / "run.mcap") as log:
        assert schema_version(log.facts) == SCHEMA_VERSION > 0
        assert math.isfinite(log["/truth/state"]["position_ned_m"][-1][0])
