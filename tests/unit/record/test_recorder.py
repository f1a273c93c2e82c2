"""A recording written here and read back by the `mcap` library and its ROS 2 decoder."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from agent.bridges.counts import BridgeCounts
from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics
from xitl_cli.errors import UserError
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import (
    ActuatorAge,
    ClockExchange,
    FaultEvent,
    LinkReport,
    MotionEstimate,
    MotorCommand,
    NodeState,
    TakeoverReport,
    TaskMissEvent,
    TaskTiming,
)


def motion(north: float = 3.0) -> Kinematics:
    quat = euler_to_quat(np.array([[0.0, 0.0, np.pi / 2]]))  # heading east
    zero = np.zeros((1, 3))
    return Kinematics(
        pos_ned_m=np.array([[north, 4.0, -0.5]]),
        vel_ned_mps=np.array([[0.0, 2.0, 0.0]]),
        acc_ned_mps2=zero,
        quat_ned_frd=quat,
        rot_ned_frd=quat_to_matrix(quat),
        gyro_frd_radps=np.array([[0.0, 0.0, 0.1]]),
        angular_acc_frd_radps2=zero,
    )


def everything(recorder: Recorder, stamp_ns: int = 2_500_000_000) -> None:
    recorder.truth(stamp_ns, motion(), np.array([[0.25, -0.5]]))
    recorder.fix(stamp_ns, -8.8, -63.95, 70.0)
    recorder.environment(stamp_ns, np.array([0.5, 0.0, 0.0]), np.array([-3.0, 1.0, 0.0]), 0.07)
    recorder.estimate(
        stamp_ns, MotionEstimate(np.array([3.1, 4.0, -0.5]), np.zeros(3), motion().quat_ned_frd[0], np.zeros(3))
    )
    recorder.actuators(
        stamp_ns, MotorCommand((0.3, -0.6), armed=True, failsafe=False, age_s=0.02), "propeller 0, rudder 0"
    )
    recorder.frame_sent(stamp_ns, b"\xfd123")
    recorder.frame_received(stamp_ns, b"\xfd45")
    recorder.write(stamp_ns, TaskTiming("LC", "control", 50.0, 100, 2, 0.001, 0.0002, 0.0009))
    recorder.write(stamp_ns, ClockExchange("LC", 7, 11, 12, 0.0005, 0.25, -3.5))
    recorder.log(stamp_ns, 4, "autopilot", "GNSS lost")
    recorder.flush_if_due()


def read_all(path: Path) -> dict[str, list]:
    with path.open("rb") as file:
        topics: dict[str, list] = {}
        for _, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory(), _Raw()]
        ).iter_decoded_messages():
            topics.setdefault(channel.topic, []).append((message.log_time, decoded))
    return topics


class _Raw:
    def decoder_for(self, encoding, schema):
        return bytes


@pytest.mark.parametrize(
    ("deviations", "variances"),
    [
        ((None, None), [1e6, 1e6, 1e6, 1e6]),
        ((np.array([0.5, 0.25, 2.0]), None), [0.0625, 0.25, 4.0, 1e6]),
        ((np.array([0.5, 0.25, 2.0]), 0.5), [0.0625, 0.25, 4.0, 0.25]),
    ],
)
def test_an_estimate_has_a_large_variance_of_what_the_autopilot_does_not_state(
    tmp_path: Path, deviations: tuple[np.ndarray | None, float | None], variances: list[float]
) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    level = motion().quat_ned_frd[0]
    recorder.estimate(1, MotionEstimate(np.zeros(3), np.zeros(3), level, np.zeros(3), *deviations))
    recorder.truth(1, motion(), np.array([[0.0, 0.0]]))
    recorder.close()
    topics = read_all(tmp_path / "run.mcap")
    estimate, truth = topics["/estimate/odometry"][0][1], topics["/truth/odometry"][0][1]
    pose, twist = (np.reshape(each.covariance, (6, 6)) for each in (estimate.pose, estimate.twist))
    assert np.diag(pose).tolist() == [*variances[:3], 1e6, 1e6, variances[3]]
    assert np.diag(twist).tolist() == [1e6] * 6
    assert np.count_nonzero(pose) == np.count_nonzero(twist) == 6
    assert not np.any(truth.pose.covariance)
    assert not np.any(truth.twist.covariance)


def test_every_topic_reads_back_with_its_values(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    everything(recorder)
    recorder.close()
    topics = read_all(tmp_path / "run.mcap")
    assert all(stamp == 2_500_000_000 for messages in topics.values() for stamp, _ in messages)
    state = topics["/truth/state"][0][1]
    assert (state.stamp.sec, state.stamp.nanosec) == (2, 500_000_000)
    assert list(state.position_ned_m) == [3.0, 4.0, -0.5]
    assert list(state.rotor) == [0.25, -0.5]
    odometry = topics["/truth/odometry"][0][1]
    assert odometry.header.frame_id == "map"
    position, attitude = odometry.pose.pose.position, odometry.pose.pose.orientation
    assert (position.x, position.y, position.z) == (4.0, 3.0, 0.5)  # ENU
    # A vessel that heads east looks along x of ENU: no rotation, and it moves straight ahead in its own frame.
    assert (abs(attitude.w), attitude.x, attitude.y, attitude.z) == pytest.approx((1, 0, 0, 0), abs=1e-12)
    assert odometry.twist.twist.linear.x == pytest.approx(2.0)
    assert odometry.twist.twist.angular.z == pytest.approx(-0.1)  # to starboard is clockwise, z is up
    assert list(topics["/environment"][0][1].wind_ned_mps) == [-3.0, 1.0, 0.0]
    actuators = topics["/actuators"][0][1]
    assert (list(actuators.command), actuators.armed, actuators.age_s) == ([0.3, -0.6], 1, 0.02)
    assert actuators.names == "propeller 0, rudder 0"
    assert bytes(topics["/link/agent/tx"][0][1].frame) == b"\xfd123"
    assert bytes(topics["/link/agent/rx"][0][1].frame) == b"\xfd45"
    task = topics["/tasks"][0][1]
    assert (task.node, task.task, task.missed, task.run_max_s) == ("LC", "control", 2, 0.0009)
    clock = topics["/clocks"][0][1]
    assert (clock.node, clock.sample, clock.host_ns, clock.node_ns, clock.drift_ppm) == ("LC", 7, 11, 12, -3.5)
    assert {"/tf", "/truth/pose", "/truth/fix", "/log"} <= topics.keys()


def test_an_age_that_cannot_be_told_is_not_zero(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    recorder.actuators(5, MotorCommand((0.0, 0.0), age_s=None), "propeller 0, propeller 1")
    recorder.close()
    assert np.isnan(read_all(tmp_path / "run.mcap")["/actuators"][0][1].age_s)


def test_what_a_board_and_its_link_report_reads_back(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4", links=("agent", "standby"))
    histogram = tuple(range(16))
    recorder.write(
        1, TaskTiming("LC", "control", 50.0, 9, 3, 0.1, 0.2, 0.3, 2, 0.05, 7, None, histogram, histogram[::-1])
    )
    recorder.write(2, TaskMissEvent("LC", "control", 41, 10, 20, 30, 2))
    recorder.write(3, ClockExchange("LC", 7, 11, 12, 0.5, 0.25, -3.5, 1e-6, 2e-4, 3e-4, 1))
    recorder.write(4, LinkReport("standby sensors", 10, 8, 2, 1, 3, 4, 5, 6, 7, 9, 0.001, 0.002, 0.003))
    recorder.write(5, LinkReport("actuators", 10, None))
    recorder.write(6, ActuatorAge(100, 3, 2, 0.004, 0.005, 0.006))
    recorder.write(
        7, NodeState("agent", "LS,LC,LA", "real", "BeagleBone", "6.1-rt", "1.2", 31.5, 8.0, 0.3, 51.0, True, "rt")
    )
    recorder.write(8, NodeState("agent", "HC", "virtual", "x86_64", "6.1", "1.2"))
    recorder.write(9, TakeoverReport("agent", "standby", 0.31, 0.05))
    recorder.write(10, FaultEvent("link-cut", active=True))
    recorder.frame_sent(11, b"\xfd1", link="standby")
    recorder.frame_received(12, b"\xfd2", link="standby", sent_ns=9)
    recorder.close()
    topics = {
        topic: [message for _, message in messages] for topic, messages in read_all(tmp_path / "run.mcap").items()
    }
    task = topics["/tasks"][0]
    assert (task.skipped, task.start_jitter_mean_s, task.worst_run_ns, task.worst_start_ns) == (2, 0.05, 7, -1)
    assert (list(task.start_histogram), list(task.run_histogram)) == (list(histogram), list(histogram[::-1]))
    miss = topics["/misses"][0]
    assert (miss.node, miss.task, miss.cycle, miss.skipped) == ("LC", "control", 41, 2)
    assert (miss.due_ns, miss.start_ns, miss.end_ns) == (10, 20, 30)
    clock = topics["/clocks"][0]
    assert (clock.residual_s, clock.path_delay_s, clock.asymmetry_bound_s, clock.steps) == (1e-6, 2e-4, 3e-4, 1)
    whole, half = topics["/links"]
    assert (whole.name, whole.sent, whole.received, whole.lost) == ("standby sensors", 10, 8, 2)
    assert (whole.gaps, whole.late, whole.repeated, whole.dropped) == (1, 3, 4, 5)
    assert (whole.unsent, whole.refused, whole.impaired) == (6, 7, 9)
    assert (whole.latency_p50_s, whole.latency_p99_s, whole.latency_max_s) == (0.001, 0.002, 0.003)
    assert (half.sent, half.received, half.impaired) == (10, -1, -1)
    assert np.isnan([half.latency_p50_s, half.latency_max_s]).all()
    age = topics["/actuators/age"][0]
    assert (age.exchanges, age.stale, age.longest_stale) == (100, 3, 2)
    assert (age.age_p50_s, age.age_p99_s, age.age_max_s) == (0.004, 0.005, 0.006)
    board, companion = topics["/nodes"]
    assert (board.node, board.nodes, board.kind, board.machine) == ("agent", "LS,LC,LA", "real", "BeagleBone")
    assert (board.kernel, board.version, board.flags, board.running) == ("6.1-rt", "1.2", "rt", 1)
    assert (board.memory_mib, board.cpu_percent, board.load, board.temperature_c) == (31.5, 8.0, 0.3, 51.0)
    assert (companion.nodes, companion.running, companion.flags) == ("HC", 0, "")
    assert np.isnan([companion.memory_mib, companion.temperature_c]).all()
    takeover = topics["/takeovers"][0]
    assert (takeover.from_node, takeover.to_node, takeover.silent_s, takeover.step) == ("agent", "standby", 0.31, 0.05)
    assert (topics["/faults"][0].fault, topics["/faults"][0].active) == ("link-cut", 1)
    assert bytes(topics["/link/standby/tx"][0].frame) == b"\xfd1"
    assert bytes(topics["/link/standby/rx"][0].frame) == b"\xfd2"
    assert not {"/link/agent/tx", "/link/agent/rx"} & topics.keys()


def test_the_counts_of_a_bridge_read_back_by_name(tmp_path: Path) -> None:
    names = [field.name for field in fields(BridgeCounts)]
    counts = {name: 10 + number for number, name in enumerate(names)}
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    recorder.write(7, BridgeCounts(**counts))
    recorder.close()
    ((stamp_ns, bridge),) = read_all(tmp_path / "run.mcap")["/bridge"]
    assert stamp_ns == 7
    assert {name: getattr(bridge, name) for name in names} == counts


def test_a_frame_keeps_when_it_was_sent_beside_when_it_came(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    recorder.frame_received(50, b"\xfd1", sent_ns=20)
    recorder.frame_received(60, b"\xfd1", sent_ns=-5)  # sent before simulation time 0
    recorder.frame_received(70, b"\xfd1")
    recorder.frame_sent(80, b"\xfd1")
    recorder.close()
    with (tmp_path / "run.mcap").open("rb") as file:
        stamps = [(message.log_time, message.publish_time) for _, _, message in make_reader(file).iter_messages()]
    assert stamps == [(50, 20), (60, 0), (70, 70), (80, 80)]


def test_what_was_flushed_survives_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    now_s = [0.0]
    file = McapFile(path, "lz4", now_s=lambda: now_s[0])
    log = file.ros_channel("/x", "t/msg/X", "float64 x")
    log(b"first", 1)
    now_s[0] = 1.0
    file.flush_if_due()
    log(b"second", 2)
    now_s[0] = 1.9
    file.flush_if_due()  # not due: the second message is still only in memory
    copy = tmp_path / "killed.mcap"
    copy.write_bytes(path.read_bytes())
    kept = []
    with copy.open("rb") as stream:
        try:
            for record in StreamReader(stream).records:
                if isinstance(record, Message):
                    kept.append(record.data)
        except EndOfFile:
            pass
    assert kept == [b"first"]
    file.close()


def test_an_existing_recording_is_never_written_over(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"precious")
    with pytest.raises(UserError, match="File exists"):
        McapFile(tmp_path / "run.mcap")
    assert (tmp_path / "run.mcap").read_bytes() == b"precious"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = Path.open
    monkeypatch.setattr(Path, "open", lambda self, mode: original(Path("/dev/full"), "wb"))
    file = McapFile(tmp_path / "run.mcap")
    log = file.ros_channel("/x", "t/msg/X", "float64 x")
    with pytest.raises(UserError, match=r"run.mcap: .*No space left on device.*free space"):
        log(os.urandom(4_000_000), 1)
    log(os.urandom(4_000_000), 2)  # said once
    file.close()
