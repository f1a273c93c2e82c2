"""A whole bridge in lockstep with a real Rover: what its MAVLink brings, and how both get through what may happen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from agent.assembly import assemble
from agent.node import PROTOCOL
from agent.options import BRIDGE, Options
from agent.wire import dialect as mav
from agent.wire.link import Link
from agent.wire.memory import memory_pair
from tests.ardupilot import Rover
from tests.free_ports import free_port

pytestmark = pytest.mark.ardupilot
TICK_US = 10_000
START, STOP = mav.XITL_RUN_COMMAND_START, mav.XITL_RUN_COMMAND_STOP


class Host:
    """Runs the bridge, with a vessel at rest at the origin. kinds: what came, by name; newest: the last of each."""

    def __init__(self, world: str, mavlink: str, opened: ExitStack) -> None:
        here, there = memory_pair()
        self.link = Link(here, 255, 190)
        self.node = assemble(there, Options(role=BRIDGE, autopilot=mavlink, world=world), opened)
        self.kinds: Counter[str] = Counter()
        self.newest: dict[str, Any] = {}
        self.said: list[str] = []
        self.ages_ms: list[float] = []
        self.tick = 0

    def order(self, command: int) -> None:
        mode = mav.XITL_CLOCK_MODE_LOCKSTEP
        self.link.send(mav.MAVLink_xitl_run_message(0, b"test", command, mode, PROTOCOL))
        self.node.poll()
        self.take()

    def take(self) -> bool:
        """Whether the tick was answered."""
        answered = False
        for message in self.link.receive():
            name = message.get_type()
            self.kinds[name] += 1
            self.newest[name] = message
            if name == "STATUSTEXT":
                self.said.append(message.text)
            elif name == "ATTITUDE_QUATERNION":
                self.ages_ms.append(self.tick * TICK_US / 1000 - message.time_boot_ms)
            elif name == "XITL_ACTUATORS":
                answered = answered or message.tick == self.tick
        return answered

    def exchange(self) -> None:
        """The next tick, repeated until it is answered."""
        self.tick += 1
        at_us = self.tick * TICK_US
        truth = mav.MAVLink_xitl_truth_message(at_us, [0] * 3, [0] * 3, [1, 0, 0, 0], [0] * 3, -1, 0)
        self.link.send(mav.MAVLink_xitl_imu_message(at_us, [0] * 3, [0, 0, -9.80665], 20), truth)
        for _ in range(40):
            self.link.send(mav.MAVLink_xitl_tick_message(at_us, self.tick))
            self.node.poll()
            if self.take():
                return
        raise AssertionError(f"no answer to tick {self.tick}: {self.said}")

    def run_until(self, done: Callable[[], object], most_s: float) -> float:
        """Seconds that it took."""
        first = self.tick
        while not done():
            assert (self.tick - first) * TICK_US < most_s * 1e6, (self.kinds, self.said)
            self.exchange()
        return (self.tick - first) * TICK_US * 1e-6

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e6 / TICK_US)):
            self.exchange()

    def command(self, command: int, *values: float) -> None:
        values = (*values, *(0.0,) * (7 - len(values)))
        self.link.send(mav.MAVLink_command_long_message(1, 1, command, 0, *values))


@pytest.fixture
def host(tmp_path: Path) -> Iterator[Host]:
    world = f"udp://127.0.0.1:{free_port()}"
    rover = Rover(tmp_path, world=world)
    with ExitStack() as opened:
        host = Host(world, rover.mavlink, opened)
        opened.enter_context(rover)
        host.order(START)
        yield host


def test_its_mavlink_comes_and_goes(host: Host) -> None:
    host.run_until(lambda: "GPS_GLOBAL_ORIGIN" in host.newest, 40.0)
    host.run(1.0)
    for name in ("HEARTBEAT", "LOCAL_POSITION_NED", "SYS_STATUS", "EKF_STATUS_REPORT", "SYSTEM_TIME", "GPS_RAW_INT"):
        assert name in host.newest, name
    assert host.newest["AUTOPILOT_VERSION"].flight_sw_version >> 24 >= 4
    assert host.newest["HEARTBEAT"].type == mav.MAV_TYPE_SURFACE_BOAT
    # Its clock is simulation time: a message was made in the last exchange, or waited for the loop's turn.
    late_ms = [age_ms for age_ms in host.ages_ms[20:] if not -1.0 <= age_ms <= 50.0]
    assert not late_ms
    status = host.newest["XITL_BRIDGE_STATUS"]
    assert (status.mavlink_lost, status.mavlink_dropped, status.world_resent, status.world_lost) == (0, 0, 0, 0)
    assert status.mavlink_passed > 0
    assert status.connected == 3
    assert "COMMAND_ACK" not in host.kinds  # those of the bridge's own requests stay with it

    host.link.send(mav.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.25, mav.MAV_PARAM_TYPE_REAL32))
    host.run_until(lambda: host.newest.get("PARAM_VALUE") and host.newest["PARAM_VALUE"].param_id == "WP_SPEED", 3.0)
    assert host.newest["PARAM_VALUE"].param_value == pytest.approx(1.25)
    host.link.send(mav.MAVLink_timesync_message(0, 123_456_789))
    host.run_until(lambda: "TIMESYNC" in host.newest, 2.0)
    answer = host.newest["TIMESYNC"]
    assert answer.ts1 == 123_456_789
    assert answer.tc1 * 1e-9 == pytest.approx(host.tick * TICK_US * 1e-6, abs=0.05)

    host.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, 21196.0)
    host.run_until(lambda: host.newest["XITL_ACTUATORS"].flags & mav.XITL_ACTUATOR_FLAGS_ARMED, 3.0)
    assert host.newest["COMMAND_ACK"].command == mav.MAV_CMD_COMPONENT_ARM_DISARM
    host.link.send(mav.MAVLink_rc_channels_override_message(1, 1, 1500, 0, 1900, 0, 0, 0, 0, 0))
    host.run_until(lambda: min(host.newest["XITL_ACTUATORS"].command[:2]) > 0.5, 3.0)
    host.order(STOP)
    assert host.newest["XITL_ACTUATORS"].flags == 0
    assert list(host.newest["XITL_ACTUATORS"].command[:2]) == [0.0, 0.0]


def test_a_slower_world_on_request(host: Host) -> None:
    host.run_until(lambda: "AUTOPILOT_VERSION" in host.newest, 10.0)
    rate = mav.MAVLink_param_set_message(1, 1, b"SIM_RATE_HZ", 1100.0, mav.MAV_PARAM_TYPE_REAL32)
    host.link.send(rate)
    host.run(4.0)
    # A step of 910 us, one more than 1100 Hz have, makes it ask for the whole Hz below.
    assert host.newest["XITL_BRIDGE_STATUS"].world_rate in (1099, 1100)
    assert all(-1.0 <= age_ms <= 50.0 for age_ms in host.ages_ms[20:])


def test_a_reboot_in_mid_run(host: Host) -> None:
    host.run_until(lambda: "AUTOPILOT_VERSION" in host.newest, 10.0)
    host.command(mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    host.run_until(lambda: any("has restarted" in text for text in host.said), 5.0)
    host.kinds.clear()
    host.ages_ms.clear()
    host.run(6.0)
    assert host.newest["XITL_BRIDGE_STATUS"].restarts == 1
    assert host.kinds["AUTOPILOT_VERSION"] >= 1
    assert host.kinds["LOCAL_POSITION_NED"] + host.kinds["ATTITUDE_QUATERNION"] > 20
    assert all(-1.0 <= age_ms <= 50.0 for age_ms in host.ages_ms[20:])
