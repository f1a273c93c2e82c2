"""The autopilot as a whole: modes, navigation, commands, failsafes, and the loop."""
