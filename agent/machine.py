"""Machine of the agent and its health, from files under /proc and /sys. Unreadable values are unknown."""

from __future__ import annotations

import os
import platform
import time
from math import inf
from pathlib import Path
from typing import NamedTuple

LOOP_PASSES, LOOP_TRIES = 2000, 10
SHORTEST_S = 0.5  # shortest interval: processor time over less is too noisy
VIRTUAL, REAL = "virtual", "real"
EMULATED = "emulated "  # prefix of the name of an emulated board
_STAND_INS = ("linux,dummy-virt", "riscv-virtio,qemu")  # models that emulators report
_CPU_SENSORS = ("cpu", "soc", "x86_pkg", "core", "mcu")  # in a thermal zone's type


class Machine(NamedTuple):
    """Constant properties of the machine."""

    kind: str
    """A real board, or a virtual machine in its place."""
    name: str
    """Model of the board, or else its processor. For an emulated board, its architecture and the speed of Python."""
    kernel: str
    """System, release, processor, and PREEMPT_RT if it applies."""
    preempt_rt: bool
    processors: int
    """Number of processors that the agent may use."""
    memory_mib: int
    """0: unknown."""


class MachineHealth(NamedTuple):
    """Health of the machine."""

    cpu_percent: float
    """Load of one core by this process since an earlier reading, at least `SHORTEST_S` ago."""
    load_1min: float
    """Below 0: unknown."""
    temperature_degc: float | None
    """None: unknown."""
    memory_kib: int
    """Resident memory, 0: unknown."""


def read_machine(root: Path = Path("/")) -> Machine:
    """Read the properties of this machine from the files under `root`."""
    model = _text(root / "proc/device-tree/model").rstrip("\0").strip()
    emulated = model in _STAND_INS
    system = platform.uname()
    preempt_rt = _text(root / "sys/kernel/realtime").strip() == "1" or "PREEMPT_RT" in system.version
    kernel = f"{system.system} {system.release} {system.machine}"
    if emulated:
        name = f"{EMULATED}{system.machine} board, {loop_rate_hz() * 1e-6:.2f} M loops/s"
    else:
        name = model or _entry(root / "proc/cpuinfo", "model name", "Hardware") or system.machine
    memory = _entry(root / "proc/meminfo", "MemTotal").split()
    return Machine(
        kind=REAL if model and not emulated else VIRTUAL,
        name=name,
        kernel=f"{kernel} PREEMPT_RT" if preempt_rt else kernel,
        preempt_rt=preempt_rt,
        processors=usable_processors(),
        memory_mib=int(memory[0]) // 1024 if memory and memory[0].isdigit() else 0,
    )


def usable_processors() -> int:
    """Number of processors that this process may use. Only Linux limits them by process; elsewhere, all of them."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class HealthMonitor:
    """Reads the health of the machine. A reading costs some reads of small files."""

    def __init__(self, root: Path = Path("/")) -> None:
        self._thermal = _thermal_zone(root)
        self._last_s = time.monotonic()
        self._last_cpu_s = time.process_time()
        self._percent: float | None = None

    def read(self) -> MachineHealth:
        """Read the present health."""
        now_s, cpu_s = time.monotonic(), time.process_time()
        elapsed_s = now_s - self._last_s
        if self._percent is None or elapsed_s >= SHORTEST_S:
            self._percent = 100.0 * (cpu_s - self._last_cpu_s) / elapsed_s if elapsed_s > 0.0 else 0.0
            self._last_s, self._last_cpu_s = now_s, cpu_s
        try:
            load = os.getloadavg()[0]
        except (AttributeError, OSError):  # Windows has no such figure
            load = -1.0
        return MachineHealth(self._percent, load, _degrees(self._thermal), resident_kib())


def resident_kib() -> int:
    """Resident memory of this process, 0 if unknown."""
    try:
        return int(_text(Path("/proc/self/statm")).split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024
    except (AttributeError, OSError, ValueError, IndexError):
        return 0


def loop_rate_hz() -> float:
    """Passes per second of a fixed Python loop, the best of several tries of some milliseconds."""
    shortest_s = inf
    for _ in range(LOOP_TRIES):
        begun_s = time.perf_counter()
        total, angle = 0, 0.0
        for number in range(LOOP_PASSES):
            total = (total + number * number) & 0xFFFF
            angle += 0.001 * total
            if angle > 180.0:
                angle -= 360.0
        shortest_s = min(shortest_s, time.perf_counter() - begun_s)
    return LOOP_PASSES / shortest_s


def _text(path: Path) -> str:
    """Return the content of a small file, empty when it cannot be read."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123  pathlib costs a slow board more than it gives here
            return file.read(65536).decode("utf-8", "replace")
    except OSError:
        return ""


def _entry(path: Path, *keys: str) -> str:
    """Return the value of the first `key: value` line with one of these keys, empty for none."""
    for line in _text(path).splitlines():
        key, _, value = line.partition(":")
        if key.strip() in keys:
            return value.strip()
    return ""


def _thermal_zone(root: Path) -> Path | None:
    """Temperature file of the processor's zone by its name, or else of the first readable zone."""
    readable = []
    for zone in sorted((root / "sys/class/thermal").glob("thermal_zone*")):
        if _degrees(zone / "temp") is None:
            continue
        if any(word in _text(zone / "type").lower() for word in _CPU_SENSORS):
            return zone / "temp"
        readable.append(zone / "temp")
    return readable[0] if readable else None


def _degrees(path: Path | None) -> float | None:
    if path is None:
        return None
    try:
        millidegrees = int(_text(path))
    except ValueError:
        return None
    return millidegrees * 1e-3 if -100_000 < millidegrees < 300_000 else None
