"""Readings of two clocks and UTC from made logs of each kind, and stamps on a common time line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.clocks.readings import (
    ClockReadings,
    UtcOffset,
    clock_readings,
    in_utc,
    utc_offset,
    whole_numbers,
)
from xitl_cli.logs.clocks.time_line import AlignedLog, LogClock, LogPlacement, Stretch, TimeLine, placement_from

SECOND = 1_000_000_000
MS = 1_000_000
UTC_S = 1_790_000_000


def readings(first: Any, second: Any, **of: Any) -> ClockReadings:
    first_ns, second_ns = np.asarray(first, dtype=np.int64), np.asarray(second, dtype=np.int64)
    return ClockReadings("k", "a", "b", first_ns + 7, first_ns, second_ns, "M", "F", **of)


def found(log: MadeLog) -> dict[str, ClockReadings]:
    return {one.key: one for one in clock_readings(log)}


# Readings themselves


def test_offset_and_level() -> None:
    assert readings([1, 2], [11, 22]).offset_ns.tolist() == [10, 20]
    assert readings([1, 2], [11, 22]).level_ns.tolist() == [10, 20]
    exchange = readings([1, 2], [11, 22], floor_ns=np.array([4, 13]))
    assert exchange.level_ns.tolist() == [7, 16]  # half way, rounded down
    part = exchange[1:]
    assert part.floor_ns is not None
    assert (part.first_ns.tolist(), part.second_ns.tolist(), part.at_ns.tolist()) == ([2], [22], [9])
    assert part.floor_ns.tolist() == [13]


def test_impossible_values_are_left_out() -> None:
    made = readings([-10, -9, 0, 9, 10, 0, 0], [0, 0, 0, 0, 0, 10, -10])
    assert made.within(10).first_ns.tolist() == [-9, 0, 9]
    assert readings([0, 1], [0, 1], floor_ns=np.array([10, 9])).within(10).first_ns.tolist() == [1]
    sound = readings([0, 1], [2, 3])
    assert sound.within(10) is sound


def test_a_clock_that_repeats_or_goes_back_is_left_out() -> None:
    assert readings([1, 2, 2, 5, 3, 4, 6], [0] * 7).in_order().first_ns.tolist() == [1, 2, 5, 6]
    sound = readings([0, 1], [2, 3])
    assert sound.in_order() is sound


def test_groups_are_thinned_to_their_best_reading() -> None:
    first = np.arange(9)
    late = readings(first, first + np.array([5, 3, 4, 9, 9, 8, 1, 2, 3]), late=True)
    assert late.thinned(3).first_ns.tolist() == [1, 5, 6]  # the least delayed
    exchange = readings(first, first + 10, floor_ns=10 - np.array([5, 3, 4, 9, 9, 8, 1, 2, 3]), late=True)
    assert exchange.thinned(3).first_ns.tolist() == [1, 5, 6]  # the shortest round trip
    both = readings(first, first + np.array([5, 3, 4, 9, 7, 8, 1, 2, 3]))
    assert both.thinned(3).first_ns.tolist() == [2, 5, 7]  # the middle offset
    assert late.thinned(9) is late
    assert len(late.thinned(8)) == 8
    assert len(late.thinned(2)) == 2


# By kind of log


def test_whole_numbers_that_do_not_fit_are_zero() -> None:
    columns = {
        "f": np.array([1.9, np.nan, 1e19, -1e19]), "u": np.array([1, (1 << 63) - 1, 1 << 63, 0], dtype=np.uint64),
        "i": np.array([1, -2, 3, 4]),
    }  # fmt: skip
    table = MadeTable("T", [1, 2, 3, 4], columns)
    assert whole_numbers(table, "f").tolist() == [1, 0, 0, 0]
    assert whole_numbers(table, "u").tolist() == [1, (1 << 63) - 1, 0, 0]
    assert whole_numbers(table, "i").tolist() == [1, -2, 3, 4]


def gps_columns(utc_s: Any) -> dict[str, Any]:
    since_ms = np.round((np.asarray(utc_s, dtype=np.float64) - 315_964_800 + 18) * 1000).astype(np.int64)
    return {"GWk": since_ms // 604_800_000, "GMS": since_ms % 604_800_000}


def test_gps_time_against_the_autopilots_clock() -> None:
    utc_s = UTC_S + np.arange(6.0)
    columns = gps_columns(utc_s)
    columns["GWk"][2] = 0  # without a fix
    gps = MadeTable("GPS", SECOND * np.arange(6), columns)
    one = found(MadeLog(gps))["gps"]
    assert (one.first, one.second, one.message, one.late) == ("GPS 1", "the autopilot's clock", "GPS", True)
    rows = [0, 1, 3, 4, 5]
    assert one.first_ns.tolist() == [(UTC_S + row) * SECOND for row in rows]
    assert one.second_ns.tolist() == [row * SECOND for row in rows]
    assert (one.resolution_s, one.slack_s) == (1e-3, 0.02)


def test_the_arrival_of_a_fix_comes_from_its_accuracy_message() -> None:
    gps = MadeTable("GPS", SECOND * np.array([1, 2, 3, 4, 5, 6, 7]), gps_columns(UTC_S + np.arange(7.0)))
    gpa = MadeTable("GPA", SECOND * np.array([6, 1, 2, 4, 5, 7]), {"SMS": [5900, 900, 1900, 1900, 0, 6810]})
    one = found(MadeLog(gps, gpa))["gps"]
    # The third fix has no GPA, the fourth has the arrival of the second, and that of the fifth is unknown.
    assert one.second_ns.tolist() == [900 * MS, 1900 * MS, 5900 * MS, 6810 * MS]
    assert (one.message, one.fields) == ("GPA", "GPS.GWk, GPS.GMS, SMS")


def test_receivers_are_told_apart() -> None:
    utc = gps_columns(np.repeat(UTC_S + np.arange(4.0), 2))
    gps = MadeTable("GPS", SECOND // 2 * np.arange(8), {"I": [0, 1] * 4, **utc}, instance="I")
    assert {key: one.first for key, one in found(MadeLog(gps)).items()} == {"gps": "GPS 1", "gps.1": "GPS 2"}


def test_utc_of_the_autopilot_counts_within_a_century() -> None:
    utc_us = np.array([0, 1_262_304_000_000_000, 1_262_304_000_000_001, UTC_S * 10**6, 4_102_444_799_999_999,
                       4_102_444_800_000_000])  # fmt: skip
    one = found(MadeLog(MadeTable("PM", SECOND * np.arange(6), {"R": utc_us})))["rtc"]
    assert one.first_ns.tolist() == [2 * SECOND, 3 * SECOND, 4 * SECOND]
    assert one.second_ns.tolist() == (utc_us[2:5] * 1000).tolist()
    assert (one.first, one.second, one.late) == ("the autopilot's clock", "UTC", False)


def test_the_sensors_clock_of_a_run_of_xitl() -> None:
    baro = MadeTable("BARO", SECOND * np.arange(4), {"SampleUS": [1, 2, 3, 4]})
    mag = MadeTable("MAG", SECOND * np.arange(4), {"SampleUS": [1, 2, 3, 4]})
    every = found(MadeLog(mag, baro))
    assert list(every) == ["samples.BARO"]
    assert every["samples.BARO"].first_ns.tolist() == [1000, 2000, 3000, 4000]
    assert every["samples.BARO"].second_ns.tolist() == (SECOND * np.arange(4)).tolist()


def clocks(*nodes: str, **more: Any) -> MadeTable:
    rows = 4 * len(nodes)
    host_ns = 100 * SECOND + np.tile(np.arange(4), len(nodes)) * SECOND
    columns = {
        "node": np.repeat(nodes, 4), "host_ns": host_ns, "node_ns": host_ns + 5 * SECOND,
        "round_trip_s": np.tile([0.001, np.nan, -1.0, 0.003], len(nodes)),
    }  # fmt: skip
    return MadeTable("/clocks", SECOND * np.arange(rows), columns | more)


def recorded(*tables: MadeTable, base: Any = "simulation") -> MadeLog:
    return MadeLog(*tables, kind="mcap", base=base)


def test_exchanges_of_a_run_in_real_time() -> None:
    table = clocks("LC", "PS1")
    table._values["round_trip_s"] = np.tile([0.001, 0.002, 10.0, 0.003], 2)
    every = found(recorded(table))
    assert list(every) == ["clocks.LC", "clocks.PS1"]
    node, host = every["clocks.LC"], every["clocks.PS1"]
    assert (node.first, node.second, node.late) == ("the host's clock", "the clock of LC", True)
    assert node.first_ns.tolist() == [100 * SECOND, 101 * SECOND, 103 * SECOND]  # 10 s is no trip
    assert node.offset_ns.tolist() == [5 * SECOND] * 3
    assert node.floor_ns is not None
    assert node.floor_ns.tolist() == [5 * SECOND - 1 * MS, 5 * SECOND - 2 * MS, 5 * SECOND - 3 * MS]
    assert (host.first, host.second, host.floor_ns) == ("simulation time", "the host's clock", None)
    assert host.offset_ns.tolist() == [-5 * SECOND] * 4


def test_the_lag_of_a_simulated_clock_is_slack() -> None:
    table = clocks("LC", "PS1", asymmetry_bound_s=np.full(8, 0.05), path_delay_s=np.tile([0.05, 0.04, 0.03, np.nan], 2))
    table._values["round_trip_s"] = np.full(8, 0.001)
    assert found(recorded(table))["clocks.LC"].slack_s == pytest.approx(0.04)
    table._values["path_delay_s"] = np.full(8, 0.06)
    assert found(recorded(table))["clocks.LC"].slack_s == 0.0


def test_exchanges_in_lockstep_have_the_grain_of_their_trip() -> None:
    table = clocks("LC", "XX")
    table._values["round_trip_s"] = np.array([0.001, 0.02, 0.002, -1.0, *[1e-4] * 4])
    every = found(recorded(table))
    assert every["clocks.LC"].first == "simulation time"
    assert len(every["clocks.LC"]) == 3
    assert every["clocks.LC"].resolution_s == pytest.approx(0.02)
    assert every["clocks.XX"].resolution_s == 1e-3
    assert every["clocks.LC"].floor_ns is None


def booted(name: str, boot_ms: Any, system: Any = 1, place: Any = None) -> MadeTable:
    rows = len(boot_ms)
    at_ns = UTC_S * SECOND + np.asarray(boot_ms, dtype=np.int64) * MS + 5 * MS
    columns = {"_sysid": np.broadcast_to(system, rows), "time_boot_ms": boot_ms}
    return MadeTable(name, at_ns, columns, place=place)


def test_the_boot_clock_is_that_of_all_messages_of_a_system_in_the_order_of_the_file() -> None:
    log = MadeLog(
        booted("ATTITUDE", [0, 200, 400], place=[0, 2, 4]), booted("RC_CHANNELS", [100, 300, 500], [1, 1, 2],
        [1, 3, 5]),
        booted("SYSTEM_TIME", [600], place=[6]), kind="tlog", base="utc",
    )  # fmt: skip
    every = found(log)
    assert list(every) == ["boot.1"]
    assert every["boot.1"].first_ns.tolist() == [100 * MS, 200 * MS, 300 * MS, 400 * MS]
    assert every["boot.1"].offset_ns.tolist() == [UTC_S * SECOND + 5 * MS] * 4
    assert (every["boot.1"].first, every["boot.1"].second) == ("autopilot 1", "the ground station's clock")


def test_telemetry_in_a_recording_is_a_clock_of_its_link() -> None:
    link = MadeTable("/link/agent/rx", [1], {"frame": [1]})
    sent = booted("/link/agent/rx:ATTITUDE", [100, 200, 300])
    other = booted("/link/agent/rx:SYS_STATUS", [1, 2, 3])
    every = found(recorded(link, sent, other))
    assert list(every) == ["boot.1./link/agent/rx"]
    assert every["boot.1./link/agent/rx"].second == "simulation time"
    assert every["boot.1./link/agent/rx"].message == "/link/agent/rx:*"
    bag = found(recorded(link, sent, base="utc"))
    assert bag["boot.1./link/agent/rx"].second == "the recorder's clock"
    table = clocks("LC")
    table._values["round_trip_s"] = np.full(4, 1e-3)
    assert list(found(recorded(link, sent, table))) == ["clocks.LC"]  # exchanges are better


def test_reported_utc_and_time_exchanges_of_telemetry() -> None:
    time = booted("SYSTEM_TIME", [100, 200, 300, 400])
    time._values["time_unix_usec"] = np.array([0, *(UTC_S * 10**6 + np.array([2, 3, 4]))])
    time.columns = MadeTable("x", [1] * 4, time._values).columns
    sync = MadeTable(
        "TIMESYNC", [1, 2, 3, 4, 5],
        {"_sysid": [1] * 5, "tc1": [0, 11, 12, 13, 14], "ts1": [5, 6, 7, 8, 0]},
    )  # fmt: skip
    every = found(MadeLog(time, sync, kind="tlog", base="utc"))
    assert every["system_time.1"].first_ns.tolist() == [200 * MS, 300 * MS, 400 * MS]
    assert every["system_time.1"].second_ns.tolist() == [UTC_S * SECOND + micro * 1000 for micro in (2, 3, 4)]
    assert every["timesync.1"].first_ns.tolist() == [6, 7, 8]
    assert every["timesync.1"].second_ns.tolist() == [11, 12, 13]


def test_stamps_in_headers_against_the_recording() -> None:
    def topic(name: str, apart_ns: Any, **more: Any) -> MadeTable:
        at_ns = SECOND * np.arange(1, 4)
        return MadeTable(name, at_ns, {"header.stamp": at_ns - apart_ns, **more})

    tables = [topic(f"/t{number}", 5) for number in range(8)]
    every = found(recorded(topic("/a", [1, 2, 3]), topic("/equal", 0), *tables, base="utc"))
    assert list(every) == ["header./a", *(f"header./t{number}" for number in range(5))]  # six topics
    assert every["header./a"].offset_ns.tolist() == [1, 2, 3]
    assert (every["header./a"].first, every["header./a"].second) == ("stamps of /a", "the recorder's clock")
    assert found(recorded(topic("/a", 5))) == {}  # in simulation time
    heavy = topic("/image", 5, data=np.array([b"1", b"2", b"3", None], dtype=object)[:3])
    assert found(recorded(heavy, base="utc")) == {}


def test_two_readings_are_none() -> None:
    assert clock_readings(MadeLog(MadeTable("PM", [1, 2], {"R": [UTC_S * 10**6] * 2}))) == []


# UTC


def offset(log: MadeLog) -> tuple[float, str] | None:
    utc = utc_offset(log)
    return None if utc is None else (utc.offset_ns / SECOND, utc.source)


def test_utc_by_the_best_source() -> None:
    gps = MadeTable("GPS", SECOND * np.arange(5), {"Status": [1, 3, 3, 3, 3], **gps_columns(UTC_S + np.arange(5.0))})
    gps._values["GMS"][[0, 4]] += 5000
    performance = MadeTable("PM", SECOND * np.arange(3), {"R": (UTC_S + 50 + np.arange(3)) * 10**6})
    time = MadeTable("SYSTEM_TIME", [0], {"time_unix_usec": [(UTC_S + 70) * 10**6]})
    assert offset(MadeLog(gps, performance, time)) == (UTC_S, "by GPS")  # the median
    gps._values["Status"][:] = 2
    assert offset(MadeLog(gps, performance, time)) == (UTC_S + 50, "by PM.R")
    assert offset(MadeLog(time)) == (UTC_S + 70, "by SYSTEM_TIME")
    assert offset(MadeLog(MadeTable("PM", [0], {"R": [5]}))) is None
    assert offset(MadeLog(performance, base="utc")) == (0.0, "of the receiving machine")
    link = MadeTable("/link/agent/rx", [1], {"frame": [1]})
    sent = MadeTable("/link/agent/rx:SYSTEM_TIME", [0], {"time_unix_usec": [UTC_S * 10**6]})
    assert offset(recorded(link, sent)) == (UTC_S, "by SYSTEM_TIME")


def test_weeks_of_an_old_receiver() -> None:
    columns = gps_columns([UTC_S] * 3)
    old = MadeTable(
        "GPS", [0, 0, 0], {"Status": [3, 3, 3], "Week": [0, 10_000, columns["GWk"][0]], "TimeMS": columns["GMS"]}
    )
    assert offset(MadeLog(old)) == (UTC_S, "by GPS")


def test_stamps_in_utc_stay_within_64_bits() -> None:
    stamps = np.array([0, 5, (1 << 63) - 1], dtype=np.int64)
    assert in_utc(stamps, None) is stamps
    assert in_utc(stamps, UtcOffset(10, "")).tolist() == [10, 15, (1 << 63) - 1]
    assert in_utc(stamps, UtcOffset(-3, "")).tolist() == [-3, 2, (1 << 63) - 4]


# Placement on a time line

LOG = MadeLog(MadeTable("A", [0, 100 * SECOND], {"x": [0, 0]}))


def placed(*stretches: Stretch, offset_ns: int = 0) -> LogPlacement:
    return LogPlacement(LOG, offset_ns, 0.0, None, "UTC", False, "", stretches)


def test_stamps_on_the_reference_by_stretch() -> None:
    assert placed(offset_ns=5).on_reference(np.array([1, 2])).tolist() == [6, 7]
    two = placed(Stretch(0, 1000, 100.0), Stretch(10 * SECOND, 7000, -50.0))
    stamps = np.array([-1, 0, 1, 9, 10, 12], dtype=np.int64) * SECOND
    expected = [0 - 100_000 + 1000, 1000, 101_000, 901_000, 7000, -93_000]
    expected = [at + stamp for at, stamp in zip(expected, stamps.tolist(), strict=True)]
    assert two.on_reference(stamps).tolist() == expected
    line = TimeLine(2 * SECOND, two.stretches)
    assert line.seconds(stamps) == pytest.approx([(at - 2 * SECOND) / SECOND for at in expected], abs=1e-12)
    assert line.seconds(stamps.astype(np.float64)) == pytest.approx([(at - 2 * SECOND) / SECOND for at in expected])
    assert line.second(12 * SECOND) == pytest.approx(10.0 - 93e-6)
    assert TimeLine(2 * SECOND).second(5 * SECOND) == 3.0
    assert TimeLine().second((1 << 63) - 1) == pytest.approx((1 << 62) * 1e-9)  # a larger value is no instant


def test_a_placement_from_a_conversion_has_a_stretch_between_breaks() -> None:
    def to_reference(stamp_ns: Any) -> Any:
        late = stamp_ns >= 40 * SECOND
        return stamp_ns + np.where(late, 9000 + (stamp_ns - 40 * SECOND) // 50_000, 500 + stamp_ns // 100_000)

    breaks = [200 * SECOND, 40 * SECOND, 40 * SECOND, 0, 100 * SECOND, -5]
    found = placement_from(LOG, (0, 100 * SECOND), to_reference, breaks, error_s=0.1, method="UTC", sentence="s")
    first, second = found.stretches
    assert (first.from_ns, second.from_ns) == (0, 40 * SECOND)
    assert (first.offset_ns, second.offset_ns) == (pytest.approx(500, abs=2), pytest.approx(9000, abs=2))
    assert (first.drift_ppm, second.drift_ppm) == (pytest.approx(10.0, abs=1e-3), pytest.approx(20.0, abs=1e-3))
    assert (found.offset_ns, found.drift_ppm) == (first.offset_ns, second.drift_ppm)  # 60 s are longer than 40 s
    assert (found.error_s, found.method, found.sentence, found.reference, found.aligned) == (
        0.1,
        "UTC",
        "s",
        False,
        True,
    )
    stamps = np.array([0, 20, 39, 41, 99]) * SECOND
    assert found.on_reference(stamps) == pytest.approx(to_reference(stamps), abs=3)


def test_a_placement_of_one_instant() -> None:
    found = placement_from(LOG, (5, 5), lambda stamp_ns: stamp_ns + 7, (), error_s=0.1, method="UTC", sentence="")
    assert found.on_reference(np.array([5])).tolist() == [12]


def test_the_clock_of_a_log_counts_from_its_zero_or_on_its_time_line() -> None:
    armed = MadeTable("ARM", SECOND * np.array([10, 30]), {"ArmState": [1, 0]})
    log = MadeLog(armed, MadeTable("A", [5 * SECOND, 100 * SECOND], {"x": [0, 0]}))
    clock = LogClock(log)
    assert (clock.start_ns, clock.end_ns) == (5 * SECOND, 100 * SECOND)
    assert clock.second(12_345_678_901) == 12.346
    assert clock.text(106_460_000_000) == "1:46.5"
    assert clock.armed == [(10 * SECOND, 30 * SECOND)]
    assert clock.was_armed(9 * SECOND, 31 * SECOND) is False
    assert clock.was_armed(9 * SECOND, 30 * SECOND) is True
    assert clock.armed_rows(np.array([9, 10, 30, 31]) * SECOND).tolist() == [False, True, True, False]
    moved = LogClock(AlignedLog(log, TimeLine(2 * SECOND)))
    assert moved.second(12 * SECOND) == 10.0
