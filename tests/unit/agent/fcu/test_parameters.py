"""The parameter table, its store, and .parm files."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import strict_zip

from agent.fcu.parameters import SYSTEM_ID, TABLE, Parameters
from agent.mavlink.parameter_rows import ParameterError, load_parm
from tests.golden import Golden

FIRMWARE_PARAMS = Path(__file__).parents[4] / "firmware_params"


def test_the_table_is_sound() -> None:
    names = [row.name for row in TABLE]
    assert names == sorted(set(names))
    for row in TABLE:
        assert row.low <= row.default <= row.high, row.name
        assert len(row.name) <= 16  # what PARAM_VALUE holds
        assert row.meaning


def test_defaults_and_limits_change_only_on_purpose(golden: Golden) -> None:
    """Failsafes, fence and gains act by these numbers. Of channels, outputs and motors, only those of the first."""
    rows = [row for row in TABLE if not re.match(r"[A-Z]+([02-9]|1\d)", row.name)]
    lines = [f"{row.name} {row.default:.9g}, {row.low:.9g} to {row.high:.9g} {row.unit}".strip() for row in rows]
    golden("table", "\n".join(lines))


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("WP_SPEDE", 1.0, "WP_SPEDE is not a parameter; did you mean WP_SPEED"),
        ("WP_SPEED", math.nan, "WP_SPEED = nan is out of range; use 0.1 to 100 m/s"),
        ("WP_SPEED", math.inf, "out of range"),
        ("WP_SPEED", 0.0, "out of range"),
        ("MIS_DONE_BEHAVE", 2.0, "MIS_DONE_BEHAVE = 2 is out of range; use 0 to 1"),
    ],
)
def test_nonsense_is_refused_and_nothing_changes(name: str, value: float, words: str) -> None:
    parameters = Parameters()
    before = parameters.as_parm(), parameters.version
    with pytest.raises(ParameterError, match=words):
        parameters.set(name, value)
    assert (parameters.as_parm(), parameters.version) == before


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.name)
def test_limits_survive_a_32_bit_float(row) -> None:
    for limit in (row.low, row.high):
        parameters = Parameters(system_id=int(limit)) if row.name == SYSTEM_ID else Parameters()
        on_wire = struct.unpack("<f", struct.pack("<f", limit))[0]
        assert row.low <= parameters.set(row.name, on_wire) <= row.high


def test_the_system_is_what_it_was_started_as_whatever_is_set(golden: Golden) -> None:
    parameters = Parameters(system_id=7)
    assert (parameters["SYSID_THISMAV"], parameters.set("SYSID_THISMAV", 7.0)) == (7.0, 7.0)
    with pytest.raises(ParameterError) as refused:
        parameters.set("SYSID_THISMAV", 8.0)
    golden("error", refused.value)
    with pytest.raises(ParameterError, match=r"boat.parm:2: SYSID_THISMAV = 8 is refused"):
        parameters.load("WP_SPEED 1\nSYSID_THISMAV 8\n", "boat.parm")
    assert (parameters["SYSID_THISMAV"], parameters["WP_SPEED"], parameters.version) == (7.0, 3.0, 0)


def test_version_counts_changes_only() -> None:
    parameters = Parameters()
    parameters.set("WP_SPEED", 3.0)
    assert parameters.version == 0
    parameters.set("WP_SPEED", 2.0)
    assert parameters.version == 1


def test_parm_text_of_both_spellings() -> None:
    text = "# boat\n\nWP_SPEED 2.5   # slow\nwp_radius,3\r\nLOS_KAPPA\t0.5\n"
    assert load_parm(text) == {"WP_SPEED": 2.5, "WP_RADIUS": 3.0, "LOS_KAPPA": 0.5}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("WP_SPEED", "boat.parm:3: expected NAME value, found 'WP_SPEED'"),
        ("WP_SPEED 1 2", "boat.parm:3: expected NAME value"),
        ("WP_SPEED fast", "boat.parm:3: WP_SPEED = 'fast' is not a number"),
        ("WP_SPEED nan", "boat.parm:3: WP_SPEED = nan is not a finite number"),
        ("WP_SPEED 1000", "boat.parm:3: WP_SPEED = 1000 is out of range"),
        ("SPEED 1", "boat.parm:3: SPEED is not a parameter"),
    ],
)
def test_a_bad_line_is_named_and_nothing_is_set(line: str, words: str) -> None:
    parameters = Parameters()
    with pytest.raises(ParameterError, match=words):
        parameters.load(f"# first\nWP_RADIUS 5\n{line}\n", "boat.parm")
    assert parameters["WP_RADIUS"] == 2.0


@pytest.mark.medium
@given(st.text(max_size=200))
def test_any_text_loads_or_is_refused(text: str) -> None:
    parameters = Parameters()
    before = parameters.as_parm()
    try:
        parameters.load(text)
    except ParameterError:
        refused = True
    else:
        refused = False
    assert not refused or parameters.as_parm() == before


@pytest.mark.parametrize("path", sorted(FIRMWARE_PARAMS.glob("embedded-*.parm")), ids=lambda path: path.name)
def test_shipped_files_load(path: Path) -> None:
    Parameters().load(path.read_text(), str(path))


def test_the_full_size_file_agrees_with_the_defaults() -> None:
    values = load_parm((FIRMWARE_PARAMS / "embedded-asv-full.parm").read_text())
    defaults = {row.name: row.default for row in TABLE}
    assert {name: defaults[name] for name in values} == values


def test_as_parm_loads_again() -> None:
    parameters = Parameters({"WP_SPEED": 1.7, "COMPASS_DEC": -0.24})
    again = Parameters()
    again.load(parameters.as_parm())
    assert dict(strict_zip(again, map(again.__getitem__, again))) == pytest.approx(
        dict(strict_zip(parameters, map(parameters.__getitem__, parameters)))
    )
