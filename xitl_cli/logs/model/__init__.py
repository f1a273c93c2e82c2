"""What every part of the log reader stands on: logs, tables, queries, texts, sections of a report, errors."""
