"""What `doctor` looks at: files under /proc, /sys and /dev, whose root is an argument, and nothing that it changes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from agent.board.findings import OK, PROBLEM, WARNING, Finding

CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23
LEAST_MEMORY_MIB, GOOD_MEMORY_MIB = 40, 96
LEAST_DISK_MIB, GOOD_DISK_MIB = 20, 200
GOOD_BUFFER_BYTES = 212_992
GOOD_RESOLUTION_S = 1e-6
HOT_DEGC = 80.0
_SERIAL = ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyO*", "ttyTHS*", "ttymxc*", "ttySTM*")
_SLOW_CLOCKS = ("jiffies", "refined-jiffies", "acpi_pm", "hpet", "pit")
_ARPHRD_CAN = 280
_IFF_UP = 1


def read(path: Path) -> str:
    """What is in a small file, empty when it cannot be read."""
    try:
        return path.read_text(errors="replace").strip("\0 \n")
    except OSError:
        return ""


def kernel(root: Path, release: str, version: str) -> Finding:
    """release, version: as `os.uname()` tells them."""
    if read(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return Finding("kernel", OK, f"{release}, PREEMPT_RT")
    return Finding(
        "kernel",
        WARNING,
        f"{release}, not PREEMPT_RT",
        "deadlines of a few ms are missed now and then; for better ones install a PREEMPT_RT kernel (linux-image-rt-…)",
    )


def real_time(root: Path) -> Finding:
    """Whether SCHED_FIFO is permitted to this process."""
    limit = _limit(root, "Max realtime priority")
    capable = _capable(root, CAP_SYS_NICE)
    budget = read(root / "proc/sys/kernel/sched_rt_runtime_us")
    if budget == "0":
        return Finding(
            "real time",
            WARNING,
            "real-time tasks get no time at all (kernel.sched_rt_runtime_us = 0)",
            "sysctl -w kernel.sched_rt_runtime_us=950000",
        )
    if capable or (limit is not None and limit > 0):
        return Finding("real time", OK, "SCHED_FIFO permitted" + ("" if capable else f" up to priority {limit:.0f}"))
    return Finding(
        "real time",
        WARNING,
        "SCHED_FIFO not permitted to this user",
        "run the agent as a service of the system (xitl agent deploy root@… --service), or add to "
        "/etc/security/limits.conf: <user> - rtprio 99",
    )


def memory_lock(root: Path) -> Finding:
    """Whether all memory may be locked."""
    limit = _limit(root, "Max locked memory")
    if _capable(root, CAP_IPC_LOCK) or limit == float("inf"):
        return Finding("memory lock", OK, "memory can be locked")
    found = "unknown" if limit is None else f"{limit / 1024:.0f} KiB"
    return Finding(
        "memory lock",
        WARNING,
        f"memory cannot be locked (limit {found})",
        "run the agent as a service of the system, or add to /etc/security/limits.conf: <user> - memlock unlimited",
    )


def governor(root: Path) -> Finding:
    """How the processors' clock is governed."""
    found = {read(path) for path in (root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")} - {""}
    if not found:
        return Finding("CPU clock", OK, "not governed by this system")
    if found == {"performance"}:
        return Finding("CPU clock", OK, "governor performance")
    return Finding(
        "CPU clock",
        WARNING,
        f"governor {', '.join(sorted(found))}: the clock changes with the load, and the jitter with it",
        "for path in /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor; do echo performance | sudo tee $path; done",
    )


def processors(count: int) -> Finding:
    if count > 1:
        return Finding("processors", OK, f"{count}")
    return Finding("processors", OK, "1: whatever else runs takes time from the agent")


def memory(root: Path) -> Finding:
    amounts = {}
    for line in read(root / "proc/meminfo").splitlines():
        name, _, value = line.partition(":")
        amounts[name] = value.split()
    try:
        total_mib, free_mib = (int(amounts[name][0]) // 1024 for name in ("MemTotal", "MemAvailable"))
    except (KeyError, IndexError, ValueError):
        return Finding("memory", WARNING, "unknown: /proc/meminfo cannot be read", "mount /proc")
    found = f"{free_mib} MiB of {total_mib} MiB available"
    if free_mib < GOOD_MEMORY_MIB:
        level = PROBLEM if free_mib < LEAST_MEMORY_MIB else WARNING
        return Finding("memory", level, found, "the agent takes about 30 MiB; stop services that are not needed")
    return Finding("memory", OK, found)


def disk(place: str, free_bytes: int) -> Finding:
    free_mib = free_bytes // (1 << 20)
    found = f"{free_mib} MiB free at {place}"
    if free_mib < GOOD_DISK_MIB:
        level = PROBLEM if free_mib < LEAST_DISK_MIB else WARNING
        return Finding("disk", level, found, "make room: a log takes about 1 MiB a minute")
    return Finding("disk", OK, found)


def clock(root: Path, resolution_s: float) -> Finding:
    """The clock that deadlines are kept with. resolution_s: of CLOCK_MONOTONIC."""
    source = read(root / "sys/devices/system/clocksource/clocksource0/current_clocksource") or "unknown source"
    found = f"{source}, resolution {resolution_s * 1e9:.0f} ns"
    if resolution_s > GOOD_RESOLUTION_S:
        return Finding("clock", PROBLEM, found, "too coarse for deadlines; use a kernel with CONFIG_HIGH_RES_TIMERS")
    if source in _SLOW_CLOCKS:
        there = read(root / "sys/devices/system/clocksource/clocksource0/available_clocksource")
        return Finding(
            "clock", WARNING, found, f"slow to read; choose a faster one at boot (clocksource=, there: {there})"
        )
    return Finding("clock", OK, found)


def date(root: Path, year: int, released: int) -> Finding:
    """Only files and log dates depend on it: the agent keeps time by the monotonic clock. released: a past year."""
    advice = "dates in logs will be wrong, nothing else; to set it: timedatectl set-ntp true"
    if year < released:
        return Finding("date", WARNING, f"this machine believes it is {year}", advice)
    if (root / "run/systemd/timesync/synchronized").exists() or any((root / "run").glob("chrony/*.pid")):
        return Finding("date", OK, "set by NTP")
    return Finding("date", OK, f"{year}, by its own clock (no systemd-timesyncd or chrony)")


def python(version: tuple[int, ...], needed: tuple[int, int], bits: int) -> Finding:
    found = f"{'.'.join(map(str, version[:3]))}, {bits} bits"
    if version[:2] < needed:
        wanted = ".".join(map(str, needed))
        return Finding("Python", PROBLEM, found, f"install Python {wanted} or newer")
    return Finding("Python", OK, found)


def sockets(root: Path) -> Finding:
    text = read(root / "proc/sys/net/core/rmem_max")
    if not text.isdigit():
        return Finding("sockets", OK, "receive buffer not told by this system")
    if int(text) < GOOD_BUFFER_BYTES:
        advice = f"messages may be lost while the machine is busy; sysctl -w net.core.rmem_max={GOOD_BUFFER_BYTES}"
        return Finding("sockets", WARNING, f"receive buffers of at most {int(text)} bytes", advice)
    return Finding("sockets", OK, f"receive buffers up to {int(text) // 1024} KiB")


def temperature(root: Path) -> Finding:
    found = []
    for path in (root / "sys/class/thermal").glob("thermal_zone*/temp"):
        try:
            found.append(int(read(path)) * 1e-3)
        except ValueError:
            continue
    if not found:
        return Finding("temperature", OK, "no sensor")
    hottest = max(found)
    if hottest > HOT_DEGC:
        return Finding("temperature", WARNING, f"{hottest:.0f} °C", "cool the board: a hot one slows its clock down")
    return Finding("temperature", OK, f"{hottest:.0f} °C")


def serial_devices(root: Path) -> Iterator[Finding]:
    """One finding a device; one that says so when there is none."""
    console = [
        word[8:].partition(",")[0] for word in read(root / "proc/cmdline").split() if word.startswith("console=")
    ]
    devices = sorted(path for pattern in _SERIAL for path in (root / "dev").glob(pattern))
    if not devices:
        yield Finding("serial", OK, "no USB or on-board serial device")
    for path in devices:
        name = f"/dev/{path.name}"
        if path.name in console:
            yield Finding("serial", WARNING, f"{name} is the kernel's console", "take another one, or console= off it")
        elif not os.access(path, os.R_OK | os.W_OK):
            advice = "sudo usermod -aG dialout $USER, then log in again"
            yield Finding("serial", WARNING, f"{name} may not be opened by this user", advice)
        else:
            yield Finding("serial", OK, name)


def usb_ethernet(root: Path) -> Finding:
    found = []
    for path in sorted((root / "sys/class/net").glob("*")):
        driver = _link_name(path / "device/driver")
        on_usb = "/usb" in os.path.realpath(path / "device") or "gadget" in os.path.realpath(path / "device")
        if on_usb or path.name.startswith("usb") or driver in ("cdc_ether", "cdc_ncm", "rndis_host", "g_ether"):
            found.append((path.name, read(path / "operstate") or "unknown"))
    if not found:
        return Finding("USB-Ethernet", OK, "no interface (matters only for a link over USB)")
    said = ", ".join(f"{name} {state}" for name, state in found)
    if any(state in ("up", "unknown") for _, state in found):
        return Finding("USB-Ethernet", OK, said)
    return Finding("USB-Ethernet", WARNING, said, f"check the cable; sudo ip link set {found[0][0]} up")


def can_interfaces(root: Path) -> Iterator[Finding]:
    """One finding an interface; one that says so when there is none."""
    there = [path for path in (root / "sys/class/net").glob("*") if read(path / "type") == str(_ARPHRD_CAN)]
    if not there:
        yield Finding("CAN", OK, "no SocketCAN interface (matters only for can://socketcan links)")
    for path in sorted(there):
        try:
            up = bool(int(read(path / "flags"), 16) & _IFF_UP)
        except ValueError:
            up = False
        if up:
            yield Finding("CAN", OK, f"{path.name} is up")
        else:
            advice = f"sudo ip link set {path.name} up type can bitrate 1000000"
            yield Finding("CAN", WARNING, f"{path.name} is down", advice)


def _link_name(path: Path) -> str:
    try:
        return path.readlink().name
    except OSError:
        return ""


def _limit(root: Path, name: str) -> float | None:
    """The soft limit of this process."""
    for line in read(root / "proc/self/limits").splitlines():
        if line.startswith(name):
            value = line[len(name) :].split()[0]
            if value == "unlimited":
                return float("inf")
            return float(value) if value.isdigit() else None
    return None


def _capable(root: Path, capability: int) -> bool:
    for line in read(root / "proc/self/status").splitlines():
        if line.startswith("CapEff:"):
            try:
                return bool(int(line.split()[1], 16) >> capability & 1)
            except (IndexError, ValueError):
                return False
    return False
