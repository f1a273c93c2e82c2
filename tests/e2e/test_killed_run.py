"""A run that is killed in its midst leaves a recording that can be read, and written whole."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from conftest import Xitl, command, environment, payloads
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, SeekingReader

from tests.patience import wait_until
from xitl_cli.logs import open_log

_SOME_BYTES = 200_000


@pytest.mark.slow
def test_the_recording_of_a_killed_run_is_repaired(xitl: Xitl, tmp_path: Path) -> None:
    run = subprocess.Popen(
        command("sim", "--profile", "sitl", "--out", "run", "--set", "clock.duration_s=600"),
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    recording = tmp_path / "run" / "run.mcap"
    try:
        wait_until(lambda: recording.is_file() and recording.stat().st_size > _SOME_BYTES, "nothing is recorded")
        assert run.poll() is None, "it ended before it could be killed"
    finally:
        run.kill()
        run.wait()
    with recording.open("rb") as file, pytest.raises(McapError):
        SeekingReader(file).get_summary()

    told = xitl("logs", "repair", "run/run.mcap")
    assert told.returncode == 0, told.stderr
    assert told.stdout.startswith("run/run-repaired.mcap: ")

    whole = recording.with_name("run-repaired.mcap")
    streamed: dict[str, list[tuple[int, bytes]]] = {}
    with whole.open("rb") as file:
        for _, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages(log_time_order=False):
            streamed.setdefault(channel.topic, []).append((message.log_time, message.data))
    sought = payloads(whole)
    assert {topic: sorted(each) for topic, each in sought.items()} == {
        topic: sorted(each) for topic, each in streamed.items()
    }
    with whole.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        assert [attached.name for attached in reader.iter_attachments()] == ["profile.yaml", "xitl.xml"]
        assert {metadata.name for metadata in reader.iter_metadata()} == {"xitl"}
    with open_log(recording) as left, open_log(whole) as log:
        assert not log.health.degraded
        assert {name: len(table) for name, table in log.tables.items()} == {
            name: len(table) for name, table in left.tables.items()
        }
        assert log.span_ns == left.span_ns
