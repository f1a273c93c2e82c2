"""Links: counts of both ends, sequence numbers, and an autopilot's log of its ports, on either side of each limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.plugins.logs.analyses.links import analyse, frames_due, senders

SECOND = 1_000_000_000
COUNTS = ("sent", "received", "lost", "gaps", "repeated", "impaired", "dropped")


def section_of(*tables: MadeTable, kind: Any = "mcap") -> Section:
    section = analyse(MadeLog(*tables, kind=kind))
    assert section is not None
    return section


def finding_of(section: Section, key: str) -> Finding:
    (finding,) = [one for one in section.findings if one.key == key]
    return finding


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


# Counts of both ends


def counted(names: list[str] | None = None, **counts: Any) -> MadeTable:
    """/links each second: counts that are not given are 0, and 1000 frames are sent each second."""
    rows = max(len(of) for of in counts.values())
    columns = {count: np.zeros(rows, dtype=np.int64) for count in COUNTS} | {"sent": 1000 * np.arange(1, rows + 1)}
    columns |= {count: np.array(of) for count, of in counts.items()}
    return MadeTable("/links", SECOND * np.arange(rows), {"name": np.array(names or ["sensors"] * rows), **columns})


@pytest.mark.parametrize(
    ("lost", "impaired", "severity", "sentence"),
    [
        (30, 0, Severity.NOTICE, "sensors: 30 of 3000 frames were lost (1.00 %), between 0:01.0 and 0:02.0"),
        (31, 0, Severity.WARNING, "sensors: 31 of 3000 frames were lost (1.03 %), between 0:01.0 and 0:02.0"),
        (600, 0, Severity.WARNING, "sensors: 600 of 3000 frames were lost (20.00 %), between 0:01.0 and 0:02.0"),
        (601, 0, Severity.CRITICAL, "sensors: 601 of 3000 frames were lost (20.03 %), between 0:01.0 and 0:02.0"),
        (
            631, 600, Severity.WARNING,
            "sensors: 631 of 3000 frames were lost (21.03 %), 600 on purpose, between 0:01.0 and 0:02.0",
        ),
        (
            90, 90, Severity.NOTICE,
            "sensors: 90 of 3000 frames were lost (3.00 %), all on purpose, between 0:01.0 and 0:02.0",
        ),
        (
            90, 95, Severity.NOTICE,
            "sensors: 90 of 3000 frames were lost (3.00 %), all on purpose, between 0:01.0 and 0:02.0",
        ),
    ],
)  # fmt: skip
def test_lost_frames_by_their_share(lost: int, impaired: int, severity: Severity, sentence: str) -> None:
    section = section_of(counted(lost=[0, 0, lost], impaired=[0, 0, impaired]))
    finding = finding_of(section, "links.loss")
    assert (finding.sentence, finding.severity) == (sentence, severity)
    assert finding.evidence == (Evidence("/links", "lost", SECOND, 2 * SECOND, str(lost)),)
    assert ("faults section" in finding.next_step) == (impaired >= lost)
    assert facts(section) == {"sensors_frames": 3000, "sensors_lost_percent": pytest.approx(lost / 30.0, abs=5e-4)}


def test_losses_in_two_spells_are_two_pieces_of_evidence() -> None:
    section = section_of(counted(lost=[0, 5, 5, 5, 5, 5, 5, 9, 9]))
    finding = finding_of(section, "links.loss")
    assert [(one.at_ns, one.until_ns) for one in finding.evidence] == [(0, SECOND), (6 * SECOND, 7 * SECOND)]
    assert finding.sentence == "sensors: 9 of 9000 frames were lost (0.10 %), between 0:00.0 and 0:07.0"


@pytest.mark.parametrize(
    ("count", "sentence"),
    [
        ("dropped", "sensors: 30 frames were damaged, unknown or from another sender, between 0:00.0 and 0:01.0"),
        ("unsent", "sensors: 30 frames were refused by the transport, between 0:00.0 and 0:01.0"),
        ("refused", "sensors: 30 frames had a wrong signature, or none, between 0:00.0 and 0:01.0"),
        ("late", "sensors: 30 frames arrived after later ones, between 0:00.0 and 0:01.0"),
    ],
)
def test_frames_with_another_fate(count: str, sentence: str) -> None:
    finding = finding_of(section_of(counted(**{count: [0, 30, 30]})), f"links.{count}")
    assert (finding.sentence, finding.severity) == (sentence, Severity.NOTICE)
    assert finding.evidence == (Evidence("/links", count, 0, SECOND, "30"),)
    worse = finding_of(section_of(counted(**{count: [0, 31, 31]})), f"links.{count}")
    assert worse.severity is Severity.WARNING


def test_what_the_ends_counted_is_in_the_table_with_the_last_known_of_each() -> None:
    table = counted(
        names=["sensors", "agent rx", "sensors", "agent rx"],
        sent=[100, -1, 200, -1], received=[90, 40, 190, 90], lost=[0, 0, 10, -1], gaps=[0, 1, 9, 2],
        repeated=[0, 0, 0, 2], latency_p50_s=[0.001, np.nan, 0.002, np.nan],
        latency_p99_s=[0.1, np.nan, 0.1, np.nan], latency_max_s=[0.3, 0.2, np.nan, np.nan],
    )  # fmt: skip
    section = section_of(table)
    (grid,) = section.grids
    assert grid.columns == ("link", *COUNTS, "half take (ms)", "99 % take (ms)", "longest (ms)")
    assert grid.rows == (
        ("sensors", 200, 190, 10, 9, 0, 0, 0, 2.0, 100.0, 300.0),
        ("agent rx", None, 90, None, 2, 2, 0, 0, None, None, 200.0),
    )
    # Received without the repeated ones, and those that the receiver misses.
    assert facts(section) == {
        "sensors_frames": 200, "sensors_lost_percent": 5.0, "sensors_latency_p99_ms": 100.0,
        "agent_rx_frames": 90, "agent_rx_lost_percent": 2.222,
    }  # fmt: skip
    assert [one.key for one in section.findings] == ["links.loss", "links.loss", "links.repeated"]
    assert section.findings[1].sentence.startswith("agent rx: at least 2 of 90 frames were lost (2.22 %), between")


def test_a_slow_link_is_a_finding() -> None:
    finding = finding_of(section_of(counted(latency_p99_s=[0.05, 0.1004])), "links.latency")
    assert finding.sentence == "sensors: one message in a hundred took 100 ms or more"
    assert finding.severity is Severity.WARNING
    assert finding.evidence == (Evidence("/links", "latency_p99_s", value="100.4 ms"),)
    assert [one.key for one in section_of(counted(latency_p99_s=[0.2, 0.1])).findings] == ["links.whole"]


def test_links_without_loss_are_one_sentence() -> None:
    names = ["sensors", "outputs", "outputs"]
    (finding,) = section_of(counted(names=names, sent=[400, 100, 200])).findings
    assert finding.sentence == "None of 400 frames on sensors and 200 frames on outputs was lost"
    assert finding.severity is Severity.OK


def test_losses_and_latencies_are_drawn() -> None:
    latency_s = [np.nan, 0.002, 0.003, 0.002]
    losses, latencies = section_of(
        counted(lost=[1, 3, -1, 5], gaps=[0, 4, 4, 4], latency_p99_s=latency_s)
    ).plots  # fmt: skip
    (lost,) = losses.traces
    assert (lost.name, lost.style, losses.y_label) == ("sensors", "steps", "frames")
    assert lost.y.tolist() == [1.0, 3.0, 0.0, 1.0]
    (latency,) = latencies.traces
    assert (latency.name, latencies.y_label) == ("sensors, 99 %", "ms")
    assert latency.x.tolist() == [SECOND, 2 * SECOND, 3 * SECOND]
    assert latency.y == pytest.approx([2.0, 3.0, 2.0])
    assert len(section_of(counted(lost=[0, 0])).plots) == 1


# Sequence numbers


def frames(rows: Any, component: int = 1, system: int = 1, name: str = "ATTITUDE", rate_hz: int = 20) -> MadeTable:
    rows = np.asarray(rows)
    who = {"_sysid": np.full(len(rows), system), "_compid": np.full(len(rows), component), "_seq": rows % 256}
    return MadeTable(name, 1_790_000_000 * SECOND + rows * SECOND // rate_hz, who)


def without(rows: int, *lost: int) -> np.ndarray:
    return np.delete(np.arange(rows), list(lost))


def test_each_sender_is_counted_by_its_numbers() -> None:
    log = MadeLog(frames(without(300, 7, 8)), frames(np.arange(400), 190, 255, "HEARTBEAT"), kind="tlog", base="utc")
    station, autopilot = senders(log)
    assert (station.system, station.component, len(station.stamp_ns), int(station.lost.sum())) == (255, 190, 400, 0)
    assert autopilot.name == "system 1, component 1"
    assert np.flatnonzero(autopilot.lost).tolist() == [7]
    assert autopilot.ratio == 2.0 / 300.0
    section = analyse(log)
    assert section is not None
    (grid,) = section.grids
    assert [dict(zip(grid.columns, row, strict=True)) for row in grid.rows] == [
        {
            "system": 255, "component": 190, "frames": 400, "lost": 0, "lost (%)": 0.0, "out of order": 0,
            "repeated": 0, "longest pause (s)": 0.05,
        },
        {
            "system": 1, "component": 1, "frames": 298, "lost": 2, "lost (%)": 0.667, "out of order": 0,
            "repeated": 0, "longest pause (s)": 0.15,
        },
    ]  # fmt: skip
    assert facts(section) == {"senders": 2, "system_1_lost_percent": 0.667}


@pytest.mark.parametrize(
    ("component", "lost", "severity"),
    [
        (1, 20, Severity.NOTICE),  # 2 %
        (1, 21, Severity.WARNING),
        (1, 200, Severity.WARNING),
        (1, 201, Severity.CRITICAL),
        (190, 201, Severity.NOTICE),  # a station records some of its own frames
    ],
)
def test_missing_numbers_by_their_share(component: int, lost: int, severity: Severity) -> None:
    missing = 3 + 4 * np.arange(lost)
    section = section_of(frames(without(1000, *missing.tolist()), component), kind="tlog")
    finding = finding_of(section, "links.sequence_loss")
    last_s = (missing[-1] + 1) / 20.0
    assert finding.sentence == (
        f"system 1, component {component}: {lost} of 1000 frames are missing by their sequence ({lost / 10.0:.2f} %), "
        f"from 0:00.2 to 0:{last_s:04.1f}"
    )
    assert finding.severity is severity
    assert finding.evidence[0].field == "_seq"


def test_frames_of_an_unknown_dialect_are_not_lost() -> None:
    log = MadeLog(frames(without(1000, *range(100, 130))), kind="tlog")
    log.health = LogHealth(0, 970, undecoded={"message 9": (8, "no known dialect has it"), "message 8": (2, "so")})
    section = analyse(log)
    assert section is not None
    finding = finding_of(section, "links.sequence_loss")
    assert finding.sentence.endswith("; up to 10 of them are messages of no known dialect")
    assert finding.severity is Severity.NOTICE  # 20 of 1000
    log.health = LogHealth(0, 970, undecoded={"message 9": (40, "no known dialect has it")})
    section = analyse(log)
    assert section is not None
    assert "; up to 30 of them" in finding_of(section, "links.sequence_loss").sentence


@pytest.mark.parametrize(("rows", "keys"), [(50, ["links.sequence_whole"]), (49, [])])
def test_few_frames_are_not_judged(rows: int, keys: list[str]) -> None:
    assert [one.key for one in section_of(frames(np.arange(rows)), kind="tlog").findings] == keys
    if keys:
        lossy = section_of(frames(without(rows + 1, 20)), kind="tlog")
        assert [one.key for one in lossy.findings] == ["links.sequence_loss"]


def test_autopilots_without_loss_are_one_sentence() -> None:
    section = section_of(frames(np.arange(90)), frames(np.arange(80), system=2, name="SYS"), kind="tlog")
    assert [one.sentence for one in section.findings] == [
        "No frame of system 1, component 1 and system 2, component 1 is missing by its sequence"
    ]


def test_frames_due_is_the_time_in_usual_periods() -> None:
    stamps = np.concatenate((np.arange(200), 199 + 70 + np.arange(200))) * SECOND // 4
    assert frames_due(stamps) == pytest.approx(np.concatenate(([0.0], np.ones(199), [70.0], np.ones(199))))
    assert frames_due(np.array([5])).tolist() == [0.0]
    assert frames_due(np.array([0, SECOND, 3 * SECOND])).tolist() == pytest.approx([0.0, 2.0 / 3.0, 4.0 / 3.0])


def test_missing_frames_are_drawn_by_the_second() -> None:
    (plot,) = section_of(frames(without(200, 45, 46, 50, 140)), kind="tlog").plots
    (trace,) = plot.traces
    assert (trace.name, trace.style, plot.y_label) == ("system 1, component 1", "steps", "frames")
    assert trace.x.tolist() == [(1_790_000_000 + second) * SECOND for second in range(10)]
    assert trace.y.tolist() == [0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]


# Silence


@pytest.mark.parametrize(("pause_s", "silent"), [(3.0, False), (3.1, True)])
def test_a_pause_of_three_seconds_is_a_silence(pause_s: float, silent: bool) -> None:
    table = frames(np.arange(200))
    table.stamp_ns[100:] += round((pause_s - 0.05) * SECOND)
    section = section_of(table, kind="tlog")
    found = [one for one in section.findings if one.key == "links.silence"]
    assert len(found) == silent
    if silent:
        begin = 1_790_000_000 * SECOND + 99 * SECOND // 20
        assert found[0].sentence == "system 1, component 1: no frame for 3.1 s from 0:05.0 (once)"
        assert found[0].evidence == (Evidence("MAVLink", None, begin, begin + 3_100_000_000),)
        assert found[0].severity is Severity.WARNING
        assert [(mark.at_ns, mark.until_ns, mark.text) for mark in section.plots[0].marks] == [
            (begin, begin + 3_100_000_000, "system 1, component 1: nothing")
        ]
        assert section.grids[-1].rows == (("system 1, component 1", 4.95, 8.05, 3.1),)


@pytest.mark.parametrize(("pause_s", "silent"), [(20.0, False), (20.1, True)])
def test_a_slow_sender_is_silent_after_twenty_periods(pause_s: float, silent: bool) -> None:
    table = frames(np.arange(60), rate_hz=1)
    table.stamp_ns[30:] += round((pause_s - 1.0) * SECOND)
    assert any(one.key == "links.silence" for one in section_of(table, kind="tlog").findings) is silent


def link_at(*spans_s: tuple[float, float]) -> MadeTable:
    """Frames at 50 Hz in each span."""
    stamps = np.concatenate([np.arange(round(a * 50), round(b * 50)) for a, b in spans_s]) * SECOND // 50
    return MadeTable("/link/agent/rx", stamps, {"frame": np.zeros(len(stamps), int)})


def test_silences_around_single_frames_are_one_and_the_longest_is_named() -> None:
    section = section_of(link_at((0.0, 2.0), (3.0, 3.02), (4.0, 5.0), (5.6, 8.0)))
    finding = finding_of(section, "links.silence")
    assert finding.sentence == "agent/rx: no frame for 2.0 s from 0:02.0 (2 times, 2.6 s in all)"
    assert [(one.at_ns, one.until_ns) for one in finding.evidence] == [
        (1_980_000_000, 4_000_000_000), (4_980_000_000, 5_600_000_000),
    ]  # fmt: skip


@pytest.mark.parametrize(("silent_s", "silent"), [(0.4, False), (0.42, True)])
def test_in_a_run_a_shorter_pause_is_a_silence(silent_s: float, silent: bool) -> None:
    log = MadeLog(link_at((0.0, 2.0), (1.98 + silent_s, 4.0)), kind="mcap")
    assert (analyse(log) is not None) is silent


def test_a_silence_that_was_injected_is_a_notice() -> None:
    def silence(fault_from_s: float, fault_until_s: float) -> Finding:
        stamps = np.array([fault_from_s, fault_until_s]) * SECOND
        fault = MadeTable("/faults", stamps, {"fault": np.array(["cut", "cut"]), "active": [1, 0]})
        return finding_of(section_of(link_at((0.0, 4.0), (6.0, 12.0)), fault), "links.silence")

    finding = silence(4.1, 6.9)
    assert finding.sentence == (
        "agent/rx: no frame for 2.0 s from 0:04.0 (once), with: fault cut begins; fault cut ends"
    )
    assert finding.severity is Severity.NOTICE
    assert finding.next_step.startswith("It was injected")
    later = silence(7.1, 8.0)  # more than a second after it
    assert later.severity is Severity.WARNING
    assert "with:" not in later.sentence


# What an autopilot logs


def packets(received: int, dropped: int, slowed: Any = None) -> MadeTable:
    """One channel, whose counts begin at 65530 and go round."""
    columns = {"chan": np.zeros(3, int), "txp": np.array([65_530, 65_535, 4])}
    columns["rxp"] = (65_530 + np.array([0, received // 2, received])) % 65_536
    columns["rxdp"] = np.array([7, 7, 7 + dropped])
    if slowed is not None:
        columns["ss"] = np.array(slowed)
    return MadeTable("MAV", SECOND * np.arange(3), columns, instance="chan")


@pytest.mark.parametrize(
    ("received", "dropped", "severity", "sentence"),
    [
        (950, 50, Severity.NOTICE, "missed 50 of 1000 packets sent to it on channel 0 (5.0 %), from 0:02.0 to 0:02.0"),
        (949, 51, Severity.WARNING, "missed 51 of 1000 packets sent to it on channel 0 (5.1 %), from 0:02.0 to 0:02.0"),
        (49, 1, Severity.NOTICE, "missed 1 of 50 packets sent to it on channel 0 (2.0 %), from 0:02.0 to 0:02.0"),
    ],
)
def test_packets_that_the_autopilot_missed(received: int, dropped: int, severity: Severity, sentence: str) -> None:
    section = section_of(packets(received, dropped), kind="dataflash")
    (finding,) = section.findings
    assert (finding.key, finding.sentence, finding.severity) == (
        "links.dropped", f"The autopilot {sentence}", severity,
    )  # fmt: skip
    assert finding.evidence == (Evidence("MAV", "rxdp", 2 * SECOND, 2 * SECOND, str(dropped)),)
    assert section.grids[0].rows == ((0, 10, received, dropped, None),)


def test_channels_without_loss_are_one_sentence_if_enough_was_heard() -> None:
    whole = section_of(packets(50, 0, [0, 120, 40]), kind="dataflash")
    assert [one.sentence for one in whole.findings] == ["None of 50 MAVLink packets sent to the autopilot was missed"]
    assert whole.grids[0].rows == ((0, 10, 50, 0, 120),)
    assert facts(whole) == {"channels": 1}
    assert section_of(packets(49, 0), kind="dataflash").findings == ()
    assert section_of(packets(48, 1), kind="dataflash").findings == ()


def radio(margin: Any, remote: Any, **more: Any) -> MadeTable:
    noise, remote_noise = np.array([40, 41, 42]), np.array([50, 50, 50])
    columns = {"RSSI": noise + margin, "Noise": noise, "RemRSSI": remote_noise + remote, "RemNoise": remote_noise}
    return MadeTable("RAD", SECOND * np.arange(3), columns | more)


def test_a_radio_near_its_noise() -> None:
    errors = {"RxErrors": [1, 3, 6], "Fixed": [2, 2, 4]}
    section = section_of(radio([50, 9, 9.5], [10, 30, 11], **errors), kind="dataflash")
    (finding,) = section.findings
    assert finding.sentence == (
        "The radio's signal at the vehicle was within 10 steps of the noise in 2 of 3 reports, first at 0:01.0"
    )
    assert finding.evidence == (Evidence("RAD", "RSSI", SECOND, 2 * SECOND, "9"),)
    assert facts(section) == {
        "rssi_margin": 9.0, "remrssi_margin": 10.0, "radio_rxerrors": 5, "radio_fixed": 2,
    }  # fmt: skip
    (plot,) = section.plots
    assert {trace.name: trace.y.tolist() for trace in plot.traces} == {
        "RSSI": [90.0, 50.0, 51.5], "Noise": [40.0, 41.0, 42.0],
        "RemRSSI": [60.0, 80.0, 61.0], "RemNoise": [50.0, 50.0, 50.0],
    }  # fmt: skip
    far = section_of(radio([50, 50, 50], [10, 30, 9]), kind="dataflash")
    assert [one.sentence for one in far.findings] == [
        "The radio's signal at the ground was within 10 steps of the noise in 1 of 3 reports, first at 0:02.0"
    ]


def test_serial_ports_have_their_rates_and_lost_bytes() -> None:
    columns = {"I": [0, 1, 0, 1], "Tx": [100, 10, 300, 20], "Rx": [1000, 0, np.nan, 0], "RxDp": [0, 0, 40, 0]}
    table = MadeTable("UART", SECOND * np.array([1, 1, 2, 2]), columns, instance="I")
    section = section_of(table, kind="dataflash")
    assert section.grids[0].rows == ((0, 200.0, 300.0, 500.0, 1000.0), (1, 15.0, 20.0, 0.0, 0.0))
    (finding,) = section.findings
    assert finding.sentence == "Serial port 0 lost bytes it had received, up to 40 a second, first at 0:02.0"
    assert finding.evidence == (Evidence("UART", "RxDp", 2 * SECOND, 2 * SECOND, "40 B/s"),)


def trips(*trip_ms: float) -> Section:
    return section_of(
        MadeTable("TSYN", SECOND * np.arange(len(trip_ms)), {"RTT": np.array(trip_ms) * 1e3}), kind="dataflash"
    )


def test_round_trips_have_their_median_and_99_per_cent() -> None:
    section = trips(-5.0, 10.0, 20.0, 30.0, 1e6, 1.8e13)
    assert facts(section) == {
        "round_trip_p50_ms": 20.0, "round_trip_p99_ms": 29.8, "round_trips_impossible": 3,
    }  # fmt: skip
    assert section.findings == ()
    (trace,) = section.plots[0].traces
    assert (trace.x.tolist(), trace.y.tolist()) == ([SECOND, 2 * SECOND, 3 * SECOND], [10.0, 20.0, 30.0])


def test_slow_round_trips_are_a_finding() -> None:
    (finding,) = trips(500.0, 500.0, 700.0, 2e6).findings
    assert finding.sentence == (
        "One round trip in a hundred took 696 ms or more, the longest 700 ms at 0:02.0"
    )  # 500 + 0.98 x 200
    assert finding.evidence == (Evidence("TSYN", "RTT", 2 * SECOND, value="700 ms"),)
    assert trips(500.0, 500.0).findings == ()


def test_a_log_without_links_says_what_it_lacks() -> None:
    nothing = MadeTable("ATT", [0, SECOND], {"Yaw": [0.0, 0.0]})
    section = section_of(nothing, kind="dataflash")
    assert section.lacks == ("The log has no MAV, RAD, UART or TSYN, so links cannot be judged.",)
    assert analyse(MadeLog(nothing, kind="mcap")) is None
