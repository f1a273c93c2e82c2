"""Places by latitude and longitude in a profile: where they are in metres, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sim_core.geodesy import LocalFrame
from xitl_cli.profile.files.entry import ProfileError
from xitl_cli.profile.files.yaml_file import parse_yaml
from xitl_cli.profile.geographic import with_places_in_metres

SITE = "site: {latitude_deg: 52.0, longitude_deg: 13.0, altitude_m: 40}\n"


def converted(text: str, site: str = SITE) -> Any:
    """The keys of a profile after the conversion."""
    entry = parse_yaml(site + text, "test.yaml")
    assert entry is not None
    return with_places_in_metres(entry, "test").plain()


def problems(text: str, site: str = SITE) -> list[str]:
    with pytest.raises(ProfileError) as refused:
        converted(text, site)
    return [problem.sentence for problem in refused.value.problems]


def radii_m() -> tuple[float, float]:
    """Of the meridian and of the parallel at 52° and 40 m (WGS 84)."""
    a, e2, sine = 6378137.0, 6.69437999014e-3, math.sin(math.radians(52.0))
    w2 = 1.0 - e2 * sine * sine
    return a * (1.0 - e2) / w2**1.5 + 40.0, (a / math.sqrt(w2) + 40.0) * math.cos(math.radians(52.0))


def test_waypoints_are_north_and_east_of_the_site_in_millimetres() -> None:
    read = converted("mission: {waypoints_ned_m: [{lat: 52.001, lon: 13.0}, {lat: 52.0, lon: 12.998}, [5.0, 6.0]]}\n")
    first, second, third = read["mission"]["waypoints_ned_m"]
    meridian_m, parallel_m = radii_m()
    assert list(first) == pytest.approx([math.radians(0.001) * meridian_m, 0.0], abs=2e-3)
    assert list(second) == pytest.approx([0.0, -math.radians(0.002) * parallel_m], abs=3e-3)
    assert list(third) == [5.0, 6.0]
    assert first[0] == round(first[0], 3)
    assert math.copysign(1.0, first[1]) == 1.0  # not -0


def test_a_converted_place_converts_back_to_its_degrees() -> None:
    read = converted("mission: {waypoints_ned_m: [{latitude_deg: 52.3, longitude_deg: 13.4}]}\n")
    ((north_m, east_m),) = read["mission"]["waypoints_ned_m"]
    frame = LocalFrame(52.0, 13.0, 40.0)
    lat, lon, _ = frame.geodetic(np.array([[north_m, east_m, 0.0]]))
    assert (float(lat[0]), float(lon[0])) == pytest.approx((52.3, 13.4), abs=2e-8)


def test_a_place_may_have_a_depth_and_a_start_its_heading() -> None:
    read = converted(
        "mission:\n"
        "  start: {lat: 52.0, lon: 13.001, heading_deg: 90}\n"
        "world: {log_boom: {points_ned_m: [{lat: 52.0, lon: 13.0, down_m: 2.5}, {lat: 52.0, lon: 13.0}]}}\n"
    )
    start = read["mission"]["start"]
    assert set(start) == {"north_m", "east_m", "heading_deg"}
    assert start["heading_deg"] == 90
    assert start["north_m"] == pytest.approx(0.0, abs=2e-3)
    assert start["east_m"] == pytest.approx(math.radians(0.001) * radii_m()[1], abs=2e-3)
    assert [list(point) for point in read["world"]["log_boom"]["points_ned_m"]] == [[0.0, 0.0, 2.5], [0.0, 0.0, 0.0]]


def test_places_of_vessels_and_of_the_world_are_converted_too() -> None:
    read = converted("vessels: {a: {mission: {waypoints_ned_m: [{lat: 52.0, lon: 13.0}]}}}\n")
    assert [list(place) for place in read["vessels"]["a"]["mission"]["waypoints_ned_m"]] == [[0.0, 0.0]]


def test_a_profile_without_degrees_is_the_same_object() -> None:
    entry = parse_yaml(SITE + "mission: {waypoints_ned_m: [[1.0, 2.0]]}\n", "test.yaml")
    assert entry is not None
    assert with_places_in_metres(entry, "test").plain() == entry.plain()


@pytest.mark.parametrize(
    ("place", "told"),
    [
        ("{lat: 52.0, lng: 13.0}", ".lng is not a key of a place; did you mean 'lon'?"),
        ("{lat: 52.0, lon: 13.0, up_m: 1}", ".up_m is not a key of a place; use lat, lon"),
        ("{lat: 52.0}", " needs 'lon'; add it in degrees"),
        ("{longitude_deg: 13.0}", " needs 'latitude_deg'; add it in degrees"),
        ("{lat: 90.5, lon: 13.0}", ".lat = 90.5 is not between -90 and 90 degrees"),
        ("{lat: 52.0, lon: -181}", ".lon = -181 is not between -180 and 180 degrees"),
        ("{lat: true, lon: 13.0}", ".lat = true is not between -90 and 90 degrees"),
        ("{lat: north, lon: 13.0}", ".lat = 'north' is not between -90 and 90 degrees"),
        ("{lat: .nan, lon: 13.0}", ".lat = nan is not between -90 and 90 degrees"),
    ],
)
def test_an_invalid_place_is_told_with_its_key(place: str, told: str) -> None:
    (text,) = problems(f"mission: {{waypoints_ned_m: [{place}]}}\n")
    assert text.startswith("mission.waypoints_ned_m.0")
    assert text.removeprefix("mission.waypoints_ned_m.0") == told


@pytest.mark.parametrize("longitude_deg", [-180.0, 180.0])
def test_the_limits_of_degrees_are_places(longitude_deg: float) -> None:
    site = "site: {latitude_deg: 0.0, longitude_deg: 180.0}\n"
    read = converted(f"mission: {{waypoints_ned_m: [{{lat: 0.0, lon: {longitude_deg}}}]}}\n", site)
    assert list(read["mission"]["waypoints_ned_m"][0]) == pytest.approx([0.0, 0.0], abs=1e-3)


def test_a_place_beyond_100_km_is_taken_for_a_mistake() -> None:
    east = math.degrees(99_900.0 / radii_m()[1])
    converted(f"mission: {{waypoints_ned_m: [{{lat: 52.0, lon: {13.0 + east}}}]}}\n")
    (text,) = problems("mission: {waypoints_ned_m: [{lat: 13.0, lon: 52.0}]}\n")
    half = math.sin(math.radians(39.0) / 2) ** 2
    half += math.cos(math.radians(52.0)) * math.cos(math.radians(13.0)) * math.sin(math.radians(39.0) / 2) ** 2
    away_km = 2.0 * 6371.0 * math.asin(math.sqrt(half))  # haversine
    assert text == (
        f"mission.waypoints_ned_m.0 = 13, 52 is {away_km:.0f} km from the site; check the order of the two numbers, or "
        "move the site"
    )


@pytest.mark.parametrize(
    "site", ["name: x\n", "site: {latitude_deg: 52.0}\n", "site: {latitude_deg: a, longitude_deg: 3}\n"]
)
def test_degrees_need_a_site(site: str) -> None:
    (text,) = problems("mission: {waypoints_ned_m: [{lat: 52.0, lon: 13.0}]}\n", site)
    assert text == "mission.waypoints_ned_m.0 is a latitude and a longitude; add site, the origin of the metres"


def test_all_problems_are_told_at_once() -> None:
    assert len(problems("mission: {waypoints_ned_m: [{lat: 52.0}, {lon: 13.0}, {lat: 52.0, lon: 13.0}]}\n")) == 2
