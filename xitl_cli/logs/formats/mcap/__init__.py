"""MCAP recordings as tables, one per topic.

container.py   the records of the format, from bytes; the index, from the summary or from the records; chunks
               decompressed to messages, and the payloads of one topic in batches
table.py       the table of a topic: batches joined to columns
cdr.py         payloads of ROS 2; decoders.py: JSON and Protobuf
file.py        the log
"""
