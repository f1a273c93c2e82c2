"""Files of MAVLink FTP, under ArduPilot's names: @PARAM/param.pck, @SYS/…, /APM/LOGS/…"""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from typing import Callable

from agent.fcu.dataflash.stored_logs import ServedLog, StoredLog
from agent.fcu.mavlink.hub import MavlinkHub
from agent.fcu.parameters import TABLE
from agent.mavlink.ftp_server import ServedFile
from agent.mavlink.parameter_file import PackedParameters, ParameterFileRow, parse_query
from agent.timing.tasks import TaskStats

_LOGS = ("APM", "LOGS")
_PARAMETERS = ("@PARAM", "param.pck")
_MOST_US, _MOST_OVERRUNS = 9999, 999


class TextFile:
    """A ServedFile with a content that is generated on opening."""

    def __init__(self, text: str) -> None:
        self._content = text.encode("ascii", "replace")

    @property
    def size(self) -> int:
        return len(self._content)

    def read(self, offset: int, count: int) -> bytes:
        return self._content[offset : offset + count]


class ServedFiles:
    """Read-only files. See `Files` and `Logs` of agent.mavlink."""

    def __init__(self, hub: MavlinkHub) -> None:
        self._hub = hub
        self._system: dict[str, Callable[[], str]] = {
            "tasks.txt": lambda: tasks_text(hub.task_stats),
            "uptime.txt": lambda: f"{hub.autopilot.state.now_ns / 1e9:.3f} s\n",
        }

    def entries(self, path: str) -> Sequence[str] | None:
        """Return the entries of a folder."""
        folder = _parts(path)
        if folder == ():
            return ["D@PARAM", "D@SYS", f"D{_LOGS[0]}"]
        if folder == _PARAMETERS[:1]:
            return [f"F{_PARAMETERS[1]}\t{self._parameters('').size}"]
        if folder == ("@SYS",):
            return [f"F{name}\t{len(text())}" for name, text in self._system.items()]
        if folder == _LOGS[:1]:
            return [f"D{_LOGS[1]}"]
        if folder == _LOGS:
            logs = self._hub.logs.logs()
            return None if logs is None else [f"F{log.name}\t{log.size}" for log in logs]
        raise _missing(path)

    def open(self, path: str) -> ServedFile | None:
        """Open a file."""
        plain, _, query = path.partition("?")
        parts = _parts(plain)
        if parts == _PARAMETERS:
            return self._parameters(query)
        if len(parts) == 2 and parts[0] == "@SYS" and parts[1] in self._system:
            return TextFile(self._system[parts[1]]())
        if len(parts) == 3 and parts[:2] == _LOGS:
            logs = self._hub.logs.logs()
            if logs is None:
                return None
            for index, log in enumerate(logs):
                if log.name == parts[2].upper():
                    return self._hub.logs.open_log(index)
        raise _missing(path)

    def logs(self) -> Sequence[StoredLog] | None:
        """Return the logs, oldest first. None while the disk is being read."""
        return self._hub.logs.logs()

    def open_log(self, index: int) -> ServedLog | None:
        """Open a log. Raises IndexError for an unknown index."""
        return self._hub.logs.open_log(index)

    def _parameters(self, query: str) -> PackedParameters:
        values = self._hub.autopilot.parameters
        return PackedParameters(
            lambda: [ParameterFileRow(row.name, row.type, values[row.name], row.default) for row in TABLE],
            parse_query(query),
        )


def tasks_text(stats: Sequence[TaskStats]) -> str:
    """Text in the format of ArduPilot's @SYS/tasks.txt, which `xitl logs tasks` reads.

    MIN is the lower edge of the shortest class. Counts are since the start of the run; ArduPilot resets them every ten
    seconds.
    """
    whole_ns = sum(task.run_mean_ns * task.cycles for task in stats)
    lines = ["TasksV2\n"]
    for task in stats:
        shortest = next((number for number, count in enumerate(task.run_histogram) if count), 0)
        least_us, mean_us, most_us = 1 << shortest if shortest else 0, task.run_mean_ns / 1e3, task.run_max_ns / 1e3
        share = 100.0 * task.run_mean_ns * task.cycles / whole_ns if whole_ns else 0.0
        least_us, mean_us, most_us = (min(int(value), _MOST_US) for value in (least_us, mean_us, most_us))
        lines.append(
            f"{task.name:<16.16} MIN={least_us:4} MAX={most_us:4} AVG={mean_us:4} "
            f"OVR={min(task.missed, _MOST_OVERRUNS):3} SLP=  0, TOT={share:4.1f}%\n"
        )
    return "".join(lines)


def _parts(path: str) -> tuple[str, ...]:
    return tuple(part for part in path.split("/") if part not in ("", "."))


def _missing(path: str) -> OSError:
    return FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), path)
