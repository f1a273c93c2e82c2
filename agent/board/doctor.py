"""`xitl-agent.pyz doctor`: check whether this machine can run the agent, and advise how to correct problems.

The checks read files under /proc, /sys and /dev and change nothing. The root of these paths is an argument.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import struct
import sys
import time
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from agent.board.receive import MARK, OLDEST
from agent.machine import loop_rate_hz
from agent.wire.transport import AddressInUseError, TransportError, open_transport

OK, WARNING, PROBLEM = "ok", "warning", "problem"
_COLOURS = {OK: "32", WARNING: "33", PROBLEM: "1;31"}


class DoctorFinding(NamedTuple):
    """Result of one check."""

    check: str
    level: str
    """ok, warning (works with limits) or problem (does not work)."""
    found: str
    advice: str = ""
    """Empty when no action is needed."""


def exit_code(findings: Iterable[DoctorFinding]) -> int:
    return 1 if any(finding.level == PROBLEM for finding in findings) else 0


def findings_text(findings: Iterable[DoctorFinding], colour: bool = False) -> str:
    """Return one line per finding. Advice follows on a second line."""
    lines = []
    for finding in findings:
        level = finding.level.ljust(len(PROBLEM))
        if colour:
            level = f"\033[{_COLOURS[finding.level]}m{level}\033[0m"
        lines.append(f"{level}  {finding.check:<14}  {finding.found}")
        if finding.advice:
            lines.append(f"{'':25}→ {finding.advice}")
    return "\n".join(lines)


def findings_to_objects(findings: Iterable[DoctorFinding]) -> list[dict[str, str]]:
    return [finding._asdict() for finding in findings]


def findings_to_json(findings: Iterable[DoctorFinding]) -> str:
    return json.dumps(findings_to_objects(findings), indent=2, ensure_ascii=False)


def findings_from_objects(objects: Any) -> list[DoctorFinding]:
    """Return the findings that `findings_to_objects` wrote. Raises ValueError for any other content."""
    try:
        findings = [DoctorFinding(**{key: str(value) for key, value in entry.items()}) for entry in objects]
    except (AttributeError, TypeError):
        raise ValueError("not findings of a doctor") from None
    if any(finding.level not in _COLOURS for finding in findings):
        raise ValueError("not findings of a doctor")
    return findings


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
    """Return the content of a small file, empty when it cannot be read."""
    try:
        return path.read_text(errors="replace").strip("\0 \n")
    except OSError:
        return ""


def check_kernel(root: Path, release: str, version: str) -> DoctorFinding:
    """Check for a real-time kernel. release, version: as in `os.uname()`."""
    if read(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return DoctorFinding("kernel", OK, f"{release}, PREEMPT_RT")
    return DoctorFinding(
        "kernel",
        WARNING,
        f"{release}, not PREEMPT_RT",
        "deadlines of a few ms are sometimes missed; to avoid this, install a PREEMPT_RT kernel (linux-image-rt-…)",
    )


def check_real_time(root: Path) -> DoctorFinding:
    """Check whether this process may use SCHED_FIFO."""
    limit = _limit(root, "Max realtime priority")
    capable = _capable(root, CAP_SYS_NICE)
    budget = read(root / "proc/sys/kernel/sched_rt_runtime_us")
    if budget == "0":
        return DoctorFinding(
            "real time",
            WARNING,
            "real-time tasks get no time at all (kernel.sched_rt_runtime_us = 0)",
            "sysctl -w kernel.sched_rt_runtime_us=950000",
        )
    if capable or (limit is not None and limit > 0):
        return DoctorFinding(
            "real time", OK, "SCHED_FIFO permitted" + ("" if capable else f" up to priority {limit:.0f}")
        )
    return DoctorFinding(
        "real time",
        WARNING,
        "SCHED_FIFO not permitted to this user",
        "run the agent as a system service (xitl agent deploy root@… --service), or add to "
        "/etc/security/limits.conf: <user> - rtprio 99",
    )


def check_memory_lock(root: Path) -> DoctorFinding:
    """Check whether this process may lock all of its memory."""
    limit = _limit(root, "Max locked memory")
    if _capable(root, CAP_IPC_LOCK) or limit == float("inf"):
        return DoctorFinding("memory lock", OK, "memory can be locked")
    shown = "unknown" if limit is None else f"{limit / 1024:.0f} KiB"
    return DoctorFinding(
        "memory lock",
        WARNING,
        f"memory cannot be locked (limit {shown})",
        "run the agent as a system service, or add to /etc/security/limits.conf: <user> - memlock unlimited",
    )


def check_governor(root: Path) -> DoctorFinding:
    """Check the frequency governor of the processors."""
    paths = (root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    governors = {read(path) for path in paths} - {""}
    if not governors:
        return DoctorFinding("CPU clock", OK, "not governed by this system")
    if governors == {"performance"}:
        return DoctorFinding("CPU clock", OK, "governor performance")
    return DoctorFinding(
        "CPU clock",
        WARNING,
        f"governor {', '.join(sorted(governors))}: the CPU clock and the jitter change with the load",
        "for path in /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor; do echo performance | sudo tee $path; done",
    )


def check_processors(count: int) -> DoctorFinding:
    if count > 1:
        return DoctorFinding("processors", OK, f"{count}")
    return DoctorFinding("processors", OK, "1: other programs take time from the agent")


def check_speed(rate_hz: float) -> DoctorFinding:
    """Report the speed, to compare boards. rate_hz: rate of the fixed loop in `agent.machine`."""
    return DoctorFinding("speed", OK, f"{rate_hz * 1e-6:.2f} million passes of a fixed Python loop per second")


def check_memory(root: Path) -> DoctorFinding:
    amounts = {}
    for line in read(root / "proc/meminfo").splitlines():
        name, _, value = line.partition(":")
        amounts[name] = value.split()
    try:
        total_mib, free_mib = (int(amounts[name][0]) // 1024 for name in ("MemTotal", "MemAvailable"))
    except (KeyError, IndexError, ValueError):
        return DoctorFinding("memory", WARNING, "unknown: /proc/meminfo cannot be read", "mount /proc")
    found = f"{free_mib} MiB of {total_mib} MiB available"
    if free_mib >= GOOD_MEMORY_MIB:
        return DoctorFinding("memory", OK, found)
    level = WARNING if free_mib >= LEAST_MEMORY_MIB else PROBLEM
    return DoctorFinding("memory", level, found, "the agent needs about 30 MiB; stop services that are not needed")


def check_disk(place: str, free_bytes: int) -> DoctorFinding:
    free_mib = free_bytes // (1 << 20)
    found = f"{free_mib} MiB free at {place}"
    if free_mib >= GOOD_DISK_MIB:
        return DoctorFinding("disk", OK, found)
    level = WARNING if free_mib >= LEAST_DISK_MIB else PROBLEM
    return DoctorFinding("disk", level, found, "free some space: a log takes about 1 MiB per minute")


def check_clock(root: Path, resolution_s: float) -> DoctorFinding:
    """Check the clock that times the deadlines. resolution_s: resolution of CLOCK_MONOTONIC."""
    source = read(root / "sys/devices/system/clocksource/clocksource0/current_clocksource") or "unknown source"
    found = f"{source}, resolution {resolution_s * 1e9:.0f} ns"
    if resolution_s > GOOD_RESOLUTION_S:
        return DoctorFinding(
            "clock", PROBLEM, found, "too coarse for deadlines; use a kernel with CONFIG_HIGH_RES_TIMERS"
        )
    if source in _SLOW_CLOCKS:
        available = read(root / "sys/devices/system/clocksource/clocksource0/available_clocksource")
        advice = f"slow to read; choose a faster clock source at boot (clocksource=…, available: {available})"
        return DoctorFinding("clock", WARNING, found, advice)
    return DoctorFinding("clock", OK, found)


def check_date(root: Path, year: int, released: int) -> DoctorFinding:
    """Check the date.

    released: a year that is certainly past.

    Only file dates and log dates depend on it. The agent keeps time by the monotonic clock.
    """
    advice = "only the dates in logs will be wrong; to set the date: timedatectl set-ntp true"
    if year < released:
        return DoctorFinding("date", WARNING, f"the year of this machine is {year}", advice)
    if (root / "run/systemd/timesync/synchronized").exists() or any((root / "run").glob("chrony/*.pid")):
        return DoctorFinding("date", OK, "set by NTP")
    return DoctorFinding("date", OK, f"{year}, not synchronised (no systemd-timesyncd or chrony)")


def check_python(version: tuple[int, ...], needed: tuple[int, int], bits: int) -> DoctorFinding:
    found = f"{'.'.join(map(str, version[:3]))}, {bits} bits"
    if version[:2] < needed:
        wanted = ".".join(map(str, needed))
        return DoctorFinding("Python", PROBLEM, found, f"install Python {wanted} or newer")
    return DoctorFinding("Python", OK, found)


def check_sockets(root: Path) -> DoctorFinding:
    text = read(root / "proc/sys/net/core/rmem_max")
    if not text.isdigit():
        return DoctorFinding("sockets", OK, "this system does not report its receive buffer")
    if int(text) < GOOD_BUFFER_BYTES:
        advice = f"messages may be lost while the machine is busy; sysctl -w net.core.rmem_max={GOOD_BUFFER_BYTES}"
        return DoctorFinding("sockets", WARNING, f"receive buffers of at most {int(text)} bytes", advice)
    return DoctorFinding("sockets", OK, f"receive buffers up to {int(text) // 1024} KiB")


def check_temperature(root: Path) -> DoctorFinding:
    temperatures_degc = []
    for path in (root / "sys/class/thermal").glob("thermal_zone*/temp"):
        try:
            temperatures_degc.append(int(read(path)) * 1e-3)
        except ValueError:
            continue
    if not temperatures_degc:
        return DoctorFinding("temperature", OK, "no sensor")
    hottest_degc = max(temperatures_degc)
    found = f"{hottest_degc:.0f} °C"
    if hottest_degc > HOT_DEGC:
        return DoctorFinding("temperature", WARNING, found, "cool the board: a hot board reduces its CPU clock")
    return DoctorFinding("temperature", OK, found)


def check_serial_devices(root: Path) -> Iterator[DoctorFinding]:
    """Yield one finding per serial device, or one finding that reports none."""
    console = [
        word[8:].partition(",")[0] for word in read(root / "proc/cmdline").split() if word.startswith("console=")
    ]
    devices = sorted(path for pattern in _SERIAL for path in (root / "dev").glob(pattern))
    if not devices:
        yield DoctorFinding("serial", OK, "no USB or on-board serial device")
    for path in devices:
        name = f"/dev/{path.name}"
        if path.name in console:
            advice = "use another device, or remove console= for this one from the kernel command line"
            yield DoctorFinding("serial", WARNING, f"{name} is the kernel's console", advice)
        elif not os.access(path, os.R_OK | os.W_OK):
            advice = "sudo usermod -aG dialout $USER, then log in again"
            yield DoctorFinding("serial", WARNING, f"this user may not open {name}", advice)
        else:
            yield DoctorFinding("serial", OK, name)


def check_usb_ethernet(root: Path) -> DoctorFinding:
    interfaces = []
    for path in sorted((root / "sys/class/net").glob("*")):
        try:
            driver = (path / "device/driver").readlink().name
        except OSError:
            driver = ""
        on_usb = "/usb" in os.path.realpath(path / "device") or "gadget" in os.path.realpath(path / "device")
        if on_usb or path.name.startswith("usb") or driver in ("cdc_ether", "cdc_ncm", "rndis_host", "g_ether"):
            interfaces.append((path.name, read(path / "operstate") or "unknown"))
    if not interfaces:
        return DoctorFinding("USB-Ethernet", OK, "no interface (matters only for a link over USB)")
    found = ", ".join(f"{name} {state}" for name, state in interfaces)
    if any(state in ("up", "unknown") for _, state in interfaces):
        return DoctorFinding("USB-Ethernet", OK, found)
    return DoctorFinding("USB-Ethernet", WARNING, found, f"check the cable; sudo ip link set {interfaces[0][0]} up")


def check_can_interfaces(root: Path) -> Iterator[DoctorFinding]:
    """Yield one finding per CAN interface, or one finding that reports none."""
    paths = [path for path in (root / "sys/class/net").glob("*") if read(path / "type") == str(_ARPHRD_CAN)]
    if not paths:
        yield DoctorFinding("CAN", OK, "no SocketCAN interface (matters only for can://socketcan links)")
    for path in sorted(paths):
        try:
            up = bool(int(read(path / "flags"), 16) & _IFF_UP)
        except ValueError:
            up = False
        if up:
            yield DoctorFinding("CAN", OK, f"{path.name} is up")
        else:
            advice = f"sudo ip link set {path.name} up type can bitrate 1000000"
            yield DoctorFinding("CAN", WARNING, f"{path.name} is down", advice)


def _limit(root: Path, name: str) -> float | None:
    """Return the soft limit of this process."""
    for line in read(root / "proc/self/limits").splitlines():
        if line.startswith(name):
            value = line[len(name) :].split()[0]
            if value == "unlimited":
                return float("inf")
            return float(value) if value.isdigit() else None
    return None


def _capable(root: Path, capability: int) -> bool:
    """Whether this process has a capability."""
    for line in read(root / "proc/self/status").splitlines():
        if line.startswith("CapEff:"):
            try:
                return bool(int(line.split()[1], 16) >> capability & 1)
            except (IndexError, ValueError):
                return False
    return False


DEFAULT_LINK = "udp://127.0.0.1:14660"
RELEASED = 2024
_PACKAGES = {"serial": "pyserial", "can": "python-can"}


def main(arguments: list[str], program: str) -> int:
    """Print the findings. Return 1 when something will not work."""
    parser = argparse.ArgumentParser(prog=program, description="Check whether this machine can run the agent.")
    parser.add_argument("--link", metavar="URL", help="also open this link: its port, device or interface")
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
    parser.add_argument("--latency", action="store_true", help="measure the real-time latency of this machine instead")
    parser.add_argument(
        "--rate", type=float, action="append", metavar="HZ", help="latency: rate of the task, repeatable (default: 400)"
    )
    parser.add_argument(
        "--duration", type=float, default=10.0, metavar="S", help="latency: time of each measured loop (default: 10)"
    )
    parser.add_argument("--load", action="store_true", help="latency: measure again with busy processors")
    parser.add_argument("--agent", default="", metavar="URL", help="latency: use the agent that waits at this address")
    parser.add_argument("--for-host", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.latency:
        return _measure_latency(options)
    findings = examine(options.link, OLDEST)
    if options.for_host:
        sys.stdout.write(MARK + json.dumps({"findings": findings_to_objects(findings)}) + "\n")
    elif options.json:
        sys.stdout.write(findings_to_json(findings) + "\n")
    else:
        sys.stdout.write(findings_text(findings, sys.stdout.isatty() and "NO_COLOR" not in os.environ) + "\n")
    return exit_code(findings)


def _measure_latency(options: argparse.Namespace) -> int:
    """Measure and print. Return 1 when a rate is not held, and 2 when the measurement is not possible."""
    from agent.board.latency import LatencyError, LatencyPlan, holds_all, measure, report_text

    try:
        plan = LatencyPlan(tuple(options.rate or (400.0,)), options.duration, options.load, options.agent)
        report = measure(plan)
    except LatencyError as error:
        if options.for_host:
            sys.stdout.write(MARK + json.dumps({"error": str(error)}) + "\n")
        sys.stderr.write(f"error: {error}\n")
        return 2
    if options.for_host:
        sys.stdout.write(MARK + json.dumps({"latency": report}) + "\n")
    else:
        sys.stdout.write((json.dumps(report, indent=2) if options.json else report_text(report)) + "\n")
    return 0 if holds_all(report) else 1


def examine(link_url: str | None, needed: tuple[int, int], root: Path = Path("/")) -> list[DoctorFinding]:
    """Return the findings of all checks.

    needed: oldest usable Python version.
    root: directory that contains /proc, /sys and /dev.
    """
    system = platform.uname()
    place = Path.cwd()
    return [
        check_python(sys.version_info[:3], needed, 8 * struct.calcsize("P")),
        *check_packages(link_url),
        check_kernel(root, system.release, system.version),
        check_real_time(root),
        check_memory_lock(root),
        check_processors(os.cpu_count() or 1),
        check_speed(loop_rate_hz()),
        check_governor(root),
        check_temperature(root),
        check_memory(root),
        check_disk(str(place), shutil.disk_usage(place).free),
        check_clock(root, time.get_clock_info("monotonic").resolution),
        check_date(root, time.gmtime().tm_year, RELEASED),
        check_sockets(root),
        check_usb_ethernet(root),
        *check_serial_devices(root),
        *check_can_interfaces(root),
        check_link(link_url),
    ]


def check_packages(link_url: str | None) -> list[DoctorFinding]:
    """Check the packages for serial and CAN links. A missing package is a problem only when the link needs it."""
    findings = []
    for module, package in _PACKAGES.items():
        wanted = (link_url or "").startswith(f"{module}:")
        try:
            import_module(module)
        except ImportError:
            level = PROBLEM if wanted else OK
            advice = f"pip install {package}, or use xitl-agent.pyz, which contains it" if wanted else ""
            findings.append(
                DoctorFinding(package, level, f"not installed (matters only for {module}:// links)", advice)
            )
        else:
            findings.append(DoctorFinding(package, OK, "installed"))
    return findings


def check_link(url: str | None) -> DoctorFinding:
    """Open the link briefly, as the agent would, and close it again."""
    link = url or DEFAULT_LINK
    try:
        open_transport(link, listen=True).close()
    except AddressInUseError as error:
        level = WARNING if url is None else PROBLEM
        return DoctorFinding(
            "link", level, f"{error.where}: {error.what}", "if an agent already runs here, nothing is wrong"
        )
    except TransportError as error:
        return DoctorFinding("link", PROBLEM, f"{error.where}: {error.what}", error.fix)
    return DoctorFinding("link", OK, f"{link} can be opened")
