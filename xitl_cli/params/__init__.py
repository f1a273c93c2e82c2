"""Parameters of an autopilot in a file or on a live vehicle.

source.py    what a user names: a .parm file, a shipped one, `defaults`, or a vehicle's URL
vehicle.py   the MAVLink parameter protocol, with any ArduPilot vehicle or the embedded autopilot
compare.py   differences, and pushing only those
text.py      values and .parm files as text
"""
