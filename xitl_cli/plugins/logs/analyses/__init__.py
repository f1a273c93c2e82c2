"""One file per question: `analyse(log) -> Section | None`; None if the log cannot answer it."""
