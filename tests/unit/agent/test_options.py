"""Options of an agent: from the command line, from a file, and both."""

from __future__ import annotations

from pathlib import Path

import pytest

from agent.options import Options, OptionsError, parse
from agent.wire.transport import open_transport

EVERYTHING = """
[agent]
link = serial:///dev/ttyS4?baud=921600
role = fcu
system-id = 7
gcs = udp://10.0.0.1:14550
      tcp://127.0.0.1:5760
parameters = boat.parm
storage = /var/lib/xitl/kept.json
log-dir = logs
signing-key = keys/ground
link-key = keys/host
controller = boats.heading:Fast
realtime = 70
cpu = 2,3
kind = real
machine = Boat 1: 100 %
silence = 12.5
"""


def test_nothing_said() -> None:
    assert parse([], "agent") == Options()


def test_the_link_is_this_machine_alone_unless_said() -> None:
    with open_transport(Options.link.replace("14660", "0"), listen=True) as transport:
        assert transport.address.startswith("udp://127.0.0.1:")


def test_a_command_line() -> None:
    words = "--link udp://usb0:14660 --system-id 250 --role companion --realtime --cpu 3,1 --kind virtual --silence 0"
    assert parse(words.split(), "agent") == Options(
        link="udp://usb0:14660",
        system_id=250,
        role="companion",
        realtime=50,
        cpus=(1, 3),
        kind="virtual",
        silence_s=0.0,
    )
    assert parse(["--realtime", "99"], "agent").realtime == 99
    assert (parse(["--attached"], "agent").attached, parse([], "agent").attached) == (True, False)


def test_a_file_says_the_same(tmp_path: Path) -> None:
    (tmp_path / "agent.ini").write_text(EVERYTHING)
    assert parse(["--config", str(tmp_path / "agent.ini")], "agent") == Options(
        link="serial:///dev/ttyS4?baud=921600",
        system_id=7,
        ground=("udp://10.0.0.1:14550", "tcp://127.0.0.1:5760"),
        parameters=tmp_path / "boat.parm",
        storage=Path("/var/lib/xitl/kept.json"),
        log_dir=tmp_path / "logs",
        signing_key=tmp_path / "keys/ground",
        link_key=tmp_path / "keys/host",
        controller="boats.heading:Fast",
        realtime=70,
        cpus=(2, 3),
        kind="real",
        machine="Boat 1: 100 %",
        silence_s=12.5,
    )


def test_the_command_line_wins(tmp_path: Path) -> None:
    (tmp_path / "agent.ini").write_text(EVERYTHING)
    given = ["--gcs", "udp://1.2.3.4:5", "--realtime", "10", "--config", str(tmp_path / "agent.ini"), "--log-dir", "/x"]
    options = parse(given, "agent")
    assert (options.ground, options.realtime, options.log_dir) == (("udp://1.2.3.4:5",), 10, Path("/x"))
    assert options.silence_s == 12.5


def test_an_option_that_stands_alone_may_do_so_in_the_file(tmp_path: Path) -> None:
    (tmp_path / "agent.ini").write_text("[agent]\nrealtime =\n")
    assert parse(["--config", str(tmp_path / "agent.ini")], "agent").realtime == 50


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[agent]\nbaud = 5\n", "unknown key baud; use one of after-run, autopilot, controller, cpu, gcs, kind, "),
        ("[agent]\nconfig = x\n", "unknown key config; use one of"),
        ("[agent]\nversion = 1\n", "unknown key version; use one of"),
        ("[agent]\nattached = 1\n", "unknown key attached; use one of"),
        ("[agent]\nrole = cook\n", "role = cook; use one of fcu, companion, bridge"),
        ("[agent]\ncpu = one\n", "cpu = one: one names no processors; write them like 1 or 2,3"),
        ("[agent]\nrealtime = 100\n", "realtime = 100: 100 is not a priority of SCHED_FIFO; use 1 to 99"),
        ("[agent]\nsilence = -1\n", "silence = -1: -1 is not a duration; use seconds, 0 for no limit"),
        ("[boat]\nlink = x\n", "unknown section [boat]; write all under [agent]"),
        ("[DEFAULT]\nlink = x\n", "unknown section [DEFAULT]; write all under [agent]"),
        ("", "has no section [agent]; write it above the options"),
        ("link = x\n", "File contains no section headers."),
        ("[agent]\nlink\n", "write KEY = VALUE under [agent]"),
        ("[agent]\nlink = a\nlink = b\n", "option 'link' in section 'agent' already exists"),
    ],
)
def test_a_file_is_refused_in_one_sentence(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "agent.ini"
    path.write_text(text)
    with pytest.raises(OptionsError) as refusal:
        parse(["--config", str(path)], "agent")
    sentence = str(refusal.value)
    assert sentence.startswith(str(path)) or "agent.ini" in sentence
    assert said in sentence
    assert "\n" not in sentence


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "noise").write_bytes(b"\xff\xfe\x00")
    for name, said in (("missing", "No such file or directory"), ("noise", "not text"), (".", "Is a directory")):
        with pytest.raises(OptionsError, match=said):
            parse(["--config", str(tmp_path / name)], "agent")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--baud 5", "unrecognized arguments: --baud 5; see agent --help"),
        ("--role cook", "argument --role: invalid choice: 'cook'"),
        ("--cpu ,", "argument --cpu: , names no processors; write them like 1 or 2,3; see agent --help"),
        ("--silence soon", "argument --silence: soon is not a duration; use seconds, 0 for no limit"),
        ("--lin udp://127.0.0.1:1", "unrecognized arguments: --lin"),
    ],
)
def test_a_command_line_is_refused_in_one_sentence(words: str, said: str) -> None:
    with pytest.raises(OptionsError) as refusal:
        parse(words.split(), "agent")
    assert str(refusal.value).startswith(said)
