"""One question, one file: `analyse(log) -> Section | None`; None where the log cannot have anything to say about it."""
