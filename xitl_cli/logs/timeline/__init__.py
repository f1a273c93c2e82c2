"""Time within a log and between logs.

readings.py       two clocks, read at the same events, as the logs hold them
sources.py        where each kind of log holds some; relations.py: all of a log, fitted
clock_fit.py      one clock against another: lines, rate by window; steps.py: where it steps or bends
one_way.py        a line under delays that have a floor; robust.py: a line through errors without one
correlation.py    how far a signal lies behind the same signal in another log
chains.py         ways from one log's time to another's; placement.py: where a log then lies
shared.py         signals that two logs both hold
alignment.py      several logs of one run on one time line
"""
