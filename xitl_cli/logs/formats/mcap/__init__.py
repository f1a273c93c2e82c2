"""MCAP recordings as tables, one a topic.

records.py     the records of the format, from bytes
index.py       what is where, from the summary; walk.py: from the records, where the file has no summary that holds
chunks.py      chunks unpacked to messages, and the payloads of one topic in batches
table.py       the table of a topic: batches put together to columns
cdr.py         payloads of ROS 2; decoders.py: JSON and Protobuf
file.py        the log
"""
