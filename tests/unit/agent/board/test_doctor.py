"""What the doctor makes of a machine, from files that say how one is."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.board import doctor
from agent.board.doctor import (
    OK,
    PROBLEM,
    WARNING,
    DoctorFinding,
    exit_code,
    findings_from_objects,
    findings_text,
    findings_to_objects,
)

LIMITS = """\
Limit                     Soft Limit           Hard Limit           Units
Max locked memory         {locked:<20} {locked:<20} bytes
Max realtime priority     {priority:<20} {priority:<20}
"""


def machine(root: Path, files: dict[str, str]) -> Path:
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return root


def permitted(root: Path, locked: str, priority: str, capabilities: str) -> Path:
    limits = LIMITS.format(locked=locked, priority=priority)
    return machine(root, {"proc/self/limits": limits, "proc/self/status": f"Name:\tx\nCapEff:\t{capabilities}\n"})


@pytest.mark.parametrize(
    ("files", "version", "level"),
    [
        ({"sys/kernel/realtime": "1\n"}, "#1 SMP PREEMPT", OK),
        ({}, "#1 SMP PREEMPT_RT Debian 6.1.0", OK),
        ({"sys/kernel/realtime": "0\n"}, "#1 SMP PREEMPT_DYNAMIC", WARNING),
        ({}, "#1 SMP", WARNING),
    ],
)
def test_kernel(tmp_path: Path, files: dict[str, str], version: str, level: str) -> None:
    found = doctor.check_kernel(machine(tmp_path, files), "6.1.0", version)
    assert found.level == level
    assert bool(found.advice) == (level != OK)


@pytest.mark.parametrize(
    ("locked", "priority", "capabilities", "real_time", "memory"),
    [
        ("8388608", "0", "0000000000000000", WARNING, WARNING),
        ("unlimited", "0", "0000000000000000", WARNING, OK),
        ("8388608", "99", "0000000000000000", OK, WARNING),
        ("8388608", "0", "0000000000800000", OK, WARNING),  # CAP_SYS_NICE alone
        ("8388608", "0", "0000000000004000", WARNING, OK),  # CAP_IPC_LOCK alone
        ("8388608", "0", "000001ffffffffff", OK, OK),
    ],
)
def test_permissions(
    tmp_path: Path, locked: str, priority: str, capabilities: str, real_time: str, memory: str
) -> None:
    root = permitted(tmp_path, locked, priority, capabilities)
    assert doctor.check_real_time(root).level == real_time
    assert doctor.check_memory_lock(root).level == memory


def test_real_time_tasks_that_get_no_time(tmp_path: Path) -> None:
    root = permitted(tmp_path, "unlimited", "99", "0")
    machine(root, {"proc/sys/kernel/sched_rt_runtime_us": "0\n"})
    found = doctor.check_real_time(root)
    assert found.level == WARNING
    assert "sched_rt_runtime_us" in found.advice


@pytest.mark.parametrize(
    ("governors", "level", "said"),
    [
        ([], OK, "not governed"),
        (["performance", "performance"], OK, "performance"),
        (["performance", "ondemand"], WARNING, "ondemand, performance"),
    ],
)
def test_governor(tmp_path: Path, governors: list[str], level: str, said: str) -> None:
    place = "sys/devices/system/cpu/cpu{}/cpufreq/scaling_governor"
    root = machine(tmp_path, {place.format(number): f"{name}\n" for number, name in enumerate(governors)})
    found = doctor.check_governor(root)
    assert found.level == level
    assert said in found.found


@pytest.mark.parametrize(("free_mib", "level"), [(400, OK), (60, WARNING), (20, PROBLEM)])
def test_memory(tmp_path: Path, free_mib: int, level: str) -> None:
    text = f"MemTotal:  {500 * 1024} kB\nMemFree: 1 kB\nMemAvailable:   {free_mib * 1024} kB\n"
    found = doctor.check_memory(machine(tmp_path, {"proc/meminfo": text}))
    assert found.level == level
    assert f"{free_mib} MiB of 500 MiB" in found.found


def test_memory_that_cannot_be_told(tmp_path: Path) -> None:
    assert doctor.check_memory(tmp_path).level == WARNING


@pytest.mark.parametrize(("free_mib", "level"), [(4000, OK), (100, WARNING), (5, PROBLEM)])
def test_disk(free_mib: int, level: str) -> None:
    assert doctor.check_disk("/home", free_mib << 20).level == level


@pytest.mark.parametrize(
    ("source", "resolution_s", "level"),
    [("tsc", 1e-9, OK), ("arch_sys_counter", 1e-9, OK), ("jiffies", 1e-9, WARNING), ("tsc", 4e-3, PROBLEM)],
)
def test_clock(tmp_path: Path, source: str, resolution_s: float, level: str) -> None:
    place = "sys/devices/system/clocksource/clocksource0/"
    root = machine(
        tmp_path, {f"{place}current_clocksource": f"{source}\n", f"{place}available_clocksource": "tsc hpet\n"}
    )
    assert doctor.check_clock(root, resolution_s).level == level


def test_date(tmp_path: Path) -> None:
    assert doctor.check_date(tmp_path, 1970, 2024).level == WARNING
    assert doctor.check_date(tmp_path, 2026, 2024).level == OK
    synchronised = doctor.check_date(machine(tmp_path, {"run/systemd/timesync/synchronized": ""}), 2026, 2024)
    assert synchronised.found == "set by NTP"


@pytest.mark.parametrize(
    ("version", "level"), [((3, 8, 10), PROBLEM), ((3, 9, 2), OK), ((3, 13, 0), OK), ((4, 0, 0), OK)]
)
def test_python(version: tuple[int, ...], level: str) -> None:
    assert doctor.check_python(version, (3, 9), 32).level == level


@pytest.mark.parametrize(("size", "level"), [("212992\n", OK), ("8192\n", WARNING), ("", OK)])
def test_sockets(tmp_path: Path, size: str, level: str) -> None:
    assert doctor.check_sockets(machine(tmp_path, {"proc/sys/net/core/rmem_max": size})).level == level


@pytest.mark.parametrize(("millidegrees", "level"), [(["45000\n"], OK), (["45000\n", "91000\n"], WARNING), ([], OK)])
def test_temperature(tmp_path: Path, millidegrees: list[str], level: str) -> None:
    place = "sys/class/thermal/thermal_zone{}/temp"
    root = machine(tmp_path, {place.format(number): value for number, value in enumerate(millidegrees)})
    assert doctor.check_temperature(root).level == level


def test_serial_devices(tmp_path: Path) -> None:
    root = machine(
        tmp_path, {"dev/ttyUSB0": "", "dev/ttyO0": "", "dev/ttyS0": "", "proc/cmdline": "console=ttyO0,115200"}
    )
    found = list(doctor.check_serial_devices(root))
    assert [(one.found, one.level) for one in found] == [
        ("/dev/ttyO0 is the kernel's console", WARNING),
        ("/dev/ttyUSB0", OK),
    ]
    assert [one.level for one in doctor.check_serial_devices(tmp_path / "empty")] == [OK]


def test_a_serial_device_of_another_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.board.doctor.os.access", lambda path, mode: False)  # root may open everything
    (found,) = doctor.check_serial_devices(machine(tmp_path, {"dev/ttyACM0": ""}))
    assert found.level == WARNING
    assert "dialout" in found.advice


def test_network_interfaces(tmp_path: Path) -> None:
    net = "sys/class/net"
    assert doctor.check_usb_ethernet(tmp_path).level == OK
    assert [one.level for one in doctor.check_can_interfaces(tmp_path)] == [OK]
    root = machine(
        tmp_path,
        {
            f"{net}/eth0/operstate": "up\n",
            f"{net}/usb0/operstate": "down\n",
            f"{net}/can0/type": "280\n",
            f"{net}/can0/flags": "0x40080\n",
            f"{net}/can1/type": "280\n",
            f"{net}/can1/flags": "0x40081\n",
            f"{net}/eth0/type": "1\n",
        },
    )
    usb = doctor.check_usb_ethernet(root)
    assert (usb.level, usb.found) == (WARNING, "usb0 down")
    assert [(one.level, one.found) for one in doctor.check_can_interfaces(root)] == [
        (WARNING, "can0 is down"),
        (OK, "can1 is up"),
    ]


def test_findings_for_people_and_programs() -> None:
    findings = [
        DoctorFinding("a", OK, "fine"),
        DoctorFinding("b", WARNING, "so so", "do this"),
        DoctorFinding("c", PROBLEM, "bad", "fix"),
    ]
    assert [exit_code(findings[:count]) for count in (0, 1, 2, 3)] == [0, 0, 0, 1]
    assert len(findings_text(findings).splitlines()) == 5
    assert findings_from_objects(findings_to_objects(findings)) == findings
    for broken in (None, [1], [{"check": "a"}], [{"check": "a", "level": "fatal", "found": ""}]):
        with pytest.raises(ValueError, match="not findings"):
            findings_from_objects(broken)
