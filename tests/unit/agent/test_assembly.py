"""A node from its options, in one process; and the process with its command line."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from dataflash_reader import rows_of

from agent.assembly import REFUSALS, assemble
from agent.options import Options
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from agent.wire.signing import Signing, read_key
from agent.wire.transport import open_transport
from tests.golden import Golden
from tests.patience import PATIENCE_S

START, STOP, HELLO = mav.XITL_RUN_COMMAND_START, mav.XITL_RUN_COMMAND_STOP, mav.XITL_RUN_COMMAND_HELLO


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def run(command: int, mode: int = mav.XITL_CLOCK_MODE_LOCKSTEP) -> Any:
    return mav.MAVLink_xitl_run_message(0, b"test", command, mode, 2)


class Pair:
    """An assembled node and a host's link to it."""

    def __init__(self, options: Options, opened: ExitStack, signing: Signing | None = None) -> None:
        here, there = memory_pair()
        self.node = assemble(there, options, opened)
        self.host = Link(here, 255, 190, signing=signing)

    def send(self, *messages: Any) -> list[Any]:
        self.host.send(*messages)
        self.node.poll()
        return self.host.receive()


def test_an_autopilot_or_a_companion(opened: ExitStack) -> None:
    for role, nodes, component in (("fcu", "LS,LC,LA", 1), ("companion", "HS,HC,HA", 191)):
        info, status = Pair(Options(role=role), opened).send(run(HELLO))
        assert (info.nodes, info.get_srcSystem(), info.get_srcComponent()) == (nodes, 1, component)
        assert status.protocol == 2


@pytest.mark.parametrize(("role", "component"), [("fcu", 1), ("companion", 191)])
def test_the_system_of_the_vessel(opened: ExitStack, role: str, component: int) -> None:
    """All that it sends is of this system, it takes what is for it or for all, and nothing that is for another."""
    pair = Pair(Options(role=role, system_id=7), opened)
    info, status = pair.send(run(HELLO))
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in (info, status)} == {(7, component)}
    if role == "fcu":
        pair.send(run(START))
        for target, answers in ((1, 0), (7, 1), (0, 1)):
            (*values, _) = pair.send(
                mav.MAVLink_param_request_read_message(target, 1, b"SYSID_THISMAV", -1),
                mav.MAVLink_xitl_tick_message(20_000 * (target + 1), target + 1),
            )
            heard = [m for m in values if m.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_VALUE]
            assert [(m.param_value, m.get_srcSystem()) for m in heard] == [(7.0, 7)] * answers


def test_a_ground_station_cannot_change_the_system(opened: ExitStack, golden: Golden) -> None:
    pair = Pair(Options(system_id=7), opened)
    pair.send(run(START))
    told = pair.send(mav.MAVLink_param_set_message(7, 1, b"SYSID_THISMAV", 9.0, mav.MAV_PARAM_TYPE_INT16))
    (value,) = [m for m in told if m.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_VALUE]
    (error,) = [m for m in told if m.get_msgId() == mav.MAVLINK_MSG_ID_PARAM_ERROR]
    assert (value.param_value, error.error) == (7.0, mav.MAV_PARAM_ERROR_READ_ONLY)
    text = "".join(m.text for m in told if m.get_msgId() == mav.MAVLINK_MSG_ID_STATUSTEXT)
    golden("text", text)


def test_what_it_runs_on_may_be_said(opened: ExitStack) -> None:
    info, _ = Pair(Options(kind="real", machine="Raft"), opened).send(run(HELLO))
    assert (info.kind, info.machine) == (mav.XITL_NODE_KIND_REAL, "Raft")


def test_parameters_and_the_log_of_each_run(opened: ExitStack, tmp_path: Path) -> None:
    (tmp_path / "boat.parm").write_text("WP_SPEED 1.5\n")
    log = tmp_path / "log.bin"
    pair = Pair(Options(parameters=tmp_path / "boat.parm", log_file=log), opened)
    pair.send(run(START))
    pair.send(mav.MAVLink_xitl_tick_message(20_000, 1))
    pair.send(run(STOP))
    rows = rows_of(log)
    assert {row.Name: row.Value for row in rows["PARM"]}["WP_SPEED"] == 1.5


def test_the_host_link_signed_both_ways(opened: ExitStack, tmp_path: Path) -> None:
    (tmp_path / "key").write_text("open sesame\n")
    (tmp_path / "key").chmod(0o600)
    key = read_key("open sesame", "key")
    options = Options(link_key=tmp_path / "key")
    info, _ = Pair(options, opened, Signing(key)).send(run(HELLO))
    assert info.flags & mav.XITL_NODE_FLAGS_SIGNED
    assert info.get_msgbuf()[2] & 1
    for stranger in (None, Signing(read_key("wrong", "key"))):
        pair = Pair(options, opened, stranger)
        assert pair.send(run(START)) == []
        assert not pair.node.role.traffic.estimates


def test_refused_frames_are_counted_in_the_status(opened: ExitStack, tmp_path: Path) -> None:
    (tmp_path / "key").write_text("open sesame\n")
    (tmp_path / "key").chmod(0o600)
    here, there = memory_pair()
    node = assemble(there, Options(link_key=tmp_path / "key"), opened)
    host = Link(here, 255, 190, signing=Signing(read_key("open sesame", "key")))
    host.send(run(START))
    node.poll()
    host.receive()
    Link(here, 255, 191).send(run(STOP))  # unsigned
    host.send(run(HELLO))
    node.poll()
    status = host.receive()[-1]
    assert (status.running, status.frames_refused) == (1, 1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (Options(link_key=Path("/nowhere/key")), "/nowhere/key: the signing key is missing, there is no such file"),
        (Options(parameters=Path("/nowhere/p")), "/nowhere/p: cannot be read (No such file or directory)"),
        (Options(controller="nowhere:Fast"), "nowhere"),
        (Options(storage=Path("/nowhere/kept.json")), "/nowhere/kept.json: there is no folder /nowhere"),
        (Options(ground=("tcp://256.0.0.1:1",)), "tcp://256.0.0.1:1"),
        (Options(log_dir=Path("/a"), log_file=Path("/b")), "log-dir, log-file: a log needs only one of them"),
        (Options(role="companion", ground=("tcp://127.0.0.1:0",)), "gcs: a companion has none; leave it out"),
        (Options(role="companion", log_dir=Path("/a")), "log-dir: a companion has none; leave it out"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(opened: ExitStack, options: Options, said: str) -> None:
    with pytest.raises(REFUSALS) as refusal:
        Pair(options, opened)
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_an_empty_key_is_refused(opened: ExitStack, tmp_path: Path) -> None:
    (tmp_path / "key").write_text("\n")
    (tmp_path / "key").chmod(0o600)
    with pytest.raises(REFUSALS, match="contains no signing key"):
        Pair(Options(link_key=tmp_path / "key"), opened)
    (tmp_path / "key").write_bytes(b"\xff\xff")
    with pytest.raises(REFUSALS, match="not text"):
        Pair(Options(link_key=tmp_path / "key"), opened)


# The process


@contextmanager
def started(*words: str) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [sys.executable, "-m", "agent", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


@pytest.mark.medium
def test_the_first_line_says_where_it_waits_and_a_host_can_call() -> None:
    with started("--link", "udp://127.0.0.1:0", "--role", "companion") as process:
        line = line_of(process)
        assert " companion waits at udp://127.0.0.1:" in line
        with open_transport(line.split()[-1], listen=False) as transport:
            host = Link(transport, 255, 190)
            heard: list[Any] = []
            for _ in range(100):
                host.send(run(HELLO, mav.XITL_CLOCK_MODE_REALTIME))
                heard += host.receive(0.1)
                if heard:
                    break
        assert heard[0].nodes == "HS,HC,HA"
        process.send_signal(signal.SIGTERM)
        _, error = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, error) == (0, "")


@pytest.mark.medium
def test_what_is_not_permitted_is_said_after_the_first_line() -> None:
    with started("--link", "udp://127.0.0.1:0", "--cpu", "4000") as process:
        assert " embedded autopilot waits at udp://" in line_of(process)
        assert line_of(process).startswith("not pinned: processor 4000 is not available; use one of ")


@pytest.mark.medium
def test_a_refusal_is_one_line_and_exit_code_2(tmp_path: Path) -> None:
    (tmp_path / "agent.ini").write_text("[agent]\nlinc = udp://127.0.0.1:0\n")
    for words in (["--config", str(tmp_path / "agent.ini")], ["--realtime", "0"], ["--link", "bus://x"]):
        with started(*words) as process:
            _, error = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 2
        assert error.startswith("error: ")
        assert error.count("\n") == 1


@pytest.mark.medium
def test_an_embedded_autopilot_loads_nothing_of_the_bridges() -> None:
    program = """
import sys
from contextlib import ExitStack
from agent.assembly import assemble
from agent.options import Options
from agent.wire.memory import memory_pair
with ExitStack() as opened:
    assemble(memory_pair()[0], Options(), opened)
print(*[name for name in sys.modules if name.startswith("agent.bridges")])
"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert told.stdout.split() == []


@pytest.mark.realtime
def test_an_agent_in_real_time_keeps_deadlines_and_says_how_it_is() -> None:
    with started("--link", "udp://127.0.0.1:0") as process:
        url = line_of(process).split()[-1]
        with open_transport(url, listen=False) as transport:
            host = Link(transport, 255, 190)
            heard: list[Any] = []
            host.send(run(START, mav.XITL_CLOCK_MODE_REALTIME))
            until_s = time.monotonic() + 3.3
            while time.monotonic() < until_s:
                host.send(mav.MAVLink_xitl_imu_message(1, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8), 20.0))
                heard += host.receive(0.01)
    status = [message for message in heard if message.get_type() == "XITL_NODE_STATUS"][-1]
    assert status.memory_kib > 5_000
    assert status.cpu_percent > 0.0
    assert status.load_1min >= 0.0
    tasks = {message.task: message for message in heard if message.get_type() == "XITL_TASK_STATS"}
    control, telemetry = tasks["control"], tasks["telemetry"]
    assert control.cycles + control.skipped >= 51
    assert abs(control.cycles + control.skipped - telemetry.cycles - telemetry.skipped) <= 1
    assert sum(control.run_histogram) == sum(control.start_jitter_histogram) == control.cycles
    assert control.run_max_usec >= control.run_mean_usec > 0.0
