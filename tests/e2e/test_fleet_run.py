"""A fleet of three models, from its file to recording, summary and logs; twice, and once with an agent elsewhere."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from conftest import running, summary
from mcap.reader import make_reader

import xitl as toolkit
from tests.golden import Golden
from tests.patience import PATIENCE_S

pytestmark = pytest.mark.slow

FLEET = """
extends: [sitl]
clock: {physics_rate_hz: 200}
vessels:
  leader: {mission: {start: {north_m: 0, east_m: 0, heading_deg: 37}, waypoints_ned_m: [[30, 22], [45, 40]]}}
  otter:
    extends: vehicles/otter
    mission: {start: {north_m: 20, east_m: -30, heading_deg: 37}, waypoints_ned_m: [[45, -10]]}
  heron:
    extends: vehicles/heron
    mission: {start: {north_m: -20, east_m: -20, heading_deg: 37}, waypoints_ned_m: [[10, 0]]}
"""
NAMES = ("leader", "otter", "heron")
DURATION_S = 20.0


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> toolkit.Result:
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "fleet.yaml").write_text(FLEET)
    return toolkit.simulate(folder / "fleet.yaml", duration_s=DURATION_S, out=folder / "run")


def topics(recording: Path) -> dict[str, tuple[int, str]]:
    """How many messages, and a digest of them with their stamps, by topic."""
    counts, digests = dict[str, int](), dict[str, Any]()
    with recording.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            digest = digests.setdefault(channel.topic, sha256())
            digest.update(message.log_time.to_bytes(8, "big") + message.publish_time.to_bytes(8, "big") + message.data)
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
    return {topic: (counts[topic], digest.hexdigest()) for topic, digest in digests.items()}


def test_each_sails_its_own_mission_and_all_are_in_one_recording(run: toolkit.Result) -> None:
    vessels = run.summary["vessels"]
    assert tuple(vessels) == NAMES
    assert run.summary["ended"] == "duration reached"
    for name in NAMES:
        assert vessels[name]["track"]["mode"] in ("AUTO", "HOLD")
        assert vessels[name]["track"]["path_m"] > 5.0, name
        assert vessels[name]["mission"]["cross_track_rms_m"] < 5.0, name
        assert vessels[name]["estimation"]["position_rms_m"] < 3.0, name
        assert vessels[name]["system_id"] == NAMES.index(name) + 1
    found = topics(run.recording)
    for name in NAMES:
        assert found[f"/{name}/truth/state"][0] == pytest.approx(50 * DURATION_S, abs=1)
    frames = {row["child_frame_id"] for row in transforms(run.recording)}
    assert {f"{name}/base_link" for name in NAMES} <= frames


def transforms(recording: Path) -> Iterator[dict[str, Any]]:
    with toolkit.open_log(recording) as log:
        table = log["/tf"]
        column = next(name for name in table.columns if name.endswith("child_frame_id"))
        for value in table.values(column):
            yield {"child_frame_id": str(value)}


def test_a_vessel_of_it_is_analysed_with_its_own_log(run: toolkit.Result, xitl: Any, golden: Golden) -> None:
    done = xitl("logs", "analyze", str(run.recording), str(run.directory / "otter/autopilot.bin"), "--json")
    assert done.returncode == 0, done.stderr
    golden("stderr", done.stderr, run=run.directory)
    report = json.loads(done.stdout)
    assert [file.get("vessel") for file in report["files"]] == ["otter", None]
    with run.open_log("otter") as log:
        assert log["/truth/state"]["position_ned_m"][0][:2] == pytest.approx([20.0, -30.0], abs=1.0)
    for name in NAMES:
        with toolkit.open_log(run.directory / name / "autopilot.bin") as own:
            assert len(own["ATT"]) > 100
    compared = toolkit.compare(
        run.recording, run.recording, vessel="leader", vessel_b="heron", of_a="truth", of_b="truth"
    )
    assert compared is not None


def test_a_seed_repeats_it_byte_for_byte_with_an_agent_in_another_process_too(
    run: toolkit.Result, tmp_path: Path
) -> None:
    elsewhere = FLEET.replace(
        "    extends: vehicles/otter\n",
        "    extends: vehicles/otter\n    autopilot: {runs: process, link: 'udp://127.0.0.1:0'}\n",
    )
    assert elsewhere != FLEET
    (tmp_path / "fleet.yaml").write_text(elsewhere)
    again = toolkit.simulate(tmp_path / "fleet.yaml", duration_s=DURATION_S, out=tmp_path / "run")
    assert topics(again.recording) == topics(run.recording)
    for name in NAMES:
        log = f"{name}/autopilot.bin"
        assert (again.directory / log).read_bytes() == (run.directory / log).read_bytes(), name
    of_host = {"links", "nodes"}  # how many bytes a transport counts, and where an agent runs
    for name in NAMES:
        one, other = (
            {key: value for key, value in each.summary["vessels"][name].items() if key not in of_host}
            for each in (run, again)
        )
        assert one == other, name


def test_an_interrupt_ends_all_of_it_and_leaves_what_was_recorded(tmp_path: Path) -> None:
    """With an agent in a process of its own, on lines beside each other; what ended is whole, and nobody is left."""
    elsewhere = FLEET.replace(
        "vehicles/otter\n", "vehicles/otter\n    autopilot: {runs: process, link: 'serial://pty?baud=921600'}\n"
    )
    (tmp_path / "fleet.yaml").write_text(elsewhere)
    with running(tmp_path, "--profile", "fleet.yaml", "--duration", "900") as process:
        started = children_of(process.pid)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, errors) == (130, "")
    assert started
    assert not any(Path(f"/proc/{child}").exists() for child in started)
    told = summary(tmp_path / "run")
    assert (told["ended"], told["error"]) == ("interrupted", None)
    found = topics(tmp_path / "run/run.mcap")
    for name in NAMES:
        assert not told["vessels"][name]["mission"]["completed"]
        assert [link["lost"] for link in told["vessels"][name]["links"]] == [0, 0]
        assert found[f"/{name}/truth/state"][0] == pytest.approx(50 * told["duration_s"], abs=1)
        with toolkit.open_log(tmp_path / "run" / name / "autopilot.bin") as log:
            assert log.span_ns[1] * 1e-9 == pytest.approx(told["duration_s"], abs=0.2)


def children_of(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
