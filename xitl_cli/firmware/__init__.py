"""Firmware of other autopilots: where it is kept, how it is brought here, how it is started."""
