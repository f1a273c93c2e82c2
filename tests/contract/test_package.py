"""`xitl agent package`: one file that bare Pythons run."""

from __future__ import annotations

import hashlib
import json
import os
import re
import socket
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from pythons import python

from tests.golden import Golden
from tests.patience import PATIENCE_S

pytestmark = pytest.mark.slow

VERSIONS = ("3.9", "3.10", "3.11", "3.12", "3.13")
OLDEST_AND_NEWEST = (VERSIONS[0], VERSIONS[-1])
"""The one lacks what later versions brought, the other what they removed. Each version starts the agent."""
BARE = ("-I", "-S")  # neither the user's nor installed packages


def xitl(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "NO_COLOR": "1"}
    words = [sys.executable, "-m", "xitl_cli.main", *arguments]
    return subprocess.run(words, capture_output=True, text=True, env=environment, check=False)


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("package") / "xitl-agent.pyz"
    made = xitl("agent", "package", "--out", str(path))
    assert made.returncode == 0, made.stderr
    assert hashlib.sha256(path.read_bytes()).hexdigest() in made.stdout
    return path


@pytest.fixture(params=OLDEST_AND_NEWEST)
def bare(request: pytest.FixtureRequest) -> tuple[str, ...]:
    return (python(request.param), *BARE)


def test_the_same_sources_give_the_same_bytes(archive: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.pyz"
    assert xitl("agent", "package", "--out", str(again)).returncode == 0
    assert again.read_bytes() == archive.read_bytes()


def test_all_in_it_is_python_and_comes_with_its_licence(archive: Path) -> None:
    with zipfile.ZipFile(archive) as opened:
        assert opened.testzip() is None
        names = opened.namelist()
    licences = {name.split("/")[1] for name in names if name.startswith("licences/")}
    assert {"xitl", "pyserial", "python-can", "packaging", "typing_extensions", "wrapt"} <= licences
    assert "licences/xitl/LICENSE" in names
    assert {Path(name).suffix for name in names if not name.startswith("licences/")} == {".py"}
    assert {name.partition("/")[0] for name in names if name.startswith(("xitl_cli", "sim_core", "numpy"))} == set()


@pytest.mark.parametrize("version", VERSIONS)
def test_it_starts_and_waits(archive: Path, version: str) -> None:
    words = [python(version), *BARE, str(archive), "--link", "udp://127.0.0.1:0"]
    agent = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        assert agent.stdout is not None
        assert "waits at udp://127.0.0.1:" in agent.stdout.readline()
    finally:
        agent.terminate()
        agent.communicate()
    assert agent.returncode == 0


@pytest.mark.parametrize("version", OLDEST_AND_NEWEST)
def test_it_runs_the_bridge_of_a_package_beside_it(archive: Path, version: str, tmp_path: Path) -> None:
    guide = (Path(__file__).parents[2] / "docs/plugins.md").read_text(encoding="utf-8")
    (lines,) = (block for block in re.findall(r"```python\n(.*?)```", guide, re.DOTALL) if "BridgeKind" in block)
    info = tmp_path / "xitl_lines-1.2.dist-info"
    info.mkdir()
    (tmp_path / "xitl_lines.py").write_text(lines, encoding="utf-8")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: xitl-lines\nVersion: 1.2\n", encoding="utf-8")
    (info / "entry_points.txt").write_text("[xitl.bridges]\nlines = xitl_lines:KIND\n", encoding="utf-8")
    words = ("--role", "bridge", "--link", "udp://127.0.0.1:0", "--autopilot", "udp://127.0.0.1:9", "--sensors")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [python(version), "-S", str(archive), *words]
    own = ["--sensor-link", "udp://127.0.0.1:9"]
    agent = subprocess.Popen([*command, "lines", *own], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert agent.stdout is not None
        assert "bridge to an autopilot waits at udp://127.0.0.1:" in agent.stdout.readline()
    finally:
        agent.terminate()
        agent.communicate()
    assert agent.returncode == 0
    refused = subprocess.run([*command, "others", *own], capture_output=True, text=True, env=environment, check=False)
    assert refused.returncode == 2
    assert "sensors: others: no installed package registers it in xitl.bridges; install its" in refused.stderr


def test_serial_and_can_are_in_it(archive: Path, bare: tuple[str, ...]) -> None:
    program = (
        f"import sys; sys.path.insert(0, {str(archive)!r}); import serial, can, can.interfaces.slcan\n"
        "with can.Bus(interface='virtual', channel='a') as one, can.Bus(interface='virtual', channel='a') as other:\n"
        "    one.send(can.Message(arbitration_id=7, data=b'abc'))\n"
        "    assert bytes(other.recv(1).data) == b'abc'\n"
        "print(serial.__file__, can.__file__)"
    )
    told = run(*bare, "-c", program)
    assert told.stdout.split() == [f"{archive}/serial/__init__.py", f"{archive}/can/__init__.py"], told.stderr


def test_it_is_a_program_of_its_own(archive: Path) -> None:
    told = run(str(archive), "--version")
    assert told.stdout.startswith("xitl agent "), told.stderr


def test_the_doctor_is_in_it(archive: Path, bare: tuple[str, ...]) -> None:
    told = run(*bare, str(archive), "doctor", "--link", "udp://127.0.0.1:0")
    assert told.returncode in (0, 1), told.stderr
    assert "udp://127.0.0.1:0 can be opened" in told.stdout


def test_it_measures_latency(archive: Path, bare: tuple[str, ...]) -> None:
    told = run(*bare, str(archive), "doctor", "--latency", "--rate", "50", "--duration", "0.1", "--json")
    report = json.loads(told.stdout)
    assert told.returncode in (0, 1), told.stderr
    assert {row["loop"] for row in report["loops"]} == {"xitl", "bare"}
    assert report["links"][0]["samples"] + report["links"][0]["lost"] == 5


@pytest.mark.parametrize("version", ["3.6", "3.7", "3.8"])
def test_an_older_python_is_told(archive: Path, version: str) -> None:
    told = run(python(version), str(archive), "--version")
    assert told.returncode == 1
    assert told.stderr.startswith("error: xitl-agent.pyz needs Python 3.9 or newer, this is " + version)
    assert len(told.stderr.splitlines()) == 1


def test_a_place_that_cannot_be_written_is_one_sentence(golden: Golden) -> None:
    told = xitl("agent", "package", "--out", "/nonexistent/agent.pyz")
    assert told.returncode == 2
    golden("stderr", told.stderr)


def test_ready_is_told_to_the_service_manager(archive: Path, tmp_path: Path) -> None:
    """What `Type=notify` in the unit waits for."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(PATIENCE_S)
        agent = subprocess.Popen(
            [sys.executable, str(archive), "--link", "udp://127.0.0.1:0"],
            stdout=subprocess.PIPE,
            env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify")},
        )
        try:
            assert manager.recv(64) == b"READY=1"
        finally:
            agent.terminate()
            agent.communicate()


def test_the_help_of_the_agent_names_what_brings_it_to_a_board() -> None:
    told = xitl("agent", "--help")
    assert told.returncode == 0
    for words in ("xitl agent package", "xitl agent deploy", "xitl doctor"):
        assert words in " ".join(told.stdout.split())
