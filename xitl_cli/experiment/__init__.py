"""Runs that an experiment makes of profiles, their quantities over time, and a table of a reference and results."""
