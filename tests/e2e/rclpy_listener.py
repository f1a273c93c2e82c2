"""A node of somebody else's: takes every topic it is told of or sees, and writes down what came.

Run by a Python with rclpy: `python rclpy_listener.py TOPICS.json REPORT.json`; says `listening`, ends with its input.
TOPICS: `{name: [type, durability]}`.
"""

import importlib
import json
import sys
import threading
from pathlib import Path

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

OWN = ("/rosout", "/parameter_events")


class Listener:
    def __init__(self, topics):
        self.node = rclpy.create_node("listener", start_parameter_services=False)
        self.heard = {}
        self.links = {}
        for name, (kind, durability) in topics.items():
            self.listen(name, kind, durability)

    def listen(self, name, kind, durability):
        package, _, message = kind.split("/")
        heard = self.heard[name] = {"type": kind, "count": 0, "stamps": [], "frames": {}}
        reliability = ReliabilityPolicy.BEST_EFFORT if name == "/clock" else ReliabilityPolicy.RELIABLE
        qos = QoSProfile(depth=5000, reliability=reliability, durability=DurabilityPolicy[durability.upper()])
        kind = getattr(importlib.import_module(package + ".msg"), message)
        self.node.create_subscription(kind, name, lambda got: self.take(name, heard, got), qos)

    def take(self, name, heard, message):
        heard["count"] += 1
        header = getattr(message, "header", None)
        if header is not None:
            heard["stamps"].append(header.stamp.sec * 10**9 + header.stamp.nanosec)
            frames = header.frame_id, getattr(message, "child_frame_id", "")
            heard["frames"][" > ".join(filter(None, frames))] = 1
        for transform in getattr(message, "transforms", ()):
            self.links[transform.child_frame_id] = transform.header.frame_id
            if name == "/tf" and transform.child_frame_id == "base_link":
                heard["stamps"].append(transform.header.stamp.sec * 10**9 + transform.header.stamp.nanosec)
        if name == "/clock":
            heard["stamps"].append(message.clock.sec * 10**9 + message.clock.nanosec)

    def look_around(self):
        """Topics with a name of their own, as those of each thruster."""
        for name, kinds in self.node.get_topic_names_and_types():
            if name not in self.heard and name not in OWN:
                about = self.node.get_publishers_info_by_topic(name)
                if about:
                    self.listen(name, kinds[0], about[0].qos_profile.durability.name)

    def report(self):
        publishers = {}
        for name in self.heard:
            for about in self.node.get_publishers_info_by_topic(name):
                qos = about.qos_profile
                publishers[name] = [about.topic_type, qos.reliability.name, qos.durability.name]
        return {"heard": self.heard, "links": self.links, "publishers": publishers, "nodes": self.nodes}


def main():
    topics, report = sys.argv[1:]
    rclpy.init()
    listener = Listener(json.loads(Path(topics).read_text()))
    listener.nodes = []
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(listener.node)
    print("listening", flush=True)
    looked, told = 0, {}
    while not over.is_set():
        executor.spin_once(0.1)
        looked += 1
        if looked % 200 == 0 or looked == 10:
            listener.look_around()
            listener.nodes = sorted({*listener.nodes, *listener.node.get_node_names()})
            told.update(listener.report()["publishers"])
    executor.spin_once(0.1)
    result = listener.report()
    result["publishers"] = told
    Path(report).write_text(json.dumps(result))


main()
