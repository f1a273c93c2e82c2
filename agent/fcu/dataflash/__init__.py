"""DataFlash logs (.bin) in ArduPilot's format: the records, and a writer that never blocks its producer."""
