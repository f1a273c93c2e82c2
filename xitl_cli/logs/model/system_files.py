"""Files that ArduPilot wrote into its log (@SYS/…, hardware definitions, scripts), and the contents of @SYS/tasks.txt.

@SYS/tasks.txt has the run time of each task of the scheduler. A header line ("TasksV2") is followed by one line per
task: name, MIN, MAX and AVG in microseconds, OVR (overruns), SLP, TOT (share of the time of all tasks). An asterisk
after the name marks a task of the fast loop. The window begins at the last PM record (10 s, Plane 5 s). MIN, MAX and
AVG saturate at 9999, OVR at 999; SLP is never counted. After the first request, the autopilot starts counting with its
next PM record. Until then, the file has only the header.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from xitl_cli.logs.model.log import Log

_LARGEST_FILE = 64 << 20
"""bytes of a file; a larger offset is damage"""
_COLUMNS = ("FileName", "Offset", "Length", "Data")


@dataclass(frozen=True, slots=True)
class EmbeddedFile:
    """A file that is stored in pieces inside a log."""

    content: bytes
    gaps: int = 0
    """Places with missing pieces; they read as zeros."""
    lost_bytes: int = 0
    """Bytes of all gaps."""
    refused: int = 0
    """Pieces with an impossible offset or length."""


def embedded_contents(log: Log) -> dict[str, bytes]:
    """Content of the embedded files by name, in the last written version."""
    return {name: file.content for name, file in embedded_files(log).items()}


def embedded_files(log: Log) -> Mapping[str, EmbeddedFile]:
    """Embedded files by name. A piece at offset 0 begins a file anew and discards its earlier content."""
    table = log.tables.get("FILE")
    if table is None or any(name not in table.columns for name in _COLUMNS):
        return {}
    if table.columns["Data"].kind != "bytes" or table.columns["FileName"].kind != "text":
        return {}
    pieces: dict[str, dict[int, bytes]] = {}
    refused: dict[str, int] = {}
    rows = zip(*(table.values(name, raw=True).tolist() for name in _COLUMNS), strict=True)
    for name, offset, length, data in rows:
        if not (0 <= offset <= _LARGEST_FILE and 0 <= length <= len(data)):  # also refuses NaN
            refused[name] = refused.get(name, 0) + 1
        elif offset == 0:
            pieces[name] = {0: data[: int(length)]}
        else:
            pieces.setdefault(name, {})[int(offset)] = data[: int(length)]
    files: dict[str, EmbeddedFile] = {}
    for name in sorted(pieces.keys() | refused.keys()):
        content = bytearray()
        gaps = lost = 0
        for offset, data in sorted(pieces.get(name, {}).items()):
            if offset > len(content):
                gaps += 1
                lost += offset - len(content)
                content.extend(bytes(offset - len(content)))
            content[offset : offset + len(data)] = data
        files[name] = EmbeddedFile(bytes(content), gaps, lost, refused.get(name, 0))
    return files


TASKS_PATH = "@SYS/tasks.txt"
TASKS_MOST_BYTES = 64 * 1024
MOST_US, MOST_OVERRUNS = 9999, 999

_LINE = re.compile(
    r"(?P<name>\S.*?)\s+MIN=\s*(?P<min>\d+)\s+MAX=\s*(?P<max>\d+)\s+AVG=\s*(?P<avg>\d+)\s+"
    r"OVR=\s*(?P<ovr>\d+)\s+SLP=\s*(?P<slp>\d+),?\s+TOT=\s*(?P<tot>\d+(?:\.\d+)?)%?"
)


@dataclass(frozen=True, slots=True)
class TaskTime:
    """Run time of one task over one window."""

    name: str
    fast: bool
    """It runs in every loop, whatever time is left."""
    least_us: int
    most_us: int
    mean_us: int
    overruns: int
    """Runs that took longer than the scheduler's table allows."""
    share_percent: float
    """Share of the time of all tasks."""


def parse_tasks(text: str) -> list[TaskTime]:
    """Tasks in the order of the file, which is the order of priority. Lines without a task are ignored."""
    tasks: list[TaskTime] = []
    for line in text[:TASKS_MOST_BYTES].splitlines():
        match = _LINE.fullmatch(line[:200].strip())
        if match is None:
            continue
        name = match["name"]
        least_us, most_us, mean_us, overruns = (int(match[key][:9]) for key in ("min", "max", "avg", "ovr"))
        share = float(match["tot"][:12])
        tasks.append(TaskTime(name.rstrip("*"), name.endswith("*"), least_us, most_us, mean_us, overruns, share))
    return tasks


def tasks_counted(tasks: Sequence[TaskTime]) -> bool:
    """Whether any time was measured. In SITL the clock stops while a task runs, so all times are 0."""
    return any(task.most_us or task.share_percent for task in tasks)
