"""What the doctor makes of a machine, from files that say how one is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from agent.board import doctor, latency
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
from agent.wire.transport import AddressInUseError, TransportError

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


def test_the_size_of_socket_buffers_is_told(tmp_path: Path) -> None:
    found = doctor.check_sockets(machine(tmp_path, {"proc/sys/net/core/rmem_max": "212992\n"})).found
    assert found == "receive buffers up to 208 KiB"


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


@pytest.mark.parametrize("missing", [True, False])
@pytest.mark.parametrize(
    ("link", "level"),
    [(None, OK), ("udp://:1", OK), ("serial:///dev/ttyS0", PROBLEM), ("can://socketcan/can0", PROBLEM)],
)
def test_a_package_is_missed_by_a_link_that_needs_it(
    monkeypatch: pytest.MonkeyPatch, missing: bool, link: str | None, level: str
) -> None:
    def load(name: str) -> None:
        if missing:
            raise ImportError(name)

    monkeypatch.setattr(doctor, "import_module", load)
    found = doctor.check_packages(link)
    assert [one.check for one in found] == ["pyserial", "python-can"]
    needed = "pyserial" if link is not None and link.startswith("serial") else "python-can"
    for one in found:
        expected = level if missing and one.check == needed else OK
        assert one.level == expected
        assert bool(one.advice) == (expected == PROBLEM)


class Opened:
    closed = 0

    def close(self) -> None:
        Opened.closed += 1


@pytest.mark.parametrize(
    ("url", "error", "level", "found"),
    [
        (None, None, OK, "udp://127.0.0.1:14660 can be opened"),
        ("udp://:5", None, OK, "udp://:5 can be opened"),
        (None, AddressInUseError("here", "is in use", "stop it"), WARNING, "here: is in use"),
        ("udp://:5", AddressInUseError("here", "is in use", "stop it"), PROBLEM, "here: is in use"),
        ("udp://:5", TransportError("there", "is no address", "write one"), PROBLEM, "there: is no address"),
    ],
)
def test_a_link_is_opened_and_closed_again(
    monkeypatch: pytest.MonkeyPatch, url: str | None, error: TransportError | None, level: str, found: str
) -> None:
    def open_transport(link: str, listen: bool) -> Opened:
        assert listen
        if error is not None:
            raise error
        return Opened()

    monkeypatch.setattr(doctor, "open_transport", open_transport)
    before = Opened.closed
    finding = doctor.check_link(url)
    assert (finding.level, finding.found) == (level, found)
    assert Opened.closed - before == (error is None)
    in_use = isinstance(error, AddressInUseError)
    assert finding.advice == (
        "" if error is None else "if an agent already runs here, nothing is wrong" if in_use else error.fix
    )


FOUND = [DoctorFinding("link", WARNING, "is in use", "stop it"), DoctorFinding("disk", OK, "90 MiB")]


def test_findings_are_printed_for_people_programs_and_the_host(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[object] = []

    def examine(link: str | None, oldest: tuple[int, int]) -> list[DoctorFinding]:
        asked.append((link, oldest))
        return FOUND

    monkeypatch.setattr(doctor, "examine", examine)
    assert doctor.main(["--link", "udp://:5"], "agent doctor") == 0
    assert capsys.readouterr().out == findings_text(FOUND) + "\n"
    assert asked == [("udp://:5", (3, 9))]
    assert doctor.main(["--json"], "agent doctor") == 0
    assert findings_from_objects(json.loads(capsys.readouterr().out)) == FOUND
    assert doctor.main(["--for-host"], "agent doctor") == 0
    mark, _, text = capsys.readouterr().out.partition("{")
    assert mark == doctor.MARK
    assert findings_from_objects(json.loads("{" + text)["findings"]) == FOUND
    monkeypatch.setattr(doctor, "examine", lambda link, oldest: [DoctorFinding("link", PROBLEM, "is gone", "")])
    assert doctor.main([], "agent doctor") == 1


@pytest.mark.parametrize(("holds", "code"), [(True, 0), (False, 1)])
def test_a_measured_latency_is_printed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], holds: bool, code: int
) -> None:
    plans: list[latency.LatencyPlan] = []

    def measure(plan: latency.LatencyPlan) -> dict[str, object]:
        plans.append(plan)
        return {"loops": []}

    monkeypatch.setattr(latency, "measure", measure)
    monkeypatch.setattr(latency, "holds_all", lambda report: holds)
    monkeypatch.setattr(latency, "report_text", lambda report: "in words")
    assert doctor.main(["--latency"], "agent doctor") == code
    assert capsys.readouterr().out == "in words\n"
    arguments = ["--latency", "--rate", "100", "--rate", "50", "--duration", "2", "--load", "--agent", "udp://:1"]
    assert doctor.main([*arguments, "--json"], "agent doctor") == code
    assert json.loads(capsys.readouterr().out) == {"loops": []}
    assert doctor.main(["--latency", "--for-host"], "agent doctor") == code
    assert capsys.readouterr().out == doctor.MARK + '{"latency": {"loops": []}}\n'
    usual = latency.LatencyPlan((400.0,), 10.0, False, "")
    assert plans == [usual, latency.LatencyPlan((100.0, 50.0), 2.0, True, "udp://:1"), usual]


def test_a_latency_that_cannot_be_measured_is_an_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measure(plan: latency.LatencyPlan) -> None:
        raise latency.LatencyError("no agent there")

    monkeypatch.setattr(latency, "measure", measure)
    assert doctor.main(["--latency"], "agent doctor") == 2
    told = capsys.readouterr()
    assert (told.out, told.err) == ("", "error: no agent there\n")
    assert doctor.main(["--latency", "--for-host"], "agent doctor") == 2
    assert capsys.readouterr().out == doctor.MARK + '{"error": "no agent there"}\n'


@pytest.mark.parametrize(("millidegrees", "level"), [(["80000"], OK), (["80001", "20000"], WARNING), (["x", ""], OK)])
def test_the_hottest_sensor_counts(tmp_path: Path, millidegrees: list[str], level: str) -> None:
    files = {f"sys/class/thermal/thermal_zone{number}/temp": text for number, text in enumerate(millidegrees)}
    found = doctor.check_temperature(machine(tmp_path, files))
    assert found.level == level
    assert found.found == {"80000": "80 °C", "80001": "80 °C"}.get(millidegrees[0], "no sensor")


@pytest.mark.parametrize(
    ("states", "level", "found"),
    [
        ({}, OK, "no interface (matters only for a link over USB)"),
        ({"usb0": "up", "usb1": "down"}, OK, "usb0 up, usb1 down"),
        ({"usb0": "down"}, WARNING, "usb0 down"),
        ({"usb0": ""}, OK, "usb0 unknown"),
        ({"eth0": "up"}, OK, "no interface (matters only for a link over USB)"),
    ],
)
def test_usb_interfaces(tmp_path: Path, states: dict[str, str], level: str, found: str) -> None:
    machine(tmp_path, {f"sys/class/net/{name}/operstate": state for name, state in states.items()})
    finding = doctor.check_usb_ethernet(tmp_path)
    assert (finding.level, finding.found) == (level, found)
    assert finding.advice == ("check the cable; sudo ip link set usb0 up" if level == WARNING else "")


@pytest.mark.parametrize(
    ("flags", "level"), [("0x1\n", OK), ("0x40c1", OK), ("0x40c0", WARNING), ("up", WARNING), ("", WARNING)]
)
def test_can_interfaces(tmp_path: Path, flags: str, level: str) -> None:
    machine(tmp_path, {"sys/class/net/can0/type": "280\n", "sys/class/net/can0/flags": flags})
    machine(tmp_path, {"sys/class/net/eth0/type": "1\n", "sys/class/net/eth0/flags": "0x1"})
    (finding,) = doctor.check_can_interfaces(tmp_path)
    assert (finding.level, finding.found) == (level, "can0 is up" if level == OK else "can0 is down")


def test_all_checks_are_made_of_a_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "loop_rate_hz", lambda: 12_340_000.0)
    monkeypatch.setattr(doctor, "open_transport", lambda link, listen: Opened())
    found = {one.check: one.found for one in doctor.examine("udp://:5", (3, 9), tmp_path)}
    names = [
        "python",
        "pyserial",
        "python-can",
        "kernel",
        "real time",
        "memory lock",
        "processors",
        "speed",
        "CPU clock",
    ]
    names += ["temperature", "memory", "disk", "clock", "date", "sockets", "USB-Ethernet", "serial", "CAN", "link"]
    assert [name.lower() for name in found] == [name.lower() for name in names]
    assert found["speed"] == "12.34 million passes of a fixed Python loop per second"
    assert found["link"] == "udp://:5 can be opened"


@pytest.mark.parametrize(("count", "found"), [(1, "1: other programs take time from the agent"), (2, "2")])
def test_processors(count: int, found: str) -> None:
    assert doctor.check_processors(count) == DoctorFinding("processors", OK, found)
