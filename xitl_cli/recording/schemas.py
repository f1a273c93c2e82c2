"""The vocabulary of a recording, as ROS 2 definitions that any CDR reader can use without a plug-in.

docs/recording.md says what each topic carries.
"""

from __future__ import annotations

_SEPARATOR = "=" * 80

_TIME = "int32 sec\nuint32 nanosec\n"

VESSEL_STATE = f"""\
builtin_interfaces/Time stamp
float64[3] position_ned_m
float64[3] velocity_ned_mps
float64[3] acceleration_ned_mps2
float64[4] quaternion_ned_frd
float64[3] angular_velocity_frd_radps
float64[] rotor
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

ENVIRONMENT = f"""\
builtin_interfaces/Time stamp
float64[3] current_ned_mps
float64[3] wind_ned_mps
float64 surface_elevation_m
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

ACTUATORS = f"""\
builtin_interfaces/Time stamp
float64[] command
uint8 armed
uint8 failsafe
float64 age_s
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

MAVLINK_FRAME = f"""\
builtin_interfaces/Time stamp
uint8[] frame
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

TASK = f"""\
builtin_interfaces/Time stamp
string node
string task
float64 rate_hz
uint32 cycles
uint32 missed
float64 start_jitter_max_s
float64 run_mean_s
float64 run_max_s
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

CLOCK = f"""\
builtin_interfaces/Time stamp
string node
uint32 sample
int64 host_ns
int64 node_ns
float64 round_trip_s
float64 offset_s
float64 drift_ppm
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

ODOMETRY = f"""\
std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
{_SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}{_SEPARATOR}
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
{_SEPARATOR}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{_SEPARATOR}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{_SEPARATOR}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
{_SEPARATOR}
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
{_SEPARATOR}
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
{_SEPARATOR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
