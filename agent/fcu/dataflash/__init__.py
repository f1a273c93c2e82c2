"""DataFlash logs (.bin) as ArduPilot writes them: the records, and a writer that never holds up who produces them."""
