"""`xitl sim` from the command line to the recording."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import Xitl, payloads, summary
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pymavlink.dialects.v20 import common

from tests.golden import Golden
from tests.recorded_run import recorded_run

pytestmark = pytest.mark.slow

SECONDS = 15
ENVIRONMENTS = {"calm": 2.0, "current-waves": 4.0, "current-waves-gusts": 4.0}


@pytest.mark.parametrize(
    "environment",
    ["calm", *(pytest.param(name, marks=pytest.mark.nightly) for name in ("current-waves", "current-waves-gusts"))],
)
def test_the_mission_closes_in_the_papers_three_environments(xitl: Xitl, tmp_path: Path, environment: str) -> None:
    profile = tmp_path / "boat.yaml"
    profile.write_text(f"extends: [sitl, environments/{environment}]\n")
    result = xitl("sim", "--profile", str(profile), "--out", "run", "--json")
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    assert told == summary(tmp_path / "run")
    mission, estimation = told["mission"], told["estimation"]
    assert mission["completed"]
    assert mission["waypoints_reached"] == mission["waypoints_total"] == 6
    assert mission["cross_track_rms_m"] < ENVIRONMENTS[environment]
    # Reached by the estimate within the radius of 3 m; the truth is off by the estimate's error, some 1 m.
    assert max(mission["closest_m"]) < 3.0 + 1.5
    assert estimation["position_rms_m"] < 1.5
    assert estimation["heading_rms_deg"] < 3.0
    assert [link["lost"] for link in told["links"]] == [0, 0]
    assert [link["sent"] for link in told["links"]] == [link["received"] for link in told["links"]]
    assert all(task["missed"] == 0 for task in told["tasks"])


def test_the_same_seed_records_the_same_bytes_and_another_does_not(xitl: Xitl, tmp_path: Path) -> None:
    for name in "ab":
        assert xitl("sim", "--seed", "7", "--duration", f"{SECONDS}", "--out", name).returncode == 0
    runs = (tmp_path / "a", tmp_path / "b", recorded_run("sitl", SECONDS))
    first, again, other = (payloads(run / "run.mcap") for run in runs)
    assert first == again
    logs = [(run / "autopilot.bin").read_bytes() for run in runs]
    assert logs[0] == logs[1] != logs[2]
    assert first["/truth/state"] != other["/truth/state"]
    assert first["/link/agent/tx"] != other["/link/agent/tx"]


def test_an_agent_in_its_own_process_flies_the_same_run_in_lockstep(xitl: Xitl, tmp_path: Path, free_port: int) -> None:
    """Where the autopilot runs changes the profile and nothing else: not one byte of the vessel's motion."""
    link = f"autopilot.link=udp://127.0.0.1:{free_port}"
    away = ("sim", "--profile", "hitl-loopback", "--clock", "lockstep", "--set", link, "--duration", f"{SECONDS}")
    result = xitl(*away, "--out", "there")
    assert result.returncode == 0, result.stderr
    here, there = payloads(recorded_run("sitl", SECONDS) / "run.mcap"), payloads(tmp_path / "there/run.mcap")
    for topic in ("/truth/state", "/actuators", "/estimate/odometry", "/environment"):
        assert here[topic] == there[topic], topic


def python_of_a_board() -> str | None:
    """A Python 3.9, the oldest an agent has to run on."""
    pyenv = sorted(Path.home().glob(".pyenv/versions/3.9*/bin/python3.9"))
    for candidate in [shutil.which("python3.9"), *map(str, pyenv)]:
        if candidate and subprocess.run([candidate, "--version"], capture_output=True, check=False).returncode == 0:
            return candidate
    return None


def test_a_bare_python_3_9_flies_the_same_run(xitl: Xitl, tmp_path: Path, free_port: int) -> None:
    """The agent as on a board: the oldest Python it supports, and no package but the standard library."""
    python = python_of_a_board()
    if python is None:
        pytest.skip("there is no Python 3.9 on this machine")
    link = f"udp://127.0.0.1:{free_port}"
    root = Path(__file__).parents[2]
    with subprocess.Popen([python, "-S", "-m", "agent", "--link", link], cwd=root, stdout=subprocess.PIPE) as agent:
        assert agent.stdout is not None
        agent.stdout.readline()
        board = ("--profile", "hitl-beaglebone", "--clock", "lockstep", "--set", f"autopilot.link={link}")
        result = xitl("sim", *board, "--duration", f"{SECONDS}", "--out", "there")
        agent.terminate()
    assert result.returncode == 0, result.stderr
    here, there = payloads(recorded_run("sitl", SECONDS) / "run.mcap"), payloads(tmp_path / "there/run.mcap")
    assert here["/truth/state"] == there["/truth/state"]
    assert here["/estimate/odometry"] == there["/estimate/odometry"]


@pytest.mark.realtime
def test_real_time_over_udp_measures_the_link_and_the_clocks(xitl: Xitl, tmp_path: Path, free_port: int) -> None:
    link = f"autopilot.link=udp://127.0.0.1:{free_port}"
    result = xitl("sim", "--profile", "hitl-loopback", "--set", link, "--duration", "4", "--out", "run")
    assert result.returncode == 0, result.stderr
    told = summary(tmp_path / "run")
    assert told["real_time_factor"] == pytest.approx(1.0, rel=0.05)
    sensors, actuators = told["links"]
    assert sensors["name"] == "sensors"
    assert sensors["received"] == sensors["sent"] > 4 * 300  # 200 + 50 + 50 + 5 samples a second, and more
    assert actuators["received"] == actuators["sent"] > 4 * 45  # 50 a second
    # Both processes read the clock of one machine: what is measured as drift or latency is the method's own error. The
    # delay of one loop-back hop is tens of microseconds; the bound leaves room for a busy machine.
    assert 0 < sensors["latency_us"]["p50"] < 20_000
    clock = told["clocks"][0]
    assert clock["samples"] > 20
    assert abs(clock["drift_ppm"]) < 100
    tasks = {task["task"]: task for task in told["tasks"]}
    assert tasks["physics"]["cycles"] == 1600
    assert tasks["control"]["cycles"] > 190
    assert len(payloads(tmp_path / "run/run.mcap")["/clocks"]) > 30


def test_the_recording_reads_back_in_standard_tools() -> None:
    path = recorded_run("sitl", SECONDS) / "run.mcap"
    topics = payloads(path)
    wanted = {"/truth/state", "/truth/odometry", "/truth/pose", "/truth/fix", "/tf", "/scene", "/environment", "/log"}
    assert wanted | {"/estimate/odometry", "/actuators", "/link/agent/tx", "/link/agent/rx", "/tasks"} <= topics.keys()
    assert len(topics["/truth/state"]) == SECONDS * 50
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert {item.name for item in reader.iter_attachments()} == {"profile.yaml", "xitl.xml"}
        states = [state for *_, state in reader.iter_decoded_messages(topics=["/truth/state"])]
    position = np.array([state.position_ned_m for state in states])
    velocity = np.array([state.velocity_ned_mps for state in states])
    # The recorded velocity is the derivative of the recorded position: between samples 20 ms apart they differ by
    # the acceleration (a few m/s² in waves) times half of that.
    assert np.abs(np.diff(position, axis=0) / 0.02 - velocity[1:]).max() < 0.2
    # pymavlink's own dialect reads the standard messages of the raw frames, checksum and all.
    mav = common.MAVLink(None)
    kinds = set()
    for _, payload in topics["/link/agent/rx"]:
        frame = payload[16:]  # encapsulation 4, stamp 8, length 4
        if int.from_bytes(frame[7:10], "little") in common.mavlink_map:
            kinds.add(mav.decode(bytearray(frame)).get_type())
    assert {"HEARTBEAT", "SYS_STATUS", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "MISSION_ACK"} <= kinds


def test_without_an_autopilot_the_driver_commands_the_vessel(xitl: Xitl, tmp_path: Path) -> None:
    course = "mission.waypoints_ned_m=[[8.0, 6.0], [24.0, 18.0]]"
    result = xitl("sim", "--profile", "mitl", "--set", course, "--out", "run", "--json")
    told = json.loads(result.stdout)
    assert result.returncode == 0, result.stderr
    assert told["mission"]["completed"]
    assert told["links"] == told["clocks"] == []
    assert told["estimation"]["position_rms_m"] is None


def test_a_run_says_whether_its_physics_was_compiled(
    xitl: Xitl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for switch, compiled in (("numpy", False), ("", True)):
        monkeypatch.setenv("XITL_PHYSICS", switch)
        run = xitl("sim", "sitl", "--duration", "0.2", "--out", f"run{compiled}")
        physics = json.loads((tmp_path / f"run{compiled}/summary.json").read_text(encoding="utf-8"))["physics"]
        assert physics == {
            "compiled": compiled,
            "why_numpy": None if compiled else "XITL_PHYSICS=numpy is set; unset it",
        }
        assert ("physics in numpy" in run.stdout) is not compiled


def test_a_resolved_profile_flies_the_same_run_again(xitl: Xitl, tmp_path: Path) -> None:
    assert xitl("sim", "--set", "environment.wind.mean_mps=8", "--duration", "15", "--out", "one").returncode == 0
    assert xitl("sim", "--profile", "one/profile.yaml", "--out", "two").returncode == 1
    one, two = payloads(tmp_path / "one/run.mcap"), payloads(tmp_path / "two/run.mcap")
    assert one == two


def test_the_estimate_never_sees_the_truth() -> None:
    """What goes to the agent are sensors, time and orders: no message carries the true state."""
    from agent.wire import dialect

    told = payloads(recorded_run("sitl", SECONDS) / "run.mcap")["/link/agent/tx"]
    sent = {int.from_bytes(data[23:26], "little") for _, data in told}
    names = {dialect.mavlink_map[number].msgname for number in sent}
    sensors = {"XITL_IMU", "XITL_GNSS", "XITL_MAGNETOMETER", "XITL_BAROMETER"}
    orders = {"XITL_TICK", "XITL_RUN", "PARAM_SET", "MISSION_COUNT", "MISSION_ITEM_INT", "COMMAND_LONG"}
    assert sensors <= names <= sensors | orders


def test_sensors_carry_noise_latency_and_rate() -> None:
    from agent.wire import dialect

    arrivals: dict[int, list[int]] = {}
    delays: dict[int, set[int]] = {}
    for stamp_ns, data in payloads(recorded_run("sitl", SECONDS) / "run.mcap")["/link/agent/tx"]:
        number = int.from_bytes(data[23:26], "little")
        if number in (dialect.MAVLINK_MSG_ID_XITL_IMU, dialect.MAVLINK_MSG_ID_XITL_GNSS):
            sampled_us = int.from_bytes(data[26:34], "little")
            arrivals.setdefault(number, []).append(stamp_ns)
            delays.setdefault(number, set()).add(stamp_ns // 1000 - sampled_us)
    assert len(arrivals[dialect.MAVLINK_MSG_ID_XITL_IMU]) == SECONDS * 200
    assert delays[dialect.MAVLINK_MSG_ID_XITL_IMU] == {0}
    assert len(arrivals[dialect.MAVLINK_MSG_ID_XITL_GNSS]) == math.floor((SECONDS - 0.12) * 5)
    assert delays[dialect.MAVLINK_MSG_ID_XITL_GNSS] == {120_000}


RAISING = """
class Raising:
    def __init__(self, parameters):
        pass
    def configure(self):
        pass
    def restart(self):
        pass
    def control(self, order, estimate, dt_s):
        raise ZeroDivisionError("the gain is zero")
"""


@pytest.mark.parametrize("duration", [("--set", "clock.duration_s=15"), ("--duration", "15")])
def test_a_run_whose_controller_raises_has_failed(xitl: Xitl, tmp_path: Path, duration: tuple[str, ...]) -> None:
    (tmp_path / "raising.py").write_text(RAISING)
    own = ("--set", f"autopilot.controller={tmp_path / 'raising.py'}:Raising")
    result = xitl("sim", "--profile", "sitl", *duration, "--out", "own", *own)
    assert result.returncode == 1
    said = " ".join((result.stdout + result.stderr).split())
    assert "raising.py:Raising failed at" in said
    verdict = summary(tmp_path / "own")["verdict"]
    assert not verdict["completed"]
    assert not verdict["duration_asked"]
    assert "raising.py:Raising failed at" in verdict["why"]


def test_a_controller_that_raises_without_an_autopilot_ends_the_run(xitl: Xitl, tmp_path: Path, golden: Golden) -> None:
    (tmp_path / "raising.py").write_text(RAISING)
    own = ("--set", f"autopilot.controller={tmp_path / 'raising.py'}:Raising")
    result = xitl("sim", "--profile", "mitl", "--duration", "5", "--out", "own", *own)
    assert result.returncode == 2
    said = " ".join(result.stderr.split())
    golden("message", said, "0.02 s")
    assert "Traceback" not in said
    assert "raising.py:Raising failed at 0.02 s" in summary(tmp_path / "own")["verdict"]["why"]


@pytest.mark.parametrize(
    ("profile", "controller"),
    [
        ("mitl", "sliding_mode_heading.py:SlidingModeHeading"),
        ("sitl", "sliding_mode_heading.py:SlidingModeHeading"),
        ("sitl", "learned_heading.py:LearnedHeading"),
    ],
)
def test_a_controller_from_a_file_steers_in_place_of_the_built_in_one(
    xitl: Xitl, tmp_path: Path, profile: str, controller: str
) -> None:
    own = ("--set", f"autopilot.controller={Path(__file__).parents[2] / 'examples' / controller}")
    result = xitl("sim", "--profile", profile, "--duration", "20", "--out", "own", *own)
    assert result.returncode == 0, result.stderr
    runs = (recorded_run(profile, 20.0), tmp_path / "own")
    built_in, steered_by_own = (payloads(run / "run.mcap")["/actuators"] for run in runs)
    assert built_in != steered_by_own
    # Both steer for the same waypoint: the courses differ in detail, not in where they go.
    assert summary(tmp_path / "own")["mission"]["cross_track_rms_m"] < 3.0
