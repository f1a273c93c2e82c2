"""`xitl logs info|dump|export|tasks` through the command's own entry; as processes where that makes a difference."""

from __future__ import annotations

import csv
import json
import os
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from conftest import Xitl, assert_one_line_error, command, environment

from tests.golden import Golden
from tests.patience import PATIENCE_S
from tests.recorded import CALM, MISSION_TLOG
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.recorder import TopicWriter

Run = Callable[..., subprocess.CompletedProcess[str]]


def test_info_of_several_files_and_one_that_is_none(xitl: Xitl, tmp_path: Path, golden: Golden) -> None:
    (tmp_path / "notes.txt").write_text("calm, a little rain\n")
    told = xitl("logs", "info", str(CALM), "notes.txt", str(MISSION_TLOG))
    assert told.returncode == 2
    golden("stderr", told.stderr.strip().splitlines())
    first, _, second = told.stdout.partition(str(MISSION_TLOG))
    assert "DataFlash, 7.1 MB, 152455 records" in first
    assert "ArduRover V4.7.0-dev" in first
    assert "42.434 to 140.712 s (1:38 min) since the autopilot started" in first
    assert "telemetry log, 342.3 kB, 7856 records" in second
    assert "ATTITUDE" in second
    lines = [line for line in told.stdout.splitlines() if not line.startswith("/")]
    assert max(map(len, lines)) <= 80


@pytest.mark.medium
def test_info_as_json(logs: Run) -> None:
    told = logs("info", "--json", str(CALM), "nowhere.bin")
    assert told.returncode == 2
    found = json.loads(told.stdout)
    assert len(found["refused"]) == 1
    (log,) = found["logs"]
    assert (log["format"], log["time_base"], log["start_utc"]) == ("dataflash", "boot", "2026-11-20 12:18:41")
    messages = {message["name"]: message for message in log["messages"]}
    assert messages["IMU"]["instances"] == 2
    assert messages["IMU"]["rate_hz"] == pytest.approx(50, abs=1)  # LOG_BITMASK logs it 50 times a second
    assert {"name": "Roll", "unit": "deg", "kind": "number", "shape": []} in messages["ATT"]["fields"]
    assert log["health"]["degraded"] is False


@pytest.mark.medium
def test_info_of_a_damaged_log_says_where(logs: Run, tmp_path: Path) -> None:
    data = bytearray(CALM.read_bytes())
    data[3_000_000:3_000_100] = bytes(100)
    (tmp_path / "damaged.bin").write_bytes(data[:-5])
    told = logs("info", "damaged.bin")
    assert told.returncode == 0
    assert "degraded" in told.stdout
    assert "at byte " in told.stdout


@pytest.mark.medium
def test_dump_rows_that_a_condition_holds_of(logs: Run) -> None:
    told = logs("dump", str(CALM), "att", "--fields", "roll,Yaw", "--where", "abs(Roll) > 0.1 and time_s < 90")
    assert told.returncode == 0
    names, units, *rows = [line.split() for line in told.stdout.splitlines()]
    assert names == ["time_s", "Roll", "Yaw"]
    assert units == ["s", "deg", "deg"]
    assert rows
    assert all(abs(float(roll)) > 0.1 and float(at) < 90 for at, roll, _ in rows)


def test_dump_several_messages_in_the_order_of_the_file(logs: Run) -> None:
    told = logs("dump", str(CALM), "MSG,MODE", "GPS", "--json", "--from", "42", "--until", "60", "--limit", "40")
    rows = [json.loads(line) for line in told.stdout.splitlines()]
    assert len(rows) == 40
    assert {row["message"] for row in rows} == {"MSG", "MODE", "GPS"}
    times = [row["time_s"] for row in rows]
    assert times == sorted(times)
    assert 42 <= times[0] <= times[-1] <= 60
    assert {"message": "MSG", "time_s": 42.433853, "fields": {"TimeUS": 42433853, "Message": "Throttle armed"}} in rows


@pytest.mark.medium
def test_messages_that_a_log_has_no_row_of_and_fields_that_one_lacks_are_said(logs: Run) -> None:
    told = logs("dump", str(CALM), "PM,EV", "--where", "NLon > 0", "--from", "60", "--until", "120")
    assert told.returncode == 0
    assert told.stderr.splitlines() == [f"{CALM}: has no row of EV", f"{CALM}: no row of PM matches"]
    told = logs("dump", str(CALM), "MSG,PM,ev", "--where", "NL > 0 or Message == 'Throttle armed'", "--json")
    rows = [json.loads(line) for line in told.stdout.splitlines()]
    assert [row["message"] for row in rows].count("PM") == 9  # one in ten seconds
    assert [row["fields"]["Message"] for row in rows if row["message"] == "MSG"] == ["Throttle armed"]
    assert told.stderr.splitlines()[1:] == [
        "MSG has no NL: comparisons with it are false there",
        "PM has no Message: comparisons with it are false there",
    ]
    assert logs("dump", str(CALM), "EV").returncode == 0
    assert_one_line_error(logs("plot", str(CALM), "EV"), "has no row of EV")
    assert_one_line_error(logs("export", str(CALM), "EV"), "has no row of EV")
    assert_one_line_error(logs("dump", str(CALM), "PM,EVV"), "'EVV'")


@pytest.mark.medium
def test_dump_raw_values_and_nothing(logs: Run) -> None:
    told = logs("dump", str(MISSION_TLOG), "GLOBAL_POSITION_INT", "--raw", "--json", "--limit", "1")
    assert isinstance(json.loads(told.stdout)["fields"]["lat"], int)
    told = logs("dump", str(CALM), "ATT", "--where", "Roll > 1000")
    assert (told.returncode, told.stdout) == (0, "")
    assert told.stderr == f"{CALM}: no row of ATT matches\n"


@pytest.mark.medium
def test_dump_ends_quietly_when_its_reader_has_enough(tmp_path: Path) -> None:
    process = subprocess.Popen(
        command("logs", "dump", str(CALM), "IMU"),
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    with process.stdout, process.stderr:
        assert os.read(process.stdout.fileno(), 100)
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.wait(PATIENCE_S) == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("dump", str(CALM), "ATTT"), ("'ATTT'", "did you mean 'ATT'")),
        (("dump", str(CALM), "ATT", "--fields", "Rol"), ("'Rol'", "'Roll'")),
        (("dump", str(CALM), "ATT", "--where", "Roll ="), ("'Roll ='",)),
        (("dump", str(CALM), "ATT", "--from", "5", "--until", "2"), ("--until = 2", "swap")),
        (("dump", ".", "ATT"), ("is a directory",)),
        (("export", str(CALM), "--format", "xlsx"), ("xlsx", "csv, parquet, mcap")),
        (("export", str(CALM), "ATT", "--out", "/proc/out"), ("/proc/out",)),
        (("tasks", "boat.bin"), ("is not the address of a vehicle", "tcp://")),
    ],
)
def test_what_cannot_be_done_is_one_sentence(
    logs: Run, tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    assert_one_line_error(logs(*arguments), *words)
    assert list(tmp_path.iterdir()) == []


def record(path: Path, stamps_ns: Sequence[int], compression: str = "lz4") -> None:
    """A recording of a vessel that goes straight on."""
    file = McapFile(path, compression)
    topics = TopicWriter(file)
    for step, stamp_ns in enumerate(stamps_ns):
        motion = (0.1 * step, 0.05 * step, 0.0), (5.0, 2.5, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        topics.write("/truth/state", stamp_ns, *motion, (0.0, 0.0, 0.0), (0.0, 0.0))
    file.close()


@pytest.mark.parametrize(
    "arguments",
    [
        ("plot", "wild.mcap", "/truth/state.position_ned_m"),
        ("analyze", "wild.mcap", "--section", "overview"),
        ("compare", "wild.mcap", "wild.mcap", "--of-a", "truth", "--of-b", "truth"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_stamp_that_no_clock_shows_ends_no_command(logs: Run, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    """Nor does it bring a warning of numpy's, which is an error here."""
    stamps_ns = [step * 20_000_000 for step in range(400)]
    record(tmp_path / "wild.mcap", stamps_ns, "none")
    data = (tmp_path / "wild.mcap").read_bytes()
    wild = data.replace(stamps_ns[-1].to_bytes(8, "little"), (2**63 - 5).to_bytes(8, "little"))
    assert wild != data
    (tmp_path / "wild.mcap").write_bytes(wild)
    told = logs(*arguments)
    assert "failed" not in told.stdout + told.stderr
    assert told.returncode == 0, told.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "cut.mcap"),
        ("dump", "cut.mcap", "/truth/state", "--limit", "1"),
        ("export", "cut.mcap", "/truth/state"),
        ("plot", "cut.mcap", "/truth/state.position_ned_m"),
        ("analyze", "cut.mcap", "--section", "vehicle"),
        ("compare", "cut.mcap", "cut.mcap", "--of-a", "truth", "--of-b", "truth"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_every_command_names_the_repair_of_what_was_never_closed(
    logs: Run, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    record(tmp_path / "run.mcap", [step * 20_000_000 for step in range(400)])
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "run.mcap").read_bytes()[:-30])
    told = logs(*arguments)
    assert told.returncode == 0, told.stderr
    words = " ".join((told.stdout + told.stderr).split())
    assert "not closed by its writer" in words
    assert "`xitl logs repair`" in words


@pytest.mark.medium
def test_export(logs: Run, tmp_path: Path) -> None:
    told = logs("export", str(CALM), "ATT", "GPS", "--until", "60", "--out", "out")
    assert told.returncode == 0
    assert told.stdout.startswith("out: ")
    with (tmp_path / "out" / "ATT.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(42 <= float(row["time_s"]) <= 60 for row in rows)
    assert_one_line_error(logs("export", str(CALM), "ATT", "--out", "out"), "ATT.csv", "--overwrite")
    told = logs("export", str(CALM), "ATT", "--format", "mcap", "--json")
    assert json.loads(told.stdout)["files"] == ["boat-auto-calm-export.mcap"]
    told = logs("info", "boat-auto-calm-export.mcap")
    assert "/ATT" in told.stdout
