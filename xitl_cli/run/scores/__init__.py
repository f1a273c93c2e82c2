"""Scores of a run against the truth."""
