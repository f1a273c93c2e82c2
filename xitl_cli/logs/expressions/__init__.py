"""Expressions over signals: syntax (parsing), functions and units, evaluation over arrays. Independent of logs."""
