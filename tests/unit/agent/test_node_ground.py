"""The node with ground stations: between runs, in lockstep, over a new run; and that without them nothing changes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from node_host import LogDouble

from agent.fcu.mavlink.channel import MavlinkChannel
from agent.fcu.vehicle.autopilot import Autopilot
from agent.node import AgentNode
from agent.roles import ground_stations
from agent.roles.autopilot import AutopilotRole
from agent.roles.ground_stations import MOST_CLIENTS, GroundStations
from agent.roles.storage import Storage
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from agent.wire.transport import open_transport
from tests.patience import PATIENCE_S

TICK_US = 20_000


class Bench:
    """A node, its host, and a ground station when it has a port for one."""

    def __init__(self, with_ground: bool, storage: Path | None = None, log: LogDouble | None = None) -> None:
        here, there = memory_pair()
        self.frames: list[bytes] = []
        self.host = Link(here, 255, 190, tap=lambda way, frame: self.frames.append(frame) if way == "rx" else None)
        self.ground = GroundStations(["tcp://127.0.0.1:0"], 1, 1) if with_ground else None
        self.storage = None if storage is None else Storage(storage)
        link = Link(there, 1, 1)
        self.role = AutopilotRole(
            lambda: MavlinkChannel(Autopilot()),
            link.send,
            ground=self.ground,
            storage=self.storage,
            make_log=None if log is None else lambda now_ns: log,
        )
        self.node = AgentNode(link, self.role)
        self.station: Link | None = None
        self.tick = 0
        if self.ground is not None:
            self.station = Link(open_transport(self.ground.addresses[0], listen=False), 254, 190)

    def poll(self, seconds: float = 0.0) -> list[Any]:
        """What the ground station hears."""
        heard: list[Any] = []
        until_s = time.monotonic() + seconds
        while True:
            self.node.poll()
            if self.station is not None:
                heard += self.station.receive(0.001)
            if time.monotonic() >= until_s:
                return heard

    def until(self, wanted: Callable[[Any], bool]) -> Any:
        return self.heard_until(wanted)[-1]

    def heard_until(self, wanted: Callable[[Any], bool]) -> list[Any]:
        """What the ground station hears up to the first that is wanted, which is the last."""
        heard: list[Any] = []
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            for message in self.poll():
                heard.append(message)
                if wanted(message):
                    return heard
        raise AssertionError("it did not come")

    def answered(self) -> list[Any]:
        """What the ground station hears before the answer to a question of its own."""
        assert self.station is not None
        self.station.send(mav.MAVLink_param_request_read_message(1, 1, b"WP_SPEED", -1))
        return self.heard_until(of("PARAM_VALUE"))

    def poll_until(self, reached: Callable[[], bool]) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while not reached():
            assert time.monotonic() < until_s, "it was not reached"
            self.poll()

    def run(self, command: int, mode: int = mav.XITL_CLOCK_MODE_LOCKSTEP) -> None:
        self.host.send(mav.MAVLink_xitl_run_message(0, b"bench", command, mode, 1))
        self.node.poll()

    def step(self, ticks: int) -> list[Any]:
        """Lockstep with a vessel at rest, seen by its IMU alone."""
        got: list[Any] = []
        for _ in range(ticks):
            self.tick += 1
            for sample in range(4):
                stamp_us = self.tick * TICK_US + sample * 5000
                self.host.send(mav.MAVLink_xitl_imu_message(stamp_us, (0.0, 0.0, 0.0), (0.0, 0.0, -9.78), 20.0))
            self.host.send(mav.MAVLink_xitl_tick_message(self.tick * TICK_US, self.tick))
            self.node.poll()
            got += self.host.receive()
        return got

    def close(self) -> None:
        if self.station is not None:
            self.station.transport.close()
        if self.ground is not None:
            self.ground.close()
        if self.storage is not None:
            self.storage.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    with closing(Bench(with_ground=True)) as made:
        yield made


def of(name: str) -> Callable[[Any], bool]:
    return lambda message: bool(message.get_type() == name)


def test_between_runs_it_beats_and_serves(bench: Bench) -> None:
    beat = bench.until(of("HEARTBEAT"))
    assert beat.custom_mode == 4
    assert bench.station is not None
    bench.station.send(mav.MAVLink_param_request_list_message(1, 1))
    assert bench.until(of("PARAM_VALUE")).param_index == 0
    assert bench.host.receive() == []


@pytest.mark.medium
def test_in_lockstep_the_ticks_set_the_pace_and_the_heart_beats_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.until(of("HEARTBEAT"))
    monkeypatch.setattr(ground_stations, "SILENCE_NS", 1 << 62)  # however long the ticks below take
    bench.run(mav.XITL_RUN_COMMAND_START)
    bench.answered()
    bench.step(100)
    heard = bench.answered()
    assert 2 <= sum(message.get_type() == "HEARTBEAT" for message in heard) <= 4
    times_ms = [message.time_boot_ms for message in heard if message.get_type() == "ATTITUDE"]
    assert times_ms
    assert max(times_ms) <= 100 * 20
    monkeypatch.undo()
    assert bench.until(of("HEARTBEAT"))  # no tick comes any more
    bench.run(mav.XITL_RUN_COMMAND_STOP)
    assert bench.until(of("SYS_STATUS"))


def test_a_new_run_has_the_same_stations_and_a_new_vehicle(bench: Bench) -> None:
    bench.until(of("HEARTBEAT"))
    assert bench.station is not None
    bench.station.send(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.0, 9))
    assert bench.until(of("PARAM_VALUE")).param_value == 1.0
    bench.run(mav.XITL_RUN_COMMAND_START)
    bench.station.send(mav.MAVLink_param_request_read_message(1, 1, b"WP_SPEED", -1))
    assert bench.until(of("PARAM_VALUE")).param_value == 3.0


def test_the_end_of_a_run_disarms(bench: Bench) -> None:
    bench.until(of("HEARTBEAT"))
    bench.run(mav.XITL_RUN_COMMAND_START)
    bench.step(5)
    assert bench.station is not None
    bench.station.send(mav.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert bench.until(of("COMMAND_ACK")).result == 0
    assert bench.step(1)[-1].flags & mav.XITL_ACTUATOR_FLAGS_ARMED
    bench.run(mav.XITL_RUN_COMMAND_STOP)
    assert bench.until(of("HEARTBEAT")).base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED == 0


def test_a_reboot_starts_over_and_keeps_what_was_set(bench: Bench) -> None:
    bench.until(of("HEARTBEAT"))
    bench.run(mav.XITL_RUN_COMMAND_START)
    bench.step(5)
    assert bench.station is not None
    bench.station.send(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.0, 9))
    bench.station.send(mav.MAVLink_command_long_message(1, 1, 176, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.station.send(mav.MAVLink_command_long_message(1, 1, 246, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert bench.until(lambda m: of("COMMAND_ACK")(m) and m.command == 246).result == 0
    bench.step(60)
    assert bench.until(of("HEARTBEAT")).custom_mode == 4
    bench.station.send(mav.MAVLink_param_request_read_message(1, 1, b"WP_SPEED", -1))
    assert bench.until(of("PARAM_VALUE")).param_value == 1.0


def test_what_is_kept_is_there_in_the_next_run(tmp_path: Path) -> None:
    path = tmp_path / "kept.json"
    with closing(Bench(with_ground=True, storage=path)) as bench:
        bench.until(of("HEARTBEAT"))
        assert bench.station is not None
        assert bench.storage is not None
        bench.station.send(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.0, 9))
        bench.until(of("PARAM_VALUE"))
        bench.run(mav.XITL_RUN_COMMAND_START)
        assert bench.answered()[-1].param_value == 1.0
    assert '"WP_SPEED": 1.0' in path.read_text()


def test_the_flight_log_is_fed() -> None:
    log = LogDouble()
    bench = Bench(with_ground=False, log=log)
    bench.run(mav.XITL_RUN_COMMAND_START)
    bench.host.send(mav.MAVLink_command_long_message(1, 1, 400, 0, 1.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.step(60)
    bench.run(mav.XITL_RUN_COMMAND_STOP)
    assert {name: log.calls[name] for name in ("start", "close", "log_task_stats")} == {
        "start": 1,
        "close": 1,
        "log_task_stats": 2,
    }
    assert log.calls["log_cycle"] == 61
    assert log.calls["log_imu"] >= 200
    assert log.calls["log_event"] >= 2  # armed by force, disarmed at the end


@pytest.mark.medium
def test_the_host_hears_the_same_with_and_without_ground_stations() -> None:
    """But for the statistics of the one task more."""
    heard = []
    for with_ground in (False, True):
        with closing(Bench(with_ground)) as bench:
            if with_ground:
                bench.until(of("HEARTBEAT"))
            bench.run(mav.XITL_RUN_COMMAND_START)
            bench.step(200)
            bench.run(mav.XITL_RUN_COMMAND_STOP)
            bench.host.receive()
        kept = [frame for frame in bench.frames if int.from_bytes(frame[7:10], "little") < 54000 or frame[7] == 0xF6]
        heard.append([frame[:4] + frame[5:-2] for frame in kept if b"XITL" not in frame])
    assert len(heard[0]) > 200
    assert heard[0] == heard[1]


@pytest.mark.medium
@settings(max_examples=60)
@given(st.lists(st.binary(max_size=400), max_size=8))
def test_bytes_of_any_kind_from_a_station_raise_nothing(chunks: list[bytes]) -> None:
    bench = _shared()
    assert bench.station is not None
    for chunk in chunks:
        bench.station.transport.send(chunk)
        bench.node.poll()
        bench.station.receive()
    bench.node.poll()
    assert math.isfinite(bench.role.channel.autopilot.state.estimate.yaw_rad)


_kept: list[Bench] = []


def _shared() -> Bench:
    if not _kept:
        _kept.append(Bench(with_ground=True))
    return _kept[0]


def teardown_module() -> None:
    for one in _kept:
        one.close()


def test_what_stations_miss_reaches_the_host_counted_from_the_start_of_the_run(bench: Bench) -> None:
    """Idle stations that make room for others; none of them calls again."""
    ground = bench.ground
    assert ground is not None
    assert bench.station is not None
    bench.poll_until(lambda: ground.counters.connected == 1)
    bench.station.transport.close()
    bench.station = None
    bench.poll_until(lambda: ground.counters.connected == 0)

    def missed(command: int) -> int:
        bench.run(command)
        status = [message for message in bench.host.receive() if message.get_type() == "XITL_NODE_STATUS"][-1]
        assert status.events_lost == 0
        return int(status.stations_missed)

    made_room = 0
    with ExitStack() as opened:

        def call() -> None:
            """One more, and wait until it is in: the system holds a few only."""
            counts = ground.counters
            opened.enter_context(open_transport(ground.addresses[0], listen=False)).receive()
            bench.poll_until(lambda: sum(ground.counters[:3]) > sum(counts[:3]))

        for _ in range(MOST_CLIENTS):
            call()
        for number in (2, 3):
            bench.run(mav.XITL_RUN_COMMAND_START)
            bench.host.receive()
            for _ in range(number):
                call()
            made_room += number
            assert ground.counters.dropped == made_room
            assert missed(mav.XITL_RUN_COMMAND_HELLO) == number
