"""The command `xitl params`: read, compare and set parameters of a vehicle.

check.py    comparison of a vehicle with the wanted parameters, with names that changed between versions
push.py     parameters over several restarts, with the script for HIL messages
"""
