"""`xitl logs analyze` and `xitl logs plot` on real logs, good and bad."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import xitl_cli.logs.signals as signals
from tests.recorded import CALM, LOGS, MISSION_TLOG
from xitl_cli.errors import UserError
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Section
from xitl_cli.plugins.logs import analyze_command
from xitl_cli.plugins.logs.analyses import power

app = typer.Typer()
app.command("analyze")(analyze_command.analyze)
app.command("plot")(analyze_command.plot)


def run(*arguments: str | Path, width: int = 80) -> tuple[int, str]:
    """Exit code, or 2 with the sentence as `main` prints it, and what was printed."""
    told = CliRunner().invoke(app, [str(each) for each in arguments], env={"COLUMNS": str(width), "NO_COLOR": "1"})
    if isinstance(told.exception, (UserError, LogError)):
        return 2, told.output + f"error: {told.exception}"
    if told.exception is not None and not isinstance(told.exception, SystemExit):
        raise told.exception
    return told.exit_code, told.output


@pytest.mark.medium
@pytest.mark.parametrize("log", sorted(LOGS.glob("*.bin")), ids=lambda path: path.stem)
def test_no_analysis_fails_on_a_real_log(log: Path) -> None:
    code, text = run("analyze", log, "--json")
    told = json.loads(text)
    assert code == 0
    assert [file["failures"] for file in told["files"]] == [[]]
    assert told["files"][0]["sections"].keys() >= {"vehicle", "modes", "scheduler", "sensors"}


@pytest.mark.medium
def test_a_report_has_a_map_below_its_track(tmp_path: Path) -> None:
    with open_log(CALM) as log:
        position = signals.position_ned(log)
    assert position is not None
    assert position.origin is not None
    latitude, longitude, _ = position.origin
    chart = tmp_path / "chart.geojson"
    properties = {"name": "</script>pier", "marker-color": "#123456"}
    point = {"type": "Point", "coordinates": [longitude, latitude]}
    chart.write_text(json.dumps({"type": "Feature", "properties": properties, "geometry": point}), encoding="utf-8")
    page = tmp_path / "report.html"
    code, _ = run("analyze", CALM, "--report", page, "--map", chart, "--no-replay")
    assert code == 0
    written = page.read_text(encoding="utf-8")
    payload = next(
        json.loads(part.partition("</script>")[0])
        for part in written.split('<script type="application/json">')
        if part.startswith('{"kind":"track"')
    )
    (shape,) = payload["chart"]["shapes"]
    assert (shape["kind"], shape["name"], shape["marker"]) == ("point", "</script>pier", "#123456")
    assert shape["rings"] == [[[0.0, 0.0]]]
    assert run("analyze", CALM, "--map", chart) == (
        2, "error: --map draws below the track of a report; add --report FILE.html, without --section"
    )  # fmt: skip
    chart.write_text(json.dumps({"type": "Point", "coordinates": [0.0, 89.0]}), encoding="utf-8")
    code, text = run("analyze", CALM, "--report", page, "--map", chart)
    assert code == 2
    assert "km away from the track" in text


@pytest.mark.medium
def test_answers_come_first_and_the_page_holds_the_overview(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the extra for it the page says how to have the replay."""
    monkeypatch.setattr("xitl_cli.extras.find_spec", lambda package: None if package == "viser" else object())
    page = tmp_path / "report.html"
    code, text = run("analyze", CALM, "--report", page)
    assert code == 0
    assert text.startswith("boat-auto-calm.bin  rover, ArduRover V4.7.0-dev")
    assert max(map(len, text.splitlines())) <= max(80, len(str(page)) + 60)  # the last line names the page
    written = page.read_text(encoding="utf-8")
    for title in ("Track", "Speed over ground", "Yaw", "Outputs to motors and servos"):
        assert f"<h3>{title}</h3>" in written
    assert "needs viser, which is not installed" in written
    assert "&#x27;xitl[view]&#x27;" in written
    assert 'id="signals"' in written
    assert "at most " in written


def test_signals_of_several_messages_are_drawn_with_a_word_on_their_times(tmp_path: Path) -> None:
    page = tmp_path / "plot.html"
    code, text = run("plot", CALM, "hypot(XKF1.VN, XKF1.VE) - GPS.Spd", "ATT.Roll", "--out", page)
    assert (code, text.splitlines()) == (
        0,
        [str(page), "hypot(XKF1.VN, XKF1.VE) - GPS.Spd: at the times of XKF1[0], with GPS resampled"],
    )
    assert "<h3>hypot(XKF1.VN, XKF1.VE) - GPS.Spd</h3>" in page.read_text(encoding="utf-8")


@pytest.mark.medium
def test_with_a_page_the_findings_and_its_name_are_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is not for the eye of a first look is on the page; `:x:` in a name is no picture."""
    monkeypatch.chdir(tmp_path)
    Path("a:x:.bin").symlink_to(CALM)
    some = ("a:x:.bin", "--section", "vehicle", "--section", "modes", "--section", "power", "--no-replay")
    code, text = run("analyze", *some, "--report", "b:x:.html", width=60)
    assert code == 0
    assert text.startswith("a:x:.bin  rover")
    assert text.splitlines()[-1].startswith("b:x:.html: all sections")
    assert "NOTICE" in text
    assert len(text.splitlines()) < 30
    assert "In AUTO" not in text
    assert max(map(len, text.splitlines()[:-1])) <= 60
    _, every = run("analyze", *some, "--report", "b:x:.html", "--verbose", width=60)
    _, without = run("analyze", *some, width=60)
    assert every.startswith(text.rpartition("\nb:x:.html")[0])
    assert "In AUTO" in every
    assert without == every.rpartition("\nb:x:.html")[0]
    assert "…" not in without.replace("SIM_…", "")


def test_one_section_only() -> None:
    told = json.loads(run("analyze", CALM, "--section", "scheduler", "--json")[1])
    assert list(told["files"][0]["sections"]) == ["scheduler"]
    code, text = run("analyze", CALM, "--section", "schedular")
    assert code == 2
    assert "there is no section 'schedular'; did you mean 'scheduler'? choose from overview, vehicle" in text


def test_a_bad_file_has_its_sentence_and_the_others_are_analysed(tmp_path: Path) -> None:
    empty = tmp_path / "empty.bin"
    empty.write_bytes(b"")
    code, text = run("analyze", empty, CALM, "--section", "vehicle")
    assert code == 2
    assert "ArduRover V4.7.0-dev" in text
    assert f"error: {empty}: " in text


def test_an_analysis_that_breaks_is_told_and_the_others_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(log: Log) -> Section | None:
        raise ZeroDivisionError("no rows")

    monkeypatch.setattr(power, "analyse", broken)
    code, text = run("analyze", CALM, "--section", "power", "--section", "modes")
    assert code == 1
    assert "the analysis of power failed at" in text
    assert "ZeroDivisionError: no rows" in " ".join(text.split())
    assert "In AUTO" in text


def test_signals_are_drawn_by_unit(tmp_path: Path) -> None:
    page = tmp_path / "plot.html"
    code, text = run("plot", CALM, "ATT.Roll", "att.pitch", "IMU[1].AccX", "GPS.Spd", "--out", page, "--from", "1:00")
    assert (code, text.strip()) == (0, str(page))
    written = page.read_text(encoding="utf-8")
    for title in ("ATT.Roll, ATT.Pitch", "IMU[1].AccX", "GPS.Spd"):
        assert f"<h3>{title}</h3>" in written


@pytest.mark.medium
def test_all_fields_of_a_message_but_its_time_are_drawn(tmp_path: Path) -> None:
    """Pulses are in microseconds too; so is the time of a row."""
    page = tmp_path / "plot.html"
    for log, signal, named in ((CALM, "RCOU", "RCOU.C1"), (MISSION_TLOG, "SERVO_OUTPUT_RAW", "servo1_raw")):
        code, text = run("plot", log, signal, "--out", page)
        assert (code, text.strip()) == (0, str(page))
        written = page.read_text(encoding="utf-8")
        assert named in written
        assert not any(time in written for time in ("TimeUS", "time_usec"))
    assert run("plot", MISSION_TLOG, "SYSTEM_TIME", "--out", page)[0] == 0  # which has no other
    assert run("plot", CALM, "IMU[0].AccX", "ATT[0].Roll", "--out", page)[0] == 0


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("nowhere.bin", "ATT.Roll"), "nowhere.bin: does not exist; write a log first"),
        ((CALM,), "no signal to draw; add some after the file"),
        ((CALM, "ATTT.Roll"), "has no message 'ATTT'; did you mean 'ATT'?"),
        ((CALM, "ATT.Rol"), "ATT has no field 'Rol'; did you mean 'Roll'?"),
        ((CALM, "IMU[9].AccX"), "IMU has no instance 9; choose from IMU[0], IMU[1]"),
        ((CALM, "ATT[1].Roll"), "ATT has no instances; write ATT.FIELD"),
        ((CALM, "MSG.Message"), "MSG.Message is text, which cannot be plotted"),
        ((CALM, "ATT.DesYaw - ATT.Yew"), "ATT has no field 'Yew'; did you mean 'Yaw'? it has TimeUS, DesRoll, Roll"),
        ((CALM, "hypot(ATT.Roll"), "'hypot(ATT.Roll' is not a valid expression (it is incomplete)"),
        ((CALM, "RCOU / 2"), "RCOU stands for 14 signals; choose one, such as RCOU.C1"),
        ((CALM, "ATT.Roll[3]"), "ATT.Roll is a single number; write it without [3]"),
        ((CALM, "ATT.Roll", "--from", "soon"), "'soon' is not a time; write seconds (90.5)"),
        ((CALM, "ATT.Roll", "--from", "90", "--until", "1:00"), "--until 1:00 is not after --from 90; swap them"),
        ((CALM, "ATT.Roll", "--from", "9000"), "ATT.Roll has no value between --from and --until"),
        ((CALM, "ATT.Roll", "--out", "/nowhere/at/all.html"), "cannot be written"),
    ],
)
def test_what_cannot_be_drawn_is_said(
    arguments: tuple[str | Path, ...], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, text = run("plot", *arguments)
    assert code == 2
    assert sentence in text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.medium
@pytest.mark.parametrize(("suffix", "beginning"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF-")])
def test_a_plot_is_written_in_the_format_of_its_suffix(suffix: str, beginning: bytes, tmp_path: Path) -> None:
    image = tmp_path / f"plot{suffix}"
    for _ in range(2):  # the second replaces the first
        code, text = run("plot", CALM, "ATT.Roll", "GPS.Spd", "RCOU.C1", "--out", image)
        assert (code, text.strip()) == (0, str(image))
        assert image.read_bytes().startswith(beginning)
    if suffix == ".svg":
        assert "GPS.Spd" in image.read_text(encoding="utf-8")


def test_a_suffix_of_no_plot_is_refused(tmp_path: Path) -> None:
    code, text = run("plot", CALM, "ATT.Roll", "--out", tmp_path / "plot.gif")
    assert code == 2
    assert "cannot plot to .gif; name a file that ends in .html, .png, .svg or .pdf" in " ".join(text.split())
    assert list(tmp_path.iterdir()) == []


def test_an_image_replaces_no_log(tmp_path: Path) -> None:
    log = tmp_path / "log.png"
    log.write_bytes(CALM.read_bytes()[:1000])
    code, text = run("plot", CALM, "ATT.Roll", "--out", log)
    assert code == 2
    assert "exists and is not a .png image" in " ".join(text.split())
    assert log.read_bytes() == CALM.read_bytes()[:1000]
