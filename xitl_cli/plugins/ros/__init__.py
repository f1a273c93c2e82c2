"""ROS 2 and ROS 1: the recorder's messages as ROS messages, live and in bags, and requests of nodes.

outputs.py            Topics that a run publishes: one table, and the changes and user topics of `ros.topics`.
inputs.py             Topics and services through which nodes request actions: one table.
msg.py                Short names of the message classes. definitions.py converts messages to bytes and back.
conversion.py         From recorded payloads to ROS messages, with `instruments`, `diagnostics`, `frames` and
                      `robot_description`.
live_ros.py           The nodes of a run. process.py is the process between the run and ROS. The two exchange
                      pipe_messages.py.
middleware.py         Interface of a ROS node. middleware_choice.py selects one of `rclpy_middleware`,
                      `cyclone_middleware` (with `rtps_services` and `rtps`) and `tcpros_middleware` (with `tcpros/`).
discovery.py          Range of node discovery, and nodes that may command.
bag_export.py         Export of logs as bags, with `log_messages` for logs of autopilots.
"""
