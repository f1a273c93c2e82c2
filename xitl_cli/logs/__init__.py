"""Reader of logs and recordings: DataFlash logs, telemetry logs, ULogs, bags and MCAP recordings as one kind of table.

Data flow: opening → Log (formats/) → signals/, clocks/ → analyses, compare/ → report/, export/
The analyses of a log register as plug-ins (`xitl_cli.log_analyses`): callers pass them to report/ and compare/.
"""

from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.errors import LogError

__all__ = ["LogError", "open_log"]
