"""What vessels of a fleet know of each other: AIS, encounters, followers, and a scripted vessel between them."""

from __future__ import annotations

import json
import math
import threading
from pathlib import Path
from typing import Any

import pytest
from conftest import Xitl
from mcap.reader import make_reader
from pymavlink import mavutil

import xitl as toolkit
from agent.wire import dialect
from agent.wire.codec import decode
from tests.ardupilot import find_ardurover

LOST_LEADER = """
extends: [bases/base-sitl, sites/santo-antonio, vehicles/asv-full, environments/current-waves-gusts]
mission: {speed_mps: 2.5}
vessels:
  leader:
    mission: {start: {north_m: 60, east_m: -120}, waypoints_ned_m: [[200, -120]]}
    driver:
      kind: script
      script: [{at_s: 15, mode: AUTO, arm: true}, {at_s: 55, mode: HOLD}, {at_s: 75, end: true}]
    faults: {silent: {from_s: 35, until_s: 42, link: {direction: actuators, loss: 1.0}}}
  follower: {driver: {kind: follow, follow: {vessel: leader, offset_frd_m: [-10, 0]}}}
"""
BARGE = "{track_ned_m: [[60, -60], [260, -60]], speed_mps: 3.0, length_m: 30, beam_m: 8, ais: {callsign: BRG1}}"
CROSSING = f"""
extends: [bases/base-sitl, sites/santo-antonio, vehicles/asv-full, environments/current-waves]
mission: {{speed_mps: 2.0}}
world: {{encounter_distance_m: 20.0}}
vessels:
  own:
    mission: {{start: {{north_m: 70, east_m: -100}}, waypoints_ned_m: [[130, -100]]}}
  target:
    ais: {{ship_type: 52}}
    mission: {{start: {{north_m: 110, east_m: -40, heading_deg: 270}}, waypoints_ned_m: [[110, -150]]}}
  barge: {{traffic: {BARGE}}}
"""
CONVOY = """
extends: [bases/base-sitl, sites/santo-antonio, vehicles/asv-full, environments/current-waves-gusts]
mission: {speed_mps: 2.5}
vessels:
  leader:
    mission: {start: {north_m: 60, east_m: -120}, waypoints_ned_m: [[130, -120], [130, -80]]}
  follower: {driver: {kind: follow, follow: {vessel: leader, offset_frd_m: [-10, 0]}}}
"""
CROSSED_S, SYSTEM_ID, BARGE_MMSI = 45.0, 1, 200_001_001


CHEAP = {"recording.scene": False, "clock.physics_rate_hz": 200}


def run_of(folder: Path, profile: str, duration_s: float) -> toolkit.Result:
    (folder / "fleet.yaml").write_text(profile)
    return toolkit.simulate(folder / "fleet.yaml", duration_s=duration_s, overrides=CHEAP, out=folder / "run")


@pytest.fixture(scope="module")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> toolkit.Result:
    return run_of(tmp_path_factory.mktemp("crossing"), CROSSING, duration_s=CROSSED_S)


@pytest.mark.slow
def test_a_crossing_is_scored_by_the_rule_and_the_closest_approach(crossing: toolkit.Result) -> None:
    """They sail at right angles: own has target on her starboard side."""
    encounters = crossing.summary["encounters"]
    pairs = {tuple(pair["vessels"]): pair for pair in encounters["pairs"]}
    assert set(pairs) == {("own", "target"), ("own", "barge"), ("target", "barge")}
    met = pairs["own", "target"]
    assert (met["rule"], met["gives_way"], met["stands_on"]) == (15, ["own"], "target")
    assert met["bearings_deg"][0] > 0.0 > met["bearings_deg"][1]
    assert encounters["too_close"] == sum(pair["distance_m"] < 20.0 for pair in pairs.values())
    assert encounters["closest_m"] == min(pair["distance_m"] for pair in pairs.values())
    assert all(0.0 < pair["distance_m"] < pair["centre_distance_m"] for pair in pairs.values())


def places(recording: Path, topic: str) -> dict[int, tuple[float, ...]]:
    """North and east by instant."""
    with toolkit.open_log(recording) as log:
        table = log.tables[topic]
        found = table.values("position_ned_m")
        return {int(stamp): tuple(row[:2]) for stamp, row in zip(table.stamp_ns, found, strict=True)}


@pytest.mark.slow
def test_the_closest_approach_is_that_of_the_recorded_tracks(crossing: toolkit.Result) -> None:
    """At the recording's 50 Hz two vessels come no more than 4.5 m/s / 50 nearer or farther between two rows."""
    tracks = {name: places(crossing.recording, f"/{name}/truth/state") for name in ("own", "target", "barge")}
    for pair in crossing.summary["encounters"]["pairs"]:
        first, second = (tracks[name] for name in pair["vessels"])
        nearest = min(math.dist(first[stamp], second[stamp]) for stamp in first.keys() & second.keys())
        assert pair["centre_distance_m"] == pytest.approx(nearest, abs=0.09)


@pytest.mark.slow
def test_autopilots_are_told_of_the_others_by_ais(crossing: toolkit.Result) -> None:
    heard: dict[int, Any] = {}
    with crossing.recording.open("rb") as file:
        reader = make_reader(file)
        assert {one.name for one in reader.iter_attachments()} == {"profile.yaml", "xitl.xml", "fleet.xml"}
        for _, _, message in reader.iter_messages(topics=["/own/link/agent/tx"]):
            frame = decode(message.data[16:])  # behind the CDR header, the stamp and the length
            if isinstance(frame, dialect.MAVLink_ais_vessel_message):
                heard[frame.MMSI] = frame
    assert set(heard) == {200_000_002, BARGE_MMSI}
    barge = heard[BARGE_MMSI]
    assert (barge.callsign, barge.dimension_bow + barge.dimension_stern, barge.heading) == ("BRG1", 30, 0)
    assert barge.velocity == pytest.approx(300, abs=3)  # a tenth of a knot is 5 cm/s
    assert heard[200_000_002].type == 52
    counts = crossing.summary["ais"]
    # Two that hear the barge, and each other.
    assert counts["heard"] == counts["sent"]["own"] + counts["sent"]["target"] + 2 * counts["sent"]["barge"]
    assert 45.0 / 10.0 <= counts["sent"]["barge"] <= 7


@pytest.mark.slow
def test_a_follower_keeps_its_place_and_ends_with_its_leader(tmp_path: Path) -> None:
    """In current, waves and gusts, once it is there; two legs, so that the median is not of getting under way."""
    result = run_of(tmp_path, CONVOY, duration_s=120.0)
    assert result.completed, result.verdict
    follower = result.summary["vessels"]["follower"]
    kept = follower["follow"]
    assert kept["settled_s"] is not None
    assert kept["settled_s"] < 40.0
    assert kept["p50_m"] < 2.0  # what the estimates of both are off is 1 m
    assert kept["leader_lost"] == 0
    assert follower["track"]["path_m"] > 40.0
    leader = result.summary["vessels"]["leader"]["driver"]
    assert leader["completed"]
    # Together: both lay moored until the follower had armed.
    assert leader["moored_s"] == pytest.approx(follower["driver"]["moored_s"], abs=0.1)
    assert leader["moored_s"] > 5.0


@pytest.mark.nightly
@pytest.mark.slow
def test_a_leader_that_falls_silent_and_one_that_stops_are_not_run_down(tmp_path: Path) -> None:
    """Silent for 7 s while it goes on, then a stop from full speed, drifting toward its follower in the current."""
    result = run_of(tmp_path, LOST_LEADER, duration_s=90.0)
    follower = result.summary["vessels"]["follower"]
    assert follower["follow"]["leader_lost"] == 1
    assert any("lost at 40" in warning for warning in follower["warnings"])
    assert result.summary["encounters"]["closest_m"] > 2.0  # between hulls, of 10 m less half of two of 4 m
    leader, behind = (places(result.recording, f"/{name}/truth/state") for name in ("leader", "follower"))
    last = max(leader.keys() & behind.keys())
    assert math.dist(leader[last], behind[last]) == pytest.approx(10.0, abs=3.0)  # beside where it has drifted to


@pytest.mark.realtime
@pytest.mark.ardupilot
def test_ardupilots_own_decoder_tells_a_ground_station_of_the_barge(xitl: Xitl, tmp_path: Path) -> None:
    """Position by message 1, name and size by both sentences of message 5."""
    firmware = find_ardurover("sitl")
    (tmp_path / "mix.yaml").write_text(
        f"extends: sitl-ardupilot\nvessels: {{rover: {{}}, barge: {{traffic: {BARGE}}}}}\n"
    )
    told: list[Any] = []
    over = threading.Event()

    def listen() -> None:
        station = mavutil.mavlink_connection("tcp:127.0.0.1:5997", dialect="ardupilotmega", retries=200)
        station.wait_heartbeat(timeout=120.0)
        station.mav.request_data_stream_send(0, 0, mavutil.mavlink.MAV_DATA_STREAM_ALL, 4, 1)
        while not over.is_set() and not (told and told[-1].name):
            message = station.recv_match(type="AIS_VESSEL", blocking=True, timeout=1.0)
            if message is not None:
                told.append(message)
        station.close()

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    stations = "vessels.rover.autopilot.ground_stations=[tcp://127.0.0.1:5997]"
    ran = xitl(
        "sim", "--profile", "mix.yaml", "--set", stations, "--set",
        f"autopilot.firmware={firmware}", "--duration", "60", "--out", "run", timeout_s=300.0,
    )  # fmt: skip
    over.set()
    listener.join(10.0)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert told
    assert (told[-1].MMSI, told[-1].name, told[-1].callsign) == (BARGE_MMSI, "BARGE", "BRG1")
    assert told[-1].dimension_bow + told[-1].dimension_stern == 30
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["ais"]["unsent_bytes"] == 0
