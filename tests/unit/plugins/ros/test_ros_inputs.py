"""What nodes ask, at a middleware that the test plays: actions, refusals, coalescing, answers of services."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import cache
from typing import Any, cast

import numpy as np
import pytest

from sim_core.environment.spec import Water
from tests.golden import Golden
from xitl_cli.plugins.ros.definitions import deserialize, ros2_types, serialize
from xitl_cli.plugins.ros.inputs import INPUTS, RosInputs
from xitl_cli.plugins.ros.middleware import QosProfile
from xitl_cli.profile import RunProfile, load_profile
from xitl_cli.record.topics import TOPICS
from xitl_cli.replay.thrust_log import command_of_thrust, motor_commands

TYPES = cast(Any, ros2_types().types)
NAN = math.nan


def made(name: str, *fields: Any) -> Any:
    return TYPES[name](*fields)


def vector(x: float, y: float, z: float) -> Any:
    return made("geometry_msgs/msg/Vector3", x, y, z)


def twist(speed: float, turn: float, sway: float = 0.0) -> Any:
    return made("geometry_msgs/msg/Twist", vector(speed, sway, 0.0), vector(0.0, 0.0, turn))


def header(frame: str, stamp_ns: int = 0) -> Any:
    time = made("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))
    return made("std_msgs/msg/Header", time, frame)


def pose(frame: str, x: float, y: float) -> Any:
    point, turn = made("geometry_msgs/msg/Point", x, y, 0.0), made("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    return made("geometry_msgs/msg/PoseStamped", header(frame), made("geometry_msgs/msg/Pose", point, turn))


class Played:
    """A middleware without a network."""

    name = "played"

    def __init__(self) -> None:
        self.topics: dict[str, tuple[str, QosProfile, Callable[[bytes], None]]] = {}
        self.services: dict[str, tuple[str, Callable[[bytes], bytes]]] = {}
        self.sent: dict[str, list[bytes]] = {}

    def advertise(self, topic: str, type_name: str, qos: QosProfile) -> Callable[[bytes], None]:
        return self.sent.setdefault(topic, []).append

    def subscribe(self, topic: str, type_name: str, qos: QosProfile, take: Callable[[bytes], None]) -> None:
        self.topics[topic] = type_name, qos, take

    def serve(self, service: str, type_name: str, answer: Callable[[bytes], bytes]) -> None:
        self.services[service] = type_name, answer

    def spin(self, timeout_s: float) -> None: ...
    def problems(self) -> list[str]:
        return []

    def close(self) -> None: ...


@cache
def profiles(name: str, *overrides: str) -> tuple[RunProfile, ...]:
    return load_profile(name, list(overrides)).run_profiles()


class Nodes:
    """What they publish, and what becomes of it; `now_s` is the clock on the wall."""

    def __init__(self, profile: str = "sitl", *overrides: str) -> None:
        self.actions: list[dict[str, Any]] = []
        self.problems: list[str] = []
        self.answers: list[tuple[str, int]] = []
        self.refusal: str | None = None
        self.now_s = 0.0
        self.middleware = Played()
        self.inputs = RosInputs(
            profiles(profile, *overrides),
            self.middleware,
            self._ask,
            lambda action: self.actions.append(dict(action)),
            lambda node, stamp_ns: self.answers.append((node, stamp_ns)),
            self.problems.append,
            lambda: self.now_s,
            lambda vessel: (100.0, 200.0),
        )

    def _ask(self, action: Any) -> str | None:
        self.actions.append(dict(action))
        return self.refusal

    def publish(self, topic: str, message: Any) -> None:
        self.middleware.topics[topic][2](message if isinstance(message, bytes) else serialize(message))

    def call(self, service: str, request: bytes = b"\0\1\0\0\0") -> tuple[bool, str]:
        answer = self.middleware.services[service][1](request)
        assert answer[:4] == b"\0\1\0\0"
        length = int.from_bytes(answer[8:12], "little")
        assert len(answer) == 12 + length
        return bool(answer[4]), answer[12:-1].decode()


def test_a_twist_is_a_speed_and_a_turn_rate_to_starboard() -> None:
    nodes = Nodes()
    nodes.publish("/cmd_vel", twist(1.5, 0.25))
    assert nodes.actions == [{"action": "velocity", "speed_mps": 1.5, "turn_rate_radps": -0.25}]


def test_what_of_a_twist_does_not_count_is_said_once(golden: Golden) -> None:
    nodes = Nodes()
    for second in range(3):
        nodes.now_s = float(second)
        nodes.publish("/cmd_vel", twist(1.0, 0.0, sway=0.3))
    assert len(nodes.actions) == 3
    golden("problem", nodes.problems)
    assert nodes.inputs.refused == {}


def test_a_stamped_twist_in_place_of_it() -> None:
    nodes = Nodes("sitl", "ros.cmd_vel=TwistStamped")
    kind = nodes.middleware.topics["/cmd_vel"][0]
    nodes.publish("/cmd_vel", made(kind, header("base_link"), twist(1.0, 0.0)))
    nodes.now_s = 1.0
    nodes.publish("/cmd_vel", made(kind, header("map"), twist(1.0, 0.0)))
    assert [action["speed_mps"] for action in nodes.actions] == [1.0]
    assert nodes.problems == ["/cmd_vel has the frame 'map'; use base_link"]


@pytest.mark.parametrize("bad", [twist(NAN, 0.0), twist(0.0, math.inf), twist(1.0, 0.0, NAN)])
def test_what_is_no_number_is_refused_counted_and_said_once(bad: Any) -> None:
    nodes = Nodes()
    for second in range(3):
        nodes.now_s = float(second)
        nodes.publish("/cmd_vel", bad)
    assert nodes.actions == []
    assert nodes.inputs.refused == {"/cmd_vel": 3}
    assert len(nodes.problems) == 1
    (told,) = nodes.middleware.sent["/refusals"]
    assert deserialize(told, "std_msgs/msg/String").data == nodes.problems[0]


@pytest.mark.parametrize("cdr", [b"", b"\0", b"\0\1\0\0", b"\0\1\0\0\1\2\3", b"\xff" * 5])
@pytest.mark.parametrize("topic", ["/cmd_vel", "/goal_pose", "/set_mode", "/set_mission", "/operator/ask"])
def test_bytes_that_are_no_message_are_refused(topic: str, cdr: bytes) -> None:
    nodes = Nodes()
    nodes.publish(topic, cdr)
    assert nodes.actions == []
    assert nodes.inputs.refused[topic] == 1
    assert "is not a valid " in nodes.problems[0]


def test_of_ten_thousand_a_second_the_latest_are_passed_on() -> None:
    nodes = Nodes()
    for number in range(2000):
        nodes.now_s = number * 1e-4
        nodes.publish("/cmd_vel", twist(number * 1e-4, 0.0))
    nodes.now_s = 1.0
    nodes.inputs.flush()
    assert 30 <= len(nodes.actions) <= 42  # one in 5 ms
    assert nodes.actions[-1]["speed_mps"] == pytest.approx(0.1999)
    assert len(nodes.actions) + nodes.inputs.superseded["/cmd_vel"] == 2000


def test_other_messages_are_dropped_when_there_are_too_many() -> None:
    nodes = Nodes()
    for number in range(1000):
        nodes.now_s = number * 1e-3
        nodes.publish("/set_mode", made("std_msgs/msg/String", "hold"))
    assert nodes.actions == [{"action": "mode", "mode": "HOLD"}] * 50
    assert nodes.inputs.refused["/set_mode"] == 950


@pytest.mark.parametrize(
    ("frame", "taken"), [("map", True), ("odom", True), ("", True), ("base_link", False), ("earth", False)]
)
def test_a_goal_is_a_place_in_map_or_odom(frame: str, taken: bool) -> None:
    nodes = Nodes()
    nodes.publish("/goal_pose", pose(frame, 20.0, 5.0))  # east, north
    east_m, north_m = (120.0, 205.0) if frame == "odom" else (20.0, 5.0)  # `odom` lies at (100, 200) of `map`
    assert nodes.actions == ([{"action": "goto", "north_m": north_m, "east_m": east_m}] if taken else [])


def test_a_path_is_a_mission_and_an_empty_one_is_none() -> None:
    nodes = Nodes()
    poses = [pose("map", 1.0, 2.0), pose("map", 3.0, 4.0)]
    nodes.publish("/set_mission", made("nav_msgs/msg/Path", header("map"), poses))
    nodes.publish("/set_mission", made("nav_msgs/msg/Path", header("map"), []))
    assert nodes.actions == [{"action": "mission", "do": "replace", "waypoints_ned_m": [[2.0, 1.0], [4.0, 3.0]]}]
    assert "clear_mission" in nodes.problems[0]


def test_services_answer_what_the_run_says_and_are_topics_too() -> None:
    nodes = Nodes()
    assert nodes.call("/arm", b"\0\1\0\0\1") == (True, "")
    assert nodes.call("/mode/smart_rtl") == (True, "")
    nodes.refusal = "pause: time goes by with the clock on the wall"
    assert nodes.call("/pause") == (False, nodes.refusal)
    nodes.publish("/arm", made("std_msgs/msg/Bool", False))
    nodes.publish("/finish", b"\0\1\0\0\0")
    assert nodes.actions == [
        {"action": "arm", "armed": True},
        {"action": "mode", "mode": "SMART_RTL"},
        {"action": "pause"},
        {"action": "arm", "armed": False},
        {"action": "end"},
    ]
    services = {name.strip("/") for name in nodes.middleware.services}
    assert {one.name for one in INPUTS.values() if one.service and "{" not in one.name} <= services
    assert all(f"/{name}" in nodes.middleware.topics for name in services if not name.startswith("mode/"))


@pytest.mark.parametrize(
    ("reference", "current_ned_mps", "asked_mps"),
    [
        ("water", (0.4, 0.0, 0.0), 1.4),  # from astern
        ("water", (-0.4, 0.0, 0.0), 0.6),
        ("water", (0.0, 0.7, 0.0), 1.0),  # abeam
        ("ground", (0.4, 0.7, 0.0), 1.0),
    ],
)
def test_a_speed_through_the_water_has_the_current_along_the_heading_added(
    reference: str, current_ned_mps: tuple[float, float, float], asked_mps: float
) -> None:
    nodes = Nodes("sitl", f"ros.cmd_vel_reference={reference}")
    nodes.inputs.recorded("/truth/odometry", heading_north())
    environment = TOPICS["/environment"].message_type().encode(1, current_ned_mps, (0.0, 0.0, 0.0), 0.0)
    nodes.inputs.recorded("/environment", environment)
    nodes.publish("/cmd_vel", twist(1.0, 0.0))
    assert nodes.actions[-1]["speed_mps"] == pytest.approx(asked_mps)


def test_a_speed_through_the_water_waits_for_the_first_current() -> None:
    nodes = Nodes("sitl", "ros.cmd_vel_reference=water")
    nodes.publish("/cmd_vel", twist(1.0, 0.0))
    assert nodes.actions == []
    assert nodes.inputs.refused == {"/cmd_vel": 1}
    assert "wait for the first message on current" in nodes.problems[0]


def heading_north() -> bytes:
    """/truth/odometry of a vessel at 3 m east, 4 m north that heads north."""
    turn = made("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(math.pi / 4), math.cos(math.pi / 4))
    place = made("geometry_msgs/msg/Pose", made("geometry_msgs/msg/Point", 3.0, 4.0, 0.0), turn)
    there = made("geometry_msgs/msg/PoseWithCovariance", place, np.zeros(36))
    moving = made("geometry_msgs/msg/TwistWithCovariance", twist(0.0, 0.0), np.zeros(36))
    return serialize(made("nav_msgs/msg/Odometry", header("map"), "base_link", there, moving))


def test_debris_goes_ahead_of_the_bow(golden: Golden) -> None:
    nodes = Nodes()
    done, answer = nodes.call("/launch_debris")
    assert not done
    golden("answer", answer)
    nodes.inputs.recorded("/truth/odometry", heading_north())
    assert nodes.call("/launch_debris") == (True, "")
    assert nodes.actions[-1] == {"action": "launch", "kind": "trunk", "north_m": 24.0, "east_m": 3.0}


def test_any_action_as_json() -> None:
    nodes = Nodes()
    nodes.publish("/operator/ask", made("std_msgs/msg/String", json.dumps({"action": "wind", "mean_mps": 6})))
    nodes.publish("/operator/ask", made("std_msgs/msg/String", "wind"))
    assert nodes.actions == [{"action": "wind", "mean_mps": 6}]
    assert "is not JSON" in nodes.problems[0]


def test_vessels_of_a_fleet_have_names_of_their_own() -> None:
    nodes = Nodes("fleet-convoy", "ros.namespace=harbour")
    first = load_profile("fleet-convoy").run_profiles()[0].vessel
    nodes.publish(f"/harbour/{first}/cmd_vel", twist(1.0, 0.0))
    assert nodes.actions[-1]["vessel"] == first
    nodes.publish(f"/harbour/{first}/goal_pose", pose(f"{first}/odom", 1.0, 2.0))
    nodes.publish(f"/harbour/{first}/goal_pose", pose("odom", 1.0, 2.0))
    assert len(nodes.actions) == 2
    assert f"use map or {first}/odom" in nodes.problems[0]
    assert "/harbour/pause" in nodes.middleware.services


def test_ready_is_asked_for_in_lockstep_alone_and_goes_after_what_came_before_it() -> None:
    assert "/ready" not in Nodes().middleware.topics
    nodes = Nodes("sitl", "ros.lockstep={nodes: [avoider]}")
    nodes.publish("/cmd_vel", twist(1.0, 0.0))
    nodes.publish("/cmd_vel", twist(2.0, 0.0))  # within 5 ms of the one before it
    nodes.publish("/ready", header("avoider", 1_200_000_000))
    assert nodes.answers == []
    nodes.inputs.flush()
    assert [action["speed_mps"] for action in nodes.actions] == [1.0, 2.0]
    assert nodes.answers == [("avoider", 1_200_000_000)]
    for number in range(200):  # of them none is too many
        nodes.publish("/ready", header("avoider", 2_000_000_000 + number))
    nodes.inputs.flush()
    assert len(nodes.answers) == 201


@pytest.mark.parametrize("newton", [0.0, 10.0, 60.0, -25.0, 1e9, -1e9])
def test_a_thrust_at_rest_is_what_the_propeller_then_gives(newton: float) -> None:
    vehicle = load_profile("mitl", ["vehicle.propellers.0.max_thrust_n=250"]).runnable().vehicle
    ahead_n, astern_n = vehicle.propellers[0].static_thrust_n(Water().density_kgpm3)
    command = command_of_thrust(newton, ahead_n, astern_n)
    full_n = ahead_n if command >= 0 else astern_n
    assert full_n * command * abs(command) == pytest.approx(min(max(newton, -astern_n), ahead_n))


def test_thrusters_are_commanded_in_newton_or_shares_by_vrx_s_names() -> None:
    nodes = Nodes("mitl", "driver.kind=ros", "ros.enabled=false")
    ahead_n, _ = load_profile("mitl").runnable().vehicle.propellers[0].static_thrust_n(Water().density_kgpm3)
    nodes.publish("/thrusters/left/cmd", made("std_msgs/msg/Float64", 0.25 * ahead_n))
    nodes.publish("/thrusters/right/cmd", made("std_msgs/msg/Float64", NAN))
    assert nodes.actions == [{"action": "motor", "number": 0, "command": pytest.approx(0.5)}]
    shares = Nodes("mitl", "driver.kind=ros", "ros.thrust=share")
    shares.publish("/thrusters/right/cmd", made("std_msgs/msg/Float64", -0.3))
    assert shares.actions == [{"action": "motor", "number": 1, "command": -0.3}]


def test_gears_and_rudders_are_commanded_by_their_angle() -> None:
    profile = load_profile("sitl-ardupilot-steered")
    run = profile.runnable()
    commands = dict(motor_commands(run, shares=False))
    assert len(commands) == run.vehicle.commands
    (name,) = [name for name in commands if name.endswith("/pos")]
    gear = run.vehicle.propellers[0].steering
    assert gear is not None
    assert commands[name](math.radians(0.5 * gear.max_angle_deg)) == pytest.approx(0.5)
    assert commands[name](-9.0) == -1.0
