"""What does not go together in a profile with an autopilot of another make, each with one sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.golden import Golden
from xitl_cli.profile import ProfileError, load_profile

Write = Callable[..., Path]

LOCKSTEP, BOARD, LINUX = "sitl-ardupilot", "hitl-ardupilot-ahrs", "hitl-ardupilot-linux-loopback"
PX4, PX4_BOARD = "sitl-px4", "hitl-px4"


def sentences(profile: str, *overrides: str) -> list[str]:
    try:
        load_profile(profile, list(overrides))
    except ProfileError as error:
        return [problem.sentence for problem in error.problems]
    return []


@pytest.mark.parametrize(
    ("profile", "override", "sentence"),
    [
        (LOCKSTEP, "clock.mode=realtime", "autopilot.bridge.world sets the autopilot's time; use clock.mode: lockstep"),
        (LOCKSTEP, "autopilot.bridge.world=null", "clock.mode = lockstep needs autopilot.bridge.world"),
        (LOCKSTEP, "autopilot.bridge.world=tcp://127.0.0.1:9002", "use udp://127.0.0.1:0"),
        (LOCKSTEP, "autopilot.bridge.mavlink=serial:///dev/ttyACM0?baud=115200", "use tcp://127.0.0.1:0"),
        (LOCKSTEP, "autopilot.bridge.mavlink=nonsense", "is not a link"),
        (
            LOCKSTEP,
            "autopilot.bridge.sensors=vectornav",
            "sensor_link is missing: vectornav needs a separate line",
        ),
        (LOCKSTEP, "autopilot.bridge.sensor_link=tcp://127.0.0.1:0", "has no effect with sensors = null"),
        (LOCKSTEP, "autopilot.bridge.sensors=px4", "does not work with autopilot.kind = ardupilot"),
        (LOCKSTEP, "autopilot.bridge.outputs=[1, 2, 3]", "does not fit a vessel with 2 propellers; use 2"),
        (LOCKSTEP, "autopilot.bridge.outputs=[3, 3]", "has a channel twice"),
        (LOCKSTEP, "autopilot.controller=a.b:C", "autopilot.controller: ardupilot has its own controller"),
        (LOCKSTEP, "autopilot.parameter_files=[rover-jason]", "did you mean 'rover-json'?"),
        (
            LOCKSTEP,
            "autopilot.kind=embedded",
            "autopilot.firmware does not apply to autopilot.kind = embedded",
        ),
        (BOARD, "autopilot.bridge.sensors=null", "without a world it has no sensors"),
        (BOARD, "autopilot.bridge.mavlink=tcp://127.0.0.1:0", "has no port, and the autopilot is started"),
        (BOARD, "autopilot.ground_stations=[udp://127.0.0.1:14550]", "apply only to an autopilot that is started here"),
        ("hitl-ardupilot-linux", "autopilot.firmware=find", "runs on this machine, but the bridge runs on a board"),
        (LOCKSTEP, "autopilot.bridge.mavlink=tcp://10.0.0.3:5760", "is on another machine"),
        (LOCKSTEP, "driver={kind: none}", "autopilot.moored_until_armed would hold the vessel for ever"),
        (LOCKSTEP, "driver={kind: script, script: [{at_s: 1, mode: AUTO}]}", "because driver.kind = script never arms"),
        (
            LOCKSTEP,
            "faults={a: {gnss: {dropout: 1.0}}}",
            "faults.a.gnss has no effect, because this autopilot simulates its own gnss",
        ),
        (
            BOARD,
            "autopilot.firmware_arguments=[-w]",
            "autopilot.firmware_arguments apply only to an autopilot that is started here",
        ),
        (BOARD, "autopilot.bridge.sensor_link=serial:///dev/ttyACM0?baud=921600", "is also the URL of its MAVLink"),
        (
            "sitl",
            "autopilot.firmware_build=linux",
            "autopilot.firmware_build does not apply to autopilot.kind = embedded",
        ),
        (
            "sitl",
            "autopilot.firmware_arguments=[-w]",
            "autopilot.firmware_arguments does not apply to autopilot.kind = embedded",
        ),
        (PX4, "autopilot.bridge.sensor_link=null", "in lockstep PX4 connects to its simulator by a separate line"),
        (
            PX4,
            "driver={kind: script, script: [{at_s: 1, mode: SMART_RTL, arm: true}]}",
            "driver.script.0.mode = SMART_RTL is not a mode of PX4; use MANUAL",
        ),
        (
            PX4,
            "autopilot.bridge.sensor_link=tcp://127.0.0.1:4560",
            "mavlink = 'udp://127.0.0.1:0' has no port, and the",
        ),
        (
            PX4,
            "autopilot.ground_stations=['udp://127.0.0.1:14550']",
            "sends to UDP 14550 of this machine; remove the key",
        ),
        (
            PX4_BOARD,
            "autopilot.firmware=/bin/sh",
            "starts a PX4 in software, but these settings are for a PX4 on a board",
        ),
        (
            PX4,
            "companion={}",
            "with ArduPilot's GUIDED, which PX4 does not have; set companion.parameters.AVD_ENABLE=0",
        ),
        (PX4_BOARD, "clock.mode=lockstep", "in lockstep PX4 connects to its simulator by a separate line"),
        (PX4, "autopilot.bridge.world=udp://127.0.0.1:9002", "JSON interface, which PX4 does not have"),
        (LINUX, "autopilot.bridge.sensors=vectornav", "does not work with ArduPilot's Linux builds"),
        (LINUX, "autopilot.bridge.world=udp://127.0.0.1:0", "firmware_build = linux runs on a real clock"),
        (
            LINUX,
            "autopilot.standby={link: 'udp://127.0.0.1:14661'}",
            "autopilot.standby: ardupilot cannot have a standby",
        ),
    ],
)
def test_what_cannot_be_is_said(profile: str, override: str, sentence: str) -> None:
    assert sentence in " ".join(sentences(profile, override))


@pytest.mark.parametrize(
    ("profile", "override"),
    [
        (LOCKSTEP, "faults={a: {imu: {dropout: 0.5}}, b: {link: {loss: 0.1}}}"),
        ("sitl-ardupilot-ahrs", "faults={a: {gnss: {dropout: 1.0}}}"),
        (LOCKSTEP, "driver={kind: script, script: [{at_s: 1, arm: true}]}"),
        (LOCKSTEP, "autopilot.bridge.mavlink=tcp://localhost:5770"),
        (PX4_BOARD, "autopilot.bridge.sensor_link=null"),
        (PX4, "companion={parameters: {AVD_ENABLE: 0}}"),
    ],
)
def test_what_can_be_is_let_through(profile: str, override: str) -> None:
    assert sentences(profile, override) == []


def test_more_ground_stations_than_it_has_ports_are_refused(golden: Golden) -> None:
    three = ", ".join(f"udp://127.0.0.1:{port}" for port in (14550, 14551, 14552))
    found = sentences(LOCKSTEP, f"autopilot.ground_stations=[{three}]")
    assert len(found) == 1
    golden("text", found[0])


def test_a_parameter_file_is_read_but_not_held_against_the_embedded_autopilot(write: Write) -> None:
    good = write("MADE_UP_NAME 3\n", "good.parm")
    bad = write("MADE_UP_NAME three\n", "bad.parm")
    assert sentences(LOCKSTEP, f"autopilot.parameter_files=[{good}]") == []
    (sentence,) = sentences(LOCKSTEP, f"autopilot.parameter_files=[{bad}]")
    assert "autopilot.parameter_files.0" in sentence
    assert "bad.parm" in sentence


def test_firmware_is_meant_from_the_profile_that_names_it_but_words_are_words(write: Write, tmp_path: Path) -> None:
    path = write("extends: sitl-ardupilot\nautopilot: {firmware: build/ardurover}", "boats/mine.yaml")
    autopilot = load_profile(str(path)).autopilot
    assert autopilot is not None
    assert autopilot.firmware == str(tmp_path / "boats/build/ardurover")
    for word in ("find", "external"):
        ports = ["autopilot.bridge.mavlink=tcp://127.0.0.1:5760", "autopilot.bridge.world=udp://127.0.0.1:9002"]
        kept = load_profile(LOCKSTEP, [f"autopilot.firmware={word}", *ports]).autopilot
        assert kept is not None
        assert kept.firmware == word
