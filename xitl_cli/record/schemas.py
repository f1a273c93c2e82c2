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
uint32 skipped
float64 start_jitter_mean_s
int64 worst_run_ns
int64 worst_start_ns
uint32[16] start_histogram
uint32[16] run_histogram
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

MISS = f"""\
builtin_interfaces/Time stamp
string node
string task
uint32 cycle
int64 due_ns
int64 start_ns
int64 end_ns
uint32 skipped
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
float64 residual_s
float64 path_delay_s
float64 asymmetry_bound_s
uint32 steps
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

LINK = f"""\
builtin_interfaces/Time stamp
string name
int64 sent
int64 received
int64 lost
int64 gaps
int64 late
int64 repeated
int64 dropped
int64 unsent
int64 refused
int64 impaired
float64 latency_p50_s
float64 latency_p99_s
float64 latency_max_s
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

ACTUATOR_AGE = f"""\
builtin_interfaces/Time stamp
uint32 exchanges
uint32 stale
uint32 longest_stale
float64 age_p50_s
float64 age_p99_s
float64 age_max_s
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

NODE = f"""\
builtin_interfaces/Time stamp
string node
string nodes
string kind
string machine
string kernel
string version
float64 memory_mib
float64 cpu_percent
float64 load
float64 temperature_c
uint8 running
string flags
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

BRIDGE_COUNTS = (
    "imu_out", "solution_out", "gnss_out", "unsent", "world_in", "world_resent", "world_lost", "restarts",
    "outputs_in", "commands_in", "junk", "mavlink_in", "mavlink_lost", "mavlink_dropped", "mavlink_passed",
    "mavlink_out", "script_in", "script_out", "script_dropped", "world_rate", "connected",
)  # fmt: skip
"""Those of XITL_BRIDGE_STATUS."""

_BRIDGE_COUNTS = "".join(f"int64 {name}\n" for name in BRIDGE_COUNTS)

BRIDGE = f"""\
builtin_interfaces/Time stamp
{_BRIDGE_COUNTS}{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

TAKEOVER = f"""\
builtin_interfaces/Time stamp
string from_node
string to_node
float64 silent_s
float64 step
{_SEPARATOR}
MSG: builtin_interfaces/Time
{_TIME}"""

FAULT = f"""\
builtin_interfaces/Time stamp
string fault
uint8 active
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
