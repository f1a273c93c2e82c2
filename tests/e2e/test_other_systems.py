"""Commands that also have to run on Windows and macOS, with a standard library and a file system as those have them.

This shows that they need nothing that only Linux has. It does not show that they run there: see docs/install.md.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from tests.other_systems import MACOS, ROOT, WINDOWS, environment_there, hidden_names, python_there

SYSTEMS = (WINDOWS, MACOS)
PLAN = """
description: One short run
base: sitl
axes: {clock.duration_s: [1]}
seeds: 1
keep: [duration_s]
recordings: none
"""
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=[WINDOWS, pytest.param(MACOS, marks=pytest.mark.nightly)])
def there(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A system, and a folder with a short run that was made there."""
    platform: str = request.param
    folder = tmp_path_factory.mktemp(platform)
    xitl(platform, folder, "sim", "sitl", "--duration", "2", "--out", "run")
    return platform, folder


def xitl(platform: str, folder: Path, *words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = python_there(platform, ("-m", "xitl_cli.main", *words), folder)
    assert done.returncode == code, done.stdout[-2000:] + done.stderr[-4000:]
    return done


@pytest.mark.parametrize("platform", SYSTEMS)
def test_what_only_linux_has_is_hidden_from_xitl_alone(platform: str, tmp_path: Path) -> None:
    asked = """
import os, select, socket, subprocess, sys
print([hasattr(os, name) for name in ("pidfd_open", "sched_getaffinity", "fork", "getuid", "cpu_count")])
print([hasattr(socket, name) for name in ("AF_CAN", "AF_INET")], hasattr(select, "epoll"), sys.platform, os.name)
def refused(action, *words, **options):
    try:
        action(*words, **options)
    except Exception as error:
        return type(error).__name__
names = ("fcntl", "pwd", "resource", "termios", "tty", "json")
print([refused(__import__, name, globals()) == "ModuleNotFoundError" for name in names])
print(refused(open, "/proc/self/stat"), os.path.exists("/proc/self"), refused(open, "a:b", "w"))
with open("open", "w", encoding="utf-8"):
    print(refused(os.remove, "open"), refused(subprocess.run, ["true"], preexec_fn=bool))
"""
    lines = {
        WINDOWS: """[False, False, False, False, True]
[False, True] False win32 nt
[True, True, True, True, True, False]
FileNotFoundError False OSError
PermissionError ValueError
""",
        MACOS: """[False, False, True, True, True]
[False, True] False darwin posix
[False, False, False, False, False, False]
FileNotFoundError False None
None None
""",
    }
    for file, expected in ((ROOT / "xitl_cli/probe.py", lines[platform]), (tmp_path / "probe.py", None)):
        program = f"exec(compile({asked!r}, {str(file)!r}, 'exec'), {{'__file__': {str(file)!r}, '__name__': 'probe'}})"
        done = python_there(platform, ("-c", program), tmp_path)
        if expected is not None:
            assert done.stdout == expected, done.stderr
        else:
            assert done.stdout.startswith("[True, True, True, True, True]\n[True, True] True linux posix\n"), (
                done.stderr
            )


def test_names_that_only_linux_has_are_those_of_the_library_reference() -> None:
    """Names whose page in the library reference has the line "Availability"."""
    windows, macos = hidden_names(WINDOWS), hidden_names(MACOS)
    for module in ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"):
        assert windows[module] == ["*"]
    assert {"fork", "getuid", "mkfifo", "posix_spawn", "sched_setaffinity", "killpg", "openpty"} <= {*windows["os"]}
    assert {"SIGHUP", "SIGKILL", "SIGUSR1", "pthread_kill"} <= {*windows["signal"]}
    assert {"AF_UNIX", "send_fds"} <= {*windows["socket"]}
    assert {"getpid", "kill", "replace", "cpu_count"}.isdisjoint(windows["os"])
    assert {"SIGINT", "SIGTERM"}.isdisjoint(windows["signal"])
    assert {"sched_getaffinity", "pidfd_open", "memfd_create"} <= {*macos["os"]}
    assert {"fork", "getuid", "killpg"}.isdisjoint(macos["os"])


def test_a_run_is_complete(there: tuple[str, Path]) -> None:
    platform, folder = there
    summary = json.loads((folder / "run/summary.json").read_text(encoding="utf-8"))
    assert summary["duration_s"] == pytest.approx(2.0)
    assert summary["physics"]["compiled"] is (platform != WINDOWS)
    assert (folder / "run/run.mcap").stat().st_size > 10_000


def test_a_run_is_analysed(there: tuple[str, Path]) -> None:
    platform, folder = there
    assert "kept upright" in xitl(platform, folder, "logs", "analyze", "run").stdout


def test_the_realism_of_a_run_is_computed(there: tuple[str, Path]) -> None:
    platform, folder = there
    assert json.loads(xitl(platform, folder, "wdri", "paper/eq35-full-hitl", "--json").stdout)["wdri"] == pytest.approx(
        0.9306, abs=5e-5
    )


def test_a_recording_becomes_a_page(there: tuple[str, Path]) -> None:
    platform, folder = there
    xitl(platform, folder, "view", "run", "--html", "replay.html")
    assert (folder / "replay.html").read_bytes()[:15].lower() == b"<!doctype html>"


def test_a_recording_is_served_until_ctrl_c(there: tuple[str, Path]) -> None:
    platform, folder = there
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "xitl_cli.main", "view", "run", "--no-open"],
        cwd=folder, env=environment_there(platform, folder), stdout=subprocess.PIPE, encoding="utf-8",
    ) as served:  # fmt: skip
        assert served.stdout is not None
        address = re.search(r"http://\S+", served.stdout.readline())
        assert address is not None
        with urllib.request.urlopen(address[0], timeout=60) as page:
            assert b"<html" in page.read()
        served.send_signal(signal.SIGINT)
        assert served.wait(60) == 0


@pytest.mark.nightly
def test_a_campaign_is_carried_out(there: tuple[str, Path]) -> None:
    platform, folder = there
    (folder / "plan.yaml").write_text(PLAN, encoding="utf-8")
    xitl(platform, folder, "campaign", "plan.yaml", "--out", "campaign", "--workers", "1", code=1)
    (row,) = (folder / "campaign/results.jsonl").read_text(encoding="utf-8").splitlines()
    result = json.loads(row)
    assert (result["status"], result["duration_s"]) == ("incomplete", pytest.approx(1.0))


def test_an_emulated_board_is_refused_in_one_sentence_on_windows(tmp_path: Path) -> None:
    assert "an emulated board needs Linux" in xitl(WINDOWS, tmp_path, "board", "list", code=2).stderr


def test_a_live_view_is_refused_in_one_sentence_on_windows(tmp_path: Path) -> None:
    words = ("sim", "sitl", "--duration", "1", "--view", "--out", "run")
    assert "need Linux or macOS" in xitl(WINDOWS, tmp_path, *words, code=2).stderr
