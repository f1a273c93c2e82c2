"""Behind a bridge there are two clocks: the agent's own, and that of the autopilot in the standard messages."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from agent.wire import dialect
from agent.wire.codec import Packer, decode
from sim_core.geodesy import LocalFrame
from xitl_cli.run.links.inbox import AgentInbox
from xitl_cli.run.links.link_accounts import LinkTiming

NOW_NS = 9_000_000_000
AHEAD_US = 5_000_000  # of the autopilot's clock


class Kept:
    """In place of a recorder."""

    def __init__(self) -> None:
        self.left_ns: list[int | None] = []

    def frame_received(self, now_ns: int, frame: bytes, left_ns: int | None, name: str) -> None:
        self.left_ns.append(left_ns)


def inbox(lockstep: bool, estimates: list[int | None], kept: Any) -> AgentInbox:
    made = AgentInbox(
        "agent", LocalFrame(-8.8, -63.95, 70.0), 2, lockstep, lambda stamp_ns, _: estimates.append(stamp_ns)
    )
    made.use_vehicle_clock(lambda autopilot_us: (autopilot_us - AHEAD_US) * 1000)
    context: Any = SimpleNamespace(recorder=kept, pace=None, clock=SimpleNamespace(now_ns=lambda: NOW_NS))
    made.begin(context)
    return made


@pytest.mark.parametrize("lockstep", [True, False])
def test_an_estimate_is_of_the_autopilot_s_clock(lockstep: bool) -> None:
    estimates: list[int | None] = []
    packer, one = Packer(1, 1), inbox(lockstep, estimates, Kept())
    for message in (
        dialect.MAVLink_gps_global_origin_message(-88000000, -639500000, 70000),
        dialect.MAVLink_attitude_quaternion_message(7500, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        dialect.MAVLink_local_position_ned_message(7500, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0),
    ):
        one.handle([decode(packer.pack(message))])
    assert estimates == [2_500_000_000]


def test_a_frame_is_stamped_by_the_clock_of_who_wrote_it() -> None:
    kept = Kept()
    packer, one = Packer(1, 1), inbox(False, [], kept)
    one.tap("rx", packer.pack(dialect.MAVLink_local_position_ned_message(7500, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0)))
    assert kept.left_ns == [2_500_000_000]
    own = dialect.MAVLink_xitl_actuators_message(7_500_000, 1, 1, 1, [0.7] * 8, 2, 1)
    one.tap("rx", packer.pack(own))
    assert kept.left_ns[1] is None  # no exchange of time stamps with the agent has been


def test_a_step_of_the_agents_clock_is_logged_once() -> None:
    logged: list[tuple[int, str]] = []
    host_ns = 0
    recorder = SimpleNamespace(
        write=lambda stamp_ns, record: None,
        log=lambda stamp_ns, severity, source, text: logged.append((severity, text)),
    )
    one = inbox(False, [], recorder)
    one.timing = LinkTiming("LC", lambda: host_ns)
    for number in range(400):
        host_ns = number * 100_000_000
        request = one.timing.request(0)
        ahead_ns = 3_000_000_000 + (500_000_000 if number >= 200 else 0)
        request.t2_ns = request.t3_ns = host_ns + 1_000_000 + ahead_ns
        host_ns += 2_000_000
        one.handle([request])
    assert logged == [(4, "the clock of LC stepped by +0.500 s")]
    assert one.clock_stepped
