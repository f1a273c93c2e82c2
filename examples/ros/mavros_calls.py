"""What a user of MAVROS calls to arm a vessel of xitl, drive it and give it a mission.

    xitl sim --profile ground-station --set driver.stay=true                          # in one terminal
    ros2 run mavros mavros_node --ros-args -p fcu_url:=tcp://127.0.0.1:5760           # in another
    python examples/ros/mavros_calls.py                                               # in a third

MAVROS speaks MAVLink to the autopilot at its ground-station port, and knows nothing of xitl either; the `ros` group of
a profile is not needed for it. It needs the packages mavros and mavros_msgs.
"""

import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from mavros_msgs.msg import State, Waypoint
from mavros_msgs.srv import CommandBool, SetMode, WaypointClear, WaypointPush
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import NavSatFix

GLOBAL_RELATIVE_ALT, NAV_WAYPOINT = 3, 16  # MAV_FRAME, MAV_CMD


class Calls(Node):
    def __init__(self) -> None:
        super().__init__("calls")
        self.state = State()
        self.fix = None
        self.create_subscription(State, "/mavros/state", self.on_state, 10)
        self.create_subscription(NavSatFix, "/mavros/global_position/global", self.on_fix, qos_profile_sensor_data)
        # In `mav_frame` LOCAL_NED, the default, x is east; with `-p mav_frame:=BODY_NED` of the plugin it is ahead.
        self.cmd_vel = self.create_publisher(Twist, "/mavros/setpoint_velocity/cmd_vel_unstamped", 10)

    def on_state(self, state: State) -> None:
        self.state = state

    def on_fix(self, fix: NavSatFix) -> None:
        self.fix = fix

    def wait(self, holds, what: str, limit_s: float = 60.0) -> None:
        until = time.monotonic() + limit_s
        while not holds():
            rclpy.spin_once(self, timeout_sec=0.2)
            if time.monotonic() > until:
                sys.exit(f"waited {limit_s:g} s for {what}")

    def call(self, kind, service: str, **fields):
        client = self.create_client(kind, f"/mavros/{service}")
        if not client.wait_for_service(10.0):
            sys.exit(f"/mavros/{service} is not there; start MAVROS")
        answer = client.call_async(kind.Request(**fields))
        rclpy.spin_until_future_complete(self, answer, timeout_sec=10.0)
        return answer.result()

    def mode(self, name: str) -> None:
        self.call(SetMode, "set_mode", custom_mode=name)
        self.wait(lambda: self.state.mode == name, f"mode {name}")

    def arm(self) -> None:
        self.wait(lambda: self.call(CommandBool, "cmd/arming", value=True).success, "the autopilot to arm")


def main() -> None:
    rclpy.init()
    node = Calls()
    node.wait(lambda: node.state.connected, "MAVROS to hear the autopilot")
    node.wait(lambda: node.fix is not None, "a position")
    node.mode("GUIDED")
    node.arm()
    for _ in range(100):  # ten seconds: ArduPilot stops 3 s after the last
        command = Twist()
        command.linear.x, command.angular.z = 1.0, 0.1
        node.cmd_vel.publish(command)
        rclpy.spin_once(node, timeout_sec=0.1)
        time.sleep(0.1)
    here = node.fix
    places = [(here.latitude, here.longitude), (here.latitude + 2e-4, here.longitude)]  # home, then 22 m north
    items = [
        Waypoint(frame=GLOBAL_RELATIVE_ALT, command=NAV_WAYPOINT, autocontinue=True, x_lat=lat, y_long=lon)
        for lat, lon in places
    ]
    node.call(WaypointClear, "mission/clear")
    pushed = node.call(WaypointPush, "mission/push", start_index=0, waypoints=items)
    print(f"{pushed.wp_transfered} items of the mission are on board")
    node.mode("AUTO")
    rclpy.shutdown()


if __name__ == "__main__":
    main()
