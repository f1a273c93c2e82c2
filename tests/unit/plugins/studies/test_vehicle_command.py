"""`xitl vehicle check`: figures for programs, and what cannot be checked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from xitl_cli.main import main


def vehicle_check(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["xitl", "vehicle", "check", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.mark.medium
def test_a_file_of_ones_own_for_programs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "boat.yaml"
    file.write_text("extends: vehicles/asv-third\nvehicle:\n  damping_linear: {roll: 0.01}\n")
    assert vehicle_check(monkeypatch, str(file), "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["vehicle"] == "asv-third"
    assert told["figures"]["draft_m"] == pytest.approx(0.1 / 3, rel=0.02)
    assert 2 < told["figures"]["top_speed_mps"] < 3
    (roll,) = [finding for finding in told["findings"] if finding["rule"] == "damping.roll"]
    assert roll["key"] == "vehicle.damping_linear.roll"
    assert roll["where"].endswith("boat.yaml:3")
    assert roll["severity"] == "warning"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("calm", ("calm.yaml", "has no vehicle")),
        ("asv-ful", ("asv-ful", "asv-full")),
    ],
)
def test_what_cannot_be_checked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, words: tuple[str, ...]
) -> None:
    assert vehicle_check(monkeypatch, name) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: ")
    assert all(word in told for word in words), told


def test_a_vessel_that_sinks(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert vehicle_check(monkeypatch, "asv-full", "--set", "vehicle.mass_kg=900") == 2
    assert "vehicle.mass_kg = 900 sinks" in capsys.readouterr().err
