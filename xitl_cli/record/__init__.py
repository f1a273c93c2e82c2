"""The recording of a run: the table of topics (topics), their CDR encoding (cdr), the recorder and the MCAP file.

xitl_cli.logs reads the same topics.
"""
