"""`mission.file` and places by latitude and longitude: what they bring, and what is refused, with its line."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil, mavwp

from agent.fcu.mission import COMMANDS, PERFORMED, STAGES
from agent.fcu.vehicle.commands import ACTIONS
from sim_core.geodesy import LocalFrame
from tests.golden import Golden
from xitl_cli.profile import ProfileError, load_profile, resolved_yaml
from xitl_cli.profile.load import load_with_origins
from xitl_cli.profile.schema import Profile

Write = Callable[..., Path]

PLACES = [(52.4012, 13.0345), (52.4015, 13.0352), (52.4009, 13.0360)]
FRAME = LocalFrame(52.4010, 13.0340, 30.0)
BOAT = """extends: [base-sitl, vehicles/blueboat]
site: {name: lake, latitude_deg: 52.4010, longitude_deg: 13.0340, altitude_m: 30}
"""
WPL = "QGC WPL 110\n" + "".join(
    f"{seq}\t{int(seq == 0)}\t3\t16\t0\t0\t0\t0\t{lat:.8f}\t{lon:.8f}\t10\t1\n"
    for seq, (lat, lon) in enumerate([(52.4, 13.0), *PLACES])
)
LINE = {"type": "LineString", "coordinates": [[lon, lat, 0.0] for lat, lon in PLACES]}
KML = (
    '<?xml version="1.0"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><LineString>\n<coordinates>'
    + " ".join(f"{lon},{lat},0" for lat, lon in PLACES)
    + "</coordinates></LineString></Placemark></Document></kml>"
)
GPX = (
    '<?xml version="1.0"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><rte>\n'
    + "".join(f'<rtept lat="{lat}" lon="{lon}"><name>a</name></rtept>\n' for lat, lon in PLACES)
    + "</rte></gpx>"
)


def _simple(command: int, params: list[float | None], jump_id: int, frame: int = 3) -> dict[str, Any]:
    return {"type": "SimpleItem", "command": command, "frame": frame, "params": params, "doJumpId": jump_id}


def _plan(items: list[dict[str, Any]], **other: Any) -> str:
    mission = {"items": items, "plannedHomePosition": [52.4, 13.0, 30], "version": 2}
    return json.dumps({"fileType": "Plan", "version": 1, "mission": mission, **other}, indent=4)


PLAIN_PLAN = _plan([_simple(16, [0, 0, 0, None, *place, 10], n) for n, place in enumerate(PLACES, start=1)])


def _geodetic(profile: Profile) -> list[tuple[float, float]]:
    assert profile.mission is not None
    ned_m = np.array([[*place, 0.0] for place in profile.mission.course_ned_m])
    lat, lon, _ = FRAME.geodetic(ned_m)
    return list(zip(lat.tolist(), lon.tolist(), strict=True))


def _load(write: Write, file: str, text: str, more: str = "") -> Profile:
    write(text, file)
    return load_profile(str(write(BOAT + f"mission: {{file: {file}{more}}}\n")))


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("course.plan", PLAIN_PLAN),
        ("course.waypoints", WPL),
        ("course.geojson", json.dumps({"type": "Feature", "properties": {}, "geometry": LINE})),
        (
            "points.geojson",
            json.dumps(
                {
                    "type": "FeatureCollection",
                    "features": [
                        {"type": "Feature", "geometry": {"type": "Point", "coordinates": [lon, lat]}}
                        for lat, lon in PLACES
                    ],
                }
            ),
        ),
        ("course.kml", KML),
        ("course.gpx", GPX),
    ],
)
def test_a_course_is_sailed_where_it_was_drawn(write: Write, file: str, text: str) -> None:
    profile = _load(write, file, text)
    assert np.array(_geodetic(profile)) == pytest.approx(np.array(PLACES), abs=2e-8)  # 2 mm
    assert profile.mission is not None
    assert not profile.mission.items
    again = write(resolved_yaml(profile), "again.yaml")
    Path(file).unlink()  # a run keeps what the file had, not the file
    assert load_profile(str(again)).mission == profile.mission


def test_waypoints_are_read_as_pymavlink_reads_them(write: Write) -> None:
    text = WPL + "4\t0\t3\t178\t1\t2.5\t-1\t0\t0\t0\t0\t1\n5\t0\t3\t177\t1\t2\t0\t0\t0\t0\t0\t1\n"
    profile = _load(write, "course.waypoints", text)
    loader = mavwp.MAVWPLoader()
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        file.write(text)
        file.flush()
        assert loader.load(file.name) == 6
    assert profile.mission is not None
    theirs = [loader.wp(seq) for seq in range(1, 6)]
    assert [item.command for item in profile.mission.items] == [one.command for one in theirs]
    assert [item.parameters for item in profile.mission.items] == [
        (one.param1, one.param2, one.param3, one.param4) for one in theirs
    ]
    assert np.array(_geodetic(profile)) == pytest.approx(np.array([(one.x, one.y) for one in theirs[:3]]), abs=2e-8)
    assert profile.mission.items[4].command == mavutil.mavlink.MAV_CMD_DO_JUMP
    assert profile.mission.jumps


@pytest.mark.medium
def test_a_plan_brings_commands_surveys_fence_and_rally_points(write: Write, golden: Golden) -> None:
    corner = [[52.400, 13.030], [52.400, 13.040], [52.404, 13.040], [52.404, 13.030]]
    survey = {
        "type": "ComplexItem",
        "complexItemType": "survey",
        "TransectStyleComplexItem": {"Items": [_simple(16, [0, 0, 0, None, *PLACES[1], 10], 7)]},
    }
    items = [
        _simple(16, [0, 0, 0, None, *PLACES[0], 10], 1),
        _simple(178, [1, 2, -1, 0, 0, 0, 0], 2, frame=2),
        survey,
        _simple(177, [7, 2, 0, 0, 0, 0, 0], 9, frame=2),
    ]
    fence = {
        "version": 2,
        "polygons": [{"polygon": corner, "inclusion": True}],
        "circles": [{"circle": {"center": list(PLACES[2]), "radius": 12.5}, "inclusion": False}],
    }
    rally = {"version": 2, "points": [[52.4011, 13.0341, 0]]}
    write(_plan(items, geoFence=fence, rallyPoints=rally), "course.plan")
    path = str(write(BOAT + "mission: {file: course.plan, rally: []}\n"))
    mission = load_profile(path).mission
    assert mission is not None
    assert [item.command for item in mission.items] == [16, 178, 16, 177]
    assert mission.items[0].parameters == (0.0, 0.0, 0.0, None)
    assert mission.items[3].parameters[0] == 3.0  # doJumpId 7 is the third item on board
    assert tuple(mission.course) == (1, 3)
    assert [(one.command, one.parameters[0]) for one in mission.fence] == [(5001, 4.0)] * 4 + [(5004, 12.5)]
    assert any("FENCE_ENABLE" in text for text in load_with_origins(path).warnings)
    write(BOAT + "mission: {file: course.plan}\n")
    with pytest.raises(ProfileError) as refused:
        load_profile(path)
    golden("error", refused.value)


def test_commands_that_are_passed_over_are_named(write: Write) -> None:
    items = [_simple(16, [0, 0, 0, 0, *PLACES[0], 0], 1), _simple(206, [5, 0, 0, 0, 0, 0, 0], 2, frame=2)]
    write(_plan(items), "course.plan")
    loaded = load_with_origins(str(write(BOAT + "mission: {file: course.plan}\n")))
    assert any("skips 1 (SetCamTrigDst)" in text for text in loaded.warnings)


def test_what_is_named_as_performed_is_what_the_autopilot_performs() -> None:
    assert {*STAGES, *ACTIONS} <= set(PERFORMED) <= set(COMMANDS)
    assert all(not COMMANDS[command].device for command in PERFORMED)


BOMB = '<!DOCTYPE a [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>\n<gpx><rte><rtept lat="&b;" lon="1"/></rte></gpx>'
EXTERNAL = (
    '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]>\n<kml><Point><coordinates>&x;</coordinates></Point></kml>'
)


@pytest.mark.parametrize(
    ("file", "text", "problem"),
    [
        ("a.gpx", BOMB, "a.gpx:1: has a <!DOCTYPE>"),
        ("a.kml", EXTERNAL, "a.kml:1: has a <!DOCTYPE>"),
        ("a.kml", "<kml>" + "<a>" * 200, "a.kml:1: has too many or too deeply nested elements"),
        ("a.gpx", "<gpx>\n<rte>\n</gpx>", "a.gpx:3: is not valid XML: mismatched tag"),
        ("a.gpx", GPX.replace('lat="52.4015"', 'lat="north"'), "a.gpx:4: <rtept> lat: 'north' is not a number"),
        (
            "a.kml",
            KML.replace("LineString", "Polygon"),
            "a.kml:2: <Polygon> is not a course; use a LineString or Points",
        ),
        ("a.waypoints", "52.4 13.0\n", "a.waypoints:1: does not begin with QGC WPL 110"),
        ("a.waypoints", WPL.replace("\t13.0352", "\t"), "a.waypoints:4: item 2: latitude 52.4015, longitude"),
        ("a.waypoints", WPL + "4 0 3 16 0 0\n", "a.waypoints:6: item has 6 columns; QGC WPL has 12"),
        ("a.geojson", '{"type": "Feature"}', "a.geojson: geometry is missing; draw it, or remove the feature"),
        ("a.geojson", '{"type": "Polygon", "coordinates": []}', "a.geojson: type is 'Polygon', which is not a course"),
        ("a.geojson", '{\n"type": ,}', "a.geojson:2: is not valid JSON"),
        ("a.geojson", "[" * 100_000, "a.geojson: is nested too deeply"),
        ("a.plan", '{"fileType": "Fence"}', "a.plan: is not a plan of QGroundControl"),
        (
            "a.plan",
            _plan([{"type": "ComplexItem", "complexItemType": "StructureScan"}]),
            "a.plan: mission.items.0 is a complex item, 'StructureScan', which xitl does not support",
        ),
        (
            "a.plan",
            _plan([_simple(178, [1, 2, 0, 0, 3, 4, 0], 1)]),
            "a.plan: mission.items.0: command 178 (ChangeSpeed) has no place, but its parameters 5 and 6 are 3 and 4",
        ),
        ("a.csv", "1,2", "boat.yaml:3: mission.file = "),
    ],
)
def test_a_file_that_is_wrong_is_refused_with_its_place(write: Write, file: str, text: str, problem: str) -> None:
    if file == "a.waypoints" and "\t13.0352" not in text and "52.4015" in text:
        text = WPL.replace("13.03520000", "213.03520000")
    with pytest.raises(ProfileError) as caught:
        _load(write, file, text)
    assert str(caught.value.problems[0]).startswith(problem)


def test_an_unknown_command_is_refused_by_its_item(write: Write, golden: Golden) -> None:
    with pytest.raises(ProfileError) as refused:
        _load(
            write,
            "a.plan",
            _plan([_simple(16, [0, 0, 0, 0, *PLACES[0], 0], 1), _simple(250, [0] * 7, 2, frame=2)]),
        )
    golden("error", refused.value, "250")


def test_the_file_takes_the_place_of_inherited_waypoints_and_is_given_alone(write: Write) -> None:
    write(WPL, "course.waypoints")
    write(BOAT + "mission: {waypoints_ned_m: [[1, 2]]}\n", "base.yaml")
    laid = str(write("extends: base.yaml\nmission: {file: course.waypoints}\n"))
    assert len(_geodetic(load_profile(laid))) == 3
    assert load_profile(laid, ["mission.waypoints_ned_m=[[5, 6]]"]).mission.course_ned_m == ((5.0, 6.0),)  # type: ignore[union-attr]
    assert len(_geodetic(load_profile("base.yaml", ["mission.file=course.waypoints"]))) == 3
    both = write(BOAT + "mission: {file: course.waypoints, waypoints_ned_m: [[1, 2]]}\n")
    with pytest.raises(ProfileError, match=r"mission\.file and mission\.waypoints_ned_m exclude each other"):
        load_profile(str(both))


PLACED = """mission:
  start: {lat: 52.4012, lon: 13.0345, heading_deg: 20}
  waypoints_ned_m: [{latitude_deg: 52.4015, longitude_deg: 13.0352}, [3, 4]]
world:
  buildings: [{centre_ne_m: {lat: 52.4009, lon: 13.0360}, size_m: [3, 3, 3]}]
  log_boom:
    points_ned_m: [{lat: 52.4012, lon: 13.0345, down_m: 0.5}, [90, 90, 0]]
    float_length_m: 4
    float_radius_m: 0.3
"""


def test_places_are_given_by_latitude_and_longitude_wherever_metres_are(write: Write) -> None:
    profile = load_profile(str(write(BOAT + PLACED)))
    mission, world = profile.mission, profile.world
    assert mission is not None
    assert world is not None
    assert world.log_boom is not None
    points = world.log_boom.points_ned_m
    assert points is not None
    assert points[0][2] == 0.5
    assert mission.start.heading_deg == 20.0
    given = [
        (mission.start.north_m, mission.start.east_m),
        mission.waypoints_ned_m[0],
        world.buildings[0].centre_ne_m,
        points[0][:2],
    ]
    lat, lon, _ = FRAME.geodetic(np.array([[*place, 0.0] for place in given]))
    assert np.stack([lat, lon], axis=1) == pytest.approx(np.array([*PLACES, PLACES[0]]), abs=2e-8)
    assert mission.waypoints_ned_m[1] == (3.0, 4.0)


@pytest.mark.parametrize(
    "text",
    [
        "{lat: 52.4}",
        "{lat: 52.4, lng: 13}",
        "{lat: 95, lon: 13}",
        "{lat: 13.0, lon: 52.4}",
    ],
)
def test_a_place_that_is_wrong_is_named_with_its_line(write: Write, text: str, golden: Golden) -> None:
    path = write(BOAT + f"mission: {{waypoints_ned_m: [{text}]}}\n")
    with pytest.raises(ProfileError) as caught:
        load_profile(str(path))
    golden("problem", caught.value.problems[0])


def test_a_place_needs_a_site(write: Write) -> None:
    path = write("mission: {waypoints_ned_m: [{lat: 52.4, lon: 13}]}\n")
    with pytest.raises(ProfileError, match="add site, the origin of the metres"):
        load_profile(str(path))
