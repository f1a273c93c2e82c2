"""Actions of a person during a run: definition, streams and replay. nodes/operator.py carries them out."""
