"""Faults in a profile: what is refused, with the sentence, and what goes together."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from sim_core.keys import key_annotations
from tests.golden import Golden
from xitl_cli.profile import ProfileError, load_profile, resolved_yaml
from xitl_cli.profile.files.catalogue import shipped_profiles
from xitl_cli.profile.schema import faults as schema

Write = Callable[..., Path]
PARTS = [name for name in shipped_profiles() if name.startswith("faults/")]


def problems(write: Write, base: str, fault: str) -> list[str]:
    with pytest.raises(ProfileError) as caught:
        load_profile(str(write(f"extends: {base}\nfaults:\n  x: {fault}\n")))
    return [str(problem) for problem in caught.value.problems]


@pytest.mark.parametrize("name", PARTS)
def test_every_shipped_fault_goes_with_a_real_time_run(name: str, write: Write) -> None:
    vehicle = "vehicles/asv-steered, " if name == "faults/rudder-jam" else ""
    profile = load_profile(str(write(f"extends: [hitl-loopback, {vehicle}{name}]"))).runnable()
    assert list(profile.faults) == [name.removeprefix("faults/")]
    assert load_profile("hitl-loopback").runnable().faults == {}


def test_faults_are_put_together_by_name(write: Write) -> None:
    path = write("extends: [hitl-loopback, faults/link-cut, faults/imu-bias]\nfaults: {link-cut: {from_s: 41}}")
    faults = load_profile(str(path)).runnable().faults
    assert list(faults) == ["link-cut", "imu-bias"]
    assert (faults["link-cut"].from_s, faults["link-cut"].until_s) == (41.0, 45.0)


def test_a_resolved_profile_shows_the_groups_that_are_there(write: Write) -> None:
    profile = load_profile(str(write("extends: [hitl-loopback, faults/link-cut]")))
    text = resolved_yaml(profile)
    assert "cut: true" in text
    assert "magnetometer: null" not in text
    assert load_profile(str(write(text, "resolved.yaml"))).faults == profile.faults


def test_a_standby_can_have_its_own_faults(write: Write) -> None:
    standby = "autopilot: {standby: {link: 'udp://127.0.0.1:14661', runs: process}}"
    path = write(f"extends: hitl-loopback\n{standby}\nfaults: {{x: {{link: {{cut: true, which: standby}}}}}}")
    assert load_profile(str(path)).runnable().faults["x"].link is not None


def test_a_fault_can_be_moved_from_the_command_line(write: Write) -> None:
    path = write("extends: [hitl-loopback, faults/link-cut]")
    profile = load_profile(str(path), ["faults.link-cut.until_s=60", "faults.link-cut.link.direction=sensors"])
    assert profile.faults is not None
    assert profile.faults["link-cut"].until_s == 60.0


@pytest.mark.parametrize(
    "fault",
    [
        "{from_s: 1.0, until_s: 1.01, link: {cut: true}}",
        "{from_s: 3}",
        "{propeller: {which: port}}",
        "{propeller: {which: propeller 2, reversed: true}}",
        "{propeller: {stuck_at: 2}}",
        "{rudder: {jam: true}}",
        "{battery: {failed_cells: 15}}",
        "{gnss: {drift_bearing_deg: 90}}",
        "{from_s: 1.0, until_s: 1.01, propeller: {stuck: true}}",
        "{link: {}}",
        "{link: {direction: sensors}}",
        "{agent: {}}",
        "{barometer: {freeze: false}}",
        "{from_s: 5, until_s: 5, imu: {freeze: true}}",
        "{imu: {dropout: 1.5}}",
        "{imu: {pressure_bias_pa: 1}}",
        "{imu: {gyro_bias_frd_radps: [1, 2]}}",
        "{agent: {clock_offset_s: -1}}",
        "{agent: {clock_skew_ppm: 20000}}",
        "{link: {direction: out}}",
        "{until_s: 9, agent: {clock_skew_ppm: 80}}",
        "{link: {cut: true, which: standby}}",
    ],
)
def test_what_is_refused(fault: str, golden: Golden, write: Write) -> None:
    golden("problem", problems(write, "hitl-loopback", fault))


@pytest.mark.parametrize(
    ("fault", "key"),
    [
        ("{link: {delay_s: 0.1}}", "link.delay_s"),
        ("{link: {loss: 0.1, jitter_s: 0.1}}", "link.jitter_s"),
        ("{agent: {cpu_load: 0.5}}", "agent.cpu_load"),
        ("{agent: {clock_offset_s: 1}}", "agent.clock_offset_s"),
    ],
)
def test_what_takes_time_means_nothing_in_lockstep(fault: str, key: str, write: Write, golden: Golden) -> None:
    golden("problem", problems(write, "sitl", fault))


@pytest.mark.parametrize(
    "fault", ["{link: {loss: 0.1, duplicate: 0.1, reorder: 0.1, cut: true}}", "{imu: {freeze: true}}"]
)
def test_the_rest_works_in_lockstep(fault: str, write: Write) -> None:
    profile = load_profile(str(write(f"extends: sitl\nfaults: {{x: {fault}}}")))
    assert profile.runnable().faults


def test_without_an_autopilot_there_is_nothing_to_go_wrong(write: Write, golden: Golden) -> None:
    found = problems(write, "mitl", "{imu: {freeze: true}}")
    assert len(found) == 1
    golden("text", found[0])


@pytest.mark.parametrize(
    ("base", "fault", "sentence"),
    [
        (
            "[sitl, vehicles/asv-steered]",
            "{rudder: {which: rudder 0, jam: true}}",
            "faults.x.rudder.which = 'rudder 0' is not a rudder or gear of asv-steered; use steering 0",
        ),
        (
            "[sitl, vehicles/asv-steered]",
            "{rudder: {jam_angle_deg: 60}}",
            "faults.x.rudder.jam_angle_deg = 60 is beyond the stop of steering 0; use an angle from -45 to 45",
        ),
        (
            "[sitl, vehicles/asv-steered]",
            "{propeller: {which: port, reversed: true}}",
            "faults.x.propeller.which = 'port' is not a propeller of asv-steered; use propeller 0",
        ),
        (
            "[sitl, vehicles/heron]",
            "{battery: {voltage_drop_v: 1}}",
            "faults.x.battery has no effect, because heron has no vehicle.battery; add it with cells",
        ),
        (
            "sitl-ardupilot",
            "{gnss: {drift_mps: 0.1}}",
            "faults.x.gnss has no effect, because this autopilot simulates its own gnss from the true motion",
        ),
    ],
)
def test_a_fault_that_the_vessel_cannot_have_is_refused(base: str, fault: str, sentence: str, write: Write) -> None:
    found = problems(write, base, fault)
    assert len(found) == 1
    assert found[0].startswith(f"boat.yaml:3: {sentence}")


def test_faults_of_the_vessel_need_no_autopilot(write: Write) -> None:
    profile = load_profile(str(write("extends: [mitl, faults/thrust-loss]"))).runnable()
    assert profile.faults["thrust-loss"].propeller is not None


def test_a_vessel_whose_samples_are_recorded_shows_no_fault(write: Write, golden: Golden) -> None:
    recorded = "sensors: {recorded: {file: somebody.mcap}}"
    path = write(f"extends: sitl\n{recorded}\nfaults: {{x: {{propeller: {{reversed: true}}}}}}")
    with pytest.raises(ProfileError) as refused:
        load_profile(str(path))
    golden("error", refused.value)


def test_the_page_names_every_key_and_every_shipped_part() -> None:
    text = (Path(__file__).parents[3] / "docs/faults.md").read_text()
    words = set(re.findall(r"\w+", text))

    groups = [value for value in vars(schema).values() if dataclasses.is_dataclass(value)]
    assert {key for group in groups if group is not schema.Bounds for key in key_annotations(group)} <= words
    assert all(f"`{name.removeprefix('faults/')}`" in text for name in PARTS)
