"""Embedded autopilot in layers. Each layer imports only the layers before it.

The layers are data and parameters (here), `estimation` (LS) and `control` (LC, LA), and `vehicle`. That one has modes,
navigation, failsafes and the autopilot. `mavlink` and `dataflash` serve and log it.
"""
