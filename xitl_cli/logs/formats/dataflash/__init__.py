"""DataFlash logs (.bin) of ArduPilot and of the embedded autopilot, read by columns. Damage is skipped and reported.

records.py     FMT, FMTU, UNIT and MULT; the chain of records; both, settled with each other
table.py       columns and time stamps; file.py: the log
"""
