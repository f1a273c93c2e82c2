"""The base of every part of a run: node interface, reports, time, statistics, faults and the run directory."""
