"""The bridge as a node's role: what goes where, and when."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from bridged_vehicle import ARMED, VehicleDouble

from agent.bridges import role
from agent.bridges.injector import Injector, InjectorCounters
from agent.bridges.role import BridgeRole, MotorOutputs
from agent.bridges.vehicle_link import VehicleLink
from agent.node import PROTOCOL, AgentNode
from agent.timing.clock import Clock
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from tests.golden import Golden
from tests.patience import PATIENCE_S, wait_until

LOCKSTEP, REALTIME = mav.XITL_CLOCK_MODE_LOCKSTEP, mav.XITL_CLOCK_MODE_REALTIME
START, STOP = mav.XITL_RUN_COMMAND_START, mav.XITL_RUN_COMMAND_STOP


class Way(Injector):
    """A way in that does as it is told."""

    title = "way"

    def __init__(self, pulses_us: Sequence[int] | None = None, values: Sequence[float] | None = None) -> None:
        self.counts = InjectorCounters()
        self.taken: list[str] = []
        self.follows = True
        self.advanced_ns: list[int] = []
        self.pulses_us, self.values = pulses_us, values
        self.say: Callable[[int, str], None] = lambda severity, text: None
        self.repeated: Callable[[], object] = lambda: None
        self.ran_on_ns: list[int] = []
        self.closed = False

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        self.counts = InjectorCounters()
        self.say = say

    def handle(self, message: Any, now_ns: int) -> None:
        self.taken.append(message.get_type())

    def advance(self, now_ns: int) -> bool:
        self.advanced_ns.append(now_ns)
        self.counts.outputs_in += 1
        return self.follows

    def repeat(self, now_ns: int) -> None:
        self.repeated()

    def run_on(self, now_ns: int) -> bool:
        self.ran_on_ns += [now_ns] if self.follows else []
        return self.follows

    def pulses(self) -> Sequence[int] | None:
        return self.pulses_us

    def commands(self) -> Sequence[float] | None:
        return self.values

    @property
    def addresses(self) -> tuple[str, ...]:
        return ("way://here",)

    def close(self) -> None:
        self.closed = True


class Bench:
    """A node that is a bridge with these ways in, a host's link to it, the autopilot at its other end."""

    def __init__(self, *ways: Injector, reboots: bool = False) -> None:
        here, there = memory_pair()
        self.host, own = Link(here, 255, 190), Link(there, 1, 1)
        self.double = VehicleDouble()
        self.vehicle = VehicleLink(self.double.url)
        self.role = BridgeRole(own.send, self.vehicle, ways, MotorOutputs((1, 3)), reboots)
        self.node = AgentNode(own, self.role)
        assert self.vehicle.wait_for_line(2.0)
        self.double.link.receive(0.01)
        self.tick = self._told = 0

    def start(self, mode: int) -> list[Any]:
        self._told = 0
        return self.send(mav.MAVLink_xitl_run_message(0, b"test", START, mode, PROTOCOL))

    def stop(self) -> list[Any]:
        return self.send(mav.MAVLink_xitl_run_message(0, b"test", STOP, LOCKSTEP, PROTOCOL))

    def send(self, *messages: Any) -> list[Any]:
        """What the host gets after these."""
        self.host.send(*messages)
        self.node.poll()
        return self.host.receive()

    def tell(self, *messages: Any) -> None:
        """The autopilot says this, and it has arrived."""
        before = self.double.link.counters.bytes_out
        self.double.say(*messages)
        self._told += self.double.link.counters.bytes_out - before
        wait_until(self._arrived)

    def _arrived(self) -> bool:
        self.vehicle._arrived += self.vehicle._link.receive()
        return self.vehicle.counters.bytes_in >= self._told

    def exchange(self) -> list[Any]:
        self.tick += 1
        return self.again()

    def again(self) -> list[Any]:
        return self.send(mav.MAVLink_xitl_tick_message(self.tick * 10_000, self.tick))

    def close(self) -> None:
        self.role.close()
        self.double.close()


@pytest.fixture
def make() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def bench(*ways: Injector, reboots: bool = False) -> Bench:
        made.append(Bench(*ways, reboots=reboots))
        return made[-1]

    yield bench
    for one in made:
        one.close()


def of(messages: list[Any], name: str) -> list[Any]:
    return [message for message in messages if message.get_type() == name]


def beat(flags: int = 0) -> Any:
    return mav.MAVLink_heartbeat_message(11, 3, flags, 0, 4, 3)


def servo(*pulses: int) -> Any:
    return mav.MAVLink_servo_output_raw_message(0, 0, *pulses, *(0,) * (16 - len(pulses)))


def test_who_it_is(make: Callable[..., Bench]) -> None:
    bench = make(Way())
    (info,) = of(bench.start(LOCKSTEP), "XITL_NODE_INFO")
    assert info.nodes == "LS,LC,LA"
    assert bench.role.addresses == (bench.double.url, "way://here")


def test_sensors_go_to_all_ways_and_orders_to_the_autopilot(make: Callable[..., Bench]) -> None:
    one, two = Way(), Way()
    bench = make(one, two)
    bench.start(LOCKSTEP)
    bench.send(
        mav.MAVLink_xitl_imu_message(1, [0] * 3, [0] * 3, 20),
        mav.MAVLink_xitl_truth_message(1, [0] * 3, [0] * 3, [1, 0, 0, 0], [0] * 3, -1, 0),
        mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
        mav.MAVLink_xitl_timesync_message(0, 0, 0, 1),
        mav.MAVLink_distance_sensor_message(0, 20, 4000, 250, 0, 1, 25, 0),
        mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0),
    )
    assert one.taken == two.taken == ["XITL_IMU", "XITL_TRUTH", "DISTANCE_SENSOR", "COMMAND_LONG"]
    wait_until(lambda: bench.double.hear() and len(bench.double.heard) >= 3)
    heard = [(message.get_type(), message.get_srcComponent()) for message in bench.double.heard]
    own_heartbeat = ("HEARTBEAT", 190)
    assert heard == [own_heartbeat, ("DISTANCE_SENSOR", 190), ("COMMAND_LONG", 190)]


def test_a_tick_lets_all_ways_advance_and_answers_with_the_outputs(make: Callable[..., Bench]) -> None:
    way = Way(pulses_us=[1700, 0, 1300])
    bench = make(way)
    bench.start(LOCKSTEP)
    bench.send(mav.MAVLink_xitl_imu_message(9_000, [0] * 3, [0] * 3, 20))
    (answer,) = of(bench.exchange(), "XITL_ACTUATORS")
    assert way.advanced_ns == [10_000_000]
    assert list(answer.command[:2]) == pytest.approx([0.5, -0.5])
    assert (answer.tick, answer.count, answer.time_usec, answer.imu_time_usec) == (1, 2, 10_000, 9_000)


def test_an_autopilot_that_does_not_follow_is_not_answered_for(make: Callable[..., Bench]) -> None:
    way = Way(pulses_us=[1500] * 3)
    bench = make(way)
    bench.start(LOCKSTEP)
    way.follows = False
    way.say(4, "it does not follow")
    came = bench.exchange()
    assert of(came, "XITL_ACTUATORS") == []
    assert [message.text for message in of(came, "STATUSTEXT")] == ["Bridge: it does not follow"]
    way.follows = True
    assert of(bench.again(), "XITL_ACTUATORS")[0].tick == 1
    assert way.advanced_ns == [10_000_000] * 2


def test_an_autopilot_that_follows_late_is_answered_for_without_another_tick(make: Callable[..., Bench]) -> None:
    """A host on a link that loses nothing sends a tick once."""
    way = Way(pulses_us=[1700, 0, 1300])
    bench = make(way)
    bench.start(LOCKSTEP)
    way.follows = False
    assert of(bench.exchange() + bench.send() + bench.send(), "XITL_ACTUATORS") == []
    way.follows = True
    (answer,) = of(bench.send(), "XITL_ACTUATORS")
    assert (answer.tick, list(answer.command[:2])) == (1, pytest.approx([0.5, -0.5]))
    assert of(bench.send(), "XITL_ACTUATORS") == []
    assert len(way.advanced_ns) == 4


def test_the_host_is_told_the_same_in_the_same_order_however_late_the_autopilot_follows(
    make: Callable[..., Bench],
) -> None:
    def told(late: bool) -> list[tuple[str, int]]:
        way = Way(pulses_us=[1500] * 3)
        bench = make(way)
        bench.start(LOCKSTEP)
        came = []
        for _ in range(120):
            way.follows = not late
            came += bench.exchange()
            way.follows = True
            came += bench.send()
        return [(message.get_type(), getattr(message, "time_usec", 0)) for message in came]

    assert told(late=True) == told(late=False)


def test_a_run_that_is_stopped_leaves_no_tick_open(make: Callable[..., Bench]) -> None:
    way = Way(pulses_us=[1500] * 3)
    bench = make(way)
    bench.start(LOCKSTEP)
    way.follows = False
    bench.exchange()
    bench.stop()
    way.follows = True
    assert bench.send() == []
    assert len(way.advanced_ns) == 1


def test_normalised_outputs_come_before_pulses(make: Callable[..., Bench]) -> None:
    bench = make(Way(), Way(pulses_us=[1900] * 3, values=[0.1, 0.2, 0.3]))
    bench.start(LOCKSTEP)
    (answer,) = of(bench.exchange(), "XITL_ACTUATORS")
    assert list(answer.command[:2]) == pytest.approx([0.1, 0.3])


def test_what_the_autopilot_says_is_passed_on_ahead_of_the_answer(make: Callable[..., Bench]) -> None:
    bench = make(Way(pulses_us=[1500] * 3))
    bench.start(LOCKSTEP)
    bench.tell(beat(ARMED), mav.MAVLink_local_position_ned_message(5, 1, 2, 3, 4, 5, 6))
    assert bench.host.receive() == []
    names = [message.get_type() for message in bench.exchange()]
    assert names[-3:] == ["HEARTBEAT", "LOCAL_POSITION_NED", "XITL_ACTUATORS"]
    (answer,) = of(bench.exchange(), "XITL_ACTUATORS")
    assert answer.flags == mav.XITL_ACTUATOR_FLAGS_ARMED
    assert bench.role.traffic.estimates == 1


def test_real_time_outputs_are_sent_as_they_come_and_silence_stays_silence(make: Callable[..., Bench]) -> None:
    bench = make(Way())
    bench.start(REALTIME)
    bench.tell(beat(), servo(1900, 0, 1100))
    (first,) = of(bench.send(), "XITL_ACTUATORS")
    assert list(first.command[:2]) == [1.0, -1.0]
    assert all(not of(bench.send(), "XITL_ACTUATORS") for _ in range(20))
    bench.tell(servo(1900, 0, 1100))
    (second,) = wait_until(lambda: of(bench.send(), "XITL_ACTUATORS"))
    assert second.tick == first.tick + 1
    assert bench.role.traffic.efforts == 2


def test_between_runs_it_hears_the_autopilot_and_tells_nobody(make: Callable[..., Bench]) -> None:
    """What came after the last status would be frames received that nobody has sent."""
    bench = make(Way())
    bench.tell(beat(), servo(1900, 0, 1100))
    assert bench.send() == []
    bench.start(REALTIME)
    bench.tell(beat())
    assert of(bench.send(), "HEARTBEAT")
    bench.stop()
    bench.tell(beat(), servo(1900, 0, 1100))
    assert all(not bench.send() for _ in range(5))


def test_the_end_is_neutral_disarmed_and_counted(make: Callable[..., Bench]) -> None:
    way = Way(pulses_us=[1900] * 3)
    bench = make(way)
    bench.start(LOCKSTEP)
    bench.tell(beat(ARMED))
    bench.exchange()
    way.counts.imu_out, way.counts.restarts, way.counts.taken = 7, 2, True
    bench.double.heard.clear()
    came = bench.stop()
    last = of(came, "XITL_ACTUATORS")[-1]
    assert (last.flags, list(last.command[:2])) == (0, [0.0, 0.0])
    status = of(came, "XITL_BRIDGE_STATUS")[-1]
    assert (status.imu_out, status.restarts, status.outputs_in, status.mavlink_in) == (7, 2, 1, 1)
    assert status.connected == 3
    wait_until(lambda: bench.double.hear() and of(bench.double.heard, "COMMAND_LONG"))
    order = of(bench.double.heard, "COMMAND_LONG")[-1]
    assert (order.command, order.param1) == (mav.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)


def test_after_the_end_the_autopilot_runs_on_for_a_second_and_then_as_long_as_it_is_waited_for(
    make: Callable[..., Bench],
) -> None:
    """It hears and logs the last orders, and a SIGTERM, only while its time goes on."""
    way = Way(pulses_us=[1900] * 3)
    bench = make(way)
    bench.start(LOCKSTEP)
    for _ in range(3):
        bench.exchange()
    bench.send()
    assert way.ran_on_ns == []
    bench.stop()
    assert way.ran_on_ns[:100] == [30_000_000 + step * 10_000_000 for step in range(1, 101)]
    before = len(way.ran_on_ns)
    bench.send()
    bench.send()
    assert len(way.ran_on_ns) == before + 2
    bench.start(LOCKSTEP)
    bench.send()
    assert len(way.ran_on_ns) == before + 2


@pytest.mark.parametrize(
    ("rests_s", "left_s"),
    [
        ((), 0.3),  # it never follows
        ((0.29, 0.29), 0.88),  # two steps, each just in time
        ((0.29,) * 9, 1.5),  # each in time, but the whole is limited
    ],
)
def test_after_the_end_an_autopilot_that_does_not_follow_is_left(
    make: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch, rests_s: tuple[float, ...], left_s: float
) -> None:
    """After 0.3 s without progress, or 1.5 s in all."""
    way = Way(pulses_us=[1900] * 3)
    bench = make(way)
    bench.start(LOCKSTEP)
    bench.exchange()
    now_s, due_s = [5000.0], [5000.0 + sum(rests_s[: number + 1]) for number in range(len(rests_s))]

    def rest(seconds: float) -> None:
        now_s[0] += seconds

    def run_on(now_ns: int) -> bool:
        if due_s and now_s[0] >= due_s[0]:
            due_s.pop(0)
            return True
        return False

    monkeypatch.setattr(role, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(role, "sleep", rest)
    monkeypatch.setattr(way, "run_on", run_on)
    bench.stop()
    assert now_s[0] - 5000.0 == pytest.approx(left_s, abs=0.004)


def test_an_autopilot_that_has_left_is_not_waited_for_at_the_end(make: Callable[..., Bench]) -> None:
    way = Way(pulses_us=[1900] * 3)
    bench = make(way)
    bench.start(LOCKSTEP)
    bench.exchange()
    way.follows = False
    assert of(bench.stop(), "XITL_ACTUATORS")[-1].flags == 0
    assert way.ran_on_ns == []


DISARM, REBOOT = mav.MAV_CMD_COMPONENT_ARM_DISARM, mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN


def last_orders(bench: Bench, way: Way, result: int | None) -> tuple[list[tuple[int, float]], str]:
    """Those at the end of a run in real time, and what the host is told of them.

    The autopilot answers with `result`, None for nothing, and hears only while samples come: as an ArduPilot with an
    external AHRS, whose main loop waits for inertial samples without an end.
    """
    bench.start(REALTIME)
    bench.tell(beat(ARMED))
    bench.send()
    bench.double.hear()
    bench.double.heard.clear()

    def answer() -> None:
        for order in of(bench.double.hear(), "COMMAND_LONG"):
            if result is not None:
                bench.double.say(mav.MAVLink_command_ack_message(order.command, result))

    way.repeated = answer
    said = "".join(text.text for text in of(bench.stop(), "STATUSTEXT"))
    wait_until(lambda: not bench.double.hear())
    return [(order.command, order.param1) for order in of(bench.double.heard, "COMMAND_LONG")], said


@pytest.mark.parametrize("reboots", [False, True])
def test_an_autopilot_that_hears_only_while_samples_come_gets_its_last_orders(
    make: Callable[..., Bench], reboots: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(role, "LAST_TRY_S", PATIENCE_S)
    way = Way()
    orders, said = last_orders(make(way, reboots=reboots), way, mav.MAV_RESULT_ACCEPTED)
    assert orders == ([(DISARM, 0.0), (REBOOT, 1.0)] if reboots else [(DISARM, 0.0)])
    assert said == ("Bridge: the autopilot reboots: the run is over" if reboots else "")


@pytest.mark.parametrize(("result", "times"), [(mav.MAV_RESULT_FAILED, 1), (None, 3)])
def test_a_last_order_that_is_not_accepted_is_told_and_an_unheard_one_repeated(
    make: Callable[..., Bench], result: int | None, times: int, monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    if result is not None:
        monkeypatch.setattr(role, "LAST_TRY_S", PATIENCE_S)
    way = Way()
    orders, said = last_orders(make(way, reboots=True), way, result)
    assert orders == [(DISARM, 0.0)] * times  # armed still, it would refuse to reboot
    golden("message", said)


def test_orders_to_an_autopilot_that_has_left_are_counted(make: Callable[..., Bench]) -> None:
    way = Way()
    bench = make(way)
    bench.start(REALTIME)
    way.counts.unsent = 3
    bench.tell(beat())
    bench.send()
    bench.double.close()
    wait_until(lambda: bench.vehicle.receive(0) or not bench.vehicle.line_is_up)
    bench.send(mav.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    assert of(bench.stop(), "XITL_BRIDGE_STATUS")[-1].unsent == 3 + 1


def test_its_status_comes_once_a_second(make: Callable[..., Bench]) -> None:
    bench = make(Way(pulses_us=[1500] * 3))
    bench.start(LOCKSTEP)
    came = [message for _ in range(301) for message in bench.exchange()]
    assert [status.time_usec for status in of(came, "XITL_BRIDGE_STATUS")] == [0, 1_000_000, 2_000_000, 3_000_000]


def test_lockstep_is_not_woken_by_the_autopilot(make: Callable[..., Bench]) -> None:
    bench = make(Way())
    assert len(bench.role.descriptors()) == 1
    bench.start(LOCKSTEP)
    assert bench.role.descriptors() == ()
    bench.stop()
    assert len(bench.role.descriptors()) == 1


def test_it_closes_what_it_has(make: Callable[..., Bench]) -> None:
    way = Way()
    make(way).role.close()
    assert way.closed


def test_the_world_waits_for_the_connection_and_then_goes_on_without(
    make: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch, golden: Golden
) -> None:
    monkeypatch.setattr("agent.bridges.role.REACH_S", 0.01)
    monkeypatch.setattr("agent.bridges.role.PATIENCE_S", 0.05)
    bench = make(Way(pulses_us=[1500] * 3))
    bench.start(LOCKSTEP)
    assert of(bench.exchange(), "XITL_ACTUATORS")
    bench.double.close()
    wait_until(lambda: bench.vehicle.receive(0) or not bench.vehicle.line_is_up)
    came = bench.exchange()
    assert of(came, "XITL_ACTUATORS") == []
    for _ in range(20):
        came += bench.again()
    assert of(came, "XITL_ACTUATORS")
    text = "".join(message.text for message in of(came, "STATUSTEXT"))
    golden("text", text, url=bench.double.url)


def test_an_autopilot_that_rests_and_puts_out_nothing_is_not_silent(make: Callable[..., Bench]) -> None:
    """A PX4 on a board, disarmed: its motors are told of ten times a second."""
    bench = make(Way(values=(0.0, 0.0, 0.0)))
    bench.start(REALTIME)
    assert of(bench.send(), "XITL_ACTUATORS") == []  # it has not been heard
    bench.tell(beat())
    told = of(bench.send(), "XITL_ACTUATORS")
    wait_until(lambda: told.extend(of(bench.send(), "XITL_ACTUATORS")) or len(told) >= 2)
    assert {message.flags for message in told} == {0}
    assert {tuple(message.command[:2]) for message in told} == {(0.0, 0.0)}
    bench.tell(beat(ARMED))
    bench.send()
    assert of(bench.send(), "XITL_ACTUATORS") == []  # armed, silence is silence
