"""A node in a process of its own that a run waits for: it answers each /clock with a cmd_vel made of the motion."""

from __future__ import annotations

import struct
import sys
from typing import Any

from xitl_cli.plugins.ros.cyclone_middleware import CycloneMiddleware
from xitl_cli.plugins.ros.definitions import deserialize, ros2_types, serialize
from xitl_cli.plugins.ros.middleware import RELIABLE
from xitl_cli.profile.schema.ros import RosSpec

TYPES: Any = ros2_types().types


def twist(speed_mps: float, turn_radps: float) -> bytes:
    vector = TYPES["geometry_msgs/msg/Vector3"]
    return serialize(TYPES["geometry_msgs/msg/Twist"](vector(speed_mps, 0.0, 0.0), vector(0.0, 0.0, turn_radps)))


def header(stamp_ns: int) -> bytes:
    stamp = TYPES["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    return serialize(TYPES["std_msgs/msg/Header"](stamp, "helm"))


class Helm:
    def __init__(self, step_ns: int) -> None:
        self.node = CycloneMiddleware(RosSpec(), "helm")
        self.cmd_vel = self.node.advertise("/cmd_vel", "geometry_msgs/msg/Twist", RELIABLE)
        self.ready = self.node.advertise("/ready", "std_msgs/msg/Header", RELIABLE)
        self.node.subscribe("/clock", "rosgraph_msgs/msg/Clock", RELIABLE, self.on_clock)
        self.node.subscribe("/ground_truth/odom", "nav_msgs/msg/Odometry", RELIABLE, self.on_motion)
        self.step_ns = step_ns
        self.clock_ns = self.motion_ns = self.answered_ns = 0
        self.turn_radps = 0.0

    def on_clock(self, cdr: bytes) -> None:
        seconds, nanoseconds = struct.unpack_from("<iI", cdr, 4)
        self.clock_ns = seconds * 1_000_000_000 + nanoseconds
        self.act()

    def on_motion(self, cdr: bytes) -> None:
        motion = deserialize(cdr, "nav_msgs/msg/Odometry")
        self.motion_ns = motion.header.stamp.sec * 1_000_000_000 + motion.header.stamp.nanosec
        self.turn_radps = motion.twist.twist.angular.z
        self.act()

    def act(self) -> None:
        now_ns = self.clock_ns
        if now_ns % self.step_ns or self.motion_ns < now_ns:
            return
        if now_ns > self.answered_ns:
            self.cmd_vel(twist(1.0, 0.3 - self.turn_radps))
        self.answered_ns = now_ns
        self.ready(header(now_ns))

    def run(self) -> None:
        while True:
            if not self.clock_ns:
                self.ready(header(0))
            self.node.spin(0.2)


if __name__ == "__main__":
    Helm(int(sys.argv[1])).run()
