"""What a user picks out of a log by words: messages, fields, a span of time, a condition; and the rows that remain."""
