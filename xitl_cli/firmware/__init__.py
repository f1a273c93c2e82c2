"""Firmware of other autopilots: cache, download, verification, process."""
