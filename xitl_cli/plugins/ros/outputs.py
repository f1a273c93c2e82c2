"""The topics of ROS that a run has: names, types, QoS and meanings, declared once.

From OUTPUTS come what is published live and written into bags, and the table of docs/ros.md (`make pages`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

QosKind = Literal["sensor", "latched", "clock"]
"""sensor: reliable, volatile; latched: reliable, transient local, the last one; clock: as sensor."""


@dataclass(frozen=True, slots=True)
class RosTopic:
    """One topic. `name` without namespace and vessel: `imu/data`; with a slash before it, it is the same for all.

    type: as ROS 2 writes it, `sensor_msgs/msg/Imu`. sources: topics of the recording that it is made from. A name with
    a part in braces stands for one each. called: what it is called instead.
    """

    name: str
    type: str
    rate: str
    frame: str
    meaning: str
    sources: tuple[str, ...] = ()
    qos: QosKind = "sensor"
    called: str = ""

    @property
    def of_all(self) -> bool:
        """There is one for all vessels."""
        return (self.called or self.name).startswith("/")

    def of(self, part: str) -> RosTopic:
        """The one with `part` in place of the braces."""
        before, _, rest = self.name.partition("{")
        return replace(self, name=before + part + rest.partition("}")[2])

    def full_name(self, vessel: str = "", namespace: str = "") -> str:
        """With namespace and vessel: `/harbour/alpha/imu/data`. Topics of all vessels have neither."""
        name = self.called or self.name
        return name if self.of_all else ros_name(namespace, vessel, name)


def ros_name(*parts: str) -> str:
    """A whole name, as `/harbour/alpha/imu/data`, of namespace, vessel and topic, of which any may be empty."""
    return "/" + "/".join(part.strip("/") for part in parts if part.strip("/"))


SENSORS_LINK, ANSWERS_LINK = "/link/agent/tx", "/link/agent/rx"
TRUTH, TRUE_STATE, TRUE_FIX, ESTIMATE = "/truth/odometry", "/truth/state", "/truth/fix", "/estimate/odometry"
TICKS, ENVIRONMENT = "/actuators", "/environment"
DIAGNOSED = ("/tasks", "/pace", "/links", "/clocks", "/nodes")

_TABLE = (
    RosTopic("/clock", "rosgraph_msgs/msg/Clock", "`clock.exchange_rate_hz`", "", "simulation time", (TICKS,), "clock"),
    RosTopic("/tf", "tf2_msgs/msg/TFMessage", "as `odometry`; moving links 10 Hz", "",
             "`odom` → `base_link`, continuous, and `map` → `odom` with the corrections of the "
             "autopilot's estimate; without an autopilot the truth (`ros.tf`); gears and rudders",
             (ESTIMATE, TRUTH, TRUE_STATE)),
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
    RosTopic("wind", "geometry_msgs/msg/Vector3Stamped", "10 Hz", "map",
             "velocity of the air at the vessel in ENU, m/s; it points to where the wind blows", (ENVIRONMENT,)),
    RosTopic("current", "geometry_msgs/msg/Vector3Stamped", "10 Hz", "map",
             "velocity of the water at the vessel in ENU, m/s", (ENVIRONMENT,)),
    RosTopic("thrusters/{thruster}/state", "sensor_msgs/msg/JointState", "10 Hz", "",
             "`left` and `right`, or `propeller_0` …, and `rudder_0` …: position is the angle of gear or "
             "rudder in rad, counter-clockwise seen from above; velocity is that of the shaft in rad/s, "
             "NaN if the vehicle file lacks it; effort is the thrust at rest in N", (TRUE_STATE,)),
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
