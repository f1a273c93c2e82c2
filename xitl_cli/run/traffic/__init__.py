"""Traffic between vessels: AIS, following, and the distances of encounters."""
