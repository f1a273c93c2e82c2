"""The ROS topics of a run: names, types, QoS and meanings, and the changes and user topics of `ros.topics`.

OUTPUTS is the source of live topics, of topics in bags, and of the table in docs/ros.md (`make pages`). A user topic
has `of`, a topic of the recording. It is a field of this topic, or all of it.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Literal

from agent.wire import dialect
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.profile.schema.ros import RosSpec, RosTopicSpec
from xitl_cli.record.topics import TOPICS

QosKind = Literal["sensor", "latched", "clock"]
"""sensor: reliable, volatile. latched: reliable, transient local, only the last message. clock: as sensor."""


@dataclass(frozen=True, slots=True)
class RosTopic:
    """One topic."""

    name: str
    """Name without namespace and vessel, `imu/data`. A leading slash: one topic for all vessels. A part in braces
    stands for several names.
    """
    type: str
    """Type in the notation of ROS 2, `sensor_msgs/msg/Imu`."""
    rate: str
    frame: str
    meaning: str
    sources: tuple[str, ...] = ()
    """Topics of the recording that it is made from."""
    qos: QosKind = "sensor"
    called: str = ""
    """Name from the profile that replaces `name`."""

    @property
    def of_all(self) -> bool:
        """True for one topic for all vessels."""
        return (self.called or self.name).startswith("/")

    def of(self, part: str) -> RosTopic:
        """Return the topic with `part` in place of the braces."""
        before, _, rest = self.name.partition("{")
        return replace(self, name=before + part + rest.partition("}")[2])

    def full_name(self, vessel: str = "", namespace: str = "") -> str:
        """Return the name with namespace and vessel: `/harbour/alpha/imu/data`. Topics for all vessels have neither."""
        name = self.called or self.name
        return name if self.of_all else ros_name(namespace, vessel, name)


def ros_name(*parts: str) -> str:
    """Return `/harbour/alpha/imu/data` from namespace, vessel and topic. Each of them may be empty."""
    return "/" + "/".join(part.strip("/") for part in parts if part.strip("/"))


SENSORS_LINK, ANSWERS_LINK = "/link/agent/tx", "/link/agent/rx"
TRUTH, TRUE_STATE, TRUE_FIX, ESTIMATE = "/truth/odometry", "/truth/state", "/truth/fix", "/estimate/odometry"
TICKS, ENVIRONMENT = "/actuators", "/environment"
DIAGNOSED = ("/tasks", "/pace", "/links", "/clocks", "/nodes")

_TABLE = (
    RosTopic("/clock", "rosgraph_msgs/msg/Clock", "`clock.exchange_rate_hz`", "", "simulation time", (TICKS,), "clock"),
    RosTopic("/tf", "tf2_msgs/msg/TFMessage", "as `odometry`; moving links 10 Hz", "",
             "`odom` → `base_link`, continuous, and `map` → `odom` with the corrections of the "
             "autopilot's estimate; without an autopilot the truth (`ros.tf`); gears and rudders; cameras on gimbals "
             "at each image",
             (ESTIMATE, TRUTH, TRUE_STATE, "/cameras/frames")),
    RosTopic("/tf_static", "tf2_msgs/msg/TFMessage", "once", "",
             "the mounting positions of sensors and thrusters; also `map` → `odom` if the truth moves `base_link`",
             (), "latched"),
    RosTopic("imu/data", "sensor_msgs/msg/Imu", "`sensors.imu.rate_hz`", "imu_link",
             "angular velocity and specific force as measured (REP 145: at rest +g upwards); orientation "
             "in ENU from the autopilot's estimate, extrapolated with the gyroscope; its covariance "
             "begins with -1 without an orientation",
             (SENSORS_LINK, ESTIMATE)),
    RosTopic("fix", "sensor_msgs/msg/NavSatFix", "`sensors.gnss.rate_hz`", "gnss_link",
             "position of the antenna, altitude above the ellipsoid, the receiver's own accuracy as covariance",
             (SENSORS_LINK,)),
    RosTopic("fix_velocity", "geometry_msgs/msg/TwistStamped", "the same", "map",
             "velocity of the antenna over ground in ENU, as the receiver measures it", (SENSORS_LINK,)),
    RosTopic("odometry", "nav_msgs/msg/Odometry", "`ros.estimate_rate_hz`", "odom → base_link",
             "the autopilot's estimate: its velocity is integrated, so the position never jumps (REP "
             "105); add `map` → `odom` for the estimated position; twist in `base_link`", (ESTIMATE,)),
    RosTopic("ground_truth/odom", "nav_msgs/msg/Odometry", "`recording.truth_rate_hz`", "map → base_link",
             "the true motion; twist in `base_link`, covariances zero", (TRUTH,)),
    RosTopic("ground_truth/fix", "sensor_msgs/msg/NavSatFix", "10 Hz", "base_link",
             "the true position on the Earth, altitude above the ellipsoid, covariances zero; together "
             "with `ground_truth/odom`, it gives the position of `map` on the Earth", (TRUE_FIX,)),
    RosTopic("magnetic_field", "sensor_msgs/msg/MagneticField", "`sensors.magnetometer.rate_hz`", "base_link",
             "in tesla", (SENSORS_LINK,)),
    RosTopic("fluid_pressure", "sensor_msgs/msg/FluidPressure", "`sensors.barometer.rate_hz`", "base_link",
             "static pressure of the air in pascal", (SENSORS_LINK,)),
    RosTopic("range/{rangefinder}", "sensor_msgs/msg/Range", "`sensors.rangefinders.N.rate_hz`", "rangefinder_N_link",
             "`range/rangefinder_0`, along the frame's x axis; -inf below its shortest range, +inf above "
             "its longest (REP 117)",
             (SENSORS_LINK,)),
    RosTopic("scan", "sensor_msgs/msg/LaserScan", "each cloud", "base_link",
             "nearest return in each degree of azimuth, from the cloud's points between 0.1 m and 3 m "
             "above the water, as in pointcloud_to_laserscan (the lidar has no ring); without a lidar, "
             "the 72 sectors of `sensors.messages.obstacle_distance`", ("/lidar/points", SENSORS_LINK)),
    RosTopic("points", "sensor_msgs/msg/PointCloud2", "`sensors.lidar.rate_hz`", "lidar_link",
             "a lidar's cloud: x y z, intensity, `time` in seconds after the stamp; each point is "
             "relative to the vessel at its own time",
             ("/lidar/points",)),
    RosTopic("sonar/points", "sensor_msgs/msg/PointCloud2", "each ping", "sonar_link",
             "points detected in the echo: x y z, intensity", ("/sonar/points",)),
    RosTopic("sonar/echo", "sensor_msgs/msg/PointCloud2", "each ping", "sonar_link",
             "the whole echo, one point per sample along the beam: x y z, intensity", ("/sonar/ping",)),
    RosTopic("cameras/{camera}/image_raw/compressed", "sensor_msgs/msg/CompressedImage", "`sensors.cameras.N.rate_hz`",
             "camera_NAME_optical",
             "JPEG of a colour camera; PNG with the class, or with the temperature in 0.01 K, of each pixel",
             ("/cameras/{camera}/image",)),
    RosTopic("cameras/{camera}/image_raw", "sensor_msgs/msg/Image", "`sensors.cameras.N.rate_hz`, depth cameras only",
             "camera_NAME_optical", "`32FC1`, metres along the optical axis, +inf for the sky (REP 118)",
             ("/cameras/{camera}/image",)),
    RosTopic("cameras/{camera}/camera_info", "sensor_msgs/msg/CameraInfo", "each image", "camera_NAME_optical",
             "lens, with the stamp of its image: `plumb_bob`, or `equidistant` of a fisheye",
             ("/cameras/{camera}/calibration",)),
    RosTopic("marine_radar/spokes", "marine_sensor_msgs/msg/RadarSector", "24 per turn", "radar_link",
             "spokes of the radar: intensity 0 to 255; angles counter-clockwise, so the increment is negative",
             ("/marine_radar/sector",)),
    RosTopic("wind", "geometry_msgs/msg/Vector3Stamped", "10 Hz", "map",
             "velocity of the air at the vessel in ENU, m/s; it points to where the wind blows", (ENVIRONMENT,)),
    RosTopic("current", "geometry_msgs/msg/Vector3Stamped", "10 Hz", "map",
             "velocity of the water at the vessel in ENU, m/s", (ENVIRONMENT,)),
    RosTopic("thrusters/{thruster}/state", "sensor_msgs/msg/JointState", "10 Hz", "",
             "`left` and `right`, or `propeller_0` …, and `rudder_0` …: position is the angle of gear or "
             "rudder in rad, counter-clockwise seen from above; velocity is the speed of the shaft in "
             "rad/s, NaN if the vehicle file does not define it; effort is the thrust at rest in N", (TRUE_STATE,)),
    RosTopic("joint_states", "sensor_msgs/msg/JointState", "10 Hz, with gears or rudders", "",
             "angles of gears and rudders by the joints of the robot description", (TRUE_STATE,)),
    RosTopic("battery", "sensor_msgs/msg/BatteryState", "as the autopilot sends it", "",
             "if the autopilot reports one", (ANSWERS_LINK,)),
    RosTopic("diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "1 Hz", "",
             "deadlines missed, losses and latencies of links, drift of clocks, stalls of the host, load of boards",
             (*DIAGNOSED, TICKS)),
    RosTopic("mission", "nav_msgs/msg/Path", "once, and at each change", "map", "start and waypoints",
             (SENSORS_LINK,), "latched"),
    RosTopic("mode", "std_msgs/msg/String", "at each change", "", "mode of the autopilot, such as `GUIDED`",
             (ANSWERS_LINK,), "latched"),
    RosTopic("armed", "std_msgs/msg/Bool", "at each change", "", "whether the autopilot is armed",
             (ANSWERS_LINK,), "latched"),
    RosTopic("ais/nmea", "std_msgs/msg/String", "each received transmission, fleets only", "",
             "transmissions that the vessel's AIS receiver received: one `!AIVDM` sentence of NMEA 0183 "
             "per message", ("/ais",)),
    RosTopic("robot_description", "std_msgs/msg/String", "once", "", "URDF of the vessel", (), "latched"),
)  # fmt: skip

OUTPUTS = {topic.name: topic for topic in _TABLE}
"""By name."""


TYPES: dict[str, type] = {
    "std_msgs/msg/Float64": float,
    "std_msgs/msg/Float32": float,
    "std_msgs/msg/Int64": int,
    "std_msgs/msg/Int32": int,
    "std_msgs/msg/Bool": bool,
    "std_msgs/msg/String": str,
    "std_msgs/msg/Float64MultiArray": list,
}
"""Types of single-field topics: the only field is `data`."""
_NAME = re.compile(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", re.ASCII)
LINK_NAME = re.compile(r"/link/[a-z]+/(tx|rx)")
_STEP = re.compile(r"([A-Za-z]\w*)((?:\[\d+\])*)", re.ASCII)
_MAVLINK = {kind.msgname: number for number, kind in dialect.mavlink_map.items()}


@dataclass(frozen=True, slots=True)
class UserTopic:
    """A user topic."""

    topic: RosTopic
    of: str
    """The recorded topic."""
    message: int | None
    """Number of the MAVLink message in its frames, None for a message of xitl."""
    read: Callable[[Any], Any] | None
    """Returns the value in a message, None if the message is published as recorded."""


def named_topics(spec: RosSpec) -> dict[str, RosTopic]:
    """Return the topics of OUTPUTS by their names, renamed as in the profile. Raises UserError for an unknown topic."""
    named = dict(OUTPUTS)
    for name, asked in spec.topics.items():
        if asked.of is not None:
            continue
        path, known = f"ros.topics.{name}", _pattern(name)
        if known is None:
            close = difflib.get_close_matches(name, OUTPUTS, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(OUTPUTS)}"
            raise UserError(f"{path} is not a topic of a run; {hint} A topic of your own needs `of`")
        for key in ("type", "message", "field"):
            if getattr(asked, key) is not None:
                raise UserError(f"{path}.{key} is for a topic of your own; name its recorded topic with `of`")
        if asked.name is not None:
            if "{" in known:
                raise UserError(f"{path}.name: a topic with several instances cannot be renamed; omit this key")
            named[known] = replace(OUTPUTS[known], called=_checked_name(path, asked.name))
    return named


def user_topics(spec: RosSpec) -> Iterator[UserTopic]:
    """Yield the user topics. Raises UserError for an invalid topic."""
    for name, asked in spec.topics.items():
        if asked.of is not None:
            yield _user_topic(name, asked)


def check_topics(spec: RosSpec) -> None:
    """Raises UserError for invalid entries of `ros.topics`, and for two topics with one name."""
    topics = [*named_topics(spec).values(), *(user.topic for user in user_topics(spec))]
    seen: set[str] = set()
    for topic in topics:
        if (name := topic.full_name()) in seen:
            raise UserError(f"ros.topics.{topic.name}: {name} already exists; rename one of the two")
        seen.add(name)


def _user_topic(name: str, asked: RosTopicSpec) -> UserTopic:
    path = f"ros.topics.{name}"
    if _pattern(name) is not None:
        raise UserError(f"{path} is a topic of every run; omit `of`, or choose another name")
    called = _checked_name(path, asked.name or name)
    source = asked.of or ""
    meaning = f"`{source}` {asked.message or ''} {asked.field or 'as it is recorded'}"
    if LINK_NAME.fullmatch(source) and asked.message is not None:
        number = _MAVLINK.get(asked.message)
        if number is None:
            close = difflib.get_close_matches(asked.message, _MAVLINK, n=1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise UserError(f"{path}.message = {asked.message!r} is not a known MAVLink message{hint}")
        fields = dialect.mavlink_map[number].fieldnames
        type_name, read = _field(path, asked, fields)
        return UserTopic(RosTopic(name, type_name, "each", "", meaning, (source,), called=called), source, number, read)
    recorded = TOPICS.get(LINK_NAME.sub(r"/link/{link}/\1", source))
    if recorded is None or recorded.fields is None:
        known = ", ".join(topic.name for topic in TOPICS.values() if topic.fields is not None)
        raise UserError(f"{path}.of = {source!r} is not a recorded topic of xitl; use {known}")
    if asked.message is not None:
        raise UserError(f"{path}.message is for the frames of a link; use of: /link/agent/rx, or omit it")
    if asked.field is None:
        if asked.type not in (None, recorded.schema):
            raise UserError(
                f"{path}.type = {asked.type!r}: {source} has the type {recorded.schema}; for another type, name a field"
            )
        topic = RosTopic(name, recorded.schema, recorded.rate, "", meaning, (source,), called=called)
        return UserTopic(topic, source, None, None)
    fields = ["header", "child_frame_id", "pose", "twist"]
    if recorded.schema.startswith("xitl_msgs/"):
        fields = [field.name for field in recorded.message_type().fields]
    type_name, read = _field(path, asked, fields)
    return UserTopic(
        RosTopic(name, type_name, recorded.rate, "", meaning, (source,), called=called), source, None, read
    )


def _field(path: str, asked: RosTopicSpec, fields: list[str]) -> tuple[str, Callable[[Any], Any]]:
    """Return type and reader of a field. Raises UserError."""
    if asked.field is None:
        raise UserError(f"{path}: needs a field; use field: {', '.join(fields)}")
    type_name = asked.type or "std_msgs/msg/Float64"
    kind = TYPES.get(type_name)
    if kind is None:
        raise UserError(f"{path}.type = {type_name!r} is not a type for a field; use {', '.join(TYPES)}")
    steps = [_STEP.fullmatch(step) for step in asked.field.split(".")]
    if not all(steps) or steps[0] is None or steps[0][1] not in fields:
        raise UserError(f"{path}.field = {asked.field!r} is not a field of {asked.of}; use {', '.join(fields)}")
    ways = [(step[1], [int(index) for index in re.findall(r"\d+", step[2])]) for step in steps if step is not None]

    def read(message: Any) -> Any:
        for name, indices in ways:
            message = getattr(message, name)
            for index in indices:
                message = message[index]
        return [float(value) for value in message] if kind is list else kind(message)

    return type_name, read


def _pattern(name: str) -> str | None:
    """Return the name in OUTPUTS, also for one of several: `range/rangefinder_0`."""
    if name in OUTPUTS:
        return name
    for known in OUTPUTS:
        before, brace, rest = known.partition("{")
        after = rest.partition("}")[2]
        if brace and name.startswith(before) and name.endswith(after) and len(name) > len(before) + len(after):
            return known
    return None


def _checked_name(path: str, name: str) -> str:
    if not _NAME.fullmatch(name):
        raise UserError(f"{path}.name = {name!r} is not a name of ROS; use letters, digits, _ and /, a letter first")
    return name
