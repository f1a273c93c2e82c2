"""The twin: the model of a boat next to the real boat (system in the loop).

boat.py       MAVLink of the boat, received or read from a telemetry log; nothing is sent
bank.py       the model, restarted every second in variants, as a batch in the compiled kernel
diagnosis.py  a bank of Kalman filters: one for no change, one for each kind and onset of a change
ghost.py      the model on its own for 30 s
session.py    the twin itself: from MAVLink to recording and alarms
"""
