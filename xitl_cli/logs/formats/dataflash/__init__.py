"""DataFlash logs (.bin) of ArduPilot and of the embedded autopilot, read by columns. Damage is skipped and reported.

definitions.py FMT, FMTU, UNIT and MULT; records.py: the chain of records; index.py: both, settled with each other
table.py       columns and time stamps; file.py: the log
"""
