"""Counts of a bridge as XITL_BRIDGE_STATUS."""

from __future__ import annotations

from collections.abc import Sequence

from agent.bridges.injector import Injection
from agent.bridges.vehicle_link import VehicleLink
from agent.wire import dialect
from agent.wire.codec import Message

HEARD, TAKEN, SCRIPT = 1, 2, 4
_MOST = 0xFFFFFFFF


def bridge_status(
    now_ns: int, counts: Sequence[Injection], vehicle: VehicleLink, outputs_in: int, unsent: int
) -> Message:
    """What all ways together have done since the run began; `outputs_in` sets of outputs were taken.

    unsent: messages of the host that the autopilot's line did not take; they are added to the frames of the ways in.
    """
    link = vehicle.counters

    def total(name: str) -> int:
        return min(sum(int(getattr(count, name)) for count in counts), _MOST)

    connected = HEARD if vehicle.connected else 0
    connected |= TAKEN if any(count.taken for count in counts) else 0
    connected |= SCRIPT if any(count.script_answers for count in counts) else 0
    damaged = link.dropped_bad_crc + link.dropped_unknown + link.dropped_truncated
    message: Message = dialect.MAVLink_xitl_bridge_status_message(
        time_usec=now_ns // 1000,
        imu_out=total("imu_out"),
        solution_out=total("solution_out"),
        gnss_out=total("gnss_out"),
        unsent=min(total("unsent") + unsent, _MOST),
        world_in=total("world_in"),
        world_resent=total("world_resent"),
        world_lost=total("world_lost"),
        restarts=max(total("restarts"), vehicle.reboots),
        outputs_in=outputs_in & _MOST,
        commands_in=total("commands_in"),
        junk=total("junk"),
        mavlink_in=link.received + vehicle.passed,
        mavlink_lost=link.lost,
        mavlink_dropped=damaged,
        mavlink_passed=vehicle.passed,
        mavlink_out=link.sent,
        script_in=total("script_in"),
        script_out=total("script_out"),
        script_dropped=total("script_dropped"),
        world_rate=min(max((count.world_rate for count in counts), default=0), 0xFFFF),
        connected=connected,
    )
    return message
