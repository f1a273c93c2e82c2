"""Nodes of a run: autopilot, bridge, standby, companion, direct control, drivers."""
