"""Section 4.3: what stands for the hardware, and time bases whose rate and jitter are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from xitl_cli.errors import UserError
from xitl_cli.experiment.setup import ExperimentSetup
from xitl_cli.plugins.studies.experiments.section_4_3_sitl_hitl import (
    HITL,
    SITL,
    TimeBaseFit,
    find_hardware,
    loop_profile,
)
from xitl_cli.profile import load_profile


@pytest.fixture(autouse=True)
def _no_ardupilot(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "cache"))


def loaded(tmp_path: Path, setup: ExperimentSetup, maps: bool) -> dict[str, object]:
    hardware = find_hardware(setup)
    found = {}
    for name, extends, keys in ((SITL, hardware.software, hardware.firmware), (HITL, hardware.extends, hardware.keys)):
        path = tmp_path / f"{name}.yaml"
        path.write_text(loop_profile(name, extends, keys, maps))
        found[name] = load_profile(str(path))
    return found


def test_without_a_board_and_without_ardupilot_a_process_stands_in(tmp_path: Path) -> None:
    setup = ExperimentSetup(tmp_path)
    profiles = loaded(tmp_path, setup, maps=True)
    assert (profiles[SITL].autopilot.runs, profiles[SITL].clock.mode) == ("in-process", "lockstep")
    assert (profiles[HITL].autopilot.runs, profiles[HITL].clock.mode) == ("process", "realtime")
    assert profiles[SITL].mission == profiles[HITL].mission
    assert profiles[HITL].companion.link == "udp://127.0.0.1:0"
    assert "xitl firmware get rover" in find_hardware(setup).said


def test_a_board_takes_its_place(tmp_path: Path) -> None:
    setup = ExperimentSetup(tmp_path, board="udp://192.168.7.2:14660")
    hardware = loaded(tmp_path, setup, maps=False)[HITL]
    assert (hardware.autopilot.runs, hardware.autopilot.link) == ("board", "udp://192.168.7.2:14660")
    assert hardware.companion is None


def test_ardupilot_is_taken_for_both_where_it_is_found(tmp_path: Path) -> None:
    program = tmp_path / "ardurover"
    program.write_bytes(Path("/bin/true").read_bytes())
    program.chmod(0o755)
    profiles = loaded(tmp_path, ExperimentSetup(tmp_path, firmware=str(program)), maps=True)
    assert {profile.autopilot.kind for profile in profiles.values()} == {"ardupilot"}
    assert {profile.autopilot.firmware for profile in profiles.values()} == {str(program)}
    assert (profiles[SITL].clock.mode, profiles[HITL].clock.mode) == ("lockstep", "realtime")
    with pytest.raises(UserError, match="nowhere"):
        find_hardware(ExperimentSetup(tmp_path, firmware="/nowhere/ardurover"))


def test_a_time_base_against_its_sample_numbers() -> None:
    numbers = np.arange(5000)
    even = TimeBaseFit.of_stamps("autopilot", 1_700_000_000_000_000_000 + 20_000_000 * numbers)
    assert even is not None
    assert even.rate_hz == pytest.approx(50.0, rel=1e-12)
    assert even.rms_s < 1e-9
    swinging = np.rint(2e7 * numbers + 3e6 * np.sin(2.0 * np.pi * numbers / 100.0)).astype(np.int64)
    found = TimeBaseFit.of_stamps("high level", swinging)
    assert found is not None
    assert found.rms_s == pytest.approx(3e-3 / np.sqrt(2.0), rel=1e-3)  # RMS of a sine
    assert TimeBaseFit.of_stamps("short", np.array([0, 1])) is None
