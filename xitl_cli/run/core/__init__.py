"""The base of every part of a run: the node interface, reports, time, statistics, seeds, faults and the run
directory.
"""
