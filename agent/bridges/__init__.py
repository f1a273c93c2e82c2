"""Another autopilot behind the agent: the host's sensors in, its outputs back, its MAVLink passed on both ways.

role.py          the node's role: one vehicle, the ways in which sensors reach it
vehicle_link.py  MAVLink with the autopilot
outputs.py       pulse widths to motor commands
injector.py      one way for sensors to get in: the base of the others
"""
