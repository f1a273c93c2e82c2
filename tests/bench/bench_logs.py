"""How fast a DataFlash log of some 100 MB is read, against pymavlink's reader in the same run.

The log is made of the records of recorded ones, as they follow each other, again and again with their time going on.
Run by hand: `python -m tests.bench.bench_logs`.
"""

from __future__ import annotations

import atexit
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from tests.recorded import LOGS
from xitl_cli.logs.formats.dataflash.file import DataFlashLog

NAMES = ("boat-auto-calm.bin", "boat-auto-gust.bin")
SIZE = 100_000_000
RUNS = 7
DENSE, RARE = "IMU", "PM"
_HOLD_ALL = """
import sys
from pathlib import Path
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
with DataFlashLog(Path(sys.argv[1])) as log:
    held = log.read()
    status = Path("/proc/self/status").read_text()  # getrusage has what forked this, too
    print(int(status.partition("VmHWM:")[2].split()[0]) * 1024)
"""


@cache
def large_log() -> Path:
    """Made anew in each run of the bench, and gone with it."""
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    path = Path(folder.name) / "large.bin"
    whole, bodies = [], []
    for name in NAMES:
        data = np.fromfile(LOGS / name, np.uint8)
        whole.append(data)
        bodies.append(_body(LOGS / name, data))
    with path.open("wb") as file:
        size = file.write(whole[0].tobytes())
        at_us = bodies[0][2] + bodies[0][3]
        while size < SIZE:
            for body, times, begin_us, lasts_us in bodies:
                shifted = body.copy()
                stamps = shifted[times[:, None] + np.arange(8)].view("<u8")[:, 0]
                now = (stamps - np.uint64(begin_us) + np.uint64(at_us)).view(np.uint8).reshape(-1, 8)
                shifted[times[:, None] + np.arange(8)] = now
                size += file.write(shifted.tobytes())
                at_us += lasts_us
    return path


def _body(path: Path, data: np.ndarray) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Records but those that describe, where their times are, when they begin and how long they last.

    Records are found by pymavlink. Types have the same numbers in both logs: one build wrote them.
    """
    from pymavlink import DFReader

    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    begin = {kind: list(starts) for kind, starts in enumerate(reader.offsets) if len(starts)}
    formats = dict(reader.formats)
    reader.close()
    left_out = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "FILE")
    rows = sorted((start, formats[kind]) for kind, starts in begin.items() for start in starts)
    rows = [(start, one) for start, one in rows if one.name not in left_out and start + one.len <= len(data)]
    body = np.concatenate([data[start : start + one.len] for start, one in rows])
    ends = np.cumsum([one.len for _, one in rows])
    times = np.array(
        [end - one.len + 3 for end, (_, one) in zip(ends, rows, strict=True) if one.columns[0] == "TimeUS"]
    )
    stamps = body[times[:, None] + np.arange(8)].view("<u8")
    return body, times, int(stamps.min()), int(np.ptp(stamps)) + 1000


@dataclass(frozen=True, slots=True)
class Theirs:
    """Seconds that pymavlink takes: to open, then each loop."""

    open_s: float
    dense_s: float
    rare_s: float
    all_s: float


@cache
def pymavlink() -> Theirs:
    """Medians of three, of the long loop one."""
    from pymavlink import DFReader

    opens_s, dense_s, rare_s = [], [], []
    DFReader.DFReader_binary(str(large_log())).close()  # the file is in memory then, for both
    for _ in range(3):
        started_s = time.perf_counter()
        reader = DFReader.DFReader_binary(str(large_log()))
        opens_s.append(time.perf_counter() - started_s)
        rare_s.append(loop_s(partial(reader.recv_match, type=RARE)))
        reader.rewind()
        dense_s.append(loop_s(partial(reader.recv_match, type=DENSE)))
        reader.rewind()
        if len(opens_s) < 3:
            reader.close()
    all_s = loop_s(reader.recv_msg)
    reader.close()
    return Theirs(*map(statistics.median, (opens_s, dense_s, rare_s, [all_s])))


def loop_s(next_one: Callable[[], object]) -> float:
    started_s = time.perf_counter()
    while next_one() is not None:
        pass
    return time.perf_counter() - started_s


def timed(work: Callable[[], object], runs: int) -> list[float]:
    """Seconds of each run, after one that is not counted."""
    work()
    took_s = []
    for _ in range(runs):
        started_s = time.perf_counter()
        work()
        took_s.append(time.perf_counter() - started_s)
    return took_s


def all_ratios() -> list[float]:
    """Opening and every message, by pymavlink's recv_msg and into scaled columns."""

    def work() -> None:
        with DataFlashLog(large_log()) as log:
            log.read()

    theirs = pymavlink()
    return [(theirs.open_s + theirs.all_s) / took_s for took_s in timed(work, RUNS)]


def dense_ratios() -> list[float]:
    """All fields of the IMU of an opened log, by pymavlink's recv_match and into scaled columns."""
    with DataFlashLog(large_log()) as log:
        took_s = timed(lambda: log.tables[DENSE].read(), RUNS)
    return [pymavlink().dense_s / one for one in took_s]


def dense_mbps() -> list[float]:
    """Of the file: opening and all fields of the IMU."""

    def work() -> None:
        with DataFlashLog(large_log()) as log:
            log.tables[DENSE].read()

    return [large_log().stat().st_size / 1e6 / took_s for took_s in timed(work, RUNS)]


def rare_ratios() -> list[float]:
    """Opening and PM alone, where pymavlink's index serves it."""

    def work() -> None:
        with DataFlashLog(large_log()) as log:
            log.tables[RARE].read()

    theirs = pymavlink()
    return [(theirs.open_s + theirs.rare_s) / took_s for took_s in timed(work, RUNS)]


def info_s() -> list[float]:
    """Opening, rows by type, the span of time."""

    def work() -> None:
        with DataFlashLog(large_log()) as log:
            void({name: len(table) for name, table in log.tables.items()}, log.span_ns)

    return timed(work, RUNS)


def health_s() -> list[float]:
    """The same, and how whole it is, down to rows that go back in time."""

    def work() -> None:
        with DataFlashLog(large_log()) as log:
            void({name: len(table) for name, table in log.tables.items()}, log.span_ns, log.health)

    return timed(work, RUNS)


def info_command_s() -> list[float]:
    """`xitl logs info` as a process of its own."""
    return timed(lambda: xitl("logs", "info", str(large_log())), RUNS)


def analyze_command_s() -> list[float]:
    """`xitl logs analyze --report` as a process of its own."""
    page = large_log().with_name("large.html")
    return timed(lambda: xitl("logs", "analyze", str(large_log()), "--report", str(page)), 3)


def xitl(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "xitl_cli.main", *arguments], capture_output=True, check=True)


def memory_over_file_mib() -> list[float]:
    """Resident at most, of a process that holds every column, less the size of the file."""
    found = []
    for _ in range(3):
        command = [sys.executable, "-c", _HOLD_ALL, str(large_log())]
        told = subprocess.run(command, capture_output=True, text=True, check=True)
        found.append((int(told.stdout) - large_log().stat().st_size) / 2**20)
    return found


def void(*_: object) -> None:
    """Where results go."""


FIGURES: list[tuple[str, str, str, Callable[[], list[float]]]] = [
    ("every message of a 100 MB log, of pymavlink", ">= 40", "x", all_ratios),
    ("all fields of its IMU, of pymavlink", ">= 60", "x", dense_ratios),
    ("the same with opening, of the file", ">= 350", "MB/s", dense_mbps),
    ("its PM alone with opening, of pymavlink", ">= 1", "x", rare_ratios),
    ("its types, rows and span", "< 0.3", "s", info_s),
    ("the same and its health", "", "s", health_s),
    ("xitl logs info of it", "< 0.5", "s", info_command_s),
    ("xitl logs analyze of it, with a report", "< 10", "s", analyze_command_s),
    ("every column held, memory over the file's size", "< 250", "MiB", memory_over_file_mib),
]


if __name__ == "__main__":
    print(f"{large_log().stat().st_size / 1e6:.1f} MB; pymavlink: {pymavlink()}")
    for name, wanted, unit, measure in FIGURES:
        values = measure()
        print(f"{name:50} {wanted:>7} {statistics.median(values):8.3g} {min(values):8.3g} {max(values):8.3g} {unit}")
