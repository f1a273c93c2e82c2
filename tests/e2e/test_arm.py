"""The packaged agent on an emulated ARMv7 processor, with Debian's Python for that (tools/armhf_python.sh)."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Xitl, command, environment, summary
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pymavlink import DFReader

from tests.patience import PATIENCE_S
from tests.recorded_run import recorded_run

SUITES = {"bullseye": "3.9", "bookworm": "3.11"}
ROOT = Path(os.environ.get("XITL_ARMHF_ROOT") or Path.home() / ".cache/xitl/armhf")
DURATION_S = 15
MOST_MEMORY_KIB = 96 * 1024  # a fifth of a BeagleBone's, with the emulator's own share in it

Run = Callable[..., subprocess.Popen[str]]


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("package") / "xitl-agent.pyz"
    subprocess.run(command("agent", "package", "--out", str(path)), env=environment(), check=True, capture_output=True)
    return path


@pytest.fixture(params=SUITES)
def arm(request: pytest.FixtureRequest, archive: Path) -> Iterator[Run]:
    """Start the archive with these arguments on the emulated board."""
    emulator = shutil.which("qemu-arm-static") or shutil.which("qemu-arm")
    if emulator is None:
        pytest.skip("needs qemu-arm-static (apt install qemu-user-static)")
    root = ROOT / request.param
    python = (root / "usr/bin/python3").resolve() if root.is_dir() else root
    if not python.is_file() or not (root / "usr/lib/python3/dist-packages/numpy").is_dir():
        pytest.skip(f"needs an armhf Python with numpy in {root} (tools/armhf_python.sh {request.param})")
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        words = [emulator, "-L", str(root), str(python), "-I", str(archive), *arguments]
        started.append(subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def truth(recording: Path) -> tuple[list[int], list[tuple[float, float, float]]]:
    """Stamps and positions of the vessel's true motion."""
    stamps, positions = [], []
    with recording.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, _, message, odometry in reader.iter_decoded_messages("/truth/odometry"):
            at = odometry.pose.pose.position
            stamps.append(message.log_time)
            positions.append((at.x, at.y, at.z))
    return stamps, positions


@pytest.mark.nightly
@pytest.mark.slow
def test_a_lockstep_run_on_armv7_is_the_run_on_this_machine(
    arm: Run, xitl: Xitl, tmp_path: Path, free_port: int, record_property: Callable[[str, object], None]
) -> None:
    link = f"udp://127.0.0.1:{free_port}"
    begun_s = time.monotonic()
    agent = arm("--link", link, "--log-dir", str(tmp_path / "logs"))
    assert agent.stdout is not None
    assert f"waits at {link}" in agent.stdout.readline()
    start_s = time.monotonic() - begun_s

    board = ("--profile", "hitl-loopback", "--clock", "lockstep", "--set", "autopilot.runs=board")
    away = xitl("sim", *board, "--set", f"autopilot.link={link}", "--duration", str(DURATION_S), "--out", "there")
    assert away.returncode == 0, away.stderr  # the duration was asked for
    memory_kib = resident_kib(agent.pid)
    agent.send_signal(signal.SIGTERM)
    _, errors = agent.communicate(timeout=PATIENCE_S)
    assert (agent.returncode, errors) == (0, "")

    told = summary(tmp_path / "there")
    assert "armv7l" in told["nodes"][0]["kernel"]
    assert [link["lost"] for link in told["links"]] == [0, 0]
    assert all(task["missed"] == 0 for task in told["tasks"])

    # The same code on this machine: only the last bit of a sine may differ between the two mathematical libraries.
    stamps, positions = truth(tmp_path / "there/run.mcap")
    here_stamps, here_positions = truth(recorded_run("sitl", DURATION_S) / "run.mcap")
    assert stamps == here_stamps
    assert len(stamps) >= DURATION_S * 50
    np.testing.assert_allclose(positions, here_positions, atol=1e-6)

    record_property("start_s", round(start_s, 2))
    record_property("resident_mib", round(memory_kib / 1024, 1))
    print(f"under emulation: waits after {start_s:.2f} s, {memory_kib / 1024:.0f} MiB resident with the emulator")
    assert 0 < memory_kib < MOST_MEMORY_KIB

    log = DFReader.DFReader_binary(str(newest_log(tmp_path / "logs")))
    with closing(log.filehandle), closing(log.data_map):
        kinds = {message.get_type() for message in iter(log.recv_msg, None)}
    assert {"FMT", "PM", "IMU", "ATT"} <= kinds


@pytest.mark.nightly
@pytest.mark.slow
def test_a_companion_with_debians_numpy_sees_on_armv7_what_it_sees_on_this_machine(
    arm: Run, xitl: Xitl, tmp_path: Path, free_port: int, request: pytest.FixtureRequest
) -> None:
    pytest.importorskip("embreex", reason="xitl[perception] is not installed")
    link = f"tcp://127.0.0.1:{free_port}"
    agent = arm("--role", "companion", "--link", link)
    assert agent.stdout is not None
    assert f"waits at {link}" in agent.stdout.readline()

    def seen(runs: str) -> dict[str, Any]:
        words = ("--set", f"companion.runs={runs}", "--set", f"companion.link={link}", "--duration", "8", "--out", runs)
        ran = xitl("sim", "sitl-perception", "--set", "companion.parameters={ODO_ENABLE: 0, MAP_ENABLE: 0}", *words)
        assert ran.returncode == 0, ran.stderr
        companion: dict[str, Any] = summary(tmp_path / runs)["companion"]
        return companion

    there = seen("board")
    if request.node.callspec.params["arm"] == "bullseye":
        assert there["clouds"] == 0
        assert any("numpy>=1.21" in warning for warning in there["warnings"])
        return
    assert there["clouds"] > 70
    assert there == seen("in-process")


@pytest.mark.slow
def test_the_doctor_looks_at_an_armv7_board(arm: Run) -> None:
    doctor = arm("doctor")
    said, errors = doctor.communicate(timeout=PATIENCE_S)
    assert errors == ""
    assert "32 bits" in said
    assert {line.split()[0] for line in said.splitlines() if line and line[0] != " "} <= {"ok", "warning", "problem"}


@pytest.mark.slow
def test_serial_and_can_load_on_armv7(arm: Run, tmp_path: Path) -> None:
    """Everything that these links need is in the archive, without a compiled part."""
    agent = arm("--link", "serial:///dev/ttyNONE?baud=115200")
    _, errors = agent.communicate(timeout=PATIENCE_S)
    assert agent.returncode == 2
    assert errors.startswith("error: serial:///dev/ttyNONE")
    assert len(errors.splitlines()) == 1


def resident_kib(process: int) -> int:
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1])
    raise AssertionError("no VmRSS")


def newest_log(directory: Path) -> Path:
    return max(directory.glob("*.BIN"), key=lambda path: path.stat().st_mtime_ns)
