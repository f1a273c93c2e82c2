"""Sail to a waypoint by cmd_vel: a node of ROS 2 that knows nothing of xitl.

    xitl sim --profile ros                                                  # in one terminal
    python examples/ros/waypoint_by_cmd_vel.py --ros-args -p x:=20.0 -p y:=15.0      # in another

x and y are metres east and north in `map`. The node ends when it is there.
"""

import math
import sys

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node

REACHED_M = 3.0
SLOW_M = 10.0
TURN_PER_RAD = 0.6
MOST_TURN_RADPS = 0.4


class Waypoint(Node):
    """Turns towards the waypoint and goes, slower in a turn and near it."""

    def __init__(self) -> None:
        super().__init__("waypoint")
        self.x = self.declare_parameter("x", 20.0).value
        self.y = self.declare_parameter("y", 15.0).value
        self.speed = self.declare_parameter("speed", 1.0).value
        self.reached = False
        self.cmd_vel = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_subscription(Odometry, "odometry", self.steer, 10)

    def steer(self, odometry: Odometry) -> None:
        place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
        yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
        east, north = self.x - place.x, self.y - place.y
        left = math.hypot(east, north)
        off = math.remainder(math.atan2(north, east) - yaw, 2 * math.pi)
        command = Twist()
        if left > REACHED_M:
            command.linear.x = self.speed * max(math.cos(off), 0.0) * min(left / SLOW_M, 1.0)
            command.angular.z = max(-MOST_TURN_RADPS, min(MOST_TURN_RADPS, TURN_PER_RAD * off))
        elif not self.reached:
            self.reached = True
            self.get_logger().info(f"reached ({place.x:.1f}, {place.y:.1f})")
        self.cmd_vel.publish(command)


def main() -> None:
    rclpy.init(args=sys.argv)
    node = Waypoint()
    try:
        while not node.reached:
            rclpy.spin_once(node)
    except KeyboardInterrupt:
        pass
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
