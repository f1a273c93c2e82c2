"""The complete autopilot: modes, navigation, commands, failsafes, and the loop."""
