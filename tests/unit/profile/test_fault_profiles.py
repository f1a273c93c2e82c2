"""Faults in a profile: what is refused, with the sentence, and what goes together."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from sim_core.keys import key_annotations
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
    ("fault", "sentence"),
    [
        (
            "{from_s: 1.0, until_s: 1.01, link: {cut: true}}",
            "faults.x.until_s = 1.01 ends it before it acts: faults.x.link is put in force at exchanges, "
            "every 0.02 s (clock.exchange_rate_hz); use 1.02 or later",
        ),
        ("{from_s: 3}", "faults.x does nothing; give it link, agent, imu, gnss, magnetometer, barometer, propeller"),
        ("{propeller: {which: port}}", "faults.x.propeller does nothing; give it thrust_loss, stuck, stuck_at or rev"),
        (
            "{propeller: {which: propeller 2, reversed: true}}",
            "faults.x.propeller.which = 'propeller 2' names no propeller of asv-full; use propeller 0, propeller 1",
        ),
        ("{propeller: {stuck_at: 2}}", "faults.x.propeller.stuck_at = 2 is too large; use a value of at most 1"),
        (
            "{rudder: {jam: true}}",
            "faults.x.rudder has nothing to act on: asv-full has neither a rudder nor a steering gear; use prop",
        ),
        (
            "{battery: {failed_cells: 15}}",
            "faults.x.battery.failed_cells = 15 is more than the 14 cells of vehicle.battery; use 14 or less",
        ),
        ("{gnss: {drift_bearing_deg: 90}}", "faults.x.gnss does nothing; give it dropout, freeze, position_bias_ned_m"),
        (
            "{from_s: 1.0, until_s: 1.01, propeller: {stuck: true}}",
            "faults.x.until_s = 1.01 ends it before it acts: faults.x.propeller is put in force at exchanges",
        ),
        ("{link: {}}", "faults.x.link does nothing; give it delay_s, jitter_s, loss, duplicate, reorder or cut"),
        ("{link: {direction: sensors}}", "faults.x.link does nothing; give it delay_s"),
        ("{agent: {}}", "faults.x.agent does nothing; give it cpu_load, clock_offset_s or clock_skew_ppm"),
        ("{barometer: {freeze: false}}", "faults.x.barometer does nothing; give it dropout, freeze or pressure_bias"),
        ("{from_s: 5, until_s: 5, imu: {freeze: true}}", "faults.x.until_s = 5 is not after from_s (5); use a later"),
        ("{imu: {dropout: 1.5}}", "faults.x.imu.dropout = 1.5 is too large; use a value of at most 1"),
        ("{imu: {pressure_bias_pa: 1}}", "faults.x.imu.pressure_bias_pa is not a known key; known keys: dropout"),
        ("{imu: {gyro_bias_frd_radps: [1, 2]}}", "faults.x.imu.gyro_bias_frd_radps"),
        ("{agent: {clock_offset_s: -1}}", "faults.x.agent.clock_offset_s = -1 is too small; use a value of at least 0"),
        (
            "{agent: {clock_skew_ppm: 20000}}",
            "faults.x.agent.clock_skew_ppm = 20000 is too large; use a value of at most 10000 in ppm",
        ),
        ("{link: {direction: out}}", "faults.x.link.direction = 'out' is not one of the choices; use both, sensors or"),
        (
            "{until_s: 9, agent: {clock_skew_ppm: 80}}",
            "faults.x.agent.clock_skew_ppm has no end, since a clock that ran ahead does not go back; drop until_s of "
            "faults.x",
        ),
        ("{link: {cut: true, which: standby}}", "faults.x.link.which = standby names an agent that this profile"),
    ],
)
def test_what_is_refused(fault: str, sentence: str, write: Write) -> None:
    found = problems(write, "hitl-loopback", fault)
    assert len(found) == 1
    assert found[0].startswith(f"boat.yaml:3: {sentence}")


@pytest.mark.parametrize(
    ("fault", "key"),
    [
        ("{link: {delay_s: 0.1}}", "link.delay_s"),
        ("{link: {loss: 0.1, jitter_s: 0.1}}", "link.jitter_s"),
        ("{agent: {cpu_load: 0.5}}", "agent.cpu_load"),
        ("{agent: {clock_offset_s: 1}}", "agent.clock_offset_s"),
    ],
)
def test_what_takes_time_means_nothing_in_lockstep(fault: str, key: str, write: Write) -> None:
    assert problems(write, "sitl", fault) == [
        f"boat.yaml:3: faults.x.{key} means nothing in lockstep, where time stands still on the way; "
        "use clock.mode: realtime, or drop it"
    ]


@pytest.mark.parametrize(
    "fault", ["{link: {loss: 0.1, duplicate: 0.1, reorder: 0.1, cut: true}}", "{imu: {freeze: true}}"]
)
def test_the_rest_works_in_lockstep(fault: str, write: Write) -> None:
    profile = load_profile(str(write(f"extends: sitl\nfaults: {{x: {fault}}}")))
    assert profile.runnable().faults


def test_without_an_autopilot_there_is_nothing_to_go_wrong(write: Write) -> None:
    found = problems(write, "mitl", "{imu: {freeze: true}}")
    assert len(found) == 1
    assert "faults.x.imu has nothing to act on: without an autopilot there is neither a link nor a sensor" in found[0]


@pytest.mark.parametrize(
    ("base", "fault", "sentence"),
    [
        (
            "[sitl, vehicles/asv-steered]",
            "{rudder: {which: rudder 0, jam: true}}",
            "faults.x.rudder.which = 'rudder 0' names no rudder or gear of asv-steered; use steering 0",
        ),
        (
            "[sitl, vehicles/asv-steered]",
            "{rudder: {jam_angle_deg: 60}}",
            "faults.x.rudder.jam_angle_deg = 60 is beyond the stop of steering 0; use an angle from -45 to 45",
        ),
        (
            "[sitl, vehicles/asv-steered]",
            "{propeller: {which: port, reversed: true}}",
            "faults.x.propeller.which = 'port' names no propeller of asv-steered; use propeller 0",
        ),
        (
            "[sitl, vehicles/heron]",
            "{battery: {voltage_drop_v: 1}}",
            "faults.x.battery has nothing to act on: vehicle.battery of heron is not given; give its cells",
        ),
        (
            "sitl-ardupilot",
            "{gnss: {drift_mps: 0.1}}",
            "faults.x.gnss reaches nobody: this autopilot simulates its own gnss from the true motion",
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


def test_a_vessel_whose_samples_are_recorded_shows_no_fault(write: Write) -> None:
    recorded = "sensors: {recorded: {file: somebody.mcap}}"
    path = write(f"extends: sitl\n{recorded}\nfaults: {{x: {{propeller: {{reversed: true}}}}}}")
    with pytest.raises(ProfileError, match=r"faults\.x\.propeller reaches nobody: the sensors replay a recording"):
        load_profile(str(path))


def test_the_page_names_every_key_and_every_shipped_part() -> None:
    text = (Path(__file__).parents[3] / "docs/faults.md").read_text()
    words = set(re.findall(r"\w+", text))

    groups = [value for value in vars(schema).values() if dataclasses.is_dataclass(value)]
    assert {key for group in groups if group is not schema.Bounds for key in key_annotations(group)} <= words
    assert all(f"`{name.removeprefix('faults/')}`" in text for name in PARTS)
