"""MCAP recordings as tables, one per topic.

records.py     the records of the format, from bytes
index.py       the index, from the summary; walk.py: from the records, if the file has no valid summary
chunks.py      chunks decompressed to messages, and the payloads of one topic in batches
table.py       the table of a topic: batches joined to columns
cdr.py         payloads of ROS 2; decoders.py: JSON and Protobuf
file.py        the log
"""
