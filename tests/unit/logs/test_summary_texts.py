"""Summaries of logs and the texts of reports: figures, units and words at each limit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.errors import LogError, UnknownNameError
from xitl_cli.logs.model.log import Damage, LogHealth, Losses
from xitl_cli.logs.model.sections import Evidence, Fact, Grid, Severity
from xitl_cli.logs.model.table import Column
from xitl_cli.logs.model.text import (
    clock_text,
    duration_text,
    length_text,
    listed,
    parse_optional_seconds,
    parse_seconds,
    plural,
    printable,
    resolve_name,
)
from xitl_cli.logs.report.build import short_names
from xitl_cli.logs.report.terminal import grid_lines
from xitl_cli.logs.report.wording import (
    damage_sentences,
    evidence_text,
    is_numeric,
    sentence_text,
    severity_counts,
    value_text,
    vehicle_line,
    verdict,
)
from xitl_cli.logs.summary import Summary, summarize_log, vehicle_facts
from xitl_cli.plugins.logs.info_command import summary_lines

S = 1_000_000_000


# Texts


@pytest.mark.parametrize(
    ("at_s", "decimals", "text"),
    [
        (43.25, 1, "0:43.2"), (43.2501, 1, "0:43.3"), (59.96, 1, "1:00.0"), (3599.94, 1, "59:59.9"),
        (3600.0, 1, "1:00:00.0"), (3723.45, 2, "1:02:03.45"), (-1.0, 1, "-0:01.0"), (-0.04, 1, "0:00.0"),
        (62.4, 0, "1:02"), (0.007, 3, "0:00.007"), (36_000.0, 0, "10:00:00"),
    ],
)  # fmt: skip
def test_instants(at_s: float, decimals: int, text: str) -> None:
    assert clock_text(at_s, decimals) == text


def test_durations() -> None:
    assert [duration_text(s) for s in (0.44, 59.94, 60.0, 372.0, 3599.4, 3600.0)] == [
        "0.4 s", "59.9 s", "1:00 min", "6:12 min", "59:59 min", "1:00:00 h",
    ]  # fmt: skip
    assert [length_text(s) for s in (0.354, 0.994, 1.0, 12.44, 99.9, 100.0, 312.4)] == [
        "0.35 s", "0.99 s", "1.0 s", "12.4 s", "99.9 s", "100 s", "312 s",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("90", 90.0),
        (" 90.5 ", 90.5),
        ("1:30.5", 90.5),
        ("1:02:03", 3723.0),
        ("-1:30", -90.0),
        ("0", 0.0),
        ("0:0:1", 1.0),
    ],
)
def test_seconds_of_a_user(text: str, seconds: float) -> None:
    assert parse_seconds(text) == seconds
    assert parse_optional_seconds(text) == seconds


@pytest.mark.parametrize("text", ["", "x", "1:2:3:4", "1:-2", "inf", "nan", "1::2"])
def test_no_seconds(text: str) -> None:
    with pytest.raises(LogError, match="is not a time"):
        parse_seconds(text)
    assert parse_optional_seconds(None) is None


def test_names() -> None:
    known = ["ATT", "GPS", "Gps2"]
    assert resolve_name("ATT", known, "no", "look") == "ATT"
    assert resolve_name("gps2", known, "no", "look") == "Gps2"
    with pytest.raises(UnknownNameError, match=r"no 'ATR'; did you mean 'ATT'\? look"):
        resolve_name("ATR", known, "no", "look")
    with pytest.raises(UnknownNameError, match=r"no 'QQQQ'; look"):
        resolve_name("QQQQ", known, "no", "look")
    assert printable("a\x1b[1mb") == "a [1mb"
    assert (plural(1, "row"), plural(2, "row"), plural(2, "loss", "losses"), plural(0, "byte")) == (
        "1 row", "2 rows", "2 losses", "0 bytes",
    )  # fmt: skip
    assert listed(["a", "_b", "c"]) == "a, c and 1 more"
    assert listed([str(n) for n in range(12)]).endswith("10, 11")
    assert listed([str(n) for n in range(14)]).endswith("11 and 2 more")


@pytest.mark.parametrize(
    ("value", "name", "text"),
    [
        (None, "", "–"), (True, "", "yes"), (False, "", "no"), (1_234_567_890, "", "1234567890"),
        (1.23456789, "", "1.23457"),
        (-0.0, "", "0"), (999_999.4, "", "999999"), (1e6, "", "1000000"), (1_234_567.8, "", "1234568"),
        (-1.5e6, "", "-1500000"),
        (1e15, "", "1e+15"), (47.123456789, "Latitude", "47.1234568"), (8.5, "longitude (deg)", "8.5000000"),
        (math.inf, "", "–"), (math.nan, "", "–"), (" a\n b ", "", "a b"),
    ],
)  # fmt: skip
def test_values(value: Any, name: str, text: str) -> None:
    assert value_text(value, name) == text


def test_columns_of_numbers() -> None:
    grid = Grid("k", "t", ("a", "b", "c", "d"), ((1, "x", True, None), (2.5, 3, False, None), (None, 4, True)))
    assert [is_numeric(grid, index) for index in range(4)] == [True, False, False, False]


def test_sentences_and_counts() -> None:
    assert sentence_text("the host stalled") == "The host stalled"
    assert sentence_text("xitl_cli fails") == "xitl_cli fails"
    assert sentence_text("B is") == "B is"
    assert sentence_text("") == ""
    critical, warning, notice, fine = Severity.CRITICAL, Severity.WARNING, Severity.NOTICE, Severity.OK
    assert severity_counts([warning, notice, warning, fine]) == "2 warnings, 1 notice"
    assert severity_counts([critical, critical]) == "2 critical"
    assert severity_counts([fine]) == "nothing to look into"
    assert verdict([critical, notice], 2) == "1 critical, 1 notice"
    assert verdict([critical], 2) == "1 critical (1 finding follows from these)"
    assert verdict([critical, notice], 5) == "1 critical, 1 notice (3 findings follow from these)"


def test_vehicles() -> None:
    def facts(**known: Any) -> list[Fact]:
        return [Fact(key, key, value) for key, value in known.items()]

    assert vehicle_line(facts(vehicle="rover", vehicle_type="surface boat", firmware="ArduRover V4")) == (
        "surface boat, ArduRover V4"
    )
    assert vehicle_line(facts(vehicle="rover", firmware_version="4.5.1")) == "rover, firmware 4.5.1"
    assert vehicle_line(facts(vehicle="rover", firmware="A", firmware_version="4.5.1")) == "rover, A"
    assert vehicle_line(facts(vehicle="rover", firmware=None)) == "rover"
    assert vehicle_line([]) == ""


def test_every_loss_has_a_sentence() -> None:
    health = LogHealth(
        100, 5, 2, (Damage(7, 3, "no record begins here"), Damage(9, 1, "x")), 1, 3, 4, True, 1, 2, 1,
        {"XYZ": (2, "no format")}, ("a gap",),
    )  # fmt: skip
    assert health.degraded
    assert damage_sentences(health) == (
        "not closed by its writer, so the end may be missing; `xitl logs repair` writes a complete copy",
        "a gap",
        "damaged in 2 places, the first at byte 7 (no record begins here)",
        "1 byte could not be read",
        "3 records kept although the data after it is damaged",
        "ends within a record, after 4 bytes of it",
        "1 row with an earlier time stamp than the row before",
        "2 rows with an impossible time, replaced by that of the row before",
        "1 type described twice, with differences",
        "XYZ: 2 rows not decoded (no format)",
    )
    assert damage_sentences(LogHealth(100, 5)) == ()


@pytest.mark.parametrize(
    ("changed", "degraded"),
    [
        ({"damaged": 1}, True), ({"lost_bytes": 1}, True), ({"suspect": 1}, True), ({"truncated_bytes": 1}, True),
        ({"unclosed": True}, True), ({"replaced_stamps": 1}, True), ({"gaps": ("a",)}, True),
        ({"back_in_time": 1}, False),
        ({"redefined": 1}, False), ({"undecoded": {"X": (1, "y")}}, False),
    ],
)  # fmt: skip
def test_a_log_is_degraded_if_written_data_is_missing(changed: dict[str, Any], degraded: bool) -> None:
    assert replace(LogHealth(1, 1), **changed).degraded is degraded


def test_losses_are_counted_and_at_most_a_thousand_are_listed() -> None:
    losses = Losses(truncated_bytes=7, suspect=2)
    for place in range(1001):
        losses.note(place, 2, "x")
    health = losses.health(9, 8, back_in_time=3)
    assert (health.damaged, health.lost_bytes, len(health.damage), health.truncated_bytes) == (1001, 2002, 1000, 7)
    assert (health.size_bytes, health.records, health.suspect, health.back_in_time) == (9, 8, 2, 3)
    assert health.as_json()["damage"][0] == {"place": 0, "lost": 2, "why": "x"}


@pytest.mark.parametrize(
    ("evidence", "text"),
    [
        (Evidence("PM", "MaxT", 43_200_000_000, 53_200_000_000, "23 ms"), "PM.MaxT from 0:41.2 to 0:51.2: 23 ms"),
        (Evidence("PM", None, 43_200_000_000), "PM at 0:41.2"),
        (Evidence("PM", "MaxT", 43_200_000_000, 43_210_000_000), "PM.MaxT at 0:41.2"),
        (Evidence("PM", "MaxT", 43_200_000_000, 1), "PM.MaxT at 0:41.2"),
        (Evidence("PM", "MaxT", value="3"), "PM.MaxT: 3"),
    ],
)
def test_evidence(evidence: Evidence, text: str) -> None:
    assert evidence_text(evidence, TimeLine(2 * S)) == text


def test_files_are_told_apart_by_as_few_folders_as_needed() -> None:
    paths = [Path("/a/b/x.bin"), Path("/a/c/x.bin"), Path("/a/c/y.bin"), Path("/z/b/x.bin"), Path("/a/c/y.bin")]
    assert short_names(paths) == ["a/b/x.bin", "c/x.bin", "//a/c/y.bin", "z/b/x.bin", "//a/c/y.bin"]


# Tables on a terminal


def test_a_table_that_fits() -> None:
    grid = Grid("k", "t", ("name", "many of them", "x"), (("a", 12.5, "yes"), ("long name", 3, None), ("c", 1, "z")))
    assert grid_lines(grid, 40, 2) == [
        "name       many of them  x",
        "a                  12.5  yes",
        "long name             3  –",
        "(1 more row in --report and --json)",
    ]


def test_a_table_that_does_not_fit() -> None:
    wide = "a text of more than twenty-four letters"
    grid = Grid("k", "t", ("name", "what", "number", "rate (Hz)"), (("a", wide, 1, 2.5), ("b", None, 3, None)))
    assert grid_lines(grid, 22, 9) == [
        "                  rate",
        "name  number      (Hz)",
        "a          1       2.5",
        "  what: a text of more",
        "    than twenty-four",
        "    letters",
        "b          3         –",
        "  what: –",
    ]
    assert grid_lines(grid, 14, 9) == [
        "name  number",
        "a          1",
        "  rate (Hz) 2.5",
        "  what: a text of",
        "    more than",
        "    twenty-four",
        "    letters",
        "b          3",
        "  rate (Hz) –",
        "  what: –",
    ]


# Summaries


def rows(name: str, rate_hz: float, many: int, **columns: Any) -> MadeTable:
    return MadeTable(name, np.round(np.arange(many) / rate_hz * S).astype(np.int64), {"A": np.zeros(many), **columns})


class EndedTable(MadeTable):
    """A table that knows its ends, as those of files do."""

    @property
    def ends_ns(self) -> tuple[int, int] | None:
        return (int(self.stamp_ns[0]), int(self.stamp_ns[-1])) if len(self.stamp_ns) else None


def test_a_summary_has_rates_and_instances() -> None:
    both = EndedTable("IMU", np.repeat(np.arange(51), 2) * S // 50, {"I": np.tile([0, 1], 51)}, instance="I")
    one = EndedTable("ONE", [5], {"A": [1]})
    quick = EndedTable("Q", [0, 99_000_000], {"A": [1, 2]})
    slow = EndedTable("R", [0, 100_000_000], {"A": [1, 2]})
    summary = summarize_log(MadeLog(both, one, quick, slow))
    found = {message.name: (message.rows, message.rate_hz, message.instances) for message in summary.messages}
    assert found == {
        "IMU": (102, pytest.approx(50.0), 2), "ONE": (1, None, None), "Q": (2, None, None),
        "R": (2, pytest.approx(10.0), None),
    }  # fmt: skip
    assert summary.span_s == (0.0, 1.0)
    document = summary.as_json()
    assert (document["from_s"], document["until_s"], document["duration_s"]) == (0.0, 1.0, 1.0)
    assert document["messages"][0]["fields"] == [{"name": "I", "unit": "", "kind": "number", "shape": []}]


def test_a_summary_of_utc_begins_at_its_first_row() -> None:
    table = EndedTable("HEARTBEAT", (1_790_000_000 + np.arange(3)) * S, {"A": [1, 2, 3]})
    summary = summarize_log(MadeLog(table, kind="tlog", base="utc"))
    assert (summary.span_s, summary.start_utc) == ((0.0, 2.0), "2026-09-21 14:13:20")
    empty = summarize_log(MadeLog())
    assert (empty.span_s, empty.start_utc, empty.as_json()["duration_s"]) == (None, None, None)


def known(*tables: MadeTable, **of: Any) -> dict[str, Any]:
    log = MadeLog(MadeTable("ATT", [2 * S, 62_340_000_000], {"Yaw": [0.0, 0.0]}), *tables, **of)
    return {fact.key: fact.value for fact in vehicle_facts(log)}


def test_the_firmware_of_ardupilot() -> None:
    version = {
        "Maj": [4],
        "Min": [5],
        "Pat": [7],
        "GH": [0xABC123],
        "FWT": [255],
        "BT": [3],
        "BU": [1],
        "FWS": ["ArduRover V4.5.7"],
    }
    parameters = MadeTable(
        "PARM",
        [2 * S] * 3,
        {"Name": ["LOG_BITMASK", "LOG_DISARMED", "LOG_BACKEND_TYPE"], "Value": [65535.0, 1.0, 1e12]},
    )
    found = known(MadeTable("VER", [2 * S], version), parameters)
    assert (found["vehicle"], found["firmware"], found["firmware_version"]) == ("rover", "ArduRover V4.5.7", "4.5.7")
    assert found["firmware_commit"] == "00abc123"
    assert (found["duration_s"], found["uptime_start_s"], found["uptime_end_s"]) == (60.3, 2.0, 62.3)
    assert (found["log_bitmask"], found["log_disarmed"], "log_backend" in found) == (65535, 1, False)
    said = known(MadeTable("MSG", [2 * S], {"Message": ["ArduRover V4.1 (0123abcd)"]}))
    assert (said["firmware"], said["firmware_commit"]) == ("ArduRover V4.1 (0123abcd)", "0123abcd")
    own = known(MadeTable("MSG", [2 * S], {"Message": ["xitl 0.9, messages and modes as ArduRover V4.6"]}))
    assert (own["firmware"], own["firmware_version"]) == ("xitl embedded autopilot", "0.9")


def test_the_firmware_of_telemetry() -> None:
    beats = MadeTable(
        "HEARTBEAT", [2 * S], {"_sysid": [1], "autopilot": [3], "type": [11], "custom_mode": [0], "base_mode": [0]}
    )
    custom = np.array([[ord(letter) for letter in "deadbeef"]])
    told = MadeTable(
        "AUTOPILOT_VERSION",
        [2 * S],
        {"_sysid": [1], "flight_sw_version": [(4 << 24) + (5 << 16) + (7 << 8) + 255], "flight_custom_version": custom},
    )
    found = known(beats, told, kind="tlog", base="utc")
    assert (found["firmware_version"], found["firmware_commit"], found["vehicle"]) == ("4.5.7", "deadbeef", "rover")
    assert "uptime_start_s" not in found


def summary(**changed: Any) -> Summary:
    empty = Summary(Path("/x.bin"), "dataflash", "boot", (1.0, 63.5), None, (), {}, LogHealth(1_530_000, 12), ())
    return replace(empty, **changed)


def test_a_summary_on_a_terminal() -> None:
    from xitl_cli.logs.summary import MessageSummary

    columns = tuple(Column(f"Field{number}", "m", shape=(3,) if number == 1 else ()) for number in range(8))
    about = (Fact("vehicle", "Vehicle", "rover"), Fact("firmware", "", "ArduRover V4.5.7"),
    Fact("firmware_version", "", "4.5.7"),
             Fact("board", "", "SITL"))  # fmt: skip
    messages = (
        MessageSummary("IMU", 12_000, 1234.5, 2, columns), MessageSummary("B", 1, None, None, ()),
        MessageSummary("/big", 9, 0.51234, None, None),
    )  # fmt: skip
    told = summary(about=about, messages=messages, start_utc="2026-09-21 14:13:20", facts={"seed": "7"})
    lines = list(summary_lines(told))
    assert lines == [
        "/x.bin",
        "  format   DataFlash, 1.5 MB, 12 records",
        "  time     1.000 to 63.500 s (1:02 min) since the autopilot started",
        "  start    2026-09-21 14:13:20 UTC",
        "  vehicle  rover, ArduRover V4.5.7, SITL",
        "  seed     7",
        "  health   whole",
        "",
        "message     rows       Hz inst  fields",
        "IMU        12000     1234    2  Field0 Field1 Field2 Field3 Field4 Field5 +2",
        "B              1        -    -",
        "/big           9    0.512    -",
        "fields are not read from a file of this size; --fields reads all of it",
    ]
    every = list(summary_lines(told, every_field=True))
    assert every[8] == "message     rows       Hz inst"
    assert every[10] == "    Field0 m, Field1[3] m, Field2 m, Field3 m, Field4 m, Field5 m, Field6 m,"
    assert every[11] == "    Field7 m"


def test_damage_and_unknown_times_on_a_terminal() -> None:
    damage = tuple(Damage(place, 1, "no record begins here") for place in range(12))
    health = LogHealth(999, 1, 12, damage, 12)
    lines = list(summary_lines(summary(health=health, span_s=None, about=(Fact("firmware_version", "", "4.1"),))))
    assert lines[1:4] == [
        "  format   DataFlash, 999 bytes, 1 record", "  time     no row has a time stamp",
        "  vehicle  firmware 4.1",
    ]  # fmt: skip
    assert sum("at byte" in line and "1 byte lost" in line for line in lines) == 10
    assert "           and 2 more places; --json lists the first 1000" in lines
    assert lines[-1] == "no readable message"
