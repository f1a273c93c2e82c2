"""Stand-ins for other autopilots. Those of ArduPilot replay what a real one sent, byte for byte.

capture.py          the file format: what was sent at which frame of the simulator
capture_rover.py    stands between xitl and a real ardurover and writes it down
replayed_rover.py   takes the command line of ardurover and sends it again
ftp_vehicle.py      a vehicle with MAVLink FTP and parameters
autopilot_scripting.lua   what ArduPilot gives its scripts
px4.py              PX4's simulator interface, with the rhythm and the gaps that a test wants
"""
