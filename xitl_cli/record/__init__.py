"""One recording, one vocabulary of topics: what a run writes and what live view, report and analysis read."""
