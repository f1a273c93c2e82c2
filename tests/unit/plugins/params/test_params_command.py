"""`xitl params` on files and on a vehicle built on pymavlink's codec."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav
from pymavlink.mavparm import MAVParmDict
from vehicle_double import Px4Vehicle, VehicleDouble, over_tcp, over_udp

from agent.fcu.parameters import TABLE
from agent.mavlink import parameters as protocol
from agent.mavlink.parameters import as_float32
from tests.free_ports import free_port
from tests.golden import Golden
from xitl_cli.params import vehicle as live
from xitl_cli.params.values import ParameterDifference, ParameterSet, differences, format_value, parm_text

Params = Callable[..., Any]

ROVER = {f"PAR_{number:03d}": number * 0.37 for number in range(150)} | {
    "WP_SPEED": 2.0,
    "FRAME_CLASS": 2.0,
    "CRUISE_SPEED": 0.1,
}


@pytest.fixture(autouse=True)
def _patient_for_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "CONNECT_S", 0.8)
    monkeypatch.setattr(protocol, "QUIET_S", 0.08)
    monkeypatch.setattr(live, "ANSWER_S", 0.1)


def _rounded(values: dict[str, float]) -> dict[str, float]:
    return {name: struct.unpack("<f", struct.pack("<f", value))[0] for name, value in values.items()}


# Files


@pytest.mark.medium
def test_a_file_is_shown_with_units_and_meanings(params: Params, tmp_path: Path) -> None:
    (tmp_path / "boat.parm").write_text("WP_SPEED 2.5 # fast\nATC_SPEED_P,0.7\n")
    ran = params("show", str(tmp_path / "boat.parm"), "--json")
    rows = {row["name"]: row for row in ran.told["parameters"]}
    table = {row.name: row for row in TABLE}
    assert rows["WP_SPEED"]["value"] == 2.5
    assert rows["WP_SPEED"]["unit"] == "m/s"
    assert rows["WP_SPEED"]["default"] == table["WP_SPEED"].default
    assert rows["ATC_SPEED_P"]["meaning"] == table["ATC_SPEED_P"].meaning
    assert "WP_SPEED" in params("show", str(tmp_path / "boat.parm")).out


@pytest.mark.medium
def test_a_pattern_picks_names(params: Params) -> None:
    names = {row["name"] for row in params("show", "defaults", "--filter", "wp_*", "--json").told["parameters"]}
    assert names == {row.name for row in TABLE if row.name.startswith("WP_")}
    assert "none of its" in params("show", "defaults", "--filter", "ZZ*").error


@pytest.mark.medium
def test_what_a_file_leaves_out_is_no_difference_but_a_name_that_does_not_exist_is(
    params: Params, tmp_path: Path
) -> None:
    speed = next(row.default for row in TABLE if row.name == "WP_SPEED")
    (tmp_path / "boat.parm").write_text(f"WP_SPEED {speed + 1}\nNO_SUCH 1\nWP_RADIUS 2\n")
    ran = params("diff", str(tmp_path / "boat.parm"), "defaults", "--json")
    assert ran.code == 1
    assert ran.told["differences"] == [
        {"name": "NO_SUCH", "one": 1.0, "other": None},
        {"name": "WP_SPEED", "one": speed + 1, "other": speed},
    ]
    same = params("diff", "defaults", "defaults")
    assert (same.code, same.out.strip()) == (0, "no differences")


def test_values_are_compared_as_they_go_over_the_wire() -> None:
    one = ParameterSet("a", {"A": 0.1, "B": 16777217.0, "C": 1.0}, complete=True)
    other = ParameterSet("b", {"A": as_float32(0.1), "B": 16777216.0, "C": 1.0000002}, complete=True)
    assert differences(one, other) == [ParameterDifference("C", 1.0, 1.0000002)]


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1e-9, 123456.789, 16777216.0, -0.0, 3.4e38])
def test_a_value_is_written_so_that_it_comes_back(value: float) -> None:
    assert as_float32(float(format_value(as_float32(value)))) == as_float32(value)
    assert len(format_value(as_float32(0.1))) == 3


def test_a_written_file_reads_in_pymavlink(tmp_path: Path) -> None:
    path = tmp_path / "boat.parm"
    path.write_text(parm_text({row.name: row.default for row in TABLE}, "a boat"))
    read = MAVParmDict()
    assert read.load(str(path), use_excludes=False)
    assert {name: pytest.approx(read[name], rel=1e-6) for name in read} == {row.name: row.default for row in TABLE}
    assert "# " in path.read_text().splitlines()[5]


@pytest.mark.medium
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("show", "embeded-asv-full"), ("did you mean 'embedded-asv-full'?", "tcp://host:port")),
        (("show", "gone.parm"), ("gone.parm does not exist",)),
        (("show", "can://x:1"), ("is no address of a vehicle", "udp://host:port or serial:///dev/ttyACM0")),
        (("show", "serial://x:1"), ("write it like serial:///dev/ttyACM0",)),
        (("show", "tcp://127.0.0.1"), ("port is missing",)),
        (("pull", "boat.parm", "x.parm"), ("'boat.parm' is not an address of a vehicle",)),
        (("pull", "tcp://127.0.0.1:9", "/no/where/x.parm"), ("/no/where: is not a folder",)),
        (("set", "tcp://127.0.0.1:9", "WP_SPEED"), ("'WP_SPEED' is not NAME=VALUE with a number",)),
        (("set", "tcp://127.0.0.1:9", "WP_SPEED=nan"), ("is not NAME=VALUE with a number",)),
        (("push", "defaults", "tcp://127.0.0.1:9"), ("there is no parameter file 'defaults'",)),
        (
            ("show", "tcp://127.0.0.1:9", "--signing-key", "gone"),
            ("gone: the signing key is missing", "or leave --signing-key out"),
        ),
    ],
)
def test_what_is_wrong_is_one_line(params: Params, arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    ran = params(*arguments)
    assert ran.code == 2
    assert "\n" not in ran.error
    for word in words:
        assert word in ran.error


@pytest.mark.medium
def test_a_broken_file_is_named_with_its_line(params: Params, tmp_path: Path) -> None:
    (tmp_path / "boat.parm").write_text("WP_SPEED 2\nWP_RADIUS two\n")
    assert "boat.parm:2: WP_RADIUS = 'two' is not a number" in params("show", str(tmp_path / "boat.parm")).error
    (tmp_path / "raw.parm").write_bytes(b"\xff\xfe\x00")
    assert "is not text" in params("show", str(tmp_path / "raw.parm")).error


# A vehicle


@pytest.mark.medium
@pytest.mark.parametrize("lose", [0, 3])
def test_all_parameters_come_over_tcp_whatever_gets_lost(params: Params, lose: int) -> None:
    with over_tcp(VehicleDouble(ROVER, lose)) as url:
        told = params("show", url, "--json").told["parameters"]
    assert {row["name"]: row["value"] for row in told} == _rounded(ROVER)
    assert [row["name"] for row in told] == list(ROVER)
    assert all(row["meaning"] is None for row in told)  # not the embedded autopilot's: its table says nothing of them


class LateNeighbour(VehicleDouble):
    """Another system sends heartbeats at the same port, but first some time after the parameters."""

    later = 0

    def _heartbeat(self) -> None:
        super()._heartbeat()
        if self._listed:
            self.later += 1
        if self.later > 5:
            neighbour = mav.MAVLink(self._codec.file, 2, 1)
            neighbour.heartbeat_send(mav.MAV_TYPE_SURFACE_BOAT, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 1, 0, 3)


@pytest.mark.medium
def test_a_read_is_refused_too_if_another_vehicle_is_heard_after_it(
    params: Params, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "OTHERS_S", 3.0)
    with over_tcp(LateNeighbour(ROVER)) as url:
        ran = params("show", url)
    assert ran.code == 2
    assert "systems 1, 2 send there; select one of them with ?system=" in ran.error


@pytest.mark.medium
def test_over_udp_the_vehicle_is_waited_for_as_a_ground_station_does(params: Params) -> None:
    with over_udp(VehicleDouble(ROVER), free_port()) as url:
        told = params("show", url, "--filter", "wp_speed", "--json").told["parameters"]
    assert [(row["name"], row["value"]) for row in told] == [("WP_SPEED", 2.0)]


@pytest.mark.medium
def test_a_push_sets_what_differs_and_no_more(params: Params, tmp_path: Path) -> None:
    file = tmp_path / "boat.parm"
    file.write_text("CRUISE_SPEED 0.1\nWP_SPEED 3.25\nPAR_003 7\nFRAME_CLASS 1\n")
    double = VehicleDouble(ROVER, lose=4)
    with over_tcp(double) as url:
        ran = params("push", str(file), url, "--json")
        again = params("push", str(file), url, "--json")
    assert ran.code == 0
    assert [(change["name"], change["value"]) for change in ran.told["set"]] == [
        ("WP_SPEED", 3.25),
        ("PAR_003", 7.0),
        ("FRAME_CLASS", 1.0),
    ]
    assert ran.told["unchanged"] == 1
    assert {name for name, _, _ in double.sets} == {"WP_SPEED", "PAR_003", "FRAME_CLASS"}
    assert {kind for name, _, kind in double.sets if name == "FRAME_CLASS"} == {double.types["FRAME_CLASS"]}
    assert double.values["PAR_003"] == 7.0
    assert (again.told["set"], again.told["unchanged"]) == ([], 4)


@pytest.mark.medium
def test_a_push_of_a_profile_sets_all_its_files_and_its_own_values(params: Params, tmp_path: Path) -> None:
    (tmp_path / "one.parm").write_text("WP_SPEED 3\nPAR_003 7\n")
    (tmp_path / "other.parm").write_text("WP_SPEED 3.25\n")
    profile = tmp_path / "boat.yaml"
    files = [str(tmp_path / "one.parm"), str(tmp_path / "other.parm")]
    text = {"extends": "hitl-ardupilot-usb", "autopilot": {"parameter_files": files, "parameters": {"PAR_001": 5}}}
    profile.write_text(json.dumps(text))
    double = VehicleDouble(ROVER)
    with over_tcp(double) as url:
        ran = params("push", str(profile), url, "--json")
    assert ran.code == 0, ran.error
    assert {change["name"]: change["value"] for change in ran.told["set"]} == {
        "WP_SPEED": 3.25,
        "PAR_003": 7.0,
        "PAR_001": 5.0,
    }


@pytest.mark.medium
def test_what_a_vehicle_refuses_is_said_with_its_own_words(params: Params, tmp_path: Path) -> None:
    file = tmp_path / "boat.parm"
    file.write_text("WP_SPEED 3\nPAR_001 5\nNO_SUCH 1\nFRAME_CLASS 1.5\n")
    with over_tcp(VehicleDouble(ROVER, stubborn=("PAR_001",))) as url:
        ran = params("push", str(file), url, "--json")
    assert ran.code == 2
    assert "PAR_001 = 5 was refused" in ran.error
    assert "(and 2 more)" in ran.error
    assert [change["name"] for change in ran.told["set"]] == ["WP_SPEED"]
    reasons = {change["name"]: change["reason"] for change in ran.told["refused"]}
    said = "PAR_001: set denied because the vessel is armed and under way right now"
    assert reasons["PAR_001"] == f"the vehicle keeps 0.37: {said}"
    assert reasons["NO_SUCH"] == "this version does not have it"
    assert reasons["FRAME_CLASS"] == "the vehicle keeps 1"


@pytest.mark.medium
def test_set_reads_back(params: Params, golden: Golden) -> None:
    double = VehicleDouble(ROVER)
    with over_tcp(double) as url:
        ran = params("set", url, "wp_speed=3.5", "CRUISE_SPEED=0.1")
        unknown = params("set", url, "WP_SPED=3")
    assert "WP_SPEED = 2 → 3.5" in ran.out
    assert "1 set, 0 refused, 1 unchanged" in ran.out
    assert double.values["WP_SPEED"] == 3.5
    golden("stderr", unknown.error, url=url)


@pytest.mark.slow
def test_a_pulled_file_pushes_back_as_nothing(params: Params, tmp_path: Path) -> None:
    file = str(tmp_path / "boat.parm")
    double = VehicleDouble(ROVER, lose=5)
    with over_tcp(double) as url:
        assert params("pull", url, file).code == 0
        assert params("diff", file, url).code == 0
        assert params("push", file, url, "--json").told == {
            "vehicle": url,
            "set": [],
            "refused": [],
            "unchanged": len(ROVER),
        }
        assert "exists; choose another name or add --overwrite" in params("pull", url, file).error
        assert params("pull", url, file, "--overwrite").code == 0
    assert double.sets == []


@pytest.mark.medium
def test_a_px4_keeps_whole_numbers_in_their_bytes(params: Params, tmp_path: Path) -> None:
    """pymavlink's codec at the other end, and INT32 as PX4 1.16 sends it: the value's bytes in the field."""
    rover = Px4Vehicle({"CA_R_REV": 3, "CAL_ACC0_ID": 1310988, "RO_SPEED_LIM": 1.5}, whole=("CA_R_REV", "CAL_ACC0_ID"))
    with over_tcp(rover) as url:
        shown = {row["name"]: row["value"] for row in params("show", url, "--json").told["parameters"]}
        assert shown == {"CA_R_REV": 3, "CAL_ACC0_ID": 1310988, "RO_SPEED_LIM": 1.5}
        assert params("pull", url, str(tmp_path / "rover.params")).code == 0
        assert params("diff", url, str(tmp_path / "rover.params")).code == 0
        wanted = (tmp_path / "rover.params").read_text().replace("CA_R_REV\t3", "CA_R_REV\t1").replace("\t1.5", "\t2.5")
        (tmp_path / "wanted.params").write_text(wanted)
        assert params("diff", url, str(tmp_path / "wanted.params")).code == 1
        told = params("check", str(tmp_path / "wanted.params"), url, "--json").told
        assert told["firmware"].startswith("PX4 Rover")
        assert [row["name"] for row in told["differs"]] == ["CA_R_REV", "RO_SPEED_LIM"]
        assert params("push", str(tmp_path / "wanted.params"), url).code == 0
        assert rover.values == {"CA_R_REV": 1, "CAL_ACC0_ID": 1310988, "RO_SPEED_LIM": 2.5}
        assert "is not a value of this integer parameter" in params("set", url, "CA_R_REV=1.5").error
        assert params("set", url, "CA_R_REV=2").code == 0
        assert rover.values["CA_R_REV"] == 2
        assert "remove --with-script" in params("push", "px4-rover", url, "--with-script").error


@pytest.mark.slow
def test_a_vehicle_that_never_answers(params: Params) -> None:
    with over_tcp(VehicleDouble({})) as url:
        assert "the vehicle sends no parameters" in params("show", url).error
    with over_tcp(VehicleDouble(ROVER, lose=1)) as url:
        assert "the vehicle sends no parameters" in params("show", url).error
    assert "no vehicle sent a heartbeat for 1 s" in params("show", "tcp://127.0.0.1:9").error
