"""Losses by the sequence, silence, and what a run injected: told as they are, and nothing where there is nothing."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_log import MadeLog, MadeTable

from tests.recorded_run import recorded_faults, recorded_run
from xitl_cli.logs import open_log
from xitl_cli.logs.clocks.alignment import align_logs
from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.plugins.logs.analyses import faults, links, scheduler, time_bases
from xitl_cli.plugins.logs.analyses.links import frames_due, missing_frames

SECOND = 1_000_000_000


def told(numbers: np.ndarray, rate_hz: float = 20.0) -> tuple[list[int], int, int]:
    """Lost before each, late and repeated of frames sent at an even rate."""
    stamps_ns = (np.maximum.accumulate(numbers) * (SECOND / rate_hz)).astype(np.int64)
    lost, late, repeated = missing_frames(numbers % 256, frames_due(stamps_ns))
    return lost.tolist(), late, repeated


def test_numbers_that_are_missing_late_or_come_twice() -> None:
    sent = np.arange(2000)
    lost, late, repeated = told(sent)
    assert (sum(lost), late, repeated) == (0, 0, 0)
    kept = np.delete(sent, [5, 6, 255, 256, 900])
    lost, late, repeated = told(kept)
    assert (sum(lost), late, repeated) == (5, 0, 0)
    assert np.flatnonzero(lost).tolist() == [5, 253, 896]
    swapped = sent.copy()
    swapped[[300, 301]] = swapped[[301, 300]]
    assert [int(np.sum(each)) for each in told(swapped)] == [0, 1, 0]
    assert [int(np.sum(each)) for each in told(np.insert(sent, 70, 69))] == [0, 0, 1]
    assert len(missing_frames(np.empty(0, dtype=np.int64), np.empty(0))[0]) == 0


@pytest.mark.parametrize("in_a_row", [1, 100, 127, 128, 129, 200, 254, 255])
@pytest.mark.parametrize("rate_hz", [0.5, 4.0, 300.0])
def test_up_to_255_missing_in_a_row_are_all_told(in_a_row: int, rate_hz: float) -> None:
    sent = np.arange(4000)
    lost, late, repeated = told(np.delete(sent, np.s_[1000 : 1000 + in_a_row]), rate_hz)
    assert (sum(lost), late, repeated) == (in_a_row, 0, 0)
    assert lost[1000] == in_a_row


@pytest.mark.medium
@given(
    st.lists(st.tuples(st.integers(0, 80), st.integers(1, 40)), max_size=30),
    st.integers(0, 255),
    st.integers(0, 2**32),
)
def test_losses_of_a_recording_add_up_whatever_is_out_of_order(
    gaps: list[tuple[int, int]], first: int, seed: int
) -> None:
    """Up to 80 missing in a row between 1 to 40 that are not, shifted by less than 20 places."""
    sent, kept = first, [first]
    for missing, present in gaps:
        sent += missing
        kept += range(sent + 1, sent + 1 + present)
        sent += present
    last = sent + 100
    kept += range(sent + 1, last)
    rng = np.random.default_rng(seed)
    middle = np.array(kept[1:-20])
    middle = middle[np.argsort(middle + rng.uniform(0.0, 20.0, len(middle)), kind="stable")]
    lost, late, repeated = told(np.array([first, *middle, *kept[-20:]]))
    assert sum(lost) == sum(missing for missing, _ in gaps)
    assert repeated == 0
    assert min(lost) >= 0
    assert (late > 0) == bool((np.diff(middle) < 0).any())


@pytest.mark.parametrize("behind", [1, 5, 50, 127])
def test_what_came_by_two_links_is_not_lost(behind: int) -> None:
    """Each frame again by the slower link."""
    sent = np.arange(behind, 3000)
    lost, late, repeated = told(np.stack([sent, sent - behind], axis=1).ravel())
    assert sum(lost) == 0
    assert late + repeated == len(sent)


@pytest.mark.parametrize("first", [0, 1, 200])
def test_a_sender_that_began_anew_costs_less_than_a_round(first: int) -> None:
    numbers = np.concatenate([np.arange(1234), np.arange(first, first + 1000)])
    stamps_ns = (np.arange(len(numbers)) * 0.02 * SECOND).astype(np.int64)
    stamps_ns[1234:] += 10 * SECOND
    lost, late, repeated = missing_frames(numbers % 256, frames_due(stamps_ns))
    assert lost.sum() < 256
    assert np.flatnonzero(lost).tolist() == [1234]
    assert (late, repeated) == (0, 0)


@pytest.mark.medium
@given(
    rate_hz=st.floats(0.2, 400.0),
    stretches=st.lists(
        st.tuples(st.integers(0, 1500), st.integers(50, 400), st.sampled_from([0.0, 0.0, 30.0])), max_size=8
    ),
    first=st.integers(0, 255),
    seed=st.integers(0, 2**32),
)
def test_a_recording_never_tells_more_than_was_lost_and_says_where_it_may_be_more(
    rate_hz: float, stretches: list[tuple[int, int, float]], first: int, seed: int
) -> None:
    """Some lost, some that arrive, each at its time more or less, and some time for which nothing is sent."""
    rng = np.random.default_rng(seed)
    numbers, times_s = [np.arange(first, first + 400)], [np.arange(400) / rate_hz]
    for lost, present, silent_s in stretches:
        begin, begin_s = numbers[-1][-1] + lost + 1, times_s[-1][-1] + lost / rate_hz + silent_s
        numbers.append(np.arange(begin, begin + present))
        times_s.append(begin_s + (np.arange(1, present + 1) + rng.uniform(-0.5, 0.5, present)) / rate_hz)
    due = frames_due((np.concatenate(times_s) * SECOND).astype(np.int64))
    lost, late, repeated = missing_frames(np.concatenate(numbers) % 256, due)
    really = sum(each for each, _, _ in stretches)
    assert (late, repeated) == (0, 0)
    assert lost.sum() <= really
    assert lost.sum() == really or due.max() >= 128


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


@pytest.mark.parametrize(("lost", "told"), [(300, "at least 44 of"), (150, "at least 150 of"), (120, " 120 of")])
def test_what_numbers_cannot_tell_is_told_as_the_least(lost: int, told: str) -> None:
    rows = np.arange(4000)
    section = links.analyse(_telemetry(rows[(rows < 1000) | (rows >= 1000 + lost)]))
    assert section is not None
    (loss,) = [finding for finding in section.findings if finding.key == "links.sequence_loss"]
    assert told in loss.sentence
    assert ("at least" in loss.sentence) == ("at least" in told)


def test_a_sender_that_was_silent_has_lost_nothing() -> None:
    rows = np.arange(4000)
    log = _telemetry(rows)
    log.tables["ATTITUDE"].stamp_ns[1000:] += 60 * SECOND
    section = links.analyse(log)
    assert section is not None
    assert [finding.key for finding in section.findings] == ["links.silence"]


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


UNKNOWN = -1


def test_repeated_frames_are_found_with_the_time_in_which_they_came() -> None:
    counts = {count: [0, 0, 0, 0] for count in ("received", "dropped", "impaired", "lost", "gaps")} | {
        "sent": [3000, 6000, 9000, 12000],
        "repeated": [0, 200, 300, 300],
    }
    table = MadeTable("/links", SECOND * np.arange(4), {"name": np.array(["sensors"] * 4), **counts})
    section = links.analyse(MadeLog(table, kind="mcap"))
    assert section is not None
    (finding,) = section.findings
    assert (finding.key, finding.severity) == ("links.repeated", Severity.WARNING)  # 300 of 12000
    assert finding.sentence.startswith("sensors: 300 frames arrived more than once, between")
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (0, 2 * SECOND)


@pytest.mark.parametrize(
    ("lost", "gaps", "said"),
    [
        ([0, 44, 300], [0, 44, 44], "sensors: 300 of 9000 frames were lost (3.33 %), between"),
        ([0, 44, UNKNOWN], [0, 44, 44], "sensors: at least 44 of 9000 frames were lost (0.49 %), between"),
        ([0, 3, 0], [0, 3, 3], "None of 9000 frames on sensors was lost"),
        ([0, 0, UNKNOWN], [0, 0, 0], None),
    ],
)
def test_the_counts_of_both_ends_come_before_what_the_receiver_misses(
    lost: list[int], gaps: list[int], said: str | None
) -> None:
    counts = {count: [0, 0, 0] for count in ("received", "repeated", "dropped", "impaired")} | {
        "sent": [3000, 6000, 9000],
        "lost": lost,
        "gaps": gaps,
    }
    table = MadeTable("/links", SECOND * np.arange(3), {"name": np.array(["sensors"] * 3), **counts})
    section = links.analyse(MadeLog(table, kind="mcap"))
    assert section is not None
    sentences = [finding.sentence for finding in section.findings]
    assert [sentence.startswith(said) for sentence in sentences] == [True] if said else not sentences


def _section(found: Section | None) -> Section:
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("frames_s", "told"),
    [
        (np.arange(0.0, 8.0, 0.02), []),
        (np.arange(0.0, 5.0, 0.02), ["agent/rx: no frame for 3.0 s from 0:05.0 to the end of the log (once)"]),
        (np.append(np.arange(0.0, 5.0, 0.02), 8.0), ["agent/rx: no frame for 3.0 s from 0:05.0 (once)"]),
    ],
)
def test_a_link_of_a_run_that_was_silent_to_the_end_is_told(frames_s: np.ndarray, told: list[str]) -> None:
    stamps_ns = np.round(frames_s * SECOND).astype(np.int64)
    link = MadeTable("/link/agent/rx", stamps_ns, {"frame": np.zeros(len(stamps_ns), int)})
    pace = MadeTable("/pace", np.arange(9) * SECOND, {"slips": np.zeros(9, int)})
    section = links.analyse(MadeLog(link, pace, kind="mcap"))
    said = [] if section is None else [one.sentence for one in section.findings if one.key == "links.silence"]
    assert said == told


@pytest.mark.realtime
def test_what_was_injected_is_what_is_found() -> None:
    run = recorded_faults()
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
    assert not [finding for finding in late.findings if "LC" in finding.sentence]  # a set clock makes no task late

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
        counted = host.tables["/links"]
        for row, link in enumerate(json.loads((run / "summary.json").read_text())["links"], start=-2):
            for count in ("sent", "received", "lost", "gaps", "repeated"):
                assert counted[count][row] == link[count]
        _, placed = align_logs([host, own])
    assert placed.method == "same clock"
    assert placed.on_reference(np.array([123])).tolist() == [123]
