"""ROS bags: of ROS 1 (`ros1_bag`), of ROS 2 in SQLite, and a folder of either storage (`ros2_bag`)."""
