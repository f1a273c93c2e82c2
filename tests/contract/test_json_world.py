"""The JSON world against what a real Rover sent, and, where there is one, against a real Rover."""

from __future__ import annotations

import math
import os
import re
import signal
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from json_autopilot import Double, Real, replayed_pulses

from agent.bridges.json_world import JsonWorld
from agent.node import PROTOCOL
from agent.timing.clock import TickClock
from agent.wire import dialect as mav
from agent.wire.transport import open_transport
from tests.free_ports import unread_bytes
from tests.golden import Golden
from tests.patience import PATIENCE_S, wait_until
from xitl_cli.profile import load_profile
from xitl_cli.run.links.connection import AgentConnection
from xitl_cli.run.links.inbox import AgentInbox
from xitl_cli.run.links.peer import InProcessAgent, options_from_profile
from xitl_cli.run.links.ports import PortClaims
from xitl_cli.run.world.world import local_frame

CAPTURE = Path(__file__).parents[1] / "data" / "captures" / "json-servo-packets.bin.gz"
FIRST_DRIVEN = 7800  # frame from which its outputs follow a person's sticks
TICK_US = 10_000
Autopilot = Double | Real


class Host:
    """A world in which the vessel goes round in a circle, and its clock."""

    RADIUS_M, RATE_RADPS = 20.0, 0.1

    def __init__(self, world: JsonWorld) -> None:
        self.world = world
        self.said: list[str] = []
        self.restarts = 0
        self.now_us = 0
        world.reset(TickClock(), True, lambda severity, text: self.said.append(text))
        self.tell(0)

    def motion(self, at_us: int) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
        """Position, velocity, attitude: closed forms."""
        angle = self.RATE_RADPS * at_us * 1e-6
        sin, cos, speed = math.sin(angle), math.cos(angle), self.RADIUS_M * self.RATE_RADPS
        pos = (self.RADIUS_M * sin, self.RADIUS_M * (1.0 - cos), 0.0)
        return pos, (speed * cos, speed * sin, 0.0), (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))

    def tell(self, at_us: int, **wind: float) -> None:
        pos, vel, quat = self.motion(at_us)
        gyro, force = (0.0, 0.0, self.RATE_RADPS), (0.0, self.RADIUS_M * self.RATE_RADPS**2, -9.80665)
        now_ns = at_us * 1000
        for back_us in (5000, 0):
            imu = mav.MAVLink_xitl_imu_message(max(at_us - back_us, 0), gyro, force, 20.0)
            self.world.handle(imu, now_ns)
        speed_mps, direction_rad = wind.get("speed", -1.0), wind.get("direction", 0.0)
        truth = mav.MAVLink_xitl_truth_message(at_us, pos, vel, quat, gyro, speed_mps, direction_rad)
        self.world.handle(truth, now_ns)

    def tick(self, tries: int = 10) -> int:
        """One exchange, repeated as a host does; returns how often it took none."""
        self.now_us += TICK_US
        self.tell(self.now_us)
        for again in range(tries):
            if self.world.advance(self.now_us * 1000):
                return again
        raise AssertionError(f"no answer at {self.now_us} us: {self.said}")

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e6 / TICK_US)):
            self.tick()


@pytest.fixture
def world() -> Iterator[JsonWorld]:
    world = JsonWorld("udp://127.0.0.1:0", lambda: None)
    yield world
    world.close()


@pytest.fixture(params=["double", pytest.param("real", marks=pytest.mark.ardupilot)])
def autopilot(request: pytest.FixtureRequest, tmp_path: Path, world: JsonWorld) -> Iterator[Autopilot]:
    autopilot: Autopilot = Real(tmp_path) if request.param == "real" else Double(_pulses())
    autopilot.start(world.address)
    yield autopilot
    autopilot.stop()


def _pulses() -> dict[int, tuple[int, ...]]:
    return replayed_pulses(CAPTURE)


@pytest.mark.medium
def test_every_frame_up_to_the_tick_is_told_and_taken(world: JsonWorld, autopilot: Autopilot) -> None:
    host = Host(world)
    host.run(3.0)
    counts = world.counts
    assert (counts.world_rate, counts.solution_out) == (1200, 3600)
    # It asks for the first frame at the start, and then for one more with each that it has taken; those of the last
    # exchange are on their way.
    assert 3600 - 12 < counts.world_in <= 3601
    assert (counts.world_resent, counts.world_lost, counts.restarts, counts.junk, counts.unsent) == (0, 0, 0, 0, 0)
    assert counts.outputs_in == 300
    assert counts.taken
    assert not host.said
    pulses = world.pulses()
    assert pulses is not None
    assert len(pulses) == 16
    assert all(pulse == 0 or 800 <= pulse <= 2200 for pulse in pulses)


@pytest.mark.medium
def test_outputs_are_those_of_the_last_exchange(world: JsonWorld) -> None:
    pulses = _pulses()
    double = Double(pulses)
    double.frame = FIRST_DRIVEN
    double.start(world.address)
    host = Host(world)
    seen = []
    for _ in range(300):
        host.tick()
        seen.append(tuple(world.pulses() or ()))
    double.stop()
    assert seen == [pulses[FIRST_DRIVEN + exchange * 12] for exchange in range(300)]
    assert len({pulses[0] for pulses in seen}) > 50


@pytest.mark.medium
def test_the_motion_between_ticks_is_that_of_the_circle(world: JsonWorld) -> None:
    double = Double()
    double.start(world.address)
    host = Host(world)
    host.run(1.0)
    world.advance((host.now_us + 1) * 1000)  # waits for the last exchange
    double.stop()
    assert len(double.told) == 1200
    clock_us, last_s = 0, 0.0
    for index, told in enumerate(double.told):
        # ArduPilot's clock: whole microseconds, what is over is cut off at each step.
        clock_us = int(clock_us + (told.timestamp_s - last_s) * 1e6)
        last_s = told.timestamp_s
        at_us = (index + 1) * 1_000_000 // 1200
        assert clock_us == at_us
        pos, vel, quat = host.motion(at_us)
        # Between ticks the cubic is off by h^4/384 of the fourth derivative, which is nothing; the chord of the
        # velocity by h^2/8 of its second, 2.5e-7 m/s; the rest is how the numbers are written.
        assert told.position == pytest.approx(pos, abs=2e-5)
        assert told.velocity == pytest.approx(vel, abs=2e-5)
        assert told.quaternion == pytest.approx(quat, abs=1e-6)
        assert told.gyro == pytest.approx((0.0, 0.0, 0.1), abs=1e-6)
        assert told.accel_body == pytest.approx((0.0, 0.2, -9.80665), abs=1e-5)


def test_32_channels(world: JsonWorld) -> None:
    double = Double(channels=32)
    double.start(world.address)
    host = Host(world)
    host.run(0.05)
    double.stop()
    assert world.pulses() == (1500,) * 32


def test_a_change_of_rate_in_mid_run(world: JsonWorld) -> None:
    double = Double()
    double.start(world.address)
    host = Host(world)
    host.run(0.5)
    double.rate_hz = 400
    host.run(0.5)
    world.advance((host.now_us + 1) * 1000)
    double.stop()
    assert world.counts.world_rate == 400
    steps_s = [after.timestamp_s - before.timestamp_s for before, after in pairwise(double.told)]
    assert all(step_s == pytest.approx(1 / 1200, abs=2e-6) for step_s in steps_s[:590])
    assert all(step_s == pytest.approx(1 / 400, abs=2e-6) for step_s in steps_s[-150:])
    assert double.told[-1].timestamp_s == pytest.approx(1.0, abs=2e-3)


def test_slow_exchanges_do_not_flood_it(world: JsonWorld) -> None:
    """At 2 Hz an exchange has 600 frames, more than a socket's buffer holds: they go out as they are taken."""
    double = Double()
    double.start(world.address)
    host = Host(world)
    for at_us in (500_000, 1_000_000):
        host.tell(at_us)
        while not world.advance(at_us * 1000):
            pass
    while not world.advance(1_000_001_000):
        pass
    double.stop()
    assert len(double.told) == 1200
    assert world.counts.world_resent == 0


def test_a_lost_answer_is_given_again(world: JsonWorld) -> None:
    double = Double()
    double.deaf = {100, 107}
    double.start(world.address)
    host = Host(world)
    host.run(0.3)
    while not world.advance((host.now_us + 1) * 1000):  # it waits for two answers, and asks again after a second
        pass
    double.stop()
    assert world.counts.world_resent == double.asked_again > 0
    assert double.frame == world.counts.solution_out == 360
    stamps = [told.timestamp_s for told in double.told]
    assert stamps == sorted(stamps)
    assert stamps[-1] == pytest.approx(0.3, abs=1e-6)


@pytest.mark.medium
def test_a_restart_is_noticed_and_served_from_where_the_run_is(world: JsonWorld, autopilot: Autopilot) -> None:
    host = Host(world)
    host.run(1.0)
    autopilot.restart(world.address)
    host.run(1.0)
    assert world.counts.restarts == 1
    assert any(text.startswith("the autopilot has restarted, at 1.0") for text in host.said)
    if isinstance(autopilot, Double):
        assert autopilot.told[-1].timestamp_s == pytest.approx(2.0, abs=0.02)


@pytest.mark.slow
def test_a_dead_autopilot_holds_the_world_and_is_spoken_of_once(world: JsonWorld, autopilot: Autopilot) -> None:
    host = Host(world)
    host.run(0.5)
    _freeze(autopilot, True)
    host.now_us += TICK_US
    host.tell(host.now_us)
    world.advance(host.now_us * 1000)  # what it took before may do
    host.now_us += TICK_US
    host.tell(host.now_us)
    assert not any(world.advance(host.now_us * 1000) for _ in range(5))
    assert world.counts.solution_out == 12 * host.now_us // TICK_US  # sent once, before the wait for the last ones
    (text,) = host.said
    assert re.match(r"the autopilot at udp://127\.0\.0\.1:\d+ has not accepted the world since", text)
    assert not world.counts.taken
    _freeze(autopilot, False)
    host.run(0.5)
    assert world.counts.taken
    assert host.said[1:] == ["the autopilot accepts the world again"]
    assert world.counts.restarts == 0


def _freeze(autopilot: Autopilot, frozen: bool) -> None:
    if isinstance(autopilot, Double):
        (autopilot.paused.set if frozen else autopilot.paused.clear)()
        wait_until(lambda: autopilot.rests.is_set() == frozen)
    else:
        process = autopilot.rover.process
        assert process is not None
        os.kill(process.pid, signal.SIGSTOP if frozen else signal.SIGCONT)


def test_nobody_asks(world: JsonWorld, golden: Golden) -> None:
    host = Host(world)
    assert not any(world.advance(0) for _ in range(4))
    golden("message", host.said, address=world.address)


class PatientDouble(Double):
    """Sends each packet once."""

    resends_s = math.inf


def test_an_autopilot_that_is_slow_to_start_gets_its_first_packet_answered_at_the_first_tick() -> None:
    """The host sends that tick once: in this process nothing can be lost."""
    vehicle, ports = open_transport("tcp://127.0.0.1:0", listen=True), PortClaims()
    profile = load_profile("sitl-ardupilot").runnable()
    address = ports.free_url("udp://127.0.0.1:0")
    bridge = replace(profile.autopilot.bridge, mavlink=vehicle.address, world=address)
    inbox = AgentInbox("agent", local_frame(profile.site), 2, True, lambda stamp_ns, estimate: None)
    connection, double = AgentConnection("agent", profile, inbox), PatientDouble()
    peer = InProcessAgent(options_from_profile(profile, None, bridge=bridge))
    try:
        connection.reach(peer)
        mode = mav.XITL_CLOCK_MODE_LOCKSTEP
        connection.send(mav.MAVLink_xitl_run_message(0, b"test", mav.XITL_RUN_COMMAND_START, mode, PROTOCOL))
        connection.receive()
        zero = (0.0, 0.0, 0.0)
        connection.send(mav.MAVLink_xitl_truth_message(TICK_US, zero, zero, (1.0, 0.0, 0.0, 0.0), zero, -1.0, 0.0))
        sent = connection.link.counters.sent
        connection.send_tick(TICK_US * 1000, 1)
        connection.receive()
        assert inbox.answered_tick != 1
        double.start(address)
        connection.wait_for_answer(TICK_US * 1000, 1, PATIENCE_S, lambda: None)
        assert inbox.answered_tick == 1
        assert connection.link.counters.sent == sent + 1
        wait_until(lambda: double.frame == TICK_US * 1200 // 1_000_000)
    finally:
        double.stop()
        peer.close()
        vehicle.close()
        ports.close()


@pytest.mark.medium
def test_after_a_run_the_vessel_goes_on_as_it_was(world: JsonWorld, autopilot: Autopilot) -> None:
    """So that the autopilot can end in order: it hears that it is to end only between two frames."""
    host = Host(world)
    host.run(4.0)  # the setup of ArduPilot takes 2 s; before its end, SIGTERM ends it at once
    told = world.counts.solution_out
    end_us = host.now_us + 1_000_000
    wait_until(lambda: world.run_on(end_us * 1000))
    assert world.counts.solution_out == told + 1200
    if isinstance(autopilot, Real):
        process = autopilot.rover.process
        assert process is not None
        process.stop(PATIENCE_S, lambda seconds: world.run_on((end_us + 10_000_000) * 1000))
        assert "Exitting" in autopilot.rover.console
        return
    autopilot.stop()
    pos, vel, quat = host.motion(host.now_us)
    for frame in autopilot.told[told:]:
        after_s = frame.timestamp_s - host.now_us * 1e-6
        assert frame.position == pytest.approx([p + v * after_s for p, v in zip(pos, vel, strict=True)], abs=2e-5)
        assert frame.velocity == pytest.approx(vel, abs=1e-5)
        assert frame.quaternion == pytest.approx(quat, abs=1e-6)
        assert frame.gyro == (0.0, 0.0, 0.0)
        assert frame.accel_body == pytest.approx((0.0, 0.0, -9.80665), abs=1e-5)


def test_another_autopilot_takes_over(world: JsonWorld) -> None:
    first, second = Double(), Double()
    second.frame = 5000
    first.start(world.address)
    host = Host(world)
    host.run(0.2)
    first.stop()
    second.start(world.address)
    wait_until(lambda: unread_bytes(int(world.address.rpartition(":")[2])))  # it has asked
    host.run(0.2)
    second.stop()
    assert len(host.said) == 1
    assert host.said[0].startswith("another autopilot at udp://127.0.0.1:")
    assert second.told[-1].frame > 5200
    assert world.counts.restarts == 0


def test_a_truth_that_comes_again_or_too_late_changes_nothing(world: JsonWorld) -> None:
    double = Double()
    double.start(world.address)
    host = Host(world)
    for _ in range(20):
        host.now_us += TICK_US
        for at_us in (host.now_us, host.now_us, host.now_us - TICK_US):
            host.tell(at_us)
        assert world.advance(host.now_us * 1000)
    world.advance((host.now_us + 1) * 1000)
    double.stop()
    for index, told in enumerate(double.told):
        pos, _, quat = host.motion((index + 1) * 1_000_000 // 1200)
        assert told.position == pytest.approx(pos, abs=2e-5)
        assert told.quaternion == pytest.approx(quat, abs=1e-6)


def test_of_a_long_exchange_every_inertial_sample_is_told(world: JsonWorld) -> None:
    """At 2 Hz there are 200 samples in an exchange; each is told from its instant on."""
    double = Double()
    double.start(world.address)
    host = Host(world)
    for stamp_us in range(2500, 500_001, 2500):
        gyro = (stamp_us * 1e-6, 0.0, 0.0)
        world.handle(mav.MAVLink_xitl_imu_message(stamp_us, gyro, (0.0, 0.0, -9.8), 20.0), 0)
    pos, vel, quat = host.motion(500_000)
    world.handle(mav.MAVLink_xitl_truth_message(500_000, pos, vel, quat, (0.0, 0.0, 0.1), -1.0, 0.0), 0)
    while not world.advance(500_000_000):
        pass
    while not world.advance(500_001_000):
        pass
    double.stop()
    for told in double.told[3:]:
        assert 0.0 <= told.timestamp_s - told.gyro[0] < 0.0025 + 2e-6


def test_a_host_that_is_slow_is_no_loss(world: JsonWorld) -> None:
    double = Double()
    double.start(world.address)
    host = Host(world)
    host.tick()
    world.advance((host.now_us + 1) * 1000)  # waits for the last exchange
    wait_until(lambda: double.asked_again)
    host.tick()
    double.stop()
    assert world.counts.world_resent == 0


def test_rangefinders_and_wind_vane(world: JsonWorld) -> None:
    double = Double()
    double.start(world.address)
    host = Host(world)
    host.run(0.1)
    for number, distance_cm in ((0, 250), (5, 1234), (6, 99)):
        distance: Any = mav.MAVLink_distance_sensor_message(0, 20, 4000, distance_cm, 0, number, 25, 0)
        world.handle(distance, 0)
    host.tell(host.now_us, speed=3.25, direction=0.5)
    world.advance(host.now_us * 1000)
    host.now_us += TICK_US
    host.tell(host.now_us, speed=3.25, direction=0.5)
    world.advance(host.now_us * 1000)
    world.advance((host.now_us + 1) * 1000)
    double.stop()
    assert "windvane" not in double.told[100].whole
    last = double.told[-1].whole
    assert {key: last[key] for key in last if key.startswith("rng_")} == {"rng_1": 2.5, "rng_6": 12.34}
    assert last["windvane"] == {"direction": 0.5, "speed": 3.25}


def test_a_second_run_with_the_same_autopilot(world: JsonWorld) -> None:
    double = Double()
    double.start(world.address)
    Host(world).run(0.5)
    world.serve(0)
    host = Host(world)
    assert host.tick() == 0
    host.run(0.2)
    world.advance((host.now_us + 1) * 1000)
    double.stop()
    assert double.told[-1].timestamp_s == pytest.approx(0.21, abs=1e-6)
    assert (world.counts.world_rate, world.counts.restarts, world.counts.solution_out) == (1200, 0, 252)
    assert host.said == []
