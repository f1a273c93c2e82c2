"""How an ArduPilot is started: its command line, its parameters, its ports."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.profile import ground_stations_of
from xitl_cli.run.links.launch import FirmwareLaunch, resolved_bridge
from xitl_cli.run.links.ports import PortClaims
from xitl_cli.run.links.setup import parameter_file_text, start_parameters


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """Says what a real one says when its port is open, and its arguments."""
    path = tmp_path / "ardurover"
    path.write_text(
        f"#!{sys.executable}\nimport sys, time\n"
        "print('SERIAL0 on TCP port', *sys.argv[1:], flush=True)\ntime.sleep(60)\n"
    )
    path.chmod(0o755)
    return path


def launch(program: Path, name: str, *overrides: str) -> tuple[FirmwareLaunch, Any]:
    ports = PortClaims()
    profile = load_profile(name, [f"autopilot.firmware={program}", *overrides]).runnable()
    bridge = resolved_bridge(profile.autopilot.bridge, ports)
    return FirmwareLaunch(profile, bridge, 5501, ground_stations_of(profile)), bridge


def port(url: str) -> str:
    return url.rpartition(":")[2]


def options(words: list[str]) -> dict[str, str]:
    return dict(zip(words[::2], words[1::2], strict=True))


def test_port_0_is_one_that_is_free_and_others_stay() -> None:
    bridge = load_profile("sitl-ardupilot-ahrs").runnable().autopilot.bridge
    claims = PortClaims()
    resolved = resolved_bridge(bridge, claims)
    ports = [port(url) for url in (resolved.mavlink, resolved.world or "", resolved.sensor_link or "")]
    assert len({*ports, "0"}) == 4
    assert resolved_bridge(resolved, claims) == resolved
    assert resolved.outputs == bridge.outputs


def test_sitl_in_lockstep_gets_its_world_its_home_and_no_ports_that_nobody_asked_for(program: Path) -> None:
    made, bridge = launch(program, "sitl-ardupilot")
    said = options(made.arguments())
    assert said["--model"] == "JSON:127.0.0.1"
    assert said["--sim-port-out"] == port(bridge.world)
    lat, lon, alt, heading = map(float, said["--home"].split(","))
    assert (lat, lon, alt, heading) == pytest.approx((-8.8, -63.95, 70.0, 36.87))
    assert said["--serial0"] == f"tcp:{port(bridge.mavlink)}"
    assert (said["--serial1"], said["--serial2"]) == ("none:", "none:")


def test_the_sensors_come_to_the_port_that_the_parameters_give_them(program: Path) -> None:
    made, bridge = launch(program, "sitl-ardupilot-ahrs")
    number = next(
        n
        for n in range(10)
        if start_parameters(load_profile("sitl-ardupilot-ahrs").runnable()).get(f"SERIAL{n}_PROTOCOL") == 36
    )
    assert options(made.arguments())[f"--serial{number}"] == f"tcp:{port(bridge.sensor_link)}"


def test_without_a_port_for_the_sensors_there_is_nothing_to_start(program: Path) -> None:
    made, _ = launch(program, "sitl-ardupilot-ahrs", "autopilot.parameter_files=[]")
    with pytest.raises(UserError, match="no serial port of the autopilot has SERIALn_PROTOCOL = 36"):
        made.arguments()


def test_in_real_time_ground_stations_have_serial_ports_of_their_own(program: Path) -> None:
    stations = "autopilot.ground_stations=[udp://127.0.0.1:14550, tcp://0.0.0.0:5760]"
    made, _ = launch(program, "hitl-ardupilot-ahrs-loopback", stations)
    said = options(made.arguments())
    assert said["--model"] == "motorboat"
    assert said["--serial1"] == "udpclient:127.0.0.1:14550"
    assert said["--serial2"] == "tcp:5760"
    assert "--speedup" not in said


def test_a_linux_build_gets_folders_of_its_own_and_addresses_as_it_writes_them(program: Path) -> None:
    made, bridge = launch(program, "hitl-ardupilot-linux-loopback")
    said = options(made.arguments())
    assert said["--log-directory"] == "logs"
    assert said["--serial0"] == f"tcp:127.0.0.1:{port(bridge.mavlink)}"
    assert f"tcp:127.0.0.1:{port(bridge.sensor_link)}:wait" in said.values()
    assert "--model" not in said
    made, bridge = launch(program, "hitl-ardupilot-linux-loopback", "autopilot.bridge.sensor_link=udp://127.0.0.1:0")
    assert f"udpin:127.0.0.1:{port(bridge.sensor_link)}" in options(made.arguments()).values()
    device = "autopilot.bridge.sensor_link=serial:///dev/pts/7?baud=921600"
    assert "/dev/pts/7" in launch(program, "hitl-ardupilot-linux-loopback", device)[0].arguments()


def test_own_arguments_come_last(program: Path) -> None:
    made, _ = launch(program, "sitl-ardupilot", "autopilot.firmware_arguments=[--start-time, '1']")
    assert made.arguments()[-2:] == ["--start-time", "1"]


def test_it_starts_in_a_folder_of_the_run_with_the_parameters_of_files_mission_and_profile(
    program: Path, tmp_path: Path
) -> None:
    made, _ = launch(program, "sitl-ardupilot", "autopilot.parameters.WP_SPEED=2.5", "mission.acceptance_radius_m=4")
    (tmp_path / "autopilot").mkdir()
    (tmp_path / "autopilot" / "eeprom.bin").write_text("of an earlier run")
    process = made.start(tmp_path)
    try:
        lines = (tmp_path / "autopilot" / "parameters.parm").read_text().splitlines()
        values = dict(line.split() for line in lines)
        assert (values["WP_SPEED"], values["WP_RADIUS"], values["FRAME_CLASS"]) == ("2.5", "4", "2")
        assert not (tmp_path / "autopilot" / "eeprom.bin").exists()
        assert "--defaults parameters.parm" in process.console_text()
    finally:
        process.stop()


def test_parameters_are_written_with_all_the_digits_that_an_autopilot_keeps() -> None:
    assert parameter_file_text({"B": 0.1, "A": 16777215.0}) == "A 16777215\nB 0.1\n"


@pytest.mark.parametrize("name", ["SCR_ENABLE", "SCR_SDEV1_PROTO"])
def test_without_scripting_hil_messages_are_refused_before_it_starts(program: Path, name: str, golden: Golden) -> None:
    launch(program, "hitl-ardupilot-usb-loopback")
    with pytest.raises(UserError) as refused:
        launch(program, "hitl-ardupilot-usb-loopback", f"autopilot.parameters.{name}=0")
    golden("error", refused.value)


@pytest.mark.parametrize(("system_id", "said"), [(1, []), (3, ["MAV_SYSID 3", "SYSID_THISMAV 3"])])
def test_its_system_is_the_vessels_by_the_name_of_each_version(
    program: Path, tmp_path: Path, system_id: int, said: list[str]
) -> None:
    made, _ = launch(program, "sitl-ardupilot", f"autopilot.system_id={system_id}")
    made.start(tmp_path).stop()
    lines = (tmp_path / "autopilot" / "parameters.parm").read_text().splitlines()
    assert [line for line in lines if "SYSID" in line and "GCS" not in line] == said
