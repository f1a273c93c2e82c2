"""Runs of an experiment, their quantities over time, and a table of reference values and results."""
