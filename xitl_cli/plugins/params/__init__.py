"""The command `xitl params`: read, compare and set parameters of a vehicle.

check.py    how a vehicle stands to what it should have, with names that changed between versions
push.py     pushing over restarts, with the script for HIL messages
"""
