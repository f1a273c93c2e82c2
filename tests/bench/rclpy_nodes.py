"""Nodes of ROS 2 for bench_ros, which know nothing of xitl.

`python rclpy_nodes.py echo`. `listen FILE`: subscribes to every topic until it is terminated, then says by topic how
many messages came. `step FILE SECONDS`: turns cmd_vel to and fro, and says when: JSON of [published_ns, speed_mps], and
of round trips in ns to the echo and back, by CLOCK_MONOTONIC.
"""

import json
import random
import sys
import time
from collections import Counter
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Int64

PERIODS_S = 0.6, 0.9
"""Drawn, so that steps come at any moment between two exchanges; under ros.silent_s, after which a vessel holds."""
LOOK_S, DEPTH = 0.2, 1000
SPEED_MPS, TURN_RADPS = 1.0, 0.3


def echo() -> None:
    node = rclpy.create_node("echo")
    back = node.create_publisher(Int64, "/bench/pong", 10)
    node.create_subscription(Int64, "/bench/ping", back.publish, 10)
    rclpy.spin(node)


def listen(file: Path) -> None:
    node = rclpy.create_node("listener")
    counts: Counter[str] = Counter()

    def subscribe() -> None:
        for topic, kinds in node.get_topic_names_and_types():
            if topic not in counts and node.count_publishers(topic):
                counts[topic] = 0
                package, _, name = kinds[0].split("/")
                kind = getattr(import_module(f"{package}.msg"), name)
                node.create_subscription(kind, topic, lambda cdr, topic=topic: counts.update([topic]), DEPTH, raw=True)

    node.create_timer(LOOK_S, subscribe)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)
    file.write_text(json.dumps(counts))


def step(file: Path, seconds: float) -> None:
    node = rclpy.create_node("stepper")
    steps, trips = [], []
    command = node.create_publisher(Twist, "/cmd_vel", 10)
    ping = node.create_publisher(Int64, "/bench/ping", 10)
    node.create_subscription(Int64, "/bench/pong", lambda m: trips.append(time.monotonic_ns() - m.data), 10)
    draw = random.Random(1)
    twist, until_s, next_s = Twist(), time.monotonic() + seconds, time.monotonic()
    while (now_s := time.monotonic()) < until_s:
        if now_s >= next_s:
            next_s += draw.uniform(*PERIODS_S)
            number = len(steps)
            twist.linear.x = SPEED_MPS + 1e-5 * number  # each is known by its number
            twist.angular.z = (TURN_RADPS, -TURN_RADPS)[number % 2]
            steps.append((time.monotonic_ns(), twist.linear.x))
            command.publish(twist)
            ping.publish(Int64(data=time.monotonic_ns()))
        rclpy.spin_once(node, timeout_sec=max(min(next_s - now_s, 0.1), 0.0))
    file.write_text(json.dumps({"steps": steps, "trips_ns": trips}))


if __name__ == "__main__":
    rclpy.init()
    asked, *of_it = sys.argv[1:]
    if asked == "echo":
        echo()
    elif asked == "listen":
        listen(Path(of_it[0]))
    else:
        step(Path(of_it[0]), float(of_it[1]))
