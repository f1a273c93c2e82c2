"""ULog (.ulg) of PX4, read by columns. Damage is skipped and reported.

definitions.py formats of messages; records.py the chain of records; contents.py parameters, information and texts
table.py       columns; times.py: stamps; file.py: the log

The format: https://docs.px4.io/main/en/dev_log/ulog_file_format
"""
