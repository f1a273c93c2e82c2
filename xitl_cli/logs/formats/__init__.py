"""Readers of the three log formats. Each gives tables with the attributes of `logs/table.py`."""
