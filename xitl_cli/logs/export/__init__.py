"""Tables of a log as files that other programs read: CSV, Parquet, MCAP."""
