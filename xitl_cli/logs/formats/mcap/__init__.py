"""MCAP recordings as tables: one a topic.

source.py      reading pieces of the file
records.py     the records of the format, from bytes
index.py       what is where, and what was found damaged
summary.py     the index as the file itself has it; walk.py: made from the records when it has none that holds
plausible.py   which bytes may be a record, to find the next one after damage
unpack.py      a chunk's bytes, bounded; content.py: the records in them; chunks.py: both, kept and counted
gather.py      the payloads of one topic, in batches
decoded.py     what a decoder gives: leaves of one batch, put together to columns
cdr_definition.py, cdr.py, cdr_leaves.py, cdr_sizes.py    ROS 2
protobuf.py, jsons.py, lists.py    Foxglove's and others'
units.py       of our own recordings
topic.py       the table of a topic
file.py        the log
"""
