"""Another autopilot behind the agent: the host's sensors in, its outputs back, its MAVLink passed on both ways.

role.py          the node's role: one vehicle, the ways in which sensors reach it
vehicle_link.py  MAVLink with the autopilot, and which messages it is asked for
outputs.py       pulse widths to motor commands
injector.py      one way for sensors to get in: the base of the others
json_world.py    ArduPilot's JSON simulator interface, in lockstep; json_line.py, json_frames.py, frame_times.py,
                 interpolation.py
ahrs.py          a navigation unit on a line of its own (sensor_line.py): vectornav.py, microstrain.py and their frames
hil.py           HIL messages for a script on the autopilot
px4.py           PX4's simulator interface; px4_line.py
readings.py      the host's samples for those three, with our own solution (navigation_solution.py) and the date
"""
