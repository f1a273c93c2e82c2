"""A run recorded in several files, read as one, and killed in its midst."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Xitl, assert_one_line_error, command, environment, payloads, summary
from mcap.reader import SeekingReader

from tests.patience import wait_until
from xitl_cli.logs import open_log

_SOME_BYTES = 200_000
_RUN = ("sim", "--profile", "sitl", "--set", "clock.duration_s=14")


def finished(result: subprocess.CompletedProcess[str]) -> str:
    assert result.returncode in (0, 1), result.stderr
    return result.stdout


@pytest.mark.slow
def test_a_split_run_has_the_results_of_the_unsplit_run(xitl: Xitl, tmp_path: Path) -> None:
    finished(xitl(*_RUN, "--out", "whole"))
    by_time, by_size = "recording.split.time_s=6", "recording.split.size_mb=0.4"
    told = finished(xitl(*_RUN, "--out", "split", "--set", by_time))
    finished(xitl(*_RUN, "--out", "small", "--set", by_size))
    assert "run.mcap, 2 more files of the recording, summary.json" in told

    listed = summary(tmp_path / "split")["recording"]
    assert [(file["file"], file["from_s"]) for file in listed] == [
        ("run.mcap", 0.0), ("run-002.mcap", 6.0), ("run-003.mcap", 12.0)
    ]  # fmt: skip
    assert [file["size_bytes"] for file in listed] == [
        (tmp_path / "split" / file["file"]).stat().st_size for file in listed
    ]
    assert listed[-1]["until_s"] == 14.0
    assert "recording" not in summary(tmp_path / "whole")

    for name in ("split", "small"):
        with open_log(tmp_path / "whole") as whole, open_log(tmp_path / name) as joined:
            assert int(joined.facts["files"]) >= 3
            assert list(joined.tables) == list(whole.tables)
            for topic, table in whole.tables.items():
                assert list(joined.payloads(topic)) == list(whole.payloads(topic)), topic
                np.testing.assert_array_equal(joined[topic].stamp_ns, table.stamp_ns)
            assert list(joined.frame_tables("/link/agent/rx")) == list(whole.frame_tables("/link/agent/rx"))

    for name in ("whole", "split"):
        finished(xitl("logs", "export", name, "--format", "csv", "--out", f"{name}-csv"))
    exported = sorted((tmp_path / "whole-csv").iterdir())
    assert sorted(path.name for path in (tmp_path / "split-csv").iterdir()) == [path.name for path in exported]
    for path in exported:
        assert (tmp_path / "split-csv" / path.name).read_bytes() == path.read_bytes(), path.name

    findings: dict[str, Any] = {}
    for name in ("whole", "split"):
        analysed = json.loads(finished(xitl("logs", "analyze", name, "--json")))
        sections = [file["sections"] for file in analysed["files"]]
        findings[name] = json.loads(json.dumps([analysed["findings"], sections]).replace(f"{name}/", ""))
    assert findings["split"] == findings["whole"]

    (tmp_path / "split" / "run-002.mcap").unlink()
    shown = " ".join(finished(xitl("logs", "info", "split")).split())
    assert "run-002.mcap is missing: no data from 6.0 s to 12.0 s; copy all files of the run again" in shown
    finished(xitl("sim", "--profile", "sitl", "--set", "clock.duration_s=1", "--out", "split", "--overwrite"))
    assert not list((tmp_path / "split").glob("run-*.mcap"))


@pytest.mark.slow
def test_a_killed_run_leaves_all_earlier_files_whole(xitl: Xitl, tmp_path: Path) -> None:
    run = subprocess.Popen(
        command("sim", "--profile", "sitl", "--out", "run", "--set", "recording.split.time_s=5"),
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    third = tmp_path / "run" / "run-003.mcap"
    try:
        wait_until(lambda: third.is_file() and third.stat().st_size > _SOME_BYTES, "no third file is recorded")
        assert run.poll() is None, "it ended before it could be killed"
    finally:
        run.kill()
        run.wait()
    names = sorted(path.name for path in (tmp_path / "run").glob("run-*.mcap"))
    whole = ["run.mcap", *names[:-1]]
    stamps_ns: list[int] = []
    for name in whole:
        with (tmp_path / "run" / name).open("rb") as file:
            reader = SeekingReader(file, validate_crcs=True)
            assert reader.get_summary() is not None
            assert [attached.name for attached in reader.iter_attachments()] == ["profile.yaml", "xitl.xml"]
        stamps_ns += [stamp_ns for stamp_ns, _ in payloads(tmp_path / "run" / name)["/truth/state"]]
    assert stamps_ns == list(range(20_000_000, len(whole) * 5 * 10**9, 20_000_000))
    last = tmp_path / "run" / names[-1]
    with open_log(tmp_path / "run") as log:
        if last.stat().st_size:
            assert log.health.unclosed
            assert not log.health.gaps
        else:  # killed between its creation and its first byte
            (gap,) = log.health.gaps
            assert gap.startswith(f"{last.name} is empty: no data from ")
        stamps = log["/truth/state"].stamp_ns
        np.testing.assert_array_equal(stamps, np.arange(1, len(stamps) + 1) * 20_000_000)
        assert len(stamps) >= len(stamps_ns)


def test_limits_that_cannot_be_are_refused(xitl: Xitl) -> None:
    refused = xitl("sim", "--profile", "sitl", "--out", "run", "--set", "recording.split.time_s=0")
    assert_one_line_error(refused, "recording.split.time_s", "0", "at least 1")
    refused = xitl("sim", "--profile", "sitl", "--out", "run", "--set", "recording.split.minutes=5")
    assert_one_line_error(refused, "recording.split.minutes", "size_mb")
