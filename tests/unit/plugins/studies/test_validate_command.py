"""`xitl validate` and `xitl vehicle check` with made results: their texts, documents, pages and exit codes."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from sim_core.environment.spec import Water
from xitl_cli.logs.model.sections import Fact, Section, Severity
from xitl_cli.main import main
from xitl_cli.plugins.studies import validate_command
from xitl_cli.plugins.studies.manoeuvres import validation, vessel_check
from xitl_cli.plugins.studies.manoeuvres.findings import VesselFinding
from xitl_cli.plugins.studies.manoeuvres.references import FigureReference, ReferenceKind, Source
from xitl_cli.plugins.studies.manoeuvres.validation import ValidatedFigure, Validation
from xitl_cli.plugins.studies.manoeuvres.vessel_check import Demands, VesselCheck
from xitl_cli.profile import load_profile

PAPER = Source(ReferenceKind.PUBLISHED, "a paper")
THEORY = validation.LINEAR


def figure(
    key: str, found: float | None, source: Source | None, disputed: str = "", unit: str = "s"
) -> ValidatedFigure:
    reference = None if source is None else FigureReference(2.0, 0.1, source, disputed)
    title = "Free decays" if source is THEORY else "Turns"
    return ValidatedFigure(title, key, f"the {key}", unit, found, reference)


GOOD = (figure("advance", 2.05, PAPER), figure("transfer", 3.0, PAPER, "another paper has 3"))
FIGURES = (*GOOD, figure("rate", None, None, unit=""), figure("period", 2.5, THEORY), figure("ratio", None, THEORY))
SECTIONS = (
    Section("turns", "Turns", tuple(Fact(one.key, one.label, one.value, one.unit) for one in FIGURES[:3])),
    Section("decays", "Free decays", (Fact("period", "the period", 2.5, "s"),), lacks=("the wind was too strong",)),
)


def command(monkeypatch: pytest.MonkeyPatch, *words: str | Path) -> int:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("sys.argv", ["xitl", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.fixture
def validated(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """In place of manoeuvres; returns what was asked for. A vessel named `otter` agrees with all."""
    asked: list[tuple[Any, ...]] = []

    def validate_vessel(model: Any, name: str, water: Any, autopilot: Any, tell: Any) -> Validation:
        tell("turns")
        asked.append((model, name, water, autopilot))
        if name == "heron":
            raise ValueError("sinks")
        return Validation(name, "rudder", SECTIONS, GOOD[:1] if name == "otter" else FIGURES)

    monkeypatch.setattr(validation, "validate_vessel", validate_vessel)
    return asked


def test_each_figure_has_a_line_with_its_reference(
    validated: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "validate", "asv-full") == 1
    ((model, name, water, autopilot),) = validated
    assert (model, name) == (load_profile("vehicles/asv-full").vehicle, "asv-full")
    assert (water, autopilot) == (None, load_profile("vehicles/asv-full").autopilot)
    told = capsys.readouterr().out
    assert told.splitlines()[0] == "asv-full, steered by rudder"
    rows = {line.split("  ")[1]: line.split() for line in told.splitlines() if line.startswith("  the ")}
    assert rows["the advance (s)"][3:] == ["2.05", "2", "+2.5", "%", "[1]"]
    assert rows["the transfer (s)"][3:] == ["3", "2", "+50.0", "%", "[1]", "disputed"]
    assert rows["the rate"][2:] == ["–", "no", "reference"]
    assert rows["the period (s)"][3:] == ["2.5", "2", "+25.0", "%", "[2]", "differs"]
    assert rows["the ratio (s)"][3:] == ["–", "2", "[2]", "differs"]
    text = " ".join(told.split())
    assert "1 agree with their reference, 2 differ, 1 have no reference, 1 have a disputed one" in text
    assert "the wind was too strong" in text
    assert "the transfer: a paper is disputed: another paper has 3" in text
    assert "It matters: the error is 5 times its tolerance" in text
    assert "1 published: a paper" in text
    assert f"2 closed form: {THEORY.text}" in text
    assert re.search(r"published +2 of 4 \(50 %\)", text)
    assert re.search(r"from outside xitl +2 of 4 \(50 %\)", text)
    titles = [line for line in told.splitlines() if line in ("Turns", "Free decays")]
    assert titles == ["Turns", "Free decays"]


def test_a_vessel_that_agrees_returns_0(
    validated: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "validate", "otter") == 0
    assert "1 agree with their reference, 0 differ, 0 have no reference\n" in capsys.readouterr().out


def test_figures_for_programs(
    validated: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "validate", "asv-full", "--json") == 1
    told = json.loads(capsys.readouterr().out)
    (vehicle,) = told["vehicles"]
    assert (vehicle["vehicle"], vehicle["steered_by"], told["surroundings"]) == ("asv-full", "rudder", [])
    assert told["references"] == {
        "measured": 0,
        "published": 2,
        "panel code": 0,
        "closed form": 2,
        "same equations": 0,
    }
    advance, transfer, rate, period, _ = vehicle["figures"]
    assert advance == {
        "manoeuvre": "Turns",
        "key": "advance",
        "label": "the advance",
        "unit": "s",
        "value": 2.05,
        "reference": 2.0,
        "allowed": 0.1,
        "error": pytest.approx(0.05),
        "agrees": True,
        "advice": None,
        "kind": "published",
        "source": "a paper",
        "disputed": None,
    }
    assert (transfer["agrees"], transfer["disputed"]) == (None, "another paper has 3")
    nothing = ("reference", "allowed", "error", "agrees", "advice", "kind", "source", "disputed")
    assert [rate[key] for key in nothing] == [None] * len(nothing)
    assert (period["agrees"], period["advice"].startswith("It matters")) == (False, True)


@pytest.mark.parametrize(
    "words", [("--report", "page.html"), ("--report", "--out", "page.html"), ("--out", "page.html")]
)
def test_the_page_is_written_where_it_is_asked_for(
    words: tuple[str, ...],
    validated: list[tuple[Any, ...]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(monkeypatch, "validate", "otter", *words) == 0
    assert "page with all plots: page.html" in capsys.readouterr().out
    assert "agree with their reference" in Path("page.html").read_text(encoding="utf-8")
    assert [asked[1] for asked in validated] == ["otter"]


def test_a_page_is_not_asked_for_and_not_written(
    validated: list[tuple[Any, ...]],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    opened: list[Path] = []
    monkeypatch.setattr(validate_command, "open_in_browser", opened.append)
    command(monkeypatch, "validate", "otter")
    assert list(tmp_path.iterdir()) == []
    assert "page" not in capsys.readouterr().out
    command(monkeypatch, "validate", "otter", "--open")
    assert opened == [Path("validation.html")]


def test_several_vessels_are_validated_by_as_many_processes(
    validated: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their results are in the order of the words; a single processor does them one after the other."""
    for processors, here in ((2, 0), (1, 2), (None, 4)):
        monkeypatch.setattr(validate_command, "os", SimpleNamespace(cpu_count=lambda processors=processors: processors))
        assert command(monkeypatch, "validate", "wamv16", "otter", "--json") == 1
        told = json.loads(capsys.readouterr().out)
        assert [vehicle["vehicle"] for vehicle in told["vehicles"]] == ["wamv16", "otter"]
        assert len(validated) == here  # the others were in other processes


def test_surroundings_are_added_when_they_are_named(
    validated: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    around = Validation("surroundings", "", (), (figure("gravity", 2.0, PAPER),))
    monkeypatch.setattr(validation, "validate_surroundings", lambda: around)
    assert command(monkeypatch, "validate", "surroundings", "otter", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert [vehicle["vehicle"] for vehicle in told["vehicles"]] == ["otter"]
    assert [one["key"] for one in told["surroundings"]] == ["gravity"]


def test_a_vessel_that_sinks_and_a_profile_without_one(
    validated: list[tuple[Any, ...]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "validate", "heron") == 2
    assert "heron: sinks" in capsys.readouterr().err
    assert command(monkeypatch, "validate", "calm") == 2
    assert "calm: has no vehicle" in capsys.readouterr().err
    assert len(validated) == 1


FINDINGS = (
    VesselFinding("mass.small", "vehicle.mass_kg", Severity.WARNING, "is small", "weigh it"),
    VesselFinding("odd", "vehicle.hull.length_m", Severity.NOTICE, "is odd", "measure it"),
)


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """In place of the check; a vessel named `otter` has no findings."""
    asked: list[Any] = []

    def check_vessel(model: Any, demands: Demands) -> VesselCheck:
        asked.append(demands)
        facts = (Fact("draft_m", "draft", 0.25, "m"), Fact("ratio", "ratio", None, ""))
        return VesselCheck(model.name, (("Afloat", facts), ("Empty", ())), () if model.name == "otter" else FINDINGS)

    monkeypatch.setattr(vessel_check, "check_vessel", check_vessel)
    return asked


def test_figures_and_suspicious_values_are_shown(
    checked: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "boat.yaml"
    file.write_text("extends: [sitl, vehicles/asv-full]\nmission: {speed_mps: 1.25}\nclock: {physics_rate_hz: 200}\n")
    assert command(monkeypatch, "vehicle", "check", file) == 0
    (demands,) = checked
    assert (demands.mission_speed_mps, demands.physics_rate_hz) == (1.25, 200.0)
    assert demands.environment.water == Water()
    told = capsys.readouterr().out
    lines = [line.split() for line in told.splitlines()]
    assert ["Afloat"] in lines
    assert ["Empty"] not in lines
    assert ["draft", "0.25", "m"] in lines
    assert ["ratio", "–"] in lines
    text = " ".join(told.split())
    assert re.search(r"warning vehicle\.mass_kg \(.*asv-full\.yaml:\d+\): is small → weigh it", text)
    assert re.search(r"notice vehicle\.hull\.length_m \(.*asv-full\.yaml:\d+\): is odd → measure it", text)


def test_a_vessel_alone_is_checked_without_demands(
    checked: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(monkeypatch, "vehicle", "check", "otter") == 0
    assert checked == [Demands()]
    assert capsys.readouterr().out.rstrip().endswith("No suspicious values.")


def test_several_vehicles_cannot_be_checked_together(
    checked: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(
        "extends: mitl\nvessels:\n  a: {extends: vehicles/otter, mission: {start: {north_m: 9.0}}}\n"
        "  b: {extends: vehicles/heron}\n"
    )
    assert command(monkeypatch, "vehicle", "check", file) == 2
    assert "has several vehicles (otter, heron); check one of them" in " ".join(capsys.readouterr().err.split())
    assert checked == []
