"""What every part of a run stands on: the node interface, reports, time, statistics, seeds, faults, the directory."""
