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
from functools import partial
from typing import Any, Literal

from agent.mavlink.modes import ROVER_MODE_NUMBERS
from sim_core.dataclass import dataclass
from xitl_cli.plugins.ros.definitions import deserialize
from xitl_cli.plugins.ros.frames import frame_name
from xitl_cli.plugins.ros.middleware import COMMANDS, RELIABLE, Middleware
from xitl_cli.plugins.ros.outputs import ENVIRONMENT, TRUTH, ros_name
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import MAP_FRAME, ODOM_FRAME, TOPICS, VESSEL_FRAME
from xitl_cli.replay.thrust_log import motor_commands

Action = Mapping[str, Any]
STREAM_S = 0.005
"""Shortest interval between passed-on messages of a stream. The latest message replaces the others."""
MOST_A_SECOND = 50
"""Limit for other topics. The excess is dropped."""
SPINS = 5
"""Spins without waiting, because rclpy calls one handler in each."""
AHEAD_M = 20.0
"""Distance from the vessel at which `launch_debris` puts a trunk."""
REFUSALS, READY = "refusals", "ready"
TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"
_EMPTY, _BOOL, _STRING, _NUMBER = (f"std_msgs/msg/{name}" for name in ("Empty", "Bool", "String", "Float64"))
_TOPIC_TYPES = {TRIGGER: _EMPTY, SET_BOOL: _BOOL}
"""Type of the topic with the name of a service, by the service's type."""
_HEADER = 4
_TOO_MANY = f"comes more than {MOST_A_SECOND} times a second; the excess is dropped"


class InputError(Exception):
    """A message requests no possible action. The text continues a sentence that begins with the topic."""


@dataclass(frozen=True, slots=True)
class RosInput:
    """A subscribed topic or an offered service.

    A service is also a topic of the same name, with std_msgs/Bool for SetBool and std_msgs/Empty for Trigger.
    """

    name: str
    """Name without namespace and vessel. A part in braces stands for several names."""
    type: str
    meaning: str
    of: Literal["vessel", "run"] = "vessel"
    """Whether each vessel has it, or the run."""
    streams: bool = False
    """True if the latest message counts, and only while messages are repeated."""

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
    RosInput("start_mission", TRIGGER,
             "starts the mission on board, from its first waypoint; a mission under way continues"),
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
INPUTS = {row.name: row for row in _TABLE}
"""By name."""


class RosInputs:
    """Subscribes to and serves all of INPUTS at `middleware`, for the vessels of `profiles`.

    ask: requests an action of the run, and returns the refusal, None if it is accepted. post: the same without waiting.
    answered: called with the name of a node that has answered a /clock. problem: reports a sentence to the user.
    odom_in_map: returns east and north of the origin of a vessel's `odom` in `map`, in metres.
    """

    def __init__(
        self,
        profiles: Sequence[RunProfile],
        middleware: Middleware,
        ask: Callable[[Action], str | None],
        post: Callable[[Action], object],
        answered: Callable[[str, int], object] = lambda node, stamp_ns: None,
        problem: Callable[[str], object] = lambda text: None,
        now_s: Callable[[], float] = time.monotonic,
        odom_in_map: Callable[[str], tuple[float, float]] = lambda vessel: (0.0, 0.0),
    ) -> None:
        self._odom_in_map = odom_in_map
        self.received: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.superseded: Counter[str] = Counter()
        """Messages by topic that a newer one replaced before they were passed on."""
        self._middleware = middleware
        self._ask, self._post, self._answered, self._problem = ask, post, answered, problem
        self._now_s = now_s
        self._reported: set[tuple[str, str]] = set()
        self._streams: list[_Stream] = []
        self._answers: list[tuple[str, int]] = []
        self._truth: dict[str, bytes] = {}
        self._environment: dict[str, bytes] = {}
        self._spec = profiles[0].ros
        self._refusals = middleware.advertise(ros_name(self._spec.namespace, "", REFUSALS), _STRING, RELIABLE)
        lockstep = self._spec.lockstep
        step_s = 0.1 if lockstep is None else lockstep.step_s
        self._open(
            "clicked_point",
            "",
            lambda m: {"action": "launch", "kind": "trunk"} | self._place(m.header.frame_id, m.point, ""),
        )
        for name, action in (("pause", {}), ("resume", {}), ("step", {"seconds": step_s})):
            self._open(name, "", lambda m, request={"action": name, **action}: request)  # type: ignore[misc]
        self._open("operator/ask", "", _action_of_json)
        if lockstep is not None:
            self._open(READY, "", self._on_ready)
        for profile in profiles:
            self._open_vessel_inputs(profile)

    def recorded(self, topic: str, payload: bytes) -> None:
        """Keep the latest recorded pose of each vessel, and the current at its position."""
        if topic.endswith(TRUTH):
            self._truth[topic.removesuffix(TRUTH).strip("/")] = payload
        elif topic.endswith(ENVIRONMENT):
            self._environment[topic.removesuffix(ENVIRONMENT).strip("/")] = payload

    def flush(self) -> None:
        """Pass on due messages. Call it after each spin of the middleware.

        A node publishes its commands before its answer, but one spin may deliver them in any order. Therefore, more
        spins deliver all earlier commands before the answer is passed on.
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

    def _open_vessel_inputs(self, profile: RunProfile) -> None:
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
            request = {"action": "mode", "mode": mode} | of
            self._open("mode/{mode}", vessel, lambda m, request=request: request, name=f"mode/{mode.lower()}")  # type: ignore[misc]
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
        """Open one of INPUTS. action: makes an action from a message, None if the run has nothing to do."""
        row = INPUTS[key]
        topic = ros_name(self._spec.namespace, vessel, name or key)
        if row.service:
            self._middleware.serve(topic, row.type, partial(self._serve, topic, row.type, action))
            if key == "mode/{mode}":
                return
        topic_type = type_name or _TOPIC_TYPES.get(row.type, row.type)
        pass_on: Callable[[bytes], None] = partial(self._read, topic, topic_type, action)
        if row.streams:
            stream = _Stream(pass_on, self._now_s, lambda: self.superseded.update([topic]))
            self._streams.append(stream)
            pass_on = stream.add
        elif key != READY:
            pass_on = _Limited(pass_on, self._now_s, lambda: self._refuse(topic, _TOO_MANY)).add

        def receive(cdr: bytes) -> None:
            self.received[topic] += 1
            pass_on(cdr)

        best_effort = row.streams and self._spec.lockstep is None  # in lockstep, a lost message would not repeat
        self._middleware.subscribe(topic, topic_type, COMMANDS if best_effort else RELIABLE, receive)

    def _read(self, topic: str, type_name: str, action: Callable[[Any], Action | None], cdr: bytes) -> None:
        """Handle a message of a topic."""
        try:
            try:
                message = None if type_name == _EMPTY else deserialize(cdr, type_name)
            except Exception as error:  # rosbags also raises errors of numpy and struct  # noqa: BLE001
                raise InputError(f"is not a valid {type_name} ({error or type(error).__name__})") from None
            request = action(message)
        except InputError as error:
            self._refuse(topic, str(error))
            return
        if request is not None:
            self._post(request)

    def _serve(self, service: str, type_name: str, action: Callable[[Any], Action | None], cdr: bytes) -> bytes:
        """Handle a request of a service, and return the response."""
        self.received[service] += 1
        message = _Switch(len(cdr) > _HEADER and cdr[_HEADER] != 0) if type_name == SET_BOOL else None
        try:
            request = action(message)
            refusal = None if request is None else self._ask(request)
        except InputError as error:
            refusal = str(error)
        if refusal is not None:
            self.refused[service] += 1
        return answer_cdr(refusal is None, refusal or "")

    def _refuse(self, topic: str, why: str) -> None:
        self.refused[topic] += 1
        self._report(topic, why)

    def _report(self, topic: str, why: str) -> None:
        """Report each reason once to the user, and to nodes on `refusals`."""
        if (topic, why) not in self._reported and len(self._reported) < MOST_A_SECOND:
            self._reported.add((topic, why))
            self._problem(f"{topic} {why}")
            self._refusals(string_cdr(f"{topic} {why}"))

    def refused_by_run(self, text: str) -> None:
        """Report a refusal of the run to nodes, once for each text."""
        if ("", text) not in self._reported and len(self._reported) < MOST_A_SECOND:
            self._reported.add(("", text))
            self._refusals(string_cdr(text))

    # Actions of messages

    def _velocity(self, message: Any, vessel: str, stamped: bool) -> dict[str, Any]:
        twist = message.twist if stamped else message
        if stamped and message.header.frame_id not in ("", frame_name(VESSEL_FRAME, vessel)):
            frame = message.header.frame_id
            raise InputError(f"has the frame {frame!r}; use {frame_name(VESSEL_FRAME, vessel)}")
        linear, angular = twist.linear, twist.angular
        used = {"linear.x": linear.x, "angular.z": angular.z}
        others = {"linear.y": linear.y, "linear.z": linear.z, "angular.x": angular.x, "angular.y": angular.y}
        _check_finite(used | others)
        if ignored := [name for name, value in others.items() if value]:
            topic = ros_name(self._spec.namespace, vessel, "cmd_vel")
            self._report(topic, f"has {', '.join(ignored)}; only linear.x and angular.z are used")
        speed_mps = float(linear.x)
        if self._spec.cmd_vel_reference == "water":
            # Add the component of the true current at the vessel along its heading
            if vessel not in self._environment or vessel not in self._truth:
                raise InputError("needs the current, which is not known yet; wait for the first message on current")
            environment = deserialize(self._environment[vessel], TOPICS[ENVIRONMENT].schema)
            north_mps, east_mps, _ = environment.current_ned_mps.tolist()
            yaw_rad = self._yaw_enu_rad(self._true_pose(vessel))
            speed_mps += float(east_mps * math.cos(yaw_rad) + north_mps * math.sin(yaw_rad))
        return {"action": "velocity", "speed_mps": speed_mps, "turn_rate_radps": -float(angular.z)}

    def _mission(self, message: Any, vessel: str) -> dict[str, Any]:
        if not len(message.poses):
            raise InputError("has no poses; use clear_mission to remove the mission from the autopilot")
        places = []
        for pose in message.poses:
            place = self._place(message.header.frame_id or pose.header.frame_id, pose.pose.position, vessel)
            places.append([*place.values()])
        return {"action": "mission", "do": "replace", "waypoints_ned_m": places}

    def _place(self, frame: str, position: Any, vessel: str) -> dict[str, float]:
        """Return north and east in `map` of a position in `map` or `odom`. An empty frame means `map`."""
        known = (MAP_FRAME, frame_name(ODOM_FRAME, vessel))
        if frame not in ("", *known):
            raise InputError(f"has the unknown frame {frame!r}; use {' or '.join(dict.fromkeys(known))}")
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
        """Return the latest geometry_msgs/Pose in `map`. Raises InputError before the first."""
        if vessel not in self._truth:
            raise InputError("needs the vessel's pose, which is not known yet; wait for the first ground_truth/odom")
        return deserialize(self._truth[vessel], "nav_msgs/msg/Odometry").pose.pose

    @staticmethod
    def _yaw_enu_rad(pose: Any) -> float:
        """Return the heading, counter-clockwise from east."""
        q = pose.orientation
        return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))

    def _on_ready(self, message: Any) -> None:
        self._answers.append((str(message.frame_id), message.stamp.sec * 1_000_000_000 + message.stamp.nanosec))


@dataclass(frozen=True, slots=True)
class _Switch:
    """A request of std_srvs/SetBool."""

    data: bool


def string_cdr(text: str) -> bytes:
    """Return a std_msgs/String."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(data)) + data


def answer_cdr(success: bool, text: str) -> bytes:
    """Return a response of std_srvs/Trigger or SetBool: success and message."""
    data = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<?xxxI", success, len(data)) + data


def _motor(number: int, command: Callable[[float], float], value: float) -> dict[str, Any]:
    _check_finite({"data": value})
    return {"action": "motor", "number": number, "command": command(float(value))}


def _action_of_json(message: Any) -> Action:
    try:
        action = json.loads(message.data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not JSON ({error})") from None
    if not isinstance(action, dict):
        raise InputError('is not a JSON object; write one such as {"action": "pause"}')
    return action


def _check_finite(named: Mapping[str, float]) -> None:
    for name, value in named.items():
        if not math.isfinite(value):
            raise InputError(f"has {name} = {value}; publish finite numbers")


class _Stream:
    """Passes on the latest message, at most every STREAM_S. `superseded` is called for each replaced message."""

    def __init__(
        self, pass_on: Callable[[bytes], object], now_s: Callable[[], float], superseded: Callable[[], object]
    ) -> None:
        self._pass_on, self._now_s, self._superseded = pass_on, now_s, superseded
        self._next_s = 0.0
        self._latest: bytes | None = None

    def add(self, cdr: bytes) -> None:
        if self._latest is not None:
            self._superseded()
        self._latest = cdr
        self.flush()

    def flush(self, waits: bool = True) -> None:
        now_s = self._now_s()
        if self._latest is not None and (now_s >= self._next_s or not waits):
            latest, self._latest, self._next_s = self._latest, None, now_s + STREAM_S
            self._pass_on(latest)


class _Limited:
    """Passes on MOST_A_SECOND messages of each second. `dropped` is called for each of the others."""

    def __init__(
        self, pass_on: Callable[[bytes], object], now_s: Callable[[], float], dropped: Callable[[], object]
    ) -> None:
        self._pass_on, self._now_s, self._dropped = pass_on, now_s, dropped
        self._second, self._count = 0.0, 0

    def add(self, cdr: bytes) -> None:
        now_s = self._now_s()
        if now_s - self._second >= 1.0:
            self._second, self._count = now_s, 0
        self._count += 1
        if self._count > MOST_A_SECOND:
            self._dropped()
        else:
            self._pass_on(cdr)
