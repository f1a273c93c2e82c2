"""Expressions over signals: syntax (parsing), functions and units, evaluation over arrays. Knows no log."""
