"""`xitl logs info|dump|export|compare` on small files whose content is known, in this process."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import typer
from dataflash_records import ITSELF, described, record
from typer.testing import CliRunner

from xitl_cli.errors import UserError
from xitl_cli.logs.model.errors import LogError
from xitl_cli.plugins.logs.plugin import COMMAND

app = typer.Typer()
COMMAND.add(app, "logs")

HEAD = (
    ITSELF
    + described(1, b"ATT", "QccC", "TimeUS,Roll,Pitch,Yaw")
    + described(2, b"MSG", "QZ", "TimeUS,Message")
    + described(3, b"POS", "QLLf", "TimeUS,Lat,Lng,Alt")
    + described(4, b"ARM", "QB", "TimeUS,ArmState")
    + described(5, b"NONE", "QB", "TimeUS,A")
)


def attitude(at_s: float, roll_deg: float, yaw_deg: float = 90.0) -> bytes:
    return record(1, "QccC", round(at_s * 1e6), round(roll_deg * 100), -150, round(yaw_deg * 100))


def place(at_s: float, lat_deg: float, lon_deg: float = 8.0) -> bytes:
    return record(3, "QLLf", round(at_s * 1e6), round(lat_deg * 1e7), round(lon_deg * 1e7), 400.0)


def small(folder: Path, name: str = "small.bin") -> Path:
    rows = attitude(10.0, 1.0) + record(2, "QZ", 10_500_000, b"two words") + attitude(11.0, 6.25) + attitude(12.5, -3.0)
    path = folder / name
    path.write_bytes(HEAD + rows)
    return path


def sailed(folder: Path, name: str, zero_s: float, east_deg: float = 0.0, seconds: int = 40) -> Path:
    """North at 1e-5 deg (1.1 m) a second, armed from the fifth second on."""
    rows = [
        attitude(zero_s + second, 0.1 * (second % 7)) + place(zero_s + second, 47.0 + 1e-5 * second, 8.0 + east_deg)
        for second in range(seconds)
    ]
    rows.insert(6, record(4, "QB", round((zero_s + 5.0) * 1e6), 1))
    path = folder / name
    path.write_bytes(HEAD + b"".join(rows))
    return path


def run(*arguments: Any) -> tuple[int, str, str]:
    """Exit code, or 2 with the sentence as `main` prints it; output and errors."""
    told = CliRunner().invoke(app, [str(each) for each in arguments], env={"COLUMNS": "80", "NO_COLOR": "1"})
    if isinstance(told.exception, (UserError, LogError)):
        return 2, told.stdout, f"error: {told.exception}"
    if told.exception is not None and not isinstance(told.exception, SystemExit):
        raise told.exception
    return told.exit_code, told.stdout, told.stderr


# dump


@pytest.mark.medium
def test_rows_of_one_message_are_a_table(tmp_path: Path) -> None:
    assert run("dump", small(tmp_path), "ATT", "--fields", "Yaw,Roll") == (
        0,
        "   time_s  Yaw  Roll\n        s\n10.000000   90     1\n11.000000   90  6.25\n12.500000   90    -3\n",
        "",
    )
    assert run("dump", small(tmp_path), "ATT", "--fields", "Roll", "--from", "11", "--until", "0:11")[1] == (
        "   time_s  Roll\n        s\n11.000000  6.25\n"
    )


def test_rows_of_several_messages_are_in_the_order_of_the_file(tmp_path: Path) -> None:
    code, text, _ = run("dump", small(tmp_path), "MSG,ATT", "--fields", "Message,Roll")
    assert code == 0
    assert text == (
        '10.000000 ATT Roll=1\n10.500000 MSG Message="two words"\n11.000000 ATT Roll=6.25\n12.500000 ATT Roll=-3\n'
    )
    assert run("dump", small(tmp_path), "MSG", "ATT", "--limit", "2", "--fields", "Roll,Message")[1].count("\n") == 2
    assert run("dump", small(tmp_path), "ATT", "--limit", "0")[1] == ""


def test_rows_as_json(tmp_path: Path) -> None:
    lines = run("dump", small(tmp_path), "ATT", "MSG", "--json", "--until", "10.6")[1].splitlines()
    assert [json.loads(line) for line in lines] == [
        {"time_s": 10.0, "message": "ATT",
         "fields": {"TimeUS": 10_000_000, "Roll": 1.0, "Pitch": -1.5, "Yaw": 90.0}},
        {"time_s": 10.5, "message": "MSG", "fields": {"TimeUS": 10_500_000, "Message": "two words"}},
    ]  # fmt: skip


@pytest.mark.medium
def test_a_condition_selects_rows_and_tells_what_it_does_not_have(tmp_path: Path) -> None:
    path = small(tmp_path)
    code, text, told = run("dump", path, "ATT", "MSG", "--where", "Roll > 0", "--fields", "Roll")
    assert (code, text) == (0, "10.000000 ATT Roll=1\n11.000000 ATT Roll=6.25\n")
    assert told == "MSG has no Roll: comparisons with it are false there\n"
    assert run("dump", path, "ATT", "--where", "Roll > 100") == (0, "", f"{path}: no row of ATT matches\n")
    assert run("dump", path, "ATT", "--where", "Rol > 0")[2].startswith("error: ")
    assert run("dump", path, "NONE") == (0, "", f"{path}: has no row of NONE\n")
    assert "did you mean 'ATT'" in run("dump", path, "ATR")[2]
    assert "has no field 'Q'" in run("dump", path, "ATT", "MSG", "--fields", "Q")[2]


# info


def test_info_of_several_files(tmp_path: Path) -> None:
    one, other = small(tmp_path), small(tmp_path, "b.bin")
    broken = tmp_path / "c.bin"
    broken.write_bytes(b"nothing that is a log")
    code, text, told = run("info", one, broken, other, one)
    assert code == 2
    assert [line for line in text.splitlines() if line.endswith(".bin")] == [str(one), str(other)]
    assert "ATT            3      0.8    -  TimeUS Roll Pitch Yaw" in text
    assert "c.bin" in told
    code, text, _ = run("info", one, broken, "--json")
    document = json.loads(text)
    assert code == 2
    assert [log["file"] for log in document["logs"]] == [str(one)]
    assert len(document["refused"]) == 1
    fields = run("info", one, "--fields")[1]
    assert "ATT            3      0.8    -\n    TimeUS, Roll, Pitch, Yaw\n" in fields


# export


@pytest.mark.medium
def test_messages_become_csv_files(tmp_path: Path) -> None:
    path, out = small(tmp_path), tmp_path / "out"
    code, text, _ = run("export", path, "ATT", "MSG", "--out", out, "--from", "10.2")
    assert code == 0
    assert text == (
        f"{out}: 3 rows of 2 messages, a file each; time_s counts seconds since the autopilot started; the log has no "
        "UTC\n"
    )
    assert sorted(each.name for each in out.iterdir()) == ["ATT.csv", "MSG.csv", "columns.csv"]
    assert (out / "ATT.csv").read_text() == (
        "time_s,TimeUS,Roll,Pitch,Yaw\n11.000000,11000000,6.25,-1.5,90\n12.500000,12500000,-3,-1.5,90\n"
    )
    assert "already exists" in run("export", path, "ATT", "--out", out)[2]
    assert run("export", path, "ATT", "--out", out, "--overwrite")[0] == 0
    document = json.loads(run("export", path, "ATT", "--out", tmp_path / "o2", "--json")[1])
    assert (document["rows"], document["files"][0]) == (3, str(tmp_path / "o2" / "ATT.csv"))
    assert "has no row of NONE; `xitl logs info` lists" in run("export", path, "NONE", "--out", tmp_path / "o3")[2]


# compare


@pytest.mark.medium
def test_two_logs_side_by_side(tmp_path: Path) -> None:
    a, b = sailed(tmp_path, "a.bin", 10.0), sailed(tmp_path, "b.bin", 100.0, east_deg=4e-5)
    document = json.loads(run("compare", a, b, "--start", "armed", "--json")[1])
    assert (document["a"], document["b"]) == (str(a), str(b))
    assert document["time"]["method"] == "armed"
    assert document["time"]["zero_ns"] == 15_000_000_000
    assert document["time"]["sentence"] == "two runs, aligned where each first armed"
    assert set(document["sections"]) >= {"trajectory", "motion", "events"}
    page, paths = tmp_path / "c.html", tmp_path / "tum"
    code, text, _ = run("compare", a, b, "--shift", "0", "--report", page, "--tum", paths)
    assert code == 0
    assert "B begins 0 s after A, as asked" in text
    assert "0 s is 0.000 s after A's first row" in text
    assert "B is 3.04 m (RMS) from A at the same instant, at most 3.04 m" in text.replace("\n      ", " ")
    assert text.splitlines()[-1] == str(page)
    written = page.read_text(encoding="utf-8")
    assert "a.bin and b.bin" in written
    assert "DataFlash" in written
    lines = [(paths / name).read_text().splitlines() for name in ("a.tum", "b.tum")]
    assert [len(each) for each in lines] == [40, 40]
    first_a, first_b = ([float(number) for number in each[0].split()] for each in lines)
    assert first_b[1] - first_a[1] == pytest.approx(3.04, abs=0.01)
    assert run("compare", a, b, "--report", a)[0] == 2
    assert a.read_bytes().startswith(HEAD)


@pytest.mark.medium
def test_limits_and_refusals_of_a_comparison(tmp_path: Path) -> None:
    a, b = small(tmp_path), small(tmp_path, "b.bin")
    assert "no trajectories to write" in run("compare", a, b, "--shift", "0", "--tum", tmp_path / "t")[2]
    assert "does not show when it was armed" in run("compare", a, b, "--shift", "0", "--armed")[2]
    assert "nothing to compare" in run("compare", a, b, "--shift", "0", "--from", "2", "--until", "1")[2]
    code, text, _ = run("compare", a, a, "--json")
    assert (code, json.loads(text)["time"]["method"]) == (0, "same file")
