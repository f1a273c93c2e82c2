"""A node that does everything wrong, and then one thing right: `python rclpy_mischief.py`, by a Python with rclpy.

Says what it does; once its input ends, it ends the run by the service `finish`.
"""

import math
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Twist, Vector3Stamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool, Float64, String
from std_srvs.srv import SetBool, Trigger

FLOOD = 20_000
PATIENCE_S = 120.0


class Mischief:
    def __init__(self):
        self.node = rclpy.create_node("mischief")
        self.refusals = []
        self.node.create_subscription(String, "refusals", lambda said: self.refusals.append(said.data), 100)
        late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Vector3Stamped, "wind", lambda wind: None, late)  # asks for what is not offered
        self.armed = False
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Bool, "armed", self.on_armed, latched)
        self.steer = self.node.create_publisher(Twist, "cmd_vel", 10)
        self.node.create_publisher(Clock, "/clock", 10)  # of somebody else in the domain
        self.goal = self.node.create_publisher(PoseStamped, "goal_pose", 10)
        self.wrong = self.node.create_publisher(Float64, "set_mode", 10)

    def on_armed(self, armed):
        self.armed = armed.data

    def wait(self, holds, what):
        until = time.monotonic() + PATIENCE_S
        while not holds():
            assert time.monotonic() < until, f"waited in vain: {what}"
            rclpy.spin_once(self.node, timeout_sec=0.05)
        print(what, flush=True)

    def call(self, kind, name, **fields):
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready, f"{name} is there")
        request = kind.Request()
        for field, value in fields.items():
            setattr(request, field, value)
        answer = client.call_async(request)
        self.wait(answer.done, f"{name} is answered")
        return answer.result()

    def run(self):
        self.wait(lambda: self.steer.get_subscription_count() and self.goal.get_subscription_count(), "found the run")
        self.wait(lambda: self.armed, "armed")
        for speed in (math.nan, math.inf, 1e9):
            command = Twist()
            command.linear.x = speed
            self.steer.publish(command)
        self.wait(lambda: any("cmd_vel" in said for said in self.refusals), "cmd_vel with NaN is refused")
        self.wait(lambda: any("too large" in said for said in self.refusals), "cmd_vel of 1e9 m/s is refused")
        nowhere = PoseStamped()
        nowhere.header.frame_id = "camera_link"
        self.goal.publish(nowhere)
        self.wait(lambda: any("camera_link" in said for said in self.refusals), "a goal in camera_link is refused")
        self.wrong.publish(Float64(data=4.0))
        started, sent = time.monotonic(), 0
        command = Twist()
        command.linear.x = 0.5
        while sent < FLOOD:
            self.steer.publish(command)
            sent += 1
        print(f"sent {sent} in {time.monotonic() - started:.2f} s", flush=True)
        answer = self.call(SetBool, "arm", data=False)
        print(f"disarm: {answer.success} {answer.message}", flush=True)
        sys.stdin.read()
        print(f"finish: {self.call(Trigger, 'finish').success}", flush=True)


def main():
    rclpy.init()
    Mischief().run()


main()
