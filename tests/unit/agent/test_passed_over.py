"""Standard messages for other autopilots do an embedded one no harm: none is refused, none answered."""

from __future__ import annotations

import pytest
from node_host import START, STOP, Host, of

from agent.companion.role import CompanionRole
from agent.roles.role import Role
from agent.wire import dialect as mav

FOR_OTHERS = (
    mav.MAVLink_distance_sensor_message(0, 30, 5000, 2000, 1, 0, 25, 0),
    mav.MAVLink_gps_input_message(0, 0, 6, 0, 2371, 3, -88000000, -639500000, 70.0, 0, 0, 0, 0, 0, 0.1, 0.5, 1.0, 14),
    mav.MAVLink_obstacle_distance_message(0, 0, [6001] * 72, 5, 50, 6000, 5.0, 0.0, 12),
    mav.MAVLink_odometry_message(0, 20, 12, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, [0.0] * 21, [0.0] * 21),
)


@pytest.mark.parametrize("role", [None, CompanionRole()])
def test_they_are_received_counted_and_passed_over(role: Role | None) -> None:
    host = Host(role)
    host.run(START)
    before = host.link.counters.sent
    said = host.send(*FOR_OTHERS)
    assert host.link.counters.sent == before + len(FOR_OTHERS)
    assert not of("STATUSTEXT", said)
    (status,) = of("XITL_NODE_STATUS", host.run(STOP))
    assert (status.frames_dropped, status.messages_refused) == (0, 0)
    assert status.frames_received == len(FOR_OTHERS) + 1  # the order to stop is the last
