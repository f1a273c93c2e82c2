"""A node that the run waits for: it answers each /clock at which it stands still, so that both repeat.

    xitl sim --profile ros-lockstep --duration 60 --out runs/one      # in one terminal
    python examples/ros/lockstep_node.py                              # in another

The rules for a node whose runs repeat: act on stamps, never on when something came; answer when everything of the
stamp is there; publish commands before the answer; draw nothing at random and read no clock but /clock.
"""

import sys

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

STEP_NS = 100_000_000  # ros.lockstep.step_s


def nanoseconds(stamp) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


class Helm(Node):
    """Sails figures of eight: the turn rate changes its sign every half minute."""

    def __init__(self) -> None:
        super().__init__("helm")
        self.clock_ns = self.answered_ns = 0
        self.motion = None
        self.cmd_vel = self.create_publisher(Twist, "cmd_vel", 10)
        self.ready = self.create_publisher(Header, "ready", 10)
        self.create_subscription(Clock, "clock", self.on_clock, qos_profile_sensor_data)
        self.create_subscription(Odometry, "ground_truth/odom", self.on_motion, 100)
        self.create_timer(0.2, self.on_start)  # on the wall clock: the run waits for the first word

    def on_start(self) -> None:
        if not self.clock_ns:
            self.answer(0)

    def on_clock(self, clock: Clock) -> None:
        self.clock_ns = nanoseconds(clock.clock)
        self.act()

    def on_motion(self, motion: Odometry) -> None:
        self.motion = motion
        self.act()

    def act(self) -> None:
        """Once, when clock and motion of a standstill are there; again only the answer, if the clock is repeated."""
        now_ns = self.clock_ns
        if now_ns % STEP_NS or self.motion is None or nanoseconds(self.motion.header.stamp) < now_ns:
            return
        if now_ns > self.answered_ns:
            command = Twist()
            command.linear.x = 1.0
            rate = 0.1 if now_ns // 30_000_000_000 % 2 == 0 else -0.1
            command.angular.z = rate - 0.2 * (self.motion.twist.twist.angular.z - rate)
            self.cmd_vel.publish(command)
        self.answer(now_ns)

    def answer(self, now_ns: int) -> None:
        self.answered_ns = now_ns
        header = Header(frame_id="helm")
        header.stamp.sec, header.stamp.nanosec = divmod(now_ns, 1_000_000_000)
        self.ready.publish(header)


def main() -> None:
    rclpy.init(args=sys.argv)
    node = Helm()
    try:
        rclpy.spin(node)
    except Exception:  # what goes wrong once Ctrl-C has been seen
        if rclpy.ok():
            raise
    except KeyboardInterrupt:
        pass
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
