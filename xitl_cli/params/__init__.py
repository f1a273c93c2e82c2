"""Parameters of an autopilot in a file or on a live vehicle.

source.py    what a user names: a .parm file, a shipped one, `defaults`, or a vehicle's URL
vehicle.py   the MAVLink parameter protocol, with any ArduPilot vehicle or the embedded autopilot
compare.py   differences, and pushing only those
check.py     how a vehicle stands to what it should have; renames.py: names that changed between versions
bring.py     pushing over restarts, with the script for HIL messages: script.py, by MAVLink FTP: ftp.py
text.py      values and .parm files as text
"""
