"""A node of ROS 1 by real rospy, for Debian's own Python: counts topics of a run, drives it, and ends it.

Prints one JSON object. Run with ROS_MASTER_URI set.
"""

import json
import sys
import time
from itertools import pairwise

import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from tf2_msgs.msg import TFMessage

TOPICS = {
    "/imu/data": Imu,
    "/fix": NavSatFix,
    "/odometry": Odometry,
    "/ground_truth/odom": Odometry,
    "/tf": TFMessage,
    "/tf_static": TFMessage,
    "/robot_description": String,
    "/points": PointCloud2,
    "/mode": String,
}
LIMIT_S = 120.0


def main():
    got = {topic: [] for topic in TOPICS}
    rospy.init_node("counter")
    for topic, kind in TOPICS.items():
        rospy.Subscriber(topic, kind, got[topic].append, queue_size=1000)
    drive = rospy.Publisher("/cmd_vel", Twist, queue_size=1)

    def wait(condition):
        end_s = time.monotonic() + LIMIT_S
        while not condition():
            if time.monotonic() > end_s:
                print(json.dumps({"late": True, "counts": {topic: len(each) for topic, each in got.items()}}))
                sys.exit(1)
            time.sleep(0.02)

    def stamps(topic):
        return [message.header.stamp.to_nsec() for message in list(got[topic])]

    wait(lambda: len(got["/imu/data"]) > 400 and got["/odometry"] and got["/points"] and got["/robot_description"])
    armed = rospy.ServiceProxy("/arm", SetBool)(True)
    turn = Twist()
    turn.linear.x, turn.angular.z = 2.0, 0.1

    def turns_as_told():
        drive.publish(turn)
        truth = got["/ground_truth/odom"][-1].twist.twist
        return truth.linear.x > 1.5 and truth.angular.z > 0.05

    wait(turns_as_told)
    modes = [message.data for message in got["/mode"]]
    ended = rospy.ServiceProxy("/finish", Trigger)()
    imu = stamps("/imu/data")
    frames = {
        (each.header.frame_id, each.child_frame_id) for tf in got["/tf"] + got["/tf_static"] for each in tf.transforms
    }
    cloud = got["/points"][-1]
    print(
        json.dumps(
            {
                "armed": armed.success,
                "ended": ended.success,
                "modes": modes,
                "imu_steps_ns": sorted({later - former for former, later in pairwise(imu)}),
                "frame_ids": {topic: got[topic][-1].header.frame_id for topic in ("/imu/data", "/fix", "/points")},
                "frames": sorted(frames),
                "cloud_bytes": [len(cloud.data), cloud.width * cloud.height * cloud.point_step],
                "description": got["/robot_description"][0].data[:60],
                "simulated_time": rospy.get_param("/use_sim_time"),
                "parameter_is_topic": rospy.get_param("/robot_description") == got["/robot_description"][0].data,
            }
        )
    )


main()
