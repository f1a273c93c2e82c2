"""Options of a bridge: what they say, what is missing, what contradicts."""

from __future__ import annotations

import dataclasses
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from agent.assembly import REFUSALS, assemble
from agent.bridges.role import BridgeRole
from agent.options import Options, OptionsError, check_bridge, parse
from agent.wire.memory import memory_pair

MAVLINK = "tcp://127.0.0.1:5760"
WORDS = (
    f"--role bridge --autopilot {MAVLINK} --sensors vectornav --sensor-link serial:///dev/ttyUSB0?baud=921600 "
    "--world udp://127.0.0.1:9002 --outputs 1,3,5 --trim 1480 --span 350 --after-run reboot"
)
FILE = f"""
[agent]
role = bridge
autopilot = {MAVLINK}
sensors = vectornav
sensor-link = serial:///dev/ttyUSB0?baud=921600
world = udp://127.0.0.1:9002
outputs = 1 3 5
trim = 1480
span = 350
after-run = reboot
"""
WANTED = Options(
    role="bridge",
    autopilot=MAVLINK,
    world="udp://127.0.0.1:9002",
    sensors="vectornav",
    sensor_link="serial:///dev/ttyUSB0?baud=921600",
    outputs=(1, 3, 5),
    trim_us=1480.0,
    span_us=350.0,
    after_run="reboot",
)


def test_on_the_command_line_and_in_a_file(tmp_path: Path) -> None:
    path = tmp_path / "agent.ini"
    path.write_text(FILE)
    assert parse(WORDS.split(), "agent") == parse(["--config", str(path)], "agent") == WANTED
    check_bridge(WANTED)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--outputs 0", "0 names no output channels; write them like 1,3"),
        ("--outputs 33", "names no output channels"),
        ("--outputs port", "names no output channels"),
        ("--outputs 1,2,3,4,5,6,7,8,9", "names no output channels"),
        ("--trim nan", "nan is not a pulse width; use microseconds, like 1500"),
        ("--span 0", "0 is not a pulse width"),
        ("--after-run sink", "invalid choice"),
    ],
)
def test_values_that_cannot_be(words: str, sentence: str) -> None:
    with pytest.raises(OptionsError, match=sentence):
        parse(words.split(), "agent")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"autopilot": ""}, "autopilot: a bridge needs the URL of its MAVLink; write it like --autopilot tcp://"),
        ({"sensors": "", "world": "", "sensor_link": ""}, "sensors, world: the autopilot would get no data; give"),
        ({"world": "tcp://127.0.0.1:9002"}, "world: tcp://127.0.0.1:9002 is not a UDP address; write it like"),
        ({"sensors": "px4", "sensor_link": ""}, "world: px4 sets the time of the autopilot itself; leave it out"),
        ({"sensors": "sextant"}, "sensors: sextant: no installed package registers it in xitl.bridges; install its"),
        ({"sensor_link": ""}, "sensor-link: vectornav needs a separate line; write it like --sensor-link serial"),
        ({"sensors": "microstrain7", "sensor_link": ""}, "sensor-link: microstrain7 needs a separate line"),
        ({"sensors": "hil"}, "sensor-link: the sensors hil use none; leave it out"),
        ({"sensors": ""}, "sensor-link: the world uses none; leave it out"),
        ({"role": "fcu"}, "autopilot: the role fcu does not use it; use --role bridge"),
        ({"role": "companion", "autopilot": ""}, "world: the role companion does not use it; use --role bridge"),
        ({"role": "fcu", "autopilot": "", "world": ""}, "sensors: the role fcu does not use it; use --role bridge"),
        (
            {"role": "fcu", "autopilot": "", "world": "", "sensors": "", "sensor_link": ""},
            "after-run: the role fcu has no autopilot to reboot; use --role bridge",
        ),
    ],
)
def test_what_is_missing_or_contradicts(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(OptionsError) as refusal:
        check_bridge(dataclasses.replace(WANTED, **changes))
    assert str(refusal.value).startswith(sentence)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"ground": (MAVLINK,)}, "gcs: a bridge has none; leave it out, or use the role fcu"),
        ({"controller": "a:B"}, "controller: a bridge has none"),
        ({"log_dir": Path("logs")}, "log-dir: a bridge has none"),
        ({"autopilot": "pigeon://coop"}, "pigeon://coop: unknown scheme"),
        ({"world": "udp://127.0.0.1"}, "udp://127.0.0.1: the port is missing"),
    ],
)
def test_what_an_assembly_refuses(changes: dict[str, Any], sentence: str) -> None:
    options = dataclasses.replace(WANTED, sensors="", sensor_link="", world="udp://127.0.0.1:0")
    with ExitStack() as opened, pytest.raises(REFUSALS) as refusal:
        assemble(memory_pair()[1], dataclasses.replace(options, **changes), opened)
    assert str(refusal.value).startswith(sentence)


def test_an_assembled_bridge_serves_a_world() -> None:
    options = Options(role="bridge", autopilot=MAVLINK, world="udp://127.0.0.1:0")
    with ExitStack() as opened:
        node = assemble(memory_pair()[1], options, opened)
        assert isinstance(node.role, BridgeRole)
        assert node.role.addresses[0] == MAVLINK
        assert node.role.addresses[1].startswith("udp://127.0.0.1:")


def test_a_port_of_the_world_that_is_taken() -> None:
    with ExitStack() as opened:
        options = Options(role="bridge", autopilot=MAVLINK, world="udp://127.0.0.1:0")
        taken = assemble(memory_pair()[1], options, opened).role.addresses[1]
        with pytest.raises(REFUSALS, match="the port is in use by another program"):
            assemble(memory_pair()[1], dataclasses.replace(options, world=taken), opened)
