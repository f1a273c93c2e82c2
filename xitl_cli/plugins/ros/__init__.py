"""ROS 2 and ROS 1: the recorder's messages as those of ROS, live and in bags."""
