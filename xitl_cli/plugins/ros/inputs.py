"""Topics and services through which ROS nodes request actions of a run, with the action of each.

The bridge takes its subscriptions and services from INPUTS, and so does the table of docs/ros.md (`make pages`). All
types are standard, so that a node needs no packages of xitl. A message is checked twice. This module checks for finite
numbers and a known frame. The run checks that it can carry out the action.
"""

from __future__ import annotations

import json
import math
import struct
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from agent.mavlink.modes import ROVER_MODE_NUMBERS
from xitl_cli.plugins.ros.definitions import deserialize
from xitl_cli.plugins.ros.frames import frame_name
from xitl_cli.plugins.ros.middleware import COMMANDS, RELIABLE, Middleware
from xitl_cli.plugins.ros.outputs import ENVIRONMENT, TRUTH, ros_name
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MAP_FRAME, ODOM_FRAME, TOPICS, VESSEL_FRAME
from xitl_cli.replay.thrust_log import motor_commands

Action = Mapping[str, Any]
STREAM_S = 0.005
"""Of a stream that comes faster than this the latest is passed on."""
MOST_A_SECOND = 50
"""Of anything else: what is more is dropped."""
SPINS = 5
"""With nothing to wait for: rclpy calls one handler in each."""
AHEAD_M = 20.0
"""Of the vessel: where `launch_debris` puts a trunk."""
REFUSALS, READY = "refusals", "ready"
TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"
_EMPTY, _BOOL, _STRING, _NUMBER = (f"std_msgs/msg/{name}" for name in ("Empty", "Bool", "String", "Float64"))
_SAID = {TRIGGER: _EMPTY, SET_BOOL: _BOOL}


class InputError(Exception):
    """A message that asks for nothing that can be: the rest of a sentence that begins with its topic."""


@dataclass(frozen=True, slots=True)
class RosInput:
    """One topic or service that is taken. `name` without namespace and vessel; braces stand for one each.

    of: whose it is. A service is a topic of the same name as well: with std_msgs/Bool for SetBool, Empty for Trigger.
    streams: the latest counts, in force while it is repeated.
    """

    name: str
    type: str
    meaning: str
    of: Literal["vessel", "run"] = "vessel"
    streams: bool = False

    @property
    def service(self) -> bool:
        return "/srv/" in self.type


_TABLE = (
    RosInput("cmd_vel", "geometry_msgs/msg/Twist",
             "`linear.x`: speed in m/s, negative astern, over ground or through the water "
             "(`ros.cmd_vel_reference`); `angular.z`: turn rate in rad/s to port; `ros.cmd_vel: "
             "TwistStamped` changes the type", streams=True),
    RosInput("thrusters/{thruster}/cmd", _NUMBER,
             "without an autopilot: thrust at rest in N, negative astern, as in VRX; with `ros.thrust: "
             "share` a motor command in [-1, 1]", streams=True),
    RosInput("thrusters/{gear}/pos", _NUMBER,
             "without an autopilot: angle of a steering gear or rudder in rad, counter-clockwise seen from above",
             streams=True),
    RosInput("goal_pose", "geometry_msgs/msg/PoseStamped",
             "GUIDED to a position in `map` or `odom`; the heading is ignored"),
    RosInput("arm", SET_BOOL, "arms or disarms"),
    RosInput("set_mode", _STRING, "sets a mode by its name, such as `LOITER`"),
    RosInput("mode/{mode}", TRIGGER, "the same, with one service per mode: `mode/hold`; it has no topic"),
    RosInput("start_mission", TRIGGER, "starts the mission on board, from its first waypoint"),
    RosInput("clear_mission", TRIGGER, "removes the mission from the autopilot"),
    RosInput("set_mission", "nav_msgs/msg/Path", "its poses in `map` or `odom` become the mission"),
    RosInput("launch_debris", TRIGGER, f"launches a drifting trunk {AHEAD_M:g} m ahead of the vessel"),
    RosInput("finish", TRIGGER, "ends the run, with `driver.kind: ros`"),
    RosInput("clicked_point", "geometry_msgs/msg/PointStamped",
             "launches a drifting trunk at a point of `map`, as RViz publishes it", "run"),
    RosInput("pause", TRIGGER, "in lockstep: pauses the run", "run"),
    RosInput("resume", TRIGGER, "continues the run", "run"),
    RosInput("step", TRIGGER, "continues a paused run for `ros.lockstep.step_s`, or 0.1 s", "run"),
    RosInput("operator/ask", _STRING,
             "any action as JSON: [view.md](view.md#what-a-person-does-is-part-of-the-run)", "run"),
    RosInput(READY, "std_msgs/msg/Header",
             "with `ros.lockstep`: the node of this name (`frame_id`) has answered the `/clock` of this stamp", "run"),
)  # fmt: skip
INPUTS = {one.name: one for one in _TABLE}
"""By name."""


class RosInputs:
    """Subscribes and serves all of INPUTS at `middleware`, for the vessels of `profiles`.

    ask: has the run carry out an action, and tells the refusal, None for none. hope: the same without waiting.
    answered: a node has answered a /clock. problem: says a sentence to people. received, refused, superseded: messages
    by topic; superseded ones had a newer one behind them before they were passed on. odom_in_map: east and north of the
    origin of a vessel's `odom` in `map`, in metres.
    """

    def __init__(
        self,
        profiles: Sequence[RunProfile],
        middleware: Middleware,
        ask: Callable[[Action], str | None],
        hope: Callable[[Action], object],
        answered: Callable[[str, int], object] = lambda node, stamp_ns: None,
        problem: Callable[[str], object] = lambda text: None,
        now_s: Callable[[], float] = time.monotonic,
        odom_in_map: Callable[[str], tuple[float, float]] = lambda vessel: (0.0, 0.0),
    ) -> None:
        self._odom_in_map = odom_in_map
        self.received: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.superseded: Counter[str] = Counter()
        self._middleware = middleware
        self._ask, self._hope, self._answered, self._problem = ask, hope, answered, problem
        self._now_s = now_s
        self._said: set[tuple[str, str]] = set()
        self._streams: list[_Stream] = []
        self._answers: list[tuple[str, int]] = []
        self._truth: dict[str, bytes] = {}
        self._environment: dict[str, bytes] = {}
        self._spec = profiles[0].ros
        self._refusals = middleware.advertise(ros_name(self._spec.namespace, "", REFUSALS), _STRING, RELIABLE)
        self._open_of_run(profiles[0])
        for profile in profiles:
            self._open_of_vessel(profile)

    def recorded(self, topic: str, payload: bytes) -> None:
        """Keep the recorded positions of the vessels and the current at their places."""
        if topic.endswith(TRUTH):
            self._truth[topic.removesuffix(TRUTH).strip("/")] = payload
        elif topic.endswith(ENVIRONMENT):
            self._environment[topic.removesuffix(ENVIRONMENT).strip("/")] = payload

    def flush(self) -> None:
        """Pass on what is due. To be called after each spin of the middleware.

        A node publishes its commands before its answer, and both may come within one spin in any order: more spins
        bring what came before the answer, and then it goes.
        """
        if self._answers:
            answers, self._answers = self._answers, []
            for _ in range(SPINS):
                self._middleware.spin(0.0)
            for stream in self._streams:
                stream.flush(waits=False)
            for node, stamp_ns in answers:
                self._answered(node, stamp_ns)
        for stream in self._streams:
            stream.flush()

    # What there is

    def _open_of_run(self, first: RunProfile) -> None:
        lockstep = self._spec.lockstep
        step_s = 0.1 if lockstep is None else lockstep.step_s
        self._open(
            "clicked_point",
            "",
            lambda m: {"action": "launch", "kind": "trunk"} | self._place(m.header.frame_id, m.point, ""),
        )
        for name, action in (("pause", {}), ("resume", {}), ("step", {"seconds": step_s})):
            self._open(name, "", lambda m, asked={"action": name, **action}: asked)  # type: ignore[misc]
        self._open("operator/ask", "", _asked)
        if lockstep is not None:
            self._open(READY, "", self._on_ready)

    def _open_of_vessel(self, profile: RunProfile) -> None:
        vessel = profile.vessel
        of = {"vessel": vessel} if vessel else {}
        stamped = self._spec.cmd_vel == "TwistStamped"
        kind = "geometry_msgs/msg/TwistStamped" if stamped else None
        self._open("cmd_vel", vessel, lambda m: self._velocity(m, vessel, stamped) | of, kind)
        for number, (name, command) in enumerate(motor_commands(profile, self._spec.thrust == "share")):
            self._open(
                "thrusters/{gear}/pos" if name.endswith("/pos") else "thrusters/{thruster}/cmd",
                vessel,
                lambda m, number=number, command=command: _motor(number, command, m.data) | of,  # type: ignore[misc]
                name=name,
            )
        self._open(
            "goal_pose",
            vessel,
            lambda m: {"action": "goto"} | self._place(m.header.frame_id, m.pose.position, vessel) | of,
        )
        self._open("arm", vessel, lambda m: {"action": "arm", "armed": bool(m.data)} | of)
        self._open("set_mode", vessel, lambda m: {"action": "mode", "mode": str(m.data).strip().upper()} | of)
        for mode in ROVER_MODE_NUMBERS:
            asked = {"action": "mode", "mode": mode} | of
            self._open("mode/{mode}", vessel, lambda m, asked=asked: asked, name=f"mode/{mode.lower()}")  # type: ignore[misc]
        self._open("start_mission", vessel, lambda m: {"action": "mission", "do": "start"} | of)
        self._open("clear_mission", vessel, lambda m: {"action": "mission", "do": "clear"} | of)
        self._open("set_mission", vessel, lambda m: self._mission(m, vessel) | of)
        self._open("launch_debris", vessel, lambda m: self._launch_ahead(vessel))
        self._open("finish", vessel, lambda m: {"action": "end"} | of)

    def _open(
        self,
        key: str,
        vessel: str,
        action: Callable[[Any], Action | None],
        type_name: str | None = None,
        name: str = "",
    ) -> None:
        """One of INPUTS; `action` makes one of a message, or None where there is nothing to be done by the run."""
        one = INPUTS[key]
        whole = ros_name(self._spec.namespace, vessel, name or key)
        if one.service:
            serve = self._serve_switch if one.type == SET_BOOL else self._serve_trigger
            self._middleware.serve(whole, one.type, lambda request: serve(whole, request, action))
            if key == "mode/{mode}":
                return
        topic_type = type_name or _SAID.get(one.type, one.type)
        read = lambda cdr: self._read(whole, topic_type, cdr, action)  # noqa: E731
        if one.streams:
            stream = _Stream(read, self._now_s, lambda: self.superseded.update([whole]))
            self._streams.append(stream)
            pass_on = stream.take
        elif key == READY:
            pass_on = read
        else:
            pass_on = _Limited(read, self._now_s, lambda: self._refuse(whole, _TOO_MANY)).take

        def take(cdr: bytes) -> None:
            self.received[whole] += 1
            pass_on(cdr)

        best_effort = one.streams and self._spec.lockstep is None  # what is lost does not repeat
        self._middleware.subscribe(whole, topic_type, COMMANDS if best_effort else RELIABLE, take)

    # What comes

    def _read(self, topic: str, type_name: str, cdr: bytes, action: Callable[[Any], Action | None]) -> None:
        try:
            asked = action(_message(cdr, type_name))
        except InputError as error:
            self._refuse(topic, str(error))
            return
        if asked is not None:
            self._hope(asked)

    def _serve_trigger(self, service: str, request: bytes, action: Callable[[Any], Action | None]) -> bytes:
        return self._serve(service, None, action)

    def _serve_switch(self, service: str, request: bytes, action: Callable[[Any], Action | None]) -> bytes:
        return self._serve(service, _Switch(len(request) > _HEADER and request[_HEADER] != 0), action)

    def _serve(self, service: str, message: Any, action: Callable[[Any], Action | None]) -> bytes:
        self.received[service] += 1
        try:
            asked = action(message)
            refusal = None if asked is None else self._ask(asked)
        except InputError as error:
            refusal = str(error)
        if refusal is not None:
            self.refused[service] += 1
        return answer_cdr(refusal is None, refusal or "")

    def _refuse(self, topic: str, why: str) -> None:
        self.refused[topic] += 1
        self._say(topic, why)

    def _say(self, topic: str, why: str) -> None:
        """To people once for each reason, and to nodes on `refusals`."""
        if (topic, why) not in self._said and len(self._said) < MOST_A_SECOND:
            self._said.add((topic, why))
            self._problem(f"{topic} {why}")
            self._refusals(string_cdr(f"{topic} {why}"))

    def refused_by_run(self, text: str) -> None:
        """The same of what the run would not do."""
        if ("", text) not in self._said and len(self._said) < MOST_A_SECOND:
            self._said.add(("", text))
            self._refusals(string_cdr(text))

    def _velocity(self, message: Any, vessel: str, stamped: bool) -> dict[str, Any]:
        twist = message.twist if stamped else message
        if stamped and message.header.frame_id not in ("", frame_name(VESSEL_FRAME, vessel)):
            raise InputError(f"is in {message.header.frame_id!r}; use {frame_name(VESSEL_FRAME, vessel)}")
        linear, angular = twist.linear, twist.angular
        used = {"linear.x": linear.x, "angular.z": angular.z}
        others = {"linear.y": linear.y, "linear.z": linear.z, "angular.x": angular.x, "angular.y": angular.y}
        _check_finite(used | others)
        if passed_over := [name for name, value in others.items() if value]:
            topic = ros_name(self._spec.namespace, vessel, "cmd_vel")
            self._say(topic, f"has {', '.join(passed_over)}, which is passed over: linear.x and angular.z count")
        speed_mps = float(linear.x)
        if self._spec.cmd_vel_reference == "water":
            speed_mps += self._current_ahead_mps(vessel)
        return {"action": "velocity", "speed_mps": speed_mps, "turn_rate_radps": -float(angular.z)}

    def _current_ahead_mps(self, vessel: str) -> float:
        """Component of the true current at the vessel along its heading. Raises InputError before the first of it."""
        if vessel not in self._environment or vessel not in self._truth:
            raise InputError("has no current to be relative to yet; wait for the first message on current")
        north_mps, east_mps, _ = deserialize(
            self._environment[vessel], TOPICS[ENVIRONMENT].schema
        ).current_ned_mps.tolist()
        yaw_rad = self._yaw_enu_rad(self._true_pose(vessel))
        return float(east_mps * math.cos(yaw_rad) + north_mps * math.sin(yaw_rad))

    def _mission(self, message: Any, vessel: str) -> dict[str, Any]:
        if not len(message.poses):
            raise InputError("has no poses; use clear_mission to take the mission off board")
        places = []
        for pose in message.poses:
            place = self._place(message.header.frame_id or pose.header.frame_id, pose.pose.position, vessel)
            places.append([*place.values()])
        return {"action": "mission", "do": "replace", "waypoints_ned_m": places}

    def _place(self, frame: str, position: Any, vessel: str) -> dict[str, float]:
        """North and east in `map` of a position in `map` or `odom`."""
        _check_frame(frame, vessel)
        _check_finite({"position.x": position.x, "position.y": position.y})
        in_odom = frame == frame_name(ODOM_FRAME, vessel)
        east_m, north_m = self._odom_in_map(vessel) if in_odom else (0.0, 0.0)
        return {"north_m": float(position.y) + north_m, "east_m": float(position.x) + east_m}

    def _launch_ahead(self, vessel: str) -> Action:
        pose = self._true_pose(vessel)
        yaw_rad = self._yaw_enu_rad(pose)
        north_m, east_m = pose.position.y + AHEAD_M * math.sin(yaw_rad), pose.position.x + AHEAD_M * math.cos(yaw_rad)
        return {"action": "launch", "kind": "trunk", "north_m": round(north_m, 3), "east_m": round(east_m, 3)}

    def _true_pose(self, vessel: str) -> Any:
        """The latest geometry_msgs/Pose in `map`. Raises InputError before the first."""
        if vessel not in self._truth:
            raise InputError("has no vessel to be ahead of yet; wait for the first ground_truth/odom")
        return deserialize(self._truth[vessel], "nav_msgs/msg/Odometry").pose.pose

    @staticmethod
    def _yaw_enu_rad(pose: Any) -> float:
        """Counter-clockwise from east."""
        q = pose.orientation
        return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))

    def _on_ready(self, message: Any) -> None:
        self._answers.append((str(message.frame_id), message.stamp.sec * 1_000_000_000 + message.stamp.nanosec))


_HEADER = 4
_TOO_MANY = f"comes more than {MOST_A_SECOND} times a second; what is more is dropped"


@dataclass(frozen=True, slots=True)
class _Switch:
    """A request of std_srvs/SetBool."""

    data: bool


def string_cdr(text: str) -> bytes:
    """A std_msgs/String."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(data)) + data


def answer_cdr(success: bool, text: str) -> bytes:
    """A response of std_srvs/Trigger or SetBool: success and message."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<?xxxI", success, len(data)) + data


def _motor(number: int, command: Callable[[float], float], value: float) -> dict[str, Any]:
    _check_finite({"data": value})
    return {"action": "motor", "number": number, "command": command(float(value))}


def _asked(message: Any) -> Action:
    try:
        action = json.loads(message.data)
    except ValueError as error:
        raise InputError(f"is no JSON ({error})") from None
    if not isinstance(action, dict):
        raise InputError('is no JSON object; write one such as {"action": "pause"}')
    return action


def _check_frame(frame: str, vessel: str) -> None:
    """A frame that is empty is taken for `map`, as it is typed at a command line."""
    known = (MAP_FRAME, frame_name(ODOM_FRAME, vessel))
    if frame not in ("", *known):
        raise InputError(f"is in {frame!r}, which is not known; use {' or '.join(dict.fromkeys(known))}")


def _check_finite(named: Mapping[str, float]) -> None:
    for name, value in named.items():
        if not math.isfinite(value):
            raise InputError(f"has {name} = {value}; it was not passed on")


def _message(cdr: bytes, type_name: str) -> Any:
    try:
        return None if type_name == _EMPTY else deserialize(cdr, type_name)
    except Exception as error:  # rosbags raises what numpy and struct do as well  # noqa: BLE001
        raise InputError(f"is no {type_name} ({error or type(error).__name__})") from None


class _Stream:
    """Passes on the latest message, at most every STREAM_S; `superseded` is called for each that had one behind it."""

    def __init__(
        self, pass_on: Callable[[bytes], object], now_s: Callable[[], float], superseded: Callable[[], object]
    ) -> None:
        self._pass_on, self._now_s, self._superseded = pass_on, now_s, superseded
        self._next_s = 0.0
        self._kept: bytes | None = None

    def take(self, cdr: bytes) -> None:
        if self._kept is not None:
            self._superseded()
        self._kept = cdr
        self.flush()

    def flush(self, waits: bool = True) -> None:
        now_s = self._now_s()
        if self._kept is not None and (now_s >= self._next_s or not waits):
            kept, self._kept, self._next_s = self._kept, None, now_s + STREAM_S
            self._pass_on(kept)


class _Limited:
    """Passes on MOST_A_SECOND messages of each second; `dropped` is called for each of the others."""

    def __init__(
        self, pass_on: Callable[[bytes], object], now_s: Callable[[], float], dropped: Callable[[], object]
    ) -> None:
        self._pass_on, self._now_s, self._dropped = pass_on, now_s, dropped
        self._second, self._count = 0.0, 0

    def take(self, cdr: bytes) -> None:
        now_s = self._now_s()
        if now_s - self._second >= 1.0:
            self._second, self._count = now_s, 0
        self._count += 1
        if self._count > MOST_A_SECOND:
            self._dropped()
        else:
            self._pass_on(cdr)
