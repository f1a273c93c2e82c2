"""Clocks within a log and between logs: readings, fits, correlation, alignment of several logs."""
