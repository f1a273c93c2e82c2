"""The experiments of the paper, each one command: it makes the runs and prints the table."""
