"""ROS bags: of ROS 1 (`ros1_bag`), of ROS 2 in SQLite (`sqlite_bag`), and a folder of either storage (`folder`)."""
