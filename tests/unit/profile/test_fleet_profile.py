"""`vessels`: what each inherits, what one entry with a count becomes, and what comes back from the resolved text."""

import math

import pytest

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.profile import Profile, ProfileError, load_profile, load_with_origins, resolved_yaml

WATER = "extends: [bases/base-sitl, sites/santo-antonio, vehicles/asv-full]\n"
CONVOY = (
    WATER
    + """mission: {start: {north_m: 100, east_m: -50, heading_deg: 90}, waypoints_ned_m: [[100, 0], [120, 0]]}
vessels:
  leader: {}
  follower:
    count: 3
    formation: {shape: column, spacing_m: 10}
    driver: {kind: follow, follow: {vessel: leader, offset_frd_m: [-10, 0]}}
  other: {extends: vehicles/otter, mission: {start: {north_m: 0, east_m: -60}}, autopilot: {system_id: 2}}
  barge: {traffic: {track_ned_m: [[0, -120], [300, -120]], speed_mps: 2.0, length_m: 60, beam_m: 12}}
"""
)


@pytest.fixture
def fleet(tmp_path):
    def load(text: str, *overrides: str) -> Profile:
        path = tmp_path / "fleet.yaml"
        path.write_text(text, encoding="utf-8")
        return load_profile(str(path), overrides)

    return load


def starts(profile: Profile) -> dict[str, tuple[float, float]]:
    found = {name: vessel.mission.start for name, vessel in profile.sailed.items()}
    return {name: (start.north_m, start.east_m) for name, start in found.items()}


def test_a_vessel_has_what_the_profile_has_unless_it_says_otherwise(fleet):
    vessels = fleet(CONVOY).vessels
    assert list(vessels) == ["leader", "follower_1", "follower_2", "follower_3", "other", "barge"]
    assert vessels["leader"].vehicle.name == vessels["follower_3"].vehicle.name == "asv-full"
    assert vessels["leader"].mission.waypoints_ned_m == ((100.0, 0.0), (120.0, 0.0))
    assert vessels["leader"].sensors == load_profile("bases/base-sitl").sensors
    otter = load_profile("vehicles/otter")
    assert vessels["other"].vehicle == otter.vehicle
    assert vessels["other"].mission.speed_mps == otter.vehicle.cruise_speed_mps
    assert vessels["leader"].mission.speed_mps == load_profile("vehicles/asv-full").vehicle.cruise_speed_mps
    assert vessels["barge"].vehicle is vessels["barge"].autopilot is vessels["barge"].sensors is None


def test_followers_begin_in_their_places_behind_the_leader(fleet):
    profile = fleet(CONVOY)
    assert starts(profile) == {
        "leader": (100, -50),
        "follower_1": (100, -60),
        "follower_2": (100, -70),
        "follower_3": (100, -80),
        "other": (0, -60),
    }
    offsets = [profile.vessels[f"follower_{number}"].driver.follow.offset_frd_m for number in (1, 2, 3)]
    assert offsets == [(-10, 0), (-20, 0), (-30, 0)]
    assert all(not profile.vessels[f"follower_{number}"].mission.waypoints_ned_m for number in (1, 2, 3))


def test_a_system_id_is_the_lowest_that_is_free_unless_given(fleet):
    profile = fleet(CONVOY)
    ids = {name: vessel.autopilot.system_id for name, vessel in profile.sailed.items()}
    assert ids == {"leader": 1, "follower_1": 3, "follower_2": 4, "follower_3": 5, "other": 2}


def test_a_run_has_a_profile_for_each_vessel_and_the_traffic_in_all(fleet):
    runs = fleet(CONVOY).run_profiles()
    assert [run.vessel for run in runs] == ["leader", "follower_1", "follower_2", "follower_3", "other"]
    assert all(run.site == runs[0].site and run.clock == runs[0].clock for run in runs)
    assert [run.ais.mmsi for run in runs] == [200000001, 200000003, 200000004, 200000005, 200000002]
    for run in runs:
        (barge,) = run.traffic.values()
        assert (barge.ais.name, barge.ais.mmsi, barge.length_m) == ("barge", 200001001, 60.0)


def test_one_vessel_without_vessels_is_what_it_was():
    profile = load_profile("sitl")
    (run,) = profile.run_profiles()
    assert run == profile.runnable()
    assert (run.vessel, run.traffic, run.autopilot.system_id) == ("", {}, 1)
    of_several = {"system_id:", "vessels:", "ais:", "follow:", "encounter_distance_m:", "traffic:"}
    assert not of_several & set(resolved_yaml(profile).split())


def test_a_fleet_is_none_for_what_takes_one_vessel(fleet, golden: Golden):
    with pytest.raises(UserError) as refused:
        fleet(CONVOY).runnable()
    golden("error", refused.value)


@pytest.mark.medium
def test_the_resolved_text_loads_to_an_equal_fleet(fleet):
    profile = fleet(CONVOY, "vessels.other.companion.lag=7", "companion.lag=3", "vessels.leader.companion=null")
    text = resolved_yaml(profile)
    again = fleet(text)
    assert again == profile
    assert resolved_yaml(again) == text
    assert "formation:" not in text


@pytest.mark.parametrize(
    ("override", "vessel", "found"),
    [
        ("vessels.leader.mission.speed_mps=2", "leader", lambda one: one.mission.speed_mps == 2),
        ("mission.speed_mps=1.5", "leader", lambda one: one.mission.speed_mps == 1.5),
        ("vessels.follower.count=8", "follower_8", lambda one: one.mission.start.east_m == -130),
        ("vessels.follower.formation.spacing_m=20", "follower_2", lambda one: one.mission.start.east_m == -80),
        ("vessels.barge.traffic.speed_mps=1", "barge", lambda one: one.traffic.speed_mps == 1),
        ("vessels.tug={}", "tug", lambda one: one.driver.kind == "mission"),
    ],
)
def test_overrides_reach_a_vessel_before_it_is_unfolded(fleet, override, vessel, found):
    apart = "vessels.tug.mission.start.north_m=160" if vessel == "tug" else "clock.seed=1"
    assert found(fleet(CONVOY, override, apart).vessels[vessel])


@pytest.mark.medium
def test_values_know_where_they_were_written(fleet, tmp_path):
    fleet(CONVOY)
    loaded = load_with_origins(str(tmp_path / "fleet.yaml"))
    line = {text.strip(): number for number, text in enumerate(CONVOY.splitlines(), start=1)}
    at = line["formation: {shape: column, spacing_m: 10}"]
    assert loaded.origin("vessels.follower_2.mission.start.north_m").line == at
    assert loaded.origin("vessels.follower_2.driver.kind").line == at + 1
    assert loaded.origin("vessels.follower_2.vehicle.mass_kg").source.endswith("asv-full.yaml")


@pytest.mark.parametrize(
    ("shape", "count", "places"),
    [
        ("column", 3, [(0, 0), (-10, 0), (-20, 0)]),
        ("line_abreast", 3, [(0, -10), (0, 0), (0, 10)]),
        ("line_abreast", 2, [(0, -5), (0, 5)]),
        ("wedge", 3, [(0, 0), (-math.sqrt(50), -math.sqrt(50)), (-math.sqrt(50), math.sqrt(50))]),
        ("circle", 4, [(math.sqrt(50), 0), (0, math.sqrt(50)), (-math.sqrt(50), 0), (0, -math.sqrt(50))]),
        ("circle", 1, [(0, 0)]),
        ("grid", 4, [(0, -5), (0, 5), (-10, -5), (-10, 5)]),
        ("grid", 5, [(0, -10), (0, 0), (0, 10), (-10, -10), (-10, 0)]),
    ],
)
@pytest.mark.parametrize("heading_deg", [0, 90])
def test_formations_lie_in_the_axes_of_the_heading(fleet, shape, count, places, heading_deg):
    profile = fleet(
        WATER
        + f"""vessels:
  boat:
    count: {count}
    formation: {{shape: {shape}, spacing_m: 10}}
    mission: {{start: {{north_m: -50, east_m: -50, heading_deg: {heading_deg}}}, waypoints_ned_m: [[5, 7]]}}
"""
    )
    for (name, (north_m, east_m)), (ahead_m, right_m) in zip(starts(profile).items(), places, strict=True):
        moved = (ahead_m, right_m) if heading_deg == 0 else (-right_m, ahead_m)
        assert (north_m + 50, east_m + 50) == pytest.approx(moved, abs=1e-3)
        assert profile.vessels[name].mission.waypoints_ned_m[0] == pytest.approx((5 + moved[0], 7 + moved[1]), abs=1e-3)


def test_waypoints_can_be_shared(fleet):
    profile = fleet(
        WATER
        + """vessels:
  boat:
    {count: 3, formation: {shape: grid, waypoints: shared}, mission: {start: {east_m: -60}, waypoints_ned_m: [[5, 7]]}}
"""
    )
    assert [one.mission.waypoints_ned_m for one in profile.vessels.values()] == [((5.0, 7.0),)] * 3


@pytest.mark.medium
def test_a_spread_is_drawn_from_the_seed_and_keeps_its_distance(fleet):
    text = (
        WATER
        + """vessels:
  boat: {count: 40, spread: {radius_m: 90, apart_m: 10}, mission: {start: {east_m: -250}, waypoints_ned_m: [[5, 7]]}}
"""
    )
    first, again, other = fleet(text), fleet(text), fleet(text, "clock.seed=2")
    assert first == again
    assert starts(first) != starts(other)
    places = list(starts(first).values())
    assert all(math.dist(place, (12, -250)) <= 90 + 1e-3 for place in places)
    assert min(math.dist(one, other) for one in places for other in places if one is not other) >= 10 - 2e-3


@pytest.mark.medium
def test_a_count_of_250_is_loaded(fleet):
    text = WATER + "vessels: {boat: {count: 250, formation: {shape: grid}, mission: {start: {east_m: -400}}}}\n"
    profile = fleet(text)
    assert [one.autopilot.system_id for one in profile.vessels.values()] == list(range(1, 251))


def test_a_count_of_one_is_numbered_too(fleet):
    text = WATER + "vessels: {boat: {count: 1, mission: {start: {east_m: -60}}}}\n"
    assert list(fleet(text).vessels) == ["boat_1"]


def test_a_fleet_is_laid_upon_another(fleet, tmp_path):
    (tmp_path / "base.yaml").write_text(CONVOY, encoding="utf-8")
    profile = fleet(
        "extends: base.yaml\nvessels: {follower: {count: 1}, barge: null, other: {extends: vehicles/heron}}\n"
    )
    assert list(profile.vessels) == ["leader", "follower_1", "other"]
    assert profile.vessels["other"].vehicle == load_profile("vehicles/heron").vehicle
    assert profile.vessels["other"].autopilot.system_id == 2


def problems(fleet, vessels: str, *overrides: str) -> list[str]:
    with pytest.raises(ProfileError) as caught:
        fleet(WATER + f"mission: {{start: {{north_m: 0, east_m: -60}}}}\nvessels:\n{vessels}", *overrides)
    return [str(problem) for problem in caught.value.problems]


FOLLOW = "driver: {kind: follow, follow: {vessel: %s}}"


@pytest.mark.parametrize(
    "vessels",
    [
        "  {}",
        "  [a, b]",
        "  Boat: {}",
        "  boat: 3",
        "  boat: {count: 0}",
        "  boat: {count: 251}",
        "  boat: {count: 2}",
        "  boat: {formation: {shape: grid}}",
        "  boat: {count: 2, formation: {shape: ring}}",
        "  boat: {count: 2, formation: {shape: grid}, spread: {radius_m: 9}}",
        "  boat: {count: 30, spread: {radius_m: 20, apart_m: 10}}",
        "  boat: {count: 2, formation: {shape: column, spacing_m: 1}}",
        "  one: {}\n  two: {}",
        "  boat_1: {}\n  boat: {count: 2, formation: {shape: column}}",
        "  one: {autopilot: {system_id: 7}}\n  two: {autopilot: {system_id: 7}, mission: {start: {east_m: -90}}}",
        "  boat: {count: 3, formation: {shape: column}, autopilot: {system_id: 249}}",
        f"  one: {{}}\n  two: {{{FOLLOW % 'three'}}}",
        f"  one: {{{FOLLOW % 'two'}}}\n  two: {{{FOLLOW % 'one'}}}",
        f"  one: {{count: 2, formation: {{shape: column}}}}\n  two: {{{FOLLOW % 'one'}}}",
        f"  one: {{{FOLLOW % 'one'}}}",
        "  one: {driver: {kind: follow}}",
        "  one: {clock: {seed: 3}, vehicle: {mass_kg: 3}}",
        "  one: {vessels: {}}",
        "  one: {extends: mitl}",
    ],
)
def test_what_is_refused(fleet, vessels, golden: Golden):
    golden("problem", problems(fleet, vessels)[0])


STANDING = """
world:
  log_boom: {anchors_ne_m: [[0, 0], [0, 40]], float_length_m: 6, float_radius_m: 0.5}
  dam: {centre_ned_m: [100, 0, 0], size_m: [40, 10, 20], heading_deg: 90}
  buildings: [{centre_ne_m: [-80, 60], size_m: [10, 10, 5]}]
  river: {through_ne_m: [0, 0], direction_deg: 0, width_m: 200, depth_m: 5, along_m: [-150, 150]}
"""


@pytest.mark.parametrize(
    ("start", "problem"),
    [
        ("north_m: 0, east_m: 20, heading_deg: 90", "its start [0, 20] is in the log boom; use another place"),
        ("north_m: 1.5, east_m: 20", "is in the log boom"),  # with its bow: the hull is 2.3 m long
        ("north_m: 1.5, east_m: 20, heading_deg: 90", None),  # it is 1.6 m wide, and floats reach to 0.5 m
        ("north_m: 96, east_m: 15", "its start [96, 15] is in the dam"),
        ("north_m: 90, east_m: 15", None),
        ("north_m: -76, east_m: 63", "is in a building"),
        ("north_m: 50, east_m: 99.5", "is aground: the river is 200 m wide there; use another place"),
        ("north_m: 50, east_m: 98", None),
        ("north_m: 500, east_m: 99.5", None),  # no banks are drawn there
    ],
)
def test_a_start_is_refused_where_something_stands(fleet, start, problem):
    text = f"{WATER}{STANDING}vessels:\n  one: {{mission: {{start: {{{start}}}}}}}\n"
    text = text.replace("log_boom: {", "log_boom: {points_ned_m: null, ")
    if problem is None:
        assert fleet(text).vessels
        return
    with pytest.raises(ProfileError) as caught:
        fleet(text)
    (found,) = caught.value.problems
    assert problem in found.sentence
    assert found.origin.line == 1 + text.count("\n", 0, text.index("one:"))


@pytest.mark.medium
def test_a_drawn_place_is_free_of_what_stands_and_lies_there(fleet):
    text = f"""{WATER}{STANDING}vessels:
  barge: {{traffic: {{track_ned_m: [[-40, 30]], length_m: 30, beam_m: 10}}}}
  boat: {{count: 60, spread: {{radius_m: 120, apart_m: 5}}, mission: {{start: {{north_m: 0, east_m: 0}}}}}}
""".replace("log_boom: {", "log_boom: {points_ned_m: null, ")
    for seed in range(1, 6):
        assert len(fleet(text, f"clock.seed={seed}").sailed) == 60  # or a start would have been refused


BARGE = "traffic: {track_ned_m: [[0, -120], [300, -120]], speed_mps: 2, length_m: 60, beam_m: 12"


@pytest.mark.parametrize(
    ("vessels", "problem"),
    [
        (
            f"  one: {{}}\n  barge: {{{BARGE}}}, vehicle: {{mass_kg: 9}}}}",
            "5: vessels.barge.vehicle has no effect on scripted traffic",
        ),
        (
            f"  barge: {{{BARGE}}}}}",
            "3: vessels has only scripted vessels; add one with an autopilot, such as `own: {}`",
        ),
        (f"  one: {{}}\n  barge: {{{BARGE}}}, ais: {{}}}}", "remove ais or traffic; its AIS is traffic.ais"),
        (
            f"  one: {{{FOLLOW % 'barge'}}}\n  barge: {{{BARGE}}}}}",
            "4: vessels.one.driver.follow.vessel = barge is",
        ),
        ("  barge: {traffic: {track_ned_m: [[0, 0], [9, 0]], length_m: 6, beam_m: 2}}", "needs 'speed_mps'"),
        (
            "  barge: {traffic: {track_ned_m: [[0, 0], [0, 0]], speed_mps: 1, length_m: 6, beam_m: 2}}",
            "repeats the point before it",
        ),
        (
            "  barge: {traffic: {track_ned_m: [[0, 0]], speed_mps: 1, length_m: 6, beam_m: 2}}",
            "needs a track of several points",
        ),
        (
            "  one: {ais: {callsign: TOOLONGX}}",
            "vessels.one.ais.callsign = 'TOOLONGX' is too long for AIS",
        ),
        ("  one: {sensors: {imu: {rate_hz: 333}}}", "4: vessels.one: sensors.imu.rate_hz = 333 does not divide"),
        (
            "  one: {sensors: {imu: {rat_hz: 3}}}",
            "4: vessels.one.sensors.imu.rat_hz is not a known key",
        ),
        ("  one: {formaton: {shape: grid}}", "vessels.one.formaton is not a known key; did you mean 'formation'?"),
        ("  one: {autopilot: {kind: none}}", "technique = sitl runs an autopilot on this machine; use technique: mitl"),
    ],
)
def test_what_is_refused_of_scripted_vessels_and_inside_others(fleet, vessels, problem):
    found = problems(fleet, vessels)
    assert problem in found[0]


def test_what_is_wrong_with_what_they_share_is_said_once(fleet, golden: Golden):
    two = "  one: {}\n  two: {mission: {start: {east_m: -90}}}"
    found = problems(fleet, two, "sensors.imu.rate_hz=333", "clock.sed=1")
    golden("text", found)
    found = problems(fleet, two, "sensors.imu.rate_hz=333")
    assert len(found) == 1
    golden("second text", found[0], "333")


def test_two_vessels_are_not_on_one_board(fleet, golden: Golden):
    board = "autopilot: {runs: board, link: 'udp://192.168.7.2:14660'}"
    vessels = f"  one: {{{board}}}\n  two: {{{board}, mission: {{start: {{east_m: -90}}}}}}"
    found = problems(fleet, vessels, "technique=hitl", "clock.mode=realtime")
    golden("text", found[0])


@pytest.mark.parametrize(("technique", "fits"), [("hitl", True), ("sitl", True), ("mitl", False)])
def test_the_technique_is_that_of_the_fleet(fleet, technique, fits):
    text = (
        WATER
        + f"technique: {technique}\n"
        + """vessels:
  one: {autopilot: {kind: none}, driver: {kind: mission}}
  two: {autopilot: {runs: process, link: 'udp://127.0.0.1:0'}, mission: {start: {east_m: -60}}}
"""
    )
    if fits:
        assert fleet(text).technique == technique
    else:
        with pytest.raises(ProfileError, match="technique = mitl has no autopilot"):
            fleet(text)


def test_traffic_and_followers_are_of_several_vessels(fleet, golden: Golden):
    with pytest.raises(ProfileError) as refused:
        fleet(WATER + f"{BARGE}}}\n")
    golden("error", refused.value)
    with pytest.raises(ProfileError) as refused:
        fleet(WATER + "driver: {kind: follow, follow: {vessel: leader}}\n")
    golden("second error", refused.value)


def test_scripted_vessels_can_be_many(fleet):
    profile = fleet(
        WATER + f"vessels: {{own: {{}}, barge: {{count: 2, formation: {{shape: column, spacing_m: 80}}, {BARGE}}}}}}}\n"
    )
    first, second = (profile.vessels[name].traffic.track_ned_m for name in ("barge_1", "barge_2"))
    assert first == ((0, -120), (300, -120))
    assert second == ((-80, -120), (220, -120))
