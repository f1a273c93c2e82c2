"""What of a flight goes into the DataFlash log, and when."""
