"""What an agent is told at its start."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from agent.options import parse
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.profile import ground_stations_of
from xitl_cli.run.links.peer import AgentOptions, options_from_profile, own_options
from xitl_cli.run.links.setup import embedded_parameters

USUAL = ("udp://127.0.0.1:14550", "tcp://127.0.0.1:5760")


@pytest.mark.parametrize(
    ("name", "overrides", "addresses"),
    [
        ("sitl", (), ()),
        ("sitl", ("clock.mode=realtime",), USUAL),
        ("hitl-loopback", (), USUAL),
        ("hitl-beaglebone", (), ()),
        ("mitl", ("clock.mode=realtime",), ()),
        ("sitl", ("autopilot.ground_stations=[tcp://127.0.0.1:5790]",), ("tcp://127.0.0.1:5790",)),
        ("hitl-loopback", ("autopilot.ground_stations=[]",), ()),
        ("hitl-loopback", ("autopilot.ground_station_interface=0.0.0.0",), (USUAL[0], "tcp://0.0.0.0:5760")),
        ("sitl", ("autopilot.ground_station_interface=0.0.0.0",), ()),
    ],
)
def test_who_may_talk_to_the_autopilot(name: str, overrides: tuple[str, ...], addresses: tuple[str, ...]) -> None:
    assert ground_stations_of(load_profile(name, overrides).runnable()) == addresses


def test_the_command_line_of_the_agent(tmp_path: Path) -> None:
    (tmp_path / "key").write_text("secret\n")
    (tmp_path / "key").chmod(0o600)
    given = ["udp://127.0.0.1:14999", "tcp://127.0.0.1:5799"]
    profile = load_profile(
        "hitl-loopback",
        [
            f"autopilot.ground_stations=[{', '.join(given)}]",
            "autopilot.controller=boats.heading:Fast",
            f"autopilot.signing_key_file={tmp_path / 'key'}",
        ],
    ).runnable()
    arguments = options_from_profile(profile, tmp_path, ground_stations_of(profile)).arguments()
    assert arguments == [
        *("--gcs", given[0], "--gcs", given[1]),
        *("--controller", "boats.heading:Fast"),
        *("--signing-key", str(tmp_path / "key")),
        *("--log-dir", str(tmp_path)),
    ]


def test_a_bridge_is_told_the_same_on_a_command_line_and_in_this_process() -> None:
    overrides = ["autopilot.bridge.outputs=[3, 1]", "autopilot.bridge.trim_us=1510", "autopilot.bridge.span_us=380.5"]
    autopilot = load_profile("sitl-ardupilot-ahrs", overrides).runnable().autopilot
    options = AgentOptions(bridge=autopilot.bridge)
    told, own = parse(options.arguments(), "xitl agent"), own_options(options)
    for name in ("role", "autopilot", "world", "sensors", "sensor_link", "outputs", "trim_us", "span_us"):
        assert getattr(told, name) == getattr(own, name), name
    assert (own.role, own.outputs, own.sensors, own.span_us) == ("bridge", (3, 1), "vectornav", 380.5)


def test_the_system_of_the_vessel_on_a_command_line_and_in_this_process(tmp_path: Path) -> None:
    for name in ("sitl", "sitl-ardupilot-ahrs"):
        profile = load_profile(name, ["autopilot.system_id=7"]).runnable()
        bridge = profile.autopilot.bridge if profile.autopilot.kind == "ardupilot" else None
        options = options_from_profile(profile, tmp_path, bridge=bridge)
        assert (parse(options.arguments(), "xitl agent").system_id, own_options(options).system_id) == (7, 7)


@pytest.mark.parametrize("vessel", ["", "leader"])
def test_a_bridge_is_told_whether_its_vessel_is_one_of_a_fleet(vessel: str, tmp_path: Path) -> None:
    profile = replace(load_profile("sitl-ardupilot").runnable(), vessel=vessel)
    options = options_from_profile(profile, tmp_path, bridge=profile.autopilot.bridge)
    assert parse(options.arguments(), "xitl agent").fleet == own_options(options).fleet == bool(vessel)


@pytest.mark.parametrize(("system_id", "kept"), [(1, {}), (7, {"SYSID_THISMAV": 7.0})])
def test_a_file_of_one_vessel_serves_another(tmp_path: Path, system_id: int, kept: dict[str, float]) -> None:
    file = tmp_path / "boat.parm"
    file.write_text("SYSID_THISMAV 7\nWP_SPEED 2.5\n")
    given = [f"autopilot.parameter_files=[{file}]", f"autopilot.system_id={system_id}"]
    values = embedded_parameters(load_profile("sitl", given).runnable())
    assert {name: value for name, value in values.items() if name == "SYSID_THISMAV"} == kept


def test_nothing_given_is_nothing_said(tmp_path: Path) -> None:
    profile = load_profile("sitl", ["recording.dataflash=false"]).runnable()
    assert options_from_profile(profile, tmp_path) == AgentOptions()
    assert AgentOptions().arguments() == []
