"""Drivers of other packages: a name of `driver.kind`, keys below `plugins`, and failures that name the package."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.installed_packages import Install
from xitl_cli.logs import open_log
from xitl_cli.profile import ProfileError, load_profile
from xitl_cli.run import session
from xitl_cli.run.nodes.display import NoDisplay

SPRINT = '''
from dataclasses import dataclass, replace
from sim_core.keys import Positive, Specification
from xitl_cli.plugin import DriverKind
from xitl_cli.run.core.reports import Progress
from xitl_cli.run.nodes.drivers import ArmingSequence, VehicleDriver

@dataclass(frozen=True, slots=True, kw_only=True)
class SprintKeys(Specification):
    """A sprint to the north."""
    distance_m: Positive = 40.0

class Sprint(VehicleDriver):
    def __init__(self, context):
        self.commands, self.keys = context.commands, context.keys
        self.arming = ArmingSequence(context.commands, "GUIDED")
        self.arrived = self.closed = False
    def update(self, sim_ns):
        if self.arming.update(sim_ns):
            self.commands.sail(sim_ns, (1.5, 0.0))
            FAILURE
    def progress(self):
        return Progress("", finished=self.arrived, completed=self.arrived)
    def report(self):
        return {"sprint": {"distance_m": self.keys.distance_m, "closed": self.closed}}
    def close(self):
        self.closed = True

KIND = DriverKind(Sprint, SprintKeys)
BARE = DriverKind(Sprint)
'''
PROFILE = "extends: sitl\ndriver: {kind: sprint}\n"


@pytest.fixture
def boat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("boat.yaml").write_text(PROFILE, encoding="utf-8")
    return Path("boat.yaml")


def run(*overrides: str) -> session.Result:
    return session.run(load_profile("boat.yaml", list(overrides)), Path("run"), True, NoDisplay, timed=True)


@pytest.mark.slow
def test_a_driver_of_a_package_steers_the_vessel_and_reads_its_keys(install: Install, boat: Path) -> None:
    install("xitl-sprint", SPRINT.replace("FAILURE", "pass"), drivers="sprint = xitl_sprint:KIND")
    result = run("clock.duration_s=25.0", "plugins.sprint.distance_m=30.0")
    assert result.summary["driver"]["kind"] == "sprint"
    assert result.summary["sprint"] == {"distance_m": 30.0, "closed": True}
    with result.open_log() as log:
        north_m = log.tables["/truth/state"].values("position_ned_m")[-1][0]
    assert north_m > 15.0, "1.5 m/s to the north for most of 25 s"


@pytest.mark.medium
def test_without_its_group_the_keys_have_their_defaults(install: Install, boat: Path) -> None:
    install("xitl-sprint", SPRINT.replace("FAILURE", "pass"), drivers="sprint = xitl_sprint:KIND")
    assert run("clock.duration_s=1.0").summary["sprint"] == {"distance_m": 40.0, "closed": True}


@pytest.mark.medium
def test_a_driver_that_raises_ends_the_run_with_its_name_and_the_traceback(install: Install, boat: Path) -> None:
    install("xitl-sprint", SPRINT.replace("FAILURE", "1 / 0"), drivers="sprint = xitl_sprint:KIND")
    result = run("clock.duration_s=25.0")
    assert result.exit_code == session.USER_ERROR
    assert "driver.kind sprint (xitl-sprint 1.2) failed at " in result.summary["error"]
    assert "ZeroDivisionError" in result.summary["error"]
    with open_log(Path("run/run.mcap")) as log:
        assert any("Traceback" in text for text in log.tables["/log"].values("message"))


def test_a_driver_needs_an_autopilot_and_a_package(install: Install, boat: Path) -> None:
    with pytest.raises(ProfileError, match=r"driver\.kind = 'sprint' is not one of the choices"):
        load_profile("boat.yaml")
    install("xitl-sprint", SPRINT.replace("FAILURE", "pass"), drivers="sprint = xitl_sprint:KIND")
    with pytest.raises(ProfileError, match=r"driver\.kind = sprint commands an autopilot; use autopilot\.kind: emb"):
        load_profile("boat.yaml", ["autopilot.kind=none", "technique=mitl"])


def test_a_driver_without_keys_takes_no_group(install: Install, boat: Path) -> None:
    install("xitl-sprint", SPRINT.replace("FAILURE", "pass"), drivers="sprint = xitl_sprint:BARE")
    with pytest.raises(ProfileError, match=r"plugins\.sprint: the driver of xitl-sprint 1\.2 has no keys"):
        load_profile("boat.yaml", ["plugins.sprint.distance_m=30.0"])


@pytest.mark.slow
def test_the_driver_of_the_guide_goes_north(install: Install, boat: Path) -> None:
    guide = (Path(__file__).parents[4] / "docs/plugins.md").read_text(encoding="utf-8")
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", guide, re.DOTALL) if "VehicleDriver" in block)
    install("xitl-sprint", code, drivers="sprint = xitl_sprint:KIND")
    with run("clock.duration_s=25.0").open_log() as log:
        assert log.tables["/truth/state"].values("position_ned_m")[-1][0] > 15.0
