"""How a PX4 is started: its instance, its ports, its parameters; and when it is not ours to start."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.run.links.launch import Px4Launch
from xitl_cli.run.links.ports import PortClaims
from xitl_cli.run.nodes.bridge import make_launch


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """Says what a real one says when it calls its simulator; it has start scripts beside it."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "etc" / "init.d-posix").mkdir(parents=True)
    (tmp_path / "etc" / "init.d-posix" / "rcS").touch()
    path = tmp_path / "bin" / "px4"
    path.write_text(
        f"#!{sys.executable}\nimport sys, time\n"
        "print('Waiting for simulator to accept connection', *sys.argv[1:], flush=True)\ntime.sleep(60)\n"
    )
    path.chmod(0o755)
    return path


def launch(program: Path | str, *overrides: str) -> Px4Launch:
    made = make_launch(load_profile("sitl-px4", [f"autopilot.firmware={program}", *overrides]).runnable(), PortClaims())
    assert isinstance(made, Px4Launch)
    return made


def ports(made: Px4Launch) -> tuple[str, str]:
    return made.bridge.sensor_link or "", made.bridge.mavlink


def test_its_ports_are_those_of_its_instance(program: Path) -> None:
    made = launch(program)
    try:
        number = made.instance
        assert ports(made) == (f"tcp://127.0.0.1:{4560 + number}", f"udp://127.0.0.1:{14580 + number}")
        assert made.arguments() == ["-d", "-i", str(number), str(program.parents[1] / "etc")]
    finally:
        made.end()


def test_two_at_once_have_two_and_give_them_back(program: Path) -> None:
    one = launch(program)
    other = launch(program)
    assert one.instance != other.instance
    one.end()
    again = launch(program)
    assert again.instance == one.instance
    other.end()
    again.end()


def test_a_port_that_is_taken_is_said(program: Path) -> None:
    one = launch(program)
    try:
        with pytest.raises(UserError, match=f"port {4560 + one.instance} of this machine, or the other ports"):
            launch(program, f"autopilot.bridge.sensor_link=tcp://127.0.0.1:{4560 + one.instance}")
    finally:
        one.end()


def test_parameters_come_before_its_start(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some are read at the start alone. What is meant for another PX4 is left out."""
    monkeypatch.setenv("PX4_SIM_MODEL", "iris")
    monkeypatch.setenv("PX4_PARAM_RO_SPEED_LIM", "9")
    made = launch(
        program, "mission.speed_mps=2.5", "autopilot.parameters={RO_YAW_P: 2}", "mission.acceptance_radius_m=4"
    )
    told = made.environment()
    made.end()
    assert "PX4_SIM_MODEL" not in told
    assert told["PX4_SYS_AUTOSTART"] == "1061"
    wanted = {"RO_SPEED_LIM": "2.5", "NAV_ACC_RAD": "4", "RO_YAW_P": "2", "CA_R_REV": "3", "EKF2_GPS_DELAY": "120"}
    assert {name: told[f"PX4_PARAM_{name}"] for name in wanted} == wanted
    assert float(told["PX4_PARAM_EKF2_IMU_POS_Z"]) == -0.3


def test_another_airframe(program: Path) -> None:
    made = launch(program, "autopilot.parameters={SYS_AUTOSTART: 1070}")
    assert made.environment()["PX4_SYS_AUTOSTART"] == "1070"
    assert "PX4_PARAM_SYS_AUTOSTART" not in made.environment()
    made.end()


@pytest.mark.medium
def test_it_is_started_in_the_run_s_directory(program: Path, tmp_path: Path) -> None:
    made = launch(program)
    process = made.start(tmp_path / "run")
    try:
        assert process.directory == tmp_path / "run" / "autopilot"
        assert f"-d -i {made.instance}" in process.console_text()
    finally:
        process.stop(0.1)
        made.end()


def test_it_is_found_by_its_variable(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XITL_PX4", str(program))
    made = launch("find")
    made.end()
    assert made.program == program


def test_without_one_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("XITL_PX4", raising=False)
    with pytest.raises(UserError, match="px4 is not on the PATH, and XITL_PX4 is not set; build PX4 with"):
        launch("find")


def test_one_without_its_start_scripts_is_none(program: Path) -> None:
    (program.parents[1] / "etc" / "init.d-posix" / "rcS").unlink()
    with pytest.raises(UserError, match=r"etc/init\.d-posix/rcS is missing"):
        launch(program)


@pytest.mark.parametrize("firmware", ["find", "external"])
def test_one_whose_ports_are_named_is_started_elsewhere(firmware: str) -> None:
    there = ["autopilot.bridge.sensor_link=tcp://127.0.0.1:4560", "autopilot.bridge.mavlink=udp://127.0.0.1:14580"]
    assert make_launch(load_profile("sitl-px4", [f"autopilot.firmware={firmware}", *there]).runnable(), ()) is None


def test_its_system_is_the_vessels_whatever_its_instance(program: Path, tmp_path: Path) -> None:
    """Its own start script makes it one more than the instance."""
    script = program.parents[1] / "etc" / "init.d-posix" / "rcS"
    script.write_text("a\nparam set MAV_SYS_ID $((px4_instance+1))\nb\n")
    same = launch(program)
    other = launch(program, "autopilot.system_id=77")
    try:
        assert ("-s" in same.arguments()) == (same.instance != 0)
        assert other.arguments()[3:5] == ["-s", "startup.sh"]
        process = other.start(tmp_path)
        process.stop()
        assert (tmp_path / "autopilot" / "startup.sh").read_text() == "a\nparam set MAV_SYS_ID 77\nb\n"
    finally:
        same.end()
        other.end()
