"""What vehicles and runs left behind: DataFlash logs, telemetry logs and MCAP recordings as one kind of table.

opening → Log (formats/) → signals/, clocks/ → analyses/, compare/ → report/, export/
"""

from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.errors import LogError

__all__ = ["LogError", "open_log"]
