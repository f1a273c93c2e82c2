"""What a machine says of itself, from files made for it."""

from __future__ import annotations

import os
import re
import resource
from pathlib import Path

import pytest

from agent.machine import (
    LOOP_PASSES,
    LOOP_TRIES,
    REAL,
    VIRTUAL,
    HealthMonitor,
    loop_rate_hz,
    read_machine,
    resident_kib,
)


def made(root: Path, **files: str) -> Path:
    for name, text in files.items():
        path = root / name.replace("__", "/").replace("_dash_", "-")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def test_a_board_is_called_by_its_model(tmp_path: Path) -> None:
    made(
        tmp_path,
        proc__device_dash_tree__model="TI AM335x BeagleBone Black\0",
        proc__meminfo="MemTotal:         496472 kB\nMemFree: 1 kB\n",
        proc__cpuinfo="model name\t: ARMv7 Processor rev 2 (v7l)\n",
        sys__kernel__realtime="1\n",
    )
    board = read_machine(tmp_path)
    assert (board.kind, board.name, board.memory_mib) == (REAL, "TI AM335x BeagleBone Black", 484)
    assert board.preempt_rt
    system = os.uname()
    assert board.kernel == f"{system.sysname} {system.release} {system.machine} PREEMPT_RT"
    assert board.processors == len(os.sched_getaffinity(0))


def test_a_desktop_by_its_processor(tmp_path: Path) -> None:
    made(tmp_path, proc__cpuinfo="processor\t: 0\nmodel name\t: Fast CPU @ 3 GHz\n", sys__kernel__realtime="0\n")
    desktop = read_machine(tmp_path)
    assert (desktop.kind, desktop.name, desktop.memory_mib) == (VIRTUAL, "Fast CPU @ 3 GHz", 0)
    assert desktop.preempt_rt == ("PREEMPT_RT" in os.uname().version)


def test_a_machine_that_tells_nothing(tmp_path: Path) -> None:
    assert read_machine(tmp_path).name == os.uname().machine


def test_an_emulated_board_stands_in_for_one(tmp_path: Path) -> None:
    made(tmp_path, proc__device_dash_tree__model="linux,dummy-virt\0")
    emulated = read_machine(tmp_path)
    assert emulated.kind == VIRTUAL
    assert re.fullmatch(r"emulated \w+ board, \d+\.\d\d M loops/s", emulated.name)


def test_the_loop_goes_round_as_often_as_a_clock_of_its_own_says(monkeypatch: pytest.MonkeyPatch) -> None:
    instants = iter([0.0, 0.5, 1.0, 1.25, *(2.0 + 0.5 * count for count in range(2 * LOOP_TRIES))])
    monkeypatch.setattr("agent.machine.time.perf_counter", lambda: next(instants))
    assert loop_rate_hz() == LOOP_PASSES / 0.25


@pytest.mark.parametrize("junk", ["MemTotal:\n", "MemTotal: many kB\n", "\xff\xfe"])
def test_junk_is_unknown(tmp_path: Path, junk: str) -> None:
    assert read_machine(made(tmp_path, proc__meminfo=junk)).memory_mib == 0


def test_the_temperature_is_the_processors(tmp_path: Path) -> None:
    zones = "sys__class__thermal__thermal_zone"
    made(tmp_path, **{f"{zones}0__type": "acpitz\n", f"{zones}0__temp": "27800\n"})
    assert HealthMonitor(tmp_path).read().temperature_degc == pytest.approx(27.8)
    made(tmp_path, **{f"{zones}1__type": "cpu-thermal\n", f"{zones}1__temp": "51500\n"})
    monitor = HealthMonitor(tmp_path)
    assert monitor.read().temperature_degc == pytest.approx(51.5)
    made(tmp_path, **{f"{zones}1__temp": "-274000\n"})
    assert monitor.read().temperature_degc is None
    assert HealthMonitor(tmp_path / "nowhere").read().temperature_degc is None


def test_a_moment_says_nothing_about_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run ends at any time after the last look: what it took to end it is not how busy the board was."""
    now = {"monotonic": 0.0, "process_time": 0.0}
    for name in now:
        monkeypatch.setattr(f"agent.machine.time.{name}", lambda name=name: now[name])
    monitor = HealthMonitor()
    told = []
    for clock_s, used_s in ((1.0, 0.05), (2.0, 0.15), (2.01, 0.155), (3.0, 0.20)):
        now.update(monotonic=clock_s, process_time=used_s)
        told.append(monitor.read().cpu_percent)
    assert told == pytest.approx([5.0, 10.0, 10.0, 5.0])


def test_how_this_machine_is_doing() -> None:
    monitor = HealthMonitor()
    used_s = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    while resource.getrusage(resource.RUSAGE_SELF).ru_utime < used_s + 0.05:
        pass
    health = monitor.read()
    assert 0.0 < health.cpu_percent <= 100.0 * (os.cpu_count() or 1) + 50.0
    assert health.load_1min >= 0.0
    # VmRSS counts the same pages, and the two looks are a moment apart.
    status = Path("/proc/self/status").read_text()
    told_kib = int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])
    assert resident_kib() == pytest.approx(told_kib, rel=0.05)
