"""Parameters of an autopilot in a file or on a live vehicle.

vehicle.py  a vehicle of ArduPilot or the embedded autopilot: parameters, commands, files
values.py   what a user names: a .parm file, a shipped one, `defaults`, or a vehicle's URL; differences; text
check.py    how a vehicle stands to what it should have, with names that changed between versions
push.py     pushing over restarts, with the script for HIL messages
"""
