"""@SYS/tasks.txt of ArduPilot: what each task of its scheduler took.

A header line ("TasksV2"), then a task a line: name, MIN, MAX and AVG in microseconds, OVR (overruns), SLP, TOT (share
of the time of all tasks). An asterisk after the name marks a task of the fast loop. Counted since the last PM record
(10 s, Plane 5 s); MIN, MAX and AVG end at 9999, OVR at 999; SLP is never counted. The autopilot starts counting when it
is first asked, with its next PM record: until then the header is all there is.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

PATH = "@SYS/tasks.txt"
MOST_BYTES = 64 * 1024
MOST_US, MOST_OVERRUNS = 9999, 999

_LINE = re.compile(
    r"(?P<name>\S.*?)\s+MIN=\s*(?P<min>\d+)\s+MAX=\s*(?P<max>\d+)\s+AVG=\s*(?P<avg>\d+)\s+"
    r"OVR=\s*(?P<ovr>\d+)\s+SLP=\s*(?P<slp>\d+),?\s+TOT=\s*(?P<tot>\d+(?:\.\d+)?)%?"
)


@dataclass(frozen=True, slots=True)
class TaskTime:
    """One task over one window. overruns: runs that took longer than the scheduler's table allows them.

    share_percent: of the time that all tasks took. fast: it runs in every loop, whatever time is left.
    """

    name: str
    fast: bool
    least_us: int
    most_us: int
    mean_us: int
    overruns: int
    share_percent: float


def parse(text: str) -> list[TaskTime]:
    """In the order of the file, which is that of priority. Lines that are no task are left out."""
    found: list[TaskTime] = []
    for line in text[:MOST_BYTES].splitlines():
        match = _LINE.fullmatch(line[:200].strip())
        if match is None:
            continue
        name = match["name"]
        found.append(
            TaskTime(
                name.rstrip("*"),
                name.endswith("*"),
                int(match["min"][:9]),
                int(match["max"][:9]),
                int(match["avg"][:9]),
                int(match["ovr"][:9]),
                float(match["tot"][:12]),
            )
        )
    return found


def counted(tasks: Sequence[TaskTime]) -> bool:
    """Whether any time was measured: where the clock stands still while a task runs (SITL), all is 0."""
    return any(task.most_us or task.share_percent for task in tasks)
