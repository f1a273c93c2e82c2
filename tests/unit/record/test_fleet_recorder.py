"""Several vessels in one recording, and reading one of them as if it were alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader

from xitl_cli.logs import open_log
from xitl_cli.logs.model.errors import LogError
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import FaultEvent, MotorCommand


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    path = tmp_path / "run.mcap"
    file = McapFile(path, "lz4")
    vessels = {name: Recorder(file, links=("agent",), vessel=name) for name in ("alpha", "beta")}
    run = Recorder(file, from_start=False)
    run.metadata("xitl", {"vessels": "alpha, beta"})
    run.log(1, 6, "run", "begins")
    for stamp, (name, recorder) in enumerate(vessels.items(), start=2):
        recorder.actuators(stamp, MotorCommand((0.1 * stamp, 0.0)), "port, starboard")
        recorder.fix(stamp, 1.0, 2.0, 3.0)
        recorder.log(stamp, 6, "autopilot", f"{name} is ready")
        recorder.frame_sent(stamp, b"\xfd")
    vessels["beta"].write(9, FaultEvent("link-cut", active=True))
    run.close()
    return path


def test_topics_bear_the_vessels_name_and_what_all_share_is_there_once(fleet: Path) -> None:
    with fleet.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        rows = [(channel.topic, message.log_time) for _, channel, message in reader.iter_messages()]
    topics = [channel.topic for channel in summary.channels.values()]
    assert len(topics) == len(set(topics))
    assert {"/tf", "/log", "/alpha/truth/state", "/beta/truth/state", "/beta/link/agent/rx"} <= set(topics)
    assert "/truth/state" not in topics
    assert ("/alpha/actuators", 2) in rows
    assert ("/beta/actuators", 3) in rows
    schemas = {channel.topic: channel.schema_id for channel in summary.channels.values()}
    assert schemas["/alpha/truth/state"] == schemas["/beta/truth/state"]


def test_one_vessel_is_read_as_if_it_were_alone(fleet: Path) -> None:
    with open_log(fleet) as every:
        assert (every.vessels, every.vessel) == (("alpha", "beta"), "")
        assert {"/alpha/actuators", "/beta/actuators", "/log"} <= set(every.tables)
        assert list(every["/log"]["name"]) == ["run", "alpha/autopilot", "beta/autopilot"]
    with open_log(fleet, "beta") as beta:
        assert set(beta.tables) == {"/actuators", "/truth/fix", "/log", "/link/agent/tx", "/faults"}
        assert beta["/actuators"]["command"][0].tolist() == [pytest.approx(0.3), 0.0]
        assert list(beta["/log"]["message"]) == ["begins", "beta is ready"]
        assert "/link/agent/rx" in beta.rowless
        assert not any("alpha" in name for name in (*beta.tables, *beta.rowless))
    with open_log(fleet, "") as first:
        assert first.vessel == "alpha"


def test_a_vessel_that_is_not_there_is_refused_by_the_names_of_those_that_are(fleet: Path, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="has no vessel 'gamma'; choose from alpha, beta"):
        open_log(fleet, "gamma")
    alone = Recorder(tmp_path / "alone.mcap", "lz4")
    alone.fix(1, 1.0, 2.0, 3.0)
    alone.close()
    with pytest.raises(LogError, match="has one vessel only"):
        open_log(tmp_path / "alone.mcap", "alpha")
    with open_log(tmp_path / "alone.mcap", "") as log:
        assert log.vessel == ""


class Mirror:
    """Shows nothing."""

    def open_channel(self, *described: object) -> None:
        return None


def test_several_watch_a_topic_that_is_opened_later(tmp_path: Path) -> None:
    """Of one of several vessels a topic begins with its first message."""
    run = Recorder(tmp_path / "run.mcap", "lz4", links=())
    vessel, seen = run.of_vessel("alpha"), list[tuple[str, int]]()
    vessel.watch("/faults", lambda stamp_ns, *values: seen.append(("first", stamp_ns)))
    vessel.watch("/faults", lambda stamp_ns, *values: seen.append(("second", stamp_ns)))
    vessel.write(5, FaultEvent("link-cut", active=True))
    run.close()
    assert sorted(seen) == [("first", 5), ("second", 5)]


def test_what_reads_a_topic_during_the_run_is_known(tmp_path: Path) -> None:
    run = Recorder(tmp_path / "run.mcap", "lz4", links=())
    vessel = run.of_vessel("alpha")
    vessel.watch("/faults", lambda stamp_ns, *values: None)
    assert vessel.read_in_run("/faults", "/clocks")
    assert not vessel.read_in_run("/clocks")
    assert not run.read_in_run("/faults")  # another vessel's
    run.close()
    mirrored = Recorder(McapFile(tmp_path / "mirrored.mcap", mirrors=(Mirror(),)))
    assert mirrored.read_in_run("/clocks")
    mirrored.close()
