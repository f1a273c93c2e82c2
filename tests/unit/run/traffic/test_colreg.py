"""Rules 13 to 15 of the COLREGs, by hand-made encounters and by symmetry."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xitl_cli.run.traffic.colreg import EncounterGeometry, encounter_geometry

D = math.pi / 180.0


def seen(bearing_deg: float, other_heading_deg: float, speeds: tuple[float, float] = (3.0, 3.0)) -> EncounterGeometry:
    """0 heads north at the origin and sees 1 on a bearing 100 m away."""
    place = (100.0 * math.cos(bearing_deg * D), 100.0 * math.sin(bearing_deg * D))
    return encounter_geometry(((0.0, 0.0), place), (0.0, other_heading_deg * D), speeds)


@pytest.mark.parametrize(
    ("bearing_deg", "heading_deg", "geometry", "gives_way", "rule"),
    [
        (45.0, 270.0, "crossing", (0,), 15),  # 1 comes from starboard
        (-45.0, 90.0, "crossing", (1,), 15),  # and from port
        (0.0, 180.0, "head-on", (0, 1), 14),
        (5.9, 180.0, "head-on", (0, 1), 14),  # both nearly ahead
        (-5.9, 180.0, "head-on", (0, 1), 14),
        (20.0, 180.0, "head-on", (0, 1), 14),  # each has the other to starboard: in doubt
        (2.0, 188.3, "head-on", (0, 1), 14),  # headings 171.7 degrees apart, bearings 2.0 and -6.3
        (6.4, 192.8, "head-on", (0, 1), 14),  # 167.2 apart
        (6.4, 193.2, "crossing", (0,), 15),  # 166.8 apart: no longer nearly reciprocal
        (13.5, 193.5, "head-on", (0, 1), 14),  # 1 has 0 right ahead: no side at all, so in doubt
        (13.1, 193.2, "crossing", (0,), 15),  # not nearly ahead, and on opposite sides
        (0.0, 0.0, "overtaking", (0,), 13),  # 0 comes up from right astern of 1
        (180.0, 0.0, "overtaking", (1,), 13),
        (30.0, 0.0, "overtaking", (0,), 13),
        (112.4, -60.0, "crossing", (0,), 15),  # 0 would still see a sidelight's sector
        (112.6, -60.0, "overtaking", (1,), 13),  # more than 22.5 degrees abaft the beam
        (-112.4, 60.0, "crossing", (1,), 15),
        (-112.6, 60.0, "overtaking", (1,), 13),
    ],
)
def test_geometry(bearing_deg: float, heading_deg: float, geometry: str, gives_way: tuple[int, ...], rule: int) -> None:
    found = seen(bearing_deg, heading_deg)
    assert (found.geometry, found.gives_way, found.rule) == (geometry, gives_way, rule)
    assert found.stands_on == (None if len(gives_way) == 2 else 1 - gives_way[0])
    assert found.bearings_deg[0] == pytest.approx(bearing_deg if bearing_deg != 180.0 else found.bearings_deg[0])


def test_of_two_stern_to_stern_the_faster_one_overtakes() -> None:
    """Going astern: nobody's bow says who comes up with whom."""
    assert seen(180.0, 180.0, (1.0, 2.0)).gives_way == (1,)
    assert seen(180.0, 180.0, (2.0, 1.0)).gives_way == (0,)


@pytest.mark.medium
@settings(deadline=None)
@given(
    bearing_deg=st.floats(-179, 179), heading_deg=st.floats(-179, 179), turned=st.floats(-math.pi, math.pi)
)  # fmt: skip
def test_it_is_the_same_from_the_other_vessel_and_wherever_north_is(
    bearing_deg: float, heading_deg: float, turned: float
) -> None:
    near_a_limit = any(
        abs(abs(one) - limit) < 1e-6
        for one in seen(bearing_deg, heading_deg).bearings_deg
        for limit in (0, 13, 112.5, 180)
    ) or abs(abs(math.remainder(heading_deg - 180.0, 360.0)) - 13.0) < 1e-6  # fmt: skip
    if near_a_limit:
        return
    found = seen(bearing_deg, heading_deg)
    place = (100.0 * math.cos(bearing_deg * D + turned), 100.0 * math.sin(bearing_deg * D + turned))
    other = encounter_geometry((place, (0.0, 0.0)), (heading_deg * D + turned, turned), (3.0, 3.0))
    assert other.geometry == found.geometry
    if found.geometry != "overtaking" or min(map(abs, found.bearings_deg)) <= 112.5:
        assert sorted(1 - one for one in other.gives_way) == sorted(found.gives_way)
