"""Common base of the log reader: logs, tables, queries, texts, sections of a report, errors."""
