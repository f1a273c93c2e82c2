"""Recorded motor outputs played again: pulse widths from a file, commands from pulse widths, commands by time.

csv_file.py, dataflash_file.py -> pulses.py (PulseLog) -> track.py (Track: what is commanded when)
"""
