"""Sensors of a run: instruments, their messages, their faults, and the perception instruments."""
