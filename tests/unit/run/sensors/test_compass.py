"""The heading error of an uncalibrated compass, against the magnetometer turned once round."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import xitl
from sim_core.kinematics import Kinematics
from sim_core.sensors.magnetometer import Magnetometer, local_field_ned_gauss
from sim_core.sensors.spec import MagnetometerSpec
from tests.golden import Golden
from xitl_cli.commands.init import init
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.profile import RunProfile
from xitl_cli.run.sensors.compass import compass_warnings, uncalibrated_heading_deg

IRON_GAUSS = (0.004, -0.003, 0.002)
NORTH = ["site.latitude_deg=69.65", "site.longitude_deg=18.96", "site.name=tromso"]


def turned_once_round(field_ned_gauss: tuple[float, float, float], iron_frd_gauss: tuple[float, float, float]) -> float:
    """The largest heading error in degrees of a level vessel at 3600 headings."""
    yaw = np.linspace(-np.pi, np.pi, 3600, endpoint=False)
    rotation = np.zeros((len(yaw), 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(yaw)
    rotation[:, 1, 0], rotation[:, 0, 1], rotation[:, 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    sensor = Magnetometer(MagnetometerSpec(hard_iron_frd_gauss=iron_frd_gauss), field_ned_gauss)
    still = np.zeros((len(yaw), 3))
    rng = np.random.default_rng(0)
    truth = Kinematics(still, still, still, np.zeros((len(yaw), 4)), rotation, still, still)
    measured = sensor.measure(sensor.initial(len(yaw), rng), truth, rng)[1].field_frd_gauss
    declination = np.arctan2(field_ned_gauss[1], field_ned_gauss[0])
    heading = declination - np.arctan2(measured[:, 1], measured[:, 0])
    return float(np.degrees(np.abs(np.angle(np.exp(1j * (heading - yaw))))).max())


@pytest.mark.parametrize("latitude_deg", [-2.7, 52.4, 60.4, 78.2])
def test_the_largest_error_is_that_of_a_vessel_turned_once_round(latitude_deg: float) -> None:
    field = local_field_ned_gauss(latitude_deg, 10.0, 0.0, 2026.0).ned_gauss
    expected = turned_once_round(field, IRON_GAUSS)
    assert uncalibrated_heading_deg(IRON_GAUSS, field) == pytest.approx(expected, abs=1e-3)


def test_iron_above_the_field_turns_the_heading_by_any_angle() -> None:
    assert uncalibrated_heading_deg((0.2, 0.0, 0.0), (0.1, 0.0, 0.5)) == 180.0


def runs(*overrides: str) -> tuple[RunProfile, ...]:
    return load_profile("sitl", overrides).run_profiles()


def test_a_weak_field_is_named_with_the_offsets_that_calibrate_it(golden: Golden) -> None:
    assert compass_warnings(runs()) == []
    (text,) = compass_warnings(runs(*NORTH))
    golden("text", text, "5.0 mG")
    assert "COMPASS_OFS_X=-4, COMPASS_OFS_Y=3, COMPASS_OFS_Z=-2" in text
    offsets = [f"autopilot.parameters.COMPASS_OFS_{axis}={value}" for axis, value in (("X", -4), ("Y", 3), ("Z", -2))]
    assert compass_warnings(runs(*NORTH, *offsets)) == []
    assert compass_warnings(runs(*NORTH, "sensors.magnetometer.hard_iron_frd_gauss=[0, 0, 0]")) == []


def test_vessels_of_a_fleet_are_named() -> None:
    (run,) = runs(*NORTH)
    (text,) = compass_warnings([replace(run, vessel="leader"), replace(run, vessel="follower")])
    assert text.startswith("leader, follower: the compass is uncalibrated")


def test_a_boat_of_ones_own_has_a_calibrated_compass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    init(Path("my-boat"))
    (run,) = load_profile("my-boat").run_profiles()
    assert compass_warnings([run]) == []
    (turned,) = load_profile("my-boat", [f"sensors.magnetometer.hard_iron_frd_gauss={list(IRON_GAUSS)}"]).run_profiles()
    assert len(compass_warnings([turned])) == 1


@pytest.mark.slow
def test_the_summary_names_it(tmp_path: Path) -> None:
    found = xitl.simulate("sitl", overrides=NORTH, duration_s=0.1, out=tmp_path / "run")
    assert any(text.startswith("the compass is uncalibrated") for text in found.summary["warnings"])
