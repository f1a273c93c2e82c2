"""Keep clear of the log boom by the lidar's points: nodes of ROS 2 in the place of the companion.

    xitl sim --profile ros-companion                    # in one terminal
    python examples/ros/avoid_boom_by_points.py         # in another

The waypoint lies behind the boom. The node heads for it, goes around what can be gone around, and stops before what
cannot. It needs rclpy and numpy alone.
"""

import math
import sys

import numpy as np
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage

CLEARANCE_M = 6.0  # of the vessel's origin from any point
SEEN_M = 40.0
LOW_M, HIGH_M = 0.4, 4.0  # above the water: what is lower is waves
NEAR_M = 10.0  # returns from there are of the water, in the middle
FEWEST = 3  # points that are an obstacle: one alone is a crest
MOST_OFF = math.radians(70)  # from the way to the waypoint
TURN_PER_RAD, MOST_TURN_RADPS = 0.6, 0.4


def rotation(q) -> np.ndarray:
    w, x, y, z = q.w, q.x, q.y, q.z
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def xyz(cloud: PointCloud2) -> np.ndarray:
    """(n, 3) of the fields x, y, z, which are float32."""
    offsets = {field.name: field.offset for field in cloud.fields}
    kind = np.dtype(
        {
            "names": list("xyz"),
            "formats": ["<f4"] * 3,
            "offsets": [offsets[n] for n in "xyz"],
            "itemsize": cloud.point_step,
        }
    )
    points = np.frombuffer(bytes(cloud.data), dtype=kind)
    return np.column_stack([points["x"], points["y"], points["z"]]).astype(float)


def nearest(distances: np.ndarray) -> float:
    return float(np.partition(distances, FEWEST - 1)[FEWEST - 1]) if len(distances) >= FEWEST else math.inf


class Avoider(Node):
    def __init__(self) -> None:
        super().__init__("avoider")
        self.x = self.declare_parameter("x", 40.0).value  # east
        self.y = self.declare_parameter("y", -22.0).value  # north
        self.speed = self.declare_parameter("speed", 1.2).value
        self.mounting = None
        self.seen = []  # (seconds, (n, 2) in map) of the last clouds
        self.nearest = math.inf
        self.pose = None
        self.cmd_vel = self.create_publisher(Twist, "cmd_vel", 10)
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(TFMessage, "/tf_static", self.on_mounting, latched)
        self.create_subscription(PointCloud2, "points", self.on_points, 10)
        self.create_subscription(Odometry, "odometry", self.steer, 10)

    def on_mounting(self, message: TFMessage) -> None:
        for frame in message.transforms:
            if frame.child_frame_id.endswith("lidar_link"):
                place = frame.transform.translation
                self.mounting = rotation(frame.transform.rotation), np.array([place.x, place.y, place.z])

    def on_points(self, cloud: PointCloud2) -> None:
        """What stands out of the water near by, in map: the lidar looks ahead alone, so that clouds are kept."""
        if self.mounting is None or self.pose is None:
            return
        turn, place = self.mounting
        attitude, here = self.pose
        points = (xyz(cloud) @ turn.T + place) @ attitude.T
        away = np.hypot(points[:, 0], points[:, 1])
        near = points[away < NEAR_M, 2]
        water = float(np.median(near)) if len(near) else 0.0
        high = (points[:, 2] > water + LOW_M) & (points[:, 2] < water + HIGH_M) & (away < SEEN_M)
        points = points[high, :2] + here
        now = cloud.header.stamp.sec + 1e-9 * cloud.header.stamp.nanosec
        self.seen = [(then, old) for then, old in self.seen if now - then < 5.0] + [(now, points)]

    def steer(self, odometry: Odometry) -> None:
        place, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
        here = np.array([place.x, place.y])
        self.pose = rotation(q), here
        if not self.seen:
            return
        around = np.concatenate([points for _, points in self.seen]) - here
        away = np.hypot(around[:, 0], around[:, 1])
        self.nearest = min(self.nearest, nearest(away))
        goal = math.atan2(self.y - here[1], self.x - here[0])
        left = math.hypot(self.x - here[0], self.y - here[1])
        command = Twist()
        if left > 3.0:
            course, free = self.course(goal, around, away, left)
            off = math.remainder(course - yaw, 2 * math.pi)
            stopping = max(free - CLEARANCE_M, 0.0)
            command.linear.x = max(math.cos(off), 0.0) * min(self.speed, 0.15 * stopping)
            command.angular.z = max(-MOST_TURN_RADPS, min(MOST_TURN_RADPS, TURN_PER_RAD * off))
        self.cmd_vel.publish(command)

    def course(self, goal: float, around: np.ndarray, away: np.ndarray, left: float) -> tuple[float, float]:
        """The course nearest to `goal` with most room, and how far it is free, `left` at most."""
        bearings = np.arctan2(around[:, 1], around[:, 0])
        best = (-1.0, goal, 0.0)
        for off in np.radians(np.arange(0, math.degrees(MOST_OFF) + 1, 5)):
            for course in (goal + off, goal - off):
                ahead = np.abs(np.angle(np.exp(1j * (bearings - course))))
                in_way = (ahead < math.pi / 2) & (away * np.sin(ahead) < CLEARANCE_M)
                free = min(nearest(away[in_way] * np.cos(ahead[in_way])), SEEN_M, left + CLEARANCE_M)
                worth = free - 10.0 * off
                if worth > best[0]:
                    best = worth, course, free
        return best[1], best[2]


def main() -> None:
    rclpy.init(args=sys.argv)
    node = Avoider()
    try:
        rclpy.spin(node)
    except Exception:  # what goes wrong once Ctrl-C has been seen
        if rclpy.ok():
            raise
    except KeyboardInterrupt:
        pass
    print(f"nearest point {node.nearest:.1f} m away")
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
