"""What `xitl params check` finds, and how `push` goes about parameters that ArduPilot hides."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav
from vehicle_double import VehicleDouble, over_tcp

from agent.mavlink import parameters as protocol
from tests.golden import Golden
from xitl_cli.params import vehicle as live
from xitl_cli.plugins.params import push as pushing
from xitl_cli.plugins.params.check import RENAMES, AbsentParameter, DifferingParameter, check_parameters, other_name

Params = Any  # of conftest.py: `xitl params ARGUMENTS`, in this process
BOAT = {"WP_SPEED": 2.0, "WP_RADIUS": 2.0, "CRUISE_SPEED": 0.1, "GPS1_TYPE": 1.0, "ARMING_SKIPCHK": 0.0}
SCRIPTS = {"SCR_ENABLE": 0.0, "EAHRS_TYPE": 0.0}


@pytest.fixture(autouse=True)
def _patient_for_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "CONNECT_S", 0.8)
    monkeypatch.setattr(protocol, "QUIET_S", 0.08)
    monkeypatch.setattr(live, "ANSWER_S", 0.1)
    monkeypatch.setattr(live, "TRIES", 2)


def test_what_is_as_it_should_be_is_counted_in_single_precision() -> None:
    found = check_parameters({"CRUISE_SPEED": 0.1, "WP_SPEED": 2.0}, {"CRUISE_SPEED": 0.10000000149, "WP_SPEED": 2.0})
    assert (found.same, found.fine) == (2, True)


def test_what_differs_has_both_values() -> None:
    assert check_parameters({"WP_SPEED": 3.0}, BOAT).differs == (DifferingParameter("WP_SPEED", 3.0, 2.0),)


def test_a_misspelt_name_gets_the_nearest() -> None:
    (missing,) = check_parameters({"WP_SPED": 3.0}, BOAT).absent
    assert missing.nearest[0] == "WP_SPEED"
    assert missing.sentence(str).startswith("this version does not have it; similar names: WP_SPEED")
    (missing,) = check_parameters({"ZZ_TOP": 3.0}, BOAT).absent
    assert missing.sentence(str) == "this version does not have it"


@pytest.mark.parametrize(
    ("wanted", "present", "name"),
    [
        ("GPS_TYPE", {"GPS1_TYPE": 1.0}, "GPS1_TYPE"),
        ("GPS1_TYPE", {"GPS_TYPE": 1.0}, "GPS_TYPE"),
        ("GPS1_POS_X", {"GPS_POS1_X": 1.0}, "GPS_POS1_X"),
        ("SYSID_THISMAV", {"MAV_SYSID": 1.0}, "MAV_SYSID"),
        ("SR0_EXTRA1", {"MAV1_EXTRA1": 1.0}, "MAV1_EXTRA1"),
    ],
)
def test_a_name_of_another_version_is_known(wanted: str, present: dict[str, float], name: str) -> None:
    (missing,) = check_parameters({wanted: 1.0}, present).absent
    assert missing.nearest == (name,)
    assert missing.sentence(str).startswith(f"this version has it as {name} = 1.0 (")


def test_a_rename_whose_value_means_otherwise_says_so() -> None:
    (missing,) = check_parameters({"ARMING_CHECK": 1.0}, BOAT).absent
    assert "1 becomes 0" in missing.sentence(str)


@pytest.mark.medium
def test_a_push_sets_a_renamed_parameter_by_the_name_that_this_version_has(params: Params, tmp_path: Path) -> None:
    file = tmp_path / "boat.parm"
    file.write_text("ARMING_CHECK 1\nGPS_TYPE 14\n")
    boat = VehicleDouble(BOAT | {"ARMING_SKIPCHK": 64.0})
    with over_tcp(boat) as url:
        ran = params("push", str(file), url, "--json")
    assert ran.code == 0, ran.error
    assert boat.values["ARMING_SKIPCHK"] == 0.0
    assert boat.values["GPS1_TYPE"] == 14.0


def test_a_push_does_not_guess_a_value_that_another_version_means_otherwise(
    params: Params, tmp_path: Path, golden: Golden
) -> None:
    file = tmp_path / "boat.parm"
    file.write_text("ARMING_CHECK 72\n")
    boat = VehicleDouble(BOAT)
    with over_tcp(boat) as url:
        ran = params("push", str(file), url, "--json")
    assert ran.code == 2
    assert boat.values["ARMING_SKIPCHK"] == 0.0
    (refused,) = ran.told["refused"]
    golden("reason", refused["reason"], "4.7")


def test_renames_are_of_names_that_fit_the_wire() -> None:
    assert all(max(len(rename.old), len(rename.new)) <= 16 for rename in RENAMES)
    assert len({rename.old for rename in RENAMES}) == len(RENAMES)
    assert other_name("WP_SPEED", BOAT) is None


@pytest.mark.parametrize(
    ("name", "behind"),
    [("SCR_HEAP_SIZE", "SCR_ENABLE"), ("SCR_SDEV1_PROTO", "SCR_SDEV_EN"), ("EAHRS_RATE", "EAHRS_TYPE")],
)
def test_what_a_switch_hides_is_told_from_what_is_not_there(name: str, behind: str) -> None:
    wanted = {"SCR_ENABLE": 1.0, "SCR_SDEV_EN": 1.0, "EAHRS_TYPE": 1.0, name: 36.0}
    assert AbsentParameter(name, 36.0, behind=behind) in check_parameters(wanted, BOAT | SCRIPTS).absent
    (missing,) = check_parameters({"SCR_NO_SUCH": 1.0}, BOAT | {"SCR_ENABLE": 1.0, "SCR_HEAP_SIZE": 1.0}).absent
    assert missing.behind == ""


# The command


@pytest.mark.medium
def test_a_vehicle_as_it_should_be(params: Params, tmp_path: Path) -> None:
    file = tmp_path / "boat.parm"
    file.write_text("WP_SPEED 2\nCRUISE_SPEED 0.1\n")
    with over_tcp(VehicleDouble(BOAT)) as url:
        ran = params("check", str(file), url)
        told = params("check", str(file), url, "--json")
    assert (ran.code, told.code) == (0, 0)
    assert "ArduPilot Rover (boat)" in ran.out
    assert "2 agree, 0 differ, 0 do not exist" in ran.out
    assert (told.told["same"], told.told["differs"], told.told["absent"]) == (2, [], [])


@pytest.mark.medium
def test_a_vehicle_that_is_otherwise(params: Params, tmp_path: Path, golden: Golden) -> None:
    file = tmp_path / "boat.parm"
    file.write_text("WP_SPEED 3\nGPS_TYPE 14\nCRUISE_SPED 1\n")
    with over_tcp(VehicleDouble(BOAT)) as url:
        ran = params("check", str(file), url)
        told: Any = params("check", str(file), url, "--json").told
    assert ran.code == 1
    golden("table", ran.out, "GPS_TYPE = 14", "GPS1_TYPE = 1", "CRUISE_SPED = 1")
    assert told["differs"] == [{"name": "WP_SPEED", "wanted": 3.0, "kept": 2.0}]
    assert [row["name"] for row in told["absent"]] == ["GPS_TYPE", "CRUISE_SPED"]


@pytest.mark.medium
def test_a_profile_is_checked_with_its_own_parameters(params: Params) -> None:
    with over_tcp(VehicleDouble(BOAT)) as url:
        told = params("check", "hitl-ardupilot-usb", url, "--json").told
    assert "EAHRS_TYPE" in {row["name"] for row in told["absent"]}
    assert "WP_SPEED" in {row["name"] for row in told["differs"]} or told["same"] > 0


@pytest.mark.medium
def test_what_cannot_be_checked_is_one_line(params: Params) -> None:
    assert "there is no parameter file 'no-such'" in params("check", "no-such", "tcp://127.0.0.1:9").error
    assert "has no parameters" in params("check", "environments/calm", "tcp://127.0.0.1:9").error
    assert "no vehicle sent a heartbeat" in params("check", "rover-hil", "tcp://127.0.0.1:9").error


# Pushing


class HidingVehicle(VehicleDouble):
    """SCR_ parameters appear with SCR_ENABLE, as in ArduPilot. crashed: EAHRS_TYPE was set before its port was."""

    crashed = False

    def answer(self, message: Any) -> None:
        super().answer(message)
        if message.get_type() == "PARAM_SET":
            if self.values["SCR_ENABLE"] > 0:
                self.values.setdefault("SCR_SDEV_EN", 0.0)
                self.types.setdefault("SCR_SDEV_EN", self.types["SCR_ENABLE"])
            if self.values.get("SCR_SDEV_EN", 0) > 0:
                self.values.setdefault("SCR_SDEV1_PROTO", -1.0)
                self.types.setdefault("SCR_SDEV1_PROTO", self.types["SCR_ENABLE"])
            self.crashed |= self.values["EAHRS_TYPE"] > 0 and self.values.get("SCR_SDEV1_PROTO") != 36.0


@pytest.mark.medium
def test_hidden_parameters_are_set_as_they_appear_and_the_driver_last(params: Params, tmp_path: Path) -> None:
    file = tmp_path / "hil.parm"
    file.write_text("EAHRS_TYPE 1\nSCR_ENABLE 1\nSCR_SDEV_EN 1\nSCR_SDEV1_PROTO 36\n")
    double = HidingVehicle(BOAT | SCRIPTS)
    with over_tcp(double) as url:
        ran = params("push", str(file), url, "--json")
    assert ran.code == 0
    assert [row["name"] for row in ran.told["set"]] == ["SCR_ENABLE", "SCR_SDEV_EN", "SCR_SDEV1_PROTO", "EAHRS_TYPE"]
    assert not double.crashed


@pytest.mark.medium
def test_what_takes_a_restart_is_said(params: Params, tmp_path: Path, golden: Golden) -> None:
    file = tmp_path / "hil.parm"
    file.write_text("EAHRS_TYPE 1\nSCR_ENABLE 1\nSCR_SDEV_EN 1\n")
    with over_tcp(VehicleDouble(BOAT | SCRIPTS)) as url:
        ran = params("push", str(file), url, "--json")
    reasons = {row["name"]: row["reason"] for row in ran.told["refused"]}
    assert reasons["SCR_SDEV_EN"] == "it appears after a restart with SCR_ENABLE on; add --reboot"
    golden("reason", reasons["EAHRS_TYPE"])


class RestartingVehicle(VehicleDouble):
    """Tells how long it is up, and restarts when it is asked to; parameters appear by that.

    restarts: how often it has. deaf: it says that it will, and does not. forgets: no value outlives a restart.
    """

    def __init__(self, deaf: bool = False, forgets: bool = False) -> None:
        super().__init__(BOAT | SCRIPTS)
        self.restarts = 0
        self._deaf = deaf
        self._forgets = forgets
        self._began_s = time.monotonic() - 1000.0

    def answer(self, message: Any) -> None:
        super().answer(message)
        if message.get_type() != "COMMAND_LONG":
            return
        if message.command == 512 and message.param1 == 2:
            self._codec.system_time_send(0, round((time.monotonic() - self._began_s) * 1000))
        elif message.command == 246:
            self._codec.command_ack_send(246, 0)
            if not self._deaf:
                self._restart()

    def _restart(self) -> None:
        self.restarts += 1
        self._began_s += 200.0
        if self._forgets:
            self.values["WP_SPEED"] = 9.0
        elif self.values["SCR_ENABLE"] > 0:
            self.values.setdefault("SCR_HEAP_SIZE", 10.0)
            self.types.setdefault("SCR_HEAP_SIZE", self.types["SCR_ENABLE"])


@pytest.fixture
def quick_restarts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pushing, "SETTLE_S", 0.0)
    monkeypatch.setattr(pushing, "RETRY_S", 0.5)
    monkeypatch.setattr(pushing, "LOST_MS", 10_000.0)  # the double loses 200 s; an answer may be late


@pytest.mark.medium
@pytest.mark.usefixtures("quick_restarts")
def test_what_appears_by_a_restart_is_set_after_it(params: Params, tmp_path: Path) -> None:
    file = tmp_path / "hil.parm"
    file.write_text("WP_SPEED 1.5\nSCR_ENABLE 1\nSCR_HEAP_SIZE 200\n")
    double = RestartingVehicle()
    with over_tcp(double) as url:
        ran = params("push", str(file), url, "--reboot", "--json")
        again = params("push", str(file), url, "--reboot", "--json")
    assert (ran.code, ran.told["restarts"], ran.told["refused"]) == (0, 2, [])
    assert double.values["SCR_HEAP_SIZE"] == 200.0
    assert (again.code, again.told["restarts"], again.told["set"]) == (0, 0, [])


class FreshBoard(VehicleDouble):
    """Its storage is empty: told takes the parameters of each calibration that it was told to accept."""

    def __init__(self) -> None:
        super().__init__({**BOAT, "EAHRS_TYPE": 7.0, "INS_ACC_ID": 0.0})
        self.told: list[tuple[float, float]] = []

    def answer(self, message: Any) -> None:
        super().answer(message)
        if message.get_type() == "COMMAND_LONG" and message.command == mav.MAV_CMD_PREFLIGHT_CALIBRATION:
            self.told.append((message.param2, message.param5))
            self._codec.command_ack_send(message.command, mav.MAV_RESULT_ACCEPTED)


@pytest.mark.medium
@pytest.mark.parametrize("calibrated", [True, False])
def test_a_calibration_that_was_pushed_is_taken_for_one_once_it_is_in_force(
    params: Params, tmp_path: Path, calibrated: bool
) -> None:
    file = tmp_path / "ahrs.parm"
    file.write_text("EAHRS_TYPE 7\n" + ("INS_ACC_ID 3277342\n" if calibrated else ""))
    double = FreshBoard()
    with over_tcp(double) as url:
        assert params("push", str(file), url).code == 0
        assert double.told == []  # a restart is due
        assert params("push", str(file), url).code == 0
    assert double.told == ([(76.0, 76.0)] if calibrated else [])


@pytest.mark.medium
@pytest.mark.usefixtures("quick_restarts")
def test_a_vehicle_that_keeps_nothing_is_not_restarted_for_ever(params: Params, tmp_path: Path) -> None:
    file = tmp_path / "speed.parm"
    file.write_text("WP_SPEED 1.5\n")
    double = RestartingVehicle(forgets=True)
    with over_tcp(double) as url:
        params("push", str(file), url, "--reboot")
    assert double.restarts == pushing.MOST_RESTARTS


@pytest.mark.medium
@pytest.mark.usefixtures("quick_restarts")
def test_a_restart_that_does_not_happen_is_noticed(
    params: Params, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.setattr(pushing, "RESTART_S", 0.3)
    file = tmp_path / "speed.parm"
    file.write_text("WP_SPEED 1.5\n")
    with over_tcp(RestartingVehicle(deaf=True)) as url:
        ran = params("push", str(file), url, "--reboot")
    golden("stderr", ran.error, "0 s", url=url)
