"""Message classes of ROS 2 by their short names: `msg.Imu` is sensor_msgs/msg/Imu, in the version of Jazzy."""

from __future__ import annotations

from rosbags.typesys.stores import ros2_jazzy as jazzy

Time = jazzy.builtin_interfaces__msg__Time
DiagnosticArray = jazzy.diagnostic_msgs__msg__DiagnosticArray
DiagnosticStatus = jazzy.diagnostic_msgs__msg__DiagnosticStatus
KeyValue = jazzy.diagnostic_msgs__msg__KeyValue
Point = jazzy.geometry_msgs__msg__Point
Pose = jazzy.geometry_msgs__msg__Pose
PoseStamped = jazzy.geometry_msgs__msg__PoseStamped
PoseWithCovariance = jazzy.geometry_msgs__msg__PoseWithCovariance
Quaternion = jazzy.geometry_msgs__msg__Quaternion
Transform = jazzy.geometry_msgs__msg__Transform
TransformStamped = jazzy.geometry_msgs__msg__TransformStamped
Twist = jazzy.geometry_msgs__msg__Twist
TwistStamped = jazzy.geometry_msgs__msg__TwistStamped
TwistWithCovariance = jazzy.geometry_msgs__msg__TwistWithCovariance
Vector3 = jazzy.geometry_msgs__msg__Vector3
Vector3Stamped = jazzy.geometry_msgs__msg__Vector3Stamped
Odometry = jazzy.nav_msgs__msg__Odometry
Path = jazzy.nav_msgs__msg__Path
Clock = jazzy.rosgraph_msgs__msg__Clock
BatteryState = jazzy.sensor_msgs__msg__BatteryState
CameraInfo = jazzy.sensor_msgs__msg__CameraInfo
CompressedImage = jazzy.sensor_msgs__msg__CompressedImage
FluidPressure = jazzy.sensor_msgs__msg__FluidPressure
Image = jazzy.sensor_msgs__msg__Image
Imu = jazzy.sensor_msgs__msg__Imu
JointState = jazzy.sensor_msgs__msg__JointState
LaserScan = jazzy.sensor_msgs__msg__LaserScan
MagneticField = jazzy.sensor_msgs__msg__MagneticField
NavSatFix = jazzy.sensor_msgs__msg__NavSatFix
NavSatStatus = jazzy.sensor_msgs__msg__NavSatStatus
PointCloud2 = jazzy.sensor_msgs__msg__PointCloud2
PointField = jazzy.sensor_msgs__msg__PointField
Range = jazzy.sensor_msgs__msg__Range
RegionOfInterest = jazzy.sensor_msgs__msg__RegionOfInterest
Bool = jazzy.std_msgs__msg__Bool
Float64MultiArray = jazzy.std_msgs__msg__Float64MultiArray
Header = jazzy.std_msgs__msg__Header
MultiArrayLayout = jazzy.std_msgs__msg__MultiArrayLayout
String = jazzy.std_msgs__msg__String
TFMessage = jazzy.tf2_msgs__msg__TFMessage


def header(stamp_ns: int, frame: str) -> Header:
    """Return a std_msgs/Header."""
    return Header(stamp=Time(*divmod(stamp_ns, 1_000_000_000)), frame_id=frame)
