"""Actuators of other packages: keys below `vehicle.actuators`, forces on the vessel, and failures with their name."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from sim_core.environment.environment import Environment
from sim_core.environment.spec import EnvironmentSpec
from sim_core.fleet import Fleet
from sim_core.fleet import initial as fleet_initial
from sim_core.fleet import step as fleet_step
from tests.installed_packages import Install
from xitl_cli.logs import open_log
from xitl_cli.profile import ProfileError, load_profile
from xitl_cli.run import session
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.world.world import build_simulation
from xitl_cli.seeds import Seeds

GUIDE = (Path(__file__).parents[4] / "docs/plugins.md").read_text(encoding="utf-8")
(SAIL,) = (block for block in re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL) if "ActuatorSpec" in block)
(PROFILE,) = (block for block in re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL) if "main-sail" in block)
ENTRY = "sail = xitl_sail:SailKeys"


@pytest.fixture
def boat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("boat.yaml").write_text(PROFILE, encoding="utf-8")
    return Path("boat.yaml")


def run(*overrides: str, path: str = "boat.yaml") -> session.Result:
    return session.run(load_profile(path, list(overrides)), Path("run"), True, NoDisplay, timed=True)


@pytest.mark.slow
def test_the_sail_of_the_guide_moves_the_vessel_and_is_recorded(install: Install, boat: Path) -> None:
    install("xitl-sail", SAIL, actuators=ENTRY)
    wind = ("environment.wind.mean_mps=8", "environment.wind.direction_deg=180", "mission.start.heading_deg=0")
    with run("clock.duration_s=6", *wind).open_log() as log:
        state = log.tables["/truth/state"]
        without_n = state.values("position_ned_m")[-1][0]
        assert log.tables["/actuators"].values("command")[-1].tolist() == [0.0, 0.0, 1.0]
    boat.write_text(PROFILE.replace("[0, 0, 1]", "[0, 0, 0]"), encoding="utf-8")
    with run("clock.duration_s=6", *wind).open_log() as log:
        edge_on_n = log.tables["/truth/state"].values("position_ned_m")[-1][0]
    assert without_n > edge_on_n + 1.0, "the wind from astern pushes a sail across the boat, and not one along it"


@pytest.mark.medium
def test_the_force_of_the_sail_is_that_of_its_formula(install: Install, boat: Path) -> None:
    install("xitl-sail", SAIL, actuators=ENTRY)
    profile = load_profile("boat.yaml").runnable()
    simulation, _ = build_simulation(profile, Seeds(1))
    propulsion = simulation.vessel.propulsion
    state = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    still, astern = np.zeros((2, 6)), np.array([[-8.0, 0.0, 0.0]] * 2)  # air overtakes the boat by 8 m/s
    terms = np.concatenate(propulsion.terms(state, still, astern), axis=1)
    force = terms @ propulsion.wrench
    ahead_n = 0.5 * 1.225 * 1.2 * 12 * 8.0**2
    np.testing.assert_allclose(force[0], [ahead_n, 0, 0, 0, -1.5 * ahead_n, 0], atol=1e-9)
    np.testing.assert_allclose(force[1], np.zeros(6), atol=1e-9)
    later = propulsion.spin(np.zeros((1, 3)), np.array([[0.0, 0.0, 2.0]]))
    assert later[0, 2] == pytest.approx(30.0 / 90.0 / profile.clock.physics_rate_hz)


@pytest.mark.medium
def test_a_fleet_steps_each_vessel_as_alone(install: Install, boat: Path) -> None:
    install("xitl-sail", SAIL, actuators=ENTRY)
    model = load_profile("boat.yaml").runnable().vehicle
    environment = Environment.from_spec(EnvironmentSpec(), np.random.default_rng(1))
    places, headings = np.array([[0.0, 0.0], [60.0, 0.0]]), np.array([0.0, 1.0])

    def end(fleet: Fleet, places: np.ndarray, headings: np.ndarray, commands: list[list[float]]) -> np.ndarray:
        rng = np.random.default_rng(1)
        state = fleet_initial(fleet, places, headings, rng)
        for _ in range(400):
            state = fleet_step(fleet, state, fleet.by_model(commands), rng)
        return np.concatenate([one.vessel.rotor_speed for one in state.batches])

    both = Fleet.from_spec([model, model], environment, 1 / 400, names=["a", "b"])
    alone = Fleet.from_spec([model], environment, 1 / 400, names=["a"])
    together = end(both, places, headings, [[0.2, 0.2, 1.0], [0.1, 0.3, -0.5]])
    np.testing.assert_array_equal(together[:1], end(alone, places[:1], headings[:1], [[0.2, 0.2, 1.0]]))
    assert together[1, 2] == pytest.approx(-1 / 3)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("spun", "why"),
    [
        ("1 / 0", "it failed (ZeroDivisionError: division by zero, xitl_sail.py:"),
        ("np.zeros(3)", "its spin returned (3,) and must return (1, 1)"),
    ],
)
def test_an_actuator_that_raises_ends_the_run_with_its_name_and_the_traceback(
    install: Install, boat: Path, spun: str, why: str
) -> None:
    code = SAIL.replace("state + np.clip(command - state, -self.most, self.most)", spun)
    install("xitl-sail", code, actuators=ENTRY)
    result = run("clock.duration_s=2")
    assert result.exit_code == session.USER_ERROR
    assert f"vehicle.actuators.main-sail: {why}" in result.summary["error"]
    assert "(xitl-sail 1.2); correct the plug-in" in result.summary["error"]
    with open_log(Path("run/run.mcap")) as log:
        assert any("Traceback" in text for text in log.tables["/log"].values("message"))


@pytest.mark.parametrize("code", ["return 1 / 0", "return np.full((len(state), 6), np.nan)", "return np.zeros(6)"])
def test_a_force_that_is_none_is_refused_before_the_run(install: Install, boat: Path, code: str) -> None:
    first = "        angle_rad = state[:, 0]"
    install("xitl-sail", SAIL.replace(first, f"        {code}\n{first}"), actuators=ENTRY)
    with pytest.raises(ProfileError, match=r"boat\.yaml:\d: vehicle\.actuators\.main-sail: it"):
        load_profile("boat.yaml")


@pytest.mark.parametrize(
    ("code", "entry", "sentence"),
    [
        ("import no_such_module", ENTRY, "cannot be loaded (ModuleNotFoundError"),
        (SAIL + "XITL_INTERFACE = 2\n", ENTRY, "is made for interface 2"),
        (SAIL, "sail = xitl_sail:Sail", "registers Sail in xitl.actuators, which is not a dataclass that derives from"),
        (SAIL, "sail = xitl_sail:OTHER", "has no attribute 'OTHER'"),
    ],
)
def test_a_broken_actuator_is_one_sentence_of_the_profile(
    install: Install, boat: Path, code: str, entry: str, sentence: str
) -> None:
    install("xitl-sail", code, actuators=entry)
    with pytest.raises(ProfileError, match=rf"boat\.yaml:4: vehicle\.actuators\.main-sail: .*{re.escape(sentence)}"):
        load_profile("boat.yaml")
    assert load_profile("mitl").name == "mitl"


def test_keys_are_checked_with_file_and_line(install: Install, boat: Path) -> None:
    with pytest.raises(
        ProfileError, match=r"boat\.yaml:4: vehicle\.actuators\.main-sail: sail: no installed package reg"
    ):
        load_profile("boat.yaml")
    install("xitl-sail", SAIL, actuators=ENTRY)
    boat.write_text(PROFILE.replace("area_m2: 12", "area_m2: -1"), encoding="utf-8")
    with pytest.raises(ProfileError, match=r"boat\.yaml:4: vehicle\.actuators\.main-sail\.area_m2 = -1 is too small"):
        load_profile("boat.yaml")
    boat.write_text(PROFILE.replace("area_m2: 12", "area: 12"), encoding="utf-8")
    with pytest.raises(ProfileError, match=r"main-sail\.area is not a known key; did you mean 'area_m2'"):
        load_profile("boat.yaml")
    boat.write_text(PROFILE.replace("[0, 0, 1]", "[0, 0]"), encoding="utf-8")
    with pytest.raises(ProfileError, match=r"does not fit a vessel with 2 propellers, 1 added command; use 3"):
        load_profile("boat.yaml")


def test_a_name_of_a_command_is_there_once(install: Install, boat: Path) -> None:
    install("xitl-sail", SAIL, actuators=ENTRY)
    boat.write_text(PROFILE.replace("main-sail", "propeller 0"), encoding="utf-8")
    with pytest.raises(ProfileError, match=r"has a command 'propeller 0', which is there twice; rename it"):
        load_profile("boat.yaml")


def test_faults_on_an_added_actuator_are_refused(install: Install, boat: Path) -> None:
    install("xitl-sail", SAIL, actuators=ENTRY)
    fault = "faults: {stuck: {from_s: 1, propeller: {which: main-sail, stuck: true}}}\n"
    boat.write_text(PROFILE + fault, encoding="utf-8")
    with pytest.raises(ProfileError, match=r"which = 'main-sail' is not a propeller of"):
        load_profile("boat.yaml")


@pytest.mark.medium
def test_a_fault_of_a_propeller_acts_beside_a_sail(install: Install, boat: Path) -> None:
    install("xitl-sail", SAIL, actuators=ENTRY)
    boat.write_text(
        PROFILE.replace("[0, 0, 1]", "[0.5, 0.5, 1]")
        + "faults: {stuck: {from_s: 1, propeller: {which: port, stuck_at: -0.5}}}\n",
        encoding="utf-8",
    )
    with run("clock.duration_s=5").open_log() as log:
        speeds = log.tables["/truth/state"].values("rotor")[-1]
    assert speeds.tolist() == pytest.approx([-0.5, 0.5, 1.0], abs=0.01)


@pytest.mark.slow
def test_the_embedded_autopilot_leaves_an_added_actuator_at_zero(install: Install, boat: Path) -> None:
    install("xitl-sail", SAIL, actuators=ENTRY)
    boat.write_text("extends: sitl\nvehicle: {actuators: {sail: {area_m2: 2}}}\n", encoding="utf-8")
    with run("clock.duration_s=14").open_log() as log:  # the propellers begin at 11 s
        commands = log.tables["/actuators"].values("command")
    assert np.abs(commands[:, 2]).max() == 0.0
    assert np.abs(commands[:, :2]).max() > 0.0


@pytest.mark.medium
def test_a_passive_actuator_has_no_command(install: Install, boat: Path) -> None:
    code = SAIL.replace(
        "    def make", "    @property\n    def commands(self):\n        return ()\n\n    def make"
    ).replace("angle_rad = state[:, 0] * 0.5 * np.pi", "angle_rad = np.full(len(state), 0.5 * np.pi)")
    install("xitl-sail", code, actuators=ENTRY)
    boat.write_text(PROFILE.replace("[0, 0, 1]", "[0, 0]"), encoding="utf-8")
    assert run("clock.duration_s=2").exit_code == 0
    assert "xitl_sail" in sys.modules
