"""The embedded autopilot in layers, each importing only those before it.

Data and parameters (here), `estimation` (LS) and `control` (LC, LA), `vehicle` (modes, navigation, failsafes, the
autopilot), then `mavlink` and `dataflash`, which serve and log it.
"""
