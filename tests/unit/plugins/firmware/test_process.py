"""An autopilot as a process: stand-ins that say something, stay, die or do not heed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.golden import Golden
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.errors import UserError
from xitl_cli.firmware.cache import find_firmware
from xitl_cli.firmware.process import FirmwareProcess, newest_log


def script(path: Path, body: str) -> Path:
    path.write_text(f"#!{sys.executable}\nimport os, signal, sys, time\n{body}\n")
    path.chmod(0o755)
    return path


def wait_for_end(process: FirmwareProcess) -> UserError:
    def end() -> UserError | None:
        try:
            process.check()
        except UserError as error:
            return error
        return None

    return wait_until(end, "it did not end")


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_it_works_where_it_is_put_and_what_it_says_is_kept(tmp_path: Path) -> None:
    program = script(tmp_path / "rover", "print('at', os.getcwd(), sys.argv[1], flush=True)\ntime.sleep(60)")
    (tmp_path / "work").mkdir()
    process = FirmwareProcess(program, ["--x"], tmp_path / "work")
    assert process.wait_for("at ", timeout_s=PATIENCE_S)
    assert process.last_line() == f"at {tmp_path / 'work'} --x"
    process.check()
    process.stop()
    process.stop()
    process.check()  # stopped on purpose is no trouble
    assert not is_alive(process.pid)


@pytest.mark.medium
def test_one_that_dies_tells_how_and_its_last_words(tmp_path: Path, golden: Golden) -> None:
    program = script(tmp_path / "rover", "print('one')\nprint('PANIC: no', flush=True)\nos.abort()")
    error = wait_for_end(FirmwareProcess(program, [], tmp_path))
    golden("error", error)
    assert str(tmp_path / "console.txt") in str(error)
    program = script(tmp_path / "other", "sys.exit(3)")
    assert "(exit code 3); see" in str(wait_for_end(FirmwareProcess(program, [], tmp_path)))


def test_one_that_does_not_heed_is_killed_with_what_it_started(tmp_path: Path) -> None:
    body = (
        "signal.signal(signal.SIGTERM, signal.SIG_IGN)\nimport subprocess\n"
        "child = subprocess.Popen(['sleep', '600'])\nprint('child', child.pid, flush=True)\ntime.sleep(600)"
    )
    process = FirmwareProcess(script(tmp_path / "rover", body), [], tmp_path)
    assert process.wait_for("child", timeout_s=PATIENCE_S)
    child = int(process.last_line().split()[1])
    process.stop(0.1)
    assert not is_alive(process.pid)
    wait_until(lambda: not is_alive(child))


def test_it_ends_when_its_host_is_killed(tmp_path: Path) -> None:
    program = script(tmp_path / "rover", "print('up', flush=True)\ntime.sleep(60)")
    host = (
        "import sys, time\nfrom pathlib import Path\nfrom xitl_cli.firmware.process import FirmwareProcess\n"
        f"p = FirmwareProcess(Path({str(program)!r}), [], Path({str(tmp_path)!r}))\n"
        f"p.wait_for('up', timeout_s={PATIENCE_S})\nprint(p.pid, flush=True)\ntime.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", host], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        pid = int(process.stdout.readline())
        assert is_alive(pid)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    wait_until(lambda: not is_alive(pid))


def test_what_is_no_program_is_refused(tmp_path: Path) -> None:
    empty = tmp_path / "rover"
    empty.write_bytes(b"\x7fELF")
    empty.chmod(0o755)
    with pytest.raises(UserError, match="cannot be started"):
        FirmwareProcess(empty, [], tmp_path)


def test_the_newest_log_is_found_below(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    assert newest_log(tmp_path) is None
    for number, name in enumerate(("00000001.BIN", "00000002.BIN", "00000003.BIN", "eeprom.bin")):
        (logs / name).write_bytes(b"" if number == 2 else b"x")
        os.utime(logs / name, (number, number))
    assert newest_log(tmp_path) == logs / "00000002.BIN"


def test_a_path_that_is_given_is_checked(tmp_path: Path, golden: Golden) -> None:
    with pytest.raises(UserError, match="does not exist"):
        find_firmware("rover", "sitl", str(tmp_path / "none"))
    with pytest.raises(UserError, match="is a directory; give the path of the program in it"):
        find_firmware("rover", "sitl", str(tmp_path))
    plain = tmp_path / "ardurover"
    plain.write_text("a text")
    with pytest.raises(UserError) as refused:
        find_firmware("rover", "sitl", str(plain))
    golden("error", refused.value)
    plain.write_bytes(b"\x7fELF")
    with pytest.raises(UserError, match="is not executable; run `chmod"):
        find_firmware("rover", "sitl", str(plain))
    plain.chmod(0o755)
    with pytest.raises(UserError, match="is a program for another processor"):
        find_firmware("rover", "sitl", str(plain))
    assert find_firmware("rover", "sitl", str(script(tmp_path / "wrapped", ""))) == tmp_path / "wrapped"


def test_it_is_looked_for_on_the_path_and_then_in_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    for variable in ("XITL_ARDUROVER", "XITL_ARDUROVER_LINUX"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(UserError) as refused:
        find_firmware("rover", "sitl")
    golden("error", refused.value)
    with pytest.raises(UserError) as refused:
        find_firmware("rover", "linux")
    golden("second error", refused.value)
    kept = tmp_path / "cache" / "firmware" / "rover" / "stable" / "sitl" / "ardurover"
    kept.parent.mkdir(parents=True)
    kept.write_bytes(Path(sys.executable).resolve().read_bytes()[:64])
    kept.chmod(0o755)
    assert find_firmware("rover", "sitl") == kept
    (tmp_path / "bin").mkdir()
    own = script(tmp_path / "bin" / "ardurover", "")
    assert find_firmware("rover", "sitl") == own
    linux = script(tmp_path / "bin" / "ardurover-linux", "")
    assert find_firmware("rover", "linux") == linux
    monkeypatch.setenv("XITL_ARDUROVER", str(script(tmp_path / "mine", "")))
    assert find_firmware("rover", "sitl") == tmp_path / "mine"
    assert find_firmware("rover", "sitl", str(own)) == own
    assert find_firmware("rover", "linux") == linux
    monkeypatch.setenv("XITL_ARDUROVER_LINUX", str(tmp_path / "none"))
    with pytest.raises(UserError, match=f"^XITL_ARDUROVER_LINUX: {tmp_path / 'none'} does not exist"):
        find_firmware("rover", "linux")


# How ArduRover 4.7 starts: standard error at once, standard output when it ends.
CONSOLE_OF_ROVER = """\
Setting SIM_SPEEDUP=200.000000
bind port 5760 for SERIAL0
{}
Starting SITL: JSON
JSON control interface set to 127.0.0.1:9002
Starting sketch 'Rover'
Starting SITL input
Using Irlock at port : 9005
Skipping port (null)
Skipping port (null)
"""


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        ("bind failed on port 5760 - Address already in use", "bind failed on port 5760 - Address already in use"),
        ("PANIC: Invalid device path: x", "PANIC: Invalid device path: x"),
        ("Defaults changed", "Defaults changed"),
        ("one error\nanother error\nanother error\nit fails", "another error; it fails"),
    ],
)
def test_the_lines_that_tell_why_it_ended_are_given_and_not_the_last_ones(
    tmp_path: Path, trouble: str, said: str, golden: Golden
) -> None:
    program = script(tmp_path / "ardurover", f"sys.stderr.write({CONSOLE_OF_ROVER.format(trouble)!r})\nsys.exit(1)")
    error = wait_for_end(FirmwareProcess(program, [], tmp_path))
    golden("error", error)


def test_one_that_says_only_what_it_always_says_is_not_quoted(tmp_path: Path) -> None:
    program = script(tmp_path / "ardurover", "print('Skipping port (null)')\nsys.exit(1)")
    assert "(exit code 1); see " in str(wait_for_end(FirmwareProcess(program, [], tmp_path)))


def test_one_that_hears_only_while_it_is_served_is_served_until_it_has_ended(tmp_path: Path) -> None:
    body = """
told = []
signal.signal(signal.SIGTERM, lambda *_: told.append(1))
print("ready", flush=True)
while not (told and os.path.exists("frame")):
    time.sleep(0.001)
print("ended in order", flush=True)
"""
    process = FirmwareProcess(script(tmp_path / "rover", body), [], tmp_path)
    assert process.wait_for("ready", timeout_s=PATIENCE_S)
    process.stop(PATIENCE_S, lambda seconds: (tmp_path / "frame").touch())
    assert process.last_line() == "ended in order"
