"""The table of topics: its page is current, names carry units, and a vessel's name has its place."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from foxglove import messages
from mcap.reader import make_reader

from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import (
    TOPICS,
    VESSEL_FRAME,
    FaultEvent,
    OdometryMessage,
    Topic,
    topic_name,
    vessel_name,
)

ROOT = Path(__file__).parents[3]
SHARES = {"rotor", "command", "step", "load", "label_share"}
"""Numbers without a unit."""


def generator() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate_topics", ROOT / "tools" / "generate_topics.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", ["recording.md", "ros.md"])
def test_the_page_is_current(page: str) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert generator().generated(page, text) == text, "run `make pages`"


def test_a_page_without_its_marks_is_refused() -> None:
    with pytest.raises(SystemExit, match="has no marks <!-- topics"):
        generator().generated("recording.md", "| topic |")


@pytest.mark.parametrize("topic", TOPICS.values(), ids=lambda topic: topic.name)
def test_every_topic_says_what_it_is_in_a_known_message(topic: Topic) -> None:
    assert topic.rate
    assert topic.meaning
    if topic.fields is None:
        assert hasattr(messages, topic.schema.removeprefix("foxglove."))
        with pytest.raises(ValueError, match="not a ROS 2 topic"):
            topic.message_type()
    elif topic.fields is not OdometryMessage:
        for field in topic.message_type().fields:
            quaternion = field.name.startswith("quaternion")
            assert field.unit or quaternion or not field.type.startswith("float") or field.name in SHARES
            assert quaternion == (field.frame == "NED ← FRD")


def test_a_vessels_name_stands_before_what_is_its_own(tmp_path: Path) -> None:
    assert topic_name(TOPICS["/tasks"]) == "/tasks"
    assert topic_name(TOPICS["/tasks"], "alpha") == "/alpha/tasks"
    assert topic_name(TOPICS["/link/{link}/tx"], "alpha", "standby") == "/alpha/link/standby/tx"
    assert topic_name(TOPICS["/tf"], "alpha") == "/tf"
    assert (vessel_name(VESSEL_FRAME), vessel_name(VESSEL_FRAME, "alpha")) == ("base_link", "alpha/base_link")
    recorder = Recorder(tmp_path / "run.mcap", "lz4", vessel="alpha")
    recorder.fix(1, 2.0, 3.0, 4.0)
    recorder.write(2, FaultEvent("link-cut", active=True))
    recorder.frame_sent(3, b"\xfd")
    recorder.log(4, 6, "run", "goes on")
    recorder.close()
    with (tmp_path / "run.mcap").open("rb") as file:
        found = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert found == ["/alpha/truth/fix", "/alpha/faults", "/alpha/link/agent/tx", "/log"]


def test_a_recording_without_messages_has_the_topics_of_every_run(tmp_path: Path) -> None:
    """Battery, waves, pace, perception, bodies, contacts and other vessels add theirs with their first message."""
    Recorder(tmp_path / "run.mcap", "none", links=("agent",)).close()
    with (tmp_path / "run.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert sorted(channel.topic for channel in summary.channels.values()) == [
        "/actuators", "/actuators/age", "/autopilot/events", "/bridge", "/clocks", "/environment",
        "/estimate/odometry", "/faults", "/link/agent/rx", "/link/agent/tx", "/links", "/log", "/misses", "/nodes",
        "/scene", "/takeovers", "/tasks", "/tf", "/truth/fix", "/truth/odometry", "/truth/pose", "/truth/state",
    ]  # fmt: skip
