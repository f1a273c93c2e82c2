"""The directory of a run in place of its logs."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.recorded_run import recorded_run
from xitl_cli import api
from xitl_cli.logs.formats.run_directory import logs_in
from xitl_cli.main import main


def logs(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> str:
    """What `xitl logs` prints."""
    monkeypatch.setattr(sys, "argv", ["xitl", "logs", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    assert not ended.value.code, said.err
    return said.out


def test_what_is_in_a_directory(tmp_path: Path) -> None:
    assert list(logs_in(tmp_path)) == [tmp_path]
    names = ["run.mcap", "autopilot.bin", "one/autopilot.bin", "two/autopilot.bin", "autopilot/logs/00000001.BIN"]
    files = [tmp_path / name for name in names]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    assert list(logs_in(tmp_path)) == files[:4]
    assert list(logs_in(tmp_path, "two")) == [files[0], files[3]]
    assert list(logs_in(tmp_path / "one")) == [tmp_path / "one"]
    assert list(logs_in(files[1])) == [files[1]]


@pytest.mark.medium
def test_a_run_is_analysed_with_the_log_of_its_autopilot() -> None:
    run = recorded_run("sitl", 12.0)
    report = api.analyze(run, sections="overview")
    assert [file.path for file in report.files] == [run / "run.mcap", run / "autopilot.bin"]
    assert report.refusals == ()
    named = api.analyze(run / "run.mcap", run, run / "autopilot.bin", sections="overview")
    assert sorted(file.path for file in named.files) == sorted(file.path for file in report.files)


@pytest.mark.medium
def test_every_command_takes_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = recorded_run("sitl", 12.0)
    recording = run / "run.mcap"

    def said(*arguments: str | Path) -> str:
        return logs(capsys, monkeypatch, *arguments)

    told = json.loads(said("info", run, "--json"))
    assert [Path(log["file"]).name for log in told["logs"]] == ["run.mcap", "autopilot.bin"]
    assert len(json.loads(said("analyze", run, "--json", "--section", "vehicle"))["files"]) == 2
    words = ("/truth/state", "--limit", "5")
    assert said("dump", run, *words) == said("dump", recording, *words) != ""
    assert said("compare", run, run, "--json", "--shift", "0")
    said("plot", run, "ATT.Roll", "--out", tmp_path / "page.html")
    assert (tmp_path / "page.html").stat().st_size
    said("export", run, "/truth/state", "--out", tmp_path / "csv")
    assert list((tmp_path / "csv").iterdir())
    assert "is complete" in said("repair", run)


@pytest.mark.medium
def test_of_a_fleet_the_log_of_the_vessel_that_is_looked_at_is_taken() -> None:
    run = recorded_run("fleet-head-on", 2.0)
    first, second = api.open_log(run / "run.mcap").vessels[:2]
    for vessel, shown in (("", first), (second, second)):
        files = api.analyze(run, sections="overview", vessel=vessel).files
        assert [file.path for file in files] == [run / "run.mcap", run / shown / "autopilot.bin"]
        assert files[0].vessel == shown
