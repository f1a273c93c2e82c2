"""`xitl validate`: all of it for the full-size catamaran, and what tells a vessel that does not do as published."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from conftest import Xitl


@pytest.mark.slow
def test_the_catamaran_agrees_with_every_reference(xitl: Xitl, tmp_path: Path) -> None:
    told = xitl("validate", "asv-full", "--report", "--json")
    assert told.returncode == 0, told.stdout + told.stderr
    (vehicle,) = json.loads(told.stdout)["vehicles"]
    figures = {figure["key"]: figure for figure in vehicle["figures"]}
    assert {figure["manoeuvre"] for figure in vehicle["figures"]} >= {
        "Acceleration",
        "Turning circle at full steering",
        "Zig-zag",
        "Spiral",
        "Crash stop and coasting",
        "Free decays",
        "Response to waves",
    }
    assert sum(figure["agrees"] is True for figure in figures.values()) > 40
    assert not any(figure["agrees"] is False for figure in figures.values())
    assert figures["zig_zag_20_overshoot_1_deg"]["value"] > figures["zig_zag_10_overshoot_1_deg"]["value"] > 0
    assert figures["turn_starboard_tactical_diameter_m"]["value"] > figures["turn_starboard_transfer_m"]["value"] > 0
    page = (tmp_path / "validation.html").read_text(encoding="utf-8")
    assert "Turning circles" in page
    assert "no reference" in page
    assert "same equations" in page


@pytest.mark.slow
def test_a_vessel_that_is_not_the_published_one(xitl: Xitl, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(
        "extends: vehicles/wamv16\nvehicle: {name: wamv16, centre_of_gravity_frd_m: [0.8, 0.0, -0.044341]}\n"
    )
    told = xitl("validate", "mine.yaml")
    assert told.returncode == 1, told.stdout + told.stderr
    row, advice = [line for line in told.stdout.splitlines() if "rate of turn, 500 and 300 N" in line]
    assert row.endswith("differs")
    assert not advice.endswith("differs")


def test_what_cannot_be_validated(xitl: Xitl) -> None:
    told = xitl("validate", "calm")
    assert told.returncode == 2
    assert "calm: has no vehicle" in told.stderr


def test_the_surroundings_alone(xitl: Xitl) -> None:
    told = xitl("validate", "surroundings")
    assert told.returncode == 0, told.stdout + told.stderr
    assert "Magnetic field: WMM2025" in told.stdout
    assert "from outside xitl" in told.stdout


@pytest.mark.slow
def test_published_vessels_do_as_published(xitl: Xitl) -> None:
    """Within 3 % in surge, sway and rate of turn, 3 degrees of heading: what the runs allow."""
    told = xitl("validate", "otter", "wamv16", "--json", timeout_s=240.0)
    assert told.returncode == 0, told.stdout + told.stderr
    vehicles = json.loads(told.stdout)["vehicles"]
    assert [vehicle["vehicle"] for vehicle in vehicles] == ["otter", "wamv16"]
    for vehicle in vehicles:
        runs = [figure for figure in vehicle["figures"] if figure["manoeuvre"] == "Published runs"]
        assert len(runs) >= 12
        assert {figure["kind"] for figure in runs} == {"published"}
        for figure in runs:
            most = 3.0 if figure["unit"] == "deg" else max(0.03 * abs(figure["reference"]), 0.05)
            assert abs(figure["value"] - figure["reference"]) <= most, figure


@pytest.mark.nightly
@pytest.mark.slow
def test_the_documentation_states_the_shares(xitl: Xitl) -> None:
    told = xitl("validate", "--json", timeout_s=240.0)
    assert told.returncode == 0, told.stdout + told.stderr
    counts = json.loads(told.stdout)["references"]
    page = (Path(__file__).parents[2] / "docs/validation.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([a-z ]+) \| .* \| (.+) \|$", page, re.MULTILINE))
    total = sum(counts.values())
    for kind, count in counts.items():
        assert rows[kind] == (f"{count}, {100 * count / total:.0f} %" if count else "none yet")
    outside = sum(counts[kind] for kind in ("measured", "published", "panel code"))
    assert f"{outside} comparisons, {100 * outside / total:.0f} %" in page
