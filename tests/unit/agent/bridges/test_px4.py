from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from time import monotonic
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from agent.bridges import px4
from agent.bridges.px4 import FIRST_US, Px4Injector, Px4Line
from agent.bridges.vehicle_link import VehicleLink
from agent.timing.clock import TickClock
from agent.wire import dialect as mav
from tests.doubles.px4 import Px4Double, calling
from tests.golden import Golden
from tests.patience import PATIENCE_S, let_pass, wait_until

MS = 1_000_000
IMU_NS, TICK_NS = 5 * MS, 10 * MS


class Bridge:
    """The injector in lockstep, as the role drives it, with a vessel whose motion is told by its samples."""

    def __init__(self, injector: Px4Injector) -> None:
        self.injector = injector
        self.said: list[str] = []
        self.begin()

    def begin(self) -> None:
        self.now_ns = 0
        self.injector.reset(TickClock(), True, self.say)

    def say(self, severity: int, text: str) -> None:
        self.said.append(text)

    @property
    def port(self) -> int:
        return int(self.injector.addresses[0].rpartition(":")[2])

    def sample(self, stamp_ns: int) -> None:
        self.injector.handle(imu(stamp_ns), stamp_ns)

    def tick(self) -> bool:
        """An exchange: samples up to it, then the tick, asked for again as the host does."""
        self.now_ns += TICK_NS
        for stamp_ns in range(self.now_ns - TICK_NS + IMU_NS, self.now_ns + 1, IMU_NS):
            self.sample(stamp_ns)
        return self.again()

    def again(self) -> bool:
        return any(self.injector.advance(self.now_ns) for _ in range(20))


def acceleration_of(stamp_ns: int) -> float:
    return (stamp_ns // MS % 400) / 512 - 0.25


def imu(stamp_ns: int) -> Any:
    return mav.MAVLink_xitl_imu_message(
        stamp_ns // 1000, [0.01, 0.02, 0.125], [acceleration_of(stamp_ns), 0.5, -9.8], 21.0
    )


class ToldVehicle(VehicleLink):
    """A line to nobody; `tell` stands for messages of the autopilot."""

    def __init__(self) -> None:
        super().__init__("udp://127.0.0.1:9")
        self.taps: list[Callable[[Any], object]] = []

    def add_tap(self, tap: Callable[[Any], object]) -> None:
        self.taps.append(tap)

    def tell(self, message: Any) -> None:
        for tap in self.taps:
            tap(message)


def listening(vehicle: VehicleLink) -> Px4Injector:
    return Px4Injector(vehicle, Px4Line("tcp://127.0.0.1:0"))


@pytest.fixture
def vehicle() -> Iterator[ToldVehicle]:
    made = ToldVehicle()
    yield made
    made.close()


@pytest.fixture
def bridge(vehicle: ToldVehicle, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bridge]:
    monkeypatch.setattr(px4, "PATIENCE_S", 5.0)  # a busy machine is no silent autopilot
    injector = listening(vehicle)
    yield Bridge(injector)
    injector.close()


# Lockstep with a program


@pytest.mark.parametrize("loop_us", [0, 10_000, 20_000])
@pytest.mark.parametrize("delay_s", [0.0, 0.002])
def test_px4_runs_in_step_at_the_rate_of_its_own_loop(bridge: Bridge, loop_us: int, delay_s: float) -> None:
    with calling(Px4Double(loop_us=loop_us, delay_s=delay_s), bridge.port) as double:
        for _ in range(100):
            assert bridge.tick()
            if bridge.now_ns <= 100 * MS:
                continue
            # Once its rhythm is known: the output that was due last, from the first sample on, is there at the tick.
            put_out_ns = bridge.now_ns - (bridge.now_ns - IMU_NS) % max(loop_us * 1000, IMU_NS)
            assert double.clock_us * 1000 >= FIRST_US * 1000 + put_out_ns
            commands = bridge.injector.commands()
            assert commands is not None
            assert commands[0] == pytest.approx(acceleration_of(put_out_ns), abs=1e-6)
    assert double.steps_back == 0
    counts = bridge.injector.counts
    assert (counts.imu_out, counts.unsent, counts.restarts, counts.junk) == (200, 0, 0, 0)
    assert counts.outputs_in >= 200 * 5_000 // max(loop_us, 5_000) - 1
    assert counts.taken
    assert bridge.said == []


def test_every_sample_waits_for_its_output(bridge: Bridge) -> None:
    with calling(Px4Double(), bridge.port):
        for _ in range(20):
            bridge.tick()
        for _ in range(50):
            bridge.tick()
            commands = bridge.injector.commands()
            assert commands is not None
            assert commands[:2] == pytest.approx((acceleration_of(bridge.now_ns), 0.125), abs=1e-6)


@pytest.mark.parametrize("quiet_us", [(0, 300_000), (200_000, 400_000)])
def test_px4_may_be_silent_at_its_start_and_while_disarmed(
    bridge: Bridge, monkeypatch: pytest.MonkeyPatch, quiet_us: tuple[int, int]
) -> None:
    monkeypatch.setattr(px4, "PATIENCE_S", 0.5)
    with calling(Px4Double(quiet_us=[quiet_us]), bridge.port) as double:
        for _ in range(60):
            assert bridge.tick()
        assert double.clock_us == FIRST_US + bridge.now_ns // 1000
        commands = bridge.injector.commands()
    assert commands is not None
    assert commands[0] == pytest.approx(acceleration_of(bridge.now_ns), abs=1e-6)
    assert double.steps_back == 0


def test_a_silent_px4_gets_the_real_time_that_it_would_have_had(bridge: Bridge) -> None:
    with calling(Px4Double(quiet_us=[(0, 10_000_000)]), bridge.port):
        assert bridge.tick()
        began_s = monotonic()
        for _ in range(20):
            assert bridge.tick()
        took_s = monotonic() - began_s
    assert took_s > 0.9 * 20 * TICK_NS * 1e-9  # a bound from below: nothing is judged for being slow
    assert bridge.injector.commands() == (0.0,) * 16


def test_what_is_late_is_not_caught_up_while_px4_is_silent(bridge: Bridge) -> None:
    """A burst would be lost on its estimator: each sample comes no sooner after the last than its time."""
    with calling(Px4Double(quiet_us=[(0, 10_000_000)]), bridge.port):
        assert bridge.tick()
        let_pass(0.2)  # the host stands still
        began_s = monotonic()
        for _ in range(10):
            assert bridge.tick()
        took_s = monotonic() - began_s
    assert took_s > 0.9 * 10 * TICK_NS * 1e-9 / px4.PACE


def test_after_the_run_px4_gets_samples_until_it_has_disarmed(bridge: Bridge) -> None:
    with calling(Px4Double(quiet_us=[(200_000, 10_000_000)]), bridge.port) as double:
        for _ in range(10):
            assert bridge.tick()
        for stamp_ns in range(110 * MS, 1110 * MS, 10 * MS):
            wait_until(lambda stamp_ns=stamp_ns: bridge.injector.run_on(stamp_ns), "PX4 is not served", look_s=0.0)
        assert FIRST_US + 200_000 < double.clock_us < FIRST_US + 300_000
        assert double.sensors[-1].xacc == pytest.approx(acceleration_of(100 * MS))
    assert double.steps_back == 0


def test_outputs_end_when_px4_says_that_it_is_disarmed(bridge: Bridge, vehicle: ToldVehicle) -> None:
    """It puts out nothing new then, and what it put out last would stay."""
    with calling(Px4Double(), bridge.port):
        for _ in range(20):
            bridge.tick()
        assert bridge.injector.commands() != (0.0,) * 16
        vehicle.tell(heartbeat(armed=True))
        assert bridge.injector.commands() != (0.0,) * 16
        vehicle.tell(heartbeat(armed=False))
        assert bridge.injector.commands() == (0.0,) * 16


def heartbeat(armed: bool) -> Any:
    return mav.MAVLink_heartbeat_message(10, mav.MAV_AUTOPILOT_PX4, 128 if armed else 0, 0, 4, 3)


def test_disarmed_outputs_command_nothing(bridge: Bridge) -> None:
    with calling(Px4Double(armed=False), bridge.port):
        for _ in range(10):
            bridge.tick()
    assert bridge.injector.commands() == (0.0,) * 16


def test_a_build_without_lockstep_is_run_in_real_time(bridge: Bridge, golden: Golden) -> None:
    with calling(Px4Double(lockstep=False), bridge.port):
        for _ in range(10):
            assert bridge.tick()
    golden("message", bridge.said)


def test_nobody_calls(bridge: Bridge, monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    monkeypatch.setattr(px4, "BLOCK_S", 0.02)
    monkeypatch.setattr(px4, "UNCALLED_S", 0.05)
    assert not bridge.tick()
    assert not bridge.again()
    (said,) = bridge.said
    golden("message", said, port=bridge.port)
    assert bridge.injector.counts.imu_out == 0

    with calling(Px4Double(), bridge.port) as double:
        assert bridge.again()
        wait_until(lambda: double.sensors)
        assert double.sensors[0].time_usec == FIRST_US + IMU_NS // 1000  # nothing was lost meanwhile
    assert bridge.said[1:] == [f"PX4 has connected to tcp://127.0.0.1:{bridge.port}"]


def test_px4_leaves_and_another_comes(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(px4, "BLOCK_S", 0.02)
    with calling(Px4Double(), bridge.port):
        for _ in range(20):
            assert bridge.tick()
    assert not bridge.tick()
    assert bridge.injector.commands() == (0.0,) * 16
    assert bridge.injector.counts.restarts == 1
    assert not bridge.injector.counts.taken
    assert "PX4 has disconnected" in bridge.said[0]

    with calling(Px4Double(), bridge.port) as double:
        assert bridge.again()
        for _ in range(20):
            assert bridge.tick()
        commands = bridge.injector.commands()
    assert commands is not None
    assert commands[0] == pytest.approx(acceleration_of(bridge.now_ns), abs=1e-6)
    assert double.steps_back == 0
    assert bridge.injector.counts.restarts == 1


def test_the_clock_of_px4_does_not_step_back_from_run_to_run(bridge: Bridge) -> None:
    with calling(Px4Double(), bridge.port) as double:
        for _ in range(10):
            bridge.tick()
        bridge.begin()
        for _ in range(10):
            assert bridge.tick()
    assert double.steps_back == 0
    assert len(double.sensors) == 40
    assert bridge.injector.counts.imu_out == 20
    assert bridge.injector.counts.restarts == 0


def test_a_sample_that_is_not_newer_is_dropped(bridge: Bridge) -> None:
    with calling(Px4Double(), bridge.port) as double:
        bridge.tick()
        bridge.sample(bridge.now_ns)
        bridge.tick()
    assert double.steps_back == 0
    assert bridge.injector.counts.unsent == 1


@pytest.mark.medium
def test_a_stopped_px4_holds_the_world(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that reads nothing: its line fills, and no sample is lost."""
    monkeypatch.setattr(px4, "BLOCK_S", 0.01)
    monkeypatch.setattr(px4, "PATIENCE_S", 0.0)
    with socket.create_connection(("127.0.0.1", bridge.port), 5.0):
        for number in range(60_000):
            bridge.injector.handle(imu(number * IMU_NS), 0)
        assert not bridge.injector.advance(60_000 * IMU_NS)
        counts = bridge.injector.counts
        assert counts.unsent == 0
        assert 0 < counts.imu_out < 60_000


def test_noise_is_counted(bridge: Bridge) -> None:
    with socket.create_connection(("127.0.0.1", bridge.port), 5.0) as caller:
        caller.sendall(b"GET / HTTP/1.1\r\n\r\n" * 20)
        bridge.tick()
        bridge.injector.serve(bridge.now_ns)
        assert bridge.injector.counts.junk > 0
    assert bridge.injector.commands() == (0.0,) * 16


# What is in the messages


def test_sensors_as_px4_reads_them(bridge: Bridge) -> None:
    injector = bridge.injector
    with calling(Px4Double(), bridge.port) as double:
        injector.handle(imu(1 * IMU_NS), 0)
        injector.handle(mav.MAVLink_xitl_magnetometer_message(5_000, [0.21, -0.03, 0.41]), 0)
        injector.handle(mav.MAVLink_xitl_barometer_message(5_000, 101_325.0, 24.5), 0)
        injector.handle(imu(2 * IMU_NS), 0)
        injector.handle(imu(3 * IMU_NS), 0)
        gnss = mav.MAVLink_xitl_gnss_message(
            15_000, -88_000_000, -639_500_000, 61_500, [1.5, -2.0, 0.25], 0.8, 1.2, 0.1, 3, 14
        )
        injector.handle(gnss, 0)
        injector.handle(imu(4 * IMU_NS), 0)
        assert bridge.injector.advance(20 * MS)
        bridge.now_ns = 20 * MS
        bridge.tick()
    first, second, third = double.sensors[:3]
    assert (first.id, first.fields_updated) == (0, 0b111111)
    assert first.time_usec == FIRST_US + 5_000
    assert (first.xgyro, first.ygyro, first.zgyro) == pytest.approx((0.01, 0.02, 0.125))
    assert (first.xacc, first.yacc, first.zacc) == pytest.approx((acceleration_of(IMU_NS), 0.5, -9.8), rel=1e-6)
    # Field and barometer are new, and only now. PX4 1.16 takes a barometer with all of these bits: 9, 11 and 12.
    assert second.fields_updated == 0b1_1011_1111_1111
    assert (second.xmag, second.ymag, second.zmag) == pytest.approx((0.21, -0.03, 0.41))
    assert second.abs_pressure == pytest.approx(1013.25)
    assert second.temperature == 24.5
    assert second.pressure_alt == pytest.approx(0.0, abs=0.01)  # at the standard's pressure at sea level
    assert third.fields_updated == 0b111111
    (fix,) = double.fixes
    assert (fix.lat, fix.lon, fix.alt, fix.fix_type, fix.satellites_visible) == (
        -88_000_000,
        -639_500_000,
        61_500,
        3,
        14,
    )
    assert (fix.vel, fix.vn, fix.ve, fix.vd) == (250, 150, -200, 25)
    assert fix.cog == pytest.approx(30_687, abs=1)  # 306.87 degrees: a 3-4-5 triangle to the north-west
    assert (fix.eph, fix.epv) == (80, 120)  # cm, as PX4 reads them
    assert bridge.injector.counts.gnss_out == 1


# Real time


def test_in_real_time_samples_go_out_as_they_come(vehicle: ToldVehicle) -> None:
    injector = listening(vehicle)

    def served_until(done: Callable[[], bool]) -> None:
        wait_until(lambda: injector.serve(0) or done())

    try:
        injector.reset(TickClock(), False, lambda severity, text: None)
        with calling(Px4Double(), int(injector.addresses[0].rpartition(":")[2])) as double:
            served_until(lambda: injector.counts.taken)
            for number in range(1, 11):
                injector.handle(imu(number * IMU_NS), number * IMU_NS)
            served_until(lambda: injector.counts.outputs_in == 10)
        assert [message.time_usec for message in double.sensors] == [FIRST_US + 5_000 * n for n in range(1, 11)]
        assert injector.counts.outputs_in == 10
    finally:
        injector.close()


class Board:
    """PX4 on a board in HITL mode, at the other end of a MAVLink line."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(PATIENCE_S)
        self.vehicle = VehicleLink(f"udp://127.0.0.1:{self.socket.getsockname()[1]}", outputs_wanted=False)
        self.said: list[str] = []
        self.injector = Px4Injector.open("", self.vehicle)
        self.begin(lockstep=False)
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.vehicle.update(0)
        data, self.there = self.socket.recvfrom(2048)
        self.heard = list(self.mav.parse_buffer(data) or [])

    def begin(self, lockstep: bool) -> None:
        self.vehicle.reset(TickClock(), lambda severity, text: None)
        self.injector.reset(TickClock(), lockstep, lambda severity, text: self.said.append(text))

    def say(self, message: Any, now_ns: int = 0) -> None:
        self.socket.sendto(message.pack(self.mav), self.there)
        before = self.vehicle.counters.received
        while self.vehicle.counters.received == before:  # a datagram on the loopback is there as soon as it is sent
            self.vehicle.receive(now_ns)

    def heartbeat(self, simulates: bool) -> Any:
        mode = CUSTOM_MODE | (32 if simulates else 0)
        return self.mav.heartbeat_encode(mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_AUTOPILOT_PX4, mode, 0, 3)

    def receive(self) -> Any:
        return (self.mav.parse_buffer(self.socket.recv(2048)) or [None])[0]

    def close(self) -> None:
        self.vehicle.close()
        self.socket.close()


CUSTOM_MODE = 1


@pytest.fixture
def board() -> Iterator[Board]:
    made = Board()
    yield made
    made.close()


def test_a_board_gets_its_sensors_over_its_mavlink(board: Board) -> None:
    board.say(board.heartbeat(simulates=True))
    board.injector.handle(imu(IMU_NS), IMU_NS)
    sensor = board.receive()
    assert sensor.get_type() == "HIL_SENSOR"
    assert sensor.time_usec == 5_000
    assert board.injector.counts.imu_out == 1
    assert board.injector.counts.taken
    assert board.injector.addresses == ()


def test_outputs_of_a_board(board: Board) -> None:
    controls = [0.5, -0.25, *[0.0] * 14]
    board.say(board.mav.hil_actuator_controls_encode(1, controls, 128 | CUSTOM_MODE, 0))
    assert board.injector.commands() == tuple(controls)
    board.say(board.mav.hil_actuator_controls_encode(2, controls, CUSTOM_MODE, 0))
    assert board.injector.commands() == (0.0,) * 16
    assert board.injector.counts.outputs_in == 2


def test_a_board_that_does_not_simulate_is_told_of_once(board: Board, golden: Golden) -> None:
    board.say(board.heartbeat(simulates=False))
    for now_ns in (0, 4 * 10**9, 6 * 10**9, 7 * 10**9):
        board.injector.serve(now_ns)
    golden("message", board.said)


def test_a_board_keeps_its_own_time(board: Board) -> None:
    board.begin(lockstep=True)
    assert "use clock.mode=realtime" in board.said[0]
    assert board.injector.advance(10 * MS)
