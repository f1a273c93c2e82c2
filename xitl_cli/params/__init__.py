"""Parameters of an autopilot in a file or on a live vehicle.

vehicle.py  a vehicle with ArduPilot or the embedded autopilot: parameters, commands, files
values.py   sources (a .parm file, a shipped one, `defaults`, or a vehicle's URL), differences, text
check.py    compares a vehicle with its wanted parameters, with names that changed between versions
push.py     pushes parameters over restarts, with the script for HIL messages
"""
