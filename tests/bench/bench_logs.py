"""How fast a DataFlash log of some 100 MB is read, against pymavlink's reader in the same run.

Two of them, each of the records of recorded logs, as they follow each other, again and again with their time going on:

simulator   of ArduPilot's simulator, whose clock stands still while it logs: 97 of 100 stamps repeat the row before
board       of the Linux build with a real scheduler; every stamp is its own, and the low bits of every float are noise

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
from typing import Literal

import numpy as np

from tests.bench.figure import Figure, scaled
from tests.recorded import LOGS
from xitl_cli.logs.formats.dataflash.file import DataFlashLog

Kind = Literal["simulator", "board"]
NAMES: dict[Kind, tuple[str, ...]] = {
    "simulator": ("boat-auto-calm.bin", "boat-auto-gust.bin"),
    "board": ("boat-auto-linux-hal-injected.bin",),
}
SIZE = 100_000_000
RUNS, PYMAVLINK_RUNS = 7, 3
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
def large_log(kind: Kind) -> Path:
    """Made anew in each run of the bench, and gone with it."""
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    path, rng = Path(folder.name) / f"{kind}.bin", np.random.default_rng(1)
    bodies = [body_of(LOGS / name) for name in NAMES[kind]]
    with path.open("wb") as file:
        size = file.write((LOGS / NAMES[kind][0]).read_bytes())
        at_us = bodies[0].begin_us + bodies[0].lasts_us
        while size < scaled(SIZE, 1):
            for body in bodies:
                records = body.shifted(at_us)
                if kind == "board":
                    body.set_apart(records, rng)
                    body.add_noise(records, rng)
                size += file.write(records.tobytes())
                at_us += body.lasts_us
    return path


@dataclass(frozen=True, slots=True)
class Body:
    """Records but those that describe. times, floats: where their stamps are, and their numbers of single precision."""

    records: np.ndarray
    times: np.ndarray
    floats: np.ndarray
    begin_us: int
    lasts_us: int

    def stamps(self, records: np.ndarray) -> np.ndarray:
        return records[self.times[:, None] + np.arange(8)].view("<u8")[:, 0].astype(np.int64)

    def stamp(self, records: np.ndarray, stamps_us: np.ndarray) -> None:
        records[self.times[:, None] + np.arange(8)] = stamps_us.astype("<u8").view(np.uint8).reshape(-1, 8)

    def shifted(self, at_us: int) -> np.ndarray:
        records = self.records.copy()
        self.stamp(records, self.stamps(records) - self.begin_us + at_us)
        return records

    def set_apart(self, records: np.ndarray, rng: np.random.Generator) -> None:
        """Stamps of rows that were written in one instant, as by a processor that takes its time for each."""
        stamps_us = self.stamps(records)
        number = np.arange(len(stamps_us))
        begins = np.append(True, stamps_us[1:] != stamps_us[:-1])
        in_a_row = number - np.maximum.accumulate(np.where(begins, number, 0))
        self.stamp(records, stamps_us + 4 * in_a_row + rng.integers(0, 4, len(stamps_us)))

    def add_noise(self, records: np.ndarray, rng: np.random.Generator) -> None:
        records[self.floats] = rng.integers(0, 256, len(self.floats), dtype=np.uint8)  # the last 14 of 24 bits
        records[self.floats + 1] = records[self.floats + 1] & 0xC0 | rng.integers(
            0, 64, len(self.floats), dtype=np.uint8
        )


def body_of(path: Path) -> Body:
    """Records are found by pymavlink. Types have the same numbers in logs of one build."""
    from pymavlink import DFReader

    data = np.fromfile(path, np.uint8)
    reader = DFReader.DFReader_binary(str(path), zero_time_base=True)
    begin = {kind: list(starts) for kind, starts in enumerate(reader.offsets) if len(starts)}
    formats = dict(reader.formats)
    reader.close()
    left_out = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "FILE")
    rows = sorted((start, formats[kind]) for kind, starts in begin.items() for start in starts)
    rows = [(start, one) for start, one in rows if one.name not in left_out and start + one.len <= len(data)]
    records = np.concatenate([data[start : start + one.len] for start, one in rows])
    ends = np.cumsum([one.len for _, one in rows])
    starts = [end - one.len for end, (_, one) in zip(ends.tolist(), rows, strict=True)]
    times = [start + 3 for start, (_, one) in zip(starts, rows, strict=True) if one.columns[0] == "TimeUS"]
    inside = {one.type: _floats(one.format) for _, one in rows}
    floats = [start + 3 + at for start, (_, one) in zip(starts, rows, strict=True) for at in inside[one.type]]
    stamps = records[np.array(times)[:, None] + np.arange(8)].view("<u8")
    return Body(records, np.array(times), np.array(floats), int(stamps.min()), int(np.ptp(stamps)) + 1000)


_SIZES = {"b": 1, "B": 1, "M": 1, "h": 2, "H": 2, "c": 2, "C": 2, "g": 2, "n": 4, "N": 16, "Z": 64, "a": 64}
_SIZES |= dict.fromkeys("iIfeEL", 4) | dict.fromkeys("qQd", 8)


def _floats(letters: str) -> list[int]:
    """Where the numbers of single precision are in a record."""
    ends = np.cumsum([_SIZES[letter] for letter in letters]).tolist()
    return [end - 4 for end, letter in zip(ends, letters, strict=True) if letter == "f"]


@dataclass(frozen=True, slots=True)
class Theirs:
    """Seconds of a processor that pymavlink takes: to open, then each loop."""

    open_s: float
    dense_s: float
    rare_s: float
    all_s: float


@cache
def pymavlink(kind: Kind) -> Theirs:
    """Medians of three, of the long loop one."""
    from pymavlink import DFReader

    opens_s, dense_s, rare_s = [], [], []
    DFReader.DFReader_binary(str(large_log(kind))).close()  # the file is in memory then, for both
    for _ in range(PYMAVLINK_RUNS):
        started_s = time.process_time()
        reader = DFReader.DFReader_binary(str(large_log(kind)))
        opens_s.append(time.process_time() - started_s)
        rare_s.append(loop_s(partial(reader.recv_match, type=RARE)))
        reader.rewind()
        dense_s.append(loop_s(partial(reader.recv_match, type=DENSE)))
        reader.rewind()
        if len(opens_s) < PYMAVLINK_RUNS:
            reader.close()
    all_s = loop_s(reader.recv_msg)
    reader.close()
    return Theirs(*map(statistics.median, (opens_s, dense_s, rare_s, [all_s])))


def loop_s(next_one: Callable[[], object]) -> float:
    """Seconds of a processor until it gives no more."""
    started_s = time.process_time()
    while next_one() is not None:
        pass
    return time.process_time() - started_s


def timed(work: Callable[[], object], runs: int, clock: Callable[[], float] = time.perf_counter) -> list[float]:
    """Seconds of each run, after one that is not counted."""
    work()
    took_s = []
    for _ in range(runs):
        started_s = clock()
        work()
        took_s.append(clock() - started_s)
    return took_s


def processor_s(work: Callable[[], object]) -> list[float]:
    """As `timed`: what others do on the machine meanwhile is in neither reader's figure."""
    return timed(work, scaled(RUNS, 1), time.process_time)


def all_ratios(kind: Kind) -> list[float]:
    """Opening and every message, by pymavlink's recv_msg and into scaled columns."""

    def work() -> None:
        with DataFlashLog(large_log(kind)) as log:
            log.read()

    theirs = pymavlink(kind)
    return [(theirs.open_s + theirs.all_s) / took_s for took_s in processor_s(work)]


def dense_ratios(kind: Kind) -> list[float]:
    """All fields of the IMU of an opened log, by pymavlink's recv_match and into scaled columns."""
    with DataFlashLog(large_log(kind)) as log:
        took_s = processor_s(lambda: log.tables[DENSE].read())
    return [pymavlink(kind).dense_s / one for one in took_s]


def dense_mbps(kind: Kind) -> list[float]:
    """Of the file: opening and all fields of the IMU."""

    def work() -> None:
        with DataFlashLog(large_log(kind)) as log:
            log.tables[DENSE].read()

    return [large_log(kind).stat().st_size / 1e6 / took_s for took_s in timed(work, scaled(RUNS, 1))]


def rare_ratios(kind: Kind) -> list[float]:
    """Opening and PM alone, where pymavlink's index serves it."""

    def work() -> None:
        with DataFlashLog(large_log(kind)) as log:
            log.tables[RARE].read()

    theirs = pymavlink(kind)
    return [(theirs.open_s + theirs.rare_s) / took_s for took_s in processor_s(work)]


def info_s(kind: Kind) -> list[float]:
    """Opening, rows by type, the span of time."""

    def work() -> None:
        with DataFlashLog(large_log(kind)) as log:
            void({name: len(table) for name, table in log.tables.items()}, log.span_ns)

    return timed(work, scaled(RUNS, 1))


def health_s(kind: Kind) -> list[float]:
    """The same, and how whole it is, down to rows that go back in time."""

    def work() -> None:
        with DataFlashLog(large_log(kind)) as log:
            void({name: len(table) for name, table in log.tables.items()}, log.span_ns, log.health)

    return timed(work, scaled(RUNS, 1))


def info_command_s(kind: Kind) -> list[float]:
    """`xitl logs info` as a process of its own."""
    return timed(lambda: xitl("logs", "info", str(large_log(kind))), scaled(RUNS, 1))


def analyze_command_s(kind: Kind) -> list[float]:
    """`xitl logs analyze --report` without the replay, as a process of its own."""
    page = large_log(kind).with_suffix(".html")
    return timed(
        lambda: xitl("logs", "analyze", str(large_log(kind)), "--no-replay", "--report", str(page)), scaled(3, 1)
    )


def xitl(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "xitl_cli.main", *arguments], capture_output=True, check=True)


def memory_over_file_mib(kind: Kind) -> list[float]:
    """Resident at most, of a process that holds every column, less the size of the file."""
    found = []
    for _ in range(scaled(3, 1)):
        command = [sys.executable, "-c", _HOLD_ALL, str(large_log(kind))]
        told = subprocess.run(command, capture_output=True, text=True, check=True)
        found.append((int(told.stdout) - large_log(kind).stat().st_size) / 2**20)
    return found


def void(*_: object) -> None:
    """Where results go."""


_OF_EACH: list[tuple[str, str, str, Callable[[Kind], list[float]]]] = [
    ("every message, of pymavlink", ">= 60", "x", all_ratios),
    ("all fields of its IMU, of pymavlink", ">= 250", "x", dense_ratios),
    ("the same with opening, of the file", ">= 350", "MB/s", dense_mbps),
    ("its PM alone with opening, of pymavlink", ">= 1", "x", rare_ratios),
    ("its types, rows and span", "< 0.3", "s", info_s),
    ("the same and its health", "", "s", health_s),
    ("xitl logs info of it", "< 0.5", "s", info_command_s),
    ("xitl logs analyze of it, with a report", "< 10", "s", analyze_command_s),
    ("every column held, memory over the file's size", "< 250", "MiB", memory_over_file_mib),
]
_LOGS: dict[Kind, str] = {"simulator": "100 MB of a simulator", "board": "100 MB of a board"}
FIGURES = [
    Figure(f"{log}: {name}", wanted, unit, partial(measure, kind))
    for kind, log in _LOGS.items()
    for name, wanted, unit, measure in _OF_EACH
]


if __name__ == "__main__":
    for each in _LOGS:
        print(f"{each}: {large_log(each).stat().st_size / 1e6:.1f} MB; pymavlink: {pymavlink(each)}")
    for name, wanted, unit, measure in FIGURES:
        values = measure()
        print(f"{name:70} {wanted:>7} {statistics.median(values):8.3g} {min(values):8.3g} {max(values):8.3g} {unit}")
