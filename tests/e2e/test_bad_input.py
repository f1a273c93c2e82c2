"""What is wrong is one line that says what, where and what to do, exit code 2, and nothing left behind."""

from __future__ import annotations

import os
import re
import signal
import socket
from pathlib import Path

import pytest
from conftest import Xitl, assert_one_line_error, payloads, running, summary
from mcap.exceptions import EndOfFile
from mcap.records import Chunk, DataEnd, Message
from mcap.stream_reader import StreamReader
from pymavlink.dialects.v20 import common

from tests.patience import PATIENCE_S, let_pass
from xitl_cli.run.core.pace import SLIP_NS


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("extends: sitl\nenvironment: {wnd: {mean_mps: 3}}\n", ("boat.yaml:2", "environment.wnd", "wind")),
        (
            "extends: sitl\nenvironment:\n  wind: {mean_mps: 8 m/s}\n",
            ("boat.yaml:3", "environment.wind.mean_mps", "8 m/s"),
        ),
        ("extends: sitl\nsensors: {imu: {rate_hz: 333}}\n", ("boat.yaml:2", "sensors.imu.rate_hz = 333", "200 or 400")),
        ("extends: stil\n", ("boat.yaml:1", "stil", "sitl")),
        ("extends: sitl\n  broken: [\n", ("boat.yaml:2",)),
        ("extends: paper/eq34-full-sitl\n", ("graph",)),
    ],
)
@pytest.mark.slow
def test_a_broken_profile(xitl: Xitl, tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    (tmp_path / "boat.yaml").write_text(text)
    assert_one_line_error(xitl("sim", "--profile", "boat.yaml", "--out", "run"), *words)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["boat.yaml"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("sim", "--profile", "nowhere.yaml"), ("nowhere.yaml",)),
        (("sim", "--profile", "stil"), ("stil", "sitl")),
        (("sim", "--set", "environment.wind.mean=8"), ("--set environment.wind.mean", "mean_mps")),
        (("sim", "--set", "nonsense"), ("nonsense",)),
        (("sim", "--clock", "warp"), ("clock.mode", "lockstep")),
        (("sim", "--duration", "-5"), ("clock.duration_s", "-5")),
        (("wdri", "sitl", "--reference", "eq99"), ("eq99",)),
        (("profiles", "show", "stil"), ("stil",)),
    ],
)
@pytest.mark.slow
def test_bad_arguments(xitl: Xitl, tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    assert_one_line_error(xitl(*arguments), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_an_unwritable_directory(xitl: Xitl, tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir(mode=0o500)
    assert_one_line_error(xitl("sim", "--out", "locked/run"), "locked", "not writable")


def test_a_file_where_the_directory_should_be(xitl: Xitl, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    assert_one_line_error(xitl("sim", "--out", "taken"), "taken", "not a directory")


@pytest.mark.slow
def test_an_earlier_run_is_kept(xitl: Xitl, tmp_path: Path) -> None:
    assert xitl("sim", "--duration", "1", "--out", "run").returncode == 0
    before = (tmp_path / "run/run.mcap").read_bytes()
    assert_one_line_error(xitl("sim", "--duration", "1", "--out", "run"), "already contains a run", "--overwrite")
    assert (tmp_path / "run/run.mcap").read_bytes() == before
    assert xitl("sim", "--duration", "2", "--out", "run", "--overwrite").returncode == 0
    assert summary(tmp_path / "run")["duration_s"] == 2.0


def test_a_port_in_use(xitl: Xitl, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        link = f"autopilot.link=udp://127.0.0.1:{port}"
        result = xitl("sim", "--profile", "hitl-loopback", "--set", link, "--out", "run")
        assert_one_line_error(result, str(port), "in use")
        assert_one_line_error(xitl("agent", "--link", f"udp://127.0.0.1:{port}"), str(port), "in use")
    assert list(tmp_path.iterdir()) == []


def test_a_board_that_does_not_answer(xitl: Xitl, tmp_path: Path, free_port: int) -> None:
    """Nobody listens at the port: what the profile's own address does depends on this machine's routes."""
    link = f"autopilot.link=udp://127.0.0.1:{free_port}"
    hurry = "autopilot.connect_timeout_s=1"
    result = xitl("sim", "--profile", "hitl-beaglebone", "--set", link, "--set", hurry, "--out", "run")
    assert_one_line_error(result, f"127.0.0.1:{free_port}", "ping", "xitl agent --link")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_beaglebone_profile_gives_up_within_ten_seconds(xitl: Xitl, tmp_path: Path) -> None:
    """As it says itself: a person waits for it."""
    result = xitl("sim", "--profile", "hitl-beaglebone", "--out", "run")
    assert_one_line_error(result, "192.168.7.2")
    waited = re.search(r"no agent answered within (\d+) s", result.stderr)
    assert waited is not None, result.stderr
    assert int(waited[1]) < 10
    assert list(tmp_path.iterdir()) == []


REALTIME = ("--profile", "sitl", "--clock", "realtime", "--duration", "600")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupt_ends_cleanly(tmp_path: Path, number: signal.Signals) -> None:
    with running(tmp_path, *REALTIME) as process:
        process.send_signal(number)
        _, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert stderr == ""
    told = summary(tmp_path / "run")
    assert told["ended"] == "interrupted"
    assert not told["mission"]["completed"]
    last_ns = max(stamp for stamp, _ in payloads(tmp_path / "run/run.mcap")["/truth/state"])
    assert told["duration_s"] - last_ns * 1e-9 < 0.03


@pytest.mark.slow
def test_a_kill_loses_at_most_the_last_second(tmp_path: Path) -> None:
    told_s = 0.0
    with running(tmp_path, *REALTIME) as process:
        assert process.stdout is not None
        while told_s < 3.0:
            told_s = float(process.stdout.readline().split()[1])
        process.kill()
        process.communicate(timeout=PATIENCE_S)
    newest_ns = 0
    records = []
    with (tmp_path / "run/run.mcap").open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=False).records:
                records.append(type(record))
                if isinstance(record, Message):
                    newest_ns = max(newest_ns, record.log_time)
        except EndOfFile:
            pass
    assert DataEnd not in records
    assert Chunk not in records
    # A second between flushes, one exchange of slack, and what a host that is behind catches up with in that second.
    assert newest_ns * 1e-9 > told_s - 1.0 - 0.02 - SLIP_NS * 1e-9


@pytest.mark.slow
def test_garbage_from_the_network_is_dropped_and_counted(tmp_path: Path, free_port: int) -> None:
    """Noise, a frame cut short, one with a flipped bit, one of an unknown kind; from somebody who is not the host."""
    whole = bytearray(common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(common.MAVLink(None)))
    flipped, unknown = bytearray(whole), bytearray(whole)
    flipped[12] ^= 0x10
    unknown[7:10] = b"\xee\xee\xee"
    garbage = [os.urandom(40).replace(b"\xfd", b"\0"), bytes(whole[:9]), bytes(flipped), bytes(unknown), b""]
    link = f"autopilot.link=udp://127.0.0.1:{free_port}"
    with (
        running(tmp_path, "--profile", "hitl-loopback", "--set", link, "--duration", "600") as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        stranger.connect(("127.0.0.1", free_port))
        for number in range(100):
            stranger.send(garbage[number % len(garbage)])
            let_pass(0.01)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert stderr == ""
    sensors, actuators = summary(tmp_path / "run")["links"]
    assert sensors["dropped"] == 80  # an empty datagram has nothing to drop
    assert sensors["lost"] == actuators["lost"] == actuators["dropped"] == 0
    assert sensors["received"] == sensors["sent"]


@pytest.mark.slow
def test_an_agent_that_dies_ends_the_run_with_a_summary(tmp_path: Path, free_port: int) -> None:
    link = f"autopilot.link=udp://127.0.0.1:{free_port}"
    with running(tmp_path, "--profile", "hitl-loopback", "--set", link, "--duration", "600") as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        assert len(children) == 1
        os.kill(int(children[0]), signal.SIGKILL)
        _, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert len(stderr.strip().splitlines()) == 1
    assert "agent process ended" in stderr
    told = summary(tmp_path / "run")
    assert told["ended"] == "failed"
    assert "agent process ended" in told["error"]
    assert payloads(tmp_path / "run/run.mcap")["/truth/state"]


def test_a_directory_that_cannot_be_made(xitl: Xitl) -> None:
    """Not even root may make one there."""
    assert_one_line_error(xitl("sim", "--out", "/proc/run"), "/proc/run", "cannot be created", "--out")
