"""QGroundControl's parameter files: what is read, what is refused, and that what is written is read again."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.mavparm import MAVParmDict

from agent.mavlink.parameter_rows import ParameterError
from xitl_cli.params.values import ParameterSet, file_text, format_value
from xitl_cli.profile.files.parameter_files import (
    is_station_file,
    load_station_file,
    read_parameter_file,
    station_file_text,
)
from xitl_cli.shipped import firmware_params_dir

# The head and first rows of a file that QGroundControl saved of a PX4.
SAVED = """# Onboard parameters for Vehicle 1
#
# Stack: PX4 Pro
# Vehicle: Ground Rover
# Version: 1.16.0
# Git Revision: 6ea3539157
#
# Vehicle-Id Component-Id Name Value Type
1\t1\tCAL_ACC0_ID\t1310988\t6
1\t1\tRO_SPEED_LIM\t3.000000000000000000\t9
1\t154\tMNT_MODE\t2\t6
"""


def test_what_a_ground_station_saved_is_read(tmp_path: Path) -> None:
    (tmp_path / "rover.params").write_text(SAVED)
    assert read_parameter_file(str(tmp_path / "rover.params")) == {"CAL_ACC0_ID": 1310988, "RO_SPEED_LIM": 3.0}


def test_it_is_known_by_its_columns_whatever_its_name(tmp_path: Path) -> None:
    (tmp_path / "rover.param").write_text(SAVED)
    assert read_parameter_file(str(tmp_path / "rover.param"))["RO_SPEED_LIM"] == 3.0
    assert not is_station_file("WP_SPEED 2.5\nCRUISE_SPEED,3\n")
    (tmp_path / "boat.params").write_text("WP_SPEED 2.5\n")
    assert read_parameter_file(str(tmp_path / "boat.params")) == {"WP_SPEED": 2.5}


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        ("1\t1\tRO_SPEED_LIM\t3", "p:2: expected Vehicle-Id Component-Id Name Value Type, found"),
        ("1\t1\tRO_SPEED_LIM\tfast\t9", "p:2: RO_SPEED_LIM = 'fast' is not a number"),
        ("1\t1\tRO_SPEED_LIM\tnan\t9", "p:2: RO_SPEED_LIM = nan is not a finite number"),
        ("1\t1\tCA_R_REV\t2.5\t6", "p:2: CA_R_REV = 2.5 is not a value of its type 6"),
        ("1\t1\tCA_R_REV\t300\t2", "p:2: CA_R_REV = 300 is not a value of its type 2"),
        ("1\t1\tCA_R_REV\t3\t77", "p:2: CA_R_REV has an unknown type 77"),
    ],
)
def test_a_row_that_is_none_is_refused_with_its_line(row: str, problem: str) -> None:
    with pytest.raises(ParameterError) as raised:
        load_station_file(f"1\t1\tA\t1\t6\n{row}\n", "p")
    assert str(raised.value).startswith(problem)


def test_what_is_written_is_read_again() -> None:
    values, types = {"A_WHOLE": 123456789.0, "B_REAL": 0.1}, {"A_WHOLE": 6, "B_REAL": 9}
    text = station_file_text(values, types, (7, 1), "udp://here:1", format_value)
    assert "7\t1\tA_WHOLE\t123456789\t6\n" in text
    assert load_station_file(text, "p") == values


def test_the_name_of_a_file_says_its_format() -> None:
    found = ParameterSet("tcp://here:1", {"A": 1.0}, True, {"A": 6}, (1, 1))
    assert file_text(found, "a.params").endswith("1\t1\tA\t1\t6\n")
    assert file_text(found, "a.parm").split("\n")[1].split() == ["A", "1"]


@pytest.mark.parametrize("name", ["px4-rover", "px4-hitl"])
def test_shipped_files_of_px4(name: str, tmp_path: Path) -> None:
    """A tool of others that takes NAME value reads the same: the columns are where it wants them."""
    values = read_parameter_file(name)
    path = firmware_params_dir() / f"{name}.params"
    theirs = MAVParmDict()
    (tmp_path / "plain.parm").write_text(
        "".join(" ".join(line.split()[2:4]) + "\n" for line in path.read_text().splitlines() if line[:1] != "#")
    )
    theirs.load(str(tmp_path / "plain.parm"))
    assert values == {key: theirs[key] for key in theirs} != {}
    assert all(len(key) <= 16 for key in values)
