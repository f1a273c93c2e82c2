"""What breaks in a run with an agent: the run goes on or ends with one sentence, the recording opens, counts add up."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from conftest import command, environment, payloads, summary
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from tests.free_ports import free_port as next_free_port
from tests.golden import Golden
from tests.patience import PATIENCE_S, let_pass, wait_until
from xitl_cli.logs import open_log
from xitl_cli.plugins.logs.analyses import events, links

Run = subprocess.Popen[str]
Start = Callable[..., Run]


@contextmanager
def under_way(folder: Path, port: int, *arguments: str, yaml: str = "extends: hitl-loopback\n") -> Iterator[Run]:
    """`xitl sim` in real time with an agent process, from its first line of progress on; killed in the end."""
    (folder / "boat.yaml").write_text(yaml)
    link = f"autopilot.link=udp://127.0.0.1:{port}"
    nobody = "autopilot.ground_stations=[]"
    process = subprocess.Popen(
        command("sim", "--profile", "boat.yaml", "--set", link, "--set", nobody, *arguments, "--out", "run"),
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        process.stdout.readline()
        yield process
    finally:
        if process.poll() is None:
            for child in children_of(process):
                os.kill(child, signal.SIGCONT)
            process.send_signal(signal.SIGCONT)
            process.kill()
        process.communicate()


@pytest.fixture
def start(tmp_path: Path, free_port: int) -> Iterator[Start]:
    """`under_way` in the folder of the test."""
    with ExitStack() as stack:
        yield lambda *arguments, **options: stack.enter_context(under_way(tmp_path, free_port, *arguments, **options))


def children_of(process: subprocess.Popen[str]) -> list[int]:
    return [int(child) for child in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]


def ended(process: subprocess.Popen[str], code: int) -> str:
    """What the run said on stderr: nothing, or one sentence when it failed."""
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == code, stderr
    assert len(stderr.strip().splitlines()) == (code == 2), stderr
    return stderr


SILENT_S = 5.2
"""Five seconds, also if the last command before them came late."""


def stop_agent(process: Run) -> None:
    (agent,) = children_of(process)
    os.kill(agent, signal.SIGSTOP)
    let_pass(SILENT_S)
    os.kill(agent, signal.SIGCONT)


def stop_host(process: Run) -> None:
    process.send_signal(signal.SIGSTOP)
    let_pass(3.0)
    process.send_signal(signal.SIGCONT)


def kill_first_agent(process: Run) -> None:
    active, _ = children_of(process)
    let_pass(12.5)  # armed and under way
    os.kill(active, signal.SIGKILL)


def leave_alone(process: Run) -> None:
    pass


HITL = "extends: hitl-loopback\n"
CUT = f"{HITL}faults:\n  gap: {{from_s: 1.0, until_s: {1.0 + SILENT_S}, link: {{cut: true}}}}\n"
STEP = f"{HITL}faults:\n  step: {{from_s: 2.0, agent: {{clock_offset_s: 0.5}}}}\n"
STANDBY = f"""\
{HITL}mission: {{speed_mps: 3.0}}
autopilot: {{standby: {{runs: process, link: "udp://127.0.0.1:0", takeover_s: 0.2, max_step: 0.04}}}}
"""
DISTURBED: dict[str, tuple[str, str, Callable[[Run], None]]] = {
    "standby": (STANDBY, "16", kill_first_agent),
    "silent agent": (HITL, "7.7", stop_agent),
    "cut": (CUT, "7.7", leave_alone),
    "stopped host": (HITL, "4", stop_host),
    "stepped clock": (STEP, "4.5", leave_alone),
}
"""Profile, duration and disturbance of runs that keep up with the clock, the longest first."""
AT_ONCE = 3  # each keeps a fifth of a processor busy


@dataclass(frozen=True)
class Disturbed:
    """A run that is over, without an error. printed: on stdout."""

    folder: Path
    printed: str

    @property
    def summary(self) -> dict[str, Any]:
        return summary(self.folder)


@pytest.fixture(scope="session")
def disturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Future[Disturbed]]:
    """The runs of DISTURBED: some at once, as they mostly wait for the clock."""

    def run(name: str, folder: Path, port: int) -> Disturbed:
        yaml, duration_s, disturb = DISTURBED[name]
        with under_way(folder, port, "--duration", duration_s, yaml=yaml) as process:
            disturb(process)
            printed, stderr = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, stderr) == (0, ""), name
        return Disturbed(folder / "run", printed)

    with ThreadPoolExecutor(AT_ONCE) as threads:
        return {
            name: threads.submit(run, name, tmp_path_factory.mktemp("disturbed"), next_free_port())
            for name in DISTURBED
        }


def said(directory: Path) -> str:
    return "\n".join(data.decode("utf-8", "replace") for _, data in payloads(directory / "run.mcap")["/log"])


def decoded(directory: Path, topic: str) -> list[Any]:
    with (directory / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [message for *_, message in reader.iter_decoded_messages(topics=[topic])]


def assert_counts_add_up(told: dict[str, Any]) -> None:
    for link in told["links"]:
        assert link["sent"] == link["received"] - link["repeated"] + link["lost"], link


@pytest.mark.slow
def test_an_agent_that_is_killed_ends_the_run(start: Start, tmp_path: Path) -> None:
    process = start("--duration", "60")
    (agent,) = children_of(process)
    os.kill(agent, signal.SIGKILL)
    stderr = ended(process, 2)
    assert "agent process ended: signal 9 killed it" in stderr
    told = summary(tmp_path / "run")
    assert told["error"] in stderr
    sensors, actuators = told["links"]
    assert sensors["sent"] > 0
    assert sensors["received"] is sensors["lost"] is actuators["sent"] is None  # nobody is left to tell
    assert payloads(tmp_path / "run/run.mcap")["/truth/state"]


@pytest.mark.slow
def test_a_host_that_is_killed_leaves_no_agent_behind(start: Start) -> None:
    """It would hold its ports, and every later run would fail for that."""
    process = start("--duration", "60")
    (agent,) = children_of(process)
    process.kill()
    process.communicate()
    line = Path(f"/proc/{agent}/cmdline")
    wait_until(lambda: not line.exists() or not line.read_bytes(), "the agent is there yet")  # empty: a zombie


@pytest.mark.realtime
def test_an_agent_that_is_silent_for_five_seconds_is_said_and_the_run_goes_on(
    disturbed: dict[str, Future[Disturbed]],
) -> None:
    run = disturbed["silent agent"].result()
    told = run.summary
    assert told["error"] is None
    text = said(run.folder)
    assert text.count("no motor commands from the agent for 0.5 s") == 1
    assert text.count("the agent commands again after 5.") == 1
    assert told["actuators"]["longest_stale"] >= 240  # exchanges at 50 Hz
    assert told["actuators"]["age_us"]["max"] > 4.8e6
    assert told["pace"]["slips"] == 0
    assert_counts_add_up(told)


@pytest.mark.slow
def test_an_agent_that_stays_silent_ends_the_run_with_one_sentence(start: Start, tmp_path: Path) -> None:
    process = start("--duration", "60", "--set", "autopilot.silent_s=1")
    (agent,) = children_of(process)
    let_pass(2.0)  # of a link that works
    os.kill(agent, signal.SIGSTOP)
    printed, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2, stderr
    assert len(stderr.strip().splitlines()) == 1, stderr
    assert "stopped answering and was silent for 1 s" in stderr
    assert "unknown number lost of sensors, unknown number lost of actuators" in " ".join(printed.split())
    error = summary(tmp_path / "run")["error"]
    assert error in stderr
    assert error in said(tmp_path / "run")
    with open_log(tmp_path / "run/run.mcap") as log:
        silences = [one.sentence for one in links.analyse(log).findings if one.key == "links.silence"]
        (failure,) = [one for one in events.analyse(log).findings if one.key == "events.run_failed"]
    told = re.compile(r"agent/rx: no frame for \d+\.\d s from \d+:\d\d\.\d to the end of the log ")
    assert any(map(told.match, silences))
    assert failure.sentence.endswith(error)


@pytest.mark.realtime
def test_a_host_that_is_suspended_for_three_seconds_goes_on_where_it_was(
    disturbed: dict[str, Future[Disturbed]],
) -> None:
    run = disturbed["stopped host"].result()
    assert "ended: duration reached" in run.printed
    assert "not a real-time run: the host stalled" in " ".join(run.printed.split())
    told = run.summary
    assert told["verdict"]["real_time"] is False
    assert 2.5 < told["verdict"]["longest_stall_s"] < 3.5
    assert told["warnings"][-1] == f"not a real-time run: {'; '.join(told['verdict']['shortfalls'])}"
    assert told["error"] is None
    assert told["duration_s"] == pytest.approx(4.0)
    assert told["pace"]["slips"] == 1
    assert 2.5 < told["pace"]["slipped_s"] < 3.5
    assert told["wall_s"] == pytest.approx(told["duration_s"] + told["pace"]["slipped_s"], abs=0.2)
    assert "this machine stalled" in said(run.folder)
    assert_counts_add_up(told)
    # Nothing in the recording is from a time that the simulation had not reached.
    topics = payloads(run.folder / "run.mcap")
    assert max(stamp_ns for messages in topics.values() for stamp_ns, _ in messages) < 4.2e9
    states = [stamp_ns for stamp_ns, _ in topics["/truth/state"]]
    assert states == [number * 20_000_000 for number in range(1, 201)]


@pytest.mark.realtime
def test_a_link_that_is_cut_for_five_seconds(disturbed: dict[str, Future[Disturbed]]) -> None:
    """Some 1500 frames to the agent and 500 from it are lost in a row, which no sequence number can tell."""
    run = disturbed["cut"].result()
    told = run.summary
    assert told["error"] is None
    assert_counts_add_up(told)
    sensors, actuators = told["links"]
    assert sensors["lost"] > 300
    assert actuators["lost"] > 300
    assert (sensors["impaired"], actuators["impaired"]) == (sensors["lost"], actuators["lost"])
    assert (sensors["repeated"], actuators["repeated"]) == (0, 0)
    text = said(run.folder)
    assert "Failsafe over" in text  # that it began was lost
    assert "the agent commands again after 5." in text
    (fault,) = told["faults"]
    assert (fault["from_s"], fault["until_s"]) == (1.0, 1.0 + SILENT_S)


@pytest.mark.slow
def test_a_link_that_loses_repeats_delays_and_reorders_adds_up(start: Start, tmp_path: Path) -> None:
    link = "{loss: 0.1, duplicate: 0.1, reorder: 0.1, delay_s: 0.02, jitter_s: 0.01}"
    ended(start("--duration", "4", yaml=f"extends: hitl-loopback\nfaults:\n  bad: {{from_s: 0.5, link: {link}}}\n"), 0)
    told = summary(tmp_path / "run")
    assert_counts_add_up(told)
    for report in told["links"]:
        assert report["lost"] == report["impaired"] > 10
        assert report["repeated"] > 10
        assert report["latency_us"]["p50"] > 20_000


@pytest.mark.realtime
def test_a_board_clock_that_steps_is_found_and_the_run_goes_on(disturbed: dict[str, Future[Disturbed]]) -> None:
    run = disturbed["stepped clock"].result()
    told = run.summary
    assert told["error"] is None
    assert told["clocks"][0]["steps"] == 1
    assert_counts_add_up(told)
    clocks = [clock for clock in decoded(run.folder, "/clocks") if clock.node == "LC"]
    seen_s = [clock.stamp.sec + clock.stamp.nanosec * 1e-9 for clock in clocks if clock.steps == 1]
    assert 2.0 < min(seen_s) < 4.0  # within 2 s
    step_s = clocks[-1].offset_s - clocks[0].offset_s
    assert step_s == pytest.approx(0.5, abs=2e-3)  # at most 100 ppm of 5 s, and half a round trip


@pytest.mark.slow
def test_a_disk_that_fills_up_ends_the_run_and_leaves_summary_and_recording(tmp_path: Path, golden: Golden) -> None:
    script = 'mount -t tmpfs -o size=1500k none small && cd small && "$@"; code=$?; cp -r run ../run; exit $code'
    if os.geteuid() != 0 or shutil.which("unshare") is None:
        pytest.skip("a small file system can be mounted by root alone")
    (tmp_path / "small").mkdir()
    result = subprocess.run(
        ["unshare", "--mount", "sh", "-c", script, "sh", *command("sim", "--duration", "100", "--out", "run")],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=3 * PATIENCE_S,
        check=False,
    )
    if "mount" in result.stderr:
        pytest.skip(f"a small file system cannot be mounted here: {result.stderr.strip()}")
    assert result.returncode == 2, result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    golden("stderr", result.stderr)
    told = summary(tmp_path / "run")
    assert "No space left on device" in told["error"]
    assert_counts_add_up(told)
    newest_ns = 0
    with (tmp_path / "run/run.mcap").open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=False, validate_crcs=True).records:
                if isinstance(record, Message):
                    newest_ns = max(newest_ns, record.log_time)
        except EndOfFile:
            pass
    assert newest_ns > 5e9


@pytest.mark.realtime
def test_the_standby_takes_over_without_a_jump(disturbed: dict[str, Future[Disturbed]]) -> None:
    run = disturbed["standby"].result()
    told = run.summary
    assert told["error"] is None
    (takeover,) = told["takeovers"]
    assert (takeover["from_node"], takeover["to_node"]) == ("agent", "standby")
    assert 0.2 <= takeover["silent_s"] < 0.3  # and an exchange or two on a busy machine
    assert takeover["step"] <= 0.04 + 1e-9
    topics = payloads(run.folder / "run.mcap")
    assert len(topics["/takeovers"]) == 1
    assert topics["/link/standby/tx"]
    assert topics["/link/standby/rx"]
    used = decoded(run.folder, "/actuators")
    at = round(takeover["at_s"] * 50)  # exchanges are numbered from 1
    before, after = used[at - 2], used[at - 1 :]
    assert before.armed, "the first agent was armed"
    assert any(before.command), "and steered"
    assert all(exchange.armed for exchange in after), "and so is the standby, from the first exchange on"
    for one, other in zip([before, *after[:9]], after[:10], strict=True):
        assert max(abs(a - b) for a, b in zip(one.command, other.command, strict=True)) <= 0.04 + 1e-9
    _, _, sensors, actuators = told["links"]
    assert (sensors["name"], actuators["name"]) == ("standby sensors", "standby actuators")
    assert_counts_add_up({"links": [sensors, actuators]})


@pytest.mark.slow
def test_an_agent_that_was_started_anew_ends_the_run(tmp_path: Path, start: Start, free_port: int) -> None:
    def agent() -> subprocess.Popen[bytes]:
        link = f"udp://127.0.0.1:{free_port}"
        process = subprocess.Popen([sys.executable, "-m", "agent", "--link", link], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        return process

    first = agent()
    process = start("--duration", "60", yaml="extends: hitl-loopback\nautopilot: {runs: board}\n")
    first.kill()
    with first, agent() as second:
        try:
            stderr = ended(process, 2)
        finally:
            second.kill()
    assert "was restarted" in stderr
    assert summary(tmp_path / "run")["error"] in stderr
