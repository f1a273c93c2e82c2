"""The joined payloads of the truth against the encoders of each message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from sim_core.frames import quat_normalize, quat_to_matrix
from sim_core.kinematics import Kinematics
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.recorder import Recorder, TruthWriter
from xitl_cli.record.topics import TOPICS
from xitl_cli.record.truth import ODOMETRY, POSE, STATE, TRANSFORM, TruthTable

STAMPS_NS = (0, 1, 1_000_000_000, 123_456_789_012, 2_000_000_000_000_000_000)


def motion(vessels: int, seed: int = 1) -> Kinematics:
    rng = np.random.default_rng(seed)
    quat = quat_normalize(rng.standard_normal((vessels, 4)))
    pos, vel, acc, gyro, angular = rng.standard_normal((5, vessels, 3)) * 100.0
    return Kinematics(pos, vel, acc, quat, quat_to_matrix(quat), gyro, angular)


def at_rest_in_the_origin() -> Kinematics:
    zero, level = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
    return Kinematics(zero, zero, zero, level, quat_to_matrix(level), zero, zero)


@pytest.mark.parametrize("stamp_ns", STAMPS_NS)
@pytest.mark.parametrize("actuators", [0, 1, 4])
@pytest.mark.parametrize("frame", ["base_link", "boat_17/base_link", "x" * 130])
def test_payloads_are_those_of_the_encoders(stamp_ns: int, actuators: int, frame: str) -> None:
    for moving in (motion(3), at_rest_in_the_origin()):
        vessels = len(moving.pos_ned_m)
        table = TruthTable(moving, np.random.default_rng(2).standard_normal((vessels, actuators)))
        rows, frames = range(vessels), [frame] * vessels
        state, odometry = (TOPICS[topic].message_type().encode for topic in (STATE, ODOMETRY))
        assert table.state_payloads(stamp_ns) == [state(stamp_ns, *table.state(row)) for row in rows]
        expected = [odometry(stamp_ns, *table.odometry(row, frame)) for row in rows]
        assert table.odometry_payloads(stamp_ns, frames) == expected
        assert table.pose_payloads(stamp_ns) == [table.pose(stamp_ns, row).encode() for row in rows]
        expected = [table.transform(stamp_ns, row, frame).encode() for row in rows]
        assert table.transform_payloads(stamp_ns, frames) == expected


def test_vessels_together_have_the_values_of_each_alone() -> None:
    together, rotor = motion(40), np.zeros((40, 2))
    table, frames = TruthTable(together, rotor), ["base_link"] * 40
    for row in range(40):
        own = slice(row, row + 1)
        alone = TruthTable(Kinematics(*(getattr(together, name)[own] for name in Kinematics.__slots__)), rotor[own])
        assert table.state_payloads(5)[row] == alone.state_payloads(5)[0]
        assert table.odometry_payloads(5, frames)[row] == alone.odometry_payloads(5, frames[:1])[0]
        assert table.pose_payloads(5)[row] == alone.pose_payloads(5)[0]


def test_who_watches_gets_values_and_the_recording_is_the_same(tmp_path: Path) -> None:
    seen: dict[str, tuple[Any, ...]] = {}
    for name, watched in (("plain", ()), ("watched", (STATE, ODOMETRY, POSE, TRANSFORM))):
        recorder = Recorder(tmp_path / f"{name}.mcap", "none")
        for topic in watched:
            recorder.watch(topic, lambda stamp_ns, *values, topic=topic: seen.update({topic: values}))
        recorder.truth(7_000_000_000, motion(1), np.array([[0.25, -0.5]]))
        recorder.close()
    assert seen[STATE][0] == motion(1).pos_ned_m[0].tolist()
    assert seen[STATE][-1] == [0.25, -0.5]
    assert seen[ODOMETRY][:2] == ("map", "base_link")
    table = TruthTable(motion(1), np.zeros((1, 2)))
    assert seen[POSE][0].encode() == table.pose_payloads(7_000_000_000)[0]
    assert seen[TRANSFORM][0].encode() == table.transform_payloads(7_000_000_000, ["base_link"])[0]
    assert (tmp_path / "plain.mcap").read_bytes() == (tmp_path / "watched.mcap").read_bytes()


def test_vessels_of_several_models_are_written_in_their_order(tmp_path: Path) -> None:
    """The first and the third vessel are rows of one table, the second is a row of another."""
    file, rows = McapFile(tmp_path / "run.mcap", "none"), [(0, 0), (1, 0), (0, 1)]
    recorders = [Recorder(file, vessel=name) for name in ("a", "b", "c")]
    tables = [TruthTable(motion(2, seed=1), np.zeros((2, 2))), TruthTable(motion(1, seed=2), np.zeros((1, 4)))]
    TruthWriter(recorders, rows).write(5, tables)
    file.close()
    with (tmp_path / "run.mcap").open("rb") as stream:
        messages = [(channel.topic, message.data) for _, channel, message in make_reader(stream).iter_messages()]
    expected = [
        tables[table].transform_payloads(5, [f"{name}/base_link"] * (2 - table))[row]
        for name, (table, row) in zip("abc", rows, strict=True)
    ]
    assert [data for topic, data in messages if topic == TRANSFORM] == expected
    states = {topic: data for topic, data in messages if topic.endswith(STATE)}
    assert states == {
        f"/{name}{STATE}": tables[table].state_payloads(5)[row] for name, (table, row) in zip("abc", rows, strict=True)
    }
