"""What only a second kernel can show: a board emulated here, booted once, disturbed in one way after the other.

How fast the board is depends on this machine, so nothing is said of deadlines; that all is counted and told is.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest import command, environment, summary

from tests.patience import let_pass, wait_until
from xitl_cli.errors import UserError
from xitl_cli.logs.formats import open_log
from xitl_cli.plugins.board.emulator import cut_power, running, shut_down, stopped, unplugged
from xitl_cli.plugins.board.life import create, remove, start
from xitl_cli.plugins.board.network import check_network
from xitl_cli.plugins.board.places import NAMESPACE, EmulatedBoard, the_board
from xitl_cli.plugins.board.tools import FOR_MAKING, find_program

pytestmark = [pytest.mark.realtime, pytest.mark.board, pytest.mark.nightly]

LIMIT_S = 600.0  # for what is sure to come, on whatever machine
PRIORITY = 50
ARMHF = "XITL_ARDUROVER_ARMHF"
BRIDGE = f"""\
[agent]
role = bridge
link = udp://usb0:14660
autopilot = tcp://127.0.0.1:5760
sensors = microstrain7
sensor-link = tcp://127.0.0.1:14800
realtime = {PRIORITY}
after-run = reboot
"""
FIRST = "-15"  # niceness of emulator and run where that is permitted: a board of its own shares with nobody


@pytest.fixture(scope="module")
def board() -> Iterator[EmulatedBoard]:
    """Booted, and removed in the end; its image is kept for the next time."""
    missing = [name for name in FOR_MAKING if find_program(name) is None]
    if missing:
        pytest.skip(f"needs {', '.join(missing)} to emulate a board (tools/system_packages.sh)")
    name = f"test-{os.getpid()}"
    try:
        create(name, "bookworm", 1, 512, None, None, lambda doing: None)
    except UserError as error:
        if os.environ.get("CI"):
            raise
        pytest.skip(f"no board can be made here: {error}")
    try:
        yield booted(name)
    finally:
        remove(name, images=False, force=True)


def booted(name: str, network: str | None = None) -> EmulatedBoard:
    return start(name, None, network, LIMIT_S, lambda doing: None)[0]


def why_not_apart(board: EmulatedBoard) -> str:
    """Why it cannot be started in a network namespace of its own here; empty where it can."""
    try:
        check_network(replace(board, network=NAMESPACE))
    except UserError as error:
        return str(error)
    return ""


@pytest.fixture
def apart(board: EmulatedBoard) -> EmulatedBoard:
    """The board in a network namespace of its own; started anew where it was not."""
    now = the_board(board.name)
    if now.network == NAMESPACE:
        return now
    if why_not := why_not_apart(board):
        pytest.skip(why_not)
    shut_down(now)
    return booted(board.name, NAMESPACE)


def reaching(name: str, *words: str) -> list[str]:
    """The command of xitl where the ports of the board are."""
    whole = command(*words)
    return command("board", "enter", name, *whole) if the_board(name).network == NAMESPACE else whole


def there(board: EmulatedBoard, *words: str) -> str:
    done = subprocess.run(
        ["ssh", "-F", str(board.ssh_config), board.name, *words], capture_output=True, timeout=LIMIT_S, check=True
    )
    return done.stdout.decode(errors="replace").strip()


def deploy(board: EmulatedBoard, link: str, folder: Path) -> str:
    config = folder / "agent.conf"
    config.write_text(f"[agent]\nlink = {link}\nrealtime = {PRIORITY}\nlog-dir = logs\n")
    words = ["agent", "deploy", f"board:{board.name}", "--service", "--config", str(config)]
    done = subprocess.run(command(*words), env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def sail(
    folder: Path,
    board: EmulatedBoard,
    duration_s: float,
    disturb: Sequence[tuple[float, Callable[[], object]]] = (),
    link: str = "",
    profile: str = "hitl-virtual-board",
) -> tuple[int, str]:
    """A run on the board, each disturbance at its time of the run; its exit code and what it said."""
    words = ["sim", "--profile", profile, "--duration", str(duration_s), "--out", "run"]
    if profile == "hitl-virtual-board":
        words += ["--set", f"autopilot.link={link or link_to(board)}"]
    words += ["--set", "autopilot.connect_timeout_s=60"]
    words += ["--set", "sensors.imu.rate_hz=100"]  # half as many frames: the board keeps up beside what else runs here
    due = list(disturb)
    said = []
    with subprocess.Popen(
        reaching(board.name, *words),
        cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    ) as ran:  # fmt: skip
        assert ran.stdout is not None
        for line in ran.stdout:
            said.append(line)
            at = re.match(r"t +([\d.]+) s", line)
            while at and due and float(at[1]) >= due[0][0]:
                due.pop(0)[1]()
        code = ran.wait(LIMIT_S)
    assert not due, "".join(said)
    return code, "".join(said)


def link_to(board: EmulatedBoard) -> str:
    now = the_board(board.name)
    return f"udp://{now.address}:{now.autopilot_port}"


def assert_all_accounted(run: dict[str, Any]) -> None:
    """What was sent has arrived or is counted as lost; unknown only where the ends did not agree when it was over."""
    for link in run["links"]:
        assert link["gaps"] is not None
        if link["lost"] is not None and link["sent"] is not None:
            assert link["sent"] == link["received"] - link["repeated"] + link["lost"], link


def findings_of(run: Path) -> str:
    words = ["logs", "analyze", str(run / "run.mcap"), "--json"]
    told = subprocess.run(command(*words), env=environment(), capture_output=True, text=True, check=False)
    return json.dumps(json.loads(told.stdout))


def during(seconds: float, disturbance: Callable[[EmulatedBoard], Any], board: EmulatedBoard) -> None:
    with disturbance(board):
        let_pass(seconds)


def assert_serves(board: EmulatedBoard) -> None:
    """The agent's service runs, with the priority of its settings."""
    there(board, "systemctl is-system-running --wait || true")
    assert there(board, "systemctl is-active xitl-agent") == "active"
    policy = there(board, "cat /proc/$(systemctl show -P MainPID xitl-agent)/sched")
    assert re.search(r"^policy\s*:\s*1$", policy, re.MULTILINE), policy  # SCHED_FIFO
    assert re.search(rf"^prio\s*:\s*{99 - PRIORITY}$", policy, re.MULTILINE), policy


def test_it_is_deployed_as_a_service(board: EmulatedBoard, tmp_path: Path) -> None:
    assert "wrote   /etc/systemd/system/xitl-agent.service" in deploy(board, "udp://usb0:14660", tmp_path)
    assert_serves(board)


def test_its_latency_is_measured_there_with_the_keys_of_this_machine(board: EmulatedBoard) -> None:
    words = ("--latency", "--rate", "50", "--duration", "0.3", "--json")
    report, own = (
        json.loads(subprocess.run(command("doctor", *words, *of), capture_output=True, text=True, check=False).stdout)
        for of in (("--board", board.name), ())
    )
    assert report["machine"]["name"].startswith("emulated armv7l board")
    assert report.keys() == own.keys()
    for part in ("loops", "links", "rates"):
        assert report[part][0].keys() == own[part][0].keys()


def test_a_clock_set_in_mid_run_and_stress_leave_the_relation_of_the_clocks_alone(
    board: EmulatedBoard, tmp_path: Path
) -> None:
    def set_date() -> None:
        there(board, "date -s '2031-05-04 03:02:01'")

    def stress() -> None:
        there(board, "systemd-run --quiet stress --cpu 4 --io 2 --vm 1 --vm-bytes 64M --timeout 6 --quiet")

    code, said = sail(tmp_path, board, 16.0, [(4.0, set_date), (7.0, stress)])
    assert code == 0, said
    run = summary(tmp_path / "run")
    assert_all_accounted(run)
    (node,) = run["nodes"]
    assert node["kind"] == "virtual"
    assert re.match(r"emulated armv7l board, [\d.]+ M loops/s$", node["machine"])
    assert {"SCHED_FIFO", "memory locked"} <= set(node["flags"])
    clock = next(one for one in run["clocks"] if one["node"] == "LC")
    assert clock["steps"] == 0
    assert clock["samples"] > 0
    assert run["graph"]["claimed"]["wdri"] == pytest.approx(run["graph"]["measured"]["wdri"])


def test_a_machine_that_stood_still_and_a_cable_that_was_out_are_counted_and_told(
    board: EmulatedBoard, tmp_path: Path
) -> None:
    disturb = [(5.0, lambda: during(2.0, stopped, board)), (12.0, lambda: during(3.0, unplugged, board))]
    code, said = sail(tmp_path, board, 22.0, disturb)
    assert code == 0, said
    run = summary(tmp_path / "run")
    assert_all_accounted(run)
    assert next(one for one in run["clocks"] if one["node"] == "LC")["steps"] >= 1
    assert sum(link["gaps"] for link in run["links"]) > 0
    assert "the clock of LC stepped" in " ".join(said.split())  # the terminal breaks its lines
    findings = findings_of(tmp_path / "run")
    assert "no frame for" in findings
    for link in run["links"]:
        agreed = link["lost"] is not None
        if lost := link["lost"] if agreed else link["gaps"]:
            assert f"{link['name']}: {'' if agreed else 'at least '}{lost} of" in findings


def test_a_power_cut_costs_the_last_second_and_the_service_comes_back(board: EmulatedBoard, tmp_path: Path) -> None:
    newest = "ls -t /var/lib/xitl/logs/*.BIN | head -1"
    logs: list[str] = []
    sizes: list[int] = []

    def cut() -> None:
        logs.append(there(board, newest))
        sizes.append(int(there(board, f"stat -c %s {logs[0]}")))
        let_pass(2.0)  # what is written by now is synced by then
        cut_power(board)

    code, said = sail(tmp_path, board, 600.0, [(10.0, cut)])
    ran_on = running(board)
    booted(board.name, None if why_not_apart(board) else NAMESPACE)
    assert code == 2, said
    words = " ".join(said.split())
    assert "stopped answering" in words
    assert "unknown number lost of sensors" in words
    findings = findings_of(tmp_path / "run")
    assert "The run failed" in findings
    assert "to the end of the log" in findings
    assert ran_on is None
    assert_serves(board)
    assert "EXT4-fs error" not in there(board, "dmesg")
    left = tmp_path / "cut.BIN"
    words = ["ssh", "-F", str(board.ssh_config), board.name, "cat", logs[0]]
    left.write_bytes(subprocess.run(words, capture_output=True, check=True).stdout)
    assert left.stat().st_size >= sizes[0]
    with open_log(left) as log:
        assert log.health.damaged == 0
        assert log.health.records > 0
    with open_log(tmp_path / "run" / "run.mcap") as recording:
        assert recording.health.damaged == 0
        assert not recording.health.unclosed


def test_the_profile_of_a_real_board_sails_in_a_namespace_of_its_own(apart: EmulatedBoard, tmp_path: Path) -> None:
    deploy(apart, "udp://usb0:14660", tmp_path)
    code, said = sail(tmp_path, apart, 12.0, profile="hitl-beaglebone")
    assert code == 0, said
    assert "nodes claimed real, but virtual: LS, LC, LA" in " ".join(said.split())
    run = summary(tmp_path / "run")
    assert_all_accounted(run)
    assert {link["name"]: link["received"] > 0 for link in run["links"]} == {"sensors": True, "actuators": True}
    assert [node["kind"] for node in run["nodes"]] == ["virtual"]
    assert run["graph"]["overclaimed"] == ["LS", "LC", "LA"]
    assert run["graph"]["measured"]["wdri"] < run["graph"]["claimed"]["wdri"]


def test_a_run_over_the_second_serial_line(board: EmulatedBoard, tmp_path: Path) -> None:
    deploy(board, "serial:///dev/ttyS0?baud=921600", tmp_path)
    code, said = sail(tmp_path, board, 12.0, link=f"serial://{board.serial}?baud=921600")
    assert code == 0, said
    run = summary(tmp_path / "run")
    assert_all_accounted(run)
    assert next(link for link in run["links"] if link["name"] == "actuators")["received"] > 0


@pytest.mark.ardupilot
def test_an_ardupilot_on_a_fresh_board_sails_with_all_its_checks_on(board: EmulatedBoard, tmp_path: Path) -> None:
    program = os.environ.get(ARMHF)
    if not program:
        pytest.skip(f"{ARMHF} names no ardurover built for armhf Linux")
    subprocess.run(command("board", "put", board.name, program), env=environment(), check=True)
    config = tmp_path / "agent.conf"
    config.write_text(BRIDGE)
    words = ["agent", "deploy", f"board:{board.name}", "--service", "--config", str(config)]
    subprocess.run(command(*words), env=environment(), check=True)
    words = ["sim", "--profile", "hitl-ardupilot-linux", "--out", "run"]
    words += ["--set", f"autopilot.link={link_to(board)}"]
    words += ["--set", f"autopilot.arm_timeout_s={LIMIT_S}", "--duration", str(2.0 * LIMIT_S)]
    subprocess.run(["renice", "-n", FIRST, "-p", str(running(board))], capture_output=True, check=False)
    words = ["nice", "-n", FIRST, *reaching(board.name, *words)]
    done = subprocess.run(words, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
    run = summary(tmp_path / "run")
    assert run["mission"]["waypoints_reached"] == run["mission"]["waypoints_total"], done.stdout + done.stderr
    assert_all_accounted(run)
    wait_until(lambda: there(board, "systemctl show -P NRestarts ardurover") == "1")  # for the next run
    log = there(board, "ls -t /var/lib/ardurover/logs/*.BIN | head -1")
    fetched = tmp_path / "ardurover.BIN"
    words = ["ssh", "-F", str(board.ssh_config), board.name, "cat", log]
    fetched.write_bytes(subprocess.run(words, capture_output=True, check=True).stdout)
    with open_log(fetched) as read:
        loops = read.tables["PM"]
        longest_us, load = max(loops.values("MaxT")), max(loops.values("Load"))
    print(f"PM: MaxT {longest_us} µs, Load {load:.1f} %")
    assert longest_us > 0
