"""Replay of recorded motor outputs: pulse widths from a file (pulse_log), commands over time (motor_schedule)."""
