"""DataFlash logs (.bin) of ArduPilot and of the embedded autopilot, read by columns; damage is skipped, and told.

heads (A3 95) → definitions (FMT) → chain (records) → index → file, table, rows → columns; embedded: files in a log
"""
