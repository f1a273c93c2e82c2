"""Another autopilot behind the agent: the host's sensors in, its outputs back, its MAVLink passed on both ways.

role.py          the node's role: one vehicle, the ways in which sensors reach it
vehicle_link.py  MAVLink with the autopilot
outputs.py       pulse widths to motor commands
streams.py       which messages it is asked for
injector.py      one way for sensors to get in: the base of the others
json_world.py    ArduPilot's JSON simulator interface, in lockstep
"""
