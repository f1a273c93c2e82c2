"""Recorded motor outputs played again: pulse widths from a file (pulse_log), commands over time (motor_schedule)."""
