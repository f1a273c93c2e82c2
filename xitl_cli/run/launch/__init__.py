"""How the firmware of another autopilot is started: its command line, files and ports."""
