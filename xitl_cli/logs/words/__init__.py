"""What the numbers in a log are called: modes, events, errors, reasons, flags, by vehicle where they differ."""
