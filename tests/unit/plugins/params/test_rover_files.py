"""The parameter files for ArduPilot Rover: readable by us and by it, and fit to be combined."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from agent.mavlink.parameter_rows import parm_lines
from xitl_cli.profile import load_profile
from xitl_cli.run.links.setup import parameter_file_values
from xitl_cli.run.links.vessel_gains import vessel_gains
from xitl_cli.shipped import firmware_params_dir

FILES = sorted(firmware_params_dir().glob("rover-*.parm"))
MOST_IN_A_LINE = 98  # ArduPilot reads 99 characters of a line; what is left over counts as the next line
MOST_IN_A_NAME = 16
WAYS_IN = ("rover-json", "rover-vectornav", "rover-microstrain7", "rover-hil")
FRAMES = ("rover-differential", "rover-steered", "rover-rudder")
VESSELS = tuple(
    f"rover-{name}"
    for name in ("asv-full", "asv-third", "asv-steered", "otter", "wamv16", "heron", "blueboat", "cybership2")
)
RUDDERS = """extends: [sitl-ardupilot, vehicles/cybership2, environments/calm]
autopilot:
  parameter_files: [rover-json, rover-rudder, rover-cybership2]
  bridge: {outputs: [3, 5, 9, 1, 7]}
"""


def names(file: Path) -> list[str]:
    return [name for _, name, _ in parm_lines(file.read_text(), str(file))]


def test_there_are_files() -> None:
    assert {file.stem for file in FILES} >= {"rover-json", *FRAMES, *VESSELS}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_a_file_says_what_it_is_for_and_fits_the_reader(file: Path) -> None:
    lines = file.read_text().splitlines()
    assert lines[0].startswith("# ")
    assert max(map(len, lines)) <= MOST_IN_A_LINE
    assert all(len(name) <= MOST_IN_A_NAME for name in names(file))
    assert len(set(names(file))) == len(names(file)) > 0


@pytest.mark.parametrize(("frame", "vessel"), list(itertools.product(FRAMES, VESSELS)))
def test_frame_and_vessel_do_not_contradict_each_other(frame: str, vessel: str) -> None:
    root = firmware_params_dir()
    assert not set(names(root / f"{frame}.parm")) & set(names(root / f"{vessel}.parm"))


def test_vessels_set_the_same_things() -> None:
    """A vessel file laid over another leaves nothing of it."""
    root = firmware_params_dir()
    sets = {frozenset(names(root / f"{vessel}.parm")) for vessel in VESSELS}
    assert len(sets) == 1


@pytest.mark.parametrize(
    ("profile", "motors"),
    [
        ("sitl-ardupilot", (73, 74)),
        ("sitl-ardupilot-steered", (70, 26)),
        (RUDDERS, (70, 70, 0, 26, 26)),
    ],
)
def test_outputs_of_a_profile_are_those_of_its_frame(profile: str, motors: tuple[int, ...], tmp_path: Path) -> None:
    if "\n" in profile:
        (tmp_path / "boat.yaml").write_text(profile)
        profile = str(tmp_path / "boat.yaml")
    autopilot = load_profile(profile).runnable().autopilot
    values, bridge = parameter_file_values(autopilot.parameter_files), autopilot.bridge
    for channel, function in zip(bridge.outputs, motors, strict=True):
        assert values[f"SERVO{channel}_FUNCTION"] == function
        if not function:  # it drives nothing
            continue
        assert values[f"SERVO{channel}_TRIM"] == bridge.trim_us
        assert values[f"SERVO{channel}_MAX"] - bridge.trim_us == bridge.span_us
        assert bridge.trim_us - values[f"SERVO{channel}_MIN"] == bridge.span_us


def test_the_gear_of_the_steered_vessel_turns_as_far_as_its_frame_says() -> None:
    ready = load_profile("sitl-ardupilot-steered").runnable()
    gear = ready.vehicle.propellers[0].steering
    assert gear is not None
    assert parameter_file_values(ready.autopilot.parameter_files)["MOT_VEC_ANGLEMAX"] == gear.max_angle_deg


@pytest.mark.parametrize("vessel", ["otter", "wamv16", "heron", "blueboat", "cybership2"])
def test_the_file_of_a_published_vessel_is_made_of_its_data(vessel: str) -> None:
    """What both autopilots mean alike is as it follows from the vessel; heading gains of a rudder boat are its own."""
    spec = load_profile(vessel).vehicle
    assert spec is not None
    assert spec.cruise_speed_mps is not None
    gains, values = vessel_gains(spec, spec.cruise_speed_mps), parameter_file_values([f"rover-{vessel}"])
    alike = ["CRUISE_SPEED", "CRUISE_THROTTLE", "ATC_SPEED_P", "ATC_SPEED_I", "MOT_THST_ASYM", "MOT_SLEWRATE"]
    if not spec.rudders:
        alike += ["ATC_STR_ANG_P", "ATC_STR_RAT_FF", "ATC_STR_RAT_P", "ATC_STR_RAT_MAX", "ATC_STR_ACC_MAX"]
    assert {name: values[name] for name in alike} == {name: pytest.approx(gains[name], rel=0.1) for name in alike}
    assert values["WP_SPEED"] == spec.cruise_speed_mps


@pytest.mark.parametrize("way", WAYS_IN)
def test_no_check_before_arming_is_switched_off_for_good(way: str) -> None:
    """All of them (1), or named ones left out: never none at all (0)."""
    values = parameter_file_values([way])
    assert values.get("ARMING_CHECK", 1) != 0
    assert values.get("ARMING_REQUIRE", 1) == 1
