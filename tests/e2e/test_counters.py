"""A counter is declared once: a field in a copy of the packages appears in the message, topic, summary and docs."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from agent.bridges.counts import BridgeCounts
from agent.wire import dialect
from agent.wire.codec import Packer

ROOT = Path(__file__).parents[2]
CONNECTED = '4 its script answers"] = (\n        field(default=0, metadata={"wire": "uint8_t"})\n    )\n'
BRIDGE = (
    '    jammed: Annotated[int, "int64", "jammed frames"] = field(default=0, metadata={"trouble": "were jammed"})\n'
)
IMPAIRED = '        default=None, metadata=counted(SENDER, "lost on purpose")\n    )\n'
LINK = (
    '    fogged: Annotated[Int64, "fogged frames"] | None = '
    'field(default=None, metadata=counted(RECEIVER, "in fog", key="late"))\n'
)
PROGRAM = """
import json, sys
from pathlib import Path
from types import SimpleNamespace
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from agent.bridges.counts import BridgeCounts
from agent.bridges.injector import InjectorCounters
from agent.wire import dialect
from agent.wire.codec import Packer
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from xitl_cli.commands.sim_report import autopilot_rows
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.links.link_accounts import LinkAccounts, LockstepTiming
from xitl_cli.run.nodes.bridge import AutopilotReport

host, agent = (Link(end, 1, number) for number, end in enumerate(memory_pair()))
def over_the_wire(frame):
    agent.transport.send(frame)
    return host.receive()[0]

counts = BridgeCounts.total([InjectorCounters(jammed=3), InjectorCounters(jammed=4)])
status = dialect.MAVLink_xitl_bridge_status_message(time_usec=1, **counts.on_wire())
bridge = BridgeCounts.of_message(over_the_wire(Packer(1, 1).pack(status)))
older = BridgeCounts.of_message(over_the_wire(bytes.fromhex(sys.argv[1])))

accounts = LinkAccounts()
accounts.link = host
names = [name for name in dialect.MAVLink_xitl_node_status_message.fieldnames if name.startswith("frames_")]
node = SimpleNamespace(**{name: number for number, name in enumerate(names)})
sensors, actuators = accounts.reports("", 0, node, LockstepTiming("LC"))

recording = Path("run.mcap")
recorder = Recorder(recording, "lz4")
recorder.write(1, bridge)
recorder.write(2, sensors)
recorder.close()
topics = {}
with recording.open("rb") as file:
    for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
        topics[channel.topic] = message
section = AutopilotReport("ardupilot", bridge=bridge).section([])
shown = dict(autopilot_rows({**section, "log": True}))
print(json.dumps({
    "message": status.get_fieldnames()[-1],
    "crc_extra": status.crc_extra,
    "older": [older.jammed, older.imu_out, older.connected],
    "topic": [topics["/bridge"].jammed, topics["/links"].fogged],
    "summary": [section["bridge"]["jammed"], sensors.section()["fogged"], actuators.section()["fogged"]],
    "reported": node.frames_late,
    "shown": shown["bridge"],
}))
"""


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packages, tools and generated pages, with one more counter of a bridge and of a link."""
    root = tmp_path_factory.mktemp("copied")
    for name in ("agent", "sim_core", "xitl_cli", "tools"):
        shutil.copytree(ROOT / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    (root / "docs").mkdir()
    for page in ("recording.md", "ros.md"):
        shutil.copy(ROOT / "docs" / page, root / "docs" / page)
    for path, before, line in (
        ("agent/bridges/counts.py", CONNECTED, BRIDGE),
        ("xitl_cli/record/topics.py", IMPAIRED, LINK),
    ):
        text = (root / path).read_text(encoding="utf-8")
        assert text.count(before) == 1, f"{path}: the test adds its counter after {before!r}"
        (root / path).write_text(text.replace(before, before + line), encoding="utf-8")
    for tool in ("generate_dialect.py", "generate_topics.py"):
        python(root, f"tools/{tool}")
    return root


def python(root: Path, *arguments: str) -> str:
    command = [sys.executable, *arguments]
    environment = {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def made(copied: Path) -> dict[str, Any]:
    """Results of the copy for both counters, and of the message of an agent without them."""
    counts = BridgeCounts(imu_out=7, connected=5)
    older = Packer(1, 1).pack(dialect.MAVLink_xitl_bridge_status_message(time_usec=1, **counts.on_wire()))
    answer: dict[str, Any] = json.loads(python(copied, "-c", PROGRAM, older.hex()))
    return answer


@pytest.mark.slow
def test_a_counter_that_is_declared_once_is_on_the_wire_in_the_topic_and_in_the_summary(made: dict[str, Any]) -> None:
    assert made["message"] == "jammed"
    assert made["topic"] == [7, made["reported"]]
    assert made["summary"] == [7, made["reported"], 0]
    assert "7 were jammed" in made["shown"]


@pytest.mark.slow
def test_an_agent_without_the_counter_is_still_understood(made: dict[str, Any]) -> None:
    assert made["crc_extra"] == dialect.MAVLink_xitl_bridge_status_message.crc_extra
    assert made["older"] == [0, 7, 5]


@pytest.mark.slow
def test_the_documentation_has_the_counter(copied: Path) -> None:
    page = (copied / "docs" / "recording.md").read_text(encoding="utf-8")
    assert "`jammed` int64 (jammed frames)" in page
    assert "`fogged` int64 (fogged frames)" in page
    wire = (copied / "agent" / "wire" / "xitl.xml").read_text(encoding="utf-8")
    assert '<extensions/>\n      <field type="uint32_t" name="jammed">Jammed frames</field>' in wire
