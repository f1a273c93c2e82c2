"""ROS 1 without an installed ROS: a node by XML-RPC and TCPROS, with the standard library and rosbags' conversions.

Sources: ROS wiki, "ROS/Master_API", "ROS/Slave_API", "ROS/TCPROS", "ROS/Connection Header".
"""
