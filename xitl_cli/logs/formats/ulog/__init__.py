"""ULog (.ulg) of PX4, read by columns. Damage is skipped and reported.

definitions.py formats of messages and units of their fields
records.py     the chain of records, and the parameters, information and texts in it
table.py       columns
file.py        the log and the stamps of its rows

The format: https://docs.px4.io/main/en/dev_log/ulog_file_format
"""
