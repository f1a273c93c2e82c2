"""The companion computer of a run: its line, what goes between it and the autopilot, what it reports."""
