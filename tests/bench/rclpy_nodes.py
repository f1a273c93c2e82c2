"""A node of ROS 2 for bench_ros: steps cmd_vel up and down, and says when; or echoes. It knows nothing of xitl.

`python rclpy_stepper.py echo`, `python rclpy_stepper.py FILE SECONDS`: JSON of [published_ns, speed_mps], and of round
trips in ns to the echo and back, by CLOCK_MONOTONIC.
"""

import json
import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist
from std_msgs.msg import Int64

PERIOD_S = 0.5


def echo() -> None:
    node = rclpy.create_node("echo")
    back = node.create_publisher(Int64, "/bench/pong", 10)
    node.create_subscription(Int64, "/bench/ping", back.publish, 10)
    rclpy.spin(node)


def step(file: Path, seconds: float) -> None:
    node = rclpy.create_node("stepper")
    steps, trips = [], []
    command = node.create_publisher(Twist, "/cmd_vel", 10)
    ping = node.create_publisher(Int64, "/bench/ping", 10)
    node.create_subscription(Int64, "/bench/pong", lambda m: trips.append(time.monotonic_ns() - m.data), 10)
    twist, until_s, next_s = Twist(), time.monotonic() + seconds, time.monotonic()
    while (now_s := time.monotonic()) < until_s:
        if now_s >= next_s:
            next_s += PERIOD_S
            number = len(steps)
            twist.linear.x = (0.5, 1.5)[number % 2] + 1e-5 * number  # each is known by its number
            steps.append((time.monotonic_ns(), twist.linear.x))
            command.publish(twist)
            ping.publish(Int64(data=time.monotonic_ns()))
        rclpy.spin_once(node, timeout_sec=max(min(next_s - now_s, 0.1), 0.0))
    file.write_text(json.dumps({"steps": steps, "trips_ns": trips}))


if __name__ == "__main__":
    rclpy.init()
    if sys.argv[1] == "echo":
        echo()
    else:
        step(Path(sys.argv[1]), float(sys.argv[2]))
