"""The joined payloads of the truth against the encoders of each message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sim_core.frames import quat_normalize, quat_to_matrix
from sim_core.kinematics import Kinematics
from xitl_cli.record.recorder import Recorder
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
        for row in range(vessels):
            state, odometry = (TOPICS[topic].message_type().encode for topic in (STATE, ODOMETRY))
            assert table.state_payload(stamp_ns, row) == state(stamp_ns, *table.state(row))
            assert table.odometry_payload(stamp_ns, row, frame) == odometry(stamp_ns, *table.odometry(row, frame))
            assert table.pose_payload(stamp_ns, row) == table.pose(stamp_ns, row).encode()
            transform = table.transform(stamp_ns, row, frame).encode()
            assert table.transform_payload(stamp_ns, row, frame) == transform


def test_vessels_together_have_the_values_of_each_alone() -> None:
    together, rotor = motion(40), np.zeros((40, 2))
    table = TruthTable(together, rotor)
    for row in range(40):
        own = slice(row, row + 1)
        alone = TruthTable(Kinematics(*(getattr(together, name)[own] for name in Kinematics.__slots__)), rotor[own])
        assert table.state_payload(5, row) == alone.state_payload(5, 0)
        assert table.odometry_payload(5, row, "base_link") == alone.odometry_payload(5, 0, "base_link")
        assert table.pose_payload(5, row) == alone.pose_payload(5, 0)


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
    assert seen[POSE][0].encode() == table.pose_payload(7_000_000_000, 0)
    assert seen[TRANSFORM][0].encode() == table.transform_payload(7_000_000_000, 0, "base_link")
    assert (tmp_path / "plain.mcap").read_bytes() == (tmp_path / "watched.mcap").read_bytes()
