"""Losses by the sequence, silence, and what a run injected: told as they are, and nothing where there is nothing."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from tests.recorded_run import recorded_run
from xitl_cli.logs import open_log
from xitl_cli.logs.analyses import faults, links, scheduler, time_bases
from xitl_cli.logs.analyses.link_sequences import missing_frames
from xitl_cli.logs.clocks.alignment import align_logs
from xitl_cli.logs.model.sections import Section, Severity

SECOND = 1_000_000_000
FAULTS = """\
extends: hitl-loopback
clock: {duration_s: 6.0}
faults:
  cut: {from_s: 1.0, until_s: 2.0, link: {cut: true}}
  jump: {from_s: 4.0, agent: {clock_offset_s: 0.5}}
"""


def test_numbers_that_are_missing_late_or_come_twice() -> None:
    sent = np.arange(2000)
    lost, late, repeated = missing_frames(sent % 256)
    assert (int(lost.sum()), late, repeated) == (0, 0, 0)
    kept = np.delete(sent, [5, 6, 255, 256, 900])
    lost, late, repeated = missing_frames(kept % 256)
    assert (int(lost.sum()), late, repeated) == (5, 0, 0)
    assert np.flatnonzero(lost).tolist() == [5, 253, 896]
    swapped = sent.copy()
    swapped[[300, 301]] = swapped[[301, 300]]
    assert [int(np.sum(each)) for each in missing_frames(swapped % 256)] == [0, 1, 0]
    assert [int(np.sum(each)) for each in missing_frames(np.insert(sent, 70, 69) % 256)] == [0, 0, 1]
    assert len(missing_frames(np.empty(0, dtype=np.int64))[0]) == 0


def _telemetry(rows: np.ndarray) -> MadeLog:
    table = MadeTable(
        "ATTITUDE",
        1_790_000_000 * SECOND + rows * SECOND // 20,
        {"_sysid": np.ones(len(rows), int), "_compid": np.ones(len(rows), int), "_seq": rows % 256},
    )
    return MadeLog(table, kind="tlog", base="utc")


def test_a_radio_out_of_reach_is_told_with_when() -> None:
    rows = np.arange(4000)
    section = links.analyse(_telemetry(rows))
    assert section is not None
    assert section.worst == Severity.OK
    out = rows[(rows < 1000) | (rows >= 1100)]
    section = links.analyse(_telemetry(out))
    assert section is not None
    by_key = {finding.key: finding for finding in section.findings}
    assert "100 of 4000" in by_key["links.sequence_loss"].sentence
    silence = by_key["links.silence"]
    assert silence.severity == Severity.WARNING
    assert (silence.evidence[0].at_ns or 0) - 1_790_000_000 * SECOND == 999 * SECOND // 20


def test_counts_of_16_bits_go_round() -> None:
    sent = (65_000 + 100 * np.arange(20)) % 65_536
    missed = np.arange(20) * 10
    table = MadeTable(
        "MAV",
        np.arange(20) * SECOND,
        {"chan": np.zeros(20, int), "txp": sent, "rxp": sent, "rxdp": missed},
        instance="chan",
    )
    section = links.analyse(MadeLog(table))
    assert section is not None
    assert section.grids[0].rows[0][:4] == (0, 1900, 1900, 190)
    assert section.findings[0].severity == Severity.WARNING  # 190 of 2090


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    profile = tmp_path_factory.mktemp("faulty") / "faulty.yaml"
    profile.write_text(FAULTS)
    return recorded_run(str(profile), 6.0)


def _section(found: Section | None) -> Section:
    assert found is not None
    return found


@pytest.mark.realtime
def test_what_was_injected_is_what_is_found(run: Path) -> None:
    known = json.loads((run / "summary.json").read_text())
    with open_log(run / "run.mcap") as host, open_log(run / "autopilot.bin") as own:
        injected = _section(faults.analyse(host))
        counted = _section(links.analyse(host))
        bases = _section(time_bases.analyse(host))
        late = _section(scheduler.analyse(host))
        _, placed = align_logs([host, own])
        own_bases = _section(time_bases.analyse(own))
    assert [row[0] for row in injected.grids[0].rows] == ["cut", "jump"]
    assert injected.worst == Severity.NOTICE
    did = known["faults"][0]["did"]
    assert injected.grids[0].rows[0][5] == did["frames_lost_to_agent"] + did["frames_lost_from_agent"]

    losses = [finding for finding in counted.findings if finding.key == "links.loss"]
    assert all("on purpose" in finding.sentence for finding in losses)
    for link, row in zip(known["links"], counted.grids[0].rows, strict=True):
        assert row[counted.grids[0].columns.index("lost")] == link["lost"]
    (silence,) = [finding for finding in counted.findings if finding.key == "links.silence"]
    assert silence.severity == Severity.NOTICE
    assert silence.evidence[0].at_ns == pytest.approx(1e9, abs=0.2e9)

    for section, about_s in ((bases, 4.0), (own_bases, None)):
        (step,) = [finding for finding in section.findings if finding.key == "time_bases.step"]
        (ahead_s,) = re.findall(r"stepped ([\d.]+) s ahead", step.sentence)
        assert float(ahead_s) == pytest.approx(0.5, abs=0.01)  # what delays a message on a busy machine is in it
        assert about_s is None or step.evidence[0].at_ns == pytest.approx(about_s * 1e9, abs=0.25e9)  # 10 Hz
    (by_step,) = [one for one in late.findings if "LC" in one.sentence]
    assert "clock leapt ahead" in by_step.sentence

    assert placed.method == "clock records"
    assert placed.error_s is not None
    assert placed.error_s < 5e-3
    slopes = {clock["node"]: clock["slope_s"] for clock in known["clocks"]}
    facts = {row[0]: row[3] for grid in bases.grids if grid.key == "sample_clocks" for row in grid.rows}
    if "PS1, step" in facts:  # chord here, least squares there: 6 s of steps that start some 0.1 ms late
        assert facts["PS1, step"] == pytest.approx(1e3 * slopes["PS1"], rel=1e-3)


@pytest.mark.slow
def test_a_run_in_lockstep_has_nothing_to_find() -> None:
    run = recorded_run()
    with open_log(run / "run.mcap") as host, open_log(run / "autopilot.bin") as own:
        for log in (host, own):
            for analysis in (links, time_bases, scheduler):
                section = analysis.analyse(log)
                assert section is None or section.worst <= Severity.NOTICE
        assert faults.analyse(host) is None
        _, placed = align_logs([host, own])
    assert placed.method == "same clock"
    assert placed.on_reference(np.array([123])).tolist() == [123]
