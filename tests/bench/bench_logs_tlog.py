"""How fast a telemetry log is read, against pymavlink's reader in the same run.

The log is a recorded one again and again with its time going on. Run by hand: `python -m tests.bench.bench_logs_tlog`.
"""

from __future__ import annotations

import atexit
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from tests.bench.bench_logs import RUNS, loop_s, timed
from tests.bench.figure import Figure, scaled
from tests.recorded import MISSION_TLOG
from xitl_cli.logs.formats.tlog.file import TelemetryLog, index_frames

SIZE = 20_000_000


@cache
def large_log() -> Path:
    """Made anew in each run of the bench, and gone with it."""
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    path = Path(folder.name) / "large.tlog"
    data = np.fromfile(MISSION_TLOG, np.uint8)
    times = (index_frames(data).start - 8)[:, None] + np.arange(8)
    stamp_us = data[times].view(">u8")[:, 0]
    lasts_us = int(np.ptp(stamp_us)) + 1000
    with path.open("wb") as file:
        for number in range(scaled(SIZE // len(data), 1)):
            data[times] = (stamp_us + np.uint64(number * lasts_us)).astype(">u8").view(np.uint8).reshape(-1, 8)
            file.write(data.tobytes())
    return path


@cache
def pymavlink_s() -> float:
    """All messages by recv_msg."""
    from pymavlink import mavutil

    connection = mavutil.mavlink_connection(str(large_log()), dialect="ardupilotmega")
    took_s = loop_s(connection.recv_msg)
    connection.close()
    return took_s


def all_s(clock: Callable[[], float] = time.perf_counter) -> list[float]:
    """Opening and every column of every message."""

    def work() -> None:
        with TelemetryLog(large_log()) as log:
            for table in log.tables.values():
                for column in table.columns:
                    table.values(column)

    return timed(work, scaled(RUNS, 1), clock)


def mbps() -> list[float]:
    return [large_log().stat().st_size / 1e6 / took_s for took_s in all_s()]


def ratios() -> list[float]:
    return [pymavlink_s() / took_s for took_s in all_s(time.process_time)]


FIGURES = [
    Figure("every message of a 20 MB telemetry log", "", "MB/s", mbps),
    Figure("every message of a 20 MB telemetry log, of pymavlink", "", "x", ratios),
]


if __name__ == "__main__":
    for name, wanted, unit, measure in FIGURES:
        values = measure()
        print(f"{name:50} {wanted:>7} {statistics.median(values):8.3g} {min(values):8.3g} {max(values):8.3g} {unit}")
