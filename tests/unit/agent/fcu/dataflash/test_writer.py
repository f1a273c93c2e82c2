"""The writer with disks that are slow, full, stuck or taken away."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from dataflash_reader import rows_of

from agent.fcu.dataflash import writer as writer_module
from agent.fcu.dataflash.format import FORMATS, header
from agent.fcu.dataflash.writer import LAST, LogWriter, fixed_log_opener, numbered_log_opener

ROOT = Path(__file__).parents[4]
PERIOD_S = 0.01
EV = FORMATS["EV"]


def record(number: int) -> bytes:
    return EV.pack(number, 25)


class Disk:
    """Stands in for os.write. Closed, it keeps the caller waiting; `full`, it fails; else it writes `most` bytes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.open = threading.Event()
        self.open.set()
        self.entered = threading.Event()
        self.failed = threading.Semaphore(0)
        self.full = False
        self.most = 1 << 30
        self._write = os.write
        monkeypatch.setattr(writer_module, "_write", self)
        monkeypatch.setattr(writer_module, "_sync", lambda _: None)

    def __call__(self, descriptor: int, data: memoryview) -> int:
        self.entered.set()
        assert self.open.wait(30.0)
        if self.full:
            self.failed.release()
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._write(descriptor, data[: self.most])


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


@pytest.mark.medium
def test_records_come_out_in_order(tmp_path: Path) -> None:
    writer = LogWriter(fixed_log_opener(tmp_path / "new" / "log.bin"), period_s=PERIOD_S)
    assert writer.put(header(FORMATS, 0), True)
    assert all(writer.put(record(number)) for number in range(10_000))
    assert writer.close(record(10_000))
    assert writer.close()  # again does nothing
    assert [row.TimeUS for row in rows_of(tmp_path / "new" / "log.bin")["EV"]] == list(range(10_001))
    assert (writer.dropped, writer.errors, writer.unwritten_bytes, writer.problem) == (0, 0, 0, "")
    assert writer.accepted_bytes == (tmp_path / "new" / "log.bin").stat().st_size


def test_a_stuck_disk_drops_and_counts_and_does_not_block(tmp_path: Path, disk: Disk) -> None:
    """Single-threaded proof: the disk is let go only after all puts have returned."""
    disk.open.clear()
    writer = LogWriter(fixed_log_opener(tmp_path / "log.bin"), capacity_bytes=1200, period_s=PERIOD_S)
    writer.put(record(0))
    assert disk.entered.wait(30.0)
    results = [writer.put(record(number)) for number in range(1, 1000)]
    kept = 1 + sum(results)
    # Seven eighths of the capacity is for such records, what is in the disk's hands included.
    assert kept * EV.length <= 1050 < (kept + 1) * EV.length
    assert writer.dropped == 1000 - kept
    assert writer.put(record(1000), True), "the reserve is there for what matters"
    assert not writer.close(record(1001), timeout_s=0.05), "and closing waits no longer than it was told"
    disk.open.set()
    assert writer.close(timeout_s=30.0)
    data = (tmp_path / "log.bin").read_bytes()
    assert data == b"".join(record(number) for number in (*range(kept), 1000, 1001))


def test_waiting_is_for_lockstep_only_and_loses_nothing(tmp_path: Path, disk: Disk) -> None:
    disk.most = 100
    writer = LogWriter(fixed_log_opener(tmp_path / "log.bin"), lossless=True, capacity_bytes=600, period_s=PERIOD_S)
    assert all(writer.put(record(number)) for number in range(2000))
    assert writer.close(timeout_s=30.0)
    assert (tmp_path / "log.bin").read_bytes() == b"".join(map(record, range(2000)))
    assert writer.dropped == 0


def test_a_stuck_disk_is_waited_for_once_in_lockstep(
    tmp_path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer_module, "_PATIENCE_S", 0.05)
    disk.open.clear()
    writer = LogWriter(fixed_log_opener(tmp_path / "log.bin"), lossless=True, capacity_bytes=600, period_s=PERIOD_S)
    waited: list[float | None] = []
    wait = threading.Condition.wait

    def noted(room: threading.Condition, seconds: float | None = None) -> bool:
        if threading.current_thread() is threading.main_thread():
            waited.append(seconds)
        return wait(room, seconds)

    monkeypatch.setattr(threading.Condition, "wait", noted)
    results = [writer.put(record(number)) for number in range(1000)]
    assert waited == [0.05]
    assert writer.dropped == results.count(False) > 0
    disk.open.set()
    assert writer.close(timeout_s=30.0)


def test_a_full_disk_is_said_and_tried_again_from_the_byte_it_stopped_at(tmp_path: Path, disk: Disk) -> None:
    disk.full = True
    writer = LogWriter(fixed_log_opener(tmp_path / "log.bin"), capacity_bytes=1200, period_s=PERIOD_S)
    writer.put(header(FORMATS, 0)[:500])  # any bytes: a stream that must not be torn
    for _ in range(3):
        assert disk.failed.acquire(timeout=30.0)
    assert writer.errors >= 2
    assert "No space left on device" in writer.problem
    assert "log.bin" in writer.problem
    disk.most = 7
    disk.full = False
    numbers = []
    for number in range(20):
        if writer.put(record(number)):
            numbers.append(number)
    assert writer.close(timeout_s=30.0)
    assert writer.problem == ""
    expected = header(FORMATS, 0)[:500] + b"".join(map(record, numbers))
    assert (tmp_path / "log.bin").read_bytes() == expected


def test_closing_on_a_full_disk_gives_up_and_says_what_is_missing(tmp_path: Path, disk: Disk) -> None:
    disk.full = True
    before = threading.enumerate()
    writer = LogWriter(fixed_log_opener(tmp_path / "log.bin"), period_s=30.0)
    writer.put(record(1))
    assert not writer.close(record(2), timeout_s=30.0)
    assert writer.unwritten_bytes == 2 * EV.length
    assert writer.dropped == 2
    assert not writer.close()
    assert writer.dropped == 2
    assert set(threading.enumerate()) <= set(before)


def test_in_lockstep_a_full_disk_is_not_waited_for(tmp_path: Path, disk: Disk) -> None:
    disk.full = True
    writer = LogWriter(fixed_log_opener(tmp_path / "log.bin"), lossless=True, capacity_bytes=600, period_s=PERIOD_S)
    results = [writer.put(record(number)) for number in range(1000)]
    assert not all(results)
    assert writer.dropped == results.count(False)
    writer.close()


def test_a_directory_that_cannot_be_made_is_a_problem_and_no_exception(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    writer = LogWriter(numbered_log_opener(tmp_path / "file" / "logs"), period_s=PERIOD_S)
    assert writer.put(record(1))
    assert not writer.close(timeout_s=30.0)
    assert writer.errors >= 1
    assert "Not a directory" in writer.problem
    assert writer.path is None


def test_names_are_the_next_free_number(tmp_path: Path) -> None:
    def next_name() -> str:
        path, descriptor = numbered_log_opener(tmp_path)()
        os.close(descriptor)
        return path.name

    assert [next_name(), next_name()] == ["00000001.BIN", "00000002.BIN"]
    assert (tmp_path / LAST).read_bytes() == b"2\r\n"
    (tmp_path / "00000007.bin").touch()
    (tmp_path / "notes.txt").touch()
    assert next_name() == "00000008.BIN"
    (tmp_path / "00000008.BIN").unlink()
    assert next_name() == "00000009.BIN", "LASTLOG.TXT remembers what was deleted"
    (tmp_path / LAST).write_text("nonsense")
    assert next_name() == "00000010.BIN"


def test_a_given_file_is_replaced(tmp_path: Path) -> None:
    for number in (1, 2):
        writer = LogWriter(fixed_log_opener(tmp_path / "log.bin"))
        writer.put(record(number))
        assert writer.close(timeout_s=30.0)
    assert (tmp_path / "log.bin").read_bytes() == record(2)


KILLED = """
import sys, time
from pathlib import Path
from agent.fcu.dataflash.writer import fixed_log_opener
from agent.fcu.dataflash.format import header
from agent.fcu.dataflash.format import FORMATS
from agent.fcu.dataflash.writer import LogWriter

writer = LogWriter(fixed_log_opener(Path(sys.argv[1])))
writer.put(header(FORMATS, 0))
start = time.monotonic()
while True:
    now_us = int((time.monotonic() - start) * 1e6)
    writer.put(FORMATS["EV"].pack(now_us, 25))
    print(now_us, flush=True)
    time.sleep(0.02)
"""


@pytest.mark.slow
def test_a_killed_process_costs_the_last_second(tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, env=environment)
    assert process.stdout is not None
    last_us = 0
    while last_us < 2_500_000:
        last_us = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    rest = process.stdout.read().split()
    process.stdout.close()
    process.wait()
    last_us = int(rest[-1]) if rest else last_us
    times = [row.TimeUS for row in rows_of(path)["EV"]]
    assert times == sorted(times)
    # The period is one second; as much again for a machine that has other things to do.
    assert last_us - times[-1] < 2_000_000


@pytest.mark.parametrize("bound", [("MOST_LOGS", 5), ("MOST_LOG_BYTES", 4 * 100)])
def test_the_oldest_logs_make_room_and_their_numbers_are_not_used_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bound: tuple[str, int]
) -> None:
    monkeypatch.setattr(writer_module, *bound)
    (tmp_path / "notes.txt").write_text("mine")
    opener = numbered_log_opener(tmp_path)
    for _ in range(12):
        _, descriptor = opener()
        os.write(descriptor, bytes(100))
        os.close(descriptor)
    assert sorted(path.name for path in tmp_path.glob("*.BIN")) == [f"{n:08d}.BIN" for n in range(8, 13)]
    assert (tmp_path / "notes.txt").read_text() == "mine"
