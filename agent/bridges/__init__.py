"""Bridge to another autopilot: pass the host's sensors to it, its outputs to the host, and MAVLink in both
directions.
"""
