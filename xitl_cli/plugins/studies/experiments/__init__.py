"""The experiments of the paper, one command each: it carries out the runs and prints the table."""
