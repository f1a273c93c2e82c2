"""What vehicles and runs left behind: DataFlash logs, telemetry logs and MCAP recordings as one kind of table.

opening → Log (dataflash/, mcap/, mavlink/) → signals/ → analyses/, timeline/, compare/ → report/, export/
"""
